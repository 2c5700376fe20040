import cv2
import numpy as np
import pytest

from usdskin.capture.lens.calibrate import import_lens
from usdskin.capture.lens.curve import IDEAL
from usdskin.capture.lens.files import ImportOptions
from usdskin.capture.lens.hugin import read_hugin
from usdskin.capture.lens.lensfun import LensfunChoice, read_lensfun
from usdskin.errors import UsageError, UsdSkinError
from usdskin.fisheye import project, vignetting
from usdskin.layers import open_stage
from usdskin.prims import read_lens
from usdskin.validate import validate

SIZE = (2000, 1500)
F, K = 620.0, np.array([-0.02, 0.004, -0.003, 0.0004])


def imported(source, tmp_path, notes=None, **given):
    choice = LensfunChoice(**given.pop("choice", {}))
    path = import_lens(
        source, tmp_path / "lens.usda", ImportOptions(choice=choice, **given), notes=notes
    )
    assert validate(path) == []
    stage = open_stage(path)
    return read_lens(stage.GetDefaultPrim())


def codes(notes):
    return [note.code for note in notes]


def opencv_file(folder, suffix, **values):
    path = folder / f"camera{suffix}"
    storage = cv2.FileStorage(str(path), cv2.FILE_STORAGE_WRITE)
    for name, value in values.items():
        storage.write(name, value)
    storage.release()
    return path


MATRIX = np.array([[F, 0.0, 1002.7], [0.0, F, 747.9], [0.0, 0.0, 1.0]])
FISHEYE_FILE = {
    "image_width": SIZE[0],
    "image_height": SIZE[1],
    "fisheye_model": 1,
    "camera_matrix": MATRIX,
    "distortion_coefficients": K[:, None],
}


@pytest.mark.parametrize("suffix", [".yml", ".xml", ".json"])
def test_opencvs_own_files_are_taken_as_they_are(tmp_path, suffix):
    notes = []
    lens = imported(
        opencv_file(tmp_path, suffix, **FISHEYE_FILE), tmp_path, notes, max_angle_deg=85.0
    )
    assert lens.focal_length_px == F and lens.resolution == SIZE and not notes
    np.testing.assert_array_equal(lens.distortion, K)
    np.testing.assert_allclose(lens.center_px, [1003.2, 748.4], rtol=1e-15)


ROS = f"""\
image_width: 2000
image_height: 1500
camera_name: front
camera_matrix:
  rows: 3
  cols: 3
  data: [{F}, 0.0, 1002.7, 0.0, {F}, 747.9, 0.0, 0.0, 1.0]
distortion_model: equidistant
distortion_coefficients:
  rows: 1
  cols: 4
  data: [-0.02, 0.004, -0.003, 0.0004]
"""
KALIBR = f"""\
cam0:
  cam_overlaps: []
  camera_model: pinhole
  distortion_coeffs: [-0.02, 0.004, -0.003, 0.0004]
  distortion_model: equidistant
  intrinsics: [{F}, {F}, 1002.7, 747.9]
  resolution: [2000, 1500]
  rostopic: /cam0/image_raw
"""


@pytest.mark.parametrize("text", [ROS, KALIBR])
def test_files_of_ros_and_kalibr_say_the_same(tmp_path, text):
    (tmp_path / "camera.yaml").write_text(text)
    lens = imported(tmp_path / "camera.yaml", tmp_path, max_angle_deg=85.0)
    assert lens.focal_length_px == F and lens.resolution == SIZE
    np.testing.assert_array_equal(lens.distortion, K)


def test_an_omnidirectional_camera_of_opencv_becomes_the_nearest_polynomial(tmp_path):
    xi, distortion = 0.9, np.array([[-0.05, 0.01, 0.0, 0.0]])
    matrix = np.array([[1150.0, 0.0, 1002.7], [0.0, 1150.0, 747.9], [0.0, 0.0, 1.0]])
    path = opencv_file(tmp_path, ".yml", camera_matrix=matrix, xi=xi, D=distortion)
    notes = []
    choice = {"resolution": SIZE}
    lens = imported(path, tmp_path, notes, max_angle_deg=95.0, choice=choice)
    phi = np.radians(np.linspace(1.0, 94.9, 50))
    rays = np.column_stack([np.sin(phi), np.zeros(50), np.cos(phi)])
    pixels, _ = cv2.omnidir.projectPoints(
        rays[:, None], np.zeros(3), np.zeros(3), matrix, xi, distortion
    )
    off = np.abs(project(lens, rays * [1.0, -1.0, -1.0]) - pixels[:, 0] - 0.5).max()
    told = float(notes[0].message.split("height to ")[1].split(" px")[0])
    assert codes(notes) == ["lens-fitted"] and 0.5 * told < off < 1.1 * told < 0.1


@pytest.mark.parametrize(
    ("changes", "given", "reason"),
    [
        ({"fisheye_model": 0}, {}, "4 distortion coefficients are not those of a fisheye"),
        ({"fisheye_model": None}, {}, "does not say which model .* --model fisheye"),
        ({"distortion_coefficients": np.zeros((5, 1))}, {}, "5 distortion coefficients"),
        ({"distortion_coefficients": np.full((4, 1), np.nan)}, {}, "not finite"),
        ({"distortion_coefficients": None}, {}, "has no distortion_coefficients"),
        ({"image_width": None}, {}, "--resolution"),
        ({"camera_matrix": np.diag([F, -F, 1.0])}, {}, "fy -620"),
        ({"camera_matrix": np.diag([F, 1.02 * F, 1.0])}, {}, "cannot .* not radial"),
        ({"distortion_coefficients": -0.4 * np.eye(4)[:, :1]}, {"max_angle_deg": 80.0}, "stops g"),
        ({}, {"choice": {"f_number": 4.0}}, "--f-number has no effect"),
        ({}, {"choice": {"resolution": (200, 150)}}, "says that the pictures have 2000 x 1500"),
        ({}, {"model": "omnidir"}, "has no xi"),
        ({"xi": 1.1}, {"model": "fisheye"}, "has xi"),
        ({"xi": "large"}, {}, "'large'.*no number"),
        ({"image_width": "wide"}, {}, "--resolution"),
    ],
)  # fmt: skip
def test_opencv_files_that_cannot_be_taken(tmp_path, changes, given, reason):
    values = {n: v for n, v in {**FISHEYE_FILE, **changes}.items() if v is not None}
    with pytest.raises(UsdSkinError, match=reason):
        imported(opencv_file(tmp_path, ".yml", **values), tmp_path, **given)


def test_slightly_unequal_focal_lengths_are_averaged_and_told(tmp_path):
    values = {**FISHEYE_FILE, "camera_matrix": MATRIX + np.diag([0.0, 0.6, 0.0])}
    notes = []
    lens = imported(opencv_file(tmp_path, ".yml", **values), tmp_path, notes, max_angle_deg=80.0)
    assert lens.focal_length_px == F + 0.3
    assert "moves points by up to 0.4 px" in notes[0].message


PTO = """\
# hugin project file
#hugin_ptoversion 2
p f2 w36000 h18000 v360  k0 E0 R0 n"TIFF_m c:LZW"
m i0

# image lines
i w{w} h{h} f{f} v{v} Ra0 Rb0 Eev0 Er1 Eb1 r3 p-2 y40 TrX0 TrY0 TrZ0 Tpy0 Tpp0 j0 {abc} {de} \
g0 t0 Va1 {vig} Vx0 Vy0  Vm5 {s} n"a b1.jpg"
i w{w} h{h} f{f} v=0 r0 p0 y120 a=0 b=0 c=0 d=0 e=0 g=0 t=0 Va=0 Vb=0 Vc=0 Vd=0 Vx=0 Vy=0  Vm5 \
{s} n"img 2.jpg"
v
"""


def project_file(folder, **given):
    values = {
        "w": 4000, "h": 3000, "f": 3, "v": 180, "abc": "a0 b0 c0", "de": "d0 e0",
        "vig": "Vb0 Vc0 Vd0", "s": "", **given,
    }  # fmt: skip
    path = folder / "project.pto"
    path.write_text(PTO.format(**values))
    return path


@pytest.mark.parametrize(
    ("given", "pixel"),
    [
        # Where `pano_trafo -r` of Hugin 2022.0 puts a point 55 deg right of the axis (+ 0.5).
        ({}, (3222.2222, 1500.0)),
        ({"v": 170, "abc": "a0.01 b-0.03 c0.02", "de": "d12.5 e-7.25"}, (3308.3604, 1492.75)),
        ({"f": 2, "v": 195, "abc": "a0.01 b-0.03 c0.02"}, (3130.8297, 1500.0)),
        (
            {"f": 10, "v": 170, "w": 3000, "h": 4000, "abc": "a0 b-0.05 c0", "de": "d5 e9"},
            (2386.0053, 2009.0),
        ),
        ({"f": 21, "v": 175, "abc": "a0.02 b-0.03 c0.02", "de": "d3 e0"}, (3335.9904, 1500.0)),
        ({"f": 8, "v": 150, "abc": "a0 b-0.03 c0", "de": "d3 e0"}, (3684.9236, 1500.0)),
        ({"f": 20, "v": 150, "abc": "a0.01 b-0.01 c0", "de": "d3 e0"}, (3577.3535, 1500.0)),
    ],
)  # fmt: skip
def test_hugin_lenses_are_where_hugin_has_them(tmp_path, given, pixel):
    notes = []
    path = project_file(tmp_path, **given)
    read = read_hugin(path, None)
    across = read.center_px[0] + read.radius(np.radians([55.0]))[0]
    np.testing.assert_allclose([across, read.center_px[1]], pixel, atol=1e-4)
    lens = imported(path, tmp_path, notes, max_angle_deg=75.0)
    ray = [np.sin(np.radians(55.0)), 0.0, -np.cos(np.radians(55.0))]
    told = float(notes[0].message.split("height to ")[1].split(" px")[0]) if notes else 0.0
    np.testing.assert_allclose(project(lens, ray), pixel, atol=1.1 * told + 1e-4)
    assert (lens.projection == "opencv") == ("abc" in given)


def test_hugins_vignetting_counts_from_the_diagonal(tmp_path):
    notes = []
    path = project_file(tmp_path, vig="Vb-0.3 Vc0.1 Vd-0.05")
    lens = imported(path, tmp_path, notes, max_angle_deg=90.0)
    phi = np.radians(np.linspace(0.0, 90.0, 19))
    r = 4000 / np.pi * phi / 2500.0
    np.testing.assert_allclose(vignetting(lens, phi), 1 - 0.3 * r**2 + 0.1 * r**4 - 0.05 * r**6)
    assert codes(notes) == ["vignetting-fitted"]


def test_a_circular_crop_is_the_largest_angle(tmp_path):
    notes = []
    lens = imported(project_file(tmp_path, f=2, s="S800,3200,300,2700"), tmp_path, notes)
    assert lens.max_angle_deg == pytest.approx(1200 * 180 / 4000, abs=0.01)
    assert codes(notes) == ["max-angle-assumed"]


@pytest.mark.parametrize(
    ("given", "reason"),
    [
        ({"f": 0}, "f0 is rectilinear"),
        ({"f": 4}, "f4 is equirectangular"),
        ({"f": 8, "v": 190}, "190 deg make no orthographic"),
        ({"abc": "a0 b0 c0 TiX3"}, "TiX is 3"),
        ({"v": "1e999"}, "v is '1e999', which is no number"),
        ({"w": 0}, "0 x 3000 pixels"),
        ({"abc": "a0.5 b-2.5 c0"}, "image height of this lens stops growing"),
    ],
)
def test_hugin_lenses_that_cannot_be_taken(tmp_path, given, reason):
    with pytest.raises(UsdSkinError, match=reason):
        imported(project_file(tmp_path, **given), tmp_path, max_angle_deg=85.0)


def test_a_project_with_two_lenses_asks_which(tmp_path):
    path = project_file(tmp_path)
    path.write_text(path.read_text().replace("v=0", "v170"))
    with pytest.raises(UsageError, match=r"images 0 and 1 have different lenses; .* --lens 0"):
        imported(path, tmp_path)
    lens = imported(path, tmp_path, choice={"lens": "1"})
    assert lens.focal_length_px == pytest.approx(4000 / np.radians(170.0))
    with pytest.raises(UsageError, match="--lens 7: the project has images 0 to 1"):
        imported(path, tmp_path, choice={"lens": "7"})


DATABASE = """\
<lensdatabase>
  <lens><maker>Maker</maker><model>Test 8mm f/3.5 Fisheye</model><mount>Test</mount>
    <focal value="8"/><type>fisheye</type><cropfactor>1.5</cropfactor>
    <calibration>
      <distortion model="ptlens" focal="8" a="0.012" b="-0.035" c="0.02"/>
      <vignetting model="pa" focal="8" aperture="3.5" distance="1" k1="-0.9" k2="0" k3="0"/>
      <vignetting model="pa" focal="8" aperture="3.5" distance="1000"
        k1="-0.5" k2="0.2" k3="-0.05"/>
    </calibration></lens>
  <lens><maker>Maker</maker><model>Test 10mm f/4 Equisolid</model><mount>Test</mount>
    <focal value="10"/><type>equisolid</type><cropfactor>1.5</cropfactor>
    <aspect-ratio>4:3</aspect-ratio>
    <calibration><distortion model="poly3" focal="10" k1="-0.03"/></calibration></lens>
  <lens><maker>Maker</maker><model>Test 12mm f/4 Stereographic</model><mount>Test</mount>
    <focal value="12"/><type>stereographic</type><cropfactor>1.5</cropfactor>
    <calibration><distortion model="poly5" focal="12" k1="-0.03" k2="0.01"/></calibration></lens>
  <lens><maker>Maker</maker><model>Test 15mm Adobe</model><mount>Test</mount>
    <focal value="15"/><type>fisheye</type><cropfactor>1</cropfactor>
    <calibration><distortion model="acm" focal="15" k1="-0.03" k2="0.002" k3="0.0001"/>
    </calibration></lens>
  <lens><maker>Maker</maker><model>Test 8-16mm Zoom</model><mount>Test</mount>
    <focal min="8" max="16"/><type>fisheye</type><cropfactor>1.5</cropfactor>
    <calibration><distortion model="none" focal="8" real-focal="8.2"/>
    <distortion model="ptlens" focal="16" a="0" b="0" c="-0.1" real-focal="15"/>
    </calibration></lens>
  <lens><maker>Maker</maker><model>Test 35mm</model><mount>Test</mount>
    <focal value="35"/><cropfactor>1</cropfactor></lens>
</lensdatabase>
"""
INVERSE = {
    "8mm": lambda y: y,
    "10mm": lambda y: 2.0 * np.arcsin(0.5 * y),
    "12mm": lambda y: 2.0 * np.arctan(0.5 * y),
}


@pytest.fixture
def database(tmp_path):
    (tmp_path / "test.xml").write_text(DATABASE)
    return tmp_path / "test.xml"


@pytest.mark.parametrize(
    ("name", "crop", "distorted"),
    [
        # Lensfun 0.3.4 (lensfunpy 1.18): 6001 x 4001 px, undistorted 600, 1800, 2900 px.
        ("8mm", 1.5, (603.7043, 1802.5161, 2885.4883)),
        ("8mm", 1.6, (603.6741, 1803.8989, 2887.3989)),
        ("10mm", 1.5, (616.6155, 1816.6152, 2830.6602)),
        ("10mm", 1.6, (616.7832, 1821.1426, 2849.5918)),
        ("12mm", 1.5, (598.4287, 1768.0698, 2845.2773)),
        ("12mm", 1.6, (598.6138, 1770.6792, 2838.2603)),
    ],
)
def test_lensfun_distortions_are_those_of_lensfun(database, name, crop, distorted):
    lens = read_lensfun(database, LensfunChoice(name, (6001, 4001), crop), [])
    px_per_mm = np.hypot(6001, 4001) * crop / np.hypot(36.0, 24.0)
    ideal = np.array([600.0, 1800.0, 2900.0]) / (px_per_mm * float(name[:-2]))
    # Lensfun scales by width - 1, in single precision.
    np.testing.assert_allclose(lens.radius(INVERSE[name](ideal)), distorted, rtol=3e-5)


def test_lensfuns_vignetting_is_that_of_the_farthest_distance(database, tmp_path):
    choice = {"lens": "8mm", "resolution": (6001, 4001), "f_number": 3.5}
    read = read_lensfun(database, LensfunChoice(**choice), [])
    # Lensfun 0.3.4, at 600, 1800 and 2900 px from the middle.
    found = read.vignetting(np.array([600.0, 1800.0, 2900.0]))
    np.testing.assert_allclose(found, [0.98632, 0.88705, 0.74672], rtol=1e-4)
    notes = []
    lens = imported(database, tmp_path, notes, max_angle_deg=80.0, choice=choice)
    phi = np.radians(np.linspace(0.0, 80.0, 9))
    np.testing.assert_allclose(vignetting(lens, phi), read.vignetting(read.radius(phi)), rtol=2e-3)
    assert codes(notes) == ["lens-fitted", "vignetting-fitted"]


def test_adobes_fisheye_model_is_opencvs(database, tmp_path):
    choice = {"lens": "adobe", "resolution": (6000, 4000)}
    notes = []
    lens = imported(database, tmp_path, notes, max_angle_deg=80.0, choice=choice)
    np.testing.assert_allclose(lens.distortion, [-0.03, 0.002, 0.0001, 0.0], atol=1e-9)
    assert lens.focal_length_px == pytest.approx(15.0 * 6000 / 36.0) and not notes


def test_a_real_focal_length_is_the_slope_on_the_axis(database, tmp_path):
    choice = {"lens": "zoom", "resolution": (6000, 4000), "focal_length_mm": 8.0}
    lens = imported(database, tmp_path, max_angle_deg=60.0, choice=choice)
    px_per_mm = np.hypot(6000, 4000) * 1.5 / np.hypot(36.0, 24.0)
    assert lens.projection == "equidistant"
    assert lens.focal_length_px == pytest.approx(8.2 * px_per_mm)
    choice["focal_length_mm"] = 16.0
    read = read_lensfun(database, LensfunChoice(**choice), [])
    assert read.radius(np.array([1e-6]))[0] / 1e-6 == pytest.approx(15.0 * px_per_mm, rel=1e-5)


@pytest.mark.parametrize(
    ("choice", "reason"),
    [
        ({"lens": "8mm"}, "--resolution"),
        ({"lens": "35mm", "resolution": SIZE}, "no fisheye lens '35mm'; --lens names one of"),
        ({"lens": "Test", "resolution": SIZE}, "several lenses fit"),
        ({"lens": "zoom", "resolution": SIZE}, "--focal-length 8, 16"),
        ({"lens": "zoom", "resolution": SIZE, "focal_length_mm": 10.0}, "only for 8, 16 mm"),
        ({"lens": "8mm", "resolution": SIZE, "crop_factor": 1.0}, "does not reach the edge"),
        ({"lens": "8mm", "resolution": SIZE, "f_number": 8.0}, "only for 3.5"),
    ],
)  # fmt: skip
def test_lensfun_choices_that_cannot_be_met(database, tmp_path, choice, reason):
    with pytest.raises(UsageError, match=reason):
        imported(database, tmp_path, choice=choice)


@pytest.mark.parametrize(
    ("name", "text"),
    [
        ("a.xml", "<lensdatabase><lens>"),
        ("a.xml", "<other/>"),
        ("a.yml", "%YAML:1.0\n---\nk: ["),
        ("a.json", '{"k":'),
        ("a.yaml", "\0\1garbage"),
        ("a.pto", "nothing"),
        ("a.txt", "nothing"),
        ("missing.pto", None),
    ],
)
def test_files_that_are_no_lens_end_in_one_line(tmp_path, name, text):
    if text is not None:
        (tmp_path / name).write_text(text)
    with pytest.raises(UsdSkinError) as caught:
        imported(tmp_path / name, tmp_path, choice={"resolution": SIZE} if "xml" in name else {})
    assert name in str(caught.value) and "\n" not in str(caught.value)


def test_the_ideal_projections_are_the_schemas():
    phi = np.linspace(0.0, 1.5, 16)
    assert {*IDEAL} == {"equidistant", "equisolid", "stereographic", "orthographic", "thoby"}
    np.testing.assert_allclose(IDEAL["thoby"](phi)[1] / phi[1], 1.47 * 0.713, rtol=2e-3)
