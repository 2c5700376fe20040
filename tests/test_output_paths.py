"""Where a command is to write: refused before the work in one line, made where it is missing."""

from __future__ import annotations

import shutil
from pathlib import Path

import numpy as np
import pytest
from chart_layers import seen_chart, write_chart
from proof_folders import write_proof

from usdskin import cli
from usdskin.errors import ImageError, LayerError, UsageError, UsdSkinError
from usdskin.images import Part, write_exr
from usdskin.layers import check_output, write_layer
from usdskin.replacing import check_writable, scratch_beside

# isort: split
from pxr import Usd

STAGES = Path(__file__).resolve().parents[1] / "stages"
SPHERE = STAGES / "sphere" / "sphere.usda"
SET = STAGES / "room_fluorescent" / "set.usda"

# What is written, by the words before it, and the function that begins the long work. Where there
# is none the name is looked at before the input, which need not be there.
FILES = {
    "import none.obj -o": ("a.usda", ""),
    f"solve {SET} -o": ("light.usda", "usdskin.judge.truth.solve.make_model"),
    f"goniometer {STAGES}/skin_library/skin_library.usda -o": (
        "samples.usda",
        "usdskin.judge.skin.goniometer.measure",
    ),
    "ingest none -o": ("shoot.usda", ""),
    "calibrate lens none.png --board charuco:7x5 -o": ("lens.usda", ""),
    "calibrate lens none.png --board charuco:7x5 -o lens.usda --plot": ("lens.png", ""),
    "calibrate camera chart.usda -o": ("camera.usda", "usdskin.estimate.camera.step._used"),
    "calibrate camera chart.usda -o camera.usda --plot": (
        "camera.svg",
        "usdskin.estimate.camera.step._used",
    ),
    "estimate light none.exr --illuminant D65 -o": ("light.usda", ""),
    "estimate light none.exr --illuminant D65 -o light.usda --plot": ("light.svg", ""),
    "estimate skin none.png -o": ("skin.usda", ""),
    f"bake {SPHERE} -o": ("transfer.usda", "usdskin.render.transfer_bake.read_scene"),
    f"render {SPHERE}": ("a.exr", "usdskin.render.render.open_workers"),
    "map none.usda -o": ("map.exr", ""),
    "compare a.exr b.exr -o": ("maps.exr", "usdskin.judge.comparison.compare.compare_pictures"),
    "plot none.usda -o": ("a.svg", ""),
    "report proof -o": ("report.html", "usdskin.judge.report.step._sections"),
}
FOLDERS = (
    "new",
    "photograph none.usda -o",
    f"photograph-skin {SPHERE} -o",
    f"prove {STAGES}/room_fluorescent --subject bust -o",
)


@pytest.fixture
def refusal(tmp_path, monkeypatch, capsys):
    """Return what runs a command that must fail, and gives its exit code and its one line."""
    monkeypatch.chdir(tmp_path)
    Path("file").write_text("")

    def refused(words: str, output: str, work: str = "") -> tuple[int, str]:
        if work:
            monkeypatch.setattr(work, lambda *_, **__: pytest.fail(f"{work} was called"))
        if "chart.usda" in words:
            write_chart(Path("chart.usda"), seen_chart())
        if words.startswith("report"):
            write_proof(Path("proof"))
        before = sorted(tmp_path.rglob("*"))
        code = cli.main([*words.split(), output])
        told = capsys.readouterr()
        assert sorted(tmp_path.rglob("*")) == before
        assert told.out == ""
        (line,) = told.err.splitlines()
        return code, line

    return refused


@pytest.mark.parametrize(("words", "name", "work"), [(key, *FILES[key]) for key in FILES])
def test_a_file_that_cannot_be_written_is_refused_before_the_work(refusal, words, name, work):
    for folder, reason in (("file", "Not a directory"), ("/proc/no", "No such file or directory")):
        code, line = refusal(words, f"{folder}/{name}", work)
        assert code == 3
        assert f"{folder}/{Path(name).stem}" in line
        assert f"cannot be written ({reason}); choose another folder" in line
    code, line = refusal(words, f"{Path(name).stem}.txt", work)
    assert code == 2
    assert f"{Path(name).stem}.txt: " in line


@pytest.mark.parametrize("words", [words for words in FILES if not words.startswith("compare")])
def test_a_folder_is_no_file_to_write(refusal, words):
    name, work = FILES[words]
    Path(name).mkdir()
    code, line = refusal(words, name, work)
    assert (code, line) == (2, f"usdskin: error: {name}: is a folder; name a file")


@pytest.mark.parametrize("words", FOLDERS)
def test_a_folder_that_cannot_be_made_is_refused_before_the_work(refusal, words):
    for output, code, reason in (
        ("file", 2, "is "),
        ("file/out", 3, "cannot be written (Not a directory); choose another folder"),
        ("/proc/out", 3, "cannot be written (No such file or directory); choose another folder"),
    ):
        found, line = refusal(words, output)
        assert found == code
        assert f"{output}: {reason}" in line


def test_maps_go_into_a_folder_or_a_file(refusal):
    """The one output that may be either: the files in the folder are looked at."""
    Path("maps/b.difference.exr").mkdir(parents=True)
    code, line = refusal("compare a.exr b.exr -o", "maps")
    assert (code, "maps/b.difference.exr: is a folder" in line) == (2, True)
    assert refusal("compare a.exr b.exr -o", "b.exr")[0] == 2


def test_missing_folders_are_made_when_the_file_is_written(tmp_path):
    layer, picture, beside = (tmp_path / name for name in ("a/b/l.usda", "c/d/p.exr", "e/f/s.usda"))
    for path in (layer, picture, beside):
        check_writable(path)
    assert not list(tmp_path.iterdir())
    write_layer(Usd.Stage.CreateInMemory(), layer)
    write_exr(picture, [Part("Z", {"Z": np.zeros((2, 2), np.float32)})])
    with scratch_beside(beside) as scratch:
        assert scratch.parent == beside.parent
    assert layer.is_file() and picture.is_file()


def test_a_file_beside_the_layer_is_looked_at_too(tmp_path):
    output, beside = tmp_path / "a.usda", tmp_path / "a.npz"
    check_output(output, [], [beside], step="bake")
    with pytest.raises(UsageError, match=r"a\.npz: is an input of this bake"):
        check_output(output, [beside], [beside], step="bake")
    beside.mkdir()
    with pytest.raises(UsageError, match=r"a\.npz: is a folder"):
        check_output(output, [], [beside], step="bake")


def test_the_current_folder_may_be_named(refusal):
    code, line = refusal("new", ".")
    assert (code, ".: is not empty" in line) == (2, True)
    Path("file").unlink()
    assert cli.main(["new", "."]) == 3  # it cannot take the place of the folder one is in


def test_a_link_to_nowhere_is_no_folder(tmp_path):
    (tmp_path / "link").symlink_to("nowhere")
    with pytest.raises(UsdSkinError, match=r"cannot be written \(.*\); choose another folder"):
        check_writable(tmp_path / "link" / "a.usda")


@pytest.mark.parametrize("folder", ["/proc", "/sys/kernel"])
def test_a_late_failure_names_the_file_and_not_its_temporary_name(folder):
    path = Path(folder) / "a.usda"
    with pytest.raises(LayerError, match="cannot be written") as caught:
        write_layer(Usd.Stage.CreateInMemory(), path)
    assert str(caught.value).startswith(f"{path}: ")
    assert ".a." not in str(caught.value) and ".tmp" not in str(caught.value)
    with pytest.raises(ImageError, match="cannot write") as caught:
        write_exr(path.with_suffix(".exr"), [Part("Z", {"Z": np.zeros((2, 2), np.float32)})])
    assert ".a." not in str(caught.value)


@pytest.mark.parametrize("command", ["render", "map"])
def test_a_picture_that_the_stage_is_made_of_is_not_written_over(tmp_path, capfd, command):
    folder = tmp_path / "sphere"
    shutil.copytree(SPHERE.parent, folder)
    picture = folder / "sky.exr"
    write_exr(picture, [Part("", {name: np.ones((8, 16), np.float32) for name in "RGB"})])
    before = picture.read_bytes()
    stage = folder / "lit.usda"
    stage.write_text(
        '#usda 1.0\n(\n    defaultPrim = "World"\n    subLayers = [@./sphere.usda@]\n)\n'
        'over "World"\n{\n    def DomeLight "Sky"\n    {\n'
        "        asset inputs:texture:file = @./sky.exr@\n    }\n}\n"
    )
    words = ["-o"] if command == "map" else []
    assert cli.main(["-q", command, str(stage), *words, str(picture)]) == 2
    assert "sky.exr: is an input of this picture, named in lit.usda" in capfd.readouterr().err
    assert picture.read_bytes() == before
