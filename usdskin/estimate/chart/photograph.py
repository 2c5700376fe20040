"""The picture of a chart in camera values: merged from its photographs, or as somebody made it."""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from usdskin.device import Workers
from usdskin.errors import ImageError, LayerError
from usdskin.fisheye import check_lens, max_radius, radius_to_angle, scaled, vignetting
from usdskin.images import read_headers, read_image
from usdskin.notes import Note
from usdskin.photographs.development import find_responses
from usdskin.photographs.frames import RAW_SUFFIXES
from usdskin.photographs.glare import find_glare, subtract_glare
from usdskin.photographs.merge import merge_bracket
from usdskin.prims import FisheyeLens, Shoot, View
from usdskin.prims.charts import ColorChart
from usdskin.progress import Progress, SilentProgress

_ROWS = 256
_NODES = 4097  # of the table of V over image height: exact to 1e-7 by linear interpolation
_FLOATING = ("half", "float", "double")


@dataclass(frozen=True, slots=True, eq=False)
class Development:
    """A picture of a chart in camera values rho."""

    values: NDArray[np.float32]
    """rho, free of glare and vignetting; beyond the largest angle of the lens the vignetting is not
    known and not undone [1/s, or as the file holds it], shape [height, width, 3]."""

    variance: NDArray[np.float32] | None
    """Variance of the values; None: the picture does not tell. Shape [height, width, 3]."""

    status: NDArray[np.uint8] | None
    """Bits of ``usdskin.photographs.merge``; None: the picture does not tell. Shape
    [height, width]."""

    lens: FisheyeLens | None
    """Lens of the picture, in its size; None: not known."""

    where: str
    """What it was made from, for errors."""


def develop(
    chart: ColorChart,
    workers: Workers,
    scratch: Path,
    progress: Progress | None = None,
    notes: list[Note] | None = None,
) -> Development:
    """Return the picture of a chart in camera values.

    Args:
        chart: The chart; ``view`` names photographs with their exposures, or ``image_file`` a
            picture that holds camera values.
        workers: Where kernels run.
        scratch: Folder for decoded raw files.
        progress: Told how far the work is.
        notes: Takes what does not stop it.

    Raises:
        LayerError: The chart names no picture, or two; or the exposures contradict the pictures.
        ImageError: A photograph cannot be read, or holds no camera values.
    """
    notes = [] if notes is None else notes
    progress = SilentProgress() if progress is None else progress
    if chart.view is not None and chart.image_file is not None:
        raise LayerError(
            f"{chart.where}: has both chart:view and chart:image:file; keep the one whose picture "
            "is to be measured"
        )
    if chart.view is not None:
        return _merged(chart, chart.view, workers, scratch, progress, notes)
    if chart.image_file is not None:
        return _finished(chart.image_file)
    raise LayerError(
        f"{chart.where}: names no picture of the chart; give chart:view (photographs with their "
        "exposures), chart:image:file (a floating-point picture in camera values) or "
        "chart:cameraValues"
    )


def _merged(
    chart: ColorChart,
    view: View,
    workers: Workers,
    scratch: Path,
    progress: Progress,
    notes: list[Note],
) -> Development:
    shoot = Shoot(where=chart.where, name=chart.name, views=(view,))
    response = find_responses(shoot, scratch, notes).get(view.name)
    merged = merge_bracket(view, workers, scratch, response, progress, notes)
    height, width = merged.status.shape
    lens = scaled(view.lens, (width, height), view.where)
    check_lens(lens, view.where)
    if lens.glare == 0.0:
        glare = find_glare(merged.values, merged.variance, lens, view.where, notes)
        lens = replace(lens, glare=glare)
    subtract_glare(merged.values, merged.variance, lens)
    divide_by_vignetting(merged.values, merged.variance, lens)
    return Development(merged.values, merged.variance, merged.status, lens, view.where)


def divide_by_vignetting(
    values: NDArray[np.float32], variance: NDArray[np.float32], lens: FisheyeLens
) -> None:
    """Divide image values by V(phi), in place, within the largest angle of the lens.

    Args:
        values: Image values, free of glare, shape [height, width, 3].
        variance: Their variance, shape [height, width, 3].
        lens: Lens of the picture, in its size.
    """
    if not len(lens.vignetting):
        return
    nodes = np.linspace(0.0, max_radius(lens), _NODES)
    table = 1.0 / vignetting(lens, radius_to_angle(lens, nodes))
    x = np.square(np.arange(values.shape[1]) + 0.5 - lens.center_px[0])
    for begin in range(0, len(values), _ROWS):
        rows = slice(begin, min(begin + _ROWS, len(values)))
        y = np.square(np.arange(rows.start, rows.stop) + 0.5 - lens.center_px[1])
        radius = np.sqrt(y[:, None] + x)
        factor = np.interp(radius, nodes, table, right=1.0).astype(np.float32)[..., None]
        values[rows] *= factor
        variance[rows] *= factor * factor


def _finished(path: Path) -> Development:
    """Read a picture that holds camera values already."""
    if path.suffix.lower() in RAW_SUFFIXES:
        raise _not_camera_values(path, "is a raw photograph")
    kinds = set(read_headers(path)[0].channel_types)
    if not kinds <= set(_FLOATING):
        raise _not_camera_values(path, f"holds {' and '.join(sorted(kinds))}")
    pixels = read_image(path, channels=("R", "G", "B")).pixels
    finite = np.isfinite(pixels).all(axis=-1)
    if not finite.all():
        y, x = (int(index) for index in np.argwhere(~finite)[0])
        raise ImageError(
            f"{path}: the pixel at x {x}, y {y} is {pixels[y, x].tolist()}; write the picture "
            "again with finite values"
        )
    return Development(pixels, None, None, None, str(path))


def _not_camera_values(path: Path, what: str) -> ImageError:
    return ImageError(
        f"{path}: {what}, so its values depend on an exposure it does not tell; name a Camera with "
        "ExposureBracketAPI by chart:view, or give a floating-point EXR or HDR in camera values"
    )
