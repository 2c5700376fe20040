"""How much memory a picture takes, how much there is, and where spectra go that do not fit."""

from __future__ import annotations

import errno
import math
import os
import shutil
import tempfile
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from usdskin.errors import DeviceError

if TYPE_CHECKING:
    from usdskin.render.products import Product

_AOV_CHANNELS = {"Z": 1, "primId": 1, "st": 2, "crypto_object": 12, "crypto_material": 12}
_BYTES = 4
_LARGEST_SHARE = 0.25
"""Of the free memory; larger spectra are kept on disk."""

_DISK_SHARE = 0.8
"""Of the free space of a disk: its other users need some too."""

_BEAUTY_CHANNELS = 8
"""Accumulated XYZ and alpha, and the RGBA that is written."""


def picture_bytes(product: Product, band_count: int) -> int:
    """Return the size of a product's pixel arrays [B]: one float32 copy of everything written."""
    width, height = product.resolution
    channels = _BEAUTY_CHANNELS + sum(_AOV_CHANNELS.get(aov.source, 3) for aov in product.aovs)
    if product.spectral is not None:
        channels += band_count
    return width * height * channels * _BYTES


def available_bytes() -> int | None:
    """Return the memory this process may still take [B]; None where the system does not say."""
    limits = [limit for limit in (_meminfo(), _control_group()) if limit is not None]
    return min(limits, default=None)


def check_memory(product: Product, band_count: int) -> None:
    """Refuse a picture that cannot fit, before anything is allocated.

    Raises:
        DeviceError: The product's pixels need more memory than there is.
    """
    width, height = product.resolution
    there = available_bytes()
    on_disk = _too_large(width * height * band_count * _BYTES, there)
    needed = picture_bytes(product, 0 if on_disk else band_count)
    if there is not None and needed > there:
        bands = f" with {band_count} bands" if product.spectral is not None else ""
        raise DeviceError(
            f"{product.files[0]}: {width} x {height} pixels{bands} need {needed / 2**30:.1f} GiB "
            f"and {there / 2**30:.1f} GiB are free; make the picture smaller with -w."
        )


def pixel_zeros(
    resolution: tuple[int, int], values: tuple[int, ...], folder: Path | None
) -> NDArray[np.float32]:
    """Return zeros, in memory or, where they would take too much of it, in an unnamed file.

    The system writes the file's pages out and drops them when memory is wanted; the space is
    reserved beforehand, and the file goes with the array.

    Args:
        resolution: Width and height of the picture [px].
        values: Shape of what a pixel holds.
        folder: Where the file may lie; None keeps everything in memory.

    Raises:
        DeviceError: The disk has no room for it.
    """
    shape = (math.prod(resolution), *values)
    size = math.prod(shape) * _BYTES
    if folder is None or not _too_large(size, available_bytes()):
        return np.zeros(shape, np.float32)
    try:
        # Reserving more than there is would fill the disk before it fails.
        if size > _DISK_SHARE * shutil.disk_usage(folder).free:
            raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))
        with tempfile.TemporaryFile(dir=folder) as file:
            os.posix_fallocate(file.fileno(), 0, size)
            return np.memmap(file, np.float32, "r+", shape=shape)
    except OSError as error:
        raise DeviceError(
            f"{folder}: {resolution[0]} x {resolution[1]} pixels have {size / 2**30:.1f} GiB of "
            f"spectra, which fit neither into memory nor here ({error.strerror or error}); free "
            "space, or make the picture smaller with -w."
        ) from None


def _too_large(size: int, there: int | None) -> bool:
    """Return whether an array is to be kept on disk."""
    can = hasattr(os, "posix_fallocate")
    return can and there is not None and size > max(_LARGEST_SHARE * there, 1)


def _meminfo() -> int | None:
    try:
        for line in Path("/proc/meminfo").read_text().splitlines():
            if line.startswith("MemAvailable:"):
                return int(line.split()[1]) * 1024
    except (OSError, ValueError, IndexError):
        pass
    return None


def _control_group() -> int | None:
    """Return what a container's limit leaves [B] (cgroup v2, then v1)."""
    for folder, limit, usage in (
        (Path("/sys/fs/cgroup"), "memory.max", "memory.current"),
        (Path("/sys/fs/cgroup/memory"), "memory.limit_in_bytes", "memory.usage_in_bytes"),
    ):
        try:
            used = int((folder / usage).read_text()) - _reclaimable(folder)
            return max(0, int((folder / limit).read_text()) - used)
        except (OSError, ValueError):  # no such file, or "max"
            continue
    return None


def _reclaimable(folder: Path) -> int:
    """Return the file cache that the kernel drops when memory is wanted [B]."""
    for line in (folder / "memory.stat").read_text().splitlines():
        name, _, value = line.partition(" ")
        if name in ("inactive_file", "total_inactive_file"):
            return int(value)
    return 0
