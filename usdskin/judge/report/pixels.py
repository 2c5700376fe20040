"""What a report knows of every pixel, packed: difference, colours and spectra.

Numbers are rounded to the digits that are shown, so the read-out is right to its last one. Planes
are 16-bit integers, each the difference to its left neighbour, low bytes before high bytes,
deflated (RFC 1950) and written in base64.
"""

from __future__ import annotations

import base64
import zlib
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from usdskin.colorimetry import chromaticity_to_xyz, rgb_to_xyz, xyz_to_lab
from usdskin.errors import ImageError
from usdskin.images import read_headers, read_image, read_spectral
from usdskin.judge.comparison.files import stated_exposure_scale
from usdskin.judge.report.rasters import beauty_pixels
from usdskin.judge.report.records import Comparison

__all__ = [
    "DELTA_STEP",
    "LAB_STEP",
    "NOTHING",
    "Box",
    "Maps",
    "bounding_box",
    "lab_of_beauty",
    "pack",
    "pack_spectra",
    "read_maps",
]

FloatArray = NDArray[np.float64]

DELTA_STEP = 0.01
"""Step of stored CIEDE2000 differences."""

LAB_STEP = 0.1
"""Step of stored L*, a*, b*."""

NOTHING = 65535
"""Stands for a pixel outside the mask."""

_SPECTRA_PER_PICTURE = 4000
_SPECTRAL_ERROR = 1e-3
_AGREEMENT = 0.05


@dataclass(frozen=True, slots=True)
class Box:
    """A rectangle of pixels."""

    x: int
    y: int
    width: int
    height: int

    @property
    def slices(self) -> tuple[slice, slice]:
        """Rows and columns."""
        return slice(self.y, self.y + self.height), slice(self.x, self.x + self.width)

    def as_json(self) -> list[int]:
        """Return it for the script."""
        return [self.x, self.y, self.width, self.height]


@dataclass(frozen=True, slots=True, eq=False)
class Maps:
    """Differences of one picture."""

    delta_e: FloatArray
    """CIEDE2000, NaN outside the mask, shape [height, width]."""

    lab: FloatArray | None
    """Differences of L*, a*, b*, shape [height, width, 3], where the file has them."""


def read_maps(path: Path) -> Maps:
    """Return the maps of ``usdskin compare``.

    Args:
        path: EXR with the channels dE2000, dL, da, db and mask, in one part or in one each.

    Raises:
        ImageError: It is missing, broken or has no dE2000.
    """
    delta = _plane(path, "dE2000")
    if delta is None:
        raise ImageError(f"{path}: has no channel dE2000; `usdskin compare` writes it.")
    mask = _plane(path, "mask")
    inside = np.isfinite(delta) if mask is None else (mask > 0.5) & np.isfinite(delta)
    delta = np.where(inside, delta, np.nan)
    planes = [_plane(path, name) for name in ("dL", "da", "db")]
    there = [plane for plane in planes if plane is not None]
    return Maps(delta, np.stack(there, axis=-1) if len(there) == 3 else None)


def _plane(path: Path, name: str) -> FloatArray | None:
    for index, header in enumerate(read_headers(path)):
        for channel in header.channel_names:
            alone = len(header.channel_names) == 1 and header.name == name
            if channel == name or channel.endswith(f".{name}") or alone:
                image = read_image(path, part=index, channels=[channel])
                return image.pixels[..., 0].astype(np.float64)
    return None


def bounding_box(inside: NDArray[np.bool_]) -> Box:
    """Return the smallest box around what is true; the whole where nothing is."""
    rows, columns = np.flatnonzero(inside.any(axis=1)), np.flatnonzero(inside.any(axis=0))
    if not rows.size:
        return Box(0, 0, inside.shape[1], inside.shape[0])
    x, y = int(columns[0]), int(rows[0])
    return Box(x, y, int(columns[-1]) - x + 1, int(rows[-1]) - y + 1)


def lab_of_beauty(path: Path, comparison: Comparison) -> FloatArray | None:
    """Return L*, a*, b* of a render, its exposure divided out, against a comparison's white.

    Args:
        path: The render.
        comparison: Says Y_n and white.

    Returns:
        Shape [height, width, 3]; None where the comparison does not say its white.
    """
    if comparison.y_n is None or comparison.white is None or not comparison.y_n > 0.0:
        return None
    rgba, space, header = beauty_pixels(path)
    white = comparison.y_n * chromaticity_to_xyz(comparison.white)
    scale = stated_exposure_scale(path, header)
    xyz = np.nan_to_num(rgba[..., :3].astype(np.float64)) @ (rgb_to_xyz(space).T / scale)
    return xyz_to_lab(xyz, white)


def labs_agree(truth: FloatArray, picture: FloatArray, maps: Maps) -> bool:
    """Return whether colours differ as the maps say, so that they are those that were judged."""
    if maps.lab is None or maps.lab.shape != truth.shape:
        return maps.lab is None
    inside = np.isfinite(maps.delta_e)
    error = np.abs((picture - truth - maps.lab)[inside])
    return not error.size or float(np.quantile(error, 0.999)) <= _AGREEMENT


def quantized(values: FloatArray, step: float) -> NDArray[np.int64]:
    """Return values in whole steps, within what 16 bits with a sign hold."""
    return np.clip(np.rint(np.nan_to_num(values) / step), -32768, 32767).astype(np.int64)


def quantized_delta(delta: FloatArray) -> NDArray[np.int64]:
    """Return differences in whole steps, ``NOTHING`` where there is none."""
    steps = np.clip(np.rint(np.nan_to_num(delta) / DELTA_STEP), 0, NOTHING - 1)
    return np.where(np.isfinite(delta), steps, NOTHING).astype(np.int64)


def pack(planes: NDArray[np.int64]) -> str:
    """Return planes of 16-bit integers as text.

    Args:
        planes: Shape [plane_count, height, width].
    """
    change = np.diff(planes, axis=2, prepend=0)
    words = (change & 0xFFFF).astype("<u2").ravel()
    data = np.concatenate([words & 0xFF, words >> 8]).astype(np.uint8).tobytes()
    return base64.b64encode(zlib.compress(data, 9)).decode("ascii")


def pack_spectra(
    pictures: dict[str, Path], inside: NDArray[np.bool_], box: Box
) -> dict[str, Any] | None:
    """Return the spectra of every n-th pixel of some pictures as weights of a common basis.

    Args:
        pictures: Spectral EXR of each picture.
        inside: Which pixels were judged, shape [height, width].
        box: Where they are.

    Returns:
        For the script; None where the files do not fit one another.
    """
    stride = max(1, int(np.ceil(np.sqrt(box.width * box.height / _SPECTRA_PER_PICTURE))))
    begin_y, begin_x = box.y + stride // 2, box.x + stride // 2
    grid = (
        slice(begin_y, box.y + box.height, stride),
        slice(begin_x, box.x + box.width, stride),
    )
    taken, wavelength_nm, units = {}, None, ""
    for name, path in pictures.items():
        nm, cube = read_spectral(path)
        fits = cube.shape[:2] == inside.shape
        if not fits or (wavelength_nm is not None and not np.array_equal(nm, wavelength_nm)):
            return None
        wavelength_nm = nm
        units = str(read_headers(path)[0].attributes.get("emissiveUnits", ""))
        taken[name] = np.nan_to_num(cube[grid].astype(np.float64)) * inside[grid][..., None]
    rows, columns = inside[grid].shape
    if wavelength_nm is None or rows == 0 or columns == 0:
        return None
    matrix = np.concatenate([cube.reshape(-1, len(wavelength_nm)) for cube in taken.values()])
    peak = float(np.abs(matrix).max())
    if not peak > 0.0:
        return None
    basis, step, error = _basis(matrix, peak)
    packed = {
        name: pack(np.moveaxis(quantized(cube @ basis.T, step), -1, 0))
        for name, cube in taken.items()
    }
    return {
        "x": begin_x,
        "y": begin_y,
        "stride": stride,
        "columns": columns,
        "rows": rows,
        "wavelengths": [round(float(nm), 3) for nm in wavelength_nm],
        "units": units,
        "step": step,
        "error": error,
        "basis": [[float(f"{value:.6g}") for value in row] for row in basis],
        "planes": packed,
    }


def _basis(matrix: FloatArray, peak: float) -> tuple[FloatArray, float, float]:
    """Return an orthonormal basis, the step of its weights and the largest error of a band."""
    _, _, directions = np.linalg.svd(matrix, full_matrices=False)
    step = float(f"{peak / 1000.0:.3g}")
    error = np.inf
    for rank in range(1, len(directions) + 1):
        basis = directions[:rank]
        weights = np.rint(matrix @ basis.T / step) * step
        error = float(np.abs(weights @ basis - matrix).max()) / peak
        if error <= 2.0 * _SPECTRAL_ERROR:
            break
    # The sign of a singular vector is anybody's choice.
    signs = np.sign(basis[np.arange(len(basis)), np.abs(basis).argmax(axis=1)])
    return basis * signs[:, None], step, float(f"{error:.2g}")
