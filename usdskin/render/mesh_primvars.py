"""Read primvars of geometry as numbers, with their indices checked.

Reads: ``UsdGeomPrimvarsAPI``, inherited values included.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from usdskin.errors import MeshError
from usdskin.layers import describe
from usdskin.notes import Note
from usdskin.render.mesh_topology import FloatArray, IndexArray

# isort: split
# After ours, which register the schemas.
from pxr import Usd, UsdGeom


@dataclass(frozen=True, slots=True)
class ElementCounts:
    """How many values a primvar of each interpolation has."""

    points: int
    """For ``vertex`` and ``varying``."""

    faces: int
    """For ``uniform``."""

    corners: int
    """For ``faceVarying``."""

    def of(self, interpolation: str) -> int | None:
        """Return the count for an interpolation; None for one that does not exist."""
        return {
            "constant": 1,
            "uniform": self.faces,
            "vertex": self.points,
            "varying": self.points,
            "faceVarying": self.corners,
        }.get(interpolation)


@dataclass(frozen=True, slots=True, eq=False)
class PrimvarValues:
    """The values of a primvar, and which of them each element has."""

    interpolation: str
    """``constant``, ``uniform``, ``varying``, ``vertex`` or ``faceVarying``."""

    values: FloatArray
    """Distinct values, shape [value_count, k]."""

    indices: IndexArray | None
    """Value of each element, shape [element_count]; None when values and elements are the same."""

    def of_elements(self) -> FloatArray:
        """Return one row per element, shape [element_count, k]."""
        return self.values if self.indices is None else self.values[self.indices]


def read_primvar(
    prim: Usd.Prim, name: str, time: Usd.TimeCode, counts: ElementCounts, notes: list[Note]
) -> PrimvarValues | None:
    """Read a primvar of a prim, or a constant one it inherits.

    Args:
        prim: Geometry.
        name: Name without ``primvars:``.
        time: When.
        counts: Elements of the geometry.
        notes: A primvar that is not made of numbers is noted.

    Returns:
        The values, or None when there is no such primvar or it is not made of numbers.

    Raises:
        MeshError: There are too many or too few values, an index is out of range, or a value is
            not finite.
    """
    primvar = UsdGeom.PrimvarsAPI(prim).FindPrimvarWithInheritance(name)
    if not primvar or not primvar.HasValue():
        return None
    attribute = primvar.GetAttr()
    value = primvar.Get(time)
    if value is None:
        return None
    values = _numbers(value, primvar.GetTypeName().isArray)
    if values is None:
        notes.append(
            Note(
                "primvar-not-numbers",
                str(prim.GetPath()),
                f"primvars:{name} is of type {primvar.GetTypeName()} and is ignored",
            )
        )
        return None
    size = max(int(primvar.GetElementSize()), 1)
    if len(values) % size:
        raise MeshError(
            f"{describe(attribute)}: primvars:{name} has {len(values)} values, which is no "
            f"multiple of its elementSize {size}"
        )
    values = values.reshape(len(values) // size, -1)
    indices = np.array(primvar.GetIndices(time), dtype=np.intp) if primvar.IsIndexed() else None
    return checked(attribute, primvar.GetInterpolation(), values, indices, counts)


def checked(
    attribute: Usd.Attribute,
    interpolation: str,
    values: FloatArray,
    indices: IndexArray | None,
    counts: ElementCounts,
) -> PrimvarValues:
    """Return the values of an attribute once counts, indices and numbers hold.

    Raises:
        MeshError: They do not.
    """
    name = f"{describe(attribute)}: {attribute.GetName()}"
    expected = counts.of(interpolation)
    if expected is None:
        raise MeshError(
            f"{name} has the interpolation '{interpolation}'; use constant, uniform, varying, "
            "vertex or faceVarying"
        )
    found = len(values) if indices is None else len(indices)
    if found != expected:
        what = "values" if indices is None else "indices"
        raise MeshError(
            f"{name} has {found} {what}, but {interpolation} interpolation needs {expected}; "
            "export it again or correct its interpolation"
        )
    if indices is not None and found:
        wrong = (indices < 0) | (indices >= len(values))
        if wrong.any():
            at = int(np.argmax(wrong))
            raise MeshError(
                f"{name}:indices[{at}] is {indices[at]}, but there are {len(values)} values; "
                "export it again"
            )
    finite = np.isfinite(values).all(axis=1)
    if not finite.all():
        raise MeshError(
            f"{name}[{int(np.argmin(finite))}] is not finite; every value must be a finite number"
        )
    return PrimvarValues(str(interpolation), values, indices)


def _numbers(value: object, is_array: bool) -> FloatArray | None:
    """Return values as rows of numbers, shape [n, k]; None when they are something else."""
    array: NDArray[np.generic] = np.asarray(value)
    if array.dtype.kind not in "fiub":
        return None
    if not is_array:
        array = array[None]
    if array.ndim == 1:
        array = array[:, None]
    if array.ndim != 2:
        return None
    return array.astype(np.float64)
