"""Find schemas and attributes of ours that are misspelt, misplaced or not applied.

USD keeps what it does not know and says nothing: a misspelt ``SpectralLigthAPI`` would only show
as a light without its spectrum.
"""

from __future__ import annotations

from collections.abc import Iterator

from pxr import Usd

from usdskin.prims.values import PrimError, Problem, closest, declared_attributes
from usdskin.schemas import SCHEMA_NAMES

_MULTIPLE_APPLY = ("SpectralDistributionAPI", "SpectralRecoveryAPI")

# Namespaces that nobody else writes to, and the schema that owns them.
_NAMESPACES = {
    "bracket:": "ExposureBracketAPI",
    "capture:": "CaptureAPI",
    "chart:": "ColorChartAPI",
    "estimate:": "LightEstimateAPI",
    "fisheye:": "FisheyeCameraAPI",
    "inputs:skin:": "SkinMaterialAPI",
    "samples:": "SkinSampleAPI",
    "inputs:spectral:": "SpectralLightAPI",
    "fit:": "SkinMaterialAPI",
    "transfer:": "SkinTransferAPI",
    "usdskin:": "SkinRenderSettingsAPI",
}
_SPECTRUM = "spectrum:"

SPECTRUM_INSTANCES = {
    "SkinMaterialAPI": ("reflectance", "scattering", "opacity"),
    "SpectralLightAPI": ("emission",),
    "LightEstimateAPI": ("mean",),
    "ColorChartAPI": ("illuminant",),
    "SkinSampleAPI": ("reflectance",),
}
"""Instances of SpectralDistributionAPI that a schema reads."""

_CLOSE = 0.8


def check_applied_schemas(prim: Usd.Prim) -> None:
    """Refuse schemas and attributes of ours that a reader would silently pass by.

    Args:
        prim: Any prim.

    Raises:
        LayerError: An applied schema's name is close to one of ours, one of ours is applied to a
            prim it does not fit, or attributes of ours are misspelt or lack their schema.
    """
    for problem in applied_problems(prim):
        raise PrimError(prim, problem)


def check_stage_schemas(stage: Usd.Stage) -> None:
    """Call ``check_applied_schemas`` on every prim of a stage, those in instances included."""
    for prim in Usd.PrimRange.Stage(stage, Usd.TraverseInstanceProxies()):
        check_applied_schemas(prim)


def instances(prim: Usd.Prim, schema: str) -> list[str]:
    """Return the instance names under which a multiple-apply schema is applied to a prim."""
    prefix = f"{schema}:"
    return [name[len(prefix) :] for name in prim.GetAppliedSchemas() if name.startswith(prefix)]


def fits(prim: Usd.Prim, schema: str) -> bool:
    """Return whether a schema may be applied to a prim.

    Not every USD's ``CanApplyAPI`` takes an API schema such as LightAPI for a condition: that of
    26.5 refuses every light.
    """
    allowed = Usd.SchemaRegistry.GetAPISchemaCanOnlyApplyToTypeNames(schema, "")
    applied = prim.GetAppliedSchemas()
    return not allowed or any(prim.IsA(name) or name in applied for name in allowed)


def applied_problems(prim: Usd.Prim) -> Iterator[Problem]:
    """Yield what ``check_applied_schemas`` refuses."""
    applied = [str(name) for name in prim.GetPrimTypeInfo().GetAppliedAPISchemas()]
    for name in applied:
        yield from _schema_problems(prim, name)
    yield from _instance_problems(prim, applied)
    yield from _property_problems(prim, applied)


def _schema_problems(prim: Usd.Prim, name: str) -> Iterator[Problem]:
    base, _, instance = name.partition(":")
    if base not in SCHEMA_NAMES:
        known = Usd.SchemaRegistry.FindSchemaInfo(base)
        match = None if known else closest(base, SCHEMA_NAMES, _CLOSE)
        if match:
            correct = f"{match}:{instance}" if instance else match
            text = f'is no known schema; did you mean "{correct}"? Correct it in apiSchemas'
            yield Problem("unknown-schema", name, text)
        return
    if base in _MULTIPLE_APPLY and not instance:
        text = f'is applied without an instance name; write "{base}:<name>"'
        yield Problem("misapplied-schema", name, text)
    elif base not in _MULTIPLE_APPLY and instance:
        text = f'is applied with an instance name; write "{base}"'
        yield Problem("misapplied-schema", name, text)
    elif not fits(prim, base):
        allowed = " or ".join(Usd.SchemaRegistry.GetAPISchemaCanOnlyApplyToTypeNames(base, ""))
        kind = str(prim.GetTypeName()) or "prim without a type"
        text = f"is applied to a {kind}; it fits {allowed} only, so move it there"
        yield Problem("misapplied-schema", name, text)


def _instance_problems(prim: Usd.Prim, applied: list[str]) -> Iterator[Problem]:
    expected = [name for schema in applied for name in SPECTRUM_INSTANCES.get(schema, ())]
    present = instances(prim, "SpectralDistributionAPI")
    absent = tuple(name for name in expected if name not in present)
    for instance in present:
        match = None if instance in expected else closest(instance, absent, _CLOSE)
        if match:
            name = f"SpectralDistributionAPI:{instance}"
            text = f'is read by nothing here; did you mean "{match}"? Rename it and its attributes'
            yield Problem("unknown-instance", name, text)


def _property_problems(prim: Usd.Prim, applied: list[str]) -> Iterator[Problem]:
    names = [str(name) for name in prim.GetAuthoredPropertyNames()]
    for namespace, schema in _NAMESPACES.items():
        ours = [name for name in names if name.startswith(namespace)]
        if ours:
            yield from _owned_problems(ours, schema, schema in applied)
    for name in names:
        parts = name.split(":")
        if name.startswith(_SPECTRUM) and len(parts) == 3:
            schema = f"SpectralDistributionAPI:{parts[1]}"
            declared = tuple(item.name for item in declared_attributes("SpectralDistributionAPI"))
            yield from _one_property(name, parts[2], declared, schema, schema in applied)


def _owned_problems(names: list[str], schema: str, is_applied: bool) -> Iterator[Problem]:
    definition = Usd.SchemaRegistry().FindAppliedAPIPrimDefinition(schema)
    declared = tuple(str(name) for name in definition.GetPropertyNames())
    for name in names:
        yield from _one_property(name, name, declared, schema, is_applied)


def _one_property(
    name: str, base: str, declared: tuple[str, ...], schema: str, is_applied: bool
) -> Iterator[Problem]:
    if base in declared:
        if not is_applied:
            text = f"is authored, but {schema} is not applied; add it to apiSchemas"
            yield Problem("schema-not-applied", name, text)
        return
    match = closest(base, declared, _CLOSE)
    if match:
        text = f'is no attribute of {schema}; did you mean "{match}"? Rename it'
        yield Problem("unknown-attribute", name, text)
