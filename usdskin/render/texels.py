"""What the texels of a light map are fit for: bad ones found, mended, and maps factorised.

Arrays in, arrays out; no USD and no files. A texel is bad when it is not finite or shines
negatively. ``where`` in the messages is what the caller knows of file, layer and prim.
"""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from usdskin.errors import ImageError
from usdskin.notes import Note

BadPixels = Literal["error", "clamp"]

RESIDUAL = 1e-6
"""Largest error of a factorised spectrum, relative to its own peak."""

_ROUNDING = 1e-6  # of sum_k |c_k| max |B_k|: float32 coefficients and a few roundings
_DARK = 1e-6  # texels below this share of the map's peak are judged as if they had it
_CHUNK_ROWS = 16384

FloatArray = NDArray[np.float32]


def mend_values(
    pixels: FloatArray, bad_pixels: BadPixels, where: str, path: str, notes: list[Note]
) -> FloatArray:
    """Find values that are no light: negative, NaN or infinite.

    Clamping sets negative values and NaN to 0 and infinite ones to the map's largest finite value.

    Args:
        pixels: Radiance in RGB or in bands, shape [height, width, channel_count].
        bad_pixels: Whether they are refused or clamped.
        where: File, layer and prim, for the message.
        path: Prim path, for the note.
        notes: Takes a note of what was clamped.

    Returns:
        ``pixels`` where all is well, else a mended copy.

    Raises:
        ImageError: A pixel is bad and ``bad_pixels`` is ``error``.
    """
    # NaN comes through both, so that a good map costs two passes.
    lowest, highest = float(pixels.min()), float(pixels.max())
    if lowest >= 0.0 and np.isfinite(highest):
        return pixels
    nan = np.isnan(pixels)
    infinite = np.isinf(pixels)
    with np.errstate(invalid="ignore"):
        negative = (pixels < 0.0) & ~infinite
    worst = np.asarray(np.where(negative, pixels, 0.0).min(axis=-1))
    kinds = [np.asarray(mask.any(axis=-1), dtype=bool) for mask in (negative, nan, infinite)]
    report = _report(worst, kinds)
    if bad_pixels == "error":
        raise ImageError(f"{where}: {report}; mend the map, or let --bad-pixels clamp do it")
    finite = pixels[~(nan | infinite)]
    largest = max(float(finite.max()), 0.0) if finite.size else 0.0
    mended = pixels.copy()
    mended[nan | negative] = 0.0
    mended[infinite] = np.where(pixels[infinite] > 0.0, np.float32(largest), np.float32(0.0))
    said = f"{report}; set to 0"
    if infinite.any():
        said += f", infinite ones to the largest finite value {largest:g}"
    notes.append(Note("bad-pixels-clamped", path, said))
    return mended


def _report(worst: NDArray[Any], kinds: list[NDArray[np.bool_]]) -> str:
    """Say how many pixels are negative, NaN and infinite, where, and how large."""
    negative, nan, infinite = kinds
    bad = negative | nan | infinite
    parts = []
    if negative.any():
        y, x = np.unravel_index(int(np.argmin(worst)), worst.shape)
        parts.append(f"{int(negative.sum())} negative (lowest {worst[y, x]:.4g} at x {x}, y {y})")
    for name, mask in (("NaN", nan), ("infinite", infinite)):
        if mask.any():
            y, x = np.unravel_index(int(np.argmax(mask)), mask.shape)
            parts.append(f"{int(mask.sum())} {name} (first at x {x}, y {y})")
    return f"{int(bad.sum())} of {bad.size} pixels are no light: {', '.join(parts)}"


def mend_low_rank(
    coefficients: FloatArray,
    basis: NDArray[np.float64],
    shares: NDArray[np.float64],
    energy: NDArray[np.float64],
    bad_pixels: BadPixels,
    where: str,
    path: str,
    notes: list[Note],
) -> tuple[FloatArray, NDArray[np.float64]]:
    """Find texels of a factorised map that are not finite or whose spectra are negative.

    Coefficients may be negative, light may not: a texel with less than no energy is bad. A
    spectrum that dips below 0 here and there, as linearly recovered ones do, is noted only: cutting
    the dips off would shift its colour. Clamping is exact: spectra are cut off at 0 band by band,
    dips too, and what that adds to them is factorised and appended to the basis. A texel that is
    not finite becomes black.

    Args:
        coefficients: Weights of the basis, shape [height, width, rank].
        basis: Spectra, shape [rank, band_count].
        shares: Of each band in the width of all [1], shape [band_count].
        energy: Mean of each spectrum over all of its wavelengths, rendered or not, shape [rank].
        bad_pixels: Whether bad texels are refused or clamped.
        where: File, layer and prim, for the message.
        path: Prim path, for the note.
        notes: Takes a note of what was clamped.

    Returns:
        Coefficients and basis, of a higher rank where spectra were clamped.

    Raises:
        ImageError: A texel is bad and ``bad_pixels`` is ``error``.
    """
    shape = coefficients.shape[:2]
    rows = coefficients.reshape(-1, coefficients.shape[-1])
    nan = np.asarray(np.isnan(rows).any(axis=-1), dtype=bool)
    infinite = np.asarray(np.isinf(rows).any(axis=-1), dtype=bool) & ~nan
    if nan.any() or infinite.any():
        rows = np.where((nan | infinite)[:, None], np.float32(0.0), rows)
    worst, dark = _lowest_radiance(rows, basis, energy)
    dips = worst < 0.0
    negative = dips if bad_pixels == "clamp" else dark
    bad = negative | nan | infinite
    if not bad.any():
        if dips.any():
            notes.append(_dip_note(rows, basis, shares, worst, shape, path))
        return coefficients, basis
    kinds = [mask.reshape(shape) for mask in (negative, nan, infinite)]
    report = _report(worst.reshape(shape), kinds)
    if bad_pixels == "error":
        raise ImageError(f"{where}: {report}; mend the map, or let --bad-pixels clamp do it")
    before = basis.shape[0]
    at = np.flatnonzero(negative)
    if at.size:
        rows, basis = _without_negatives(rows, basis, at)
    said = f"{report}; negative bands set to 0 (rank {before} to {basis.shape[0]})"
    if nan.any() or infinite.any():
        said += ", texels that are not finite made black"
    notes.append(Note("bad-pixels-clamped", path, said))
    return rows.reshape(*shape, -1), basis


def _chunks(count: int) -> Iterator[slice]:
    for start in range(0, count, _CHUNK_ROWS):
        yield slice(start, min(start + _CHUNK_ROWS, count))


def _dip_note(
    rows: FloatArray,
    basis: NDArray[np.float64],
    shares: NDArray[np.float64],
    worst: FloatArray,
    shape: tuple[int, int],
    path: str,
) -> Note:
    """Tell how many spectra dip below 0, and how much of the light that is."""
    below = above = 0.0
    for chunk in _chunks(rows.shape[0]):
        spectra = rows[chunk] @ basis.astype(np.float32)
        negative = float(np.minimum(spectra, 0.0).sum(axis=0, dtype=np.float64) @ shares)
        below -= negative
        above += float(spectra.sum(axis=0, dtype=np.float64) @ shares) - negative
    y, x = np.unravel_index(int(np.argmin(worst)), shape)
    return Note(
        "spectra-dip",
        path,
        f"the spectra of {int(np.count_nonzero(worst))} of {worst.size} pixels dip below zero, "
        f"{below / above:.2%} of the energy, deepest at x {x}, y {y}; they are used as they are",
    )


def _lowest_radiance(
    rows: FloatArray, basis: NDArray[np.float64], energy: NDArray[np.float64]
) -> tuple[FloatArray, NDArray[np.bool_]]:
    """Return each texel's lowest radiance where it is negative beyond rounding, else 0.

    The second result tells which texels have less than no energy.
    """
    spectra = basis.astype(np.float32)
    size = np.abs(spectra).max(axis=1)
    worst = np.zeros(rows.shape[0], dtype=np.float32)
    dark = np.zeros(rows.shape[0], dtype=bool)
    if rows.min(initial=0.0) >= 0.0 and spectra.min(initial=0.0) >= 0.0:
        return worst, dark
    for chunk in _chunks(rows.shape[0]):
        radiance = rows[chunk] @ spectra
        lowest = radiance.min(axis=1)
        allowance = _ROUNDING * (np.abs(rows[chunk]) @ size)
        worst[chunk] = np.where(lowest < -allowance, lowest, 0.0)
        dark[chunk] = rows[chunk] @ energy.astype(np.float32) < -allowance
    return worst, dark


def _without_negatives(
    rows: FloatArray, basis: NDArray[np.float64], at: NDArray[np.intp]
) -> tuple[FloatArray, NDArray[np.float64]]:
    """Return a factorisation in which the spectra of some rows are cut off at 0."""
    spectra = rows[at].astype(np.float64) @ basis
    missing = np.maximum(-spectra, 0.0)
    added, shapes = factorize(missing.astype(np.float32), np.abs(spectra).max(axis=1))
    rank, band_count = basis.shape
    if rank + shapes.shape[0] >= band_count:
        full = np.empty((rows.shape[0], band_count), dtype=np.float32)
        for chunk in _chunks(rows.shape[0]):
            full[chunk] = rows[chunk].astype(np.float64) @ basis
        full[at] = np.maximum(spectra, 0.0)
        return full, np.eye(band_count)
    wide = np.zeros((rows.shape[0], rank + shapes.shape[0]), dtype=np.float32)
    wide[:, :rank] = rows
    wide[at, rank:] = added
    return wide, np.vstack((basis, shapes))


def factorize(
    rows: FloatArray, peaks: NDArray[Any] | None = None
) -> tuple[FloatArray, NDArray[np.float64]]:
    """Factorise spectra at their numerical rank: ``rows = coefficients @ basis``.

    The basis is made of the leading eigenvectors of the Gram matrix of the spectra, each scaled to
    peak 1 so that dark texels count like bright ones (float64). The rank is the least at which no
    value is off by more than ``RESIDUAL`` of its spectrum's peak.

    Args:
        rows: Spectra, shape [count, band_count].
        peaks: What the error of each row is relative to, shape [count]; its own peak by default.

    Returns:
        Coefficients, shape [count, rank], and orthonormal basis, shape [rank, band_count]; the
        spectra themselves and a unit matrix where nothing is gained.
    """
    count, band_count = rows.shape
    own = np.abs(rows).max(axis=1) if peaks is None else peaks
    peak = np.asarray(own, dtype=np.float64)
    brightest = float(np.max(peak, initial=0.0))
    peak = np.maximum(peak, _DARK * max(brightest, float(np.finfo(np.float32).tiny)))
    gram = np.zeros((band_count, band_count))
    for chunk in _chunks(count):
        scaled = rows[chunk] / peak[chunk, None]
        gram += scaled.T @ scaled
    eigenvalues, eigenvectors = np.linalg.eigh(gram)
    vectors = eigenvectors[:, ::-1]
    # A direction whose rms amplitude is below a tenth of the bound can hardly break it.
    noise = band_count * np.finfo(np.float64).eps * float(eigenvalues[-1])
    strong = eigenvalues > max(count * (0.1 * RESIDUAL) ** 2, noise)
    rank = max(int(np.count_nonzero(strong)), 1)
    while rank < band_count:
        basis = vectors[:, :rank]
        coefficients = np.empty((count, rank), dtype=np.float32)
        if _project(rows, peak, basis, coefficients):
            return coefficients, np.ascontiguousarray(basis.T)
        rank += 1
    return rows, np.eye(band_count)


def _project(
    rows: FloatArray,
    peak: NDArray[Any],
    basis: NDArray[np.float64],
    coefficients: FloatArray,
) -> bool:
    """Fill in the coefficients; return whether they give the spectra within the bound."""
    for chunk in _chunks(rows.shape[0]):
        spectra = rows[chunk].astype(np.float64)
        weights = (spectra @ basis).astype(np.float32)
        error = np.abs(weights @ basis.T - spectra).max(axis=1)
        if np.any(error > RESIDUAL * peak[chunk]):
            return False
        coefficients[chunk] = weights
    return True
