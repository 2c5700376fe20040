"""The way of light through a body, exp(-s delta), as a few products of length and wavelength."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from usdskin.prims import SkinParameters
from usdskin.render.materials import SkinMaterial, SurfaceMaterial
from usdskin.spectrum import Spectrum

FloatArray = NDArray[np.float64]

PASSAGE_ENTRIES = 512
"""Path lengths at which exp(-s delta) is tabulated."""

PASSAGE_TOLERANCE = 1.0e-5
"""Largest error of its low-rank form, of 1."""

LEAST_CLEAR = 1.0e-4
"""Share of light that a body is taken to stop altogether."""

NO_LIMIT = 1.0e18
"""Path length [m] that no body reaches."""


@dataclass(frozen=True, slots=True, eq=False)
class Passage:
    """exp(-s delta(lambda)) = sum_k f_k(s) g_k(lambda), the way of light through a body."""

    table: FloatArray
    """f_k over log(1 + s / scale) in equal steps from 0, shape [entry_count, rank]."""

    spectra: FloatArray
    """g_k, shape [rank, bands]."""

    scale: float
    """Path length below which the table's axis is nearly straight in s [m]."""

    last: float
    """log(1 + s / scale) of the table's last entry; 0 where the path length is constant."""

    limit: float
    """Path length beyond which less than ``LEAST_CLEAR`` is left in every band [m]."""


def sampled(spectrum: Spectrum | float | None, nm: FloatArray, fallback: float) -> FloatArray:
    """Return a spectrum at wavelengths, a number at all of them, shape [bands]."""
    if spectrum is None:
        return np.full(len(nm), fallback)
    if isinstance(spectrum, Spectrum):
        return spectrum.resample(nm)
    return np.full(len(nm), float(spectrum))


def dims(skin: SkinParameters) -> bool:
    """Return whether a skin's body weakens the light that crosses it."""
    opacity = skin.opacity
    return bool(np.max(opacity.value if isinstance(opacity, Spectrum) else opacity) > 0.0)


def factorised_passage(
    material: SkinMaterial, opacity: FloatArray, thickness_range: dict[str, float]
) -> Passage:
    """Factorise exp(-s delta) over the thicknesses in use, by its singular values."""
    skin = material.parameters
    largest = thickness_range.get(material.path, 0.0)
    limit = _limit(opacity)
    if largest <= 0.0:
        return Passage(np.ones((1, 1)), np.exp(-skin.thickness * opacity)[None], 1.0, 0.0, limit)
    # In equal steps of log(1 + s / scale) a band's error does not depend on its opacity.
    scale = 0.5 / float(opacity.max())
    last = float(np.log1p(min(largest, 12.0 / float(opacity[opacity > 0.0].min())) / scale))
    exact = np.exp(-(scale * np.expm1(np.linspace(0.0, last, PASSAGE_ENTRIES)))[:, None] * opacity)
    left, sizes, right = np.linalg.svd(exact, full_matrices=False)
    for rank in range(1, len(sizes) + 1):
        table = left[:, :rank] * sizes[:rank]
        if np.abs(table @ right[:rank] - exact).max() < PASSAGE_TOLERANCE:
            break
    return Passage(table, right[:rank], scale, last, limit)


def _limit(opacity: FloatArray) -> float:
    clearest = float(opacity.min())
    return -float(np.log(LEAST_CLEAR)) / clearest if clearest > 0.0 else NO_LIMIT


def body_reach(material: SkinMaterial | SurfaceMaterial, nm: FloatArray) -> float:
    """Return the way light is followed through a body [m]; 0 where it is clear or no skin."""
    if not isinstance(material, SkinMaterial):
        return 0.0
    opacity = sampled(material.parameters.opacity, nm, 0.0)
    return _limit(opacity) if opacity.max(initial=0.0) > 0.0 else 0.0
