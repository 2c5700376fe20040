"""Sequences: what does not change between frames is read, baked and uploaded once."""

from __future__ import annotations

import time
from collections import Counter
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from light_stages import write_rgb

from usdskin import compilation
from usdskin.errors import ImageError
from usdskin.images import read_image
from usdskin.progress import SilentProgress
from usdskin.render import domes, light_maps, scene, traced_lights, uploading
from usdskin.render import render as rendering
from usdskin.render.frame_writer import OVERLAP_BYTES, FrameWriter
from usdskin.render.overrides import RenderOverrides
from usdskin.render.render import render_stage
from usdskin.warp_kernels import raster

# isort: split
# After ours, which register the schemas.

FRAMES = (1.0, 2.0, 3.0)

TURN = """float xformOp:rotateY.timeSamples = {1: 0, 2: 31, 3: 95}
    uniform token[] xformOpOrder = ["xformOp:rotateY"]"""

STAGE = """#usda 1.0
(
    metersPerUnit = 1
    upAxis = "Y"
    subLayers = []
)
def Xform "Orbit" {{
    {orbit}
    def Camera "Camera" {{
        double3 xformOp:translate = (0, 0.2, 4)
        uniform token[] xformOpOrder = ["xformOp:translate"]
        {camera}
    }}
}}
def Xform "Rig" {{
    {rig}
    def DomeLight "Sky" {{
        asset inputs:texture:file = @./sky.exr@
        {sky}
    }}
    def DistantLight "Sun" {{
        float inputs:intensity = 0.5
        float3 xformOp:rotateXYZ = (-40, 20, 0)
        uniform token[] xformOpOrder = ["xformOp:rotateXYZ"]
        {sun}
    }}
}}
def RectLight "Panel" {{
    float inputs:intensity = 3
    double3 xformOp:translate = (0, 0, 3)
    uniform token[] xformOpOrder = ["xformOp:translate"]
    {panel}
}}
def Xform "Body" {{
    {body}
    def Sphere "Head" (prepend apiSchemas = ["MaterialBindingAPI"]) {{
        rel material:binding = </Paint>
        {head}
    }}
    def Cube "Hat" {{
        double size = 1
        double3 xformOp:translate = (0.8, 0.9, 0.3)
        uniform token[] xformOpOrder = ["xformOp:translate"]
        {hat}
    }}
}}
def Material "Paint" {{
    token outputs:surface.connect = </Paint/Surface.outputs:surface>
    def Shader "Surface" {{
        uniform token info:id = "UsdPreviewSurface"
        color3f inputs:diffuseColor = (0.7, 0.4, 0.2)
        float inputs:roughness = 0.3
        {paint}
        token outputs:surface
    }}
}}
"""

MOVES = {
    "orbit": TURN,
    "camera": "float focalLength.timeSamples = {1: 50, 3: 70}",
    "rig": TURN,
    "sky": "float inputs:intensity.timeSamples = {1: 1, 2: 2, 3: 2}",
    "sun": "color3f inputs:color.timeSamples = {1: (1, 1, 1), 2: (1, 0.2, 0.2), 3: (1, 0.2, 0.2)}",
    "panel": 'token visibility.timeSamples = {1: "inherited", 2: "invisible"}',
    "body": TURN,
    "head": "double radius.timeSamples = {1: 1, 2: 0.8, 3: 1.1}",
    "hat": 'token visibility.timeSamples = {1: "invisible", 2: "inherited"}',
    "paint": "float inputs:metallic.timeSamples = {1: 0, 2: 0.5, 3: 1}",
}

READERS = {
    "light map": (domes, "read_image"),
    "shapes": (scene, "read_gprim"),
    "materials": (scene, "read_materials"),
    "light": (uploading, "build_light_field"),
    "reflections": (uploading, "add_reflections"),
    "maps": (light_maps, "bake_maps"),
    "upload": (uploading, "_upload_geometry"),
    "tables": (uploading, "build_surfaces"),
    "tree": (traced_lights, "build_light_tree"),
}


@pytest.fixture(scope="module")
def sky(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A light map with a lamp in it, which nothing turns into itself."""
    polar, turns = np.meshgrid(np.linspace(0, np.pi, 32), np.arange(64) / 64, indexing="ij")
    pixels = np.stack(
        [1 + np.cos(polar), 1 + np.sin(2 * np.pi * turns), 1.2 + np.cos(4 * np.pi * turns)], -1
    )
    pixels[9:11, 20:22] = 60.0
    path = tmp_path_factory.mktemp("sky") / "sky.exr"
    write_rgb(path, pixels.astype(np.float32))
    return path


def write_stage(sky: Path, folder: Path, *moving: str) -> Path:
    path = folder / "shot.usda"
    (folder / "sky.exr").write_bytes(sky.read_bytes())
    path.write_text(STAGE.format(**{name: MOVES[name] * (name in moving) for name in MOVES}))
    return path


def render(stage: Path, name: str, frames: tuple[float, ...], **flags: object) -> list[np.ndarray]:
    """Render frames of a stage; return the pictures."""
    output = stage.with_name(f"{name}.####.exr")
    overrides = RenderOverrides(frames=frames, resolution=(16, 16), dome="show", png=False, **flags)  # type: ignore[arg-type]
    report = render_stage(stage, output, overrides, SilentProgress())
    assert not report.failures
    return [read_image(path).pixels for path in report.paths]


def assert_frames_stand_alone(stage: Path, **flags: object) -> None:
    """Rendering frames together gives what rendering each by itself does."""
    together = render(stage, "together", FRAMES, **flags)
    for number, found in zip(FRAMES, together, strict=True):
        (alone,) = render(stage, "alone", (number,), **flags)
        np.testing.assert_array_equal(found, alone, err_msg=f"frame {number:g}")
    assert any((each != together[0]).any() for each in together[1:])


TRACED = {"integrator": "traced", "samples": 4}


@pytest.mark.parametrize("moving", [*([name] for name in MOVES if name != "panel"), [*MOVES]],
                         ids="-".join)  # fmt: skip
def test_frames_of_a_sequence_are_those_rendered_alone(moving, sky, tmp_path):
    assert_frames_stand_alone(write_stage(sky, tmp_path, *moving), samples=4)


@pytest.mark.parametrize("moving", [["rig"], ["panel"], [*MOVES]], ids="-".join)
def test_traced_frames_of_a_sequence_are_those_rendered_alone(moving, sky, tmp_path):
    assert_frames_stand_alone(write_stage(sky, tmp_path, *moving), **TRACED)


@pytest.fixture
def calls(monkeypatch: pytest.MonkeyPatch) -> Counter[str]:
    """How often each part was read or made."""
    counted: Counter[str] = Counter()

    def counting(name, function):
        def call(*args, **kwargs):
            counted[name] += 1
            return function(*args, **kwargs)

        return call

    for name, (module, attribute) in READERS.items():
        monkeypatch.setattr(module, attribute, counting(name, getattr(module, attribute)))
    return counted


ONCE = {"light map": 1, "shapes": 2, "materials": 1, "light": 1, "reflections": 1, "maps": 1,
        "upload": 1, "tables": 1}  # fmt: skip


@pytest.mark.parametrize("moving", [["orbit"], ["camera"], ["rig"], ["orbit", "camera", "rig"]])
def test_turntables_of_cameras_and_domes_read_nothing_twice(moving, calls, sky, tmp_path):
    render(write_stage(sky, tmp_path, *moving), "o", FRAMES, samples=1)
    assert calls == ONCE


def test_a_traced_turntable_of_a_dome_alone_builds_its_tree_once(calls, sky, tmp_path):
    stage = write_stage(sky, tmp_path, "rig")
    hidden = 'token visibility = "invisible"'
    stage.write_text(stage.read_text().replace("float inputs:intensity = 0.5", hidden))
    render(stage, "o", FRAMES, integrator="traced", samples=1)
    assert calls == ONCE | {"tree": 1}


@pytest.mark.parametrize(
    ("moving", "again"),
    [
        ("head", {"shapes": 6, "upload": 3}),
        ("body", {"shapes": 6, "upload": 3}),
        ("sky", {"light map": 3, "light": 3, "reflections": 3, "maps": 3, "tables": 3}),
        ("paint", {"shapes": 6, "materials": 3, "light": 3, "reflections": 3, "maps": 3,
                   "upload": 3, "tables": 3}),
    ],
)  # fmt: skip
def test_what_changes_is_read_again_and_no_more(moving, again, calls, sky, tmp_path):
    render(write_stage(sky, tmp_path, moving), "o", FRAMES, samples=1)
    assert calls == ONCE | again


@pytest.fixture
def found_faces(monkeypatch: pytest.MonkeyPatch) -> list[int]:
    """The number of pixels of each band whose first triangles were found."""
    bands = []
    find = raster.rasterize_band

    def noting(*args, **kwargs):
        bands.append(args[3] * args[5])
        return find(*args, **kwargs)

    monkeypatch.setattr(raster, "rasterize_band", noting)
    return bands


@pytest.mark.parametrize(
    ("moving", "times"), [("rig", 2), ("sky", 2), ("orbit", 3), ("camera", 3), ("body", 3)]
)
def test_what_a_camera_that_stands_sees_is_found_no_third_time(
    moving, times, found_faces, sky, tmp_path, monkeypatch
):
    loaded = set()
    load = compilation.load

    def noting(module, device):
        loaded.add(module.__name__.rpartition(".")[2])
        load(module, device)

    monkeypatch.setattr(compilation, "load", noting)
    render(write_stage(sky, tmp_path, moving), "o", FRAMES, samples=1)
    assert found_faces == [16 * 16] * times
    assert "first_faces" not in loaded  # by rays, which no picture here needs


def test_a_camera_that_stands_and_goes_on_sees_what_is_there(found_faces, sky, tmp_path):
    stage = write_stage(sky, tmp_path, "rig", "camera")
    steps = "{1: 50, 2: 50, 3: 50, 4: 70, 5: 70, 6: 70, 7: 50}"
    stage.write_text(stage.read_text().replace("{1: 50, 3: 70}", steps))
    frames = tuple(float(number) for number in range(1, 8))
    together = render(stage, "together", frames, samples=4)
    assert len(found_faces) == 5  # of seven
    for number, found in zip(frames, together, strict=True):
        (alone,) = render(stage, "alone", (number,), samples=4)
        np.testing.assert_array_equal(found, alone, err_msg=f"frame {number:g}")


def test_a_frame_that_fails_leaves_nothing_to_the_next(sky, tmp_path):
    stage = write_stage(sky, tmp_path, "rig")
    broken = "float3 xformOp:scale.timeSamples = {1: (1, 1, 1), 2: (0, 1, 1), 3: (1, 1, 1)}"
    text = stage.read_text().replace(TURN, f"{broken}\n    {TURN}", 1)
    stage.write_text(text.replace('["xformOp:rotateY"]', '["xformOp:rotateY", "xformOp:scale"]'))
    output = tmp_path / "o.####.exr"
    overrides = RenderOverrides(
        frames=FRAMES, resolution=(16, 16), samples=1, png=False, dome="show"
    )
    report = render_stage(stage, output, overrides, SilentProgress())
    assert [path.name for path in report.paths] == ["o.0001.exr", "o.0003.exr"]
    assert list(report.failures) == ["2"]
    assert "flattens" in report.failures["2"]
    (alone,) = render(stage, "alone", (3.0,), samples=1)
    np.testing.assert_array_equal(read_image(report.paths[-1]).pixels, alone)


# --- Writing beside rendering --------------------------------------------------------------------


def test_a_write_error_is_that_of_its_own_frame(sky, tmp_path, monkeypatch):
    real = rendering.write_picture

    def broken(product, files, *rest):
        if "0002" in str(files["exr"]):
            raise ImageError(f"{files['exr']}: the disk is full")
        return real(product, files, *rest)

    monkeypatch.setattr(rendering, "write_picture", broken)
    stage = write_stage(sky, tmp_path, "orbit")
    overrides = RenderOverrides(frames=FRAMES, resolution=(8, 8), samples=1, png=False)
    report = render_stage(stage, tmp_path / "o.####.exr", overrides, SilentProgress())
    assert [path.name for path in report.paths] == ["o.0001.exr", "o.0003.exr"]
    assert list(report.failures) == ["2"]
    assert "the disk is full" in report.failures["2"]


def test_an_interrupt_lets_the_picture_that_is_being_written_be_finished():
    written, failures = [], []

    def write() -> None:
        time.sleep(0.05)
        written.append(1)

    with (
        pytest.raises(KeyboardInterrupt),
        FrameWriter(lambda frame, error: failures.append(frame)) as writer,
    ):
        writer.put(1.0, 0, write)
        raise KeyboardInterrupt
    assert written == [1]
    assert failures == []


def test_pictures_are_written_in_order_and_at_most_one_behind():
    log: list[str] = []

    def writing(name: str) -> Callable[[], None]:
        def write() -> None:
            time.sleep(0.02)
            log.append(name)

        return write

    with FrameWriter(lambda frame, error: log.append(f"{frame} failed")) as writer:
        for name in "abc":
            writer.put(1.0, 0, writing(name))
            log.append(f"{name} given")
        writer.put(2.0, OVERLAP_BYTES + 1, writing("large"))
        log.append("large given")
    assert [entry for entry in log if "given" not in entry] == ["a", "b", "c", "large"]
    assert log.index("a") < log.index("b given")
    assert log.index("b") < log.index("c given")
    assert log.index("large") < log.index("large given")
