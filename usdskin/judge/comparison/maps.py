"""The maps of a comparison as files: one float EXR of all of them, and a picture with its scale.

Writes: ``X.difference.exr`` (channels dE2000, dE76, dL, da, db, flip, mask, with spectra gfc and
rmse; 0 outside the mask) and ``X.difference.png``, CIEDE2000 in colours with a legend. Both carry
mask, Y_n, white and figures in their headers.
"""

from __future__ import annotations

import json
from collections.abc import Iterable
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from usdskin import __version__
from usdskin.capture.quality.drawing import text_width, write
from usdskin.errors import UsageError
from usdskin.images import Part, write_exr, write_png
from usdskin.judge.comparison.compare import Comparison
from usdskin.replacing import check_writable

FloatImage = NDArray[np.float32]

_LEAST_HEIGHT, _MOST_HEIGHT = 420, 2160
_TOPS = (0.5, 1.0, 2.0, 3.0, 5.0, 10.0, 20.0, 50.0, 100.0)
_PAPER, _INK, _FAINT = (250, 250, 250), (20, 20, 20), (110, 110, 110)
_OUTSIDE = (205, 205, 205)
_OVER = (255, 0, 200)
"""Differences beyond the scale: a colour that the scale has not."""


def map_files(output: Path, stem: str, compared: Iterable[Path]) -> list[Path]:
    """Return the names of the EXR and the PNG, or of the PNG alone where it is named.

    Args:
        output: A folder, or a file that ends in .exr or .png.
        stem: Name of the judged picture without suffixes.
        compared: The pictures, which stay as they are.

    Raises:
        UsageError: It is a file of another kind, or one of the pictures.
        UsdSkinError: The folder cannot be made or written to.
    """
    kind = output.suffix.lower()
    if output.is_dir() or not kind:
        files = [output / f"{stem}.difference{suffix}" for suffix in (".exr", ".png")]
    elif kind in (".exr", ".png"):
        files = [output] if kind == ".png" else [output, output.with_suffix(".png")]
    else:
        raise UsageError(f"-o {output}: give a folder, or a name that ends in .exr or .png.")
    taken = {path.resolve() for path in compared}
    for file in files:
        if file.resolve() in taken:
            raise UsageError(f"{file}: this is one of the pictures compared; choose another name.")
        check_writable(file)
    return files


def write_maps(comparison: Comparison, output: str | Path) -> list[Path]:
    """Write the maps of a comparison.

    Args:
        comparison: What ``compare_pictures`` returned.
        output: A folder, which is made, or a file: the EXR, with the PNG beside it, or the PNG.

    Returns:
        The files written.

    Raises:
        UsageError: The name is neither a folder nor that of a picture, or a picture compared.
        UsdSkinError: They cannot be written.
    """
    files = map_files(Path(output), comparison.stem, (comparison.truth, comparison.picture))
    said = json.dumps(comparison.as_json(), sort_keys=True)
    header = {"usdskin/version": __version__, "usdskin/comparison": said}
    for file in files:
        if file.suffix.lower() == ".png":
            write_png(file, heat_map(comparison), header)
        else:
            write_exr(file, [Part("difference", _layers(comparison), header)])
    return files


def _layers(comparison: Comparison) -> dict[str, FloatImage]:
    layers = {
        name: np.where(comparison.mask, values, 0.0).astype(np.float32)
        for name, values in comparison.maps.items()
    }
    return {**layers, "mask": comparison.mask.astype(np.float32)}


def scale_top(comparison: Comparison) -> float:
    """Return the top of the scale: the first round number that the 99th percentile is below."""
    high = float(np.percentile(comparison.maps["dE2000"][comparison.mask], 99.0))
    return next((top for top in _TOPS if high <= top), _TOPS[-1])


def heat_map(comparison: Comparison) -> NDArray[np.uint8]:
    """Return CIEDE2000 in colours, with a legend and the figures.

    Returns:
        sRGB, shape [rows, columns, 3].
    """
    import cv2

    height = comparison.mask.shape[0]
    factor = max(1, -(-_LEAST_HEIGHT // height)) if height <= _MOST_HEIGHT else 1
    top = scale_top(comparison)
    colors = _colors(np.where(comparison.mask, comparison.maps["dE2000"], 0.0), top)
    colors[~comparison.mask] = _OUTSIDE
    picture = cv2.resize(colors, None, fx=factor, fy=factor, interpolation=cv2.INTER_NEAREST)
    letter = max(10.0, picture.shape[0] / 45.0)
    lines = _caption(comparison)
    most = max(text_width(line, letter) for line in lines)
    margin = round(2.0 * letter)
    legend = round(12.0 * letter)
    foot = round(2.2 * letter * len(lines) + 2.5 * letter)
    page_width = max(picture.shape[1] + legend, most) + 2 * margin
    page = np.empty((picture.shape[0] + margin + foot, page_width, 3), np.float32)
    page[:] = _PAPER
    page[margin : margin + picture.shape[0], margin : margin + picture.shape[1]] = picture
    _draw_legend(page, (margin + picture.shape[1] + margin, margin), picture.shape[0], top, letter)
    baseline = margin + picture.shape[0] + 2.6 * letter
    for line in lines:
        write(page, line, (margin, baseline), letter, _INK)
        baseline += 2.2 * letter
    return np.asarray(np.clip(np.round(page), 0, 255), dtype=np.uint8)


def _colors(values: NDArray[np.float64], top: float) -> FloatImage:
    """Return the colours of differences, shape [..., 3]."""
    import cv2

    level = np.clip(np.round(255.0 * values / top), 0, 255).astype(np.uint8)
    colors = cv2.applyColorMap(level.reshape(-1, 1), cv2.COLORMAP_VIRIDIS)[..., ::-1]
    result = colors.reshape(*values.shape, 3).astype(np.float32)
    result[values > top] = _OVER
    return np.ascontiguousarray(result)


def _draw_legend(
    page: FloatImage, place: tuple[int, int], height: int, top: float, letter: float
) -> None:
    left, upper = place
    wide = round(2.0 * letter)
    first = upper + round(5.0 * letter)
    last = upper + height - round(3.5 * letter)
    ramp = np.linspace(top, 0.0, last - first)[:, None].repeat(wide, axis=1)
    page[first:last, left : left + wide] = _colors(ramp, top)
    box = round(1.2 * letter)
    page[first - 2 * box : first - box, left : left + wide] = _OVER
    write(page, "dE2000", (left, upper + letter), letter, _INK, bold=True)
    text = left + wide + 0.7 * letter
    write(page, f"> {top:g}", (text, first - 1.5 * box + 0.5 * letter), letter, _INK)
    for share in (0.0, 0.25, 0.5, 0.75, 1.0):
        row = first + (1.0 - share) * (last - first - 1)
        page[round(row), left + wide : left + wide + round(0.4 * letter)] = _INK
        write(page, f"{share * top:g}", (text, row + 0.5 * letter), letter, _INK)
    page[last + box : last + 2 * box, left : left + wide] = _OUTSIDE
    write(page, "not judged", (text, last + 1.5 * box + 0.5 * letter), letter, _FAINT)


def _caption(comparison: Comparison) -> list[str]:
    found = comparison.statistics("dE2000")
    x, y = comparison.white
    return [
        _ascii(f"{comparison.picture.name} against {comparison.truth.name}"),
        "dE2000 "
        + ", ".join(f"{name} {found[name]:.3g}" for name in ("mean", "median", "p95", "max")),
        f"Y_n {comparison.diffuser_xyz[1]:.5g}, white x {x:.4f} y {y:.4f}, {comparison.observer}",
        _ascii(f"mask {comparison.mask_from}: {int(comparison.mask.sum())} pixels"),
    ]


def _ascii(text: str) -> str:
    return text.encode("ascii", "replace").decode()
