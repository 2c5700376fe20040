"""The light a virtual camera stands in, as its three channels and the eye respond to it.

Reads: a stage with dome and distant lights, or a latlong picture under an assigned lamp.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from pxr import Sdf, Usd, UsdGeom, UsdLux

from usdskin.colorimetry import xyz_weights
from usdskin.device import Workers
from usdskin.errors import LayerError
from usdskin.judge.shoot.sensitivity import CameraSensitivity
from usdskin.latlong import (
    latlong_coordinates,
    latlong_directions,
    latlong_from_world,
    texel_directions,
    texel_solid_angles,
)
from usdskin.layers import open_stage
from usdskin.notes import Note
from usdskin.render.lights import Lights, read_lights
from usdskin.render.texels import BadPixels
from usdskin.spectrum import band_widths

FloatArray = NDArray[np.float64]

CHANNEL_COUNT = 4
"""R, G, B and luminance."""

_STAGE_SUFFIXES = (".usd", ".usda", ".usdc", ".usdz")
_ALONE = Workers("cpu", 1)
_LEAST_ROWS = 256  # rows of the quadrature of irradiance; the midpoint rule errs 4e-5 there


@dataclass(frozen=True, slots=True, eq=False)
class LightMap:
    """Light from all around, constant over every texel of a latlong map."""

    values: NDArray[np.float32]
    """Responses of R, G, B and luminance, shape [height, width, 4]."""

    to_world: FloatArray
    """Rotation from the map's frame (+Y pole, u = 0.5 at +Z) to the world, shape [3, 3]."""


@dataclass(frozen=True, slots=True, eq=False)
class LightDisc:
    """A round lamp at infinity, evenly bright."""

    values: FloatArray
    """Responses of R, G, B and luminance, shape [4]."""

    direction: FloatArray
    """Unit vector towards its middle, in the world, shape [3]."""

    half_angle: float
    """Angular radius [rad]."""

    @property
    def solid_angle(self) -> float:
        """Solid angle [sr]."""
        return 4.0 * math.pi * math.sin(0.5 * self.half_angle) ** 2


@dataclass(frozen=True, slots=True, eq=False)
class Environment:
    """Everything that shines on the camera; its parts add up."""

    maps: tuple[LightMap, ...]
    """Domes."""

    discs: tuple[LightDisc, ...] = ()
    """Distant lights."""

    up_axis: str = "Y"
    """``Y`` or ``Z``, the stage's."""

    luminance_unit: float = 1.0
    """Luminance of a relative unit of light [cd m^-2]; 1 where light is absolute."""

    @property
    def panorama_from_world(self) -> FloatArray:
        """Rotation from the stage's world to the panorama's frame, shape [3, 3]."""
        return latlong_from_world(self.up_axis)

    @property
    def rows(self) -> int:
        """Rows of the finest map; 0 without a map."""
        return max((light.values.shape[0] for light in self.maps), default=0)

    @property
    def detail(self) -> float:
        """Size of the smallest thing to be seen: a texel, or a quarter of a disc [rad]."""
        sizes = [math.pi / light.values.shape[0] for light in self.maps]
        return min(sizes + [0.5 * disc.half_angle for disc in self.discs], default=math.pi)

    @property
    def without_discs(self) -> Environment:
        """Its domes alone."""
        return replace(self, discs=())

    def look(self, directions: FloatArray, world_from: FloatArray) -> NDArray[np.float64]:
        """Return what is seen in some directions.

        Args:
            directions: Unit vectors, shape [3, ...].
            world_from: Rotation from their frame to the world, shape [3, 3].

        Returns:
            Responses of R, G, B and luminance, shape [..., 4].
        """
        seen = np.zeros((*directions.shape[1:], CHANNEL_COUNT))
        for light in self.maps:
            seen += _texels(light, light.to_world.T @ world_from, directions)
        for disc in self.discs:
            x, y, z = world_from.T @ disc.direction
            cosine = x * directions[0] + y * directions[1] + z * directions[2]
            seen[cosine >= math.cos(disc.half_angle)] += disc.values
        return seen

    def mean(self) -> FloatArray:
        """Return the mean response over the sphere, shape [4]."""
        total = np.zeros(CHANNEL_COUNT)
        for values, solid_angle in self.samples():
            total += solid_angle @ values
        return total / (4.0 * np.pi)

    def peak(self) -> FloatArray:
        """Return the largest response anywhere, shape [4]."""
        found = [light.values.max(axis=(0, 1)).astype(np.float64) for light in self.maps]
        found += [disc.values for disc in self.discs]
        return np.max(found, axis=0) if found else np.zeros(CHANNEL_COUNT)

    def samples(self) -> Iterator[tuple[FloatArray, FloatArray]]:
        """Yield light, shape [n, 4], and the solid angle it fills [sr], shape [n]."""
        for light in self.maps:
            height, width = light.values.shape[:2]
            solid_angle = texel_solid_angles(height, width)
            for row in range(height):
                yield light.values[row].astype(np.float64), np.full(width, solid_angle[row])
        for disc in self.discs:
            yield disc.values[None], np.array([disc.solid_angle])

    def irradiance(self, direction: FloatArray) -> FloatArray:
        """Return the integral of the light times the cosine to a direction, shape [4].

        Args:
            direction: Unit vector in the world, shape [3].
        """
        total = np.zeros(CHANNEL_COUNT)
        for light in self.maps:
            height, width = light.values.shape[:2]
            finer = -(-_LEAST_ROWS // height)
            solid_angle = texel_solid_angles(height * finer, width * finer)
            cosine = texel_directions(height * finer, width * finer) @ light.to_world.T @ direction
            weight = np.maximum(cosine, 0.0) * solid_angle[:, None]
            weight = weight.reshape(height, finer, width, finer).sum(axis=(1, 3))
            total += np.tensordot(weight, light.values.astype(np.float64), axes=2)
        for disc in self.discs:
            # The mean cosine over a disc, all of it taken to be on one side of the horizon.
            tilt = 0.5 * (1.0 + math.cos(disc.half_angle))
            facing = max(float(disc.direction @ direction), 0.0)
            total += disc.values * (disc.solid_angle * tilt * facing)
        return total


def _texels(light: LightMap, map_from: FloatArray, directions: FloatArray) -> NDArray[np.float32]:
    """Return the texels that directions fall into, shape [..., 4]."""
    height, width = light.values.shape[:2]
    x, y, z = (
        row[0] * directions[0] + row[1] * directions[1] + row[2] * directions[2] for row in map_from
    )
    column = np.arctan2(x, -z) * (width / (2.0 * np.pi))
    column = np.where(column < 0.0, column + width, column).astype(np.intp)
    row = (np.arccos(np.clip(y, -1.0, 1.0)) * (height / np.pi)).astype(np.intp)
    index = np.minimum(row, height - 1) * width + np.minimum(column, width - 1)
    found: NDArray[np.float32] = light.values.reshape(-1, CHANNEL_COUNT)[index]
    return found


def read_environment(
    source: str | Path,
    camera: CameraSensitivity,
    illuminant: str | None = None,
    mean_luminance: float = 100.0,
    bad_pixels: BadPixels = "error",
    notes: list[Note] | None = None,
) -> Environment:
    """Read an environment as a camera responds to it.

    A channel's response is ``integral L(lambda) s(lambda) dlambda``, summed over the camera's own
    bands.

    Args:
        source: A stage with lights, or a latlong picture (EXR, HDR).
        camera: Who looks.
        illuminant: Lamp that RGB light is taken to be; by default what the stage says, else D65.
        mean_luminance: Of the sphere [cd m^-2], where the light has no absolute units.
        bad_pixels: Whether pixels that are no light are refused, or clamped with a note.
        notes: Takes what could not be honoured.

    Raises:
        LayerError: The stage cannot be read or has no light that a camera could see.
        ImageError: A map cannot be read.
        UsageError: The illuminant cannot be used.
    """
    notes = [] if notes is None else notes
    nm = camera.wavelength_nm
    lights, up_axis = read_spectral_lights(source, nm, illuminant, bad_pixels, notes)
    weights = np.column_stack(
        [
            camera.value * band_widths(nm)[:, None],
            xyz_weights(nm, absolute=lights.absolute)[:, 1],
        ]
    )
    found = _responses(lights, weights, str(source), up_axis, notes)
    mean = found.mean()
    if not (np.isfinite(mean).all() and mean[1] > 0.0):
        raise LayerError(f"{source}: no light reaches the camera; add a DomeLight to the stage")
    unit = 1.0 if lights.absolute else mean_luminance / float(mean[3])
    if unit == 1.0:
        return found
    return _responses(lights, weights * [1.0, 1.0, 1.0, unit], str(source), up_axis, [], unit)


def read_spectral_lights(
    source: str | Path,
    wavelength_nm: FloatArray,
    illuminant: str | None,
    bad_pixels: BadPixels,
    notes: list[Note],
) -> tuple[Lights, str]:
    """Return the lights of an environment with their spectra, and its up axis.

    Args:
        source: A stage with lights, or a latlong picture (EXR, HDR).
        wavelength_nm: Band centres [nm], shape [band_count].
        illuminant: As ``read_environment`` takes it.
        bad_pixels: As ``read_environment`` takes it.
        notes: Takes what could not be honoured.

    Raises:
        LayerError: The stage cannot be read.
        ImageError: A map cannot be read.
        UsageError: The illuminant cannot be used.
    """
    path = Path(source)
    is_stage = path.suffix.lower() in _STAGE_SUFFIXES or str(source).endswith("]")
    stage = open_stage(source, notes) if is_stage else _stage_of_picture(path)
    start = Usd.TimeCode(stage.GetStartTimeCode())
    time = start if stage.HasAuthoredTimeCodeRange() else Usd.TimeCode.Default()
    lights = read_lights(
        stage, time, wavelength_nm, illuminant=illuminant, bad_pixels=bad_pixels, notes=notes
    )
    return lights, str(UsdGeom.GetStageUpAxis(stage))


def _stage_of_picture(path: Path) -> Usd.Stage:
    """Return a stage in memory, Y up, with a dome that shows a latlong picture."""
    stage = Usd.Stage.CreateInMemory()
    UsdGeom.SetStageUpAxis(stage, UsdGeom.Tokens.y)
    dome = UsdLux.DomeLight.Define(stage, "/Dome")
    dome.CreateTextureFileAttr(Sdf.AssetPath(str(path.resolve())))
    dome.CreateTextureFormatAttr(UsdLux.Tokens.latlong)
    return stage


def _responses(
    lights: Lights,
    weights: FloatArray,
    where: str,
    up_axis: str,
    notes: list[Note],
    unit: float = 1.0,
) -> Environment:
    maps = []
    for dome in lights.domes:
        values = (dome.coefficients @ (dome.basis @ weights)).astype(np.float32)
        dark = int((values < 0.0).any(axis=-1).sum())
        if dark:
            np.maximum(values, 0.0, out=values)
            text = f"{dark} texels have spectra to which a channel responds below 0; they are black"
            notes.append(Note("negative-response", dome.path, text))
        maps.append(LightMap(values, dome.to_world))
    discs = []
    for distant in lights.distants:
        half = math.radians(0.5 * distant.angle_deg)
        if not 0.0 < half <= 0.5 * math.pi:
            raise LayerError(
                f"{where} <{distant.path}>: its inputs:angle is {distant.angle_deg:g}, and a "
                "camera sees a lamp only if it has a size; author an angle such as 0.53"
            )
        # E = L pi sin^2(t) on a surface that faces the disc.
        radiance = distant.irradiance / (math.pi * math.sin(half) ** 2)
        discs.append(LightDisc(radiance @ weights, distant.direction, half))
    return Environment(tuple(maps), tuple(discs), up_axis, unit)


def panorama(
    environment: Environment,
    height: int,
    workers: Workers = _ALONE,
    advance: Callable[[int], None] | None = None,
) -> FloatArray:
    """Return an environment as a latlong picture in the panorama's frame, averaged over texels.

    Args:
        environment: The light.
        height: Rows; there are twice as many columns.
        workers: Threads to compute with.
        advance: Told how many rows are done.

    Returns:
        Responses of R, G, B and luminance, shape [height, 2 * height, 4].
    """
    domes = environment.without_discs
    # Two samples across every texel of the light, and at least four, in each direction.
    count = max(4, math.ceil(2.0 * math.pi / height / domes.detail))
    world_from = environment.panorama_from_world.T
    edges = np.cos(np.arange(height + 1) * np.pi / height)
    columns = np.arange(2 * height)
    result = np.zeros((height, 2 * height, CHANNEL_COUNT))

    def rows(begin: int, end: int) -> None:
        for row in range(begin, end):
            shift_u, shift_v = pixel_shifts(np.full_like(columns, row), columns)
            turns = (columns + (np.arange(count)[:, None] + shift_u) / count) / (2 * height)
            for a in range(count):
                # Evenly in the sine of elevation, and so in solid angle.
                sine = edges[row] + (edges[row + 1] - edges[row]) * (a + shift_v) / count
                directions = latlong_directions(
                    turns, np.arccos(np.broadcast_to(sine, turns.shape))
                )
                seen = domes.look(np.moveaxis(directions, -1, 0), world_from)
                result[row] += seen.sum(axis=0)

    workers.run(height, 8, rows, advance)
    result /= count**2
    for disc in environment.discs:
        _add_disc(disc, result, environment.panorama_from_world)
    return result


def _add_disc(disc: LightDisc, picture: FloatArray, panorama_from_world: FloatArray) -> None:
    """Add a disc to a latlong picture, every bit of its flux."""
    height, width = picture.shape[:2]
    sizes = texel_solid_angles(height, width)
    count = int(np.clip(256.0 * disc.solid_angle / sizes.max(), 4096, 2**22))
    index = np.arange(count) + 0.5
    # A spiral in equal steps of solid angle, a golden angle apart.
    cosine = 1.0 - index / count * 2.0 * math.sin(0.5 * disc.half_angle) ** 2
    sine, turn = np.sqrt(1.0 - cosine**2), index * math.pi * (3.0 - math.sqrt(5.0))
    middle = panorama_from_world @ disc.direction
    across = np.cross(middle, np.eye(3)[np.argmin(np.abs(middle))])
    across /= np.linalg.norm(across)
    frame = np.stack([across, np.cross(middle, across), middle])
    u, v = latlong_coordinates(
        np.stack([sine * np.cos(turn), sine * np.sin(turn), cosine], axis=-1) @ frame
    )
    rows = np.minimum((v * height).astype(np.int64), height - 1)
    columns = (u * width).astype(np.int64) % width
    hits = np.bincount(rows * width + columns, minlength=height * width).reshape(height, width)
    covered = hits * (disc.solid_angle / count) / sizes[:, None]
    picture += covered[..., None] * disc.values


def pixel_shifts(
    rows: NDArray[np.int64], columns: NDArray[np.int64]
) -> tuple[FloatArray, FloatArray]:
    """Return a shift in x and one in y for the sample grid of every pixel [1].

    Pixels whose samples all lie alike would miss the same part of a lamp's straight edge; these
    shifts fill 0..1 evenly along rows, columns and diagonals (the generalised golden ratio of
    Roberts, "The unreasonable effectiveness of quasirandom sequences", 2018).
    """
    first, second = 0.7548776662466927, 0.5698402909980532
    return (first * columns + second * rows) % 1.0, (second * columns + first * rows + 0.5) % 1.0
