"""Read a lens that OpenCV, or a tool in its terms, has written: YAML, XML or JSON.

Read are OpenCV's own files (``camera_matrix``, ``distortion_coefficients``, with ``xi`` those of
``cv2.omnidir``), ROS ``camera_info`` and Kalibr's camera chains. OpenCV counts pixels from the
middle of the first one.
"""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from usdskin.capture.lens.curve import FileLens
from usdskin.capture.lens.models import MODELS
from usdskin.errors import UsageError, UsdSkinError

FloatArray = NDArray[np.float64]

_MATRIX = ("camera_matrix", "cameramatrix", "k", "intrinsic_matrix", "intrinsics", "mtx")
_DISTORTION = (
    "distortion_coefficients",
    "distortion_coeffs",
    "distcoeffs",
    "dist_coeffs",
    "dist",
    "d",
)
_SIZE = ("resolution", "image_size", "imagesize", "dim", "size")
_MODEL = ("distortion_model", "camera_model", "model", "type")
_FISHEYE_WORDS = ("fisheye", "equidistant", "equi", "kannala", "kb4")
_LARGEST_FILE = 2**20


def read_opencv(path: Path, model: str | None, resolution: tuple[int, int] | None) -> FileLens:
    """Return the lens of a file.

    Args:
        path: The file.
        model: ``fisheye`` or ``omnidir`` where the file does not say it: four coefficients alone
            may as well be k1, k2, p1, p2 of a lens that is no fisheye.
        resolution: Width and height of the pictures [px] where the file does not say them.

    Raises:
        UsageError: The model or the size of the pictures is missing.
        UsdSkinError: The file cannot be read, or its lens is no fisheye.
    """
    values = _read_values(path)
    size = _size(path, values, resolution)
    matrix = _numbers(path, values, _MATRIX, 9, 4, 5)
    distortion = _numbers(path, values, _DISTORTION, 4, 5, 2, 8, 12, 14)
    if matrix is None or distortion is None:
        raise UsdSkinError(
            f"{path}: has no {'camera_matrix' if matrix is None else 'distortion_coefficients'}; "
            "give a calibration written by OpenCV"
        )
    xi = np.ravel(values.get("xi", ()))
    if len(matrix) == 5:  # Kalibr's omni: xi, fx, fy, cx, cy
        xi, matrix = matrix[:1], matrix[1:]
    if len(matrix) == 4:
        fx, fy, cx, cy = (float(value) for value in matrix)
        skew = 0.0
    else:
        (fx, skew, cx), (_, fy, cy) = (row.tolist() for row in matrix.reshape(3, 3)[:2])
    if not (fx > 0.0 and fy > 0.0):
        raise UsdSkinError(f"{path}: camera_matrix has fx {fx:g}, fy {fy:g}; calibrate again")
    f, tangential = 0.5 * (fx + fy), 0.0
    if len(xi):
        if model == "fisheye":
            raise UsageError(f"{path}: has xi, so it is of --model omnidir; leave --model out")
        if xi.dtype.kind != "f" or not np.isfinite(xi[0]):
            raise UsdSkinError(f"{path}: xi is {xi[0]!r}, which is no number")
        parameters = np.concatenate([[f], xi[:1], distortion[:2]])
        tangential = 3.0 * float(np.hypot(*distortion[2:4])) if len(distortion) >= 4 else 0.0
    else:
        _check_is_fisheye(path, values, model, len(distortion))
        parameters = np.concatenate([[f], distortion])
    radial = MODELS["omnidir" if len(xi) else "fisheye"]
    uneven = (0.5 * abs(fx - fy) + abs(skew)) / f

    def not_radial(angle: FloatArray) -> FloatArray:
        height_px = radial.radius(parameters, angle)
        return np.asarray(uneven * height_px + tangential * height_px**2 / f)

    return FileLens(
        where=str(path),
        radius=lambda angle: radial.radius(parameters, angle),
        center_px=np.array([cx, cy]) + 0.5,
        resolution=size,
        exact=None if len(xi) else ("opencv", f, parameters[1:]),
        not_radial=not_radial if uneven + tangential > 0.0 else None,
    )


def _size(path: Path, values: dict[str, Any], stated: tuple[int, int] | None) -> tuple[int, int]:
    """Return the size of the pictures [px]."""
    size = _numbers(path, values, _SIZE, 2)
    if size is None:
        sides = [values.get(f"image_{side}", values.get(side)) for side in ("width", "height")]
        if all(isinstance(side, float) and 1.0 <= side < 1e6 for side in sides):
            size = np.array(sides)
    if size is None and stated is None:
        raise UsageError(
            f"{path}: says no size of the pictures; give it, as in --resolution 6000x4000"
        )
    if size is None:
        assert stated is not None
        return stated
    if not ((size >= 1.0) & (size < 1e6)).all():
        raise UsdSkinError(
            f"{path}: the pictures have {size[0]:g} x {size[1]:g} pixels; correct it"
        )
    found = int(size[0]), int(size[1])
    if stated is not None and stated != found:
        raise UsageError(
            f"{path}: says that the pictures have {found[0]} x {found[1]} pixels; leave "
            "--resolution out, or calibrate for yours"
        )
    return found


def _check_is_fisheye(
    path: Path, values: dict[str, Any], model: str | None, coefficient_count: int
) -> None:
    words = " ".join(str(values[name]).lower() for name in _MODEL if name in values)
    says_so = values.get("fisheye_model") == 1 or any(word in words for word in _FISHEYE_WORDS)
    if coefficient_count != 4 or (not says_so and (words or values.get("fisheye_model") == 0)):
        named = f" of model {words!r}" if words else ""
        raise UsdSkinError(
            f"{path}: {coefficient_count} distortion coefficients{named} are not those of a "
            "fisheye lens; calibrate with cv2.fisheye or cv2.omnidir, or from a board here"
        )
    if model == "omnidir":
        raise UsageError(f"{path}: has no xi, so it is not of --model omnidir; leave that out")
    if not says_so and model != "fisheye":
        raise UsageError(
            f"{path}: does not say which model its four coefficients belong to; add --model "
            "fisheye if they are k1 .. k4 of cv2.fisheye"
        )


def _read_values(path: Path) -> dict[str, Any]:
    """Return everything in a file by its last name in lower case; matrices as flat arrays."""
    import cv2

    if path.stat().st_size > _LARGEST_FILE:
        raise UsdSkinError(f"{path}: is too large for a calibration; give the file OpenCV wrote")
    text = path.read_text(encoding="utf-8", errors="replace")
    if path.suffix.lower() in (".yml", ".yaml") and not text.startswith("%YAML"):
        text = f"%YAML:1.0\n---\n{text.removeprefix('---')}"
    values: dict[str, Any] = {}
    try:
        storage = cv2.FileStorage(text, cv2.FILE_STORAGE_READ | cv2.FILE_STORAGE_MEMORY)
        try:
            _flatten(path, storage.root(), values)
        finally:
            storage.release()
    except (cv2.error, SystemError):  # its constructor raises the latter
        raise UsdSkinError(
            f"{path}: cannot be read as YAML, XML or JSON; export the calibration again"
        ) from None
    return values


def _flatten(path: Path, node: Any, values: dict[str, Any]) -> None:
    for key in node.keys():
        child, name = node.getNode(key), str(key).lower()
        value: Any = None
        if child.isMap() and child.getNode("data").isSeq():
            value = _sequence(child.getNode("data"))
        elif child.isMap():
            _flatten(path, child, values)
        elif child.isSeq():
            value = _sequence(child)
        elif child.isInt() or child.isReal():
            value = child.real()
        elif child.isString():
            value = child.string()
        if value is None:
            continue
        if name in values:
            raise UsdSkinError(f"{path}: has {key} twice; leave one camera in the file")
        values[name] = value


def _sequence(node: Any) -> FloatArray | None:
    """Return the numbers of a list, or of lists in it; ``None`` where it holds anything else."""
    numbers: list[float] = []
    for index in range(node.size()):
        item = node.at(index)
        if item.isSeq():
            inner = _sequence(item)
            if inner is None:
                return None
            numbers.extend(inner)
        elif item.isInt() or item.isReal():
            numbers.append(item.real())
        else:
            return None
    return np.array(numbers, dtype=np.float64)


def _numbers(
    path: Path, values: dict[str, Any], names: tuple[str, ...], *counts: int
) -> FloatArray | None:
    """Return the first of some values that is there, checked."""
    name = next((name for name in names if isinstance(values.get(name), np.ndarray)), None)
    if name is None:
        return None
    value = np.asarray(values[name], dtype=np.float64)
    if len(value) not in counts or not np.isfinite(value).all():
        raise UsdSkinError(
            f"{path}: {name} holds {len(value)} numbers, some perhaps not finite; "
            f"{' or '.join(map(str, counts))} are needed"
        )
    return value
