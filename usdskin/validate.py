"""Look a stage through for what is wrong with it, without rendering it.

The findings are those of USD's own validators (``UsdValidation``), of the values of our schemas
(``usdskin.prims``), and of what belongs together on a stage (``usdskin.stage_checks``).
"""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import Any

from pxr import Sdf, Usd, UsdValidation

from usdskin.errors import LayerError
from usdskin.findings import Finding, Severity, finding
from usdskin.layers import corruption_as_errors, layer_name, open_stage, quiet_diagnostics
from usdskin.notes import Note
from usdskin.prims.applied import applied_problems
from usdskin.prims.values import PrimError, Problem, declared_attributes, examine_schema
from usdskin.schemas import SCHEMA_NAMES
from usdskin.stage_checks import CHECKS

_ORDER = {"error": 0, "warning": 1, "info": 2}

# Covered by findings of ours that name the prim, the attribute and the remedy.
_COVERED = ("CompositionErrorTest",)
_MISSING_FILE = ".UnresolvableDependency"


def validate(path: str | Path) -> list[Finding]:
    """Return what is wrong with a stage, errors first.

    Args:
        path: Layer to open.

    Raises:
        LayerError: The layer cannot be opened at all.
    """
    notes: list[Note] = []
    stage = open_stage(path, notes)
    root = stage.GetRootLayer().GetDisplayName()
    found = [Finding("error", note.code, root, note.path, note.message) for note in notes]
    found += _usd_findings(stage)
    with quiet_diagnostics():
        for prim in composed_prims(stage):
            found += _prim_findings(prim)
    unique = dict.fromkeys(_without_doubles(found))
    return sorted(unique, key=lambda item: (_ORDER[item.severity], item.path, item.code))


def _without_doubles(found: list[Finding]) -> Iterator[Finding]:
    """Leave out USD's finding of a missing file where ours says at which prim it is missing."""
    ours = [item.message for item in found if item.code in ("file-not-found", "composition-error")]
    for item in found:
        name = Path(item.message.rstrip(".'").rpartition("'")[2]).name
        doubled = item.code.endswith(_MISSING_FILE) and any(name in text for text in ours)
        if not doubled:
            yield item


def composed_prims(stage: Usd.Stage) -> Iterator[Usd.Prim]:
    """Yield the prims of a stage, those that instances share only once."""
    shared: set[Sdf.Path] = set()
    for prim in Usd.PrimRange.Stage(stage, Usd.TraverseInstanceProxies()):
        if prim.IsInstanceProxy():
            path = prim.GetPrimInPrototype().GetPath()
            if path in shared:
                continue
            shared.add(path)
        yield prim


def _usd_findings(stage: Usd.Stage) -> Iterator[Finding]:
    validators = UsdValidation.ValidationRegistry().GetOrLoadAllValidators()
    with quiet_diagnostics():
        errors = UsdValidation.ValidationContext(validators).Validate(stage)
    severities: dict[Any, Severity] = {
        UsdValidation.ValidationErrorType.Error: "error",
        UsdValidation.ValidationErrorType.Warn: "warning",
        UsdValidation.ValidationErrorType.Info: "info",
    }
    for error in errors:
        validator = error.GetValidator().GetMetadata().name.rpartition(":")[2]
        if validator not in _COVERED and error.GetType() in severities:
            layer, path = _site(stage, error)
            yield Finding(
                severities[error.GetType()],
                f"usd:{validator}.{error.GetName()}",
                layer,
                path,
                " ".join(error.GetMessage().split()),
            )


def _site(stage: Usd.Stage, error: Any) -> tuple[str, str]:
    """Return the layer and prim path an error of USD's validators is about."""
    for site in error.GetSites():
        subject = site.GetProperty() if site.IsProperty() else site.GetPrim()
        if subject:
            return layer_name(subject), str(subject.GetPrim().GetPath())
        spec = site.GetPropertySpec() or site.GetPrimSpec()
        if spec:
            return spec.layer.GetDisplayName(), str(spec.path.GetPrimPath())
        if site.GetLayer():
            return site.GetLayer().GetDisplayName(), "/"
    return stage.GetRootLayer().GetDisplayName(), "/"


def _prim_findings(prim: Usd.Prim) -> Iterator[Finding]:
    try:
        with corruption_as_errors(layer_name(prim)):
            problems = [*applied_problems(prim), *_schema_problems(prim)]
    except LayerError as error:
        yield finding("error", prim, "unreadable", str(error))
        return
    for problem in problems:
        yield finding("error", prim, problem.code, problem.message, problem.name)
    if problems:
        return
    for check in CHECKS:
        try:
            with corruption_as_errors(layer_name(prim)):
                yield from check(prim)
        except PrimError as error:
            problem = error.problem
            yield finding("error", prim, problem.code, problem.message, problem.name)
        except LayerError as error:
            yield finding("error", prim, "unreadable", str(error))


def _schema_problems(prim: Usd.Prim) -> Iterator[Problem]:
    """Yield the problems of every applied schema of ours, at all of its times."""
    for applied in prim.GetAppliedSchemas():
        schema, _, instance = applied.partition(":")
        if schema not in SCHEMA_NAMES:
            continue
        names = [declared.full_name(instance) for declared in declared_attributes(schema)]
        seen = set()
        for time in _times(prim, names):
            for problem in examine_schema(prim, schema, time, instance)[1]:
                if (problem.name, problem.code) not in seen:
                    seen.add((problem.name, problem.code))
                    yield problem


def _times(prim: Usd.Prim, names: list[str]) -> list[Usd.TimeCode]:
    attributes = [prim.GetAttribute(name) for name in names if prim.HasAttribute(name)]
    samples = sorted({time for attribute in attributes for time in attribute.GetTimeSamples()})
    return [Usd.TimeCode(time) for time in samples] or [Usd.TimeCode.Default()]
