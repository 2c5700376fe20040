"""Draw the figure of a layer.

Reads:  ``camera.usda``, ``chart.usda``, ``light.usda`` or ``skin.usda``, and the files they name.
Writes: one figure, ``.svg``, ``.png`` or ``.pdf``.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

from pxr import Usd

from usdskin.errors import LayerError, UsageError
from usdskin.layers import corruption_as_errors, named_files, open_stage
from usdskin.notes import Note
from usdskin.plots.figures import figure_format, save_figure, styled
from usdskin.replacing import check_writable

if TYPE_CHECKING:
    from matplotlib.figure import Figure

_OTHERS = ("SpectralCameraAPI", "ColorChartAPI", "SpectralLightAPI")
"""What a layer is drawn for where its default prim is no skin."""


_LAYER_SUFFIXES = (".usd", ".usda", ".usdc", ".usdz")


@dataclass(frozen=True, slots=True)
class PlotOptions:
    """What to show."""

    what: tuple[str, ...] = ()
    """Parts of the figure; all where empty."""

    patches: tuple[str, ...] = ()
    """Patches of a camera's chart whose spectra are drawn; a dozen where empty."""

    classes: tuple[str, ...] = ()
    """Light classes of a camera to show; all where empty."""


def plot_file(
    path: Path, output: Path, options: PlotOptions | None = None, notes: list[Note] | None = None
) -> Path:
    """Draw what is in a layer.

    Args:
        path: Layer with a calibrated camera, a colour chart, a spectral light or a skin.
        output: Figure to write, ``.svg``, ``.png`` or ``.pdf``.
        options: What to show.
        notes: Takes what could not be drawn; without a list that is an error.

    Returns:
        ``output``, once it is complete on disk.

    Raises:
        LayerError: The layer holds none of them, or lacks what was asked for.
        UsageError: An option does not fit what the layer holds; matplotlib is not installed.
        ImageError: A map cannot be read, or the figure cannot be written.
    """
    options = options or PlotOptions()
    _check_figure(output)
    with corruption_as_errors(path):
        figure, inputs = _draw(path, open_stage(path, notes), options, notes)
    if output.resolve() in {file.resolve() for file in inputs}:
        raise UsageError(f"{output}: is drawn in this figure; write to another name")
    return save_figure(figure, output)


def check_figure(output: Path, layer: Path, inputs: Iterable[Path | None]) -> None:
    """Refuse a figure that a step could not draw in the end, or that would destroy a file.

    Args:
        output: Figure to write.
        layer: Layer that the step writes first.
        inputs: Files the step reads; what the layers among them name is safe too. None: no file.

    Raises:
        LayerError: An input is a broken layer.
        UsageError: Another kind of file, matplotlib is not installed, or the figure is an input.
        UsdSkinError: The folder cannot be made or written to.
    """
    _check_figure(output)
    taken = {layer.resolve()}
    for path in inputs:
        if path is None:
            continue
        taken.add(path.resolve())
        if path.suffix in _LAYER_SUFFIXES and path.is_file():
            taken |= named_files(path)
    if output.resolve() in taken:
        raise UsageError(f"{output}: is a file of this step; draw under another name")


def _check_figure(output: Path) -> None:
    figure_format(output)
    check_writable(output)
    with styled():
        pass  # refuse before the work where there is no matplotlib


def _draw(
    path: Path, stage: Usd.Stage, options: PlotOptions, notes: list[Note] | None
) -> tuple[Figure, list[Path]]:
    """Return the figure of what a stage holds, and the pictures it was drawn from."""
    skin = _skin_prim(path, stage)
    if skin is None and _with_schema(stage, "SpectralCameraAPI"):
        from usdskin.plots.camera import draw_camera
        from usdskin.prims import read_spectral_camera

        camera = read_spectral_camera(stage)
        return draw_camera(
            camera, notes, what=options.what, patches=options.patches, classes=options.classes
        ), []
    for name, given in (("--patches", options.patches), ("--class", options.classes)):
        if given:
            raise UsageError(f"{name}: chooses what the figure of a camera shows; {path} has none")
    if skin is not None:
        from usdskin.plots.skin import draw_skin
        from usdskin.plots.skins import read_drawn_skin

        return draw_skin(read_drawn_skin(skin, notes), notes, what=options.what), []
    if _with_schema(stage, "ColorChartAPI"):
        from usdskin.plots.chart import draw_chart
        from usdskin.plots.charts import read_chart_figure
        from usdskin.prims import read_color_charts

        charts = read_color_charts(stage)
        assumed: list[Note] = [] if notes is None else notes
        shown = [read_chart_figure(chart, assumed) for chart in charts]
        pictures = [chart.image_file for chart in charts if chart.image_file is not None]
        return draw_chart(shown, notes, what=options.what), pictures
    from usdskin.plots.light import draw_light
    from usdskin.plots.lights import light_files, read_light_spectra

    prim = _light_prim(path, stage)
    return draw_light(read_light_spectra(prim), notes, what=options.what), light_files(prim)


def _with_schema(stage: Usd.Stage, schema: str) -> list[Usd.Prim]:
    return [prim for prim in stage.Traverse() if prim.HasAPI(schema)]


def _skin_prim(path: Path, stage: Usd.Stage) -> Usd.Prim | None:
    """Return the skin that a layer is about: its default prim, or one where nothing else is."""
    skins = _with_schema(stage, "SkinMaterialAPI")
    default = stage.GetDefaultPrim()
    if default and default in skins:
        return default
    if not skins or any(_with_schema(stage, schema) for schema in _OTHERS):
        return None
    if len(skins) > 1:
        raise LayerError(
            f"{path}: several materials have SkinMaterialAPI ({_listed(skins)}); draw the layer of "
            "one of them, or set defaultPrim"
        )
    return skins[0]


def _light_prim(path: Path, stage: Usd.Stage) -> Usd.Prim:
    lights = _with_schema(stage, "SpectralLightAPI")
    default = stage.GetDefaultPrim()
    if default and default in lights:
        return default
    if not lights:
        raise LayerError(
            f"{path}: has no calibrated camera, no colour chart and no spectral light or skin; "
            "`usdskin calibrate` and `usdskin estimate` write what can be drawn"
        )
    if len(lights) > 1:
        raise LayerError(
            f"{path}: several lights have SpectralLightAPI ({_listed(lights)}); draw the layer of "
            "one of them, or set defaultPrim"
        )
    return lights[0]


def _listed(prims: Iterable[Usd.Prim]) -> str:
    return ", ".join(f"<{prim.GetPath()}>" for prim in prims)
