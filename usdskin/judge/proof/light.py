"""The true light of a proof: solved from a set, or one that was solved before."""

from __future__ import annotations

import os
from collections.abc import Callable, Iterable
from dataclasses import dataclass
from pathlib import Path

from usdskin.errors import LayerError
from usdskin.estimate.light.step import LightOptions
from usdskin.judge.proof.place import Place
from usdskin.judge.proof.record import Doing
from usdskin.layers import open_stage, quiet_diagnostics, used_files, write_layer
from usdskin.progress import Progress

# isort: split
# After ours, which register the schemas.
from pxr import Sdf, Usd, UsdGeom

ONLY_CLASS = "light"
"""Name of the class of light where there is only one."""


@dataclass(frozen=True, slots=True, eq=False)
class TrueLight:
    """What really lights the set."""

    light: Path
    """The whole light."""

    classes: dict[str, Path]
    """The light of every class alone; the whole light where there is one class."""


def solve_light(
    set_layer: Path, place: Place, height: int, progress: Progress, doing: Doing
) -> None:
    """Write the true light of a set and of each of its classes.

    Args:
        set_layer: The set.
        place: Where to write.
        height: Rows of the light.
        progress: Told how far it is.
        doing: Takes files and classes.
    """
    from usdskin.judge.truth.solve import solve_set

    solved = solve_set(
        set_layer, place.truth_light, height=height, progress=progress, notes=doing.notes
    )
    doing.facts["classes"] = sorted(solved.classes)
    doing.writes += _files_beside(place, [solved.light, *solved.classes.values()])


def adopt_light(source: Path, place: Place, doing: Doing) -> None:
    """Write layers that refer to a light that was solved before.

    Its classes are the layers beside it that begin with its name: ``light_tubes.usda`` beside
    ``light.usda``.

    Args:
        source: The light.
        place: Where to write.
        doing: Takes files and classes.
    """
    classes = classes_beside(source)
    doing.facts["classes"] = sorted(classes)
    for file, target in [
        (source, place.truth_light),
        *((file, place.truth_class(name)) for name, file in classes.items()),
    ]:
        doing.writes.append(_refer(file, target))


def classes_beside(source: Path) -> dict[str, Path]:
    """Return the layers of a light's classes, by their names."""
    begin = f"{source.stem}_"
    found = {
        path.stem.removeprefix(begin): path
        for path in sorted(source.parent.glob(f"{begin}*{source.suffix}"))
    }
    return {name: path for name, path in found.items() if name.isidentifier()}


def true_light(place: Place, classes: list[str]) -> TrueLight:
    """Return the true light that a proof holds."""
    if len(classes) < 2:
        name = classes[0] if classes else ONLY_CLASS
        return TrueLight(place.truth_light, {name: place.truth_light})
    return TrueLight(place.truth_light, {name: place.truth_class(name) for name in classes})


def light_files(layer: Path) -> list[Path]:
    """Return everything that a light is made of: its layers and maps."""
    stage = open_stage(layer)
    files = list(used_files(stage))
    for prim in stage.Traverse():
        for attribute in prim.GetAttributes():
            value = attribute.Get() if attribute.GetTypeName() == "asset" else None
            if value is not None and value.resolvedPath:
                files.append(Path(value.resolvedPath))
    return [file for file in dict.fromkeys(files) if file.is_file()]


def estimate_options(
    place: Place, classes: Iterable[str]
) -> tuple[LightOptions, list[str], list[Path]]:
    """Return how a proof estimates its light, the same as options of the command, and what is read.

    Args:
        place: Holds the captures.
        classes: Those that were captured alone too.
    """
    alone = tuple((name, place.capture(name)) for name in classes)
    words = [
        word
        for name, layer in alone
        for word in ("--class-capture", f"{name}={place.name_of(layer)}")
    ]
    layers = [place.capture(), *(layer for _, layer in alone)]
    pictures = [
        layer.with_name(name) for layer in layers for name in ("panorama.exr", "stddev.exr")
    ]
    reads = [*layers, *(picture for picture in pictures if picture.exists())]
    return LightOptions(class_captures=alone), words, reads


def _files_beside(place: Place, layers: list[Path]) -> list[Path]:
    inside = place["truth"].resolve()
    files = [file for layer in layers for file in light_files(layer)]
    return [file for file in dict.fromkeys(files) if inside in file.resolve().parents]


def _refer(source: Path, target: Path) -> Path:
    """Write a layer that references another's default prim."""
    referred = open_stage(source)
    root = referred.GetDefaultPrim()
    if not root:
        raise LayerError(f"{source}: has no default prim to be referenced; set defaultPrim")
    stage = Usd.Stage.CreateInMemory()
    UsdGeom.SetStageUpAxis(stage, UsdGeom.GetStageUpAxis(referred))
    UsdGeom.SetStageMetersPerUnit(stage, UsdGeom.GetStageMetersPerUnit(referred))
    prim = stage.DefinePrim(f"/{root.GetName()}", str(root.GetTypeName()))
    stage.SetDefaultPrim(prim)
    name = Path(os.path.relpath(source.resolve(), target.parent.resolve())).as_posix()
    reference: Callable[[str], Sdf.Reference] = Sdf.Reference
    with quiet_diagnostics():  # in memory, a stage cannot find what lies beside its file
        prim.GetReferences().AddReference(reference(name))
    return write_layer(stage, target)
