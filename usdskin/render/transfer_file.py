"""The binary file beside ``transfer.usda``: what was measured, mesh by mesh.

A NumPy archive (.npz) without pickles. ``meshes`` and ``hashes`` name all geometry that stood in
the way. Per baked mesh k there are ``k/weakened`` (bits, [row_count, word_count]), ``k/first``
([row_count + 1]) and, for directions from which some light arrives, ``k/direction``, ``k/clear``
(255 is all) and ``k/length`` (in millimetres), shape [entry_count].
"""

from __future__ import annotations

import zipfile
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from usdskin.errors import LayerError
from usdskin.replacing import replacing

_PART_TYPES = {
    "weakened": np.uint32,
    "first": np.int64,
    "direction": np.uint16,
    "clear": np.uint8,
    "length": np.float16,
}
_LARGEST_PART = 1 << 33
_REMEDY = "bake it again with `usdskin bake`"


@dataclass(frozen=True, slots=True, eq=False)
class MeshTransfer:
    """What was measured at the places of one mesh."""

    weakened: NDArray[np.uint32]
    """A bit per direction that is not clear, shape [row_count, word_count]."""

    first: NDArray[np.int64]
    """First entry of each row, and one past the last, shape [row_count + 1]."""

    direction: NDArray[np.uint16]
    """Directions from which some of the light arrives, shape [entry_count]."""

    clear: NDArray[np.uint8]
    """Share that other bodies let pass [1/255], shape [entry_count]."""

    length: NDArray[np.float16]
    """Way inside the own body [mm], shape [entry_count]."""

    def hidden(self) -> NDArray[np.uint32]:
        """Return the bits of the directions from which less than half of the light comes.

        Light that crosses the own body is not among it: nothing is mirrored through skin.
        """
        clear = (self.clear >= 128) & (self.length == 0)
        row = np.repeat(np.arange(len(self.weakened)), np.diff(self.first))[clear]
        place = self.direction[clear].astype(np.int64)
        found = self.weakened.copy()
        bits = np.left_shift(np.uint32(1), (place % 32).astype(np.uint32))
        np.bitwise_and.at(found, (row, place // 32), ~bits)
        return found


def kept(
    weakened: NDArray[np.uint32],
    first: NDArray[np.int64],
    direction: NDArray[np.int32],
    clear: NDArray[np.float32],
    length: NDArray[np.float32],
) -> MeshTransfer:
    """Return measurements as they are kept.

    Args:
        weakened: A bit per direction that is not clear, shape [row_count, word_count].
        first: First entry of each row, and one past the last, shape [row_count + 1].
        direction: Directions from which some of the light arrives, shape [entry_count].
        clear: Share that other bodies let pass [1], above 0, shape [entry_count].
        length: Way inside the own body [m], shape [entry_count].
    """
    millimetres = np.minimum(length * 1e3, 6e4).astype(np.float16)
    # A way too short for the format is still a way through the body.
    inside = length > 0.0
    millimetres[inside] = np.maximum(millimetres[inside], np.float16(6e-8))
    steps = np.rint(clear * 255.0).astype(np.uint8)
    return MeshTransfer(weakened, first, direction.astype(np.uint16), steps, millimetres)


def joined(parts: Sequence[MeshTransfer]) -> MeshTransfer:
    """Return the rows of several transfers, one after the other."""
    ends = np.cumsum([0, *(part.first[-1] for part in parts)])
    firsts = [part.first[:-1] + end for part, end in zip(parts, ends, strict=False)]
    return MeshTransfer(
        np.concatenate([part.weakened for part in parts]),
        np.concatenate([*firsts, ends[-1:]]),
        np.concatenate([part.direction for part in parts]),
        np.concatenate([part.clear for part in parts]),
        np.concatenate([part.length for part in parts]),
    )


def write_transfers(path: Path, transfers: Sequence[MeshTransfer], hashes: dict[str, str]) -> None:
    """Write the file of a layer, whole or not at all.

    Args:
        path: File to write.
        transfers: What was measured, mesh by mesh.
        hashes: Hash of all geometry by prim path.

    Raises:
        ImageError: The file cannot be written.
    """
    arrays: dict[str, NDArray[np.generic]] = {
        "meshes": np.array(list(hashes), dtype=np.str_),
        "hashes": np.array(list(hashes.values()), dtype=np.str_),
    }
    for k, transfer in enumerate(transfers):
        for name in _PART_TYPES:
            arrays[f"{k}/{name}"] = getattr(transfer, name)
    with replacing(path) as temporary:
        np.savez_compressed(temporary, **arrays)  # type: ignore[arg-type]


class TransferFile:
    """A file of measurements, opened for reading."""

    def __init__(self, path: Path) -> None:
        """Open a file.

        Raises:
            LayerError: It is missing or damaged.
        """
        self.path = path
        try:
            self._archive = np.load(path, allow_pickle=False)
            if not isinstance(self._archive, np.lib.npyio.NpzFile):
                raise ValueError("no archive")
            archive = self._archive.zip
            if archive is None:
                raise ValueError("no archive")
            self._sizes = {item.filename: item.file_size for item in archive.infolist()}
        except FileNotFoundError:
            raise LayerError(f"{path}: no such file; {_REMEDY}") from None
        except (OSError, ValueError, EOFError, zipfile.BadZipFile):
            raise self._damaged("is not a transfer") from None

    def _damaged(self, what: str) -> LayerError:
        return LayerError(f"{self.path}: {what}; {_REMEDY}")

    def _array(self, name: str) -> NDArray[np.generic]:
        if not 0 < self._sizes.get(f"{name}.npy", 0) < _LARGEST_PART:
            raise self._damaged(f"has no usable part {name}")
        try:
            return np.asarray(self._archive[name])
        except (OSError, ValueError, KeyError, EOFError, zipfile.BadZipFile, MemoryError):
            raise self._damaged(f"its part {name} is damaged") from None

    def hashes(self) -> dict[str, str]:
        """Return the hashes of all geometry that stood in the way, by prim path."""
        names, values = self._array("meshes"), self._array("hashes")
        if names.dtype.kind != "U" or values.dtype.kind != "U" or names.shape != values.shape:
            raise self._damaged("its geometry is not named")
        return dict(zip(names.ravel().tolist(), values.ravel().tolist(), strict=True))

    def transfer(self, index: int, row_count: int, direction_count: int) -> MeshTransfer:
        """Return the measurements of a mesh.

        Args:
            index: Which mesh of the file.
            row_count: Places of the mesh.
            direction_count: Directions of the transfer.

        Raises:
            LayerError: They are missing or damaged, or of other counts.
        """
        words = -(-direction_count // 32)
        expected = 4 * row_count * words + 4096
        if self._sizes.get(f"{index}/weakened.npy", 0) > expected:
            raise self._damaged(f"its part {index}/weakened is too large")
        parts = {name: self._array(f"{index}/{name}") for name in _PART_TYPES}
        for name, dtype in _PART_TYPES.items():
            if parts[name].dtype != dtype:
                raise self._damaged(f"its part {index}/{name} is of another kind")
        first, entries = parts["first"], len(parts["direction"].ravel())
        right = parts["weakened"].shape == (row_count, words) and first.shape == (row_count + 1,)
        right &= all(parts[name].shape == (entries,) for name in ("direction", "clear", "length"))
        if not right:
            raise self._damaged(f"its parts {index} are of other counts than the mesh")
        transfer = MeshTransfer(**parts)  # type: ignore[arg-type]
        right = transfer.first[0] == 0 and transfer.first[-1] == entries
        right &= bool((np.diff(transfer.first) >= 0).all())
        right &= not entries or int(transfer.direction.max()) < direction_count
        right &= bool(np.isfinite(transfer.length).all() and (transfer.length >= 0).all())
        if not right:
            raise self._damaged(f"its parts {index} contradict one another")
        return transfer

    def close(self) -> None:
        """Close the file."""
        self._archive.close()
