"""The error budget of a proof: every fault by itself, on an otherwise perfect chain.

The panorama is the true light as the camera responds to it, the chart has its true camera values;
one thing at a time goes wrong with them, the light is estimated by the steps of the chain, and the
shot is rendered by map. So each row says what that one fault costs on skin.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from usdskin.capture.viewpoints import parse_directions
from usdskin.estimate.camera.step import CalibrationOptions, calibrate_camera
from usdskin.estimate.light.step import estimate_light
from usdskin.images import Part, read_image, write_exr
from usdskin.judge.proof.compare import compare_render
from usdskin.judge.proof.ideal import expose_exactly, measure_exactly
from usdskin.judge.proof.light import TrueLight
from usdskin.judge.proof.options import Faults, ProofOptions
from usdskin.judge.proof.place import Place
from usdskin.judge.proof.record import Doing
from usdskin.judge.proof.render import render_shot
from usdskin.judge.proof.shoot import VIEWS, shooting_of
from usdskin.judge.proof.shots import ShotParts, write_shot
from usdskin.judge.proof.skin import write_true_skin
from usdskin.judge.proof.spectra import read_material
from usdskin.judge.shoot.shoot_layers import new_stage
from usdskin.latlong import texel_directions, texel_solid_angles
from usdskin.layers import open_stage, record_provenance, write_layer
from usdskin.prims import read_color_charts, write_color_chart
from usdskin.prims.skin import SkinParameters
from usdskin.progress import Progress, SilentProgress

# isort: split
# After ours, which register the schemas.
from pxr import Sdf, UsdGeom

FloatArray = NDArray[np.float64]
Spoil = Callable[[FloatArray], FloatArray]

_DRAWS = 6
"""Of noise: one chart's may cost twice as much as another's."""


@dataclass(frozen=True, slots=True)
class Fault:
    """One thing that goes wrong."""

    cause: str
    """What it is."""

    setting: str
    """How much of it."""

    panorama: Spoil | None = None
    """What it does to the panorama, shape [height, 2 * height, 3]."""

    chart: Spoil | None = None
    """What it does to the chart's camera values, shape [patch_count, 3]."""

    scale: float = 1.0
    """What it does to the chart's radiance."""

    skin: Callable[[SkinParameters], SkinParameters] | None = None
    """What it does to the skin; the light is then the true one."""


def noise_of(share: float, seed: int) -> Spoil:
    """Return noise that is a share of every value."""

    def spoil(values: FloatArray) -> FloatArray:
        random = np.random.default_rng([seed, values.shape[0]])
        noisy = values * (1.0 + share * random.normal(size=values.shape))
        return np.asarray(np.maximum(noisy, 0.0))

    return spoil


def glare_of(share: float) -> Spoil:
    """Return light spread evenly over the sphere: (1 - g) I + g mean(I)."""

    def spoil(values: FloatArray) -> FloatArray:
        weights = texel_solid_angles(*values.shape[:2]) / (4.0 * np.pi)
        mean = np.einsum("i,ijk->k", weights, values)
        return np.asarray((1.0 - share) * values + share * mean)

    return spoil


def clipping_of(share: float) -> Spoil:
    """Return saturation at a share of the brightest channel of the brightest texel."""

    def spoil(values: FloatArray) -> FloatArray:
        return np.asarray(np.minimum(values, share * values.max()))

    return spoil


def rotation_of(angle_deg: float) -> Spoil:
    """Return a turn about the vertical; texels are averaged, so no light is lost."""

    def spoil(values: FloatArray) -> FloatArray:
        columns = angle_deg / 360.0 * values.shape[1]
        whole = int(np.floor(columns))
        part = columns - whole
        first = np.roll(values, whole, axis=1)
        return np.asarray((1.0 - part) * first + part * np.roll(values, whole + 1, axis=1))

    return spoil


def vignetting_of(share: float) -> Spoil:
    """Return a falloff that is left at the edges of the views: 1 - share (phi / 90 deg)^2."""
    axes = np.array([direction.vector for direction in parse_directions(VIEWS)])

    def spoil(values: FloatArray) -> FloatArray:
        cosine = (texel_directions(*values.shape[:2]) @ axes.T).max(axis=-1)
        angle = np.arccos(np.clip(cosine, -1.0, 1.0)) / (0.5 * np.pi)
        return np.asarray(values * (1.0 - share * angle**2)[..., None])

    return spoil


def faults(seed: int) -> Iterator[tuple[Fault, ...]]:
    """Yield the faults of the budget, the absence of all first; those by chance, a few draws each.

    Args:
        seed: Of the noise.
    """
    draws = range(seed, seed + _DRAWS)
    yield (Fault("recovery alone", "no fault"),)
    for share in (0.01, 0.05):
        what = f"{share:.0%} a texel"
        yield tuple(Fault("sensor noise", what, panorama=noise_of(share, k)) for k in draws)
    for share in (0.005, 0.01, 0.02, 0.05):
        yield (Fault("glare", f"{100 * share:g} %", panorama=glare_of(share)),)
    for share in (0.5, 0.25, 0.1):
        yield (Fault("clipping", f"at 1/{1 / share:g} of the peak", panorama=clipping_of(share)),)
    for angle in (1.0, 3.0, 10.0):
        yield (Fault("rotation", f"{angle:g} deg", panorama=rotation_of(angle)),)
    for share in (0.02, 0.05, 0.1):
        yield (Fault("vignetting left", f"{share:.0%} at the edge", panorama=vignetting_of(share)),)
    for share in (0.01, 0.03):
        yield tuple(Fault("chart noise", f"{share:.0%}", chart=noise_of(share, k)) for k in draws)
    for share in (0.01, 0.03):
        yield (Fault("scale of the readings", f"+{share:.0%}", scale=1.0 + share),)
    for step in (0.05, 0.1):
        yield (Fault("wrap l", f"+{step:g}", skin=partial(_with_wrap, step)),)
    for share in (0.02, 0.05):
        yield (Fault("alpha", f"+{share:.0%}", skin=partial(_with_alpha, share)),)


def _with_wrap(step: float, skin: SkinParameters) -> SkinParameters:
    return replace(skin, wrap=min(skin.wrap + step, 1.0))


def _with_alpha(share: float, skin: SkinParameters) -> SkinParameters:
    return replace(skin, alpha=skin.alpha * (1.0 + share))


def judge_faults(
    truth: TrueLight,
    base: Path,
    place: Place,
    options: ProofOptions,
    progress: Progress,
    doing: Doing,
) -> None:
    """Judge every fault; the rows of ``proof.json`` are the fact ``rows``.

    Args:
        truth: The true light.
        base: The shot.
        place: The proof's folder.
        options: What the proof is told.
        progress: Told how far it is.
        doing: Takes files and rows.
    """
    bench = _Bench(truth, base, place, options)
    found = list(faults(options.seed))
    progress.start(len(found), "budget")
    rows = []
    for draws in found:
        rows.append(_row(draws[0], [bench.judge(fault) for fault in draws]))
        progress.advance()
    progress.done()
    doing.facts["rows"] = rows
    doing.writes.append(place["budget/capture.usda"])


def _row(fault: Fault, draws: list[dict[str, float]]) -> dict[str, Any]:
    """Return the row of a fault: means over its draws, and the largest of all."""
    mean, p95 = (float(np.mean([draw[name] for draw in draws])) for name in ("mean", "p95"))
    largest = max(draw["max"] for draw in draws)
    numbers = {"mean": mean, "p95": p95, "max": largest}
    return {"cause": fault.cause, "setting": fault.setting, "deltaE2000": numbers}


class _Bench:
    """What all faults are judged on."""

    def __init__(self, truth: TrueLight, base: Path, place: Place, options: ProofOptions) -> None:
        self.place, self.options, self.base = place, options, base
        self.folder = place["budget"]
        self.folder.mkdir(parents=True, exist_ok=True)
        self.truth = truth
        none = Doing()
        perfect = replace(options, scale_error=0.0)
        setup = shooting_of(perfect, Faults(noise=False)).setup
        work: tuple[int | None, Progress, Doing] = (options.threads, SilentProgress(), none)
        self.capture = self.folder / "capture.usda"
        constant = expose_exactly(truth.light, self.capture, setup, *work)
        self.charts = []
        for name, light in truth.classes.items():
            chart = self.folder / f"chart_{name}.usda"
            measure_exactly(light, chart, setup, constant, name, options.chart, *work)
            self.charts.append(chart)
        picture = read_image(self.folder / "panorama.exr", channels=("R", "G", "B"))
        self.panorama = np.asarray(picture.pixels, dtype=np.float64)
        self.camera = self._calibrated(self.charts, "camera")
        self.skin, _ = read_material(place.truth_skin)
        self.picture = self._rendered("truth", place.truth_light, place.truth_skin)

    def judge(self, fault: Fault) -> dict[str, float]:
        """Return what one fault does to the picture, as CIEDE2000."""
        light, skin = self.place.truth_light, self.place.truth_skin
        if fault.skin is None:
            light = self._light(fault)
        else:
            skin = write_true_skin(fault.skin(self.skin), skin, self.folder / "fault.skin.usda")
        picture = self._rendered("fault", light, skin)
        maps = self.folder / "fault.difference.exr"
        observer = self.options.observer
        done = compare_render(self.picture, picture, maps, observer, self.place)
        result: dict[str, float] = done.facts["result"]["deltaE2000"]
        return result

    def _light(self, fault: Fault) -> Path:
        camera, panorama = self.camera, self.panorama
        if fault.chart is not None or fault.scale != 1.0:
            charts = [
                _spoiled_chart(chart, fault, self.folder / f"fault.{chart.name}")
                for chart in self.charts
            ]
            camera = self._calibrated(charts, "fault.camera")
        if fault.panorama is not None:
            panorama = fault.panorama(panorama)
        pixels = panorama.astype(np.float32)
        channels = {name: pixels[..., index] for index, name in enumerate("RGB")}
        write_exr(self.folder / "fault.panorama.exr", [Part("", channels, {}, "float", "unknown")])
        capture = self.folder / "fault.capture.usda"
        layer = Sdf.Layer.CreateAnonymous(".usda")
        layer.TransferContent(Sdf.Layer.FindOrOpen(str(self.capture)))
        attribute = layer.GetAttributeAtPath("/Capture.capture:panorama:file")
        attribute.default = Sdf.AssetPath("./fault.panorama.exr")
        write_layer(layer, capture)
        output = self.folder / "fault.light.usda"
        estimate_light(capture, camera, output)
        return output

    def _calibrated(self, charts: Sequence[Path], name: str) -> Path:
        options = CalibrationOptions(
            estimator=self.options.estimator,
            device=self.options.device,
            threads=self.options.threads,
        )
        return calibrate_camera(charts, self.folder / f"{name}.usda", options).path

    def _rendered(self, name: str, light: Path, skin: Path) -> Path:
        parts = ShotParts(light, skin, self.skin.thickness)
        shot = write_shot(self.base, parts, self.folder / f"{name}.shot.usda")
        picture = self.folder / f"{name}.exr"
        render_shot(shot, picture, "map", self.options, SilentProgress())
        return picture


def _spoiled_chart(source: Path, fault: Fault, output: Path) -> Path:
    """Write a chart with a fault."""
    chart = read_color_charts(open_stage(source))[0]
    assert chart.camera_values is not None and chart.signals is not None
    values = chart.camera_values if fault.chart is None else fault.chart(chart.camera_values)
    lamp = chart.illuminant
    spoiled = replace(
        chart,
        where="",
        camera_values=values,
        signals=fault.scale * chart.signals,
        illuminant=None if lamp is None else replace(lamp, value=fault.scale * lamp.value),
    )
    stage = new_stage("Y")
    prim = UsdGeom.Scope.Define(stage, "/Chart").GetPrim()
    stage.SetDefaultPrim(prim)
    write_color_chart(prim, spoiled, output.parent)
    record_provenance(stage, "prove", [], {}, output.parent)
    return write_layer(stage, output)
