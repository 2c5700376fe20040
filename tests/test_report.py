"""``usdskin report``: what is in the page, what is refused, and that nothing can leave it."""

from __future__ import annotations

import base64
import csv
import hashlib
import json
import re
import shutil
import zlib
from html.parser import HTMLParser
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import proof_folders
import pytest

from usdskin.cli import main
from usdskin.images import Part, read_image, write_exr
from usdskin.judge.report.charts import nice_ticks, spread_bar
from usdskin.judge.report.markup import Markup, element, json_block
from usdskin.judge.report.pixels import lab_of_beauty, pack, quantized_delta
from usdskin.judge.report.shown import number

HOSTILE = '</script><img src=x onerror="alert(1)">{{style}}\'&<b>'
"""A name that would be markup, a script's end and a slot of the template, were it believed."""


class Page(HTMLParser):
    """Elements of a page, in order, with what matters to its safety."""

    def __init__(self, text: str) -> None:
        super().__init__()
        self.elements: list[tuple[str, dict[str, str | None]]] = []
        self.inside: list[str] = []
        self.texts: dict[str, list[str]] = {"style": [], "script": [], "td": [], "th": []}
        self.all_text = ""
        self.feed(text)

    def handle_starttag(self, tag, attrs):
        self.elements.append((tag, dict(attrs)))
        self.inside.append(tag)
        if tag in self.texts:
            self.texts[tag].append("")

    def handle_endtag(self, tag):
        if tag in self.inside:
            while self.inside.pop() != tag:
                pass

    def handle_data(self, data):
        for tag in set(self.inside) & set(self.texts):
            self.texts[tag][-1] += data
        if not set(self.inside) & {"style", "script"}:
            self.all_text += data

    def attributes(self, name: str) -> list[str | None]:
        return [found[name] for _, found in self.elements if name in found]


@pytest.fixture(scope="module")
def proof(tmp_path_factory) -> Path:
    folder = tmp_path_factory.mktemp("proof")
    proof_folders.write_proof(folder)
    return folder


@pytest.fixture(scope="module")
def text(proof) -> str:
    assert main(["report", str(proof)]) == 0
    return (proof / "report.html").read_text("utf-8")


@pytest.fixture
def copy(proof, tmp_path) -> Path:
    """Return a copy of the proof without light, whose maps take the longest."""
    folder = tmp_path / "copy"
    shutil.copytree(proof, folder, ignore=shutil.ignore_patterns("report.*"))
    content = json.loads((folder / "proof.json").read_text())
    content["layers"] = {"capture": "capture.usda"}
    proof_folders.save(folder, content)
    return folder


def content_of(folder: Path) -> dict:
    return json.loads((folder / "proof.json").read_text())


def refusal(capsys, folder: Path, *more: str) -> str:
    """Return the one line that a report is refused with."""
    assert main(["report", str(folder), *more]) in (2, 3)
    lines = capsys.readouterr().err.strip().splitlines()
    assert len(lines) == 1
    return lines[0]


# --- Numbers -----------------------------------------------------------------------------------


def test_every_difference_of_the_proof_is_in_the_page_to_two_digits(proof, text):
    cells = [cell.strip() for cell in Page(text).texts["td"]]
    for comparison in content_of(proof)["comparisons"]:
        for value in comparison["result"]["deltaE2000"].values():
            assert f"{value:.2f}" in cells


def test_report_json_holds_the_numbers_of_the_proof_unrounded(proof, text):
    written = json.loads((proof / "report.json").read_text())
    content = content_of(proof)
    for mine, theirs in zip(written["comparisons"], content["comparisons"], strict=True):
        for name in ("deltaE2000", "deltaE76", "flip", "deltaL", "spectral", "white", "yN"):
            assert mine[name] == theirs["result"][name]
    assert written["bars"] == content["bars"]
    assert written["skin"] == content["skin"]
    assert [row["cause"] for row in written["budget"]] == ["clipping", "rotation", "wrap"]
    capture = {row["name"]: row["value"] for row in written["capture"]}
    assert capture["Coverage"] == 0.9876
    assert capture["Rotation residual"] == 0.034


def test_report_csv_holds_the_same_numbers_as_report_json(proof, text):
    rows = list(csv.DictReader((proof / "report.csv").read_text().splitlines()))
    found = {(row["section"], row["item"], row["quantity"]): row["value"] for row in rows}
    for item in json.loads((proof / "report.json").read_text())["comparisons"]:
        key = f"{item['name']} {item['integrator']}"
        for statistic, value in item["deltaE2000"].items():
            assert float(found["comparisons", key, f"deltaE2000 {statistic}"]) == value
    assert float(found["skin", "wrap", "stddev"]) == 0.0061
    assert float(found["budget", "clipping lamps at a half", "deltaE2000 p95"]) == 9.8


def test_missed_bars_make_the_headline(text):
    assert "1 of 2 bars met, 1 missed" in text


def test_numbers_have_fixed_digits_and_no_minus_before_zero():
    assert number(0.0042, 3) == "0.004"
    assert number(-0.5) == "−0.50"
    assert number(-0.0001) == "0.00"
    assert number(None) == "–"
    assert number(-1.234e7) == "−1.23 × 10⁷"


def test_ticks_are_round_and_inside():
    assert nice_ticks(0.0, 1.04) == [0.0, 0.5, 1.0]
    assert nice_ticks(400.0, 700.0, 3) == [400.0, 500.0, 600.0, 700.0]


def test_bars_that_would_dwarf_the_others_are_cut_and_seen_to_be():
    assert 'class="cut"' in spread_bar(20.0, 30.0, 2.0)
    assert 'class="cut"' not in spread_bar(1.0, 30.0, 2.0)
    assert 'width="50"' in spread_bar(1.0, 2.0, 2.0)


# --- Pixels ------------------------------------------------------------------------------------


def unpacked(packed: str, shape: tuple[int, int, int]) -> np.ndarray:
    data = np.frombuffer(zlib.decompress(base64.b64decode(packed)), np.uint8).astype(np.int64)
    low, high = np.split(data, 2)
    return np.cumsum((low | high << 8).reshape(shape), axis=2) & 0xFFFF


def test_planes_come_back_as_they_were():
    planes = np.random.default_rng(0).integers(0, 65536, (2, 5, 7))
    np.testing.assert_array_equal(unpacked(pack(planes), planes.shape), planes)


def test_differences_beyond_the_range_and_outside_the_mask_are_told_apart():
    steps = quantized_delta(np.array([0.004, 0.006, 700.0, np.nan]))
    assert steps.tolist() == [0, 1, 65534, 65535]


def test_embedded_differences_are_those_of_the_maps_to_the_shown_digits(proof, text):
    embedded = json.loads(re.search(r'id="pixels">(.*?)</script>', text, re.S).group(1))
    view = embedded["views"]["map"]
    x, y, width, height = view["box"]
    image = read_image(proof / "differences/chain_map.exr")
    delta = image.pixels[..., image.channel_names.index("dE2000")][y : y + height, x : x + width]
    stored = unpacked(view["pictures"]["chain"]["delta"], (1, height, width))[0]
    inside = np.isfinite(delta)
    assert (stored[~inside] == embedded["nothing"]).all()
    error = np.abs(stored[inside] * embedded["deltaStep"] - delta[inside])
    assert error.max() <= 0.005 + 1e-6


def test_embedded_spectra_are_within_what_is_said_of_them(proof, text):
    embedded = json.loads(re.search(r'id="pixels">(.*?)</script>', text, re.S).group(1))
    packed = embedded["views"]["traced"]["spectra"]
    shape = (len(packed["basis"]), packed["rows"], packed["columns"])
    weights = unpacked(packed["planes"]["chain"], shape).astype(np.uint16).view(np.int16)
    found = np.einsum("krc,kb->rcb", weights * packed["step"], np.array(packed["basis"]))
    true, _ = proof_folders.ball_spectra(-0.06 + 0.004)
    rows = slice(packed["y"], packed["y"] + packed["stride"] * packed["rows"], packed["stride"])
    columns = slice(
        packed["x"], packed["x"] + packed["stride"] * packed["columns"], packed["stride"]
    )
    error = np.abs(found - true[rows, columns]).max()
    assert error <= 1.05 * packed["error"] * true.max() + 1e-7
    assert packed["error"] <= 0.002


# --- Safety ------------------------------------------------------------------------------------


def test_policy_allows_this_style_and_this_script_alone(text):
    page = Page(text)
    policy = page.attributes("content")[0]
    assert policy.startswith("default-src 'none'; ")
    for kind in ("style", "script"):
        runs = [
            body
            for body, (_, attributes) in zip(
                page.texts[kind], [e for e in page.elements if e[0] == kind], strict=True
            )
            if attributes.get("type") is None
        ]
        assert len(runs) == 1
        digest = base64.b64encode(hashlib.sha256(runs[0].encode()).digest()).decode()
        assert f"{kind}-src 'sha256-{digest}'" in policy
    assert "unsafe" not in policy


def test_page_names_no_other_place(text):
    """Nothing could be fetched, even without the policy."""
    page = Page(text)
    addresses = [value for name in ("src", "href") for value in page.attributes(name)]
    assert addresses
    assert all(value.startswith(("data:image/", "#")) for value in addresses)
    shown = re.sub(r"data:image/[a-z]+;base64,[A-Za-z0-9+/=]+", "", text)
    shown = shown.replace("http://www.w3.org/2000/svg", "").replace("http-equiv", "")
    assert not re.search(r"https?:|//[a-z]+\.|@import|url\((?!#)", shown)
    assert not re.search(
        r"\b(eval|fetch|XMLHttpRequest|WebSocket|innerHTML|importScripts)\b", shown
    )


def test_page_has_no_inline_handlers_and_no_inline_styles(text):
    names = {name for _, attributes in Page(text).elements for name in attributes}
    assert not {name for name in names if name.startswith("on")}
    assert "style" not in names


def test_hostile_names_are_text_and_nothing_else(tmp_path):
    folder = tmp_path / "hostile"
    content = proof_folders.write_proof(folder, set_name=HOSTILE)
    content["layers"] = {"capture": "capture.usda"}
    content["comparisons"][0]["result"]["regions"][0]["name"] = HOSTILE
    content["budget"][0]["cause"] = f"={HOSTILE}"
    content["tones"][0]["tone"] = HOSTILE
    proof_folders.save(folder, content)
    assert main(["report", str(folder)]) == 0
    text = (folder / "report.html").read_text()
    page = Page(text)
    assert page.all_text.count(HOSTILE) >= 6
    assert all(attributes.get("src", "") != "x" for _, attributes in page.elements)
    assert text.count("<script") == 2
    test_page_has_no_inline_handlers_and_no_inline_styles(text)
    cells = (folder / "report.csv").read_text()
    assert "\nbudget,\"'=<" in cells or "\nbudget,\"'=" in cells


def test_text_is_escaped_and_markup_is_not():
    made = element("p", "<&>\"'", element("b", "x"), title='"<')
    assert made == '<p title="&quot;&lt;">&lt;&amp;&gt;&quot;&#x27;<b>x</b></p>'
    assert isinstance(made, Markup)
    assert "</script><" not in json_block("x", json.dumps("</script><"))[:-20]


def test_reports_of_one_proof_are_the_same_bytes(copy, tmp_path):
    for name in ("one.html", "two.html"):
        assert main(["report", str(copy), "-o", str(tmp_path / name)]) == 0
    for suffix in ("html", "json", "csv"):
        first, second = (tmp_path / f"{name}.{suffix}" for name in ("one", "two"))
        assert first.read_bytes() == second.read_bytes()


# --- What is not there -------------------------------------------------------------------------


def test_missing_parts_are_left_out_and_named(copy, capsys):
    content = content_of(copy)
    for name in ("spectra", "skin", "tones", "budget", "comparisons", "pictures", "bars"):
        content[name] = {} if name == "spectra" else []
    content["layers"] = {}
    proof_folders.save(copy, content)
    assert main(["report", str(copy)]) == 0
    said = "Truth and reproduction, Renders, Chart patches, Tones of skin, Error budget, Spectra, "
    said += "Light, Skin parameters"
    assert said in capsys.readouterr().err
    text = (copy / "report.html").read_text()
    assert said in text
    assert "No picture was compared with a truth" in text
    assert json.loads((copy / "report.json").read_text())["comparisons"] == []


def test_a_real_shoot_is_judged_by_its_patches(copy):
    content = content_of(copy)
    content["comparisons"], content["bars"] = [], []
    content["pictures"] = [row for row in content["pictures"] if row["name"] == "chain"]
    content["layers"] = {"shoot": "../shoot.usda", "capture": "capture.usda"}
    (copy.parent / "shoot.usda").write_text("#usda 1.0\n")
    content["missing"] = ["the true light is not known"]
    content["patches"] = [
        {
            "class": "tubes",
            "leaveOneOut": {"deltaE2000": {"mean": 1.234, "p95": 2.5}, "gfc": 0.99},
            "relit": {"deltaE2000": {"mean": 0.876, "p95": 1.5}, "gfc": 0.98, "lampGfc": 0.97},
            "patches": [{"name": "dark skin", "leaveOneOut": 1.11, "relit": 2.22}],
        },
        {"class": "window", "leaveOneOut": {"deltaE2000": None, "gfc": None}, "relit": None},
    ]
    proof_folders.save(copy, content)
    assert main(["report", str(copy)]) == 0
    text = (copy / "report.html").read_text()
    assert "Judged by the chart&#x27;s patches; the truth is not known" in text
    for shown in ("1.23", "0.88", "0.97000", "1.11", "2.22", "The proof says: the true light is"):
        assert shown in text
    assert text.count("<img") == 3
    rows = (copy / "report.csv").read_text()
    assert "patches,tubes,relit deltaE2000 mean,0.876,1" in rows


def test_sections_of_a_whole_proof_are_all_there(text):
    sections = [found["id"] for tag, found in Page(text).elements if tag == "section"]
    assert sections == [
        "verdict", "pictures", "renders", "tones", "budget", "spectra", "light", "skin", "capture",
        "provenance",
    ]  # fmt: skip


def test_every_picture_has_words_in_its_place(text):
    images = [attributes for tag, attributes in Page(text).elements if tag == "img"]
    assert len(images) >= 16
    assert all(attributes["alt"] for attributes in images)


def test_files_with_hashes_and_commands_are_listed(proof, text):
    content = content_of(proof)
    for name, row in content["files"].items():
        assert name in text
        assert row["sha256"] in text
    for step in content["steps"]:
        assert step["command"] in text


def test_files_no_longer_there_that_are_not_shown_are_noted(copy, capsys):
    content = content_of(copy)
    content["files"]["shoot/a.tif"] = {"sha256": "0" * 64, "bytes": 5}
    (copy / "proof.json").write_text(json.dumps(content))
    assert main(["report", str(copy)]) == 0
    assert "shoot/a.tif" in capsys.readouterr().err
    assert "(not here)" in (copy / "report.html").read_text()


# --- What is refused ---------------------------------------------------------------------------


def test_folder_without_a_proof_is_refused(tmp_path, capsys):
    assert "holds no proof.json; `usdskin prove" in refusal(capsys, tmp_path)
    assert "no such folder" in refusal(capsys, tmp_path / "none")


def test_broken_json_is_refused(tmp_path, capsys):
    (tmp_path / "proof.json").write_text("{")
    assert "is no JSON" in refusal(capsys, tmp_path)
    (tmp_path / "proof.json").write_bytes(b"\xff\xfe")
    assert "is no JSON" in refusal(capsys, tmp_path)
    (tmp_path / "proof.json").write_text("[]")
    assert "an object is needed" in refusal(capsys, tmp_path)


def test_missing_picture_is_refused(copy, capsys):
    (copy / "renders/light_map.exr").unlink()
    line = refusal(capsys, copy)
    assert "renders/light_map.exr: is missing" in line


def test_changed_file_is_refused(copy, capsys):
    with open(copy / "capture.usda", "a") as file:
        file.write("# touched\n")
    assert "capture.usda: has changed since the proof was made" in refusal(capsys, copy)


def test_file_without_a_hash_is_refused(copy, capsys):
    content = content_of(copy)
    del content["files"]["renders/light_map.exr"]
    (copy / "proof.json").write_text(json.dumps(content))
    assert "renders/light_map.exr: has no sha256 in proof.json" in refusal(capsys, copy)


def test_link_out_of_the_folder_is_refused(copy, capsys, tmp_path):
    shutil.move(copy / "capture.usda", tmp_path / "capture.usda")
    (copy / "capture.usda").symlink_to(tmp_path / "capture.usda")
    assert "is a link out of the proof's folder" in refusal(capsys, copy)


@pytest.mark.parametrize("name", ["../other.exr", "/etc/passwd", "a/../../b.exr", "C:\\x.exr", ""])
def test_files_outside_the_folder_are_refused(copy, capsys, name):
    content = content_of(copy)
    content["pictures"][0]["beauty"] = name
    (copy / "proof.json").write_text(json.dumps(content))
    assert "not inside the folder" in refusal(capsys, copy)


@pytest.mark.parametrize(
    ("path", "value", "said"),
    [
        (("comparisons", 0, "result", "deltaE2000", "mean"), "x", "mean: is 'x'; a number"),
        (("comparisons", 0, "result", "yN"), float("nan"), "NaN is no number of JSON"),
        (("comparisons", 0, "result", "yN"), 10**400, "a finite number is needed"),
        (("title",), "\ud800", "is no JSON ('utf-8' codec can't encode"),
        (("comparisons", 0, "result", "white"), [2.0, 0.3], "a chromaticity"),
        (("bars", 0, "met"), "yes", "true or false"),
        (("spectra", "items", 0, "true"), [1.0], "has 1 values for 16 wavelengths"),
        (("spectra", "wavelengths"), [500.0] * 16, "must ascend"),
        (("steps",), {"a": 1}, "a list is needed"),
        (("skin", 0, "name"), None, "a text is needed"),
    ],
)
def test_values_that_cannot_be_are_refused_with_their_place(copy, capsys, path, value, said):
    content = content_of(copy)
    place = content
    for key in path[:-1]:
        place = place[key]
    place[path[-1]] = value
    (copy / "proof.json").write_text(json.dumps(content))
    assert said in refusal(capsys, copy)


def test_report_does_not_overwrite_the_proof(copy, capsys):
    assert "end the name in .html" in refusal(capsys, copy, "-o", str(copy / "proof.json"))
    assert "is a file of the proof" in refusal(capsys, copy, "-o", str(copy / "proof.html"))


def test_maps_without_differences_are_refused(copy, capsys):
    shutil.copy(copy / "light.exr", copy / "differences/light_map.exr")
    proof_folders.save(copy, content_of(copy))
    assert "has no channel dE2000" in refusal(capsys, copy)


@pytest.mark.parametrize("exposure", [0.25, 1.0, 4.0])
def test_colors_are_those_of_the_light_whatever_the_cameras_exposure(tmp_path, exposure):
    """A fifth of the white is L* = 116 (0.2)^(1/3) - 16."""
    pixels = np.full((2, 3, 3), 0.2 * exposure, np.float32)
    header = {"usdskin/exposureScale": repr(exposure)}
    part = Part("beauty", {"": pixels}, header, color_space="lin_rec709_scene")
    file = write_exr(tmp_path / "a.exr", [part]) or tmp_path / "a.exr"
    judged = SimpleNamespace(y_n=1.0, white=(0.3127, 0.3290))
    found = lab_of_beauty(file, judged)
    np.testing.assert_allclose(found, np.full((2, 3, 3), [51.8372, 0.0, 0.0]), atol=0.02)
