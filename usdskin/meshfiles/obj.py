"""Wavefront OBJ: polygons with their own indices for points, texture coordinates and normals.

A reader of our own: tinyobjloader publishes no wheels for Python 3.13 and only a release candidate
of 2.0 (November 2026), and open3d cuts polygons into triangles, which subdivision must not have.
The format is that of the appendix "Object files" of Wavefront's Advanced Visualizer manual.
"""

from __future__ import annotations

from collections.abc import Iterable
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from usdskin.colorimetry import decode_srgb
from usdskin.errors import MeshError
from usdskin.meshfiles.meshfile import FLOAT32_LIMIT, FileMaterial, MeshFile
from usdskin.meshfiles.mtl import read_mtl
from usdskin.meshfiles.text import (
    FACE,
    NAMING,
    NORMAL,
    OTHER,
    TEXTURE,
    VERTEX,
    Statements,
    read_statements,
)
from usdskin.notes import Note

_SLASH = ord("/")
_MISSING = np.iinfo(np.int64).min
"""Stands for the index a corner does not give."""


def read_obj(path: str | Path, notes: list[Note] | None = None) -> MeshFile:
    """Read an OBJ file and the MTL files it names.

    Args:
        path: File to read.
        notes: Takes what the file holds and a mesh cannot, such as curves.

    Returns:
        The mesh. Vertex colors are taken as sRGB, as Blender and MeshLab write them.

    Raises:
        MeshError: The file is missing, no OBJ, damaged or without faces; names file and line.
    """
    path = Path(path)
    notes = notes if notes is not None else []
    statements = read_statements(path)
    if not len(statements.of(VERTEX)):
        raise MeshError(f"{path}: holds no vertices, so is no OBJ mesh; export it again")
    points, colors = _read_points(statements, notes)
    st = _read_vectors(statements, TEXTURE, 2, (1, 2, 3), "texture coordinates")
    normals = _read_vectors(statements, NORMAL, 3, (3,), "normal")
    faces = _drop_short_faces(statements, notes)
    counts, corners = _read_faces(statements, faces)
    corners = _resolve(statements, faces, counts, corners, (len(points), len(st), len(normals)))
    st_indices, st = _complete_st(path, corners[:, 1], st, notes)
    normal_indices = _complete_normals(path, corners[:, 2], notes)
    groups, objects, materials, libraries = _read_names(statements, faces, notes)
    _note_the_rest(statements, notes)
    files = _find_libraries(path, libraries, notes)
    definitions = _read_definitions(files, materials, notes)
    pictures = {item.diffuse_texture: None for item in definitions.values()}
    return MeshFile(
        source=path,
        points=points,
        face_counts=counts.astype(np.int32),
        face_indices=corners[:, 0].astype(np.int32),
        st=st if st_indices is not None else None,
        st_indices=st_indices,
        normals=normals if normal_indices is not None else None,
        normal_indices=normal_indices,
        colors=colors,
        groups=groups,
        objects=objects,
        materials=materials,
        definitions=definitions,
        companions=(*files, *(picture for picture in pictures if picture is not None)),
    )


def _read_points(
    statements: Statements, notes: list[Note]
) -> tuple[NDArray[np.float64], NDArray[np.float32] | None]:
    lines = statements.of(VERTEX)
    widths = statements.tokens[lines]
    odd = ~np.isin(widths, (3, 4, 6, 7))
    if odd.any():
        index = int(lines[np.flatnonzero(odd)[0]])
        raise statements.error(index, f"a vertex has {statements.tokens[index]} numbers, not 3")
    flat = statements.numbers(lines, np.float64, int(widths.sum()))
    start = np.cumsum(widths) - widths
    points = flat[start[:, None] + np.arange(3)]
    _refuse_wild(statements, lines, points, "vertex")
    colored = widths >= 6
    if not colored.any():
        return points, None
    path = str(statements.path)
    if not colored.all():
        notes.append(Note("vertex-colors-dropped", path, "not every vertex has a color"))
        return points, None
    colors = flat[(start + widths - 3)[:, None] + np.arange(3)]
    if not ((colors >= 0.0) & (colors <= 1.0)).all():
        notes.append(Note("vertex-colors-dropped", path, "vertex colors are not all from 0 to 1"))
        return points, None
    return points, decode_srgb(colors).astype(np.float32)


def _read_vectors(
    statements: Statements, kind: int, width: int, allowed: tuple[int, ...], what: str
) -> NDArray[np.float64]:
    lines = statements.of(kind)
    widths = statements.tokens[lines]
    odd = ~np.isin(widths, allowed)
    if odd.any():
        index = int(lines[np.flatnonzero(odd)[0]])
        raise statements.error(index, f"{what}: {statements.tokens[index]} numbers, not {width}")
    flat = statements.numbers(lines, np.float64, int(widths.sum()))
    values = np.zeros((len(lines), width))
    start = np.cumsum(widths) - widths
    for column in range(width):
        there = widths > column
        values[there, column] = flat[start[there] + column]
    _refuse_wild(statements, lines, values, what)
    return values


def _refuse_wild(
    statements: Statements, lines: NDArray[np.int64], values: NDArray[np.float64], what: str
) -> None:
    wild = ~(np.abs(values) <= FLOAT32_LIMIT).all(axis=1)
    if wild.any():
        row = int(np.flatnonzero(wild)[0])
        shown = " ".join(f"{value:g}" for value in values[row])
        raise statements.error(int(lines[row]), f"{what} is {shown}, not finite")


def _drop_short_faces(statements: Statements, notes: list[Note]) -> NDArray[np.int64]:
    lines = statements.of(FACE)
    short = statements.tokens[lines] < 3
    if short.all():
        raise MeshError(
            f"{statements.path}: holds no faces of 3 or more corners; export the mesh with its "
            "polygons"
        )
    if short.any():
        first = int(statements.number[lines[np.flatnonzero(short)[0]]])
        what = f"{int(short.sum())} faces have fewer than 3 corners, the first on line {first}"
        notes.append(Note("short-faces-dropped", str(statements.path), what))
    return lines[~short]


def _read_faces(
    statements: Statements, lines: NDArray[np.int64]
) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """Return the corner counts and the indices as written, ``_MISSING`` where there is none.

    Returns:
        Counts, shape [face_count], and point, st and normal of each corner, shape [corner_count,
        3].
    """
    counts = statements.tokens[lines]
    corners = np.full((int(counts.sum()), 3), _MISSING, dtype=np.int64)
    corner_start = np.cumsum(counts) - counts
    for columns, faces in _by_form(statements, lines, counts):
        chosen, spans = lines[faces], counts[faces]
        text = statements.gather(chosen).replace(b"/", b" ")
        expected = int(spans.sum()) * len(columns)
        try:
            flat = statements.numbers(chosen, np.int64, expected, text)
        except MeshError as error:
            raise _first_odd_face(statements, chosen) or error from None
        within = np.arange(spans.sum()) - np.repeat(np.cumsum(spans) - spans, spans)
        where = np.repeat(corner_start[faces], spans) + within
        corners[where[:, None], np.array(columns)] = flat.reshape(-1, len(columns))
    return counts, corners


def _by_form(
    statements: Statements, lines: NDArray[np.int64], counts: NDArray[np.int64]
) -> list[tuple[tuple[int, ...], NDArray[np.int64]]]:
    """Return which faces are written v, v/vt, v/vt/vn and v//vn, and which indices those give."""
    slashes = statements.count(statements.text == _SLASH, lines)
    pairs = np.zeros(len(statements.text), dtype=bool)
    pairs[:-1] = (statements.text[:-1] == _SLASH) & (statements.text[1:] == _SLASH)
    doubled = statements.count(pairs, lines)
    forms = {
        (0,): slashes == 0,
        (0, 1): (slashes == counts) & (doubled == 0),
        (0, 1, 2): (slashes == 2 * counts) & (doubled == 0),
        (0, 2): (slashes == 2 * counts) & (doubled == counts),
    }
    odd = ~np.logical_or.reduce(list(forms.values()))
    if odd.any():
        raise _first_odd_face(statements, lines[odd]) or statements.error(
            int(lines[odd][0]), "a face is not of the form v, v/vt, v//vn or v/vt/vn"
        )
    return [(columns, np.flatnonzero(held)) for columns, held in forms.items() if held.any()]


def _first_odd_face(statements: Statements, lines: NDArray[np.int64]) -> MeshError | None:
    """Return what is wrong with the first face whose corners are of no form, or of several."""
    for index in lines:
        forms = set()
        for word in statements.line(int(index)).split():
            parts = word.split(b"/")
            if len(parts) > 3 or not parts[0] or not parts[-1]:
                shown = word[:20].decode("utf-8", "replace")
                return statements.error(int(index), f"{shown!r} is not v, v/vt, v//vn or v/vt/vn")
            forms.add(tuple(bool(part) for part in parts))
        if len(forms) > 1:
            return statements.error(int(index), "the corners of a face differ in form")
    return None


def _resolve(
    statements: Statements,
    lines: NDArray[np.int64],
    counts: NDArray[np.int64],
    corners: NDArray[np.int64],
    sizes: tuple[int, int, int],
) -> NDArray[np.int64]:
    """Return indices from 0, -1 where there is none; negative ones count back from their line."""
    resolved = corners - 1
    for column, (kind, what) in enumerate(
        ((VERTEX, "vertex"), (TEXTURE, "texture coordinate"), (NORMAL, "normal"))
    ):
        written = corners[:, column]
        given = written != _MISSING
        backwards = given & (written < 0)
        if backwards.any():
            defined = np.searchsorted(statements.of(kind), np.repeat(lines, counts))
            resolved[backwards, column] = (defined + written)[backwards]
        wrong = given & ((resolved[:, column] < 0) | (resolved[:, column] >= sizes[column]))
        if wrong.any():
            corner = int(np.flatnonzero(wrong)[0])
            line = int(lines[np.searchsorted(np.cumsum(counts), corner, side="right")])
            problem = f"a face refers to {what} {written[corner]}, but there are {sizes[column]}"
            raise statements.error(line, problem)
        resolved[~given, column] = -1
    return resolved


def _complete_st(
    path: Path, indices: NDArray[np.int64], st: NDArray[np.float64], notes: list[Note]
) -> tuple[NDArray[np.int32] | None, NDArray[np.float64]]:
    missing = indices < 0
    if missing.all():
        return None, st
    if missing.any():
        what = f"{int(missing.sum())} corners have no texture coordinates; they get (0, 0)"
        notes.append(Note("st-incomplete", str(path), what))
        indices = np.where(missing, len(st), indices)
        st = np.concatenate([st, np.zeros((1, 2))])
    return indices.astype(np.int32), st


def _complete_normals(
    path: Path, indices: NDArray[np.int64], notes: list[Note]
) -> NDArray[np.int32] | None:
    missing = indices < 0
    if missing.any() and not missing.all():
        what = f"{int(missing.sum())} corners have no normal; all normals are dropped"
        notes.append(Note("normals-incomplete", str(path), what))
    return None if missing.any() else indices.astype(np.int32)


def _read_names(
    statements: Statements, faces: NDArray[np.int64], notes: list[Note]
) -> tuple[
    dict[str, NDArray[np.int32]],
    dict[str, NDArray[np.int32]],
    dict[str, NDArray[np.int32]],
    list[str],
]:
    """Return the faces of groups, objects and materials, and the names of material files."""
    lines = statements.of(NAMING)
    first_face = np.searchsorted(faces, lines)
    changes: dict[str, list[tuple[int, tuple[str, ...]]]] = {"g": [], "o": [], "usemtl": []}
    libraries: list[str] = []
    smoothing = set()
    for index, face in zip(lines, first_face, strict=True):
        text = statements.line(int(index)).decode("utf-8", "replace").strip()
        keyword, _, rest = text.partition(" ")
        words = rest.split()
        if keyword == "mtllib":
            libraries.append(rest.strip())
        elif keyword == "s":
            smoothing.update(words[:1])
        elif keyword == "g":
            changes["g"].append((int(face), tuple(dict.fromkeys(words))))
        else:
            changes[keyword].append((int(face), (rest.strip(),) if words else ()))
    if len(smoothing - {"off", "0"}) > 1:
        what = f"{len(smoothing - {'off', '0'})} smoothing groups; the surface is smooth throughout"
        notes.append(Note("smoothing-groups-dropped", str(statements.path), what))
    groups, objects, materials = (
        _collect(changes[keyword], len(faces)) for keyword in ("g", "o", "usemtl")
    )
    return groups, objects, materials, libraries


def _collect(
    changes: list[tuple[int, tuple[str, ...]]], face_count: int
) -> dict[str, NDArray[np.int32]]:
    spans: dict[str, list[NDArray[np.int32]]] = {}
    ends = [*(face for face, _ in changes), face_count][1:]
    for (begin, names), end in zip(changes, ends, strict=True):
        for name in names if begin < end else ():
            spans.setdefault(name, []).append(np.arange(begin, end, dtype=np.int32))
    return {name: np.concatenate(parts) for name, parts in spans.items()}


def _find_libraries(path: Path, libraries: list[str], notes: list[Note]) -> tuple[Path, ...]:
    found: dict[Path, None] = {}
    for text in libraries:
        # One name with spaces in it, or several names.
        names = [text] if (path.parent / text).is_file() else text.split()
        for name in names:
            file = path.parent / name.replace("\\", "/")
            if file.is_file():
                found[file] = None
            else:
                what = f"the material file {name} is missing; its materials have no color"
                notes.append(Note("material-file-missing", str(path), what))
    return tuple(found)


def _read_definitions(
    files: Iterable[Path], used: Iterable[str], notes: list[Note]
) -> dict[str, FileMaterial]:
    definitions: dict[str, FileMaterial] = {}
    for file in files:
        for name, found in read_mtl(file, notes).items():
            definitions.setdefault(name, found)
    return {name: definitions[name] for name in used if name in definitions}


def _note_the_rest(statements: Statements, notes: list[Note]) -> None:
    lines = statements.of(OTHER)
    lines = lines[statements.tokens[lines] > 0]
    found: dict[str, int] = {}
    for index in lines:
        word = statements.line(int(index)).split(None, 1)[0].decode("utf-8", "replace")[:20]
        found[word] = found.get(word, 0) + 1
    if found:
        shown = ", ".join(f"{count} x {word!r}" for word, count in sorted(found.items())[:8])
        notes.append(Note("obj-statements-ignored", str(statements.path), f"{shown} are left out"))
