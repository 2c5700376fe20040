"""Pictures of a head in the true light of the sets against Mitsuba 3's, band by band.

Both renderers take the very files that ``usdskin solve`` wrote; ours by ``usdskin render``'s
function, Mitsuba's by numbers read here from the layers with pxr and OpenEXR alone. The triangles
are those that our reader makes of the bust. How Mitsuba is brought to it:
``mitsuba_shot_peer.py``. ``python tests/test_shot_mitsuba.py`` prints the table of docs/proof.md.
"""

from __future__ import annotations

import importlib.util
import subprocess
import sys
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from usdskin.images import read_spectral
from usdskin.progress import SilentProgress
from usdskin.render.opening import opened
from usdskin.render.overrides import RenderOverrides
from usdskin.render.render import render_stage
from usdskin.render.scene import read_scene
from usdskin.render.settings import resolve_settings

# isort: split
# After ours, which register the schemas.
import OpenEXR
from pxr import Sdf, Usd, UsdGeom

FloatArray = NDArray[np.float64]

pytestmark = pytest.mark.skipif(
    importlib.util.find_spec("mitsuba") is None,
    reason="mitsuba is not installed; the extra `test` has it",
)

STAGES = Path(__file__).resolve().parents[1] / "stages"
SIZE = (64, 80)
BUST = "/Shot/Subject{subject=bust}"
SETS = ("room_fluorescent", "hall_incandescent", "outdoor_sun", "mixed_window")
NO_LUSTRE = "/Shot/Skin.inputs:skin:specular:weight=0"
BOUND = {"map": 5e-3, "traced": 1e-2}


@dataclass(frozen=True)
class Comparison:
    """Our light over Mitsuba's, of parts of the picture."""

    names: tuple[str, ...]
    ratio: FloatArray
    """Shape [parts, bands]."""

    error: FloatArray
    """Standard error of Mitsuba's, relative, shape [parts, bands]."""

    over_bands: FloatArray
    """The same of the sum over bands, ratio and error, shape [parts, 2]."""


def stage_of(name: str) -> Usd.Stage:
    layer = Sdf.Layer.CreateAnonymous(".usda")
    layer.subLayerPaths.append(str(STAGES / name / "shot.usda"))
    subject = Sdf.CreatePrimInLayer(layer, "/Shot/Subject")
    subject.variantSelections["subject"] = "bust"
    return Usd.Stage.Open(layer)


def bust(name: str) -> dict[str, NDArray]:
    """The triangles of the bust, corners not shared."""
    asked = RenderOverrides(variants=[BUST], settings="/Render/Map")
    with opened(STAGES / name / "shot.usda", asked, []) as stage:
        settings = resolve_settings(stage, asked, None, []).settings
        (mesh,) = read_scene(stage, Usd.TimeCode.Default(), settings, [], unlit=True).meshes
    assert mesh.closed
    return {
        "points": mesh.points[mesh.triangles].reshape(-1, 3).astype(np.float64),
        "normals": mesh.normals.reshape(-1, 3),
        "faces": np.arange(3 * len(mesh.triangles)).reshape(-1, 3),
    }


def light(stage: Usd.Stage) -> dict[str, Any]:
    """The dome's bands and the sun, as the layer says."""
    dome = stage.GetPrimAtPath("/Shot/Light/Dome")
    assert dome.GetAttribute("inputs:spectral:source").Get() == "basis"
    assert dome.GetAttribute("inputs:spectral:scale").Get() == 1.0
    nm = np.array(dome.GetAttribute("inputs:spectral:basis:wavelengths").Get())
    basis = np.array(dome.GetAttribute("inputs:spectral:basis").Get()).reshape(-1, nm.size)
    file = dome.GetAttribute("inputs:spectral:coefficients:file").Get().resolvedPath
    channels = OpenEXR.File(str(file), separate_channels=True).channels()
    coefficients = np.stack([channels[f"c{k}"].pixels for k in range(len(basis))], axis=-1)
    frame = np.array(UsdGeom.Xformable(dome).ComputeLocalToWorldTransform(0.0)).T
    half = 0.5 * (nm[1] - nm[0])
    result: dict[str, Any] = {
        "radiance": coefficients.astype(np.float64) @ basis,
        "dome_to_world": frame[:3, :3],
        "edges_nm": np.append(nm - half, nm[-1] + half),
    }
    sun = stage.GetPrimAtPath("/Shot/Light/disc")
    if sun:
        assert sun.GetAttribute("spectrum:emission:quantity").Get() == "irradiance"
        assert np.array_equal(sun.GetAttribute("spectrum:emission:wavelengths").Get(), nm)
        frame = np.array(UsdGeom.Xformable(sun).ComputeLocalToWorldTransform(0.0)).T
        result["sun_direction"] = frame[:3, 2] / np.linalg.norm(frame[:3, 2])
        result["sun_angle_deg"] = sun.GetAttribute("inputs:angle").Get()
        result["sun_irradiance"] = np.array(sun.GetAttribute("spectrum:emission:values").Get())
    return result


def skin(stage: Usd.Stage) -> dict[str, Any]:
    prim = stage.GetPrimAtPath("/Shot/Skin")
    nm = np.array(prim.GetAttribute("spectrum:reflectance:wavelengths").Get())
    result = {"wavelength_nm": nm}
    for name in ("reflectance", "scattering", "opacity"):
        assert np.array_equal(prim.GetAttribute(f"spectrum:{name}:wavelengths").Get(), nm)
        result[name] = np.array(prim.GetAttribute(f"spectrum:{name}:values").Get())
    assert prim.GetAttribute("inputs:skin:wrapNormalization").Get() == "paper"
    for name in ("alpha", "wrap"):
        result[name] = prim.GetAttribute(f"inputs:skin:{name}").Get()
    return result


def camera(stage: Usd.Stage) -> dict[str, Any]:
    prim = UsdGeom.Camera(stage.GetPrimAtPath("/Shot/Camera"))
    aperture = prim.GetHorizontalApertureAttr().Get() / prim.GetFocalLengthAttr().Get()
    assert np.isclose(
        prim.GetVerticalApertureAttr().Get() / prim.GetHorizontalApertureAttr().Get(),
        SIZE[1] / SIZE[0],
    )
    return {
        "camera": np.array(prim.ComputeLocalToWorldTransform(0.0)).T,
        "fov_deg": np.degrees(2.0 * np.arctan(0.5 * aperture)),
        "size": SIZE,
    }


def ours(name: str, folder: Path, integrator: str, samples: int) -> FloatArray:
    asked = RenderOverrides(
        variants=[BUST], settings=f"/Render/{integrator.title()}", resolution=SIZE,
        samples=samples, target_error=0.0 if integrator == "traced" else None, pixel_filter="box",
        bounces=0, spectral_output=True, png=False, attributes=[NO_LUSTRE],
    )  # fmt: skip
    output = folder / f"{name}_{integrator}.exr"
    render_stage(STAGES / name / "shot.usda", output, asked, SilentProgress())
    return read_spectral(output.with_suffix(".spectral.exr"))[1].astype(np.float64)


def theirs(
    name: str, folder: Path, integrator: str, samples: int, passes: int, straight: bool = False
) -> FloatArray:
    stage = stage_of(name)
    job = folder / f"{name}_{integrator}.npz"
    np.savez(
        job, **bust(name), **light(stage), **skin(stage), **camera(stage),
        shadowed=integrator == "traced", straight=straight, samples=samples, passes=passes,
    )  # fmt: skip
    script = Path(__file__).with_name("mitsuba_shot_peer.py")
    out = job.with_suffix(".peer.npz")
    done = subprocess.run(
        [sys.executable, str(script), str(job), str(out)], capture_output=True, text=True
    )
    if done.returncode != 0:
        assert "LLVM" in done.stderr, done.stderr
        pytest.skip("Mitsuba finds no libLLVM of version 17 or later, which this picture needs")
    with np.load(out) as found:
        return np.asarray(found["pictures"], np.float64)


def parts(picture: FloatArray) -> dict[str, NDArray[np.bool_]]:
    """The whole head, its halves, and its rows."""
    total = picture.sum(axis=-1)
    shown = total > 0.0
    rows, columns = np.nonzero(shown)
    head = rows < np.quantile(rows, 0.55)
    middle = np.median(columns[head])
    cut = [-1, *np.quantile(rows, [0.2, 0.4, 0.6]).astype(int), SIZE[1]]
    i, j = np.indices(shown.shape)
    result = {"all": shown, "left": shown & (j < middle), "right": shown & (j >= middle)}
    for name, low, high in zip(("brow", "eyes", "mouth", "bust"), cut, cut[1:], strict=False):
        for side in ("left", "right"):
            result[f"{name}, {side}"] = result[side] & (i > low) & (i <= high)
    return result


def compare(own: FloatArray, peer: FloatArray) -> Comparison:
    names, ratio, error, over = [], [], [], []
    for name, mask in parts(peer.mean(axis=0)).items():
        found = own[mask].sum(axis=0)
        groups = peer[:, mask].sum(axis=1)
        mean = groups.mean(axis=0)
        root = np.sqrt(len(groups))
        names.append(name)
        ratio.append(found / mean)
        error.append(groups.std(axis=0, ddof=1) / root / mean)
        sums = groups.sum(axis=1)
        over.append((found.sum() / sums.mean(), sums.std(ddof=1) / root / sums.mean()))
    return Comparison(tuple(names), np.array(ratio), np.array(error), np.array(over))


def run(name: str, folder: Path, integrator: str, samples: int, passes: int) -> Comparison:
    found = ours(name, folder, integrator, 64 if integrator == "map" else 1024)
    return compare(found, theirs(name, folder, integrator, samples, passes))


def check(found: Comparison, integrator: str) -> None:
    """All bands over the head, and parts of it over all bands."""
    bound = BOUND[integrator]
    assert (found.error[0] < 0.3 * bound).all(), "Mitsuba's pictures are too noisy to tell"
    assert (np.abs(found.ratio[0] - 1.0) <= bound).all()
    assert (found.over_bands[:, 1] < 0.3 * bound).all()
    assert (np.abs(found.over_bands[:, 0] - 1.0) <= bound).all()


@pytest.mark.slow
def test_the_shadowed_bust_in_the_office_matches_mitsuba_in_every_band(tmp_path: Path):
    """And the shadows are no small matter: the map's picture is another one."""
    found = run("room_fluorescent", tmp_path, "traced", 1024, 6)
    check(found, "traced")
    plain = ours("room_fluorescent", tmp_path, "map", 16)
    traced = read_spectral(tmp_path / "room_fluorescent_traced.spectral.exr")[1]
    assert plain.sum() / traced.sum() > 1.0 + 3.0 * BOUND["traced"]


@pytest.mark.slow
@pytest.mark.parametrize("integrator", ["map", "traced"])
@pytest.mark.parametrize("name", SETS)
def test_the_bust_in_a_set_matches_mitsuba_in_every_band(
    tmp_path: Path, name: str, integrator: str
):
    passes = 48 if integrator == "map" else 16
    check(run(name, tmp_path, integrator, 1024, passes), integrator)


@pytest.mark.slow
def test_spectra_that_are_straight_between_samples_change_single_bands_by_a_percent(
    tmp_path: Path,
):
    """A table of 5 nm is read as averages of bands; at the edges of blood it makes a difference."""
    found = ours("room_fluorescent", tmp_path, "map", 64)
    peer = theirs("room_fluorescent", tmp_path, "map", 1024, 16, straight=True)
    result = compare(found, peer)
    off = result.ratio[0] - 1.0
    assert 5e-3 < np.abs(off).max() < 1.2e-2
    assert np.sqrt((off**2).mean()) < 3e-3
    assert np.abs(result.over_bands[0, 0] - 1.0) < 1e-3


def main() -> None:
    """Print the table of docs/proof.md [%]."""
    import tempfile

    print("| set | integrator | bands: mean, rms, largest | error | parts of it | error |")
    print("|---|---|---|---|---|---|")
    for name in sys.argv[1:] or SETS:
        for integrator in ("map", "traced"):
            with tempfile.TemporaryDirectory() as folder:
                found = run(name, Path(folder), integrator, 1024, 48)
            off, error = 100.0 * (found.ratio[0] - 1.0), 100.0 * found.error[0]
            most, parted = np.abs(off).argmax(), 100.0 * (found.over_bands - [1.0, 0.0])
            print(
                f"| {name} | {integrator} | {off.mean():+.2f}, {np.sqrt((off**2).mean()):.2f}, "
                f"{off[most]:+.2f} | {error.mean():.2f} | {parted[1:, 0].min():+.2f} to "
                f"{parted[1:, 0].max():+.2f} | {parted[1:, 1].max():.2f} |",
                flush=True,
            )


if __name__ == "__main__":
    main()
