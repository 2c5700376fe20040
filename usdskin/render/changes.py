"""What of a stage varies over a job's frames, so that all the rest is read once.

Reads: any stage. Makes: ``Changes``. In doubt a part varies.
"""

from __future__ import annotations

from dataclasses import dataclass

from pxr import Usd, UsdGeom, UsdLux, UsdRender, UsdShade

_FAR = (UsdLux.DomeLight, UsdLux.DomeLight_1, UsdLux.DistantLight)


@dataclass(frozen=True, slots=True)
class Changes:
    """What may differ between two frames."""

    shapes: bool
    """Meshes: their points, primvars, transforms, visibility, poses."""

    materials: bool
    """What materials and their networks say."""

    lights: bool
    """Lights, in more than how those far away are turned."""

    turned: frozenset[str] = frozenset()
    """Paths of the lights far away whose transform varies."""


EVERYTHING = Changes(True, True, True)


def find_changes(stage: Usd.Stage) -> Changes:
    """Look at every attribute of a stage once.

    Cameras are not in it: they are read at every frame.
    """
    found = _Found()
    predicate = Usd.TraverseInstanceProxies(Usd.PrimAllPrimsPredicate)
    for prim in Usd.PrimRange(stage.GetPseudoRoot(), predicate):
        names = [a.GetName() for a in prim.GetAttributes() if a.ValueMightBeTimeVarying()]
        if not names:
            continue
        moves = any(name.startswith("xformOp:") for name in names)
        hides = "visibility" in names
        rest = [n for n in names if n != "visibility" and not n.startswith("xformOp:")]
        if rest:
            found.add_values(prim, rest)
        if moves or hides:
            for below in Usd.PrimRange(prim, predicate):
                found.add_place(below, hides)
        if found.everything:
            return EVERYTHING
    return Changes(found.shapes, found.materials, found.lights, frozenset(found.turned))


class _Found:
    """What has been found to vary so far."""

    def __init__(self) -> None:
        self.shapes = self.materials = self.lights = False
        self.turned: set[str] = set()

    @property
    def everything(self) -> bool:
        return self.shapes and self.materials and self.lights

    def add_values(self, prim: Usd.Prim, names: list[str]) -> None:
        """Take in attributes of a prim that vary, its transform and visibility aside."""
        is_light = prim.HasAPI(UsdLux.LightAPI)
        shades = prim.IsA(UsdShade.NodeGraph) or prim.IsA(UsdShade.Shader)
        self.lights |= is_light
        self.materials |= shades
        if is_light and not prim.IsA(UsdGeom.Gprim):
            return
        if any(name.startswith("collection:") for name in names):
            self._add_all()
        elif prim.IsA(UsdGeom.Imageable) and not prim.IsA(UsdGeom.Camera):
            self.shapes = True
            # What networks may be connected to.
            if any(name.startswith(("inputs:", "outputs:")) for name in names):
                self._add_all()
        elif not shades and not _is_read_otherwise(prim):
            self._add_all()

    def add_place(self, prim: Usd.Prim, hides: bool) -> None:
        """Take in a prim that moves, or is hidden at times."""
        if prim.HasAPI(UsdLux.LightAPI):
            if hides or not any(prim.IsA(kind) for kind in _FAR):
                self.lights = True
            else:
                self.turned.add(str(prim.GetPath()))
            self.shapes |= prim.IsA(UsdGeom.Gprim)
            return
        bare = prim.GetTypeName() in ("Xform", "Scope") or prim.IsA(UsdShade.NodeGraph)
        self.shapes |= not (bare or prim.IsA(UsdShade.Shader) or _is_read_otherwise(prim))

    def _add_all(self) -> None:
        self.shapes = self.materials = self.lights = True


def _is_read_otherwise(prim: Usd.Prim) -> bool:
    """Return whether a prim is read at every frame anyway, or once for all."""
    kinds = (UsdGeom.Camera, UsdRender.SettingsBase, UsdRender.Var)
    return any(prim.IsA(kind) for kind in kinds)
