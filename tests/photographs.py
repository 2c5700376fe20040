"""Photographs with EXIF, small and of every kind, as a camera would write them."""

from __future__ import annotations

import struct
from datetime import datetime, timedelta
from fractions import Fraction
from pathlib import Path
from typing import Any

import numpy as np
import OpenImageIO

BEGAN = datetime(2026, 11, 22, 14, 5, 0)

_EXIF_BY_NAME = {
    "time": "ExposureTime",
    "f_number": "FNumber",
    "iso": "Exif:PhotographicSensitivity",
    "make": "Make",
    "model": "Model",
    "lens": "Exif:LensModel",
    "orientation": "Orientation",
    "white_balance": "Exif:WhiteBalance",
    "heading": "GPano:PoseHeadingDegrees",
    "pitch": "GPano:PosePitchDegrees",
}

CAMERA = {"make": "Nikon", "model": "Nikon D850", "lens": "Fish 8mm", "orientation": 1}
"""What every photograph tells unless a test says otherwise."""


def write_photo(
    path: Path, pixels: np.ndarray, moment: datetime | None = None, **told: Any
) -> Path:
    """Write one photograph; the ending of its name says which kind.

    Args:
        path: File to write.
        pixels: Values from 0 to 1, shape [height, width, 3] or, of a raw file, [height, width].
        moment: When it was taken.
        told: What EXIF tells, by the names of ``_EXIF_BY_NAME``; None: left out.
    """
    told = {name: value for name, value in {**CAMERA, **told}.items() if value is not None}
    path.parent.mkdir(parents=True, exist_ok=True)
    if path.suffix in (".tif", ".dng", ".nef"):
        path.write_bytes(_tiff(pixels, moment, told, is_raw=path.suffix != ".tif"))
        return path
    kind = {".exr": "float", ".jpg": "uint8", ".png": "uint8"}[path.suffix]
    height, width = pixels.shape[:2]
    spec = OpenImageIO.ImageSpec(width, height, 3, kind)
    for name, value in told.items():
        spec.attribute(_EXIF_BY_NAME[name], value)
    if moment is not None:
        spec.attribute("Exif:DateTimeOriginal", f"{moment:%Y:%m:%d %H:%M:%S}")
        spec.attribute("Exif:SubsecTimeOriginal", f"{moment.microsecond // 1000:03d}")
    spec.attribute("jpeg:subsampling", "4:4:4")
    output = OpenImageIO.ImageOutput.create(str(path))
    assert output.open(str(path), spec), output.geterror()
    assert output.write_image(np.ascontiguousarray(pixels, np.float32))
    output.close()
    return path


def write_bracket(
    folder: Path,
    light: np.ndarray,
    times: Any,
    began: datetime | None = BEGAN,
    suffix: str = ".tif",
    first: int = 1,
    **told: Any,
) -> list[Path]:
    """Write one bracket: ``light`` [1/s] exposed for ``times`` [s], 2 s apart."""
    paths = []
    for index, time in enumerate(times):
        path = folder / f"IMG_{first + index}{suffix}"
        moment = None if began is None else began + timedelta(seconds=2.0 * index)
        settings = {"time": float(time), "iso": 100, "f_number": 8.0, **told}
        paths.append(write_photo(path, np.clip(light * time, 0.0, 1.0), moment, **settings))
    return paths


def disc(height: int = 60, width: int = 80, radius: float = 27.0) -> np.ndarray:
    """Return light in an image circle in the middle of a dark picture, shape [height, width, 3]."""
    y, x = np.mgrid[0:height, 0:width] + 0.5
    away = np.hypot(x - width / 2.0, y - height / 2.0)
    light = np.where(away < radius, 0.5 + 0.3 * np.sin(0.3 * x), 0.0)
    return np.repeat(light[..., None], 3, axis=-1)


# --- TIFF by hand: OpenImageIO leaves the ISO out, and writes no raw files ---------------------


def _tiff(pixels: np.ndarray, moment: datetime | None, told: dict[str, Any], is_raw: bool) -> bytes:
    """Return an uncompressed 16-bit TIFF, or a DNG of a RGGB mosaic (DNG Specification 1.4)."""
    scale = 15872.0 if is_raw else 65535.0
    data = np.rint(pixels * scale + (512.0 if is_raw else 0.0)).astype("<u2")
    height, width = data.shape[:2]
    samples = 1 if is_raw else 3
    exif = [
        (0x829A, 5, told.get("time")), (0x829D, 5, told.get("f_number")),
        (0x8827, 3, told.get("iso")), (0xA434, 2, told.get("lens")),
    ]  # fmt: skip
    if moment is not None:
        exif += [(0x9003, 2, f"{moment:%Y:%m:%d %H:%M:%S}")]
        exif += [(0x9291, 2, f"{moment.microsecond // 1000:03d}")]
    main: list[tuple[int, int, Any]] = [
        (0x100, 4, width), (0x101, 4, height), (0x102, 3, [16] * samples), (0x103, 3, 1),
        (0x106, 3, 32803 if is_raw else 2), (0x10F, 2, told.get("make")),
        (0x110, 2, told.get("model")), (0x112, 3, told.get("orientation", 1)),
        (0x115, 3, samples), (0x116, 4, height), (0x11C, 3, 1),
    ]  # fmt: skip
    if is_raw:
        main += [
            (0xFE, 4, 0), (0x828D, 3, [2, 2]), (0x828E, 1, [0, 1, 1, 2]),
            (0xC612, 1, [1, 4, 0, 0]), (0xC613, 1, [1, 1, 0, 0]), (0xC614, 2, "Test"),
            (0xC61A, 4, 512), (0xC61D, 4, 16384), (0xC621, 10, [1, 0, 0, 0, 1, 0, 0, 0, 1]),
            (0xC628, 5, [1, 1, 1]), (0xC65A, 3, 21),
        ]  # fmt: skip
    strip = data.tobytes()
    head = b"II*\0"
    at = 8 + len(strip)
    exif_bytes = _directory(exif, at)
    main_at = at + len(exif_bytes)
    main += [(0x8769, 4, at), (0x111, 4, 8), (0x117, 4, len(strip))]
    return head + struct.pack("<I", main_at) + strip + exif_bytes + _directory(main, main_at)


def _directory(entries: list[tuple[int, int, Any]], at: int) -> bytes:
    entries = sorted(entry for entry in entries if entry[2] is not None)
    table, rest = struct.pack("<H", len(entries)), b""
    rest_at = at + 2 + 12 * len(entries) + 4
    for tag, kind, value in entries:
        count, packed = _packed(kind, value)
        if len(packed) > 4:
            packed, rest = struct.pack("<I", rest_at + len(rest)), rest + packed
        table += struct.pack("<HHI", tag, kind, count) + packed.ljust(4, b"\0")
    whole = table + struct.pack("<I", 0) + rest
    return whole + b"\0" * (len(whole) % 2)


def _packed(kind: int, value: Any) -> tuple[int, bytes]:
    if kind == 2:
        text = (value if isinstance(value, bytes) else value.encode()) + b"\0"
        return len(text), text + b"\0" * (len(text) % 2)
    values = value if isinstance(value, list) else [value]
    if kind in (5, 10):
        parts = [Fraction(item).limit_denominator(100_000) for item in values]
        flat = [part for item in parts for part in (item.numerator, item.denominator)]
        return len(values), struct.pack(f"<{len(flat)}{'I' if kind == 5 else 'i'}", *flat)
    packed = struct.pack(f"<{len(values)}{ {1: 'B', 3: 'H', 4: 'I'}[kind] }", *values)
    return len(values), packed
