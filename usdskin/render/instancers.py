"""Point instancers: which shapes they place, and where.

Reads: ``UsdGeomPointInstancer``, prototypes anywhere in the stage, instancers in prototypes. It
never asks for a bound, on which usd-core crashes where prototypes form a cycle.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, field

import numpy as np

from usdskin.errors import LayerError
from usdskin.layers import describe
from usdskin.notes import Note
from usdskin.render.gprims import is_gprim, unsupported_note
from usdskin.render.mesh_topology import BoolArray, FloatArray, IndexArray
from usdskin.render.mesh_values import read_indices

# isort: split
# After ours, which register the schemas.
from pxr import Usd, UsdGeom, Vt

_DEPTH_LIMIT = 32
"""Most instancers inside one another."""

_SINGULAR = 1e-9
"""Ratio of the smallest to the largest stretch below which an instance has no size."""

# A prototype may be an over or a class, so that it is not drawn by itself.
_PREDICATE = Usd.TraverseInstanceProxies(Usd.PrimIsActive & Usd.PrimIsLoaded)


@dataclass(frozen=True, slots=True, eq=False)
class Link:
    """What one prototype of one instancer holds: a shape, or the next instancer inwards."""

    instancer: Usd.Prim
    """The instancer."""

    instances: IndexArray
    """Places in ``protoIndices`` of the shown instances of the prototype, shape [n]."""

    transforms: FloatArray
    """From the prototype's space to the instancer's, column vectors, shape [n, 4, 4]."""

    count: int
    """Instances of all prototypes, hidden ones included."""

    root: Usd.Prim
    """The prototype."""

    prim: Usd.Prim
    """The shape or instancer inside it."""

    to_root: FloatArray
    """From the space of ``prim`` to that around the prototype, column vectors, shape [4, 4]."""

    @property
    def suffix(self) -> str:
        """Path of ``prim`` from the prototype on, its name included."""
        return str(self.prim.GetPath())[len(str(self.root.GetPath().GetParentPath()).rstrip("/")) :]


@dataclass(frozen=True, slots=True, eq=False)
class Placed:
    """A shape that instancers place many times."""

    links: tuple[Link, ...]
    """From the outermost instancer inwards; the last one's ``prim`` is the shape."""

    @property
    def prim(self) -> Usd.Prim:
        """The shape."""
        return self.links[-1].prim

    @property
    def count(self) -> int:
        """How often it is shown."""
        total = 1
        for link in self.links:
            total *= len(link.instances)
        return total

    def expand(self, to_world: FloatArray) -> tuple[FloatArray, list[str], list[IndexArray]]:
        """Return where the shape is shown.

        Args:
            to_world: From the outermost instancer's space to the world's, shape [4, 4].

        Returns:
            From the space around the innermost prototype to the world's, shape [count, 4, 4]; the
            names ``/Instancer[3]/Prototype/Shape``; and which instance of each link it is, shape
            [count] each.
        """
        matrices = np.asarray(to_world, dtype=np.float64)[None]
        names = [str(self.links[0].instancer.GetPath())]
        rows: list[IndexArray] = []
        for k, link in enumerate(self.links):
            count = len(link.instances)
            matrices = (matrices[:, None] @ link.transforms[None]).reshape(-1, 4, 4)
            if k + 1 < len(self.links):
                matrices = matrices @ link.to_root
            rows = [np.repeat(row, count) for row in rows]
            rows.append(np.tile(link.instances, len(names)))
            names = [f"{name}[{at}]{link.suffix}" for name in names for at in link.instances]
        return matrices, names, rows


@dataclass(frozen=True, slots=True)
class InstancerReader:
    """Reads the instancers of a stage at one moment."""

    time: Usd.TimeCode

    base: Usd.TimeCode
    """The frame that the moment belongs to: it says which instances there are, and from which
    sample of positions their velocities count."""

    purposes: frozenset[str]
    """Purposes that are drawn."""

    notes: list[Note]
    cache: UsdGeom.XformCache
    _known: dict[str, list[Link]] = field(default_factory=dict)

    def read(self, prim: Usd.Prim) -> list[Placed]:
        """Return the shapes that an instancer places.

        Args:
            prim: A visible ``UsdGeomPointInstancer`` that is in no prototype.

        Raises:
            LayerError: Prototypes form a cycle, are missing or too deep, or an array cannot be
                used.
        """
        purpose = UsdGeom.Imageable(prim).ComputePurpose()
        return list(self._descend(prim, str(purpose), ()))

    def _descend(self, prim: Usd.Prim, purpose: str, outer: tuple[Link, ...]) -> Iterator[Placed]:
        path = prim.GetPath()
        if any(link.instancer.GetPath() == path for link in outer):
            raise _cycle(prim)
        if len(outer) >= _DEPTH_LIMIT:
            raise LayerError(
                f"{describe(prim)}: {_DEPTH_LIMIT} point instancers are inside one another; "
                "flatten some of them"
            )
        for link in self._links(prim):
            own = _authored_purpose(link.prim, link.root) or purpose
            links = (*outer, link)
            if link.prim.IsA(UsdGeom.PointInstancer):
                yield from self._descend(link.prim, own, links)
            elif own in self.purposes:
                yield Placed(links)

    def _links(self, prim: Usd.Prim) -> list[Link]:
        path = str(prim.GetPath())
        if path not in self._known:
            self._known[path] = list(self._read_links(prim))
        return self._known[path]

    def _read_links(self, prim: Usd.Prim) -> Iterator[Link]:
        instancer = UsdGeom.PointInstancer(prim)
        targets = instancer.GetPrototypesRel().GetTargets()
        indices = read_indices(
            instancer.GetProtoIndicesAttr(), self.base, len(targets), "prototype"
        )
        if not len(indices):
            return
        transforms, shown = self._transforms(instancer, len(indices))
        for number, target in enumerate(targets):
            instances = np.flatnonzero(shown & (indices == number))
            if not len(instances):
                continue
            root = prim.GetStage().GetPrimAtPath(target)
            if prim.GetPath().HasPrefix(target):
                raise _cycle(prim)
            if not root:
                raise LayerError(
                    f"{describe(prim)}: prototypes name <{target}>, which is not there; restore "
                    "it or point the instancer at other prims"
                )
            for inner in self._shapes(root):
                yield Link(
                    prim,
                    instances,
                    transforms[instances],
                    len(indices),
                    root,
                    inner,
                    self._to_root(inner, root),
                )

    def _transforms(
        self, instancer: UsdGeom.PointInstancer, count: int
    ) -> tuple[FloatArray, BoolArray]:
        """Return the transforms of all instances, and which of them are shown."""
        prim, base = instancer.GetPrim(), self.base
        where = describe(prim)
        for name in _PER_INSTANCE:
            attribute = prim.GetAttribute(name)
            if name == "ids" and not self._usable_ids(attribute):
                continue
            found = _length(attribute, base)
            if found != count and (found or name == "positions"):
                raise LayerError(
                    f"{where}: {name} has {found} values, but protoIndices has {count}; export "
                    "the instancer again"
                )
        self._usable_ids(instancer.GetInvisibleIdsAttr())
        shown = np.ones(count, dtype=np.bool_)
        mask = instancer.ComputeMaskAtTime(base)
        if len(mask):
            shown &= np.asarray(mask, dtype=np.bool_)
        found_matrices = _matrices(instancer, self.time, base, count)
        if len(found_matrices) != count:
            raise LayerError(
                f"{where}: USD finds {len(found_matrices)} transforms for {count} instances; "
                "export the instancer again"
            )
        matrices = np.array(found_matrices, dtype=np.float64).reshape(-1, 4, 4).transpose(0, 2, 1)
        broken = ~np.isfinite(matrices).all(axis=(1, 2)) & shown
        if broken.any():
            raise LayerError(
                f"{where}: instance {int(np.argmax(broken))} has a transform that is not finite; "
                "correct its position, orientation, scale or velocity"
            )
        return matrices, shown & self._with_size(prim, matrices, shown)

    def _usable_ids(self, attribute: Usd.Attribute) -> bool:
        """Return whether ids are of the type that USD reads; note others, which it passes over."""
        value = attribute.Get(self.base)
        if value is None or isinstance(value, Vt.Int64Array):
            return True
        what = f"{attribute.GetName()} is not of type int64[], so USD ignores it"
        path = str(attribute.GetPrim().GetPath())
        self.notes.append(Note("instancer-ids-ignored", path, what))
        return False

    def _with_size(self, prim: Usd.Prim, matrices: FloatArray, shown: BoolArray) -> BoolArray:
        """Return which instances are not flattened; scaling by 0 is a way to hide one."""
        solid = np.ones(len(matrices), dtype=np.bool_)
        stretch = np.linalg.svd(matrices[shown, :3, :3], compute_uv=False)
        solid[shown] = stretch[:, 2] > _SINGULAR * stretch[:, 0]
        lost = np.flatnonzero(~solid)
        if len(lost):
            what = f"{len(lost)} instances are scaled to nothing, such as {lost[0]}; not shown"
            self.notes.append(Note("instances-without-size", str(prim.GetPath()), what))
        return solid

    def _shapes(self, root: Usd.Prim) -> Iterator[Usd.Prim]:
        """Yield what a prototype shows: its shapes and instancers, invisible ones left out.

        What hides the prims around a prototype does not hide its instances.
        """
        if not root.IsActive() or not root.IsLoaded():
            return
        walk = iter(Usd.PrimRange(root, _PREDICATE))
        for prim in walk:
            imageable = UsdGeom.Imageable(prim)
            if imageable:
                visibility = imageable.GetVisibilityAttr().Get(self.time)
                if visibility == UsdGeom.Tokens.invisible:
                    walk.PruneChildren()
                    continue
            if prim.IsA(UsdGeom.PointInstancer):
                walk.PruneChildren()
                yield prim
                continue
            note = unsupported_note(prim)
            if note is not None:
                self.notes.append(note)
            elif is_gprim(prim):
                yield prim

    def _to_root(self, prim: Usd.Prim, root: Usd.Prim) -> FloatArray:
        matrix, _ = self.cache.ComputeRelativeTransform(prim, root.GetParent())
        return np.array(matrix, dtype=np.float64).T


_PER_INSTANCE = (
    "positions",
    "orientations",
    "orientationsf",
    "scales",
    "velocities",
    "accelerations",
    "angularVelocities",
    "ids",
)
"""Arrays with a value per instance; all but the positions may be left out."""


def _length(attribute: Usd.Attribute, time: Usd.TimeCode) -> int:
    """Return the number of values of an array, 0 where there is none.

    Raises:
        LayerError: It is of another type than the schema's, which USD would pass over.
    """
    if not attribute or not attribute.HasValue():
        return 0
    value = attribute.Get(time)
    if value is None:
        return 0
    if not isinstance(value, attribute.GetTypeName().type.pythonClass):
        raise LayerError(
            f"{describe(attribute)}: {attribute.GetName()} does not hold what its type "
            f"{attribute.GetTypeName()} asks for; export the instancer again"
        )
    return len(value)


def _matrices(
    instancer: UsdGeom.PointInstancer, time: Usd.TimeCode, base: Usd.TimeCode, count: int
) -> Vt.Matrix4dArray:
    """Return the transforms of all instances, as they are at the frame where USD finds none.

    Without velocities positions are read at the time itself, and a sample in between may hold
    other instances.
    """
    base = _moment(instancer, base)
    for moment in (_moment(instancer, time), base):
        found = instancer.ComputeInstanceTransformsAtTime(
            moment,
            base,
            UsdGeom.PointInstancer.ExcludeProtoXform,
            UsdGeom.PointInstancer.IgnoreMask,
        )
        if len(found) == count:
            break
    return found


def _moment(instancer: UsdGeom.PointInstancer, time: Usd.TimeCode) -> Usd.TimeCode:
    """Return a time that velocities can be counted from, where the earliest of all is asked for."""
    if not time.IsEarliestTime():
        return time
    samples = instancer.GetPositionsAttr().GetTimeSamples()
    return Usd.TimeCode(samples[0]) if samples else Usd.TimeCode.Default()


def _cycle(prim: Usd.Prim) -> LayerError:
    return LayerError(
        f"{describe(prim)}: its prototypes hold the instancer itself; point it at other prims"
    )


def _authored_purpose(prim: Usd.Prim, root: Usd.Prim) -> str | None:
    """Return the purpose that a prim has inside a prototype; None where none is authored."""
    while True:
        imageable = UsdGeom.Imageable(prim)
        if imageable and imageable.GetPurposeAttr().HasAuthoredValue():
            return str(imageable.GetPurposeAttr().Get())
        if prim.GetPath() == root.GetPath():
            return None
        prim = prim.GetParent()
