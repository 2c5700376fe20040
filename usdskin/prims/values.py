"""Read every attribute of one applied schema, checked against what the schema says.

Type, allowed tokens, limits and fallback come from the schema registry, so ``schema.usda`` is the
only place they are written. What the schema language cannot say (lengths that belong together,
ascending wavelengths) is in ``usdskin.prims.rules``.
"""

from __future__ import annotations

import difflib
import functools
import math
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from pxr import Sdf, Usd, UsdShade

from usdskin.errors import LayerError
from usdskin.layers import layer_name
from usdskin.prims.rules import RULES

DEFAULT_TIME = Usd.TimeCode.Default()
"""The time of what does not move."""

_TEMPLATE_INSTANCE = "__INSTANCE_NAME__"

_TUPLE_WIDTHS = {
    "double2": 2,
    "double3": 3,
    "double4": 4,
    "float2": 2,
    "int2": 2,
    "vector3d": 3,
    "vector3f": 3,
}


@dataclass(frozen=True, slots=True)
class Problem:
    """One thing that is wrong with a prim's opinions."""

    code: str
    """Stable kebab-case name, such as ``not-ascending``."""

    name: str
    """Name of the property, or of the applied schema."""

    message: str
    """What is wrong with which value, and what to do; to be read after the name."""


class PrimError(LayerError):
    """A problem with a prim's opinions, with the place it is at."""

    def __init__(self, prim: Usd.Prim, problem: Problem) -> None:
        is_property = Sdf.Path.IsValidNamespacedIdentifier(problem.name)
        prop = prim.GetProperty(problem.name) if is_property else None
        self.problem = problem
        self.layer = layer_name(prop if prop else prim)
        self.path = str(prim.GetPath())
        super().__init__(f"{self.layer} <{self.path}>: {problem.name} {problem.message}")


class _RefusedError(Exception):
    def __init__(self, code: str, message: str) -> None:
        super().__init__(message)
        self.code = code


@dataclass(frozen=True, slots=True)
class Declared:
    """An attribute as the schema declares it."""

    name: str
    """Name in ``schema.usda``: that of a multiple-apply schema without prefix and instance."""

    template: str
    """Name in the registry, with the place of the instance name."""

    type_name: str
    """Value type, such as ``double[]``."""

    tokens: tuple[str, ...]
    """Allowed tokens; empty where there is no list of them."""

    minimum: float
    """Smallest allowed value."""

    maximum: float
    """Largest allowed value."""

    def full_name(self, instance: str) -> str:
        """Return the name of the property on a prim."""
        return self.template.replace(_TEMPLATE_INSTANCE, instance)


@functools.cache
def declared_attributes(schema: str) -> tuple[Declared, ...]:
    """Return the attributes of a schema, relationships left out."""
    definition = Usd.SchemaRegistry().FindAppliedAPIPrimDefinition(schema)
    declared = []
    for template in definition.GetPropertyNames():
        if definition.GetSpecType(template) != Sdf.SpecTypeAttribute:
            continue
        hard = (definition.GetPropertyMetadata(template, "limits") or {}).get("hard", {})
        declared.append(
            Declared(
                name=template.rpartition(f"{_TEMPLATE_INSTANCE}:")[2],
                template=template,
                type_name=str(definition.GetAttributeDefinition(template).GetTypeName()),
                tokens=tuple(definition.GetPropertyMetadata(template, "allowedTokens") or ()),
                minimum=float(hard.get("minimum", -math.inf)),
                maximum=float(hard.get("maximum", math.inf)),
            )
        )
    return tuple(declared)


def read_schema(
    prim: Usd.Prim, schema: str, time: Usd.TimeCode | float, instance: str = ""
) -> dict[str, Any]:
    """Return the checked values of all attributes of an applied schema.

    Args:
        prim: Prim the schema is applied to.
        schema: Identifier of the schema, such as ``SkinMaterialAPI``.
        time: Time to read at.
        instance: Instance name of a multiple-apply schema.

    Returns:
        Values by attribute name, as in ``schema.usda``. None where there is neither an opinion
        nor a fallback; numbers are float or int, numeric arrays float64, assets resolved paths.

    Raises:
        LayerError: The first problem found.
    """
    values, problems = examine_schema(prim, schema, time, instance)
    if problems:
        raise PrimError(prim, problems[0])
    return values


def examine_schema(
    prim: Usd.Prim, schema: str, time: Usd.TimeCode | float, instance: str = ""
) -> tuple[dict[str, Any], list[Problem]]:
    """Return the values ``read_schema`` returns, and everything that is wrong with them.

    A value that is wrong by itself is returned as None.
    """
    values: dict[str, Any] = {}
    problems: list[Problem] = []
    full_names: dict[str, str] = {}
    for declared in declared_attributes(schema):
        name = full_names[declared.name] = declared.full_name(instance)
        attribute = prim.GetAttribute(name)
        value = attribute.Get(time) if attribute else None
        values[declared.name] = None
        if value is not None:
            try:
                values[declared.name] = _convert(declared, attribute, value)
            except _RefusedError as refused:
                problems.append(Problem(refused.code, name, str(refused)))
    if not problems:
        for rule in RULES.get(schema, ()):
            for complaint in rule(values):
                name = full_names[complaint.name]
                problems.append(Problem(complaint.code, name, complaint.message))
    return values, problems


def _convert(declared: Declared, attribute: Usd.Attribute, value: Any) -> Any:
    type_name = declared.type_name
    if type_name in ("float", "double", "int"):
        return _number(declared, value)
    if type_name == "bool":
        return _plain(declared, value, bool)
    if type_name in ("token", "string"):
        return _text(declared, value)
    if type_name == "asset":
        return _file(attribute, _plain(declared, value, Sdf.AssetPath))
    if type_name == "asset[]":
        items = _plain(declared, value, Sdf.AssetPathArray)
        return [_file(attribute, item) for item in items]
    if type_name in ("token[]", "string[]"):
        if not all(isinstance(item, str) for item in value):
            raise _wrong_type(declared, value)
        return [str(item) for item in value]
    return _numbers(declared, value)


def _wrong_type(declared: Declared, value: Any) -> _RefusedError:
    shown = f'"{value}"' if isinstance(value, str) else str(value)
    shown = shown if len(shown) <= 40 else f"{shown[:37]}..."
    return _RefusedError(
        "wrong-type",
        f"is {shown}, which is no {declared.type_name}; author it as {declared.type_name}",
    )


def _plain(declared: Declared, value: Any, kind: type) -> Any:
    if not isinstance(value, kind):
        raise _wrong_type(declared, value)
    return value


def _number(declared: Declared, value: Any) -> float | int:
    if isinstance(value, bool) or not isinstance(value, (int, float)):
        raise _wrong_type(declared, value)
    if not math.isfinite(value):
        raise _RefusedError("not-finite", f"is {value}; set it to a finite number")
    if declared.type_name == "int" and value != int(value):
        raise _wrong_type(declared, value)
    if not declared.minimum <= value <= declared.maximum:
        limits = f"at least {declared.minimum:g}"
        if math.isfinite(declared.maximum):
            limits = f"from {declared.minimum:g} to {declared.maximum:g}"
        raise _RefusedError("out-of-range", f"is {value:g}; it must be {limits}")
    if declared.type_name == "int":
        return int(value)
    with np.errstate(over="ignore"):
        single = np.float32(value)
    # An author who wrote 0.3 meant 0.3, and not the float next to it.
    return float(str(single)) if float(single) == value else float(value)


def _text(declared: Declared, value: Any) -> str:
    text = str(_plain(declared, value, str))
    if declared.tokens and text not in declared.tokens:
        raise _RefusedError(
            "unknown-token",
            f'is "{text}"; {suggestion(text, declared.tokens)}use one of '
            f"{', '.join(declared.tokens)}",
        )
    return text


def suggestion(word: str, known: tuple[str, ...]) -> str:
    """Return ``did you mean ...? `` where a known word is close, and nothing otherwise."""
    match = closest(word, known, 0.7)
    return f'did you mean "{match}"? ' if match else ""


def closest(word: str, known: tuple[str, ...], cutoff: float) -> str | None:
    """Return the known word closest to another, if it is close enough; case does not count."""
    lower = {name.lower(): name for name in known}
    matches = difflib.get_close_matches(word.lower(), lower, n=1, cutoff=cutoff)
    return lower[matches[0]] if matches else None


def _file(attribute: Usd.Attribute, asset: Sdf.AssetPath) -> Path | None:
    if not asset.path:
        return None
    if asset.resolvedPath:
        return Path(asset.resolvedPath)
    layer = attribute.GetPropertyStack()[0].layer
    if "<UDIM>" in asset.path:
        tiled = UsdShade.UdimUtils.ResolveUdimPath(asset.path, layer)
        if tiled:
            return Path(tiled)
    raise _RefusedError(
        "file-not-found",
        f"names @{asset.path}@, which is not there; restore it or correct the path",
    )


def _numbers(declared: Declared, value: Any) -> Any:
    is_bool = declared.type_name == "bool[]"
    try:
        array = np.array(value)
    except (TypeError, ValueError):
        raise _wrong_type(declared, value) from None
    if array.size and array.dtype.kind not in ("b" if is_bool else "fiu"):
        raise _wrong_type(declared, value)
    if is_bool:
        return array.astype(bool)
    width = _TUPLE_WIDTHS.get(declared.type_name.removesuffix("[]"), 0)
    expected_dimensions = declared.type_name.endswith("[]") + bool(width)
    if array.size and (array.ndim != expected_dimensions or (width and array.shape[-1] != width)):
        raise _wrong_type(declared, value)
    bad = np.flatnonzero(~np.isfinite(array.astype(np.float64)).reshape(-1))
    if bad.size:
        at = int(bad[0]) // max(width, 1)
        raise _RefusedError(
            "not-finite",
            f"is not finite at index {at} ({np.ravel(array)[bad[0]]}); correct the "
            f"{bad.size} numbers that are not",
        )
    return array.astype(np.float64)
