"""A sensor simulated in float64, and the files and brackets it fills: the truth of merge tests.

It shares no code with ``usdskin``: photons are Poisson counts, read noise is normal, raw values are
rounded and end at the top of the converter.
"""

from __future__ import annotations

import struct
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import OpenImageIO

from usdskin.prims import ExposureBracket, FisheyeLens, View

LENS = FisheyeLens("equidistant", 100.0, np.array([50.0, 50.0]), (100, 100))


@dataclass(frozen=True)
class Sensor:
    """Raw values of a camera of 14 bits."""

    gain: float = 4.0
    """Electrons per raw value at ISO 100."""

    read_noise: float = 3.0
    """DN"""

    black: Any = 512.0
    """DN, one for all channels or one each."""

    white: float = 16383.0
    top: float = 16383.0

    @property
    def electrons(self) -> Any:
        """Electrons at the white level, at ISO 100."""
        return self.gain * (self.white - np.asarray(self.black))

    def expose(
        self, light: np.ndarray, exposure: float, rng: np.random.Generator, iso: float = 100.0
    ) -> np.ndarray:
        """Return raw values of image values times an exposure, both in units of each other."""
        gain = self.gain * 100.0 / iso
        mean = light * exposure * (self.white - np.asarray(self.black)) * gain
        counted = rng.poisson(np.minimum(mean, 1e9))
        read = rng.normal(0.0, self.read_noise, light.shape)
        return np.clip(np.round(self.black + counted / gain + read), 0.0, self.top)


def write_picture(path: Path, pixels: np.ndarray, sample_type: str = "uint16", **given) -> Path:
    """Write rows of pixels; an int for ``tile`` makes tiles."""
    pixels = np.ascontiguousarray(
        pixels.astype(np.float32 if sample_type == "half" else sample_type)
    )
    spec = OpenImageIO.ImageSpec(*pixels.shape[1::-1], pixels.shape[2], sample_type)
    spec.attribute("oiio:UnassociatedAlpha", 1)
    spec.tile_width = spec.tile_height = given.pop("tile", 0)
    for name, value in given.items():
        spec.attribute(name.replace("__", ":"), value)
    output = OpenImageIO.ImageOutput.create(str(path))
    assert output.open(str(path), spec), output.geterror()
    assert output.write_image(pixels), output.geterror()
    output.close()
    return path


def bracket_view(images: Sequence[Path], times: Sequence[float], **given: Any) -> View:
    """Return a view of photographs at f/1 and ISO 100 unless told otherwise."""
    count = len(images)
    settings = {
        "iso": np.full(count, 100.0),
        "f_number": np.ones(count),
        "nd_factor": np.ones(count),
        "black_level": np.zeros(1),
        **given,
    }
    settings = {
        name: np.atleast_1d(np.asarray(value, float))
        if isinstance(value, int | float | list | tuple | np.ndarray)
        else value
        for name, value in settings.items()
    }
    bracket = ExposureBracket(
        images=tuple(images), exposure_time_s=np.asarray(times, float), **settings
    )
    return View("north", "shoot.usda </Shoot/north>", LENS, bracket, np.eye(3))


def photograph(
    folder: Path,
    light: np.ndarray,
    times: Sequence[float],
    sensor: Sensor | None = None,
    seed: int = 0,
    change: Callable[[int, np.ndarray], np.ndarray] | None = None,
    iso: Sequence[float] | None = None,
    **given: Any,
) -> View:
    """Photograph image values [1/s] at several exposure times, and return the view.

    Args:
        folder: Where the TIFF files go.
        light: Image values, shape [height, width, 3].
        times: Exposure times [s].
        sensor: The camera.
        seed: Of its noise.
        change: Changes the raw values of image k before they are written.
        iso: Sensitivity of each image.
        given: More of the ``ExposureBracket``.
    """
    sensor = sensor or Sensor()
    rng = np.random.default_rng(seed)
    images = []
    isos = np.full(len(times), 100.0) if iso is None else np.asarray(iso, float)
    for k, (time, speed) in enumerate(zip(times, isos, strict=True)):
        raw = sensor.expose(light, time * speed / 100.0, rng, speed)
        raw = raw if change is None else change(k, raw)
        images.append(write_picture(folder / f"{k}.tif", raw))
    levels = {"black_level": sensor.black, "white_level": sensor.white}
    return bracket_view(images, times, iso=isos, **{**levels, **given})


def write_dng(path: Path, mosaic: np.ndarray, black: Sequence[int], white: int) -> Path:
    """Write an uncompressed DNG of a RGGB mosaic (Adobe, "DNG Specification 1.4").

    Args:
        path: The file.
        mosaic: Raw values, shape [height, width], both even.
        black: Raw value without light of the four photosites of a cell, row by row.
        white: Raw value at saturation.
    """
    height, width = mosaic.shape
    data = mosaic.astype("<u2").tobytes()
    identity = [(int(i == j), 1) for i in range(3) for j in range(3)]
    entries: list[tuple[int, str, list[Any]]] = [
        (254, "I", [0]), (256, "I", [width]), (257, "I", [height]), (258, "H", [16]),
        (259, "H", [1]), (262, "H", [32803]), (271, "s", ["usdskin"]), (272, "s", ["Simulated"]),
        (273, "I", [0]), (274, "H", [1]), (277, "H", [1]), (278, "I", [height]),
        (279, "I", [len(data)]), (33421, "H", [2, 2]), (33422, "B", [0, 1, 1, 2]),
        (50706, "B", [1, 4, 0, 0]), (50708, "s", ["usdskin Simulated"]), (50713, "H", [2, 2]),
        (50714, "H", list(black)), (50717, "I", [white]), (50721, "ii", identity),
        (50728, "II", [(1, 1)] * 3), (50778, "H", [21]),
    ]  # fmt: skip
    kinds = {"B": 1, "s": 2, "H": 3, "I": 4, "II": 5, "ii": 10}
    at = 8 + 2 + 12 * len(entries) + 4
    table, rest = b"", b""
    strip = 0
    for tag, kind, values in entries:
        if kind == "s":
            packed = values[0].encode() + b"\0"
            count = len(packed)
        else:
            flat = [part for value in values for part in (value if len(kind) > 1 else [value])]
            packed, count = struct.pack(f"<{len(flat)}{kind[0]}", *flat), len(values)
        if tag == 273:
            strip = len(table) + 8
        if len(packed) > 4:
            rest += b"\0" * (len(rest) % 2)
            packed, rest = struct.pack("<I", at + len(rest)), rest + packed
        table += struct.pack("<HHI", tag, kinds[kind], count) + packed.ljust(4, b"\0")
    begin = struct.pack("<I", at + len(rest))
    table = table[:strip] + begin + table[strip + 4 :]
    header = b"II*\0" + struct.pack("<IH", 8, len(entries))
    path.write_bytes(header + table + struct.pack("<I", 0) + rest + data)
    return path
