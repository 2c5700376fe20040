"""``ColorChartAPI`` <-> ``ColorChart``."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from pxr import Gf, Sdf, Usd, Vt

from usdskin.errors import LayerError
from usdskin.layers import describe
from usdskin.prims.applied import check_applied_schemas
from usdskin.prims.spectra import read_spectrum, write_spectrum
from usdskin.prims.values import DEFAULT_TIME, read_schema
from usdskin.prims.views import View, read_view
from usdskin.prims.writing import write_schema
from usdskin.spectrum import SpectralQuantity, Spectrum

FloatArray = NDArray[np.float64]

_ILLUMINANT_QUANTITIES = (
    SpectralQuantity.RADIANCE,
    SpectralQuantity.IRRADIANCE,
    SpectralQuantity.RELATIVE,
)


@dataclass(frozen=True, slots=True, eq=False)
class ColorChart:
    """A chart that was photographed and measured; None where the layer says nothing."""

    where: str = ""
    """``layer.usda </Prim/path>``, for errors."""

    name: str = ""
    """Maker and type."""

    layout: str = ""
    """Where its patches are: ``classic24``, ``sg140`` or empty."""

    light_class: str = ""
    """Class of the light it stood in; empty: the name of its prim."""

    patches: tuple[str, ...] | None = None
    """Names of the m patches."""

    camera_values: FloatArray | None = None
    """Camera values rho, shape [m, 3]."""

    camera_values_file: Path | None = None
    """Text file of them: name, R, G, B."""

    wavelength_nm: FloatArray | None = None
    """Wavelengths of signals or reflectances [nm], shape [n]."""

    signals: FloatArray | None = None
    """Radiance of the patches [W m^-2 sr^-1 nm^-1, or relative], shape [m, n]."""

    signals_file: Path | None = None
    """An instrument's file of it."""

    reflectances: FloatArray | None = None
    """Reflectance of the patches [1], shape [m, n]."""

    reflectances_file: Path | None = None
    """An instrument's file of it."""

    illuminant: Spectrum | None = None
    """Radiance of a perfect diffuser in the chart's place."""

    illuminant_name: str = ""
    """Name of the lamp, such as ``FL2``."""

    illuminant_file: Path | None = None
    """An instrument's file of the lamp."""

    units: str = "relative"
    """``absolute`` or ``relative``: what the number 1 of signals and illuminant means."""

    image_file: Path | None = None
    """Picture of the chart in camera values."""

    view: View | None = None
    """The camera whose photographs show the chart."""

    corners: FloatArray | None = None
    """Top left, top right, bottom right and bottom left of the patches in the picture [px], shape
    [4, 2]."""

    model: str = ""
    """Model of the camera."""

    lens: str = ""
    """Model of the lens."""

    white_balance: str = ""
    """White balance and color matrix applied to the pictures; empty for raw values."""

    iso: FloatArray | None = None
    """ISO settings that camera values were divided by, ascending; None: not stated."""


_FIELDS = {
    "name": "chart:name",
    "layout": "chart:layout",
    "light_class": "chart:lightClass",
    "camera_values": "chart:cameraValues",
    "camera_values_file": "chart:cameraValues:file",
    "wavelength_nm": "chart:wavelengths",
    "signals": "chart:signals",
    "signals_file": "chart:signals:file",
    "reflectances": "chart:reflectances",
    "reflectances_file": "chart:reflectances:file",
    "illuminant_name": "chart:illuminant",
    "illuminant_file": "chart:illuminant:file",
    "units": "chart:units",
    "image_file": "chart:image:file",
    "corners": "chart:corners",
    "model": "chart:settings:model",
    "lens": "chart:settings:lens",
    "white_balance": "chart:settings:whiteBalance",
    "iso": "chart:settings:iso",
}
_ARRAYS = ("camera_values", "wavelength_nm", "signals", "reflectances", "corners", "iso")


def read_color_charts(stage: Usd.Stage) -> tuple[ColorChart, ...]:
    """Return the charts of a stage, in its order.

    Raises:
        LayerError: There is none, or an opinion cannot be used.
    """
    found = [prim for prim in stage.Traverse() if prim.HasAPI("ColorChartAPI")]
    if not found:
        name = stage.GetRootLayer().GetDisplayName()
        raise LayerError(
            f"{name}: no prim has ColorChartAPI; author a Scope with it, as docs/estimation.md says"
        )
    return tuple(read_color_chart(prim) for prim in found)


def read_color_chart(prim: Usd.Prim) -> ColorChart:
    """Return what a prim with ``ColorChartAPI`` says.

    Raises:
        LayerError: An opinion cannot be used, or arrays that belong together do not fit.
    """
    check_applied_schemas(prim)
    values = read_schema(prim, "ColorChartAPI", DEFAULT_TIME)
    fields = {field: values[name] for field, name in _FIELDS.items()}
    for field in _ARRAYS:
        if fields[field] is not None and not len(fields[field]):
            fields[field] = None
    if fields["camera_values"] is not None:
        fields["camera_values"] = fields["camera_values"].reshape(-1, 3)
    for field in ("signals", "reflectances"):
        if fields[field] is not None:
            fields[field] = fields[field].reshape(-1, len(fields["wavelength_nm"]))
    view = _view(prim)
    if view is not None and fields["iso"] is None:
        fields["iso"] = _stated_iso(prim, view)
    fields["light_class"] = fields["light_class"] or prim.GetName()
    patches = values["chart:patches"]
    return ColorChart(
        where=describe(prim),
        patches=tuple(patches) if patches else None,
        illuminant=read_spectrum(prim, "illuminant", DEFAULT_TIME, _ILLUMINANT_QUANTITIES),
        view=view,
        **fields,
    )


def _view(prim: Usd.Prim) -> View | None:
    targets = prim.GetRelationship("chart:view").GetTargets()
    if not targets:
        return None
    camera = prim.GetStage().GetPrimAtPath(targets[0])
    if len(targets) > 1 or not camera or not camera.HasAPI("ExposureBracketAPI"):
        listed = ", ".join(f"<{target}>" for target in targets)
        raise LayerError(
            f"{describe(prim)}: chart:view names {listed}; name one Camera with ExposureBracketAPI"
        )
    return read_view(camera)


def _stated_iso(prim: Usd.Prim, view: View) -> FloatArray | None:
    camera = prim.GetStage().GetPrimAtPath(prim.GetRelationship("chart:view").GetTargets()[0])
    if not camera.GetAttribute("bracket:iso").HasAuthoredValue():
        return None
    return np.unique(view.bracket.iso)


def write_color_chart(
    prim: Usd.Prim,
    chart: ColorChart,
    folder: str | Path | None = None,
    view: Sdf.Path | None = None,
) -> None:
    """Apply ``ColorChartAPI`` to a Scope and author a chart.

    Args:
        prim: Scope, written at the stage's edit target.
        chart: What to write; its ``view`` is written by the caller.
        folder: Folder the layer is going to be written to; see ``write_schema``.
        view: Path of the camera whose photographs show the chart.

    Raises:
        LayerError: The prim is no Scope, or a file cannot be named from the layer.
    """
    values = {name: getattr(chart, field) for field, name in _FIELDS.items()}
    if chart.patches is not None:
        values["chart:patches"] = Vt.TokenArray(chart.patches)
    if chart.corners is not None:
        values["chart:corners"] = Vt.Vec2fArray([Gf.Vec2f(*map(float, c)) for c in chart.corners])
    write_schema(prim, "ColorChartAPI", values, folder)
    if view is not None:
        prim.GetRelationship("chart:view").SetTargets([view])
    if chart.illuminant is not None:
        write_spectrum(prim, "illuminant", chart.illuminant)
