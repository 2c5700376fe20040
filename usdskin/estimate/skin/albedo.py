"""From an RGB albedo texture to a texture of weights of skin spectra."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from usdskin.colorimetry import DEFAULT_OBSERVER, Observer, linear_color_space, linearize
from usdskin.errors import ImageError
from usdskin.estimate.skin.prior import SkinPrior, shipped_prior, skin_map
from usdskin.estimate.skin.recovered import rgb_weights
from usdskin.notes import Note
from usdskin.spectrum import DEFAULT_WAVELENGTHS_NM
from usdskin.uplift import deepest_dip

FloatArray = NDArray[np.float64]

DEEPEST_DIP = -0.01
"""Spectra that fall further below zero, as a share of their peak, are told [1]."""


@dataclass(frozen=True, slots=True, eq=False)
class AlbedoWeights:
    """S of a textured skin, ``weights @ basis``."""

    weights: NDArray[np.float32]
    """Weights of the basis, shape [h, w, 3]."""

    basis: FloatArray
    """Reflectances the weights multiply [1], nowhere below zero, shape [3, n]."""

    wavelength_nm: FloatArray
    """Band centres [nm], shape [n]."""


def weights_of_albedo(
    image: ArrayLike,
    color_space: str = "lin_rec709_scene",
    *,
    wavelength_nm: ArrayLike = DEFAULT_WAVELENGTHS_NM,
    observer: Observer = DEFAULT_OBSERVER,
    prior: SkinPrior | None = None,
    where: str = "albedo",
    notes: list[Note] | None = None,
) -> AlbedoWeights:
    """Return an albedo texture as weights of three reflectances of skin.

    Every texel has its colour under D65 exactly, and is the likeliest skin of that colour. Its
    spectrum is linear in its linear RGB, so filtering the weights is filtering the albedo, and a
    factorised renderer makes of them what it would make of the spectra.

    Args:
        image: The albedo, shape [h, w, 3].
        color_space: USD's name of the space it is encoded in, such as ``srgb_rec709_scene``.
        wavelength_nm: Band centres [nm] of the basis, shape [n].
        observer: Whose colour-matching functions the colour is meant for.
        prior: What skin may be; the shipped one by default.
        where: File of the texture, for errors and notes.
        notes: Takes a note where texels are no skin and their spectra fall below zero.

    Raises:
        ImageError: A texel is not finite, or there are not three channels.
        UsdSkinError: An unknown colour space or observer.
    """
    pixels = np.asarray(image)
    if pixels.ndim != 3 or pixels.shape[2] != 3:
        raise ImageError(
            f"{where}: has shape {pixels.shape}; an albedo has three channels, R, G, B"
        )
    bad = np.argwhere(~np.isfinite(pixels).all(axis=2))
    if bad.size:
        y, x = bad[0]
        raise ImageError(f"{where}: the texel at x {x}, y {y} is not finite; mend it")
    grid = np.asarray(wavelength_nm, dtype=np.float64)
    believed = shipped_prior(grid) if prior is None else prior.on(grid)
    seen = rgb_weights(grid, linear_color_space(color_space), observer)
    primaries = skin_map(believed, seen).matrix.T
    linear = np.asarray(linearize(pixels, color_space)).reshape(-1, 3)
    dip, worst, count = deepest_dip(linear, primaries)
    if notes is not None and dip < DEEPEST_DIP:
        y, x = divmod(worst, pixels.shape[1])
        text = (
            f"{count} of {len(linear)} texels are no skin: their spectra fall below zero, by "
            f"{-dip:.2g} of the peak at x {x}, y {y}"
        )
        notes.append(Note("albedo-not-skin", where, text))
    transform, basis = _above_zero(primaries, believed.mean @ seen)
    weights = (linear.astype(np.float64) @ transform).astype(np.float32)
    return AlbedoWeights(weights.reshape(pixels.shape), basis, believed.wavelength_nm)


def _above_zero(primaries: FloatArray, skin_rgb: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return non-negative spectra B with the span of an RGB space's primaries.

    The spectra of the primaries themselves fall below zero, since no skin is so saturated. So
    each is mixed with as much of the mean skin s as it needs, ``B_k = P_k + f_k s``, and brought
    to a peak of 1. From ``a B = rgb P`` and ``s = m P`` follows ``a = rgb - m (f.rgb)/(1 + f.m)``.

    Args:
        primaries: P, the spectra of R, G and B, shape [3, n].
        skin_rgb: m, the RGB of the mean skin, shape [3].

    Returns:
        The matrix T with ``weights = rgb @ T``, shape [3, 3], and B, shape [3, n].
    """
    skin = skin_rgb @ primaries
    needed = np.maximum((-primaries / skin).max(axis=1), 0.0)
    mixed = primaries + needed[:, None] * skin
    peak = mixed.max(axis=1)
    transform = np.eye(3) - needed[:, None] * skin_rgb / (1.0 + needed @ skin_rgb)
    return transform * peak, np.maximum(mixed, 0.0) / peak[:, None]
