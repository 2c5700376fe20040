"""Skin's reflectance from camera values or from an RGB colour, by the skin prior."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from usdskin.colorimetry import (
    DEFAULT_OBSERVER,
    Observer,
    cat16,
    illuminant,
    rgb_to_xyz,
    white_xyz,
    xyz_weights,
)
from usdskin.errors import LayerError
from usdskin.estimate.skin.prior import (
    LARGEST_UNLIKENESS,
    SkinMap,
    SkinPrior,
    shipped_prior,
    skin_map,
)
from usdskin.notes import Note
from usdskin.spectrum import DEFAULT_WAVELENGTHS_NM

FloatArray = NDArray[np.float64]

_DEEPEST_DIP = 1e-3


@dataclass(frozen=True, slots=True, eq=False)
class RecoveredSkin:
    """Reflectances of skin, and how sure they are."""

    wavelength_nm: FloatArray
    """Band centres [nm], shape [n]."""

    reflectance: FloatArray
    """S, the likeliest diffuse reflectance [1], shape [k, n]."""

    stddev: FloatArray
    """Standard deviation of its error [1], shape [k, n]."""

    unlikeness: FloatArray
    """How far each colour is from skin, in standard deviations [1], shape [k]."""


def skin_from_camera(
    values: ArrayLike,
    responsivity: ArrayLike,
    light: ArrayLike,
    noise: ArrayLike = 0.0,
    *,
    wavelength_nm: ArrayLike = DEFAULT_WAVELENGTHS_NM,
    prior: SkinPrior | None = None,
    where: str = "readings",
    names: Sequence[str] = (),
    notes: list[Note] | None = None,
) -> RecoveredSkin:
    """Return the reflectance of skin that a calibrated camera saw in a known light.

    Args:
        values: Camera values of the diffuse reflection over those of the perfect diffuser in the
            same place, channel by channel [1], shape [k, 3]; for rho as read divide by that of the
            diffuser, or by ``light @ responsivity`` in its units.
        responsivity: t, camera value per radiance in any scale, shape [n, 3].
        light: E, the light's spectrum in any scale, shape [n].
        noise: Standard deviation of a value over the value [1], shape [] or [3]; with 0 the
            values are met exactly.
        wavelength_nm: Band centres [nm] of all three and of the result, shape [n].
        prior: What skin may be; the shipped one by default.
        where: ``layer.usda </Prim/path>``, for errors and notes.
        names: Names of the readings, shape [k]; empty: numbered.
        notes: Takes a note on every reading whose colour is unlike skin.

    Raises:
        LayerError: A value is not a number above zero, the camera and the light do not show three
            colours, or a reading is so unlike skin that its reflectance would be below zero.
    """
    grid = np.asarray(wavelength_nm, dtype=np.float64)
    seen = np.asarray(light, dtype=np.float64)[:, None] * np.asarray(responsivity, dtype=np.float64)
    white = seen.sum(axis=0)
    if not (np.isfinite(seen).all() and (white > 0.0).all() and _is_regular(seen / white)):
        raise LayerError(
            f"{where}: this camera in this light does not tell three colors apart; use a broader "
            "light, or another calibration"
        )
    believed = shipped_prior(grid) if prior is None else prior.on(grid)
    mapped = skin_map(believed, seen / white, noise)
    return _recovered(np.atleast_2d(np.asarray(values, np.float64)), mapped, where, names, notes)


def skin_from_rgb(
    rgb: ArrayLike,
    color_space: str = "lin_rec709_scene",
    noise: ArrayLike = 0.0,
    *,
    wavelength_nm: ArrayLike = DEFAULT_WAVELENGTHS_NM,
    observer: Observer = DEFAULT_OBSERVER,
    prior: SkinPrior | None = None,
    where: str = "readings",
    names: Sequence[str] = (),
    notes: list[Note] | None = None,
) -> RecoveredSkin:
    """Return the reflectance of skin that has an albedo's colour under D65.

    Args:
        rgb: Linear values of the diffuse albedo, shape [k, 3].
        color_space: USD's name of their linear space; the white of all of them is D65.
        noise: Standard deviation of a value over the value [1], shape [] or [3]; with 0 the
            colours are met exactly.
        wavelength_nm: Band centres [nm], shape [n].
        observer: Whose colour-matching functions the colour is meant for.
        prior: What skin may be; the shipped one by default.
        where: What to call the values in errors and notes.
        names: Names of the values, shape [k]; empty: numbered.
        notes: Takes a note on every colour that is unlike skin.

    Raises:
        LayerError: A value is not a number above zero, or a colour is so unlike skin that its
            reflectance would be below zero.
        UsdSkinError: An unknown colour space or observer.
    """
    grid = np.asarray(wavelength_nm, dtype=np.float64)
    believed = shipped_prior(grid) if prior is None else prior.on(grid)
    mapped = skin_map(believed, rgb_weights(grid, color_space, observer), noise)
    return _recovered(np.atleast_2d(np.asarray(rgb, np.float64)), mapped, where, names, notes)


def rgb_weights(
    wavelength_nm: ArrayLike,
    color_space: str = "lin_rec709_scene",
    observer: Observer = DEFAULT_OBSERVER,
) -> FloatArray:
    """Return what turns a reflectance into the RGB of its colour under D65.

    Args:
        wavelength_nm: Band centres [nm], strictly ascending, shape [n].
        color_space: USD's name of a linear RGB space.
        observer: Whose colour-matching functions.

    Returns:
        Weights such that ``rgb = reflectance @ weights``, (1, 1, 1) for the perfect diffuser,
        shape [n, 3].
    """
    weights = illuminant("D65", wavelength_nm)[:, None] * xyz_weights(wavelength_nm, observer)
    white = weights.sum(axis=0)
    # The grid's own D65 is a little off the chromaticity that the space's white has by name.
    adapted = cat16(white_xyz(color_space), white / white[1]) @ rgb_to_xyz(color_space)
    return np.asarray(np.linalg.solve(adapted, (weights / white[1]).T).T)


def _is_regular(seen: FloatArray) -> bool:
    return bool(np.linalg.cond(seen) < 1e6)


def _recovered(
    values: FloatArray,
    mapped: SkinMap,
    where: str,
    names: Sequence[str],
    notes: list[Note] | None,
) -> RecoveredSkin:
    if values.ndim != 2 or values.shape[1] != 3:
        raise ValueError(f"camera values have shape {values.shape}, not [k, 3]")
    labels = list(names) or [f"reading [{index}]" for index in range(len(values))]
    bad = np.flatnonzero(~(np.isfinite(values) & (values > 0.0)).all(axis=1))
    if bad.size:
        raise LayerError(
            f"{where}: {labels[bad[0]]} has the values {_listed(values[bad[0]])}; they must be "
            "numbers above zero"
        )
    reflectance = mapped(values)
    unlikeness = mapped.unlikeness(values)
    dips = np.flatnonzero(reflectance.min(axis=1) < -_DEEPEST_DIP * reflectance.max(axis=1))
    if dips.size:
        raise LayerError(
            f"{where}: {labels[dips[0]]} has the values {_listed(values[dips[0]])} over those of "
            "white, which no skin has; check the white and the order of the channels, or mask it"
        )
    for index in np.flatnonzero(unlikeness > LARGEST_UNLIKENESS) if notes is not None else ():
        text = (
            f"{labels[index]} is {unlikeness[index]:.1f} standard deviations from the color of "
            "measured skin; its spectrum is a guess"
        )
        assert notes is not None
        notes.append(Note("unlike-skin", where, text))
    return RecoveredSkin(
        wavelength_nm=mapped.prior.wavelength_nm,
        reflectance=np.maximum(reflectance, 0.0),
        stddev=mapped.stddev(values),
        unlikeness=unlikeness,
    )


def _listed(values: FloatArray) -> str:
    return "(" + ", ".join(f"{value:.4g}" for value in values) + ")"
