"""Find damage in PNG and JPEG files that their readers are silent or too loud about.

OpenImageIO reads a JPEG that was cut short as a picture whose lower part is gray, and libpng prints
its errors before OpenImageIO can report them.
"""

from __future__ import annotations

import zlib
from pathlib import Path
from typing import BinaryIO

_PNG = b"\x89PNG\r\n\x1a\n"
_JPEG = b"\xff\xd8\xff"
_START_OF_SCAN, _END_OF_IMAGE = 0xDA, b"\xff\xd9"
_BLOCK_BYTES = 2**20


def find_damage(file: str | Path) -> str | None:
    """Return what is wrong with a PNG or JPEG file, None where nothing is found.

    Args:
        file: The file; one of another kind is not looked at.

    Raises:
        OSError: The file cannot be read.
    """
    with open(file, "rb") as opened:
        start = opened.read(len(_PNG))
        if start == _PNG:
            return _png_damage(opened)
        if start.startswith(_JPEG):
            return _jpeg_damage(start + opened.read())
    return None


def _png_damage(opened: BinaryIO) -> str | None:
    """Check that all chunks are there, and the checksums of those that hold the picture."""
    while True:
        head = opened.read(8)
        size, kind = int.from_bytes(head[:4], "big"), head[4:]
        is_critical = kind[:1].isupper()
        checksum = zlib.crc32(kind)
        while size > 0 and (block := opened.read(min(size, _BLOCK_BYTES))):
            checksum = zlib.crc32(block, checksum) if is_critical else checksum
            size -= len(block)
        stored = opened.read(4)
        if size > 0 or len(stored) < 4:
            return "it is cut short"
        if is_critical and checksum != int.from_bytes(stored, "big"):
            return f"it is damaged (the checksum of a {kind.decode('latin-1')} chunk is wrong)"
        if kind == b"IEND":
            return None


def _jpeg_damage(data: bytes) -> str | None:
    """Look for the end of the picture behind its first scan (ITU-T T.81, annex B)."""
    at = 2
    while at + 4 <= len(data) and data[at] == 0xFF:
        marker = data[at + 1]
        if marker == _START_OF_SCAN:
            # Inside a scan every 0xff of the data is followed by 0.
            return None if data.find(_END_OF_IMAGE, at) >= 0 else "it is cut short"
        at += 1 if marker == 0xFF else 2 + int.from_bytes(data[at + 2 : at + 4], "big")
    return "it is cut short" if at + 4 > len(data) else None
