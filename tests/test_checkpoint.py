"""An interrupted picture goes on where it ended, with the same pixels, or is rendered anew."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import time
from dataclasses import dataclass
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import OpenEXR
import pytest

from usdskin.images import read_image
from usdskin.progress import SilentProgress
from usdskin.render import checkpoint as module
from usdskin.render.checkpoint import Checkpoint, fingerprint, partial_path
from usdskin.render.overrides import RenderOverrides
from usdskin.render.render import render_stage

STAGE = Path(__file__).resolve().parents[1] / "stages" / "sphere" / "sphere.usda"


class Stop(BaseException):
    """An interruption."""


def arrays(count=40):
    return {"xyza": np.zeros((count, 4), np.float32), "hits": np.zeros(count, np.int32)}


def checkpoint(folder, key="key", **more):
    notes = []
    return Checkpoint(folder / "out.exr", lambda: key, notes, **{"resume": True, **more}), notes


def fill(part, begin, end):
    part["xyza"][begin:end] = np.arange(begin, end)[:, None] + 0.25
    part["hits"][begin:end] = np.arange(begin, end)


def interrupted(folder, *tiles, key="key", **more):
    """Finish some tiles, then stop."""
    part = arrays()
    kept, notes = checkpoint(folder, key, **more)
    with pytest.raises(Stop) as caught, kept.tiles(part) as telling:
        for begin, end in tiles:
            fill(part, begin, end)
            telling.finished(begin, end)
        raise Stop
    return caught.value, notes


def resumed(folder, key="key"):
    part = arrays()
    kept, notes = checkpoint(folder, key)
    with kept.tiles(part) as tiles:
        there = [begin for begin in range(0, 40, 10) if tiles.restored(begin, begin + 10)]
    return part, there, notes


def test_finished_tiles_come_back_and_the_others_do_not(tmp_path):
    interrupted(tmp_path, (10, 20), (30, 40))
    part, there, notes = resumed(tmp_path)
    expected = arrays()
    fill(expected, 10, 20)
    fill(expected, 30, 40)
    assert there == [10, 30]
    assert notes == []
    for name, values in expected.items():
        np.testing.assert_array_equal(part[name], values)


def test_a_second_interruption_adds_to_the_first(tmp_path):
    interrupted(tmp_path, (0, 10))
    interrupted(tmp_path, (20, 30))
    assert resumed(tmp_path)[1] == [0, 20]


def test_larger_tiles_than_those_kept_are_rendered_again(tmp_path):
    interrupted(tmp_path, (0, 10))
    kept, _ = checkpoint(tmp_path)
    with kept.tiles(arrays()) as tiles:
        assert tiles.restored(2, 8)
        assert not tiles.restored(0, 20)


@pytest.mark.parametrize("cut", [1, 40, 150, 230])
def test_a_record_that_was_cut_short_is_dropped_and_what_is_before_it_stays(tmp_path, cut):
    interrupted(tmp_path, (0, 10), (10, 20))
    path = partial_path(tmp_path / "out.exr")
    path.write_bytes(path.read_bytes()[:-cut])
    assert resumed(tmp_path)[1] == [0]
    interrupted(tmp_path, (30, 40))
    assert resumed(tmp_path)[1] == [0, 30]


def test_a_changed_byte_is_found_by_the_checksum(tmp_path):
    interrupted(tmp_path, (0, 10), (10, 20))
    path = partial_path(tmp_path / "out.exr")
    content = bytearray(path.read_bytes())
    content[-3] ^= 1
    path.write_bytes(content)
    assert resumed(tmp_path)[1] == [0]


@pytest.mark.parametrize("content", [b"", b"{}\n", b"\0" * 100_000, b"x" * 100_000])
def test_a_foreign_file_is_told_and_not_used(tmp_path, content):
    partial_path(tmp_path / "out.exr").write_bytes(content)
    part, there, notes = resumed(tmp_path)
    assert there == [] and not part["xyza"].any()
    assert [note.code for note in notes] == ["partial-not-used"]


def test_what_another_stage_left_is_told_and_not_used(tmp_path):
    interrupted(tmp_path, (0, 10), key="before")
    _, there, notes = resumed(tmp_path, key="after")
    assert there == []
    assert "another stage" in notes[0].message


def test_without_resume_a_short_render_leaves_nothing(tmp_path):
    stop, _ = interrupted(tmp_path, (0, 10), resume=False)
    assert list(tmp_path.iterdir()) == []
    assert not hasattr(stop, "__notes__")


def test_without_resume_a_long_render_is_kept_and_says_how_to_go_on(tmp_path):
    now = iter(range(0, 10_000, 31))
    stop, _ = interrupted(tmp_path, (0, 10), (10, 20), resume=False, clock=lambda: next(now))
    assert "--resume" in stop.__notes__[0]
    assert resumed(tmp_path)[1] == [0, 10]


def test_snapshots_come_at_the_interval(tmp_path):
    shown = []
    ticks = [0.0, 1.0, 2.0, 5.5, 5.6, 6.0, 6.5, 12.0, 12.1, 12.2, 12.3]
    now = iter(ticks)
    kept, _ = checkpoint(
        tmp_path,
        interval_s=5.0,
        preview=lambda path, part: shown.append((path.name, int(part["hits"].max()))),
        clock=lambda: next(now),
    )
    part = arrays()
    with kept.tiles(part) as tiles:
        for begin in range(0, 40, 10):
            fill(part, begin, begin + 10)
            tiles.finished(begin, begin + 10)
    assert {name for name, _ in shown} == {"out.exr.snapshot.png"}
    assert 1 <= len(shown) <= 2


def test_a_disk_that_is_full_is_told_and_the_render_goes_on(tmp_path):
    (tmp_path / "out.exr.partial").mkdir()
    notes = interrupted(tmp_path, (0, 10))[1]
    assert "partial-not-kept" in [note.code for note in notes]


@dataclass(frozen=True)
class Inputs:
    name: str
    values: np.ndarray
    inside: tuple


def test_fingerprint_changes_with_every_input_and_with_nothing_else():
    def inputs(name="a", value=1.0, inside=(1, None, {"k": 2.0})):
        return Inputs(name, np.array([[value, 2.0]]), inside)

    first = fingerprint(inputs())
    assert first == fingerprint(inputs())
    changed = [inputs("b"), inputs(value=1.5), inputs(inside=(1, None, {"k": 3.0}))]
    assert len({first, *map(fingerprint, changed)}) == 4
    assert fingerprint("ab", "c") != fingerprint("a", "bc")


@pytest.mark.parametrize("name", ["forearm/forearm.usda", "skin_tones/skin_tones.usda"])
def test_every_input_of_a_shipped_stage_has_a_fingerprint(tmp_path, monkeypatch, name):
    keys = []

    def stop(*_given, checkpoint, **_more):
        keys.append(checkpoint.key())
        raise Stop

    monkeypatch.setattr("usdskin.render.render.integrate", stop)
    for _ in range(2):
        with pytest.raises(Stop):
            overrides = RenderOverrides(width=16, samples=1)
            render_stage(STAGE.parents[1] / name, tmp_path / "out.exr", overrides, SilentProgress())
    assert keys[0] == keys[1]


def render(tmp_path, **overrides):
    given = {"width": 40, "samples": 4, "threads": 1, "png": False, "spectral_output": True}
    return render_stage(
        STAGE, tmp_path / "out.exr", RenderOverrides(**given, **overrides), SilentProgress()
    )


def pixels(tmp_path):
    return [
        {name: channel.pixels for name, channel in OpenEXR.File(str(path)).channels().items()}
        for path in (tmp_path / "out.exr", tmp_path / "out.spectral.exr")
    ]


def assert_same(found, expected):
    assert found.keys() == expected.keys()
    for name, values in expected.items():
        np.testing.assert_array_equal(found[name], values)


def interrupt_after(monkeypatch, count):
    """Let a render finish some tiles of 5 rows and stop in the next."""
    from usdskin.render import integrate

    monkeypatch.setattr(integrate, "TILE_PIXELS", 200)
    real = integrate.film.render_tile
    done = []

    def render_tile(*arguments):
        if len(done) == count:
            raise KeyboardInterrupt
        done.append(1)
        real(*arguments)

    monkeypatch.setattr(integrate.film, "render_tile", render_tile)
    return done


def test_resumed_picture_is_that_of_an_uninterrupted_render_to_the_bit(tmp_path, monkeypatch):
    with monkeypatch.context() as patched:
        interrupt_after(patched, 3)
        with pytest.raises(KeyboardInterrupt):
            render(tmp_path, resume=True)
    assert [path.name for path in tmp_path.iterdir()] == ["out.exr.partial"]
    with monkeypatch.context() as patched:
        done = interrupt_after(patched, -1)
        report = render(tmp_path, resume=True)
    assert len(done) == 8 - 3
    assert not report.notes
    assert not partial_path(tmp_path / "out.exr").exists()
    found = pixels(tmp_path)
    render(tmp_path)
    for mine, whole in zip(found, pixels(tmp_path), strict=True):
        assert_same(mine, whole)


@pytest.mark.parametrize(
    "change", [{"attributes": ("/World/Ball.radius=0.05",)}, {"samples": 5}, {"seed": 3}]
)
def test_changed_stage_or_settings_are_never_mixed(tmp_path, monkeypatch, change):
    with monkeypatch.context() as patched:
        interrupt_after(patched, 3)
        with pytest.raises(KeyboardInterrupt):
            render(tmp_path, resume=True)
    given = {"width": 40, "samples": 4, "threads": 1, "png": False, "spectral_output": True}
    overrides = RenderOverrides(**{**given, **change}, resume=True)
    report = render_stage(STAGE, tmp_path / "out.exr", overrides, SilentProgress())
    assert [note.code for note in report.notes] == ["partial-not-used"]
    found = pixels(tmp_path)
    overrides = RenderOverrides(**{**given, **change})
    render_stage(STAGE, tmp_path / "out.exr", overrides, SilentProgress())
    assert_same(found[1], pixels(tmp_path)[1])


def test_changed_layer_is_never_mixed(tmp_path, monkeypatch):
    """The command line is the same, the file is not."""
    layer = tmp_path / "own.usda"
    layer.write_text(f'#usda 1.0\n(\n    subLayers = [@{STAGE}@]\n)\nover "World" {{}}\n')
    given = {"width": 40, "samples": 4, "threads": 1, "png": False, "resume": True}
    overrides = RenderOverrides(**given)
    with monkeypatch.context() as patched:
        interrupt_after(patched, 3)
        with pytest.raises(KeyboardInterrupt):
            render_stage(layer, tmp_path / "out.exr", overrides, SilentProgress())
    layer.write_text(
        layer.read_text().replace("{}", '{\n over "Ball" {\n double radius = 0.07\n}\n}')
    )
    report = render_stage(layer, tmp_path / "out.exr", overrides, SilentProgress())
    assert "partial-not-used" in [note.code for note in report.notes]


def test_skip_existing_does_not_skip_what_is_unfinished(tmp_path):
    render(tmp_path)
    assert render(tmp_path, skip_existing=True, resume=True).paths == []
    partial_path(tmp_path / "out.exr").write_bytes(b"")
    assert render(tmp_path, skip_existing=True).paths == []
    assert render(tmp_path, skip_existing=True, resume=True).paths != []


def test_snapshot_shows_what_is_finished_and_goes_with_the_end(tmp_path, monkeypatch):
    with monkeypatch.context() as patched:
        interrupt_after(patched, 5)
        patched.setattr(module, "KEEP_EVERY_S", 0.0)
        with pytest.raises(KeyboardInterrupt):
            render(tmp_path, snapshot_s=1e-6)
    snapshot = tmp_path / "out.exr.snapshot.png"
    shown = read_image(snapshot).pixels
    assert shown.shape[:2] == (40, 40)
    assert shown[20, 20, :3].max() > 0.0 and not shown[30:].any()
    render(tmp_path, resume=True)
    assert not snapshot.exists()


def test_nothing_is_left_beside_a_finished_picture(tmp_path):
    render(tmp_path, resume=True, snapshot_s=1e-6)
    assert sorted(path.name for path in tmp_path.iterdir()) == ["out.exr", "out.spectral.exr"]


def test_spectra_that_do_not_fit_into_memory_are_kept_on_disk_and_are_the_same(
    tmp_path, monkeypatch
):
    from usdskin.render import memory

    render(tmp_path)
    expected = pixels(tmp_path)
    kinds = []
    monkeypatch.setattr(memory, "available_bytes", lambda: 1_000_000)
    real = memory.np.memmap
    monkeypatch.setattr(
        memory.np, "memmap", lambda *given, **more: kinds.append(1) or real(*given, **more)
    )
    render(tmp_path)
    assert kinds == [1]
    for mine, whole in zip(pixels(tmp_path), expected, strict=True):
        assert_same(mine, whole)
    assert sorted(path.name for path in tmp_path.iterdir()) == ["out.exr", "out.spectral.exr"]


def test_disk_without_room_for_the_spectra_is_one_line(tmp_path, monkeypatch):
    from usdskin.errors import DeviceError
    from usdskin.render import memory

    def full(*_):
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(memory, "available_bytes", lambda: 1_000_000)
    monkeypatch.setattr(memory.os, "posix_fallocate", full)
    with pytest.raises(DeviceError, match="No space left on device"):
        render(tmp_path)
    assert list(tmp_path.iterdir()) == []


def test_a_disk_is_not_filled_to_find_that_there_is_no_room(tmp_path, monkeypatch):
    from usdskin.errors import DeviceError
    from usdskin.render import memory

    reserved = []
    nearly_full = SimpleNamespace(free=50_000)
    monkeypatch.setattr(memory, "available_bytes", lambda: 1_000_000)
    monkeypatch.setattr(memory.shutil, "disk_usage", lambda _: nearly_full)
    monkeypatch.setattr(memory.os, "posix_fallocate", lambda *given: reserved.append(given))
    with pytest.raises(DeviceError, match=r"GiB of spectra.*No space left on device.*make the"):
        render(tmp_path)
    assert not reserved
    assert list(tmp_path.iterdir()) == []


@pytest.mark.slow
def test_terminated_render_keeps_the_old_picture_and_resumes(tmp_path):
    out = tmp_path / "out.exr"
    out.write_bytes(b"old")
    command = [sys.executable, "-m", "usdskin", "--threads", "1", "render", str(STAGE), str(out)]
    command += ["-w", "512", "-p", "256", "--resume", "--snapshot", "0.3", "--no-png"]
    running = subprocess.Popen(command, stderr=subprocess.PIPE, text=True)
    limit = time.monotonic() + 120
    while not partial_path(out).exists() and time.monotonic() < limit:
        time.sleep(0.05)
    os.kill(running.pid, signal.SIGTERM)
    said = running.communicate(timeout=60)[1]
    assert running.returncode == 143, said
    assert "--resume" in said.splitlines()[-1]
    assert out.read_bytes() == b"old"
    assert partial_path(out).exists()
    done = subprocess.run(command, capture_output=True, text=True, timeout=300)
    assert done.returncode == 0, done.stderr
    assert [path.name for path in tmp_path.iterdir()] == ["out.exr"]
