"""Mixed light from captures of one place with one kind of lamps switched on at a time."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pytest
from test_estimate_light import (
    HEIGHT,
    NM,
    SCALE,
    SETTINGS,
    WIDTH,
    lamp,
    make_place,
    recovered,
    relative,
    responsivity,
    surfaces,
)

from usdskin import cli
from usdskin.colorimetry import xyz_weights
from usdskin.errors import ImageError, LayerError, UsageError
from usdskin.estimate.light.step import LightOptions, estimate_light
from usdskin.images import Part, read_image, write_exr
from usdskin.prims.writing import write_schema

from pxr import Usd, UsdGeom  # isort: skip

LAMPS = ("FL2", "D65", "A")


@dataclass
class Switchable:
    """A place whose lamps were captured together and one by one."""

    folder: Path
    camera: Path
    parts: np.ndarray
    """Radiance of each lamp's light, shape [lamps, height, width, 61]."""

    def captures(self, *names: str) -> tuple[tuple[str, Path], ...]:
        return tuple((name, self.folder / f"{name}.usda") for name in names)

    def light(self, *names: str) -> Path:
        output = self.folder / "light.usda"
        options = LightOptions(class_captures=self.captures(*names))
        self.result = estimate_light(self.folder / "all.usda", self.camera, output, options)
        return output


def write_capture(folder: Path, name: str, radiance: np.ndarray, scale: float, **more) -> None:
    """Write a capture of a radiance, its pixels ``scale`` times the camera values."""
    pixels = (scale * (radiance @ responsivity())).astype(np.float32)
    write_exr(folder / f"{name}.exr", [Part("", {"": pixels}, color_space="unknown")])
    stage = Usd.Stage.CreateNew(str(folder / f"{name}.usda"))
    UsdGeom.SetStageUpAxis(stage, more.pop("up_axis", "Y"))
    prim = UsdGeom.Xform.Define(stage, "/Capture").GetPrim()
    stage.SetDefaultPrim(prim)
    values = {
        "capture:panorama:file": folder / f"{name}.exr",
        "capture:scale": scale,
        "capture:settings:model": SETTINGS["model"],
        "capture:settings:lens": SETTINGS["lens"],
        "capture:settings:whiteBalance": SETTINGS["white_balance"],
    }
    write_schema(prim, "CaptureAPI", values | more, folder)
    stage.Save()


def switchable(folder: Path, count: int = 2) -> Switchable:
    """Write a place where every texel holds light of every lamp, of another surface each."""
    camera = make_place(folder, LAMPS[:count]).camera
    rng = np.random.default_rng(11)
    colors = rng.uniform(0.0, 1.0, (count, HEIGHT, WIDTH, 3))
    colors[:, 0] = 0.0  # dark
    colors[0, 1] = 0.0  # without the first
    parts = np.stack([(color @ surfaces()) * lamp(name)
                      for color, name in zip(colors, LAMPS, strict=False)])  # fmt: skip
    write_capture(folder, "all", parts.sum(axis=0), SCALE)
    for index, part in enumerate(parts):
        write_capture(folder, f"lamp{index}", part, SCALE * (1.5 + index))
    return Switchable(folder, camera, parts)


@pytest.mark.parametrize("captured", [("lamp0", "lamp1"), ("lamp1",), ("lamp0",)])
def test_the_light_of_every_lamp_comes_back_whatever_the_surfaces(tmp_path, captured):
    """No class map could: surfaces differ from lamp to lamp, in every texel."""
    place = switchable(tmp_path)
    spectra, _ = recovered(place.light(*captured))
    assert relative(spectra, place.parts.sum(axis=0)) < 1e-5


def test_three_kinds_of_lamps_take_two_captures(tmp_path):
    place = switchable(tmp_path, 3)
    spectra, _ = recovered(place.light("lamp2", "lamp0"))
    assert relative(spectra, place.parts.sum(axis=0)) < 1e-5


def test_the_map_and_the_report_tell_the_shares_of_the_lamps(tmp_path):
    place = switchable(tmp_path)
    place.light("lamp0", "lamp1")
    weights = read_image(tmp_path / "light.classes.exr").pixels[..., :2]
    luminance = place.parts @ xyz_weights(NM)[:, 1]
    lit = slice(1, None)
    shares = luminance[0, lit] / luminance[:, lit].sum(axis=0)
    np.testing.assert_allclose(weights[lit, :, 0], shares, atol=1e-3)
    assert (weights[1, :, 0] < 1e-3).all()
    shares = [item.flux_share for item in place.result.report.classes]
    assert sum(shares) == pytest.approx(1.0)


def test_drift_between_captures_leaves_the_whole_as_it_was_captured(tmp_path):
    """Lamps that are 10 % brighter alone change the shares a little, the camera values not."""
    place = switchable(tmp_path)
    first, _ = recovered(place.light("lamp0", "lamp1"))
    (tmp_path / "lamp1.usda").unlink()
    write_capture(tmp_path, "lamp1", 1.1 * place.parts[1], SCALE)
    again, _ = recovered(place.light("lamp0", "lamp1"))
    np.testing.assert_allclose(
        again @ responsivity(), first @ responsivity(), rtol=1e-4, atol=1e-6 * first.max()
    )


def lit_room(folder: Path) -> Switchable:
    """Write grey walls, in the light of two lamps, each seen in a direction of its own."""
    camera = make_place(folder, LAMPS[:2]).camera
    amount = np.full((2, HEIGHT, WIDTH), 0.2)
    amount[0, 6:9, 10:14] = amount[1, 9:12, 30:34] = 20.0
    parts = np.stack([amount[index, ..., None] * lamp(LAMPS[index]) for index in range(2)])
    write_capture(folder, "all", parts.sum(axis=0), SCALE)
    for index, part in enumerate(parts):
        write_capture(folder, f"lamp{index}", part, SCALE)
    return Switchable(folder, camera, parts)


def spoil(place: Switchable, radiance: np.ndarray) -> None:
    """Write the capture of the first lamp anew."""
    (place.folder / "lamp0.usda").unlink()
    write_capture(place.folder, "lamp0", radiance, 3.0 * SCALE)


def disagreements(place: Switchable) -> list[str]:
    return [str(note) for note in place.result.notes if note.code.startswith("captures-")]


@pytest.mark.parametrize("captured", [("lamp0", "lamp1"), ("lamp0",)])
def test_a_capture_from_a_turned_tripod_is_refused(tmp_path, captured):
    """The lamp is where the whole capture has a wall: columns 10 to 13 of 48, turned by four."""
    place = lit_room(tmp_path)
    place.light(*captured)
    assert disagreements(place) == []
    spoil(place, np.roll(place.parts[0], 4, axis=1))
    message = (
        r"--class-capture lamp0 \(lamp0.usda </Capture>\): gives \d+\.\d\d times the light of the "
        r"whole capture, all.usda </Capture>, around azimuth 2[34]\d, elevation [34]\d deg "
        r"\(x 1[567], y [678] of all.exr\), so it does not belong to it; name the right layer, or "
    )
    with pytest.raises(LayerError, match=message):
        place.light(*captured)


def test_lamps_that_were_off_in_their_capture_are_refused(tmp_path):
    """Light is missing, and the sum cannot tell in which capture."""
    place = lit_room(tmp_path)
    spoil(place, 0.01 * place.parts[0])
    message = r"lamp0, lamp1: together give 0.\d\d times .*\(x 1[0-3], y [678] of .*one of them"
    with pytest.raises(LayerError, match=message):
        place.light("lamp0", "lamp1")


@pytest.mark.parametrize(
    ("factor", "count"), [(1 / 1.4, 1), (1 / 1.1, 0), (1.0, 0), (1.1, 0), (1.4, 1)]
)
def test_captures_that_do_not_quite_add_up_are_noted(tmp_path, factor, count):
    place = lit_room(tmp_path)
    spoil(place, factor * place.parts[0])
    place.light("lamp0", "lamp1")
    found = disagreements(place)
    assert len(found) == count
    assert all("times the light of the whole capture, all.usda" in note for note in found)


def test_a_single_capture_is_not_held_to_be_the_whole(tmp_path):
    """What the other class adds is its light; that it adds nothing is told."""
    place = lit_room(tmp_path)
    place.light("lamp0")
    assert disagreements(place) == []
    spoil(place, place.parts.sum(axis=0))
    place.light("lamp0")
    (note,) = disagreements(place)
    assert "captures-leave-nothing <lamp0>: give all the light of all.usda" in note


@pytest.mark.parametrize(
    ("names", "error", "message"),
    [
        (("tubes",), UsageError, "--class-capture tubes: .*it has lamp0, lamp1, lamp2"),
        (("lamp0",), UsageError, "lamp1, lamp2 have none"),
        (("lamp0", "lamp0", "lamp1"), UsageError, "lamp0: given twice"),
    ],
)
def test_captures_that_do_not_say_enough_are_refused(tmp_path, names, error, message):
    place = switchable(tmp_path, 3)
    write_capture(tmp_path, "tubes", place.parts[0], SCALE)
    with pytest.raises(error, match=message):
        place.light(*names)
    assert not (tmp_path / "light.usda").exists()


def test_captures_of_another_size_or_frame_or_camera_are_refused(tmp_path):
    place = switchable(tmp_path)
    for file in tmp_path.glob("lamp0.*"):
        file.unlink()
    write_capture(tmp_path, "lamp0", place.parts[0][: HEIGHT // 2, : WIDTH // 2], SCALE)
    with pytest.raises(
        ImageError, match=r"24 x 12 pixels, but .*all.exr has 48 x 24; capture lamp0"
    ):
        place.light("lamp0", "lamp1")
    write_capture(tmp_path, "other", place.parts[0], SCALE, up_axis="Z")
    options = LightOptions(class_captures=(("lamp0", tmp_path / "other.usda"),))
    with pytest.raises(LayerError, match=r"--class-capture lamp0 \(other.usda.*: its up axis is Z"):
        estimate_light(tmp_path / "all.usda", place.camera, tmp_path / "l.usda", options)
    settings = {"capture:settings:model": "Another"}
    write_capture(tmp_path, "foreign", place.parts[0], SCALE, **settings)
    options = LightOptions(class_captures=(("lamp0", tmp_path / "foreign.usda"),))
    message = r'^--class-capture lamp0: foreign.usda .* camera model is "Another" .* "Maker 5100"'
    with pytest.raises(LayerError, match=message):
        estimate_light(tmp_path / "all.usda", place.camera, tmp_path / "l.usda", options)


@pytest.mark.parametrize("count", [2, 3])
def test_captures_with_each_others_names_are_refused(tmp_path, count):
    place = switchable(tmp_path, count)
    (one, first), (other, second) = place.captures("lamp0", "lamp1")
    rest = place.captures("lamp2") if count == 3 else ()
    options = LightOptions(class_captures=((one, second), (other, first), *rest))
    message = (
        r"^--class-capture lamp0 \(lamp1.usda.*\), lamp1 \(lamp0.usda.*\): have the color of each "
        r"other's lamps: lamp0 over lamp1 is [\d.]+ in R/G and [\d.]+ in B/G, and the calibration "
        r"says [\d.]+ and [\d.]+; interchange the two names$"
    )
    with pytest.raises(LayerError, match=message):
        estimate_light(tmp_path / "all.usda", place.camera, tmp_path / "l.usda", options)
    assert not (tmp_path / "l.usda").exists()


def test_a_single_capture_with_the_others_name_is_refused(tmp_path):
    place = switchable(tmp_path)
    options = LightOptions(class_captures=(("lamp0", tmp_path / "lamp1.usda"),))
    message = r"^--class-capture lamp0 \(lamp1.usda.*\): has the color of lamp1, .*call it lamp1$"
    with pytest.raises(LayerError, match=message):
        estimate_light(tmp_path / "all.usda", place.camera, tmp_path / "l.usda", options)


def test_files_that_are_no_captures_are_refused_by_the_name_of_their_class(tmp_path):
    place = switchable(tmp_path)
    (tmp_path / "empty.usda").write_text("#usda 1.0\n")
    pixels = np.full((HEIGHT, WIDTH, 3), np.nan, np.float32)
    (tmp_path / "lamp1.exr").unlink()
    write_exr(tmp_path / "lamp1.exr", [Part("", {"": pixels}, color_space="unknown")])
    for name, error, message in [
        ("gone", LayerError, "--class-capture lamp0: .*gone.usda: no such file"),
        ("empty", LayerError, "--class-capture lamp0: empty.usda: .*, so it is no capture"),
        ("lamp1", ImageError, r"lamp1.exr \(lamp1.usda </Capture>\): the pixel at x 0, y 0 is nan"),
    ]:
        options = LightOptions(class_captures=(("lamp0", tmp_path / f"{name}.usda"),))
        with pytest.raises(error, match=message):
            estimate_light(tmp_path / "all.usda", place.camera, tmp_path / "l.usda", options)


def test_a_class_or_a_map_and_captures_exclude_each_other(tmp_path):
    place = switchable(tmp_path)
    for other in ({"light_class": "lamp0"}, {"class_map": tmp_path / "map.exr"}):
        options = LightOptions(class_captures=place.captures("lamp0"), **other)
        with pytest.raises(UsageError, match="--class-capture exclude each other"):
            estimate_light(tmp_path / "all.usda", place.camera, tmp_path / "l.usda", options)


def test_the_command_takes_captures_by_name(tmp_path, monkeypatch, capsys):
    place = switchable(tmp_path)
    monkeypatch.chdir(tmp_path)
    given = ["estimate", "light", "all.usda", "--camera", place.camera.name, "-o", "light.usda"]
    assert cli.main(["-q", *given, "--class-capture", "lamp1=lamp1.usda"]) == 0
    assert relative(recovered(tmp_path / "light.usda")[0], place.parts.sum(axis=0)) < 1e-5
    assert cli.main(["-q", *given, "--class-capture", "lamp1.usda"]) == 2
    assert "is not NAME=CAPTURE.usda" in capsys.readouterr().err
