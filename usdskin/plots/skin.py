"""The figure of a skin: its spectra and color, and the readings it was fitted to."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import partial
from typing import TYPE_CHECKING, Any

import numpy as np

from usdskin.errors import LayerError
from usdskin.notes import Note
from usdskin.plots.entries import draw_entries, entries_height, with_error
from usdskin.plots.figures import section_title, styled
from usdskin.plots.sections import Section, chosen_parts, page
from usdskin.plots.skin_color import draw_swatches, reflected
from usdskin.plots.skin_fit import FIT_HEIGHT_IN, DrawnFit, draw_fit
from usdskin.plots.skin_spectra import draw_opacity, draw_reflectance, draw_scattering
from usdskin.prims import SkinFitRecord, SkinParameters
from usdskin.spectrum import DEFAULT_WAVELENGTHS_NM, Spectrum

if TYPE_CHECKING:
    from matplotlib.figure import Figure

PARTS = ("spectra", "color", "fit", "summary")
"""What the figure shows, by the names that ``--what`` takes."""

_LEAST_BANDS = 3
_MILLIMETRES = 1e3


@dataclass(frozen=True, slots=True, eq=False)
class DrawnSkin:
    """A skin as its figure needs it."""

    where: str
    """``layer.usda </Prim/path>``, for errors."""

    name: str
    """What the material and its chosen variants are called."""

    skin: SkinParameters
    """What the material says."""

    record: SkinFitRecord | None = None
    """The fit it came from; None: it was not fitted."""

    fit: DrawnFit | None = None
    """The readings of the fit; None: the layer has none."""


def draw_skin(
    drawn: DrawnSkin, notes: list[Note] | None = None, *, what: Sequence[str] = ()
) -> Figure:
    """Return the figure of a skin.

    Args:
        drawn: What to draw.
        notes: Takes what the layer lacks, where nothing in particular was asked for; without a
            list that is an error.
        what: Parts of the figure, out of ``PARTS``; all by default.

    Raises:
        UsageError: No such part; matplotlib is not installed.
        LayerError: The layer lacks what was asked for.
    """
    parts = _available(drawn, what, notes)
    sections: list[Section] = []
    if "spectra" in parts:
        sections.append(Section(2.5, partial(_draw_spectra, drawn=drawn)))
    if "color" in parts:
        sections.append(Section(1.75, partial(_draw_color, drawn=drawn)))
    if "fit" in parts:
        assert drawn.fit is not None  # _available
        sections.append(Section(FIT_HEIGHT_IN, partial(draw_fit, fit=drawn.fit)))
    if "summary" in parts:
        height = entries_height(len(_entries(drawn)))
        sections.append(Section(height, partial(_draw_summary, drawn=drawn)))
    title = "Skin" if drawn.record is None else "Estimated skin"
    with styled():
        return page(title, _subtitle(drawn), sections)


def _available(drawn: DrawnSkin, what: Sequence[str], notes: list[Note] | None) -> tuple[str, ...]:
    """Return the parts to draw; what the layer lacks is a note, or an error if asked for."""
    parts = chosen_parts(what, PARTS, "a skin")
    skin = drawn.skin
    lacking = {}
    if skin.reflectance is None:
        lacking["color"] = "no spectrum of S (spectrum:reflectance)"
        if skin.scattering is None and not isinstance(skin.opacity, Spectrum):
            lacking["spectra"] = "no spectrum of S, Ss or opacity"
    elif len(skin.reflectance.wavelength_nm) < _LEAST_BANDS:
        lacking["color"] = f"fewer than {_LEAST_BANDS} wavelengths of S"
    if drawn.fit is None:
        lacking["fit"] = "no readings beside it (a Scope with SkinSampleAPI)"
        if drawn.record is None:
            lacking["fit"] = "no fit (fit:parameters)"
    for name in [name for name in parts if name in lacking]:
        expected = name == "fit" and drawn.record is None  # many skins were never fitted
        if what or (notes is None and not expected):
            raise LayerError(
                f"{drawn.where}: has {lacking[name]}, which --what {name} draws; leave it out"
            )
        if notes is not None and not expected:
            text = f"{name} not drawn: has {lacking[name]}"
            notes.append(Note("plot-left-out", drawn.where, text))
    return tuple(name for name in parts if name not in lacking)


# --- Parts -------------------------------------------------------------------------------------


def _draw_spectra(part: Any, *, drawn: DrawnSkin) -> None:
    """Draw S, Ss and delta side by side, as far as the skin has them."""
    skin, record = drawn.skin, drawn.record
    fitted = record is not None
    stddev = (None, None) if record is None else (
        record.reflectance_stddev, record.scattering_stddev
    )  # fmt: skip
    panels = []
    if skin.reflectance is not None:
        facing = reflected(skin, [1.0])[0]
        panels.append(partial(draw_reflectance, spectrum=skin.reflectance, deviation=stddev[0],
                              facing=facing, fitted=fitted))  # fmt: skip
    if skin.scattering is not None:
        panels.append(partial(draw_scattering, spectrum=skin.scattering, deviation=stddev[1],
                              fitted=fitted))  # fmt: skip
    if isinstance(skin.opacity, Spectrum) or skin.opacity > 0.0:
        known = skin.reflectance or skin.scattering
        nm = DEFAULT_WAVELENGTHS_NM if known is None else known.wavelength_nm
        panels.append(partial(draw_opacity, opacity=skin.opacity, range_nm=(nm[0], nm[-1])))
    section_title(part, "Spectra", _texture_note(skin))
    grid = part.subplots(1, len(panels), squeeze=False)
    for axes, draw in zip(grid.flat, panels, strict=True):
        draw(axes)


def _texture_note(skin: SkinParameters) -> str:
    """Return what the spectra do not show."""
    file = skin.weights_file or skin.albedo_file
    if file is None:
        return ""
    if skin.reflectance is None:
        return "S is in a texture, and not shown"
    return "S is the material's own; a texture gives others over the surface"


def _draw_color(part: Any, *, drawn: DrawnSkin) -> None:
    note = "above: facing the lamp; below: turned from it; eye adapted to the lamp, no lustre"
    section_title(part, "Color", note)
    draw_swatches(part, drawn.skin)


def _draw_summary(part: Any, *, drawn: DrawnSkin) -> None:
    section_title(part, "Summary")
    draw_entries(part, _entries(drawn))


# --- Words -------------------------------------------------------------------------------------


def _subtitle(drawn: DrawnSkin) -> str:
    known = drawn.skin.reflectance or drawn.skin.scattering
    words = [drawn.where.partition(" ")[0], drawn.name]
    if known is not None:
        nm = known.wavelength_nm
        bands = "1 band" if len(nm) == 1 else f"{len(nm)} bands"
        words.append(f"{nm[0]:g} to {nm[-1]:g} nm, {bands}")
    return ";  ".join(filter(None, words))


def _entries(drawn: DrawnSkin) -> list[tuple[str, str]]:
    """Return what the layer says about the skin, as names and values."""
    skin = drawn.skin
    record = drawn.record or SkinFitRecord("none")
    entries = [
        ("wrap l", with_error(skin.wrap, record.wrap_stddev)),
        ("diffuse share α", with_error(skin.alpha, record.alpha_stddev)),
    ]
    if skin.wrap_normalization != "paper":
        entries.append(("wrap term", skin.wrap_normalization))
    entries += _fit_entries(drawn)
    if not isinstance(skin.opacity, Spectrum) and skin.opacity > 0.0:
        entries.append(("opacity δ", f"{skin.opacity:.4g} m$^{{-1}}$"))
    if skin.thickness > 0.0:
        entries.append(("thickness", f"{_MILLIMETRES * skin.thickness:.3g} mm"))
    if skin.specular_weight <= 0.0:
        return [*entries, ("lustre", "none")]
    found = _specular_stddev(record)
    entries += [
        ("weight of the lustre", with_error(skin.specular_weight, found.get("weight"))),
        ("roughness of lobe 1", with_error(skin.roughness1, found.get("roughness1"))),
    ]
    if skin.mix > 0.0:
        entries += [
            ("roughness of lobe 2", with_error(skin.roughness2, found.get("roughness2"))),
            ("share of lobe 2", with_error(skin.mix, found.get("mix"))),
        ]
    return entries


def _fit_entries(drawn: DrawnSkin) -> list[tuple[str, str]]:
    record, fit = drawn.record, drawn.fit
    if record is None:
        return []
    entries = []
    if record.residual is not None:
        entries.append(("residual, rms", f"{100.0 * record.residual:.2g} % of the peak"))
    if record.reach_deg is not None:
        reached = f"{record.reach_deg:.1f}°"
        if record.needed_reach_deg is not None:
            reached += f"; {record.needed_reach_deg:.1f}° needed"
        entries.append(("largest angle", reached))
    if fit is not None:
        entries.append(("readings used", f"{int(fit.used.sum())} of {len(fit.used)}"))
    return entries


def _specular_stddev(record: SkinFitRecord) -> dict[str, float]:
    """Return the standard deviations of the lobes' numbers, where they were fitted."""
    if record.covariance is None:
        return {}
    with np.errstate(over="ignore"):
        deviations = np.sqrt(record.covariance.diagonal())
    return {
        name.removeprefix("specular:"): float(deviation)
        for name, deviation in zip(record.parameters, deviations, strict=True)
        if name.startswith("specular:") and deviation < 1.0
    }
