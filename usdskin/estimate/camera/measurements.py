"""What a chart layer says, as two tables: spectra and the lamp they stood in.

Spectra come inline, or from an instrument's file, as radiance, or as reflectance with a lamp. They
all end on one grid as the radiance of the patches and of a perfect diffuser among them.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from usdskin.colorimetry import xyz_weights
from usdskin.errors import LayerError, UsdSkinError
from usdskin.estimate.chart.layouts import Layout
from usdskin.illuminants import illuminant
from usdskin.notes import Note
from usdskin.prims import ColorChart
from usdskin.spectrafiles import SpectraFile, as_radiances, as_reflectances, read_spectra
from usdskin.spectrafiles import single_spectrum as read_single_spectrum
from usdskin.spectrum import Outside, resample

FloatArray = NDArray[np.float64]

_Convert = Callable[[SpectraFile, list[Note]], FloatArray]

_REACH_NM = 20.0
"""How far reflectances may be held beyond their ends [nm]."""

WHITE_REFLECTANCE = 0.9
"""Of the lightest patch of a chart that nothing is known of: that of common white patches."""


@dataclass(frozen=True, slots=True, eq=False)
class Spectra:
    """The patches' radiance, and that of a perfect diffuser in their place."""

    names: tuple[str, ...] | None
    """Names of the rows; None: they have none."""

    signals: FloatArray
    """Radiance of the patches, shape [m, n]."""

    illuminant: FloatArray | None
    """Radiance of a perfect diffuser, shape [n]; None: to be found from the patches."""

    units: str
    """``absolute`` or ``relative``."""


def read_chart_spectra(chart: ColorChart, wavelength_nm: FloatArray, notes: list[Note]) -> Spectra:
    """Return the spectra of a chart on a grid.

    Args:
        chart: What its layer says.
        wavelength_nm: Band centres [nm], shape [n].
        notes: Takes what was assumed.

    Raises:
        LayerError: There are no spectra, no lamp for reflectances, or the wavelengths do not cover
            the grid.
        UsdSkinError: A file cannot be used.
    """
    lamp = _lamp(chart, wavelength_nm)
    if chart.signals is not None or chart.signals_file is not None:
        nm, rows, names = _table(chart, chart.signals, chart.signals_file, as_radiances, notes)
        signals = _on_grid(chart, "chart:signals", nm, rows, wavelength_nm, "zero", notes)
        return Spectra(names, signals, lamp, chart.units)
    if chart.reflectances is None and chart.reflectances_file is None:
        raise LayerError(
            f"{chart.where}: has no spectra; set chart:signals or chart:signals:file (radiance of "
            "the patches), or chart:reflectances or chart:reflectances:file with a lamp"
        )
    if lamp is None:
        raise LayerError(
            f"{chart.where}: has reflectances but no lamp; apply "
            "SpectralDistributionAPI:illuminant, or set chart:illuminant:file or chart:illuminant"
        )
    given, file = chart.reflectances, chart.reflectances_file
    nm, rows, names = _table(chart, given, file, as_reflectances, notes)
    reflectances = _on_grid(chart, "chart:reflectances", nm, rows, wavelength_nm, "hold", notes)
    named_only = chart.illuminant is None and chart.illuminant_file is None
    if named_only and chart.units == "absolute":
        raise LayerError(
            f'{chart.where}: chart:units is "absolute", but the lamp {chart.illuminant_name} of '
            "chart:illuminant has no scale; measure the lamp, or make the units relative"
        )
    if chart.units == "relative":
        lamp = lamp / float(lamp @ xyz_weights(wavelength_nm)[:, 1])
    return Spectra(names, reflectances * lamp, lamp, chart.units)


def _table(
    chart: ColorChart,
    given: FloatArray | None,
    file: Path | None,
    convert: _Convert,
    notes: list[Note],
) -> tuple[FloatArray, FloatArray, tuple[str, ...] | None]:
    if given is not None:
        assert chart.wavelength_nm is not None
        return chart.wavelength_nm, given, chart.patches
    assert file is not None
    table = read_spectra(file, notes)
    return table.wavelength_nm, convert(table, notes), table.names or None


def _lamp(chart: ColorChart, wavelength_nm: FloatArray) -> FloatArray | None:
    """Return the radiance of a perfect diffuser, where the layer tells it."""
    if chart.illuminant is not None:
        power = chart.illuminant.resample(wavelength_nm)
        name = "spectrum:illuminant:values"
    elif chart.illuminant_file is not None:
        power = resample(*read_single_spectrum(chart.illuminant_file), wavelength_nm)
        name = f"{chart.illuminant_file}:"
    elif chart.illuminant_name:
        try:
            power = illuminant(chart.illuminant_name, wavelength_nm)
        except UsdSkinError as error:
            raise LayerError(f"{chart.where}: chart:illuminant: {error}") from None
        name = "chart:illuminant"
    else:
        return None
    if not power.any() or power.min() < 0.0:
        what = "has no power" if not power.any() else "is negative"
        raise LayerError(
            f"{chart.where}: {name} {what} between {wavelength_nm[0]:g} and {wavelength_nm[-1]:g} "
            "nm; give the spectrum of the lamp the chart stood in"
        )
    return power


def _on_grid(
    chart: ColorChart,
    name: str,
    nm: FloatArray,
    rows: FloatArray,
    wavelength_nm: FloatArray,
    outside: Outside,
    notes: list[Note],
) -> FloatArray:
    """Return band averages, having checked that the spectra reach over the grid."""
    first, last = wavelength_nm[0], wavelength_nm[-1]
    short = max(nm[0] - first, last - nm[-1])
    if short > _REACH_NM or nm[-1] <= first or nm[0] >= last:
        raise LayerError(
            f"{chart.where}: {name} goes from {nm[0]:g} to {nm[-1]:g} nm, which does not cover "
            f"{first:g} to {last:g} nm; measure over that range"
        )
    if short > 1e-6:
        notes.append(
            Note(
                "spectra-extended",
                chart.where,
                f"{name} goes from {nm[0]:g} to {nm[-1]:g} nm; its outermost values are taken for "
                f"the {short:g} nm that are missing",
            )
        )
        outside = "hold"
    return resample(nm, rows, wavelength_nm, outside=outside)


def illuminant_of_patches(
    chart: ColorChart,
    names: Sequence[str],
    signals: FloatArray,
    wavelength_nm: FloatArray,
    notes: list[Note],
) -> FloatArray:
    """Return the radiance of a perfect diffuser among patches whose radiance was measured.

    With the published reflectances R of the chart it is the least-squares fit E = sum(S R) /
    sum(R^2) per band; without them the lightest patch, taken for white.

    Args:
        chart: Where the patches are from.
        names: Their names.
        signals: Their radiance, shape [m, n].
        wavelength_nm: Band centres [nm], shape [n].
        notes: Takes what was assumed.
    """
    reference = _published(chart.layout, wavelength_nm)
    known = [index for index, name in enumerate(names) if name in reference]
    if len(known) >= 3:
        surface = np.stack([reference[names[index]] for index in known])
        return np.asarray((signals[known] * surface).sum(axis=0) / (surface**2).sum(axis=0))
    luminance = signals @ xyz_weights(wavelength_nm)[:, 1]
    lightest = int(np.argmax(luminance))
    notes.append(
        Note(
            "assumed-white",
            chart.where,
            f'no lamp was measured; patch "{names[lightest]}", the lightest, is taken to reflect '
            f"{WHITE_REFLECTANCE:g} at every wavelength",
        )
    )
    return np.asarray(signals[lightest] / WHITE_REFLECTANCE)


def _published(layout: str, wavelength_nm: FloatArray) -> dict[str, FloatArray]:
    """Return the published reflectances of a chart's patches: N. Ohta's of the ColorChecker."""
    if layout != "classic24":
        return {}
    from colour import SDS_COLOURCHECKERS

    return {
        str(name): resample(one.wavelengths, one.values, wavelength_nm, outside="hold")
        for name, one in SDS_COLOURCHECKERS["ColorChecker N Ohta"].items()
    }


def match_patches(
    chart: ColorChart,
    camera_names: Sequence[str] | None,
    camera_count: int,
    spectra: Spectra,
    layout: Layout | None,
    notes: list[Note],
) -> tuple[list[int], list[int], tuple[str, ...]]:
    """Return which rows of camera values and spectra are the same patches.

    Args:
        chart: What its layer says.
        camera_names: Names of the rows of camera values, or None.
        camera_count: How many there are.
        spectra: The spectra.
        layout: Which chart it is, for the other names of its patches, such as ``A1``.
        notes: Takes that rows were taken in order, or that patches were left out.

    Returns:
        Rows of the camera values, rows of the spectra, and the names of the pairs.

    Raises:
        LayerError: Names or numbers do not fit.
    """
    count = len(spectra.signals)

    if camera_names is not None and spectra.names is not None:
        seen, measured = _keys(chart, camera_names, spectra.names, layout)
        rows = {key: index for index, key in enumerate(measured)}
        shared = [(i, rows[key]) for i, key in enumerate(seen) if key in rows]
        if len(shared) == min(camera_count, count):
            if count != camera_count:
                kept, whole = len(shared), max(camera_count, count)
                text = f"{kept} of {whole} patches have both camera values and a spectrum"
                notes.append(Note("patches-without-pair", chart.where, text))
            pairs = [list(column) for column in zip(*shared, strict=True)]
            return pairs[0], pairs[1], tuple(camera_names[i] for i, _ in shared)
        if shared:
            absent = spectra.names[next(i for i, key in enumerate(measured) if key not in seen)]
            raise LayerError(
                f'{chart.where}: the spectra name a patch "{absent}" that the camera values do not '
                f"({', '.join(camera_names[:4])}, ...); give both the same names"
            )
    if count != camera_count:
        raise LayerError(
            f"{chart.where}: {camera_count} patches have camera values and {count} a spectrum, and "
            "their names do not pair them; give both the same names, or the same number in order"
        )
    names = camera_names or spectra.names or [str(index + 1) for index in range(count)]
    if camera_names is not None and spectra.names is not None:
        text = f'the spectra are taken in the order of the patches: "{spectra.names[0]}" is '
        text += f'"{camera_names[0]}", and so on'
        notes.append(Note("patches-in-order", chart.where, text))
    return list(range(count)), list(range(count)), tuple(names)


def _keys(
    chart: ColorChart, seen: Sequence[str], measured: Sequence[str], layout: Layout | None
) -> list[list[int | str]]:
    """Return by what patches of two lists are paired.

    By their names as they are where those of one list are all in the other, else by what is left
    of them without spaces and signs, or by the layout's numbers.

    Raises:
        LayerError: Two patches of a list cannot be told apart.
    """
    lists: list[list[int | str]] = [[*seen], [*measured]]
    if not (set(seen) <= set(measured) or set(measured) <= set(seen)):
        for names in lists:
            for index, name in enumerate(names):
                known = None if layout is None else layout.index(str(name))
                plain = re.sub(r"[^\w.]|_", "", str(name).casefold())
                names[index] = (plain or name) if known is None else known
    for what, given, keys in zip(
        ("camera values", "spectra"), (seen, measured), lists, strict=True
    ):
        for index, key in enumerate(keys):
            first = keys.index(key)
            if first != index:
                raise LayerError(
                    f'{chart.where}: the {what} call patch {first + 1} "{given[first]}" and patch '
                    f'{index + 1} "{given[index]}", which cannot be told apart; give every patch a '
                    "name of its own"
                )
    return lists


def read_camera_values(path: Path) -> tuple[tuple[str, ...], FloatArray]:
    """Return names and camera values of a text file: name, R, G, B per row.

    Returns:
        Names, and values, shape [m, 3].

    Raises:
        LayerError: The file cannot be read, or a row is something else.
    """
    try:
        lines = path.read_text("utf-8-sig").splitlines()
    except (OSError, UnicodeDecodeError) as error:
        reason = getattr(error, "strerror", None) or "it is no text"
        raise LayerError(f"{path}: cannot be read ({reason}); give rows of name, R, G, B") from None
    names: list[str] = []
    rows: list[list[float]] = []
    for number, line in enumerate(lines, start=1):
        cells = [cell.strip().strip('"') for cell in re.split(r"[,;\t]", line.split("#", 1)[0])]
        if not any(cells):
            continue
        try:
            values = [float(cell) for cell in cells[-3:]]
            if len(cells) != 4 or not np.isfinite(values).all():
                raise ValueError
        except ValueError:
            if not rows and number == 1:
                continue  # a heading
            raise LayerError(f"{path}:{number}: {line[:40]!r} is not name, R, G, B") from None
        if cells[0] in names:
            raise LayerError(f'{path}:{number}: patch "{cells[0]}" is there twice; rename one')
        names.append(cells[0])
        rows.append(values)
    if not rows:
        raise LayerError(f"{path}: has no rows of name, R, G, B; add them")
    return tuple(names), np.array(rows)
