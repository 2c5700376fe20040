"""docs/cli.md is what the commands say of themselves."""

from __future__ import annotations

import importlib.util
from pathlib import Path
from types import ModuleType

import click
import pytest

from usdskin.cli import cli

DOCS = Path(__file__).resolve().parents[1] / "docs"


@pytest.fixture(scope="module")
def generator() -> ModuleType:
    spec = importlib.util.spec_from_file_location("generate_cli", DOCS / "generate_cli.py")
    assert spec is not None and spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


def test_reference_is_current(generator):
    written = (DOCS / "cli.md").read_text(encoding="utf-8")
    assert written == generator.reference(), "run: python docs/generate_cli.py"


def test_reference_has_every_command_and_option(generator):
    text = generator.reference()

    def check(name: str, command: click.Command) -> None:
        if isinstance(command, click.Group):
            for part, child in command.commands.items():
                check(f"{name} {part}", child)
            return
        section = text.partition(f"\n## {name}\n")[2].partition("\n## ")[0]
        assert "```sh\n" in section, f"{name} has no example"
        for option in command.params:
            if isinstance(option, click.Option) and not option.hidden:
                assert all(flag in section for flag in option.opts), f"{name} {option.opts}"

    check("usdskin", cli)


def test_reference_says_nothing_of_this_machine_or_of_clicks_inside(generator):
    text = generator.reference()
    for word in ("Sentinel", "UNSET", "object at 0x", str(Path.home()), "\b"):
        assert word not in text
