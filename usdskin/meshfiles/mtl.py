"""MTL, the materials beside an OBJ: what a ``UsdPreviewSurface`` can take over."""

from __future__ import annotations

import math
from pathlib import Path
from typing import Any

from usdskin.errors import MeshError
from usdskin.meshfiles.meshfile import FileMaterial
from usdskin.notes import Note

_IGNORED = {"ka", "ks", "ke", "ns", "tf", "illum", "sharpness"}
"""Statements of the Phong model, which have no like in a ``UsdPreviewSurface``."""

_OPTIONS = {
    **dict.fromkeys(("-blendu", "-blendv", "-boost", "-bm", "-cc", "-clamp", "-imfchan"), 1),
    **dict.fromkeys(("-texres", "-type"), 1),
    **dict.fromkeys(("-o", "-s", "-t"), 3),
    "-mm": 2,
}
"""Texture options and the most words after them."""


def read_mtl(path: Path, notes: list[Note]) -> dict[str, FileMaterial]:
    """Return the materials of an MTL file by name.

    ``Kd`` is taken as linear, and ``Pr`` and ``Pm`` as roughness and metallic of the physically
    based extension (Exocortex, 2014).

    Raises:
        MeshError: A number is wrong; names file and line.
    """
    text = path.read_bytes().decode("utf-8", "replace")
    materials: dict[str, dict[str, Any]] = {}
    current: dict[str, Any] = {}
    left_out: dict[str, int] = {}
    for number, line in enumerate(text.splitlines(), start=1):
        keyword, _, rest = line.partition("#")[0].strip().replace("\t", " ").partition(" ")
        keyword, rest = keyword.lower(), rest.strip()
        where = f"{path}:{number}"
        if keyword == "newmtl":
            current = materials.setdefault(rest, {})
        elif keyword == "kd":
            current["diffuse_color"] = _color(where, rest)
        elif keyword == "map_kd":
            current["diffuse_texture"] = _texture(path, where, rest, notes)
        elif keyword in ("d", "tr"):
            value = _number(where, rest.split()[-1] if rest else "", 0.0, 1.0)
            current["opacity"] = value if keyword == "d" else 1.0 - value
        elif keyword == "ni":
            current["ior"] = _number(where, rest, 1.0, 10.0)
        elif keyword in ("pr", "pm"):
            name = "roughness" if keyword == "pr" else "metallic"
            current[name] = _number(where, rest, 0.0, 1.0)
        elif keyword and keyword not in _IGNORED:
            left_out[keyword] = left_out.get(keyword, 0) + 1
    if left_out:
        shown = ", ".join(sorted(left_out))
        notes.append(Note("mtl-statements-ignored", str(path), f"{shown} are left out"))
    return {name: FileMaterial(**values) for name, values in materials.items()}


def _color(where: str, text: str) -> tuple[float, float, float]:
    words = text.split()
    if len(words) not in (1, 3):
        raise MeshError(f"{where}: Kd {text[:40]} is not a red, a green and a blue number")
    values = [_number(where, word, 0.0, 1e6) for word in words]
    # Green and blue may be left out: they are then as the red.
    return values[0], values[len(values) // 2], values[-1]


def _number(where: str, text: str, low: float, high: float) -> float:
    try:
        value = float(text)
    except ValueError:
        value = math.nan
    if not low <= value <= high:
        raise MeshError(f"{where}: {text[:20]!r} is not a number from {low:g} to {high:g}")
    return value


def _texture(path: Path, where: str, text: str, notes: list[Note]) -> Path | None:
    words = text.split()
    options = []
    skipped = 0
    while skipped + 1 < len(words) and words[skipped] in _OPTIONS:
        options.append(words[skipped])
        most = _OPTIONS[words[skipped]]
        skipped += 2
        while most > 1 and skipped + 1 < len(words) and _is_number(words[skipped]):
            skipped, most = skipped + 1, most - 1
    # The name may hold spaces.
    name = text.split(None, skipped)[-1].strip() if words else ""
    if options:
        what = f"texture options {' '.join(options)} are left out"
        notes.append(Note("texture-options-ignored", where, what))
    file = path.parent / name.replace("\\", "/")
    if not file.is_file():
        notes.append(Note("texture-missing", where, f"the texture {name} is missing; left out"))
        return None
    return file


def _is_number(word: str) -> bool:
    try:
        float(word)
    except ValueError:
        return False
    return True
