"""From a folder of photographs to the layer of a shoot, with folders as they really are."""

import json
import re
import sys
from dataclasses import replace
from datetime import timedelta
from pathlib import Path

import numpy as np
import OpenEXR
import pytest
from photographs import BEGAN, disc, write_bracket, write_photo

from usdskin.capture.ingest.exif import Photo, read_photo
from usdskin.capture.ingest.folder import natural
from usdskin.capture.ingest.image_circle import find_circle, find_circle_of_brackets, guess_lens
from usdskin.capture.ingest.options import IngestOptions
from usdskin.capture.ingest.sequences import in_order, split_brackets
from usdskin.capture.ingest.step import ingest
from usdskin.capture.viewpoints import Direction, directions_of_names, parse_directions
from usdskin.cli import main
from usdskin.errors import ImageError, LayerError, UsageError
from usdskin.layers import open_stage, write_layer
from usdskin.prims import FisheyeLens, read_shoot, write_lens
from usdskin.validate import validate

# isort: split
from pxr import Usd, UsdGeom

TIMES = (1 / 250, 1 / 60, 1 / 15, 0.25)


def shoot_folder(directory, views=("a", "b", "c"), times=TIMES, **told):
    """Write a folder for each view, a bracket in each, two minutes apart."""
    for index, view in enumerate(views):
        began = BEGAN + timedelta(minutes=2 * index)
        write_bracket(directory / view, disc(), times, began, **told)
    return directory


def run(directory, output=None, **options):
    """Ingest; return the shoot as its layer says it, and the notes."""
    notes = []
    output = output or directory.parent / "shoot.usda"
    assert ingest(directory, output, IngestOptions(threads=1, **options), notes=notes) == output
    return read_shoot(open_stage(output)), notes


def codes(notes):
    return {note.code for note in notes}


def text_of(notes, code):
    return " / ".join(note.message for note in notes if note.code == code)


# --- EXIF --------------------------------------------------------------------------------------


@pytest.mark.parametrize("suffix", [".tif", ".jpg", ".png", ".exr", ".dng", ".nef"])
def test_every_kind_of_file_tells_how_it_was_taken(tmp_path, suffix):
    pixels = disc(24, 32)
    if suffix in (".dng", ".nef"):
        pytest.importorskip("rawpy")
        pixels = pixels[..., 0]
    moment = BEGAN + timedelta(milliseconds=370)
    given = {"time": 1 / 60, "iso": 400, "f_number": 5.6, "orientation": 6}
    photo = read_photo(write_photo(tmp_path / f"a{suffix}", pixels, moment, **given))
    assert (photo.width, photo.height) == (32, 24)
    assert (photo.model, photo.lens, photo.orientation) == ("Nikon D850", "Fish 8mm", 6)
    assert (photo.iso, photo.f_number, photo.moment) == (400.0, 5.6, moment)
    rounded = 1e-4 if suffix in (".jpg", ".png") else 1e-12  # OpenImageIO writes 16666/1000000
    assert photo.exposure_time_s == pytest.approx(1 / 60, rel=rounded)


def test_standard_attributes_of_exr_are_read(tmp_path):
    header = {
        "compression": OpenEXR.ZIP_COMPRESSION,
        "type": OpenEXR.scanlineimage,
        "expTime": 1 / 125,
        "aperture": 4.0,
        "isoSpeed": 200.0,
        "capDate": "2026:11:22 14:05:00",
        "cameraModel": "Cam",
        "lensModel": "Fish",
    }
    path = tmp_path / "a.exr"
    with OpenEXR.File(header, {"RGB": np.zeros((4, 6, 3), np.float32)}) as file:
        file.write(str(path))
    photo = read_photo(path)
    assert (photo.exposure_time_s, photo.f_number, photo.iso) == (1 / 125, 4.0, 200.0)
    assert (photo.model, photo.lens, photo.moment) == ("Cam", "Fish", BEGAN)


def test_make_is_named_where_the_model_does_not_repeat_it(tmp_path):
    both = {"make": "RICOH", "model": "THETA Z1"}
    assert read_photo(write_photo(tmp_path / "a.tif", disc(), **both)).model == "RICOH THETA Z1"
    both = {"make": "NIKON CORPORATION", "model": "NIKON Z 6"}
    assert read_photo(write_photo(tmp_path / "b.tif", disc(), **both)).model == "NIKON Z 6"


def test_f_number_zero_is_a_lens_without_contacts(tmp_path):
    photo = read_photo(write_photo(tmp_path / "a.tif", disc(), f_number=0))
    assert photo.f_number is None


def test_text_that_is_not_utf8_is_read_as_latin1(tmp_path):
    photo = read_photo(write_photo(tmp_path / "a.tif", disc(), lens=b"F\xfcnfer 8mm"))
    assert photo.lens == "Fünfer 8mm"


# --- Directions --------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("text", "looks"),
    [
        ("0", (0, 0, -1)),
        ("90", (-1, 0, 0)),
        ("left", (-1, 0, 0)),
        ("180", (0, 0, 1)),
        ("270", (1, 0, 0)),
        ("up", (0, 1, 0)),
        ("down", (0, -1, 0)),
        ("90:45", (-(0.5**0.5), 0.5**0.5, 0)),
    ],
)
def test_directions_count_to_the_left_from_minus_z(text, looks):
    (direction,) = parse_directions(f"{text}")
    np.testing.assert_allclose(direction.vector, looks, atol=1e-15)
    rotation = direction.rotation()
    np.testing.assert_allclose(rotation.T @ rotation, np.eye(3), atol=1e-15)
    assert np.linalg.det(rotation) == pytest.approx(1.0)


def test_level_camera_is_upright_and_a_rolled_one_is_not():
    direction = Direction(40.0)
    np.testing.assert_allclose(direction.rotation() @ (0, 1, 0), (0, 1, 0), atol=1e-15)
    right = direction.rotation() @ (1, 0, 0)
    np.testing.assert_allclose(direction.rotation(-90.0) @ (0, 1, 0), right, atol=1e-15)
    np.testing.assert_allclose(direction.rotation(-90.0) @ (0, 0, -1), direction.vector)


def test_sets_of_directions_have_names():
    assert parse_directions("3") == (Direction(0), Direction(120), Direction(240))
    assert parse_directions("3+zenith") == (*parse_directions("3"), Direction(0, 90))
    assert parse_directions("4+zenith+nadir")[-2:] == (Direction(0, 90), Direction(0, -90))
    assert parse_directions("back-to-back") == (Direction(0), Direction(180))
    assert parse_directions("0, 72:-10,up") == (Direction(0), Direction(72, -10), Direction(0, 90))
    assert [str(item) for item in parse_directions("30,72:-10,up")] == ["30", "72:-10", "up"]


@pytest.mark.parametrize("text", ["0,north", "0:0:0", "nan", "0:95", "", "3+moon"])
def test_text_that_is_no_direction_is_refused(text):
    with pytest.raises(UsageError, match=r"--views .* is no direction; give 3, 3\+zenith"):
        parse_directions(text)


def test_names_tell_directions_only_where_they_are_aimed():
    assert directions_of_names(["0", "120", "up"]) == (
        Direction(0),
        Direction(120),
        Direction(0, 90),
    )
    assert directions_of_names(["1", "2", "3"]) is None
    assert directions_of_names(["0", "120", "kitchen"]) is None


# --- Brackets in a flat folder -----------------------------------------------------------------


def a_photo(name, time, moment=None):
    return Photo(Path(name), 8, 6, "uint16", float(time), 100.0, 8.0, moment=moment)


def sequence(times, views, moments=None):
    count = len(times) * views
    return [
        a_photo(f"IMG_{index}", times[index % len(times)], moments and moments[index])
        for index in range(count)
    ]


def names(brackets):
    return [[int(str(photo.path)[4:]) for photo in bracket] for bracket in brackets]


def test_brackets_end_where_settings_repeat():
    assert names(split_brackets(sequence(TIMES, 3))) == [[0, 1, 2, 3], [4, 5, 6, 7], [8, 9, 10, 11]]


@pytest.mark.parametrize("dropped", range(12))
def test_a_missing_photograph_moves_no_other_to_another_view(dropped):
    photos = sequence(TIMES, 3)
    del photos[dropped]
    expected = [[i for i in range(4 * v, 4 * v + 4) if i != dropped] for v in range(3)]
    assert names(split_brackets(photos)) == expected


def test_bracket_that_repeats_a_setting_is_told_by_pauses():
    """Two automatic brackets around different middles share an exposure."""
    times = (1 / 60, 1 / 250, 1 / 15, 1 / 250, 1 / 1000, 1 / 60)
    starts = [120 * view + 0.5 * index for view in range(3) for index in range(6)]
    moments = [BEGAN + timedelta(seconds=start) for start in starts]
    found = names(split_brackets(sequence(times, 3, moments)))
    assert found == [list(range(6)), list(range(6, 12)), list(range(12, 18))]


def test_long_exposures_are_no_pauses():
    times = (1 / 4, 4.0, 30.0)
    starts = [0, 1, 6, 60, 61, 66, 120, 121, 126]
    moments = [BEGAN + timedelta(seconds=start) for start in starts]
    assert [len(item) for item in split_brackets(sequence(times, 3, moments))] == [3, 3, 3]


def test_one_bracket_with_uneven_pauses_is_one_view():
    moments = [BEGAN + timedelta(seconds=seconds) for seconds in (0, 3, 40, 44)]
    assert len(split_brackets(sequence(TIMES, 1, moments))) == 1


def test_photographs_of_one_setting_are_views_of_their_own():
    assert names(split_brackets(sequence((1 / 60,), 3))) == [[0], [1], [2]]


def test_time_orders_photographs_across_a_counter_that_starts_over():
    first, second = (
        a_photo("IMG_9999", 1, BEGAN),
        a_photo("IMG_0001", 1, BEGAN + timedelta(hours=1)),
    )
    assert in_order([second, first]) == [first, second]
    unknown = replace(first, moment=None)
    assert in_order([second, unknown]) == [second, unknown]


def test_numbers_in_names_sort_by_their_value():
    assert sorted(["b10", "b9", "a", "B2"], key=natural) == ["a", "B2", "b9", "b10"]


# --- Image circle ------------------------------------------------------------------------------


def circle_picture(x, y, radius, dark_floor=False, flare=False):
    rows, columns = np.mgrid[0:341, 0:512] + 0.5
    away = np.hypot(columns - x, rows - y)
    light = 0.5 * np.exp(0.8 * np.sin(columns / 17.0) + 0.8 * np.cos(rows / 23.0))
    if dark_floor:
        light = np.where(rows > 0.7 * 341, 0.005, light)
    picture = np.clip(light * np.clip(radius - away + 0.5, 0.0, 1.0) + 0.003, 0.0, 1.0)
    if flare:
        picture[:40, :60] = 0.5
    return picture.astype(np.float32)


@pytest.mark.parametrize(
    ("x", "y", "radius", "trouble"),
    [
        (256.0, 170.5, 165.0, {}),
        (249.3, 172.6, 160.0, {"dark_floor": True}),
        (256.0, 170.5, 165.0, {"dark_floor": True, "flare": True}),
        (260.0, 175.0, 230.0, {}),  # cropped above and below
    ],
)
def test_image_circle_is_found_to_half_a_pixel(x, y, radius, trouble):
    found = find_circle([circle_picture(x, y, radius, **trouble)])
    np.testing.assert_allclose(found, (x, y, radius), atol=0.5)


def test_picture_that_light_fills_has_no_circle():
    assert find_circle([circle_picture(256.0, 170.5, 400.0)]) is None
    assert find_circle([np.zeros((60, 80), np.float32)]) is None


def veiled_room(radius, glare):
    """Return a room with a lamp, through a veil that lies over the whole picture."""
    rows, columns = np.mgrid[0:341, 0:512] + 0.5
    away = np.hypot(columns - 256.0, rows - 170.5)
    light = 0.5 * np.exp(0.8 * np.sin(columns / 17.0) + 0.8 * np.cos(rows / 23.0))
    light[90:130, 200:300] = 60.0
    light *= np.clip(radius - away + 0.5, 0.0, 1.0)
    return (1.0 - glare) * light + glare * light[away < radius].mean()


LONGEST_FIRST = 60.0 * 0.25 ** np.arange(9)


@pytest.mark.parametrize("glare", [0.0, 0.003, 0.01, 0.03])
def test_image_circle_is_found_through_a_veil_of_glare(glare):
    room = veiled_room(160.0, glare)
    bracket = [np.clip(0.03 + room * time, 0.0, 1.0).astype("f4") for time in LONGEST_FIRST]
    found = find_circle_of_brackets([bracket, bracket[2:]])
    assert found is not None
    np.testing.assert_allclose(found, (256.0, 170.5, 160.0), rtol=0.02)
    if glare > 0.0:
        assert find_circle(bracket[:1]) is None  # the veil saturates the longest exposure


def test_fall_of_light_to_the_corners_is_no_image_circle():
    rows, columns = np.mgrid[0:341, 0:512] + 0.5
    away = np.hypot(columns - 256.0, rows - 170.5) / 307.6
    light = 0.03 + 0.97 * (1.0 - away**2) ** 2
    bracket = [np.clip(light * item, 0.0, 1.0).astype(np.float32) for item in (30.0, 4.0, 0.5)]
    assert find_circle_of_brackets([bracket]) is None


@pytest.mark.parametrize(
    ("projection", "height"),
    [
        ("equidistant", np.pi / 2.0),
        ("equisolid", 2.0 * np.sin(np.pi / 4.0)),
        ("stereographic", 2.0 * np.tan(np.pi / 4.0)),
        ("orthographic", 1.0),
    ],
)
def test_guessed_lens_puts_its_field_on_the_circle(projection, height):
    lens = guess_lens(find_circle([circle_picture(256, 170, 165)]), (512, 341), projection, 180.0)
    assert lens.focal_length_px == pytest.approx(165.0 / height, rel=2e-3)
    assert lens.max_angle_deg == 90.0
    diagonal = guess_lens(None, (300, 400), projection, 180.0)
    assert diagonal.focal_length_px == pytest.approx(250.0 / height)
    np.testing.assert_array_equal(diagonal.center_px, (150.0, 200.0))


@pytest.mark.parametrize("glare", [0.003, 0.01, 0.03])
def test_lens_is_guessed_to_two_percent_under_glare(tmp_path, glare):
    light = np.repeat(veiled_room(160.0, glare)[..., None], 3, axis=-1)
    for view in ("a", "b"):
        write_bracket(tmp_path / "photos" / view, light, LONGEST_FIRST[::-1])
    shoot, _ = run(tmp_path / "photos", views="0,up")
    assert shoot.views[0].lens.focal_length_px == pytest.approx(160.0 / (np.pi / 2.0), rel=0.02)


# --- Whole folders -----------------------------------------------------------------------------


def test_folders_become_views_of_a_shoot(tmp_path):
    shoot, notes = run(shoot_folder(tmp_path / "photos"), views="0,120,up")
    assert [view.name for view in shoot.views] == ["a", "b", "c"]
    assert shoot.session == "photos"
    assert (shoot.model, shoot.lens) == ("Nikon D850", "Fish 8mm")
    assert (shoot.device, shoot.time) == ("Nikon D850, Fish 8mm", "2026-11-22T14:05:00")
    for view, direction in zip(shoot.views, parse_directions("0,120,up"), strict=True):
        np.testing.assert_allclose(view.rotation, direction.rotation(), atol=1e-12)
        np.testing.assert_allclose(view.bracket.exposure_time_s, TIMES, rtol=1e-12)
        np.testing.assert_array_equal(view.bracket.f_number, 8.0)
        assert [path.name for path in view.bracket.images] == [f"IMG_{i}.tif" for i in range(1, 5)]
        assert view.lens.focal_length_px == pytest.approx(27.0 / (np.pi / 2.0), rel=0.03)
    assert codes(notes) == {"lens-guessed"}


def test_layer_passes_validation_and_names_photographs_from_its_own_folder(tmp_path):
    shoot_folder(tmp_path / "set" / "photos")
    (tmp_path / "layers").mkdir()
    output = tmp_path / "layers" / "shoot.usda"
    run(tmp_path / "set" / "photos", output)
    assert validate(output) == []
    text = output.read_text()
    assert "@../set/photos/a/IMG_1.tif@" in text
    assert str(tmp_path) not in text


def test_same_folder_gives_the_same_bytes_whatever_the_threads(tmp_path, monkeypatch):
    monkeypatch.setenv("SOURCE_DATE_EPOCH", "1700000000")
    directory = shoot_folder(tmp_path / "photos")
    before = {path: path.read_bytes() for path in directory.rglob("*.tif")}
    one, other = tmp_path / "one.usda", tmp_path / "other.usda"
    for output, threads in ((one, 1), (other, 4)):
        ingest(directory, output, IngestOptions(threads=threads))
    assert one.read_bytes() == other.read_bytes()
    assert {path: path.read_bytes() for path in directory.rglob("*.tif")} == before


def test_flat_folder_is_split_into_views(tmp_path):
    for view in range(3):
        began = BEGAN + timedelta(minutes=view)
        write_bracket(tmp_path / "photos", disc(), TIMES, began, first=8 + 4 * view)
    shoot, notes = run(tmp_path / "photos")
    assert [view.name for view in shoot.views] == ["view1", "view2", "view3"]
    assert shoot.views[0].bracket.images[2].name == "IMG_10.tif"
    assert "taken to be evenly around" in text_of(notes, "directions-assumed")
    assert "0, 120, 240 deg, counted to the left" in text_of(notes, "directions-assumed")


def test_folders_of_a_memory_card_are_no_views(tmp_path):
    write_bracket(tmp_path / "DCIM" / "100NIKON", disc(), TIMES, BEGAN)
    write_bracket(tmp_path / "DCIM" / "101NIKON", disc(), TIMES, BEGAN + timedelta(minutes=1))
    shoot, _ = run(tmp_path / "DCIM")
    assert [view.name for view in shoot.views] == ["view1", "view2"]


def test_names_of_folders_tell_directions(tmp_path):
    shoot, notes = run(shoot_folder(tmp_path / "photos", ("0", "90", "up")))
    assert [view.name for view in shoot.views] == ["view0", "view90", "up"]
    np.testing.assert_allclose(shoot.views[1].rotation @ (0, 0, -1), (-1, 0, 0), atol=1e-12)
    assert "read from the names of the folders: 0, 90, up" in text_of(notes, "directions-assumed")


def test_compass_tells_directions_clockwise_from_north(tmp_path):
    for name, heading in (("a", 0.0), ("b", 90.0)):
        told = {"heading": heading, "pitch": 10.0}
        write_bracket(tmp_path / "photos" / name, disc(), TIMES, suffix=".exr", **told)
    shoot, notes = run(tmp_path / "photos")
    east = (np.cos(np.radians(10.0)), np.sin(np.radians(10.0)), 0.0)
    np.testing.assert_allclose(shoot.views[1].rotation @ (0, 0, -1), east, atol=1e-12)
    assert "read from the compass" in text_of(notes, "directions-assumed")


def test_lens_layer_is_referenced(tmp_path):
    lens = FisheyeLens("equisolid", 17.0, np.array([41.0, 29.0]), (80, 60), max_angle_deg=92.0)
    lens_layer(tmp_path / "lens.usda", lens)
    shoot, notes = run(shoot_folder(tmp_path / "photos"), lens=tmp_path / "lens.usda")
    for view in shoot.views:
        assert (view.lens.projection, view.lens.focal_length_px) == ("equisolid", 17.0)
    assert "references = @./lens.usda@" in (tmp_path / "shoot.usda").read_text()
    assert "lens-guessed" not in codes(notes)
    assert validate(tmp_path / "shoot.usda") == []


def lens_layer(path, lens):
    stage = Usd.Stage.CreateInMemory()
    UsdGeom.SetStageUpAxis(stage, UsdGeom.Tokens.y)
    UsdGeom.SetStageMetersPerUnit(stage, 1.0)
    camera = UsdGeom.Camera.Define(stage, "/Lens").GetPrim()
    stage.SetDefaultPrim(camera)
    write_lens(camera, lens)
    return write_layer(stage, path)


def test_readings_and_levels_are_written(tmp_path):
    shoot, _ = run(
        shoot_folder(tmp_path / "photos"),
        illuminance=(350.0, Direction(0.0, 90.0)),
        luminance=(85.0, Direction(90.0)),
        black_level=512.0,
        white_level=16383.0,
        transfer="linear",
        nd_factor=64.0,
        session="hall",
    )
    assert (shoot.illuminance_lx, shoot.luminance, shoot.session) == (350.0, 85.0, "hall")
    np.testing.assert_allclose(shoot.illuminance_direction, (0, 1, 0), atol=1e-12)
    np.testing.assert_allclose(shoot.luminance_direction, (-1, 0, 0), atol=1e-12)
    bracket = shoot.views[0].bracket
    assert (bracket.black_level[0], bracket.white_level[0], bracket.transfer) == (
        512.0,
        16383.0,
        "linear",
    )
    np.testing.assert_array_equal(bracket.nd_factor, 64.0)


def test_dark_and_flat_are_no_views(tmp_path):
    directory = tmp_path / "photos"
    write_bracket(directory, disc(), TIMES)
    dark = write_photo(directory / "dark.tif", 0.0 * disc(), time=0.25, iso=100, f_number=8)
    shoot, _ = run(directory, dark=dark)
    assert len(shoot.views) == 1 and len(shoot.views[0].bracket.images) == 4
    assert shoot.views[0].bracket.dark_file == dark.resolve()


def test_raw_files_win_over_the_jpegs_beside_them(tmp_path):
    pytest.importorskip("rawpy")
    write_bracket(tmp_path / "photos", disc()[..., 0], TIMES, suffix=".dng")
    write_bracket(tmp_path / "photos", disc(), TIMES, suffix=".jpg")
    shoot, notes = run(tmp_path / "photos")
    assert [path.suffix for path in shoot.views[0].bracket.images] == [".dng"] * 4
    assert "4 beside a raw file of the same name" in text_of(notes, "skipped-files")
    shoot, _ = run(tmp_path / "photos", only="*.JPG")
    assert [path.suffix for path in shoot.views[0].bracket.images] == [".jpg"] * 4


def test_hidden_and_other_files_are_passed_over_and_told(tmp_path):
    directory = shoot_folder(tmp_path / "photos")
    for name in (".DS_Store", "a/._IMG_1.tif", "a/notes.txt", "b/making_of.MOV"):
        (directory / name).write_bytes(b"?")
    (directory / ".thumbnails").mkdir()
    write_photo(directory / "renders" / "preview.png", disc())
    shoot, notes = run(directory)
    assert len(shoot.views) == 3
    assert text_of(notes, "skipped-files") == "not used: 1 .mov, 1 .txt, 2 hidden"
    assert "none of its 1 pictures tells an exposure time" in text_of(notes, "skipped-folder")


def test_names_with_spaces_and_signs_survive(tmp_path):
    directory = tmp_path / "Küche 2@night"
    write_bracket(directory / "left side", disc(), TIMES)
    write_bracket(directory / "right, side", disc(), TIMES)
    shoot, _ = run(directory)
    assert [view.name for view in shoot.views] == ["left_side", "right__side"]
    assert all(path.is_file() for view in shoot.views for path in view.bracket.images)
    assert shoot.session == "Küche 2@night"


def test_views_whose_names_fall_together_are_refused(tmp_path):
    directory = shoot_folder(tmp_path / "photos", ("a b", "a-b"))
    refused(directory, UsageError, 'the views "a b" and "a-b" would both be called a_b; rename one')


# --- exposures.csv -----------------------------------------------------------------------------


def test_table_tells_what_pictures_do_not(tmp_path):
    directory = tmp_path / "photos"
    untold = {"time": None, "iso": None, "f_number": None}
    for index in range(4):
        write_photo(directory / f"{index}.png", disc() * 0.2 * (index + 1), **untold)
    (directory / "exposures.csv").write_text(
        "File;Time;ISO;FNumber;ND;View\n"
        "0.png;1/60;200;5.6;;left\n1.png;1/15;200;5.6;2;left\n\n"
        "2.png;0.5;100;8;;right\n3.png;2;100;8;;right\n",
        encoding="utf-8-sig",
    )
    shoot, _ = run(directory)
    left, right = shoot.views
    assert (left.name, right.name) == ("left", "right")
    np.testing.assert_allclose(left.bracket.exposure_time_s, (1 / 60, 1 / 15))
    np.testing.assert_array_equal(left.bracket.nd_factor, (1.0, 2.0))
    np.testing.assert_array_equal(right.bracket.f_number, 8.0)


def test_table_wins_over_exif_and_says_so(tmp_path):
    directory = tmp_path / "photos"
    write_bracket(directory, disc(), TIMES)
    (directory / "exposures.csv").write_text("file,time\nIMG_1.tif,1/500\nIMG_2.tif,1/60\n")
    shoot, notes = run(directory)
    assert shoot.views[0].bracket.exposure_time_s[0] == 1 / 500
    assert text_of(notes, "table-over-exif") == (
        "exposures.csv says time 0.002 and EXIF 0.004; the table is used"
    )


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("name,time\n", 'exposures.csv: has a column "name"; name the columns file,time,iso'),
        ("time,iso\n", 'has no column "file"'),
        ("file,time\nIMG_1.tif,1/0\n", 'line 2: time is "1/0"; give a number above 0'),
        ("file,time\nIMG_1.tif,fast\n", 'line 2: time is "fast"'),
        ("file,nd\nIMG_1.tif,0.5\n", 'line 2: nd is "0.5"; give 1 or more'),
        ("file,time\nIMG_9.tif,1\n", "line 2: there is no IMG_9.tif in"),
        ("file,time\nIMG_1.tif,1\nIMG_1.tif,2\n", "line 3: IMG_1.tif has a line already"),
        ("file,view\nIMG_1.tif,a\n", "names the views of some photographs but not of IMG_2.tif"),
    ],
)
def test_bad_table_is_refused_with_its_line(tmp_path, text, message):
    write_bracket(tmp_path / "photos", disc(), TIMES)
    (tmp_path / "photos" / "exposures.csv").write_text(text)
    with pytest.raises(LayerError, match=message):
        run(tmp_path / "photos")


# --- What the pictures tell --------------------------------------------------------------------


def test_missing_exposure_is_told_with_its_view(tmp_path):
    directory = shoot_folder(tmp_path / "photos")
    (directory / "b" / "IMG_2.tif").unlink()
    _, notes = run(directory)
    note = next(note for note in notes if note.code == "exposure-missing")
    assert (note.path, note.message) == (
        "b",
        "lacks the exposure 1/60 s f/8 ISO 100 that other views have",
    )


def test_clipped_lamp_is_told_while_it_can_still_be_photographed(tmp_path):
    light = disc()
    light[20:22, 40:43] = 1e4
    write_bracket(tmp_path / "photos", light, TIMES)
    _, notes = run(tmp_path / "photos")
    share = f"{6 / 4800:.2%}".replace("%", " %")
    assert f"{share} of the pixels are saturated even in IMG_1.tif, 1/250 s f/8 ISO 100" in (
        text_of(notes, "lamp-clipped")
    )


def test_black_view_is_told(tmp_path):
    directory = shoot_folder(tmp_path / "photos")
    write_bracket(directory / "c", 0.0 * disc(), TIMES)
    _, notes = run(directory)
    assert [note.path for note in notes if note.code == "black-view"] == ["c"]


def test_levels_of_a_sensor_in_wider_files_are_told(tmp_path):
    """14-bit raw values with a pedestal, stored in 16 bits as they are."""
    for index, time in enumerate((0.2, 0.8, 3.2, 12.8), start=1):
        raw = np.minimum(512.0 + 15871.0 * disc() * time, 16383.0) / 65535.0
        write_photo(tmp_path / "photos" / f"{index}.tif", raw, time=time, iso=100, f_number=8)
    _, notes = run(tmp_path / "photos")
    assert "end at the raw value 16383, below the white level 65535" in text_of(
        notes, "white-level"
    )
    assert "state --black-level 512" in text_of(notes, "black-level")
    _, notes = run(tmp_path / "photos", black_level=512.0, white_level=16383.0)
    assert not {"white-level", "black-level"} & codes(notes)


def test_camera_on_its_side_turns_the_views_not_the_pixels(tmp_path):
    shoot, notes = run(shoot_folder(tmp_path / "photos", orientation=6), views="0,120,up")
    np.testing.assert_allclose(shoot.views[0].rotation @ (0, 1, 0), (1, 0, 0), atol=1e-12)
    np.testing.assert_allclose(shoot.views[2].rotation @ (0, 0, -1), (0, 1, 0), atol=1e-12)
    assert "EXIF orientation is 6 in 8 of 8 pictures" in text_of(notes, "orientation")


def test_camera_that_looks_up_has_no_say_in_how_it_is_mounted(tmp_path):
    directory = shoot_folder(tmp_path / "photos", ("a", "b"))
    write_bracket(directory / "up", disc(), TIMES, orientation=8)
    shoot, notes = run(directory, views="0,180,up")
    np.testing.assert_allclose(shoot.views[0].rotation, np.eye(3), atol=1e-12)
    assert "orientation" not in codes(notes)


def test_automatic_white_balance_and_apertures_are_told(tmp_path):
    directory = tmp_path / "photos"
    write_bracket(directory, disc(), TIMES[:2], suffix=".jpg", white_balance=0)
    write_bracket(directory, disc(), TIMES[2:], None, ".jpg", 3, white_balance=0, f_number=11.0)
    shoot, notes = run(directory)
    assert shoot.white_balance == "auto"
    assert {"auto-white-balance", "aperture-changes"} <= codes(notes)


# --- What cannot be used -----------------------------------------------------------------------


def refused(directory, kind, message, **options):
    """Check that a folder is refused in one line, and nothing is written."""
    with pytest.raises(kind, match=message) as caught:
        run(directory, **options)
    assert "\n" not in str(caught.value)
    assert not (directory.parent / "shoot.usda").exists()


def test_pictures_without_exif_are_refused_with_the_way_out(tmp_path):
    directory = shoot_folder(tmp_path / "photos", time=None)
    message = (
        r"12 of 12 photographs do not tell their exposure time \(a.IMG_1.tif, a.IMG_2.tif, "
        r"a.IMG_3.tif and 9 more\); state each in exposures.csv \(columns file,time,iso,fnumber,nd"
    )
    refused(directory, ImageError, message)


def test_pictures_without_an_f_number_take_the_one_that_is_stated(tmp_path):
    directory = shoot_folder(tmp_path / "photos", f_number=0)
    refused(
        directory,
        ImageError,
        "their f-number .*; state one for all with --f-number, or each in exposures.csv",
    )
    shoot, _ = run(directory, f_number=5.6)
    np.testing.assert_array_equal(shoot.views[0].bracket.f_number, 5.6)


@pytest.mark.parametrize("time", [0.0, -1.0])
def test_impossible_exposure_is_refused_unless_the_table_mends_it(tmp_path, time):
    directory = tmp_path / "photos"
    write_bracket(directory, disc(), TIMES, suffix=".exr")
    untrue = {"time": time, "iso": 100, "f_number": 8.0}
    write_photo(directory / "IMG_5.exr", disc(), BEGAN + timedelta(seconds=8), **untrue)
    refused(directory, ImageError, f"IMG_5.exr: states the exposure time {time:g}, which cannot be")
    (directory / "exposures.csv").write_text("file,time\nIMG_5.exr,1\n")
    shoot, _ = run(directory)
    assert shoot.views[0].bracket.exposure_time_s[-1] == 1.0


@pytest.mark.parametrize(
    ("told", "what"), [({"model": "Nikon Z 6"}, "camera"), ({"lens": "Fish 10mm"}, "lens")]
)
def test_two_cameras_or_lenses_are_refused(tmp_path, told, what):
    directory = shoot_folder(tmp_path / "photos")
    write_bracket(directory / "b", disc(), TIMES[:1], **told)
    message = rf"b.IMG_1.tif: was taken with the {what} .* \(1 photographs\), but .*a shoot has one"
    refused(directory, ImageError, message)


def test_two_sizes_in_a_view_are_refused(tmp_path):
    directory = shoot_folder(tmp_path / "photos")
    write_bracket(directory / "b", disc(30, 40), TIMES[:1])
    refused(
        directory, ImageError, r"IMG_2.tif: has 80 x 60 pixels, but .*IMG_1.tif of the same view"
    )


def test_two_kinds_in_a_view_are_refused(tmp_path):
    directory = shoot_folder(tmp_path / "photos")
    write_bracket(directory / "b", disc(), TIMES, suffix=".exr", first=5)
    refused(
        directory,
        ImageError,
        "holds 16-bit values, but .*IMG_5.exr of the same view floating-point",
    )


def test_views_of_another_aspect_ratio_are_refused(tmp_path):
    directory = shoot_folder(tmp_path / "photos")
    write_bracket(directory / "d", disc(60, 60), TIMES)
    refused(directory, LayerError, "60 x 60 pixels, but fisheye:resolution is 80 x 60")


@pytest.mark.parametrize("suffix", [".tif", ".jpg", ".png", ".exr", ".dng"])
def test_picture_that_was_cut_short_is_refused_by_name(tmp_path, suffix):
    light = (
        disc()[..., 0]
        if suffix == ".dng"
        else disc() + 0.1 * np.random.default_rng(0).random((60, 80, 3))
    )
    if suffix == ".dng":
        pytest.importorskip("rawpy")
    paths = write_bracket(tmp_path / "photos", light, TIMES, suffix=suffix)
    whole = paths[2].read_bytes()
    paths[2].write_bytes(whole[: len(whole) * 2 // 3])
    refused(tmp_path / "photos", ImageError, f"IMG_3{suffix}: ")


def test_raw_files_without_rawpy_say_what_to_install(tmp_path, monkeypatch):
    monkeypatch.setitem(sys.modules, "rawpy", None)
    write_bracket(tmp_path / "photos", disc()[..., 0], TIMES, suffix=".dng")
    refused(tmp_path / "photos", UsageError, r"IMG_1.dng: raw .* `pip install 'usdskin\[raw\]'`")


def test_mirrored_picture_is_refused(tmp_path):
    directory = shoot_folder(tmp_path / "photos", orientation=2)
    refused(directory, ImageError, "orientation 2 says it is stored mirrored")


def test_number_of_directions_must_be_that_of_the_views(tmp_path):
    directory = shoot_folder(tmp_path / "photos")
    message = (
        r"--views 0,180: names 2 views, but .* holds 3: a with 4, b with 4, c with 4 photographs"
    )
    refused(directory, UsageError, message, views="0,180")


def test_photographs_beside_folders_of_photographs_are_refused(tmp_path):
    directory = shoot_folder(tmp_path / "photos")
    write_photo(directory / "snapshot.jpg", disc(), time=1, iso=100, f_number=8)
    refused(directory, UsageError, "has 1 photographs itself and more in its folder a")


def test_folder_without_photographs_is_refused(tmp_path):
    refused(tmp_path / "none", UsageError, "does not exist; name the folder")
    (tmp_path / "photos").mkdir()
    refused(tmp_path / "photos", UsageError, "has no photographs")
    shoot_folder(tmp_path / "photos")
    refused(tmp_path / "photos", UsageError, r"no photograph fits --only \*.cr2", only="*.cr2")


def test_projection_that_does_not_reach_the_field_is_refused(tmp_path):
    directory = shoot_folder(tmp_path / "photos")
    options = {"projection": "orthographic", "field_deg": 200.0}
    refused(
        directory, LayerError, "--projection orthographic --fov 200: .*stops growing", **options
    )


def test_layer_without_a_lens_is_refused(tmp_path):
    directory = shoot_folder(tmp_path / "photos")
    stage = Usd.Stage.CreateInMemory()
    stage.SetDefaultPrim(stage.DefinePrim("/Lens", "Camera"))
    write_layer(stage, tmp_path / "lens.usda")
    message = "default prim is no Camera with FisheyeCameraAPI"
    refused(directory, LayerError, message, lens=tmp_path / "lens.usda")


def test_inputs_are_never_overwritten(tmp_path):
    lens = lens_layer(
        tmp_path / "lens.usda", FisheyeLens("equidistant", 17.0, np.array([40.0, 30.0]), (80, 60))
    )
    before = lens.read_bytes()
    directory = shoot_folder(tmp_path / "photos")
    with pytest.raises(UsageError, match="is an input of this ingest"):
        ingest(directory, lens, IngestOptions(lens=lens))
    with pytest.raises(UsageError, match="end its name in"):
        ingest(directory, directory / "a" / "IMG_1.tif")
    assert lens.read_bytes() == before


# --- The command -------------------------------------------------------------------------------


@pytest.fixture
def command(capsys):
    """Return a function that runs ``usdskin ingest`` and gives exit code, stdout and stderr."""

    def run_command(*arguments):
        capsys.readouterr()
        code = main(["ingest", *map(str, arguments)])
        captured = capsys.readouterr()
        return code, captured.out, captured.err

    return run_command


def test_command_says_what_it_understood_and_prints_the_path(tmp_path, command):
    directory = shoot_folder(tmp_path / "photos")
    output = tmp_path / "shoot.usda"
    code, out, err = command(directory, "-o", output, "--views", "0,120,up")
    assert (code, out) == (0, f"{output}\n")
    rows = [line.split() for line in err.splitlines()]
    assert "a 0 4 1/250 s .. 1/4 s 6 f/8 100 0 .. 0".split() in rows
    assert "c up 4 1/250 s .. 1/4 s 6 f/8 100 0 .. 0".split() in rows
    assert re.search(r"camera: Nikon D850\n +lens: Fish 8mm", err)


def test_dry_run_writes_nothing(tmp_path, command):
    directory = shoot_folder(tmp_path / "photos")
    before = sorted(tmp_path.rglob("*"))
    code, out, _ = command(directory, "--dry-run")
    assert code == 0 and "views (3)" in out
    assert sorted(tmp_path.rglob("*")) == before


def test_json_tells_the_views(tmp_path, command):
    directory = shoot_folder(tmp_path / "photos")
    code, out, _ = command(directory, "-o", tmp_path / "shoot.usda", "--json")
    events = [json.loads(line) for line in out.splitlines()]
    shoot = next(event for event in events if event["event"] == "shoot")
    assert code == 0 and [row["images"] for row in shoot["views"]] == [4, 4, 4]
    assert events[-1] == {"event": "wrote", "path": str(tmp_path / "shoot.usda")}


@pytest.mark.parametrize(
    ("arguments", "code", "message"),
    [
        ((), 2, "missing option -o SHOOT.usda"),
        (("-o", "s.usda", "--lens", "l.usda", "--fov", "180"), 2, "--lens tells the projection"),
        (("-o", "s.usda", "--illuminance", "350"), 2, "give the reading and its direction"),
        (("-o", "s.usda", "--luminance", "x@up"), 2, "give the reading and its direction"),
        (("-o", "s.txt"), 2, "end its name in .usda"),
        (("-o", "s.usda", "--lens", "none.usda"), 3, "none.usda: no such file"),
    ],
)
def test_wrong_options_are_refused_in_one_line(tmp_path, command, arguments, code, message):
    directory = shoot_folder(tmp_path / "photos", ("a",))
    found, out, err = command(directory, *arguments, "-q")
    assert (found, out) == (code, "")
    assert message in err and len(err.splitlines()) == 1
