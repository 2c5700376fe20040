"""The figure of a calibrated camera.

Sensitivities; for each class of light its perfect diffuser, chromaticities, spectra of patches
estimated (solid) against measured (dashed), and what leaving each patch out costs.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import partial
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from usdskin.errors import LayerError, UsageError
from usdskin.notes import Note
from usdskin.plots.appearance import display_colors, lab_values, signal_chromaticity
from usdskin.plots.chromaticity import draw_diagram, draw_pairs
from usdskin.plots.figures import INK, legend_inside, styled
from usdskin.plots.patch_errors import draw_errors, errors_height
from usdskin.plots.patches import choose_patches
from usdskin.plots.sections import Section, chosen_parts, draw_heading, page
from usdskin.plots.spectra import draw_class_light, draw_patches, draw_sensitivities, patch_rows
from usdskin.prims.cameras import Recovery, SpectralCamera
from usdskin.prims.charts import ColorChart

if TYPE_CHECKING:
    from matplotlib.figure import Figure

FloatArray = NDArray[np.float64]

PARTS = ("sensitivities", "diffuser", "chromaticity", "spectra", "errors")
"""What the figure shows, by the names that ``--what`` takes."""

_PANELS = ("sensitivities", "diffuser", "chromaticity")
_ROW_IN = 1.28


@dataclass(frozen=True, slots=True, eq=False)
class _Trained:
    """A recovery and what it was made from, patch by patch; empty where the layer lacks it."""

    recovery: Recovery
    names: tuple[str, ...]
    measured: FloatArray
    estimated: FloatArray
    colors: FloatArray


def draw_camera(
    camera: SpectralCamera,
    notes: list[Note] | None = None,
    *,
    patches: Sequence[str] = (),
    what: Sequence[str] = (),
    classes: Sequence[str] = (),
) -> Figure:
    """Return the figure of a calibrated camera.

    Curves of estimated spectra are the fit, in which the patch itself took part; the figures
    beside them, and the bars, are leave-one-out.

    Args:
        camera: The calibration, with the charts it was made from.
        notes: Takes what the layer lacks, where nothing in particular was asked for; without a
            list that is an error.
        patches: Names of the patches whose spectra are drawn; a dozen varied ones by default.
        what: Parts of the figure, out of ``PARTS``; all by default.
        classes: Classes of light to show; all by default.

    Raises:
        UsageError: No such part, class or patch; matplotlib is not installed.
        LayerError: The layer lacks what was asked for.
    """
    parts = chosen_parts(what, PARTS, "a camera")
    recoveries = _chosen_recoveries(camera, classes)
    sections: list[Section] = []
    for index, recovery in enumerate(recoveries):
        trained = _trained(camera, recovery)
        known = _available(camera, trained, parts, notes if not what else None)
        panels = [name for name in known if name in _PANELS]
        if index > 0 and "sensitivities" in panels:
            panels.remove("sensitivities")
        if known != ["sensitivities"]:
            heading = partial(draw_heading, title=f"Light class {recovery.light_class}",
                              lines=_class_lines(recovery))  # fmt: skip
            sections.append(Section(0.50, heading))
        if panels:
            draw = partial(_draw_panels, camera=camera, trained=trained, panels=panels)
            sections.append(Section(2.4, draw))
        if "spectra" in known:
            sections.append(_spectra_section(camera, trained, patches))
        if "errors" in known:
            height = errors_height(recovery.patches)
            sections.append(Section(height, partial(_draw_errors, trained=trained)))
    with styled():
        return page(_title(camera), _subtitle(camera, recoveries), sections)


def _chosen_recoveries(camera: SpectralCamera, classes: Sequence[str]) -> list[Recovery]:
    known = [recovery.light_class for recovery in camera.recoveries]
    for name in classes:
        if name not in known:
            raise UsageError(
                f"--class {name}: {camera.where} was calibrated for {', '.join(known)}"
            )
    return [item for item in camera.recoveries if not classes or item.light_class in classes]


def _trained(camera: SpectralCamera, recovery: Recovery) -> _Trained:
    """Return the patches a recovery was made from, estimated by it."""
    chart = next((c for c in camera.charts if c.light_class == recovery.light_class), None)
    if chart is None or not _is_whole(chart):
        none = np.empty((0, len(camera.wavelength_nm)))
        return _Trained(recovery, (), none, none, np.empty((0, 3)))
    assert chart.signals is not None and chart.camera_values is not None  # _is_whole
    if chart.signals.shape[1] != len(camera.wavelength_nm):
        raise LayerError(
            f"{chart.where}: chart:signals have {chart.signals.shape[1]} bands but the camera "
            f"{len(camera.wavelength_nm)}; calibrate the camera again"
        )
    names = chart.patches or tuple(str(1 + index) for index in range(len(chart.signals)))
    colors = display_colors(chart.signals, recovery.illuminant, camera.wavelength_nm)
    estimated = chart.camera_values @ recovery.matrix.T
    return _Trained(recovery, names, chart.signals, estimated, colors)


def _is_whole(chart: ColorChart) -> bool:
    return chart.signals is not None and chart.camera_values is not None


def _available(
    camera: SpectralCamera, trained: _Trained, parts: Sequence[str], notes: list[Note] | None
) -> list[str]:
    """Return the parts that the layer has data for; what it lacks is a note, or an error."""
    recovery = trained.recovery
    lacking = {}
    if not trained.names:
        reason = f"no chart of light class {recovery.light_class} with camera values and signals"
        lacking = {"chromaticity": reason, "spectra": reason}
    if not recovery.patches or any(values is None for values in _errors(recovery)):
        lacking["errors"] = f"no errors per patch of light class {recovery.light_class}"
    known = []
    for name in parts:
        if name not in lacking:
            known.append(name)
        elif notes is None:
            raise LayerError(
                f"{camera.where}: has {lacking[name]}, which --what {name} draws; "
                "calibrate the camera again, or leave it out"
            )
        else:
            where = camera.where
            notes.append(Note("plot-left-out", where, f"{name} not drawn: {lacking[name]}"))
    return known


def _errors(recovery: Recovery) -> tuple[FloatArray | None, ...]:
    return recovery.patch_delta_e_2000, recovery.patch_gfc, recovery.patch_rmse


# --- Parts -------------------------------------------------------------------------------------


def _draw_panels(
    part: Any, *, camera: SpectralCamera, trained: _Trained, panels: Sequence[str]
) -> None:
    """Draw up to three panels side by side."""
    recovery = trained.recovery
    widths = [1.0 if name == "chromaticity" else 1.12 for name in panels]
    grid = part.subplots(1, len(panels), squeeze=False, width_ratios=widths)
    for axes, name in zip(grid.flat, panels, strict=True):
        if name == "sensitivities":
            noise = camera.noise if np.any(camera.noise) else None
            draw_sensitivities(axes, camera.wavelength_nm, camera.responsivity, noise)
        elif name == "diffuser":
            recovered = recovery.matrix @ (recovery.illuminant @ camera.responsivity)
            spectra = recovery.illuminant, recovered, recovery.posterior_stddev
            draw_class_light(axes, camera.wavelength_nm, spectra, camera.units)
        else:
            _draw_chromaticity(axes, camera.wavelength_nm, trained)


def _draw_chromaticity(axes: Any, wavelength_nm: FloatArray, trained: _Trained) -> None:
    measured = signal_chromaticity(trained.measured, wavelength_nm)
    estimated = signal_chromaticity(trained.estimated, wavelength_nm)
    light = signal_chromaticity(trained.recovery.illuminant, wavelength_nm)
    corner = draw_diagram(axes, np.vstack([measured, estimated, light[None]]))
    draw_pairs(axes, measured, estimated)
    axes.plot(*light, "+", color=INK, markersize=7, markeredgewidth=1.0, zorder=6, label="light")
    axes.set_title("Chromaticity, fitted")
    legend_inside(axes, loc=corner, ncols=1, handlelength=1.0)


def _spectra_section(camera: SpectralCamera, trained: _Trained, wanted: Sequence[str]) -> Section:
    recovery, wavelength_nm = trained.recovery, camera.wavelength_nm
    lab = lab_values(trained.measured, recovery.illuminant, wavelength_nm)
    chosen = choose_patches(trained.names, lab, wanted)
    draw = partial(
        draw_patches,
        wavelength_nm=wavelength_nm,
        spectra=(trained.measured[chosen], trained.estimated[chosen]),
        colors=trained.colors[chosen],
        captions=[(trained.names[index], _caption(trained, index)) for index in chosen],
        units=camera.units,
    )
    return Section(0.55 + _ROW_IN * patch_rows(len(chosen)), draw)


def _caption(trained: _Trained, index: int) -> str:
    """Return what leaving a patch out costs it, where the layer says."""
    recovery, name = trained.recovery, trained.names[index]
    if recovery.patch_delta_e_2000 is None or recovery.patch_gfc is None:
        return ""
    if name not in recovery.patches:
        return ""
    at = recovery.patches.index(name)
    delta_e, fit = recovery.patch_delta_e_2000[at], recovery.patch_gfc[at]
    return f"ΔE$_{{00}}$ {delta_e:.2f}, GFC {fit:.4f}"


def _draw_errors(part: Any, *, trained: _Trained) -> None:
    recovery = trained.recovery
    delta_e, fit, rmse = (np.asarray(values) for values in _errors(recovery))
    by_name = dict(zip(trained.names, trained.colors, strict=True))
    grey = np.full(3, 0.75)
    colors = np.array([by_name.get(name, grey) for name in recovery.patches])
    draw_errors(part, recovery.patches, (delta_e, fit, rmse), colors)


# --- Words -------------------------------------------------------------------------------------


def _title(camera: SpectralCamera) -> str:
    return f"Spectral calibration: {camera.model or 'camera of unknown model'}"


def _subtitle(camera: SpectralCamera, recoveries: Sequence[Recovery]) -> str:
    settings = [camera.lens, camera.white_balance and f"white balance {camera.white_balance}"]
    if camera.iso is not None:
        settings.append("ISO " + ", ".join(f"{value:g}" for value in camera.iso))
    wavelength_nm = camera.wavelength_nm
    settings.append(
        f"{wavelength_nm[0]:g} to {wavelength_nm[-1]:g} nm, {len(wavelength_nm)} bands, "
        f"{camera.units}"
    )
    return ";  ".join(text for text in settings if text)


def _class_lines(recovery: Recovery) -> tuple[str, str]:
    """Return what is known about the recovery in one class of light."""
    left_out = _listed(
        ("ΔE$_{00}$", recovery.loo_delta_e_2000, ".2f", ""),
        ("GFC", recovery.loo_gfc, ".4f", ""),
        ("RMSE", 100.0 * recovery.loo_rmse, ".2f", " % of the light's peak"),
    )
    others = _listed(
        ("condition", recovery.condition, ".3g", ""),
        ("|Gt - I|", recovery.identity_error, ".2g", ""),
        ("negative energy", 100.0 * recovery.negative_share, ".2g", " %"),
        ("expected ΔE$_{00}$ of grey", recovery.grey_delta_e, ".2f", ""),
        ("of skin", recovery.skin_delta_e, ".2f", ""),
    )
    first = f"estimator {recovery.estimator}" + (left_out and f";  leave-one-out: {left_out}")
    return first, others


def _listed(*entries: tuple[str, float | None, str, str]) -> str:
    """Return names and values, but for those that are not known."""
    return ", ".join(
        f"{name} {value:{style}}{unit}"
        for name, value, style, unit in entries
        if value is not None and np.isfinite(value)
    )
