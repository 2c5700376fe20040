"""The layers of a virtual shoot: what the photographer states, and what was true.

Writes: ``shoot.usda``, as ``usdskin ingest`` would from real photographs; ``truth/truth.exr`` and
        ``truth/truth.usda``.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import combinations
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from usdskin.errors import LayerError
from usdskin.images import Part, read_image, write_exr
from usdskin.judge.shoot.environments import Environment, panorama
from usdskin.judge.shoot.photo_files import CURVES
from usdskin.judge.shoot.setups import BEGAN, Setup, photograph_name
from usdskin.latlong import texel_directions
from usdskin.layers import SettingValue, open_stage, record_provenance, write_layer
from usdskin.prims import (
    ExposureBracket,
    FisheyeLens,
    read_lens,
    write_bracket,
    write_lens,
    write_rotation,
)
from usdskin.prims.writing import write_schema

# isort: split
# After ours, which register the schemas.
from pxr import Gf, Usd, UsdGeom, Vt

FloatArray = NDArray[np.float64]

METER_ANGLE_DEG = 1.0
"""Field of view of the luminance meter [deg], that of common spot meters."""

_METER_RINGS = 24
_EVEN_ROWS = 60  # texels of three degrees, in patches of five by five


@dataclass(frozen=True, slots=True, eq=False)
class Shooting:
    """One shoot: the light, and how the camera really stood."""

    environment: Path
    """Where the light was read from."""

    light: Environment
    """The light."""

    camera: str
    """Make and model of the camera."""

    constant: float
    """c of rho = c integral L s dlambda."""

    names: tuple[str, ...]
    """Names of the views."""

    rotations: tuple[FloatArray, ...]
    """True rotations from camera to world, shape [3, 3] each."""

    stated_rotations: tuple[FloatArray, ...]
    """The rotations that the shoot states, shape [3, 3] each."""


@dataclass(frozen=True, slots=True, eq=False)
class Truth:
    """What the photographer knows and the photographs do not tell."""

    values: NDArray[np.float32]
    """True camera values rho in the panorama's frame, shape [height, 2 * height, 3]."""

    rotations: dict[str, FloatArray]
    """True rotation of every view, from camera to world, shape [3, 3] each."""

    lens: FisheyeLens
    """The true lens."""

    constants: dict[str, Any]
    """``sensorConstant``, ``luminanceUnit``, ``gain``, ``readNoise``, ``camera``, ...; see
    ``write_truth``."""


def write_shoot(path: Path, shooting: Shooting, setup: Setup, folder: Path) -> None:
    """Write the layer that describes the photographs as their taker would.

    Args:
        path: Layer to write, beside the folders of the views.
        shooting: What was photographed.
        setup: How.
        folder: Where the layer is going to lie in the end.

    Raises:
        LayerError: The layer cannot be written.
    """
    stage = new_stage(shooting.light.up_axis)
    prim = UsdGeom.Xform.Define(stage, "/Shoot").GetPrim()
    stage.SetDefaultPrim(prim)
    write_schema(prim, "CaptureAPI", _session(shooting, setup))
    for index, name in enumerate(shooting.names):
        camera = UsdGeom.Camera.Define(stage, f"/Shoot/{name}").GetPrim()
        write_lens(camera, setup.stated_lens)
        count = setup.exposures_of(index).time_s.size
        images = [path.parent / photograph_name(setup, index, shot) for shot in range(count)]
        write_bracket(camera, stated_bracket(setup, images, index), path.parent)
        write_rotation(camera, shooting.stated_rotations[index])
    settings: dict[str, SettingValue] = {
        "camera": setup.camera,
        "seed": setup.seed,
        "views": len(shooting.names),
    }
    record_provenance(stage, "photograph", [shooting.environment], settings, folder)
    write_layer(stage, path)


def new_stage(up_axis: str) -> Usd.Stage:
    """Return an empty stage in memory, in metres.

    Args:
        up_axis: ``Y`` or ``Z``.
    """
    stage = Usd.Stage.CreateInMemory()
    UsdGeom.SetStageUpAxis(stage, UsdGeom.Tokens.z if up_axis == "Z" else UsdGeom.Tokens.y)
    UsdGeom.SetStageMetersPerUnit(stage, 1.0)
    return stage


def _session(shooting: Shooting, setup: Setup) -> dict[str, Any]:
    light = shooting.light
    facing = _unit(setup.illuminance_direction, light.panorama_from_world[1])
    looking = _unit(setup.luminance_direction, even_direction(light))
    factor = 1.0 + setup.reading_error
    return {
        "capture:session": "virtual",
        "capture:device": "virtual camera on a panorama head",
        "capture:time": BEGAN.strftime("%Y-%m-%dT%H:%M:%SZ"),
        "capture:settings:model": shooting.camera,
        "capture:settings:lens": setup.lens_name,
        "capture:settings:whiteBalance": "",
        "capture:illuminance": factor * float(light.irradiance(facing)[3]),
        "capture:illuminance:direction": Gf.Vec3d(*facing.tolist()),
        "capture:luminance": factor * float(spot(light, looking)[3]),
        "capture:luminance:direction": Gf.Vec3d(*looking.tolist()),
        "capture:luminanceWeights": Gf.Vec3d(*luminance_weights(light).tolist()),
    }


def _unit(given: tuple[float, float, float] | None, fallback: FloatArray) -> FloatArray:
    direction = fallback if given is None else np.array(given, dtype=np.float64)
    return np.asarray(direction / np.linalg.norm(direction))


def even_direction(light: Environment) -> FloatArray:
    """Return where a luminance meter is best held: on an even surface of middling brightness.

    Args:
        light: What is measured.

    Returns:
        Unit vector in the world, shape [3].
    """
    luminance = panorama(light, _EVEN_ROWS)[..., 3]
    steps = range(-2, 3)
    near = np.stack([np.roll(luminance, (i, j), (0, 1)) for i in steps for j in steps])
    middle = np.median(luminance)
    usual = (luminance >= 0.5 * middle) & (luminance <= 2.0 * middle)
    usual[: _EVEN_ROWS // 6] = usual[-_EVEN_ROWS // 6 :] = False  # rows shrink towards the poles
    spread = np.where(usual, np.ptp(near, axis=0) / np.maximum(luminance, 1e-300), np.inf)
    row, column = np.unravel_index(int(np.argmin(spread)), spread.shape)
    direction = texel_directions(*spread.shape)[row, column]
    return np.asarray(light.panorama_from_world.T @ direction)


def spot(light: Environment, direction: FloatArray) -> FloatArray:
    """Return the mean response within the field of a luminance meter, shape [4].

    Args:
        light: What is measured.
        direction: Unit vector to the middle of the field, in the world, shape [3].
    """
    across = np.linalg.svd(direction[None])[2]  # rows: the direction, and two across it
    edge = 1.0 - np.cos(np.radians(0.5 * METER_ANGLE_DEG))
    cosine = 1.0 - edge * (np.arange(_METER_RINGS) + 0.5) / _METER_RINGS
    turn = (np.arange(4 * _METER_RINGS) + 0.5) * (2.0 * np.pi / (4 * _METER_RINGS))
    cosine, turn = np.meshgrid(cosine, turn)
    sine = np.sqrt(1.0 - cosine**2)
    first, second = across[1], across[2]
    directions = (
        np.multiply.outer(direction, cosine)
        + np.multiply.outer(first, sine * np.cos(turn))
        + np.multiply.outer(second, sine * np.sin(turn))
    )
    return np.asarray(light.look(directions, np.eye(3)).mean(axis=(0, 1)))


def luminance_weights(light: Environment) -> FloatArray:
    """Return weights of R, G and B, none negative, whose sum follows luminance best.

    They are the fit of least relative squares over the sphere, as a calibration under this very
    light would give them, scaled to a sum of 1.

    Args:
        light: The light.

    Returns:
        Weights [1], shape [3].
    """
    gram = np.zeros((4, 4))
    for values, solid_angle in light.samples():
        bright = values[:, 3] > 0.0
        ratio = values[bright] / values[bright, 3:]
        gram += (ratio * solid_angle[bright, None]).T @ ratio
    best, least = np.array([0.0, 1.0, 0.0]), np.inf
    for count in (1, 2, 3):
        for chosen in map(list, combinations(range(3), count)):
            part = np.linalg.lstsq(gram[np.ix_(chosen, chosen)], gram[chosen, 3], rcond=None)[0]
            weights = np.zeros(3)
            weights[chosen] = part
            misfit = float(weights @ gram[:3, :3] @ weights - 2.0 * weights @ gram[:3, 3])
            if part.min() >= 0.0 and misfit < least:
                best, least = weights, misfit
    return np.asarray(best / best.sum())


def stated_bracket(setup: Setup, images: Sequence[Path], view: int) -> ExposureBracket:
    """Return the bracket of a view as the photographer states it.

    Args:
        setup: How it was taken.
        images: Its photographs.
        view: Index of the view.
    """
    exposures, development = setup.exposures_of(view), setup.development
    black, white = development.levels
    noise = setup.states_noise and not development.is_developed
    per_sample = (white - black) / (setup.sensor.white_level - setup.sensor.black_level)
    gain = np.array([setup.sensor.gain(iso) for iso in exposures.iso]) / per_sample
    return ExposureBracket(
        images=tuple(images),
        exposure_time_s=exposures.time_s,
        iso=exposures.iso,
        f_number=exposures.f_number,
        nd_factor=exposures.nd_factor,
        black_level=np.array([black]),
        white_level=np.array([white]),
        gain=gain if noise else None,
        read_noise=setup.sensor.read_noise / gain if noise else None,
    )


def write_truth(
    folder: Path, shooting: Shooting, setup: Setup, values: FloatArray, final: Path
) -> None:
    """Write ``truth.exr``, ``truth.usda`` and, where pictures are developed, ``response.txt``.

    The layer's cameras have the true lens and rotations. The rest is in ``customData["truth"]`` of
    its default prim: ``sensorConstant`` c of rho = c integral L s dlambda (L in the units of the
    light), ``luminanceUnit`` [cd m^-2] of relative light, ``illuminanceUp`` [lx], ``camera``,
    ``fullWell`` [electrons], ``readNoise`` [electrons], ``gain`` [electrons per DN at ISO 100],
    ``seed``, and
    ``exposureFactors``, true over stated exposure of every photograph, view by view.

    Args:
        folder: To be made.
        shooting: What was photographed.
        setup: How.
        values: True rho in the panorama's frame, shape [height, 2 * height, 3].
        final: Where the folder is going to lie in the end.
    """
    folder.mkdir()
    pixels = values.astype(np.float32)
    channels = {name: pixels[..., index] for index, name in enumerate("RGB")}
    write_exr(folder / "truth.exr", [Part("", channels)])
    stage = new_stage(shooting.light.up_axis)
    prim = UsdGeom.Xform.Define(stage, "/Truth").GetPrim()
    stage.SetDefaultPrim(prim)
    up = shooting.light.panorama_from_world[1]
    factors = [
        factor
        for view in range(len(shooting.names))
        for factor in (setup.true_exposure(view) / setup.exposures_of(view).exposure).tolist()
    ]
    facts: dict[str, Any] = {
        "sensorConstant": shooting.constant,
        "luminanceUnit": shooting.light.luminance_unit,
        "illuminanceUp": float(shooting.light.irradiance(up)[3]),
        "camera": shooting.camera,
        "fullWell": setup.sensor.full_well,
        "readNoise": setup.sensor.read_noise,
        "gain": setup.sensor.gain(100.0),
        "seed": setup.seed,
        "exposureFactors": Vt.DoubleArray(factors),
    }
    prim.SetCustomDataByKey("truth", facts)
    for name, rotation in zip(shooting.names, shooting.rotations, strict=True):
        camera = UsdGeom.Camera.Define(stage, f"/Truth/{name}").GetPrim()
        write_lens(camera, setup.lens)
        write_rotation(camera, rotation)
    record_provenance(stage, "photograph", [shooting.environment], {"seed": setup.seed}, final)
    write_layer(stage, folder / "truth.usda")
    if setup.development.is_developed:
        light = _developed_light(setup.curve)
        lines = [f"{level} {value:.9g}\n" for level, value in enumerate(light)]
        (folder / "response.txt").write_text("".join(lines), "ascii")


def _developed_light(curve: str) -> FloatArray:
    """Return the exposure relative to white of every 8-bit value, shape [256]."""
    light = np.linspace(0.0, 1.0, 1 << 20)
    return np.interp(np.arange(256) / 255.0, CURVES[curve](light), light)


def read_truth(folder: str | Path) -> Truth:
    """Return the truth about a virtual shoot.

    Args:
        folder: What ``photograph`` wrote.

    Raises:
        LayerError: There is no truth in the folder.
    """
    place = Path(folder) / "truth"
    stage = open_stage(place / "truth.usda")
    cameras = [prim for prim in stage.Traverse() if prim.HasAPI("FisheyeCameraAPI")]
    if not cameras:
        raise LayerError(f"{place}/truth.usda: has no views; photograph again")
    cache = UsdGeom.XformCache()
    return Truth(
        values=read_image(place / "truth.exr", channels=("R", "G", "B")).pixels,
        rotations={
            camera.GetName(): np.array(cache.GetLocalToWorldTransform(camera))[:3, :3].T
            for camera in cameras
        },
        lens=read_lens(cameras[0]),
        constants=dict(stage.GetDefaultPrim().GetCustomDataByKey("truth")),
    )
