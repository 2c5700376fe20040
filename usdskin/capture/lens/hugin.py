"""Read the lens of a Hugin or PanoTools project, ``.pto``.

The lens of an ``i`` line is an ideal projection f(phi) whose scale the horizontal field of view v
sets, then a radial polynomial in the image height over half the shorter side, r' = (a r^3 + b r^2 +
c r + 1 - a - b - c) r, then a shift by d, e pixels from the picture's middle (libpano13's
``Optimize.txt`` and ``stitch.txt``; the wiki page "Lens correction model"). Vignetting is
Va + Vb r^2 + Vc r^4 + Vd r^6 with r over half the diagonal (Hugin's ``nona.txt``).
"""

from __future__ import annotations

import re
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from usdskin.capture.lens.curve import IDEAL, Curve, FileLens, named
from usdskin.errors import UsageError, UsdSkinError

FloatArray = NDArray[np.float64]

_PROJECTIONS = {
    2: "equidistant",
    3: "equidistant",
    8: "orthographic",
    10: "stereographic",
    20: "thoby",
    21: "equisolid",
}
"""Codes of f that are fisheye lenses; 2 is the circular one."""

_WIDEST_DEG = {
    "equidistant": 360.0,
    "orthographic": 180.0,
    "stereographic": 350.0,
    "thoby": 250.0,
    "equisolid": 360.0,
}
"""Largest field of view that the width of a picture can stand for [deg]."""

_OTHERS = {0: "rectilinear", 1: "cylindrical", 4: "equirectangular", 7: "a mirror ball"}
_TOKEN = re.compile(r'([A-Za-z]+?)(=\d+|[-+.\d][^\s"]*)(?=\s|$)|n"[^"]*"')
_LENS_KEYS = ("w", "h", "f", "v", "a", "b", "c", "d", "e", "g", "t", "S")
_VIGNETTING_KEYS = ("Vm", "Va", "Vb", "Vc", "Vd", "Vx", "Vy")


def read_hugin(path: Path, image: int | None) -> FileLens:
    """Return the lens of one image of a project.

    Args:
        path: The project.
        image: Number of the image, from 0; by default all must have the same lens.

    Raises:
        UsageError: The image is not there, or must be named.
        UsdSkinError: The file is no project, or its lens is no fisheye or has parameters that
            cannot be held.
    """
    images = _read_images(path)
    if image is not None and not 0 <= image < len(images):
        raise UsageError(f"{path}: --lens {image}: the project has images 0 to {len(images) - 1}")
    if image is None:
        keys = (*_LENS_KEYS, *_VIGNETTING_KEYS)
        lenses = [tuple(line.get(key) for key in keys) for line in images]
        other = next((number for number, lens in enumerate(lenses) if lens != lenses[0]), None)
        if other is not None:
            raise UsageError(
                f"{path}: images 0 and {other} have different lenses; choose one by its image, as "
                "in --lens 0"
            )
    return _lens(f"{path} image {image or 0}", images[image or 0])


def _read_images(path: Path) -> list[dict[str, str]]:
    """Return the fields of every ``i`` line, with links to other images (``v=0``) followed."""
    images: list[dict[str, str]] = []
    for line in path.read_text(encoding="utf-8", errors="replace").splitlines():
        if line.startswith("i "):
            fields = {m[1]: m[2] for m in _TOKEN.finditer(line[2:]) if m[1]}
            for key, value in fields.items():
                if value.startswith("="):
                    source = int(value[1:])
                    if source >= len(images) or key not in images[source]:
                        raise UsdSkinError(
                            f"{path}: image {len(images)} takes {key} from image {source}, which "
                            "does not have it before; save the project again"
                        )
                    fields[key] = images[source][key]
            images.append(fields)
    if not images:
        raise UsdSkinError(f"{path}: has no image ('i' line); give a project saved by Hugin")
    return images


def _number(where: str, fields: dict[str, str], key: str, fallback: float | None = None) -> float:
    if key not in fields:
        if fallback is None:
            raise UsdSkinError(f"{where}: says no {key}; save the project again")
        return fallback
    try:
        value = float(fields[key])
    except ValueError:
        value = float("nan")
    if not np.isfinite(value):
        raise UsdSkinError(f"{where}: {key} is {fields[key]!r}, which is no number")
    return value


def _lens(where: str, fields: dict[str, str]) -> FileLens:
    width, height, code = (int(_number(where, fields, key)) for key in "whf")
    if code not in _PROJECTIONS:
        name = _OTHERS.get(code, "unknown here")
        raise UsdSkinError(f"{where}: projection f{code} is {name}; a fisheye lens is needed")
    for key in ("g", "t", "TiX", "TiY", "TiZ"):
        if _number(where, fields, key, 0.0) != 0.0:
            raise UsdSkinError(
                f"{where}: {key} is {fields[key]}; shear and tilt of the picture cannot be held, "
                "so optimise the project without them"
            )
    projection, field_deg = _PROJECTIONS[code], _number(where, fields, "v")
    if not (width > 0 and height > 0 and 0.0 < field_deg <= _WIDEST_DEG[projection]):
        raise UsdSkinError(
            f"{where}: {width} x {height} pixels with a field of view of {field_deg:g} deg make no "
            f"{projection} picture; correct the project"
        )
    ideal = IDEAL[projection]
    f = 0.5 * width / float(ideal(np.array([0.5 * np.deg2rad(field_deg)]))[0])
    a, b, c, d, e = (_number(where, fields, key, 0.0) for key in "abcde")
    half_side = 0.5 * min(width, height)

    def radius(angle: FloatArray) -> FloatArray:
        r = f * ideal(angle) / half_side
        return np.asarray(half_side * r * (((a * r + b) * r + c) * r + 1.0 - a - b - c))

    center = np.array([width, height]) / 2.0 + [d, e]
    vignetting_shift = [_number(where, fields, key, 0.0) for key in ("Vx", "Vy")]
    return FileLens(
        where=where,
        radius=radius,
        center_px=center,
        resolution=(width, height),
        exact=named(projection, f) if a == b == c == 0.0 else None,
        vignetting=_vignetting(where, fields, 0.5 * float(np.hypot(width, height))),
        vignetting_off_px=float(np.linalg.norm(np.subtract(vignetting_shift, [d, e]))),
        circle_px=_circle_px(fields.get("S", ""), center) if code == 2 else None,
    )


def _vignetting(where: str, fields: dict[str, str], half_diagonal: float) -> Curve | None:
    """Return V over the image height [px]; Hugin knows none but mode 5, radial by division."""
    terms = [_number(where, fields, key, 0.0) for key in ("Vb", "Vc", "Vd")]
    if _number(where, fields, "Vm", 0.0) != 5.0 or not any(terms):
        return None
    terms = [_number(where, fields, "Va", 1.0), *terms]
    return lambda radius: np.asarray(
        np.polynomial.polynomial.polyval((radius / half_diagonal) ** 2, terms)
    )


def _circle_px(selection: str, center: FloatArray) -> float | None:
    """Return how far a circular crop ``left,right,top,bottom`` reaches around the axis [px]."""
    if not re.fullmatch(r"-?\d+(,-?\d+){3}", selection):
        return None
    left, right, top, bottom = (float(word) for word in selection.split(","))
    off = np.hypot(*(np.array([left + right, top + bottom]) / 2.0 - center))
    radius = 0.5 * min(right - left, bottom - top) - float(off)
    return radius if radius > 0.0 else None
