"""Sequences: what does not change between frames is read, baked and uploaded once."""

from __future__ import annotations

from collections import Counter
from pathlib import Path

import numpy as np
import pytest
from light_stages import write_rgb

from usdskin.images import read_image
from usdskin.progress import SilentProgress
from usdskin.render import domes, light_maps, scene, traced
from usdskin.render.overrides import RenderOverrides
from usdskin.render.render import render_stage

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
    "light": (scene, "build_light_field"),
    "reflections": (scene, "add_reflections"),
    "maps": (light_maps, "bake_maps"),
    "upload": (scene, "_upload_geometry"),
    "tables": (scene, "build_surfaces"),
    "tree": (traced, "build_light_tree"),
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
    overrides = RenderOverrides(frames=frames, resolution=(24, 24), dome="show", png=False, **flags)  # type: ignore[arg-type]
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


@pytest.mark.parametrize("flags", [{"samples": 4}, TRACED], ids=["map", "traced"])
@pytest.mark.parametrize("moving", [*([name] for name in MOVES), [*MOVES]], ids="-".join)
def test_frames_of_a_sequence_are_those_rendered_alone(moving, flags, sky, tmp_path):
    if moving == ["panel"] and flags is not TRACED:
        pytest.skip("a light with a place")
    assert_frames_stand_alone(write_stage(sky, tmp_path, *moving), **flags)


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


def test_a_frame_that_fails_leaves_nothing_to_the_next(sky, tmp_path):
    stage = write_stage(sky, tmp_path, "rig")
    broken = "float3 xformOp:scale.timeSamples = {1: (1, 1, 1), 2: (0, 1, 1), 3: (1, 1, 1)}"
    text = stage.read_text().replace(TURN, f"{broken}\n    {TURN}", 1)
    stage.write_text(text.replace('["xformOp:rotateY"]', '["xformOp:rotateY", "xformOp:scale"]'))
    output = tmp_path / "o.####.exr"
    overrides = RenderOverrides(
        frames=FRAMES, resolution=(24, 24), samples=1, png=False, dome="show"
    )
    report = render_stage(stage, output, overrides, SilentProgress())
    assert [path.name for path in report.paths] == ["o.0001.exr", "o.0003.exr"]
    assert list(report.failures) == ["2"]
    assert "flattens" in report.failures["2"]
    (alone,) = render(stage, "alone", (3.0,), samples=1)
    np.testing.assert_array_equal(read_image(report.paths[-1]).pixels, alone)
