"""Tristimulus values, chromatic adaptation, RGB spaces and colour differences.

Colour-science is imported inside the functions that measure results (CCT, colour difference),
since that takes seconds; what a render needs is computed here from the tables shipped with us.
"""

from __future__ import annotations

import difflib
from dataclasses import dataclass
from functools import cache
from typing import Any, Literal, get_args

import numpy as np
from numpy.typing import ArrayLike, NDArray

from usdskin.errors import UsdSkinError
from usdskin.illuminants import (
    TABLE_STEP_NM,
    daylight,
    illuminant,
    illuminant_names,
    planck_radiance,
    table,
)
from usdskin.spectrum import band_widths, resample

__all__ = [
    "DEFAULT_OBSERVER",
    "LUMINOUS_EFFICACY",
    "Observer",
    "adaptation",
    "cat16",
    "chromaticity_to_xyz",
    "color_matching_functions",
    "color_space_names",
    "correlated_color_temperature",
    "daylight",
    "decode_srgb",
    "delta_e_2000",
    "encode_srgb",
    "illuminant",
    "illuminant_names",
    "linear_color_space",
    "linearize",
    "planck_radiance",
    "rgb_to_xyz",
    "white_xyz",
    "xyz_to_lab",
    "xyz_to_rgb",
    "xyz_weights",
]

FloatArray = NDArray[np.float64]

Observer = Literal["cie1931_2", "cie1964_10", "cie2015_2"]
DEFAULT_OBSERVER: Observer = "cie1931_2"

LUMINOUS_EFFICACY = 683.002
"""Maximum luminous efficacy of photopic vision, K_m [lm W^-1] (BIPM, SI brochure appendix 2)."""


# --- Observers ---------------------------------------------------------------------------------


def color_matching_functions(
    wavelength_nm: ArrayLike, observer: Observer = DEFAULT_OBSERVER
) -> FloatArray:
    """Return an observer's colour-matching functions.

    Args:
        wavelength_nm: Band centres [nm], strictly ascending, shape [band_count].
        observer: Which CIE standard observer.

    Returns:
        x, y, z [1], shape [band_count, 3]: the value at the centre of bands up to 5 nm wide, the
        summation of CIE 015:2018; the average over wider ones; zero outside the tables.

    Raises:
        UsdSkinError: An unknown observer.
    """
    if observer not in get_args(Observer):
        raise UsdSkinError(
            f"unknown observer {observer!r}; choose one of {', '.join(get_args(Observer))}"
        )
    centers = np.asarray(wavelength_nm, dtype=np.float64)
    wide = band_widths(centers) > TABLE_STEP_NM + 1e-9
    columns = table(observer)
    result = np.empty((centers.size, 3))
    for index, name in enumerate("xyz"):
        nm, value = columns[name]
        result[:, index] = np.interp(centers, nm, value, left=0.0, right=0.0)
        if wide.any():
            result[wide, index] = resample(nm, value, centers)[wide]
    return result


def xyz_weights(
    wavelength_nm: ArrayLike,
    observer: Observer = DEFAULT_OBSERVER,
    absolute: bool = False,
) -> FloatArray:
    """Return the weights that turn a spectrum into tristimulus values.

    Args:
        wavelength_nm: Band centres [nm], strictly ascending, shape [band_count].
        observer: Which CIE standard observer.
        absolute: Whether radiance is in W m^-2 sr^-1 nm^-1. Then the weights hold K_m and Y is
            luminance [cd m^-2]; else Y = 1 for D65 scaled to 1 at 560 nm.

    Returns:
        Weights [nm, or lm nm W^-1], shape [band_count, 3], such that ``XYZ = spectrum @ weights``.
    """
    cmf = color_matching_functions(wavelength_nm, observer)
    weights: FloatArray = cmf * band_widths(wavelength_nm)[:, None]
    if absolute:
        return LUMINOUS_EFFICACY * weights
    d65 = resample(*table("illuminants")["D65"], wavelength_nm) / 100.0  # its value at 560 nm
    luminance = float(d65 @ weights[:, 1])
    if luminance <= 0.0:
        raise UsdSkinError("the wavelength grid holds no visible light; cover some of 400..700 nm")
    normalized: FloatArray = weights / luminance
    return normalized


# --- Chromatic adaptation ----------------------------------------------------------------------

# Li et al., Comprehensive color solutions: CAM16, CAT16 and CAM16-UCS, Color Res Appl 42 (2017).
_CAT16 = np.array(
    [
        [0.401288, 0.650173, -0.051461],
        [-0.250268, 1.204414, 0.045854],
        [-0.002079, 0.048952, 0.953127],
    ]
)
# Lam 1985, as in Fairchild, Color Appearance Models; what USD adapts the ACES primaries with.
_BRADFORD = np.array(
    [
        [0.8951, 0.2664, -0.1614],
        [-0.7502, 1.7135, 0.0367],
        [0.0389, -0.0685, 1.0296],
    ]
)


def adaptation(source_xyz: ArrayLike, target_xyz: ArrayLike, sharpening: ArrayLike) -> FloatArray:
    """Return the von Kries transform between two whites in a sharpened cone space.

    Args:
        source_xyz: White adapted from, shape [3].
        target_xyz: White adapted to, shape [3].
        sharpening: Matrix from XYZ to the cone space, shape [3, 3].

    Returns:
        Matrix such that ``target = matrix @ source``, shape [3, 3].

    Raises:
        UsdSkinError: A white that is black, or so saturated that a cone does not respond.
    """
    cone = np.asarray(sharpening, dtype=np.float64)
    whites = [np.asarray(white, dtype=np.float64) for white in (source_xyz, target_xyz)]
    source, target = (cone @ white for white in whites)
    if not (np.all(source > 0.0) and np.all(target > 0.0)):
        raise UsdSkinError(
            f"cannot adapt from white XYZ {whites[0]} to {whites[1]}: "
            "one of them is black or too saturated to be a white"
        )
    matrix = np.linalg.solve(cone, (target / source)[:, None] * cone)
    return np.asarray(matrix, dtype=np.float64)


def cat16(source_xyz: ArrayLike, target_xyz: ArrayLike) -> FloatArray:
    """Return the CAT16 chromatic adaptation between two whites, complete adaptation.

    Args:
        source_xyz: White adapted from, shape [3].
        target_xyz: White adapted to, shape [3].

    Returns:
        Matrix such that ``target = matrix @ source``, shape [3, 3].
    """
    return adaptation(source_xyz, target_xyz, _CAT16)


# --- RGB spaces --------------------------------------------------------------------------------

_D65 = (0.3127, 0.3290)
_ACES_WHITE = (0.32168, 0.33767)


@dataclass(frozen=True, slots=True)
class _Primaries:
    red: tuple[float, float]
    green: tuple[float, float]
    blue: tuple[float, float]
    white: tuple[float, float] = _D65


_PRIMARIES = {
    "rec709": _Primaries((0.64, 0.33), (0.30, 0.60), (0.15, 0.06)),
    "rec2020": _Primaries((0.708, 0.292), (0.170, 0.797), (0.131, 0.046)),
    "p3d65": _Primaries((0.680, 0.320), (0.265, 0.690), (0.150, 0.060)),
    "adobergb": _Primaries((0.64, 0.33), (0.21, 0.71), (0.15, 0.06)),
    "ap0": _Primaries((0.7347, 0.2653), (0.0, 1.0), (0.0001, -0.0770), _ACES_WHITE),
    "ap1": _Primaries((0.713, 0.293), (0.165, 0.830), (0.128, 0.044), _ACES_WHITE),
}
_ENCODED: dict[str, tuple[str, str | float]] = {
    "srgb_rec709_scene": ("rec709", "srgb"),
    "srgb_p3d65_scene": ("p3d65", "srgb"),
    "srgb_ap1_scene": ("ap1", "srgb"),
    "g18_rec709_scene": ("rec709", 1.8),
    "g22_rec709_scene": ("rec709", 2.2),
    "g24_rec709_scene": ("rec709", 2.4),
    "g22_adobergb_scene": ("adobergb", 563.0 / 256.0),
    "g22_ap1_scene": ("ap1", 2.2),
    "srgb_rec709_display": ("rec709", "srgb"),  # Blender's name
}
_SPACES: dict[str, tuple[str, str | float]] = {
    **{f"lin_{name}_scene": (name, "linear") for name in _PRIMARIES},
    "lin_ciexyzd65_scene": ("ciexyzd65", "linear"),
    **_ENCODED,
}


def color_space_names() -> tuple[str, ...]:
    """Return USD's names of the RGB spaces that can be read."""
    return tuple(_SPACES)


def _space(color_space: str) -> tuple[str, str | float]:
    if color_space in _SPACES:
        return _SPACES[color_space]
    close = difflib.get_close_matches(color_space, _SPACES, n=1)
    hint = f"did you mean {close[0]}?" if close else f"choose one of {', '.join(_SPACES)}"
    raise UsdSkinError(f"unknown color space {color_space!r}; {hint}")


def linear_color_space(color_space: str) -> str:
    """Return the name of the linear space with the same primaries."""
    return f"lin_{_space(color_space)[0]}_scene"


def white_xyz(color_space: str) -> FloatArray:
    """Return the white of an RGB space, Y = 1, shape [3]: D65 for every space that USD names."""
    _space(color_space)
    return chromaticity_to_xyz(_D65)


def chromaticity_to_xyz(xy: tuple[float, float]) -> FloatArray:
    """Return the XYZ of a chromaticity at Y = 1, shape [3]."""
    return np.array([xy[0] / xy[1], 1.0, (1.0 - xy[0] - xy[1]) / xy[1]])


def rgb_to_xyz(color_space: str) -> FloatArray:
    """Return the matrix from linear RGB to XYZ relative to D65.

    USD (``GfColorSpace``) defines every space it names against D65; the ACES primaries are
    adapted from their own white by Bradford's transform. So RGB (1, 1, 1) is D65 in all of them.

    Args:
        color_space: USD's name, such as ``lin_rec709_scene`` or ``lin_ap1_scene``; an encoded
            space gives the matrix of its linear values (see ``linearize``).

    Returns:
        Matrix such that ``XYZ = matrix @ rgb``, shape [3, 3].

    Raises:
        UsdSkinError: An unknown color space.
    """
    return _rgb_to_xyz(_space(color_space)[0]).copy()


@cache
def _rgb_to_xyz(primaries: str) -> FloatArray:
    if primaries == "ciexyzd65":
        return np.eye(3)
    space = _PRIMARIES[primaries]
    columns = np.column_stack(
        [chromaticity_to_xyz(xy) * xy[1] for xy in (space.red, space.green, space.blue)]
    )
    white = chromaticity_to_xyz(space.white)
    matrix: FloatArray = columns * np.linalg.solve(columns, white)
    if space.white != _D65:
        matrix = adaptation(white, chromaticity_to_xyz(_D65), _BRADFORD) @ matrix
    return matrix


def xyz_to_rgb(color_space: str) -> FloatArray:
    """Return the inverse of ``rgb_to_xyz``, shape [3, 3]."""
    return np.asarray(np.linalg.inv(rgb_to_xyz(color_space)), dtype=np.float64)


def linearize(values: ArrayLike, color_space: str) -> NDArray[Any]:
    """Return the linear values of an encoded RGB space, in the type they came in.

    Args:
        values: Encoded values, any shape.
        color_space: USD's name of the space they are encoded in.

    Returns:
        Linear values, the same shape; negative ones are mirrored through zero.
    """
    encoded = _floating(values)
    transfer = _space(color_space)[1]
    if transfer == "linear":
        return encoded
    if transfer == "srgb":
        return decode_srgb(encoded)
    power: NDArray[Any] = np.sign(encoded) * np.abs(encoded) ** encoded.dtype.type(transfer)
    return power


def _floating(values: ArrayLike) -> NDArray[Any]:
    array = np.asarray(values)
    return array if np.issubdtype(array.dtype, np.floating) else array.astype(np.float64)


def decode_srgb(encoded: ArrayLike) -> NDArray[Any]:
    """Return the linear values of sRGB-encoded ones (IEC 61966-2-1), mirrored through zero."""
    value = _floating(encoded)
    size = np.abs(value)
    linear = np.where(size <= 0.04045, size / 12.92, ((size + 0.055) / 1.055) ** 2.4)
    result: NDArray[Any] = np.copysign(linear, value).astype(value.dtype, copy=False)
    return result


def encode_srgb(linear: ArrayLike) -> NDArray[Any]:
    """Return the sRGB encoding of linear values (IEC 61966-2-1), mirrored through zero."""
    value = _floating(linear)
    size = np.abs(value)
    encoded = np.where(size <= 0.0031308, size * 12.92, 1.055 * size ** (1.0 / 2.4) - 0.055)
    result: NDArray[Any] = np.copysign(encoded, value).astype(value.dtype, copy=False)
    return result


# --- Judging -----------------------------------------------------------------------------------


def xyz_to_lab(xyz: ArrayLike, white: ArrayLike) -> FloatArray:
    """Return CIE 1976 L*a*b* (CIE 015:2018).

    Args:
        xyz: Tristimulus values, shape [..., 3].
        white: Tristimulus values of the white they are seen against, shape [3].

    Returns:
        L*, a*, b*, shape [..., 3].
    """
    ratio = np.asarray(xyz, dtype=np.float64) / np.asarray(white, dtype=np.float64)
    knee = 6.0 / 29.0
    response = np.where(ratio > knee**3, np.cbrt(ratio), ratio / (3.0 * knee**2) + 4.0 / 29.0)
    x, y, z = np.moveaxis(response, -1, 0)
    return np.stack([116.0 * y - 16.0, 500.0 * (x - y), 200.0 * (y - z)], axis=-1)


def delta_e_2000(lab: ArrayLike, reference_lab: ArrayLike) -> FloatArray:
    """Return the CIEDE2000 colour difference, by colour-science.

    Args:
        lab: L*, a*, b*, shape [..., 3].
        reference_lab: L*, a*, b* compared with, broadcastable to the same shape.

    Returns:
        Differences [1], shape [...].
    """
    from colour.difference import delta_E_CIE2000

    return np.asarray(delta_E_CIE2000(lab, reference_lab), dtype=np.float64)


def correlated_color_temperature(xyz: ArrayLike) -> tuple[float, float]:
    """Return correlated colour temperature [K] and Duv (Ohno 2013), by colour-science.

    Args:
        xyz: Tristimulus values of the CIE 1931 observer, shape [3].
    """
    from colour.models import UCS_to_uv, XYZ_to_UCS
    from colour.temperature import uv_to_CCT_Ohno2013

    uv = UCS_to_uv(XYZ_to_UCS(np.asarray(xyz, dtype=np.float64)))
    temperature, distance = uv_to_CCT_Ohno2013(uv)
    return float(temperature), float(distance)
