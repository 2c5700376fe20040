"""Read the attributes of geometry as checked arrays.

A file may hold an opinion of another type than the schema's, and any index or number: nothing
beyond here has to doubt them.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from usdskin.errors import MeshError
from usdskin.layers import describe
from usdskin.render.mesh_topology import FloatArray, IndexArray

# isort: split
# After ours, which register the schemas.
from pxr import Usd

_TOKENS = {
    "orientation": ("rightHanded", "leftHanded"),
    "subdivisionScheme": ("catmullClark", "loop", "bilinear", "none"),
    "interpolateBoundary": ("none", "edgeOnly", "edgeAndCorner"),
    "faceVaryingLinearInterpolation": (
        "none", "cornersOnly", "cornersPlus1", "cornersPlus2", "boundaries", "all",
    ),
    "triangleSubdivisionRule": ("catmullClark", "smooth"),
    "axis": ("X", "Y", "Z"),
}  # fmt: skip


def read_whole_numbers(attribute: Usd.Attribute, time: Usd.TimeCode) -> IndexArray:
    """Return an array of whole numbers, empty where there is no value, shape [n].

    Raises:
        MeshError: The value is of another type.
    """
    array = _array(attribute, time)
    if array.dtype.kind not in "iu" or array.ndim != 1:
        raise _wrong_type(attribute, "whole numbers")
    return array.astype(np.intp)


def read_numbers(attribute: Usd.Attribute, time: Usd.TimeCode, width: int) -> FloatArray:
    """Return an array of rows of numbers, empty where there is no value, shape [n, width].

    Raises:
        MeshError: The value is of another type.
    """
    array = _array(attribute, time)
    if not array.size:
        return np.empty((0, width))
    if width == 1 and array.ndim == 1:
        array = array[:, None]
    if array.dtype.kind not in "fiu" or array.shape[1:] != (width,):
        raise _wrong_type(attribute, "numbers" if width == 1 else f"rows of {width} numbers")
    return array.astype(np.float64)


def read_points(attribute: Usd.Attribute, time: Usd.TimeCode) -> FloatArray:
    """Return points, all finite, shape [n, 3].

    Raises:
        MeshError: A point is not finite, or the value is of another type.
    """
    points = read_numbers(attribute, time, 3)
    finite = np.isfinite(points).all(axis=1)
    if not finite.all():
        bad = int(np.argmin(finite))
        count = int((~finite).sum())
        more = "" if count == 1 else f" (and {count - 1} more)"
        raise MeshError(
            f"{describe(attribute)}: point {bad} is {vector_text(points[bad])}{more}; every "
            "coordinate must be a finite number"
        )
    return points


def read_indices(
    attribute: Usd.Attribute, time: Usd.TimeCode, count: int, element: str
) -> IndexArray:
    """Return an array of indices, all within range, shape [n].

    Args:
        attribute: Attribute of whole numbers.
        time: When.
        count: How many elements there are.
        element: What the indices name, for errors.

    Raises:
        MeshError: An index names an element that does not exist, or the value is of another type.
    """
    indices = read_whole_numbers(attribute, time)
    wrong = (indices < 0) | (indices >= count)
    if wrong.any():
        at = int(np.argmax(wrong))
        there = f"there are {count} (0 to {count - 1})" if count else "there is none"
        raise MeshError(
            f"{describe(attribute)}: {attribute.GetName()}[{at}] names {element} {indices[at]}, "
            f"but {there}; export it again"
        )
    return indices


def read_token(attribute: Usd.Attribute, time: Usd.TimeCode) -> str:
    """Return a token attribute of a mesh or shape.

    Raises:
        MeshError: The token is not one that the schema allows.
    """
    name = attribute.GetName()
    value = str(attribute.Get(time))
    allowed = _TOKENS[name]
    if value not in allowed:
        raise MeshError(
            f"{describe(attribute)}: {name} is '{value}'; use one of {', '.join(allowed)}"
        )
    return value


def read_size(attribute: Usd.Attribute, time: Usd.TimeCode) -> float:
    """Return a length, at least 0.

    Raises:
        MeshError: It is negative, not finite or not a number.
    """
    value = attribute.Get(time)
    if not isinstance(value, int | float):
        raise _wrong_type(attribute, "a number")
    if not np.isfinite(value) or value < 0.0:
        raise MeshError(
            f"{describe(attribute)}: {attribute.GetName()} is {value:g}; it must be 0 or more"
        )
    return float(value)


def vector_text(values: NDArray[Any]) -> str:
    """Return a short text for a point."""
    return "(" + ", ".join(f"{float(value):.6g}" for value in values) + ")"


def _array(attribute: Usd.Attribute, time: Usd.TimeCode) -> NDArray[Any]:
    value = attribute.Get(time)
    if value is None:
        return np.empty(0, dtype=np.intp)
    array = np.asarray(value)
    return array if array.size else np.empty(0, dtype=np.intp)


def _wrong_type(attribute: Usd.Attribute, wanted: str) -> MeshError:
    return MeshError(
        f"{describe(attribute)}: {attribute.GetName()} does not hold {wanted}, as its type "
        f"{attribute.GetTypeName()} asks for; export it again"
    )
