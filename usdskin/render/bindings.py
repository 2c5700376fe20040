"""Which material a prim shows: bindings of its own, of its ancestors and of collections."""

from __future__ import annotations

from collections.abc import Sequence

from usdskin.notes import Note

# isort: split
# After ours, which register the schemas.
from pxr import Usd, UsdShade


def bound_material(prim: Usd.Prim, purposes: Sequence[str] = ("full", "")) -> str | None:
    """Return the path of the material a prim shows, its ancestors' bindings included.

    Collection bindings and ``strongerThanDescendants`` count as ``UsdShade`` says.

    Args:
        prim: A gprim or a GeomSubset.
        purposes: Material purposes, the preferred one first; ``""`` is all purposes.
    """
    binding = UsdShade.MaterialBindingAPI(prim)
    for purpose in purposes:
        material, relationship = binding.ComputeBoundMaterial(purpose)
        # A search for "full" also gives what is bound for all purposes, whose turn comes later.
        if material and _purpose_of(relationship) == purpose:
            return str(material.GetPath())
    return None


def binding_notes(prim: Usd.Prim) -> list[Note]:
    """Return why a binding authored on a prim itself does not show."""
    relationship = UsdShade.MaterialBindingAPI(prim).GetDirectBindingRel()
    targets = relationship.GetTargets() if relationship else []
    if not targets:
        return []
    path = str(prim.GetPath())
    if not prim.HasAPI(UsdShade.MaterialBindingAPI):
        what = "has a material:binding but not MaterialBindingAPI, so USD ignores it; apply the API"
        return [Note("binding-ignored", path, what)]
    bound = prim.GetStage().GetPrimAtPath(targets[0])
    if not bound or not bound.IsA(UsdShade.Material):
        what = f"is bound to <{targets[0]}>, which is no Material; its displayColor is shown"
        return [Note("binding-broken", path, what)]
    return []


def _purpose_of(relationship: Usd.Relationship) -> str:
    """Return the purpose in ``material:binding[:collection][:<purpose>][:<collection's name>]``."""
    parts = relationship.GetName().split(":")[2:]
    if parts[:1] == ["collection"]:
        return parts[1] if len(parts) > 2 else ""
    return parts[0] if parts else ""
