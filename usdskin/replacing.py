"""Let files appear complete or not at all, one by one or together."""

from __future__ import annotations

import os
import secrets
import tempfile
from collections.abc import Iterator, Sequence
from contextlib import contextmanager, suppress
from pathlib import Path

from usdskin.errors import ImageError, UsageError, UsdSkinError


def check_writable(path: Path) -> None:
    """Refuse a file that could not be written in the end, before the work; leave no trace.

    A folder that is missing is made when the file is written.

    Raises:
        UsageError: The name is that of a folder.
        UsdSkinError: The folder cannot be made or written to.
    """
    if os.path.isdir(path):
        raise UsageError(f"{path}: is a folder; name a file")
    check_place(path)


def check_place(path: Path) -> None:
    """Refuse a file or folder that could not be made in the end, before the work; leave no trace.

    Raises:
        UsdSkinError: The folder around it cannot be made or written to.
    """
    folder = next((above for above in path.parents if os.path.lexists(above)), path)
    try:
        # Permission bits do not tell: root passes them, and a read-only disk does not show in them.
        tempfile.TemporaryFile(dir=folder).close()
    except OSError as error:
        raise UsdSkinError(
            f"{path}: cannot be written ({error.strerror}); choose another folder"
        ) from None


@contextmanager
def replacing(path: str | Path) -> Iterator[str]:
    """Give the name of a temporary file that becomes ``path`` when the block ends well.

    Its folder is made where it is missing. The file is flushed to disk before it is renamed, and
    removed when the block raises.

    Raises:
        ImageError: The file cannot be written.
    """
    path = Path(path)
    temporary = path.with_name(f".{path.stem}.{os.getpid()}-{secrets.token_hex(4)}{path.suffix}")
    try:
        if path.is_dir():
            raise ImageError(f"{path}: cannot write; it is a folder, so choose another name.")
        path.parent.mkdir(parents=True, exist_ok=True)
        yield str(temporary)
        with open(temporary, "rb") as file:
            os.fsync(file.fileno())
        os.replace(temporary, path)
    except OSError as error:
        raise ImageError(
            f"{path}: cannot write; {error.strerror or error}; check the folder's permissions and "
            "free space."
        ) from error
    finally:
        with suppress(OSError):
            temporary.unlink(missing_ok=True)


@contextmanager
def scratch_beside(output: str | Path) -> Iterator[Path]:
    """Give a folder on the file system of a file to be written, gone in the end whatever happens.

    Raises:
        ImageError: The file's folder cannot be made or written to.
    """
    output = Path(output)
    try:
        output.parent.mkdir(parents=True, exist_ok=True)
        folder = tempfile.TemporaryDirectory(prefix=f".{output.stem}.", dir=output.parent)
    except OSError as error:
        raise ImageError(
            f"{output.parent}: cannot be written to ({error.strerror}); choose another folder."
        ) from None
    with folder as name:
        yield Path(name)


def replace_all(scratch: Path, paths: Sequence[Path]) -> None:
    """Bring finished files from a scratch folder to where they belong, the first one last.

    The first is the layer that names the others: a reader never sees it without them.

    Args:
        scratch: Folder with all of them, under their names.
        paths: Where they go.

    Raises:
        ImageError: One cannot be put there.
    """
    for path in reversed(paths):
        try:
            os.replace(scratch / path.name, path)
        except OSError as error:
            raise ImageError(
                f"{path}: cannot be written ({error.strerror}); check the folder's permissions."
            ) from None
