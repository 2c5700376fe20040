"""Dome lights as latlong maps of coefficients times a basis of spectra."""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from pxr import Usd, UsdGeom, UsdLux

from usdskin.colorimetry import linear_color_space, linearize
from usdskin.errors import ImageError, LayerError
from usdskin.images import read_headers, read_image, read_spectral
from usdskin.layers import describe
from usdskin.render.light_files import asset_file, map_color_space
from usdskin.render.light_inputs import (
    Context,
    LightPrim,
    check_brightness,
    constant_spectrum,
    light_input,
    rgb_spectra,
)
from usdskin.render.texels import factorize, mend_low_rank, mend_values
from usdskin.spectrum import SpectralQuantity, band_widths, resample
from usdskin.uplift import deepest_dip

_UNIFORM = (2, 4)  # rows and columns of a dome without a map
_ASPECT_TOLERANCE = 0.01  # a map of odd height is still a latlong one
_SCALE_TOLERANCE = 1e-4
_CHUNK_ROWS = 16

# DomeLight_1 with its pole along +Z: the map's +Y points to +Z and its +Z to -Y.
_POLE_Z = np.array([[1.0, 0.0, 0.0], [0.0, 0.0, -1.0], [0.0, 1.0, 0.0]])


@dataclass(frozen=True, slots=True, eq=False)
class DomeLight:
    """Light from all around, constant over every texel of a latlong map.

    In the light's own frame u = 0.5 (the middle column) points to +Z, u = 0.25 to +X and v = 0
    (the top row) to +Y; centres of texels are at (i + 0.5) / N.
    """

    path: str
    """Prim path."""

    coefficients: NDArray[np.float32]
    """Weights of the basis, brightness included, shape [height, width, rank]."""

    basis: NDArray[np.float64]
    """Spectra [W m^-2 sr^-1 nm^-1, or relative], shape [rank, band_count], such that the radiance
    of a texel is ``coefficients @ basis``."""

    to_world: NDArray[np.float64]
    """Rotation from the light's frame to the world, column vectors, determinant 1, shape [3, 3]."""

    absolute: bool
    """Whether radiance is in W m^-2 sr^-1 nm^-1."""

    is_mirrored: bool = False
    """Whether the prim's transform mirrors, and ``coefficients`` therefore are (u to 1 - u)."""


def read_dome(light: LightPrim, to_world: NDArray[np.float64], context: Context) -> DomeLight:
    """Read a dome light.

    Args:
        light: The prim and what every light has.
        to_world: Its local-to-world transform, column vectors, shape [4, 4].
        context: How lights are read.

    Raises:
        LayerError: An opinion cannot be used.
        ImageError: The map is missing, broken, of the wrong kind, or holds pixels that are no
            light and are not to be clamped.
    """
    rotation, is_mirrored = _rotation(light.prim, to_world, context)
    source = "rgb" if light.shows_rgb else light.spectral.source
    if source == "rgb":
        coefficients, basis = _read_rgb(light, context)
    elif source == "basis":
        coefficients, basis = _read_basis(light, context)
    elif source == "bands":
        coefficients, basis = _read_bands(light, context)
    else:
        emission = light.spectral.emission
        if source == "tabulated" and emission is not None:
            _refuse_irradiance(light, emission.quantity)
        basis = constant_spectrum(light, context)[None]
        coefficients = np.ones((*_UNIFORM, 1), dtype=np.float32)
    peak = float(np.abs(coefficients).max(initial=0.0)) * light.scale
    check_brightness(light, peak * max(float(np.abs(basis).max(initial=0.0)), 1.0))
    if light.scale != 1.0:
        coefficients = coefficients * np.float32(light.scale)
    if is_mirrored:
        coefficients = coefficients[:, ::-1]
    return DomeLight(
        path=light.path,
        coefficients=np.ascontiguousarray(coefficients, dtype=np.float32),
        basis=basis,
        to_world=rotation,
        absolute=light.is_absolute,
        is_mirrored=is_mirrored,
    )


def turn_dome(
    dome: DomeLight, prim: Usd.Prim, to_world: NDArray[np.float64], context: Context
) -> DomeLight | None:
    """Return a dome whose transform alone has changed, with the arrays it had.

    Args:
        dome: The light as it was read.
        prim: Its prim.
        to_world: Its local-to-world transform now, column vectors, shape [4, 4].
        context: How lights are read.

    Returns:
        The dome; None where its map is mirrored now and was not, or the other way around.

    Raises:
        LayerError: The transform cannot be used.
    """
    rotation, is_mirrored = _rotation(prim, to_world, context)
    return replace(dome, to_world=rotation) if is_mirrored == dome.is_mirrored else None


def _refuse_irradiance(light: LightPrim, quantity: SpectralQuantity) -> None:
    if quantity is SpectralQuantity.IRRADIANCE:
        raise LayerError(
            f"{describe(light.prim)}: spectrum:emission:quantity is irradiance, which a dome has "
            "not; give its radiance"
        )


def _rotation(
    prim: Usd.Prim, to_world: NDArray[np.float64], context: Context
) -> tuple[NDArray[np.float64], bool]:
    """Return the rotation from map to world, and whether the map is mirrored (u to 1 - u).

    It is the orthogonal factor of the transform's polar decomposition: scale and shear do not
    touch a light at infinity. A mirroring transform is a rotation of the map mirrored in x.
    """
    linear = to_world[:3, :3]
    sizes = np.linalg.svd(linear, compute_uv=False) if np.isfinite(linear).all() else np.zeros(3)
    if not sizes.min() > 1e-9 * max(sizes.max(), 1e-30):
        raise LayerError(
            f"{describe(prim)}: its transform flattens or is not finite, so the dome has no "
            "orientation; mend its xformOps"
        )
    if sizes.max() > sizes.min() * (1.0 + _SCALE_TOLERANCE):
        context.note(
            "dome-scale-ignored", prim, "uneven scale or shear in its transform; only it is turned"
        )
    left, _, right = np.linalg.svd(linear)
    orthogonal = left @ right
    is_mirrored = bool(np.linalg.det(orthogonal) < 0.0)
    rotation = orthogonal @ _pole(prim)
    if is_mirrored:
        rotation = rotation @ np.diag([-1.0, 1.0, 1.0])
    return np.asarray(rotation, dtype=np.float64), is_mirrored


def _pole(prim: Usd.Prim) -> NDArray[np.float64]:
    """Return how a dome stands before its transform: ``DomeLight`` with its pole along +Y."""
    if not prim.IsA(UsdLux.DomeLight_1):
        return np.eye(3)
    axis = str(UsdLux.DomeLight_1(prim).GetPoleAxisAttr().Get())
    if axis not in ("scene", "Y", "Z"):
        raise LayerError(f"{describe(prim)}: poleAxis is {axis!r}; use scene, Y or Z")
    if axis == "scene":
        axis = str(UsdGeom.GetStageUpAxis(prim.GetStage()))
    return _POLE_Z if axis == "Z" else np.eye(3)


# --- Maps --------------------------------------------------------------------------------------


def _read_rgb(
    light: LightPrim, context: Context
) -> tuple[NDArray[np.float32], NDArray[np.float64]]:
    """Return an RGB map's pixels and the spectra of its primaries; white without a map."""
    attribute, _ = light_input(light.prim, "texture:file", context)
    path = asset_file(attribute, context.time)
    if path is None:
        spectra = rgb_spectra(light, "lin_rec709_scene", context)
        white = spectra.sum(axis=0)
        _note_dips(light, np.ones((1, 1, 1), np.float32), white[None], context)
        return np.ones((*_UNIFORM, 1), dtype=np.float32), white[None]
    where = f"{path} ({describe(attribute)})"
    try:
        names = read_headers(path)[0].channel_names
        chosen = rgb_channels(where, names)
        image = read_image(path, channels=chosen)
    except ImageError as error:
        raise placed(error, path, where) from None
    pixels = image.pixels
    if pixels.shape[:2] == (1, 1):  # one color all around, in whatever layout
        pixels = np.tile(pixels, (*_UNIFORM, 1))
    token = str(light_input(light.prim, "texture:format", context)[1] or "automatic")
    fault = layout_fault(token, pixels.shape, image.attributes)
    if fault is not None:
        raise ImageError(f"{where}: {fault}")
    if pixels.shape[2] == 1:
        pixels = np.repeat(pixels, 3, axis=2)
    pixels = mend_values(pixels, context.bad_pixels, where, light.path, context.notes)
    space = map_color_space(attribute, image.color_space, image.sample_type)
    pixels = linearize(pixels, space)
    spectra = rgb_spectra(light, linear_color_space(space), context)
    _note_dips(light, pixels, spectra, context)
    return pixels, spectra


def placed(error: ImageError, path: Path, where: str) -> ImageError:
    """Return an image's error with the layer and prim that asked for the image."""
    text = str(error)
    return ImageError(text if where in text else text.replace(str(path), where, 1))


def rgb_channels(where: str, names: tuple[str, ...]) -> tuple[str, ...]:
    """Return the channels of an RGB or grey picture; ``where`` is what errors call it."""
    if {"R", "G", "B"} <= set(names):
        return ("R", "G", "B")
    grey = [name for name in names if name != "A"]
    if len(grey) == 1:
        return (grey[0],)
    raise ImageError(
        f"{where}: no channels R, G, B; it has {', '.join(names[:8])}; give an RGB picture, or "
        "name the file in inputs:spectral:bands:file or :coefficients:file"
    )


def layout_fault(token: str, shape: tuple[int, ...], attributes: dict[str, Any]) -> str | None:
    """Return why an RGB map is not, or not known to be, a latlong one; None where it is.

    Args:
        token: ``inputs:texture:format``.
        shape: Of the map, (height, width, ...).
        attributes: What its file says.
    """
    if token not in ("automatic", "latlong"):
        return f"inputs:texture:format is {token}, which cannot be read yet; convert it to latlong"
    height, width = shape[:2]
    said = str(attributes.get("textureformat", ""))  # OpenImageIO's name of EXR's envmap
    if token == "latlong" or said.startswith("LatLong"):
        return None
    if "Environment" in said:
        return f"a {said}, which cannot be read yet; convert it to latlong"
    if abs(width / height / 2.0 - 1.0) <= _ASPECT_TOLERANCE:
        return None
    return (
        f"{width} x {height} pixels are not twice as wide as high, so no latlong map; convert it, "
        "or author inputs:texture:format = latlong"
    )


def _note_dips(
    light: LightPrim,
    pixels: NDArray[np.float32],
    spectra: NDArray[np.float64],
    context: Context,
) -> None:
    """Note where the spectra of good RGB pixels fall below zero."""
    width = pixels.shape[1]
    depth, worst, count = deepest_dip(pixels.reshape(-1, pixels.shape[2]), spectra)
    if count:
        y, x = divmod(worst, width)
        context.note(
            "uplift-negative",
            light.prim,
            f"the spectra of {count} of {pixels[..., 0].size} saturated pixels dip below zero, by "
            f"{-depth:.1%} of their peak at x {x}, y {y}; XYZ stays exact",
        )


def _read_basis(
    light: LightPrim, context: Context
) -> tuple[NDArray[np.float32], NDArray[np.float64]]:
    """Return the coefficient channels c0, c1, ... and the basis on the grid."""
    spectral = light.spectral
    path, basis, nm = spectral.coefficients_file, spectral.basis, spectral.basis_wavelength_nm
    if path is None or basis is None or nm is None:
        raise LayerError(
            f"{describe(light.prim)}: inputs:spectral:source is basis; author "
            "inputs:spectral:coefficients:file, :basis and :basis:wavelengths"
        )
    where = f"{path} ({describe(light.prim)})"
    rank = basis.shape[0]
    wanted = tuple(f"c{index}" for index in range(rank))
    try:
        header = read_headers(path)[0]
        held = [name for name in header.channel_names if _is_coefficient(name)]
        if set(held) != set(wanted):
            shown = ", ".join(sorted(held)) or ", ".join(header.channel_names[:8])
            raise ImageError(
                f"{where}: inputs:spectral:basis has {rank} rows and needs the channels "
                f"{wanted[0]} to {wanted[-1]}, but the file holds {shown}; make them agree"
            )
        image = read_image(path, channels=wanted)
    except ImageError as error:
        raise placed(error, path, where) from None
    on_grid = resample(nm, basis, context.wavelength_nm)
    if not on_grid.any():
        raise LayerError(
            f"{describe(light.prim)}: inputs:spectral:basis:wavelengths {nm[0]:g} to {nm[-1]:g} nm "
            "miss the rendered wavelengths; render others, or extend the basis"
        )
    energy = basis @ _shares(nm)
    return mend_low_rank(
        image.pixels, on_grid, _shares(context.wavelength_nm), energy, context.bad_pixels,
        where, light.path, context.notes,
    )  # fmt: skip


def _shares(wavelength_nm: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return the share of each band of a grid in its whole width."""
    if len(wavelength_nm) < 2:
        return np.ones(1)
    widths_nm = band_widths(wavelength_nm)
    return np.asarray(widths_nm / widths_nm.sum())


def _is_coefficient(name: str) -> bool:
    return name[:1] == "c" and name[1:].isdigit()


def _read_bands(
    light: LightPrim, context: Context
) -> tuple[NDArray[np.float32], NDArray[np.float64]]:
    """Return a spectral map brought onto the grid and factorised at its numerical rank."""
    path = light.spectral.bands_file
    if path is None:
        raise LayerError(
            f"{describe(light.prim)}: inputs:spectral:source is bands; author "
            "inputs:spectral:bands:file"
        )
    where = f"{path} ({describe(light.prim)})"
    try:
        nm, pixels = read_spectral(path)
    except ImageError as error:
        raise placed(error, path, where) from None
    pixels = mend_values(pixels, context.bad_pixels, where, light.path, context.notes)
    grid = context.wavelength_nm
    if nm.shape != grid.shape or np.abs(nm - grid).max() > 1e-6:
        on_grid = np.empty((*pixels.shape[:2], grid.size), dtype=np.float32)
        for start in range(0, pixels.shape[0], _CHUNK_ROWS):
            rows = slice(start, start + _CHUNK_ROWS)
            on_grid[rows] = resample(nm, pixels[rows], grid)
        pixels = on_grid
    if not pixels.any():
        context.note("light-black", light.prim, f"{path} is black at the rendered wavelengths")
    coefficients, basis = factorize(pixels.reshape(-1, grid.size))
    return coefficients.reshape(*pixels.shape[:2], -1), basis
