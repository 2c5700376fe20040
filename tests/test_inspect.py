"""``usdskin info``: what it finds in stages and pictures, and how it prints that."""

from __future__ import annotations

import io
import json
from pathlib import Path

import numpy as np
import pytest

from usdskin import cli
from usdskin.errors import ImageError, LayerError
from usdskin.images import Part, write_exr, write_spectral_exr
from usdskin.inspect import ROW_LIMIT, inspect_file, print_report

STAGE = """#usda 1.0
(
    defaultPrim = "World"
    metersPerUnit = 0.01
    upAxis = "Z"
    startTimeCode = 1
    endTimeCode = 24
)
def Xform "World" (
    variants = {
        string lamp = "a"
    }
    prepend variantSets = "lamp"
)
{
    def Camera "Cam"
    {
    }
    def DomeLight "Basis" (prepend apiSchemas = ["SpectralLightAPI"])
    {
        token inputs:spectral:source = "blackbody"
        float inputs:colorTemperature = 2856
    }
    def DistantLight "Plain"
    {
        float inputs:exposure = 2
    }
    def SphereLight "Lamp"
    {
    }
    def Mesh "Head" (prepend apiSchemas = ["MaterialBindingAPI"])
    {
        int[] faceVertexCounts = [4]
        int[] faceVertexIndices = [0, 1, 2, 3]
        point3f[] points = [(0, 0, 0), (1, 0, 0), (1, 1, 0), (0, 1, 0)]
        texCoord2f[] primvars:st = [(0, 0), (1, 0), (1, 1), (0, 1)] (interpolation = "vertex")
        rel material:binding = </World/Skin>
    }
    def Material "Skin" (prepend apiSchemas = ["SkinMaterialAPI"])
    {
        float inputs:skin:wrap = 0.4
    }
    variantSet "lamp" = {
        "a" {
        }
        "b" {
        }
    }
}
"""


@pytest.fixture
def stage(tmp_path: Path) -> Path:
    path = tmp_path / "shot.usda"
    path.write_text(STAGE)
    return path


def test_stage_tells_units_time_and_what_is_in_it(stage):
    report = inspect_file(stage)
    assert report["kind"] == "stage"
    summary = report["summary"]
    assert (summary["upAxis"], summary["metersPerUnit"]) == ("Z", 0.01)
    assert (summary["startTimeCode"], summary["endTimeCode"]) == (1, 24)
    assert summary["defaultPrim"] == "/World"
    assert summary["layers"] == ["shot.usda"]
    assert [row["path"] for row in report["cameras"]] == ["/World/Cam"]
    assert report["variants"][0]["sets"] == {"lamp": {"selected": "a", "variants": ["a", "b"]}}


def test_lights_tell_their_spectral_source(stage):
    lights = {row["path"]: row for row in inspect_file(stage)["lights"]}
    assert lights["/World/Basis"]["source"] == "blackbody"
    assert lights["/World/Basis"]["spectrum"] == "2856 K"
    assert (lights["/World/Plain"]["source"], lights["/World/Plain"]["exposure"]) == ("rgb", 2)


def test_meshes_tell_counts_and_materials_tell_skin(stage):
    report = inspect_file(stage)
    (mesh,) = report["meshes"]
    assert (mesh["points"], mesh["faces"], mesh["primvars"]) == (4, 1, ["st"])
    assert mesh["material"] == "/World/Skin"
    (material,) = report["materials"]
    assert material["skin"]
    (skin,) = report["skins"]
    assert (skin["path"], skin["alpha"], skin["l"]) == ("/World/Skin", 1.0, 0.4)


def test_numbers_of_a_skin_are_numbers(tmp_path, capsys):
    path = tmp_path / "skin.usda"
    path.write_text(
        '#usda 1.0\n(\n    metersPerUnit = 1\n)\ndef Material "Skin" (prepend apiSchemas = '
        '["SkinMaterialAPI", "SpectralDistributionAPI:reflectance"])\n{\n'
        "    double[] spectrum:reflectance:wavelengths = [450, 550, 650]\n"
        "    double[] spectrum:reflectance:values = [0.27, 0.31, 0.6]\n}\n"
    )
    assert cli.main(["--json", "info", str(path)]) == 0
    events = [json.loads(line) for line in capsys.readouterr().out.splitlines()]
    (skin,) = next(event["skins"] for event in events if "skins" in event)
    assert skin["S at 450, 550, 650 nm"] == [0.27, 0.31, 0.6]
    assert len(skin["L*a*b* (D65, SCI)"]) == 3


def test_layers_come_strongest_first_then_by_path_and_tell_equal_names_apart(tmp_path):
    texts = {
        "shot.usda": "#usda 1.0\n(\n    subLayers = [@z.usda@, @a.usda@]\n)\n"
        'def "M" (references = @m/look.usda@</A>)\n{\n}\n'
        'def "B" (references = @b/look.usda@</A>)\n{\n}\n'
        'def "C" (references = @c/single.usda@</A>)\n{\n}\n',
        **dict.fromkeys(["z.usda", "a.usda"], "#usda 1.0\n"),
        **dict.fromkeys(["m/look.usda", "b/look.usda", "c/single.usda"], '#usda 1.0\ndef "A" {}\n'),
    }
    for name, text in texts.items():
        (tmp_path / name).parent.mkdir(exist_ok=True)
        (tmp_path / name).write_text(text)
    layers = inspect_file(tmp_path / "shot.usda")["summary"]["layers"]
    expected = ["shot.usda", "z.usda", "a.usda", "b/look.usda", "single.usda", "m/look.usda"]
    assert layers == expected


def test_what_a_render_would_not_show_is_named(stage):
    report = inspect_file(stage)
    assert ("light-needs-traced", "/World/Lamp") in {
        (note["code"], note["path"]) for note in report["notes"]
    }
    assert report["problems"] == []


def test_what_would_stop_a_render_is_named_once_and_the_rest_still_shown(stage):
    text = STAGE.replace("inputs:skin:wrap = 0.4", "inputs:skin:wrap = 7")
    stage.write_text(text.replace('def Camera "Cam"', 'def Xform "Cam"'))
    report = inspect_file(stage)
    assert len(report["meshes"]) == 1
    assert sum("no camera" in problem for problem in report["problems"]) == 1
    assert sum("inputs:skin:wrap" in problem for problem in report["problems"]) == 1


def test_missing_and_corrupt_layers_are_errors(tmp_path):
    with pytest.raises(LayerError):
        inspect_file(tmp_path / "none.usda")
    (tmp_path / "bad.usda").write_text("#usda 1.0\n{{{")
    with pytest.raises(LayerError):
        inspect_file(tmp_path / "bad.usda")


def test_picture_tells_parts_channels_and_header(tmp_path):
    path = tmp_path / "a.exr"
    beauty = Part("beauty", {"": np.zeros((4, 6, 4), np.float32)}, {"usdskin/frame": 7.0})
    depth = Part("Z", {"Z": np.zeros((4, 6), np.float32)})
    write_exr(path, [beauty, depth])
    report = inspect_file(path)
    assert [row["part"] for row in report["parts"]] == ["beauty", "Z"]
    assert report["parts"][0]["size"] == "6 x 4"
    assert report["parts"][1]["channels"] == ["Z"]
    frame = {row["name"]: row["value"] for row in report["headers"] if row["part"] == "beauty"}
    assert frame["usdskin/frame"] == 7


def test_spectral_picture_tells_its_bands(tmp_path):
    path = tmp_path / "a.spectral.exr"
    zeros = np.zeros((2, 2, 61), np.float32)
    write_spectral_exr(path, np.arange(400.0, 701.0, 5.0), zeros, zeros[..., :3])
    (row,) = inspect_file(path)["parts"]
    assert (row["bands"], row["wavelengths"]) == (61, "400-700 nm")
    assert row["channels"] == ["R", "G", "B"]


def test_file_that_is_no_picture_is_an_image_error(tmp_path):
    (tmp_path / "a.exr").write_text("no")
    with pytest.raises(ImageError):
        inspect_file(tmp_path / "a.exr")


def test_json_is_one_event_with_everything(stage, capsys):
    assert cli.main(["info", str(stage), "--json"]) == 0
    (line,) = capsys.readouterr().out.splitlines()
    event = json.loads(line)
    assert event["event"] == "info"
    assert event["meshes"][0]["points"] == 4


def test_plain_report_aligns_columns_and_says_what_it_leaves_out():
    rows = [{"path": f"/A{index}", "value": index / 4} for index in range(ROW_LIMIT + 5)]
    stream = io.StringIO()
    print_report({"file": "a", "kind": "stage", "summary": {"on": True}, "rows": rows}, stream)
    lines = stream.getvalue().splitlines()
    assert lines[:2] == ["a", "  on: yes"]
    assert "  path  value" in lines
    assert "  /A0   0" in lines
    assert lines[-1] == "  ... and 5 more; --json lists all"


def test_terminal_report_shows_brackets_as_they_are():
    class Terminal(io.StringIO):
        def isatty(self) -> bool:
            return True

    stream = Terminal()
    print_report({"file": "a", "kind": "x", "summary": {}, "rows": [{"name": "[red]x"}]}, stream)
    assert "[red]x" in stream.getvalue()


def test_a_skin_tells_which_maps_it_has(tmp_path):
    for name in ("n.png", "h.png"):
        (tmp_path / name).write_bytes(b"not looked into")
    path = tmp_path / "skin.usda"
    path.write_text(
        """#usda 1.0
def Material "Skin" (prepend apiSchemas = ["SkinMaterialAPI"])
{
    asset inputs:skin:normal:file = @./n.png@
    asset inputs:skin:bump:file = @./h.png@
}
"""
    )
    assert "normal, bump" in json.dumps(inspect_file(path), default=str)
