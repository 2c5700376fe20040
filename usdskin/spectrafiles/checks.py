"""What makes spectra that were read usable, or refuses them."""

from __future__ import annotations

import numpy as np

from usdskin.errors import UsdSkinError
from usdskin.notes import Note
from usdskin.spectrafiles.spectrafile import RawSpectra, SpectraFile

VISIBLE_NM = (400.0, 700.0)
"""Wavelengths that spectra have to reach into [nm]."""

NEGATIVE_SHARE = 0.005
"""How far below zero noise may take a reading, of the largest reading in the file [1]."""

_UNEVEN_SHARE = 0.2
"""Share of steps of a grid that may differ from the others and still look like a slip."""


def check_spectra(raw: RawSpectra, notes: list[Note]) -> SpectraFile:
    """Return the spectra of a file with wavelengths ascending and small negative readings at zero.

    A negative reading is judged against the largest in the file: what the instrument's noise does
    to a black patch it does on the scale of the white one.

    Args:
        raw: What a reader found.
        notes: What was changed is appended here.

    Raises:
        UsdSkinError: Names are missing or repeated, wavelengths repeated or all outside 400 to
            700 nm, a value not finite or clearly negative, or a spectrum is zero everywhere.
    """
    _check_names(raw)
    _check_finite(raw)
    order = _check_wavelengths(raw, notes)
    values = _without_negatives(raw, notes)
    for index, name in enumerate(raw.names):
        if not values[index].any():
            raise UsdSkinError(
                f"{raw.where(index, 0)}: {name!r} is zero at every wavelength; measure it again, "
                "or remove it"
            )
    return SpectraFile(
        path=raw.path,
        names=raw.names,
        wavelength_nm=raw.wavelength_nm[order],
        values=np.ascontiguousarray(values[:, order]),
        quantity=raw.quantity,
        units=raw.units,
        metadata=raw.metadata,
    )


def _check_names(raw: RawSpectra) -> None:
    seen: dict[str, int] = {}
    for index, name in enumerate(raw.names):
        if not name:
            raise UsdSkinError(f"{raw.where(index, 0)}: a spectrum without a name; give it one")
        if name in seen:
            raise UsdSkinError(
                f"{raw.where(index, 0)}: a second {name!r}, the first is at "
                f"{raw.where(seen[name], 0)}; every spectrum needs a name of its own"
            )
        seen[name] = index


def _check_finite(raw: RawSpectra) -> None:
    bad = np.argwhere(~np.isfinite(raw.values))
    if bad.size:
        spectrum, sample = (int(index) for index in bad[0])
        raise UsdSkinError(
            f"{raw.where(spectrum, sample)}: {raw.names[spectrum]!r} is "
            f"{raw.values[spectrum, sample]:g} at {raw.wavelength_nm[sample]:g} nm; "
            "give a number, or remove this wavelength from the file"
        )


def _check_wavelengths(
    raw: RawSpectra, notes: list[Note]
) -> np.ndarray[tuple[int], np.dtype[np.intp]]:
    """Return the order in which wavelengths ascend."""
    wavelength_nm = raw.wavelength_nm
    if wavelength_nm.size < 2:
        raise UsdSkinError(f"{raw.path}: {wavelength_nm.size} wavelengths; a spectrum needs more")
    order = np.argsort(wavelength_nm, kind="stable")
    steps = np.diff(wavelength_nm[order])
    if (steps <= 0.0).any():
        again = int(order[int(np.argmin(steps)) + 1])
        raise UsdSkinError(
            f"{raw.where(0, again)}: {wavelength_nm[again]:g} nm a second time; "
            "give every wavelength once"
        )
    low, high = wavelength_nm[order[0]], wavelength_nm[order[-1]]
    if low >= VISIBLE_NM[1] or high <= VISIBLE_NM[0]:
        raise UsdSkinError(
            f"{raw.path}: reaches from {low:g} to {high:g} nm, so not into "
            f"{VISIBLE_NM[0]:g} to {VISIBLE_NM[1]:g} nm; measure visible light"
        )
    rises = np.diff(wavelength_nm) > 0.0
    if rises.any() and not rises.all():
        notes.append(
            Note("wavelengths-sorted", str(raw.path), "wavelengths do not ascend; they were sorted")
        )
    usual = float(np.median(steps))
    uneven = np.abs(steps - usual) > 0.01 * usual
    if uneven.any() and uneven.mean() < _UNEVEN_SHARE:
        at = int(np.flatnonzero(uneven)[0])
        message = (
            f"wavelengths are {usual:g} nm apart, but {steps[at]:g} nm after "
            f"{wavelength_nm[order[at]]:g} nm; see whether one is missing"
        )
        notes.append(Note("wavelength-step-uneven", str(raw.path), message))
    return order


def _without_negatives(
    raw: RawSpectra, notes: list[Note]
) -> np.ndarray[tuple[int, int], np.dtype[np.float64]]:
    peak = float(raw.values.max(initial=0.0))
    spectrum, sample = np.unravel_index(int(np.argmin(raw.values)), raw.values.shape)
    lowest = float(raw.values[spectrum, sample])
    if lowest >= 0.0:
        return raw.values
    what = f"{raw.names[spectrum]!r} is {lowest:g} at {raw.wavelength_nm[sample]:g} nm"
    if lowest < -NEGATIVE_SHARE * peak:
        raise UsdSkinError(
            f"{raw.where(int(spectrum), int(sample))}: {what}, below zero by more than "
            f"{100.0 * NEGATIVE_SHARE:g} % of the file's largest value; measure it again"
        )
    count = int(np.count_nonzero(raw.values < 0.0))
    notes.append(
        Note(
            "negative-readings-zeroed",
            str(raw.path),
            f"{count} readings below zero were set to zero; the lowest: {what}",
        )
    )
    return np.maximum(raw.values, 0.0)
