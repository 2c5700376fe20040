"""Imports run one way (docs: DESIGN), read from the syntax trees."""

from __future__ import annotations

import ast
import tomllib
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[1]
FOLDERS = {
    "usdskin": "usdskin",
    "schemas": "usdskin.schemas",
    "warp_kernels": "usdskin.warp_kernels",
}

SHARED = "usdskin.photographs"
"""What several steps do to photographs: above the vocabulary, below the steps."""

STEPS = ("usdskin.capture", "usdskin.estimate", "usdskin.render")
"""They meet in layers, never in Python."""

ABOVE_STEPS = (
    "usdskin.judge",
    "usdskin.plots",
    "usdskin.stage_checks",
    "usdskin.validate",
    "usdskin.inspect_estimates",
    "usdskin.inspect",
    "usdskin.commands",
    "usdskin.cli",
    "usdskin.__main__",
)
"""In the order in which each may import those before it."""

KERNELS = "usdskin.warp_kernels"
PURE = ("usdskin", "usdskin.errors", "usdskin.notes", "usdskin.stops")
"""Modules anyone may import, which themselves import the standard library alone."""

HEAVY = {"pxr", "warp", "numpy", "colour", "scipy", "open3d", "OpenImageIO", "OpenEXR"} | {
    "PyOpenColorIO",
    "rich",
}


@dataclass(frozen=True)
class Import:
    module: str
    """Who imports."""

    name: str
    """What is imported."""

    line: int
    within_function: bool


def modules() -> dict[str, Path]:
    found = {}
    for folder, package in FOLDERS.items():
        for path in sorted((ROOT / folder).rglob("*.py")):
            parts = path.relative_to(ROOT / folder).with_suffix("").parts
            found[".".join((package, *parts)).removesuffix(".__init__")] = path
    return found


MODULES = modules()


def imports() -> Iterator[Import]:
    for module, path in MODULES.items():
        tree = ast.parse(path.read_text(), str(path))
        yield from _imports_of(module, tree, path.name == "__init__.py")


def _imports_of(module: str, tree: ast.Module, is_package: bool) -> Iterator[Import]:
    inside = {
        child
        for node in ast.walk(tree)
        if isinstance(node, ast.FunctionDef | ast.AsyncFunctionDef)
        or (isinstance(node, ast.If) and ast.unparse(node.test) == "TYPE_CHECKING")
        for child in ast.walk(node)
    }
    for node in ast.walk(tree):
        if isinstance(node, ast.Import):
            names = [alias.name for alias in node.names]
        elif isinstance(node, ast.ImportFrom):
            assert node.level == 0, f"{module}:{node.lineno}: relative import"
            assert node.module is not None
            names = [_imported(node.module, alias.name) for alias in node.names]
        else:
            continue
        for name in names:
            yield Import(module, name, node.lineno, node in inside)


def _imported(package: str, name: str) -> str:
    """Return the module that ``from package import name`` loads."""
    return f"{package}.{name}" if f"{package}.{name}" in MODULES else package


IMPORTS = list(imports())


def within(name: str, package: str) -> bool:
    return name == package or name.startswith(f"{package}.")


def layer(module: str) -> str:
    for package in ("usdskin.schemas", KERNELS, SHARED, *STEPS, *ABOVE_STEPS):
        if within(module, package):
            return package
    return "vocabulary" if within(module, "usdskin") else "outside"


def refuse(broken: list[Import], rule: str) -> None:
    lines = [f"{item.module}:{item.line} imports {item.name}" for item in broken]
    assert not lines, f"{rule}:\n" + "\n".join(lines)


def test_schemas_import_nothing_of_ours_but_the_errors():
    broken = [
        item
        for item in IMPORTS
        if layer(item.module) == "usdskin.schemas"
        and within(item.name, "usdskin")
        and layer(item.name) != "usdskin.schemas"
        and item.name not in PURE
    ]
    refuse(broken, "schemas know pxr and the error tree")


def test_kernels_import_warp_and_numpy_only():
    allowed = ("warp", "numpy", "__future__", "math", "functools", "dataclasses", "typing", "enum")
    broken = [
        item
        for item in IMPORTS
        if layer(item.module) == KERNELS
        and not any(within(item.name, name) for name in (*allowed, "collections", KERNELS))
    ]
    refuse(broken, "warp_kernels take arrays and give arrays")


def test_only_those_who_compute_pixels_touch_warp():
    users = (KERNELS, SHARED, "usdskin.render", "usdskin.capture")
    broken = [
        item
        for item in IMPORTS
        if (within(item.name, "warp") or within(item.name, KERNELS))
        and layer(item.module) not in users
        and item.module not in ("usdskin.device", "usdskin.compilation")
    ]
    refuse(broken, "Warp starts on the device that all of them share")


def test_vocabulary_knows_no_step():
    broken = [
        item
        for item in IMPORTS
        if layer(item.module) == "vocabulary"
        and layer(item.name) in (*STEPS, *ABOVE_STEPS, SHARED, KERNELS)
    ]
    refuse(broken, "the vocabulary lies below the steps")


def test_photographs_know_no_step():
    broken = [
        item
        for item in IMPORTS
        if layer(item.module) == SHARED and layer(item.name) in (*STEPS, *ABOVE_STEPS)
    ]
    refuse(broken, "steps share photographs, which know none of them")


def test_steps_do_not_import_one_another():
    broken = [
        item
        for item in IMPORTS
        if layer(item.module) in STEPS
        and layer(item.name) in (*STEPS, *ABOVE_STEPS)
        and layer(item.name) != layer(item.module)
    ]
    refuse(broken, "steps meet in layers")


def test_what_lies_above_the_steps_is_not_imported_from_below():
    order = {name: index for index, name in enumerate(ABOVE_STEPS)}
    broken = [
        item
        for item in IMPORTS
        if layer(item.module) in order
        and order.get(layer(item.name), -1) > order[layer(item.module)]
    ]
    refuse(broken, "commands call steps, not the other way round")


def test_nobody_imports_stages_or_tests():
    broken = [
        item
        for item in IMPORTS
        if any(within(item.name, name) for name in ("stages", "tests", "benchmarks"))
        or item.name.split(".")[0] in ("schemas", "warp_kernels")
    ]
    refuse(broken, "stages are USD stages; folders are imported by their installed names")


@pytest.mark.parametrize("package", ["usdskin.cli", "usdskin.commands", "usdskin.__main__"])
def test_commands_import_heavy_modules_only_inside_functions(package):
    broken = [
        item
        for item in IMPORTS
        if within(item.module, package)
        and not item.within_function
        and item.name.split(".")[0] in HEAVY
    ]
    refuse(broken, "--help answers at once")


def test_foundations_import_the_standard_library_alone():
    broken = [
        item
        for item in IMPORTS
        if item.module in PURE and item.name.split(".")[0] in HEAVY | {"click", "usdskin"}
    ]
    refuse(broken, "everyone imports them")


def test_colour_science_and_open3d_load_only_where_they_are_used():
    """Importing colour takes 3 to 5 s and open3d 2 s."""
    broken = [
        item
        for item in IMPORTS
        if item.name.split(".")[0] in ("colour", "open3d", "scipy", "rich", "matplotlib")
        and not item.within_function
        and not item.module.endswith(".generate")  # run by hand, imported by nobody
    ]
    refuse(broken, "slow imports stay inside the functions that need them")


def test_pyproject_lists_every_package():
    with open(ROOT / "pyproject.toml", "rb") as file:
        settings = tomllib.load(file)["tool"]["setuptools"]
    there = {name for name, path in MODULES.items() if path.name == "__init__.py"}
    assert set(settings["packages"]) == there
    for folder, package in FOLDERS.items():
        assert settings["package-dir"][package] == folder
