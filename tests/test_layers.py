"""Opening, describing and writing layers, and the record of their origin."""

from __future__ import annotations

import hashlib
import os
import resource
import subprocess
import sys
from pathlib import Path

import pytest
from pxr import Sdf, Tf, Usd, UsdMedia

from usdskin import __version__
from usdskin.errors import LayerError
from usdskin.layers import (
    corruption_as_errors,
    describe,
    open_stage,
    quiet_diagnostics,
    record_provenance,
    sha256,
    write_layer,
)
from usdskin.notes import Note

HEADER = "#usda 1.0\n"


def layer_file(folder: Path, text: str, name: str = "shot.usda") -> Path:
    path = folder / name
    path.write_text(HEADER + text)
    return path


def message_of(path: str | Path) -> str:
    with pytest.raises(LayerError) as caught:
        open_stage(path)
    message = str(caught.value)
    assert "\n" not in message
    return message


# Opening


def test_a_sound_layer_opens(tmp_path: Path) -> None:
    stage = open_stage(layer_file(tmp_path, 'def Xform "World" {\n}\n'))
    assert stage.GetPrimAtPath("/World")


def test_a_path_may_be_given_as_text(tmp_path: Path) -> None:
    assert open_stage(str(layer_file(tmp_path, "")))


def test_a_missing_layer_is_named(tmp_path: Path) -> None:
    assert "nope.usda: no such file" in message_of(tmp_path / "nope.usda")


def test_a_folder_is_not_a_layer(tmp_path: Path) -> None:
    assert "not a file" in message_of(tmp_path)


def test_a_name_no_file_can_have_is_an_error() -> None:
    assert "no such file" in message_of("x" * 5000 + ".usda")


@pytest.mark.parametrize(
    "content", [b"", b"#usda 1.0\ndef Xform {", b"hello", b"PXR-USDC", b"\xff"]
)
@pytest.mark.parametrize("suffix", [".usda", ".usdc", ".usd", ".usdz"])
def test_a_broken_layer_is_one_line(tmp_path: Path, content: bytes, suffix: str) -> None:
    path = tmp_path / f"broken{suffix}"
    path.write_bytes(content)
    assert message_of(path).startswith(f"{path}: ")


def test_text_that_is_not_utf8_is_one_line(tmp_path: Path) -> None:
    path = tmp_path / "latin1.usda"
    path.write_bytes(b'#usda 1.0\ndef Xform "W\xe9lt" {\n  bad\xff\n}\n')
    assert message_of(path).startswith(f"{path}: ")


def test_an_unknown_kind_of_file_is_an_error(tmp_path: Path) -> None:
    path = tmp_path / "picture.png"
    path.write_bytes(b"\x89PNG")
    assert "picture.png" in message_of(path)


@pytest.mark.parametrize("rate", ["0", "-24", "nan", "inf"])
@pytest.mark.parametrize("name", ["timeCodesPerSecond", "framesPerSecond"])
def test_a_rate_that_is_not_positive_is_refused(tmp_path: Path, name: str, rate: str) -> None:
    path = layer_file(tmp_path, f"(\n  {name} = {rate}\n)\n")
    assert "PerSecond" in message_of(path)


def test_a_rate_of_zero_in_a_sublayer_is_refused_with_its_name(tmp_path: Path) -> None:
    layer_file(tmp_path, "(\n  timeCodesPerSecond = 0\n)\n", "anim.usda")
    path = layer_file(tmp_path, "(\n  subLayers = [@./anim.usda@]\n)\n")
    assert message_of(path).startswith("anim.usda: timeCodesPerSecond is 0;")


def test_a_rate_of_zero_in_a_referenced_layer_is_refused(tmp_path: Path) -> None:
    layer_file(tmp_path, '(\n  timeCodesPerSecond = 0\n)\ndef "A" {\n}\n', "asset.usda")
    path = layer_file(tmp_path, 'def "B" (\n  references = @./asset.usda@</A>\n) {\n}\n')
    assert "asset.usda" in message_of(path)


@pytest.mark.parametrize("value", ["0", "-1", "nan", "inf"])
def test_units_without_a_length_are_refused(tmp_path: Path, value: str) -> None:
    assert "metersPerUnit" in message_of(layer_file(tmp_path, f"(\n  metersPerUnit = {value}\n)\n"))


def test_an_unknown_up_axis_is_refused(tmp_path: Path) -> None:
    assert 'upAxis is "X"' in message_of(layer_file(tmp_path, '(\n  upAxis = "X"\n)\n'))


MISSING_REFERENCE = 'def "World" (\n  references = @./nope.usda@\n) {\n}\n'


def test_a_missing_reference_is_an_error_at_its_prim(tmp_path: Path) -> None:
    message = message_of(layer_file(tmp_path, MISSING_REFERENCE))
    assert "</World>" in message
    assert "nope.usda" in message


def test_a_missing_reference_is_a_note_where_notes_are_taken(tmp_path: Path) -> None:
    notes: list[Note] = []
    assert open_stage(layer_file(tmp_path, MISSING_REFERENCE), notes)
    assert [(note.code, note.path) for note in notes] == [("composition-error", "/World")]
    assert "nope.usda" in notes[0].message


def test_a_missing_sublayer_is_an_error(tmp_path: Path) -> None:
    assert "nope.usda" in message_of(layer_file(tmp_path, "(\n  subLayers = [@./nope.usda@]\n)\n"))


def test_opening_prints_nothing(tmp_path: Path, capfd: pytest.CaptureFixture[str]) -> None:
    open_stage(layer_file(tmp_path, MISSING_REFERENCE), [])
    message_of(layer_file(tmp_path, "def {", "broken.usda"))
    assert capfd.readouterr() == ("", "")


def test_quiet_diagnostics_keeps_what_usd_said(capfd: pytest.CaptureFixture[str]) -> None:
    with quiet_diagnostics() as messages:
        Tf.Warn("two\nlines")
    assert messages == ["two lines"]
    assert capfd.readouterr().err == ""


def test_opening_after_a_late_registration_is_an_error(tmp_path: Path) -> None:
    path = layer_file(tmp_path, 'def Mesh "A" {\n}\n')
    code = (
        "import sys; from pxr import Usd; Usd.Stage.Open(sys.argv[1])\n"
        "from usdskin import errors, layers\n"
        "try: layers.open_stage(sys.argv[1])\n"
        "except errors.SchemaError as error: print(error)\n"
    )
    done = subprocess.run(
        [sys.executable, "-c", code, str(path)], capture_output=True, text=True, check=False
    )
    assert "before the first stage is opened" in done.stdout
    assert done.stderr == ""


def test_a_value_that_turns_out_corrupt_is_one_line(tmp_path: Path) -> None:
    with pytest.raises(LayerError, match=r"shot\.usda: cannot be read as a USD layer: .*broken; "):
        with corruption_as_errors(tmp_path / "shot.usda"):
            Tf.RaiseCodingError("broken")


# Where an opinion comes from


def test_a_prim_is_described_by_its_strongest_layer_and_path(tmp_path: Path) -> None:
    layer_file(tmp_path, 'def Xform "World" {\n  double size = 1\n}\n', "asset.usda")
    path = layer_file(
        tmp_path, '(\n  subLayers = [@./asset.usda@]\n)\nover "World" {\n  double other = 1\n}\n'
    )
    stage = open_stage(path)
    prim = stage.GetPrimAtPath("/World")
    assert describe(prim) == "shot.usda </World>"
    assert describe(prim.GetAttribute("size")) == "asset.usda </World>"
    assert describe(prim.GetAttribute("other")) == "shot.usda </World>"


def test_what_flags_set_is_described_by_the_flag(tmp_path: Path) -> None:
    (tmp_path / "own.usda").write_text(HEADER + 'def Sphere "A" {}\ndef Sphere "B" {}\n')
    stage = open_stage(tmp_path / "own.usda")
    with Usd.EditContext(stage, stage.GetSessionLayer()):
        stage.GetAttributeAtPath("/A.radius").Set(2.0)
        stage.GetPrimAtPath("/B").GetVariantSets().AddVariantSet("lamp")
    prim = stage.GetPrimAtPath("/A")
    assert describe(prim.GetAttribute("radius")) == "--set </A>"
    assert describe(prim) == "own.usda with --set </A>"
    assert describe(stage.GetPrimAtPath("/B")) == "own.usda </B>"


def test_a_property_without_opinions_is_described_by_its_prim() -> None:
    stage = Usd.Stage.CreateInMemory("light.usda")
    prim = stage.DefinePrim("/L", "DomeLight")
    assert describe(prim.GetAttribute("inputs:intensity")) == "light.usda </L>"


# Writing


def test_a_layer_is_written_whole_and_leaves_nothing_else(tmp_path: Path) -> None:
    stage = Usd.Stage.CreateInMemory()
    stage.DefinePrim("/World", "Xform")
    path = write_layer(stage, tmp_path / "out.usda")
    assert list(tmp_path.iterdir()) == [path]
    assert Sdf.Layer.FindOrOpen(str(path)).GetPrimAtPath("/World")


@pytest.mark.parametrize("suffix", [".usda", ".usdc", ".usd"])
def test_layers_are_written_in_the_format_of_their_name(tmp_path: Path, suffix: str) -> None:
    path = write_layer(Sdf.Layer.CreateAnonymous(".usda"), tmp_path / f"out{suffix}")
    assert path.read_bytes()[:8] == (b"#usda 1." if suffix == ".usda" else b"PXR-USDC")


@pytest.mark.parametrize("name", ["out.txt", "out", "out.usdz"])
def test_names_that_are_no_layers_are_refused(tmp_path: Path, name: str) -> None:
    with pytest.raises(LayerError, match=r"end its name in \.usda"):
        write_layer(Usd.Stage.CreateInMemory(), tmp_path / name)


def test_a_file_that_should_be_a_folder_is_an_error(tmp_path: Path) -> None:
    (tmp_path / "no").touch()
    with pytest.raises(LayerError, match="cannot be written"):
        write_layer(Usd.Stage.CreateInMemory(), tmp_path / "no" / "out.usda")


def test_a_folder_in_the_way_leaves_no_temporary_file(tmp_path: Path) -> None:
    (tmp_path / "out.usda").mkdir()
    with pytest.raises(LayerError, match="cannot be written"):
        write_layer(Usd.Stage.CreateInMemory(), tmp_path / "out.usda")
    assert [path.name for path in tmp_path.iterdir()] == ["out.usda"]


def test_a_failed_export_keeps_the_old_file(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    path = layer_file(tmp_path, "", "out.usda")
    before = path.read_bytes()

    def fail(*_: object) -> None:
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(os, "fsync", fail)
    with pytest.raises(LayerError, match="No space left on device"):
        write_layer(Usd.Stage.CreateInMemory(), path)
    assert path.read_bytes() == before
    assert list(tmp_path.iterdir()) == [path]


def test_an_open_copy_sees_what_was_written(tmp_path: Path) -> None:
    path = layer_file(tmp_path, "")
    stage = open_stage(path)
    other = Usd.Stage.CreateInMemory()
    other.DefinePrim("/New", "Xform")
    write_layer(other, path)
    assert stage.GetPrimAtPath("/New")


def test_written_files_have_the_permissions_of_ordinary_ones(tmp_path: Path) -> None:
    plain = layer_file(tmp_path, "", "plain.usda")
    path = write_layer(Usd.Stage.CreateInMemory(), tmp_path / "out.usda")
    assert path.stat().st_mode == plain.stat().st_mode


# Provenance


def test_provenance_names_inputs_by_relative_path_and_content(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("SOURCE_DATE_EPOCH", "0")
    (tmp_path / "in").mkdir()
    source = layer_file(tmp_path / "in", "", "capture.usda")
    stage = Usd.Stage.CreateInMemory()
    stage.SetDefaultPrim(stage.DefinePrim("/Light", "DomeLight"))
    settings = {"estimator": "regression", "ridge": 0.5, "grid": [400.0, 700.0], "names": ["a"]}

    record_provenance(stage, "estimateLight", [source], settings, tmp_path / "out")

    record = stage.GetRootLayer().customLayerData["usdskin"]["estimateLight"]
    assert list(record["inputs"]) == ["../in/capture.usda"]
    assert list(record["inputsSha256"]) == [hashlib.sha256(source.read_bytes()).hexdigest()]
    assert record["created"] == "1970-01-01T00:00:00Z"
    assert record["version"] == __version__
    assert record["settings"]["estimator"] == "regression"
    assert list(record["settings"]["grid"]) == [400.0, 700.0]
    assert str(tmp_path) not in stage.GetRootLayer().ExportToString()
    if not hasattr(UsdMedia, "AuthorshipAPI"):
        return
    authorship = UsdMedia.AuthorshipAPI(stage.GetDefaultPrim(), "estimateLight")
    assert authorship.GetSoftwarePackageAttr().Get() == "usdskin"
    assert authorship.GetCreatedAttr().Get() == "1970-01-01T00:00:00Z"
    assert len(authorship.GetInputsAttr().Get()) % 2 == 0


def test_provenance_of_an_input_elsewhere_holds_no_absolute_path(tmp_path: Path) -> None:
    source = layer_file(tmp_path, "")
    stage = Usd.Stage.CreateInMemory()
    stage.SetDefaultPrim(stage.DefinePrim("/Light", "DomeLight"))
    record_provenance(stage, "step", [source], {}, "/usr")
    record_provenance(stage, "other", [source], {})
    data = stage.GetRootLayer().customLayerData["usdskin"]
    assert list(data["step"]["inputs"]) == ["./shot.usda"]
    assert list(data["other"]["inputs"]) == ["./shot.usda"]


def test_provenance_counts_from_the_folder_of_the_layer(tmp_path: Path) -> None:
    source = layer_file(tmp_path, "", "capture.usda")
    stage = open_stage(layer_file(tmp_path, '(\n defaultPrim = "A"\n)\ndef "A" {\n}\n'))
    record_provenance(stage, "step", [source], {})
    record = stage.GetRootLayer().customLayerData["usdskin"]["step"]
    assert list(record["inputs"]) == ["./capture.usda"]


def test_provenance_needs_a_default_prim() -> None:
    with pytest.raises(LayerError, match="default prim"):
        record_provenance(Usd.Stage.CreateInMemory(), "step", [], {})


def test_provenance_of_a_missing_input_is_an_error(tmp_path: Path) -> None:
    stage = Usd.Stage.CreateInMemory()
    stage.SetDefaultPrim(stage.DefinePrim("/Light", "DomeLight"))
    with pytest.raises(LayerError, match=r"nope\.exr: cannot be read"):
        record_provenance(stage, "step", [tmp_path / "nope.exr"], {})


def test_sha256_is_that_of_the_standard(tmp_path: Path) -> None:
    """The digest of "abc" in FIPS 180-4, example B.1."""
    (tmp_path / "abc").write_bytes(b"abc")
    expected = "ba7816bf8f01cfea414140de5dae2223b00361a396177a9cb410ff61f20015ad"
    assert sha256(tmp_path / "abc") == expected


# Malformed files

OPEN_ALL = """
import sys
from usdskin.errors import LayerError
from usdskin.layers import open_stage
for path in sys.argv[1:]:
    print("begin", path, flush=True)
    try:
        open_stage(path)
        print("opened", flush=True)
    except LayerError as error:
        assert "\\n" not in str(error) and len(str(error)) > 20, repr(str(error))
        print("refused", flush=True)
"""

MEMORY_LIMIT = 4 << 30


def limit_memory() -> None:
    resource.setrlimit(resource.RLIMIT_AS, (MEMORY_LIMIT, MEMORY_LIMIT))


@pytest.mark.realdata
@pytest.mark.parametrize("folder", ["synthetic", "openusd_usdchecker_bad", "openusd_sdf_parsing"])
def test_malformed_layers_open_or_give_one_line(
    realdata: Path, tmp_path: Path, folder: str
) -> None:
    """One child per set, with limits: a crash or hang shows which file it happened on."""
    suffixes = (".usd", ".usda", ".usdc", ".usdz", ".sdf")
    files = sorted(p for p in (realdata / "malformed" / folder).iterdir() if p.suffix in suffixes)
    assert files
    if folder == "openusd_sdf_parsing":
        for file in files:
            (tmp_path / f"{file.stem}.usda").write_bytes(file.read_bytes())
        files = sorted(tmp_path.iterdir())
    done = subprocess.run(
        [sys.executable, "-c", OPEN_ALL, *map(str, files)],
        capture_output=True,
        text=True,
        check=False,
        timeout=60,
        preexec_fn=limit_memory,
    )
    last = done.stdout.splitlines()[-2:]
    assert done.returncode == 0, f"{last}: {done.stderr}"
    # USD itself prints this one, past its diagnostics.
    errors = [line for line in done.stderr.splitlines() if "posix_madvise" not in line]
    assert not errors
    assert done.stdout.count("opened") + done.stdout.count("refused") == len(files)
