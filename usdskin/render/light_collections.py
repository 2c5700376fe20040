"""What a light says about whom it reaches, before anything is drawn."""

from __future__ import annotations

from pxr import Usd, UsdLux


def is_linked(light: Usd.Prim, name: str) -> bool:
    """Return whether a light's collection may leave something out."""
    links = Usd.CollectionAPI(light, name)
    if not links:
        return False
    targets = [*links.GetIncludesRel().GetTargets(), *links.GetExcludesRel().GetTargets()]
    expression = links.GetMembershipExpressionAttr()
    return bool(
        targets
        or links.GetIncludeRootAttr().Get() is not True
        or (expression and expression.HasAuthoredValue())
    )


def casts_shadows(light: Usd.Prim, time: Usd.TimeCode) -> bool:
    """Return false where ``ShadowAPI`` turns a light's shadows off."""
    if not light.HasAPI(UsdLux.ShadowAPI):
        return True
    return bool(UsdLux.ShadowAPI(light).GetShadowEnableAttr().Get(time))
