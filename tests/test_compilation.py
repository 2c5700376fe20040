"""Kernels compiled ahead: none forgotten, none twice, and failures in one line."""

from __future__ import annotations

import json
import os
import subprocess
import sys
from pathlib import Path
from types import SimpleNamespace

import pytest

import usdskin.warp_kernels
from usdskin import compilation
from usdskin.device import open_workers
from usdskin.errors import DeviceError

KERNEL_FOLDER = Path(usdskin.warp_kernels.__file__).parent


class Told:
    """Progress that remembers."""

    def __init__(self) -> None:
        self.lines: list[str] = []

    def start(self, total: int, label: str) -> None:
        self.lines.append(f"{label} {total}")

    def advance(self, count: int = 1) -> None:
        self.lines.append(f"+{count}")

    def done(self) -> None:
        self.lines.append("done")


def usdskin_command(*arguments: str, cache: Path) -> subprocess.CompletedProcess[str]:
    return subprocess.run(
        [sys.executable, "-m", "usdskin", *arguments],
        env={**os.environ, "WARP_CACHE_PATH": str(cache)},
        capture_output=True,
        text=True,
        timeout=300,
    )


def test_every_module_that_defines_a_kernel_is_found():
    defining = {
        path.stem for path in KERNEL_FOLDER.rglob("*.py") if "@wp.kernel" in path.read_text()
    }
    found = {module.__name__.rpartition(".")[2] for module in compilation.kernel_modules()}
    assert found == defining


def test_a_new_module_is_found_without_being_listed(tmp_path, monkeypatch):
    (tmp_path / "brand_new.py").write_text(
        "import warp as wp\n\n\n@wp.kernel\ndef one(out: wp.array[wp.float32]):\n"
        "    out[wp.tid()] = 1.0\n"
    )
    folders = [*usdskin.warp_kernels.__path__, str(tmp_path)]
    monkeypatch.setattr(usdskin.warp_kernels, "__path__", folders)
    names = [module.__name__ for module in compilation.kernel_modules()]
    assert "usdskin.warp_kernels.brand_new" in names
    sys.modules.pop("usdskin.warp_kernels.brand_new")


def test_modules_without_kernels_are_not_compiled():
    names = {module.__name__.rpartition(".")[2] for module in compilation.kernel_modules()}
    assert not names & {"structs", "lookup", "skin"}


@pytest.fixture
def slow_compiler(monkeypatch):
    """A compiler that compiles on demand, for modules that nothing has compiled."""
    compiled: list[str] = []
    monkeypatch.setattr(compilation, "is_compiled", lambda module, _: module.__name__ in compiled)
    monkeypatch.setattr(
        compilation.wp,
        "load_module",
        lambda name, device, max_workers=None: compiled.append(name),
    )
    yield compiled
    compilation.abandon()


def module(name):
    return SimpleNamespace(__name__=f"usdskin.warp_kernels.{name}")


def test_what_was_begun_is_compiled_once_and_progress_tells_each(slow_compiler):
    told = Told()
    parts = [module("a"), module("b")]
    compilation.begin(parts, "cpu", told)
    compilation.begin(parts, "cpu", told)
    for part in parts:
        compilation.load(part, "cpu")
    compilation.finish()
    assert sorted(slow_compiler) == [f"usdskin.warp_kernels.{name}" for name in "ab"]
    assert told.lines[0] == f"{compilation.COMPILING} 2"
    assert told.lines.count("+1") == 2


def test_nothing_is_said_where_all_is_compiled(slow_compiler):
    slow_compiler.append("usdskin.warp_kernels.a")
    told = Told()
    compilation.prepare([module("a")], "cpu", told)
    assert told.lines == []


def test_a_compiler_that_fails_is_one_line(monkeypatch):
    def fail(name, device, max_workers=None):
        raise Exception("CPU kernel build failed with error code 1")

    monkeypatch.setattr(compilation, "is_compiled", lambda *_: False)
    monkeypatch.setattr(compilation.wp, "load_module", fail)
    with pytest.raises(DeviceError, match="kernel module a cannot be compiled for cpu") as caught:
        compilation.prepare([module("a")], "cpu", Told())
    assert "\n" not in str(caught.value)


def test_a_full_disk_is_one_line(monkeypatch):
    def fail(name, device, max_workers=None):
        raise OSError(28, "No space left on device")

    open_workers("cpu")
    monkeypatch.setattr(compilation, "is_compiled", lambda *_: False)
    monkeypatch.setattr(compilation.wp, "load_module", fail)
    with pytest.raises(DeviceError, match=r"No space left on device.*WARP_CACHE_PATH"):
        compilation.load(module("a"), "cpu")


def test_cache_that_cannot_be_made_is_one_line(tmp_path):
    file = tmp_path / "file"
    file.write_text("")
    done = usdskin_command("warmup", cache=file)
    assert done.returncode == 6
    assert done.stdout == ""
    (line,) = done.stderr.splitlines()
    assert str(file) in line
    assert "WARP_CACHE_PATH" in line


@pytest.mark.slow
def test_warmup_compiles_everything_and_then_has_nothing_left_to_do(tmp_path):
    first = usdskin_command("warmup", "--json", "--device", "cpu", cache=tmp_path)
    assert first.returncode == 0, first.stderr
    events = [json.loads(line) for line in first.stdout.splitlines()]
    kernels = {event["module"]: event for event in events if event["event"] == "kernels"}
    assert set(kernels) == {
        module.__name__.rpartition(".")[2] for module in compilation.kernel_modules()
    }
    assert all(event["compiled"] and event["seconds"] > 0 for event in kernels.values())
    assert Path(events[-1]["cache"]).parent == tmp_path

    before = sorted(tmp_path.rglob("*"))
    second = usdskin_command("warmup", "--device", "cpu", cache=tmp_path)
    assert "all was ready" in second.stdout
    assert "compile" not in second.stderr
    assert sorted(tmp_path.rglob("*")) == before


@pytest.mark.slow
def test_first_picture_says_that_it_compiles_and_is_that_of_the_second(tmp_path):
    stage = Path(__file__).resolve().parents[1] / "stages" / "sphere" / "sphere.usda"
    pictures = [tmp_path / "first.exr", tmp_path / "second.exr"]
    cache = tmp_path / "cache"
    said = []
    for picture in pictures:
        done = usdskin_command("render", str(stage), str(picture), "-w", "32", cache=cache)
        assert done.returncode == 0, done.stderr
        said.append(done.stderr)
    assert compilation.COMPILING in said[0]
    assert compilation.COMPILING not in said[1]
    import OpenEXR

    first, second = (OpenEXR.File(str(picture)).channels()["RGBA"].pixels for picture in pictures)
    assert (first == second).all()
