"""Photographs as cameras write them: raw values or developed pictures, with EXIF."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import OpenImageIO
from numpy.typing import NDArray

from usdskin.colorimetry import encode_srgb
from usdskin.errors import ImageError, UsageError
from usdskin.images import replacing

FloatArray = NDArray[np.float64]
Rows = Callable[[int, int], NDArray[np.uint16]]

ROWS_PER_BLOCK = 64
"""Rows that are developed and written at once; a block is a unit of noise too."""


def _filmic(x: FloatArray) -> FloatArray:
    """Return an S-shaped curve from (0, 0) to (1, 1): the sRGB curve with a toe and a shoulder."""
    encoded = encode_srgb(x)
    return np.asarray(encoded + 0.12 * encoded * (1.0 - encoded) * (2.0 * encoded - 1.0) * 2.0)


CURVES: Mapping[str, Callable[[FloatArray], FloatArray]] = {
    "srgb": encode_srgb,
    "gamma22": lambda x: np.asarray(x ** (1.0 / 2.2)),
    "filmic": _filmic,
}
"""Tone curves of developed pictures: from exposure relative to white to a value of 0..1."""


@dataclass(frozen=True, slots=True)
class FileKind:
    """How a photograph is stored."""

    suffix: str
    """End of the file's name, with the dot."""

    sample_type: str
    """``uint16``, ``float`` or ``uint8``; a picture of 8 bits is developed by a tone curve."""

    attributes: tuple[tuple[str, Any], ...] = ()
    """How OpenImageIO is to write it."""


KINDS: Mapping[str, FileKind] = {
    "tif": FileKind(".tif", "uint16", (("compression", "none"),)),
    "png": FileKind(".png", "uint16", (("png:compressionLevel", 1),)),
    "exr": FileKind(".exr", "float", (("compression", "zip"),)),
    "jpg": FileKind(".jpg", "uint8", (("compression", "jpeg:98"), ("jpeg:subsampling", "4:4:4"))),
    "png8": FileKind(".png", "uint8", (("png:compressionLevel", 1),)),
}
"""``tif`` and ``png`` hold raw values as they are, ``exr`` raw values over the largest; ``jpg`` and
``png8`` are developed."""


@dataclass(frozen=True, slots=True)
class Development:
    """How raw values become the samples of a file."""

    kind: str
    """One of ``KINDS``."""

    curve: str
    """One of ``CURVES``, for kinds of 8 bits."""

    black_level: int
    """Raw value without light [DN]."""

    white_level: int
    """Largest raw value [DN]."""

    def __post_init__(self) -> None:
        """Check the names.

        Raises:
            UsageError: There is no such kind or curve.
        """
        for name, known in ((self.kind, KINDS), (self.curve, CURVES)):
            if name not in known:
                raise UsageError(f"no format or curve {name!r}; choose one of {', '.join(known)}")

    @property
    def is_developed(self) -> bool:
        """Whether the file holds a developed picture, not raw values."""
        return KINDS[self.kind].sample_type == "uint8"

    @property
    def levels(self) -> tuple[float, float]:
        """Value without light and largest value in the file, as a capture is to know them."""
        if self.is_developed:
            return 0.0, 255.0
        if KINDS[self.kind].sample_type == "float":
            return self.black_level / self.white_level, 1.0
        return float(self.black_level), float(self.white_level)

    def samples(self, raw: NDArray[np.uint16]) -> NDArray[Any]:
        """Return what the file holds for raw values [DN], the same shape."""
        if self.is_developed:
            span = self.white_level - self.black_level
            light = np.clip((raw.astype(np.float64) - self.black_level) / span, 0.0, 1.0)
            return np.rint(255.0 * CURVES[self.curve](light)).astype(np.uint8)
        if KINDS[self.kind].sample_type == "float":
            return raw.astype(np.float32) / np.float32(self.white_level)
        return raw


def write_photograph(
    path: Path,
    size: tuple[int, int],
    rows: Rows,
    development: Development,
    exif: Mapping[str, Any],
) -> None:
    """Write one photograph, a block of rows at a time.

    Args:
        path: File to write.
        size: Width and height [px].
        rows: Gives the raw values of rows ``begin`` to ``end``, shape [end - begin, width, 3].
        development: How they are stored.
        exif: Attributes by OpenImageIO's name.

    Raises:
        ImageError: The file cannot be written; nothing is left behind.
    """
    width, height = size
    kind = KINDS[development.kind]
    spec = OpenImageIO.ImageSpec(width, height, 3, kind.sample_type)
    for name, value in (*kind.attributes, *exif.items()):
        spec.attribute(name, value)
    with replacing(path) as temporary:
        output = OpenImageIO.ImageOutput.create(temporary)
        if output is None or not output.open(temporary, spec):
            raise ImageError(f"{path}: cannot write; {OpenImageIO.geterror() or 'no such format'}.")
        try:
            for begin in range(0, height, ROWS_PER_BLOCK):
                end = min(begin + ROWS_PER_BLOCK, height)
                block = np.ascontiguousarray(development.samples(rows(begin, end)))
                if not output.write_scanlines(begin, end, 0, block):
                    raise ImageError(f"{path}: cannot write; {output.geterror()}; free some space.")
        finally:
            is_closed = output.close()
        if not is_closed:
            raise ImageError(f"{path}: cannot write; check the folder's free space.")
