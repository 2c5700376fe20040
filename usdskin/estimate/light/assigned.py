"""Assign a lamp to an ordinary environment map, and say so.

Reads:  a latlong picture in RGB, and the spectrum of a lamp.
Writes: ``light.usda``, a DomeLight with ``SpectralLightAPI``, and its pictures beside it.

Three numbers do not tell a spectrum: what comes out has the map's colors, seen by an eye adapted
to the lamp, and spectra that surfaces of those colors would have in that lamp's light. It is an
assumption, which the layer states.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from usdskin.colorimetry import cat16, rgb_to_xyz, white_xyz
from usdskin.errors import UsageError, UsdSkinError
from usdskin.estimate.light.environment import BadPixels, Environment, read_environment
from usdskin.estimate.light.layer import Background
from usdskin.estimate.light.light_map import LightMap, rows_per_block
from usdskin.estimate.light.maps import Form, map_files
from usdskin.estimate.light.publish import Clock, LightResult, publish_light
from usdskin.estimate.light.totals import Readings, add_up, check_totals
from usdskin.illuminants import illuminant
from usdskin.layers import check_output
from usdskin.meters import flux
from usdskin.notes import Note
from usdskin.progress import Progress, SilentProgress
from usdskin.spectrafiles import single_spectrum
from usdskin.spectrum import DEFAULT_WAVELENGTHS_NM, resample
from usdskin.uplift import light_basis

FloatArray = NDArray[np.float64]
FloatImage = NDArray[np.float32]


@dataclass(frozen=True, slots=True, eq=False)
class AssignOptions:
    """What the step is told."""

    illuminant: str = "D65"
    """Name of a lamp, such as ``FL2``, ``A``, ``D55`` or ``3200K``, or a file with its spectrum."""

    white: tuple[float, float, float] | Literal["mean"] | None = None
    """RGB of the map that is the lamp's own light; ``mean``: the mean of the map, by solid angle;
    None: (1, 1, 1)."""

    color_space: str | None = None
    """USD's name of the map's color space; None: what the file says."""

    bad_pixels: BadPixels = "error"
    """Whether pixels that are no light are refused or clamped."""

    form: Form = "basis"
    """``basis``, or ``bands`` for a map with all spectra written out."""

    up_axis: Literal["Y", "Z"] = "Y"
    """Of the layer."""

    wavelength_nm: FloatArray | None = None
    """Band centres [nm], shape [band_count]; None: the default grid."""


def assign_light(
    environment: str | Path,
    output: str | Path,
    options: AssignOptions | None = None,
    progress: Progress | None = None,
) -> LightResult:
    """Write the spectral light that a map would be if a lamp lit all it shows.

    Args:
        environment: Latlong picture, such as an HDRI. It is read, never changed.
        output: Layer to write; its pictures are written beside it.
        options: What is asked for.
        progress: Told how far the work is.

    Returns:
        The files, complete on disk, the report and the notes.

    Raises:
        ImageError: The map cannot be read, or a picture not written.
        UsageError: The white is none, or an output is an input.
        UsdSkinError: The lamp cannot be used.
        LayerError: The layer cannot be written.
    """
    options = options or AssignOptions()
    progress = progress or SilentProgress()
    environment, output = Path(environment), Path(output)
    clock, notes = Clock(), list[Note]()
    lamp_file = Path(options.illuminant) if Path(options.illuminant).is_file() else None
    inputs = [environment, *([lamp_file] if lamp_file is not None else [])]
    files = map_files(output, options.form, is_mixed=False)
    check_output(output, inputs, files.paths(), step="estimate")
    grid = DEFAULT_WAVELENGTHS_NM if options.wavelength_nm is None else options.wavelength_nm
    lamp = _lamp(options.illuminant, lamp_file, grid, notes)
    name = options.illuminant if lamp_file is None else lamp_file.name
    with clock("read"):
        read = read_environment(environment, options.color_space, options.bad_pixels, notes)
    white = _white(read, options.white)
    light = assigned_map(read, lamp, grid, white)
    with clock("measure"):
        totals = add_up(light, Readings(), progress)
    check_totals(totals, light, str(environment), notes)
    shown = "1, 1, 1" if white is None else ", ".join(f"{value:.4g}" for value in white)
    background = Background(
        origin="assigned",
        documentation=(
            f"Assigned, not measured: the colors of {environment.name} as if the lamp {name} lit "
            f"all it shows, its own light being RGB {shown}."
        ),
        inputs=inputs,
        settings=_settings(options, name, white),
        up_axis=options.up_axis,
        illuminant=name,
    )
    paths, report = publish_light(
        light, totals, background, options.form, files, output, progress, clock
    )
    return LightResult(paths, report, notes, clock.seconds)


def assigned_map(
    environment: Environment, lamp: FloatArray, wavelength_nm: FloatArray, white: FloatArray | None
) -> LightMap:
    """Return the light of a map under a lamp: coefficients are its linear RGB.

    The basis is ``uplift.light_basis``: RGB (1, 1, 1) is the lamp. With another white w, RGB is
    first adapted from w to the color space's own white W by CAT16, ``A^-1 CAT(w -> W) A``, which
    leaves the luminance of w as it is; adaptations in one cone space follow on one another, so
    this is the adaptation from w to the lamp.

    Args:
        environment: The map.
        lamp: Its power in any scale, shape [band_count].
        wavelength_nm: Band centres [nm], shape [band_count].
        white: RGB of the lamp's own light, shape [3]; None: (1, 1, 1).

    Raises:
        UsdSkinError: The lamp has no luminance or is too narrow, or the white is no white.
    """
    space = environment.color_space
    basis = light_basis(lamp, wavelength_nm, space)
    if white is not None:
        to_xyz = rgb_to_xyz(space)
        white_of_map = to_xyz @ white
        balance = cat16(white_of_map / white_of_map[1], white_xyz(space))
        basis = np.linalg.solve(to_xyz, balance @ to_xyz).T @ basis
    pixels = environment.pixels
    height, width = pixels.shape[:2]

    def blocks() -> Iterable[tuple[int, FloatImage]]:
        count = rows_per_block(width)
        for begin in range(0, height, count):
            yield begin, pixels[begin : begin + count]

    return LightMap(height, width, basis, wavelength_nm, False, ("assigned",), blocks)


def _lamp(name: str, file: Path | None, grid: FloatArray, notes: list[Note]) -> FloatArray:
    if file is None:
        try:
            return illuminant(name, grid)
        except UsdSkinError as error:
            raise UsageError(f"--illuminant {name}: {error}") from None
    lamp = resample(*single_spectrum(file, notes), grid)
    if not lamp.any():
        raise UsdSkinError(
            f"{file}: has no power from {grid[0]:g} to {grid[-1]:g} nm; give a lamp that shines "
            "there"
        )
    return lamp


def _white(
    environment: Environment, white: tuple[float, float, float] | Literal["mean"] | None
) -> FloatArray | None:
    if white is None:
        return None
    is_mean = isinstance(white, str)
    rgb = flux(environment.pixels) / (4.0 * np.pi) if is_mean else np.array(white, np.float64)
    shown = ",".join(f"{value:g}" for value in rgb)
    luminance = float(rgb_to_xyz(environment.color_space)[1] @ rgb)
    if rgb.shape != (3,) or not np.isfinite(rgb).all() or not luminance > 0.0 or rgb.min() < 0.0:
        raise UsageError(
            f"--white {'mean' if is_mean else shown}: the RGB {shown} is no white; give three "
            "numbers above 0"
        )
    return rgb


def _settings(options: AssignOptions, name: str, white: FloatArray | None) -> dict[str, Any]:
    given: dict[str, Any] = {
        "illuminant": name,
        "white": None if white is None else [float(value) for value in white],
        "colorSpace": options.color_space,
        "badPixels": options.bad_pixels,
        "as": options.form,
    }
    return {key: value for key, value in given.items() if value is not None}
