"""The virtual photographer against closed forms: what it says of light is what was there."""

from __future__ import annotations

import importlib
import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from click.testing import CliRunner

from usdskin.colorimetry import illuminant, xyz_to_rgb, xyz_weights
from usdskin.commands.photograph import photograph as command
from usdskin.commands.reporter import GlobalOptions
from usdskin.device import Workers
from usdskin.errors import LayerError, UsageError
from usdskin.images import Part, read_image, write_exr
from usdskin.judge.shoot import photographer
from usdskin.judge.shoot.environments import (
    Environment,
    LightDisc,
    LightMap,
    panorama,
    read_environment,
)
from usdskin.judge.shoot.optics import (
    Picture,
    inverse_projection,
    pixel_angles,
    radius_at,
    vignetting,
)
from usdskin.judge.shoot.photo_files import CURVES, KINDS
from usdskin.judge.shoot.photographer import Setup, add_glare, fisheye, photograph
from usdskin.judge.shoot.sensitivity import read_sensitivity
from usdskin.judge.shoot.sensor import Sensor, exposure_list, exposure_series
from usdskin.judge.shoot.setups import lens_of_layer
from usdskin.judge.shoot.shoot_layers import even_direction, luminance_weights, read_truth, spot
from usdskin.judge.shoot.viewpoints import THREE_LEVEL, rotation_about, rotation_of
from usdskin.latlong import latlong_coordinates, texel_directions, texel_solid_angles
from usdskin.layers import open_stage
from usdskin.prims import FisheyeLens, read_shoot, write_lens
from usdskin.render.lights import read_lights
from usdskin.validate import validate

# isort: split
# After ours, which register the schemas.
from pxr import Gf, Usd, UsdGeom, UsdLux

ROOM = Path(__file__).resolve().parents[1] / "stages" / "capture_room" / "room.usda"
ALONE = Workers("cpu", 1)
X, Y, Z = np.eye(3)
NO_VIGNETTING = ()
LENSES = {
    "equidistant": fisheye(240, "equidistant", 190.0),
    "equisolid": fisheye(240, "equisolid", 190.0),
    "stereographic": fisheye(240, "stereographic", 190.0),
    "orthographic": fisheye(240, "orthographic", 170.0),
    "opencv": FisheyeLens(
        projection="opencv",
        focal_length_px=70.0,
        center_px=np.array([121.3, 118.6]),
        resolution=(240, 236),
        distortion=np.array([0.03, -0.008, 0.0012, -0.0001]),
        max_angle_deg=92.0,
        vignetting=np.array([-0.05, 0.001]),
    ),
}


@pytest.fixture(scope="module")
def camera_file(tmp_path_factory):
    """Return a camera of three smooth curves; colour-science takes seconds to load."""
    nm = np.arange(400.0, 701.0, 10.0)
    curves = [np.exp(-0.5 * ((nm - middle) / 35.0) ** 2) for middle in (600.0, 540.0, 460.0)]
    path = tmp_path_factory.mktemp("camera") / "acme.csv"
    rows = zip(nm, *curves, strict=True)
    path.write_text(
        "nm,R,G,B\n" + "".join(f"{a:g},{r:.9e},{g:.9e},{b:.9e}\n" for a, r, g, b in rows)
    )
    return str(path)


def room(path: Path, *, lamps=(), dome=None, up="Y", intensity=1.0) -> Path:
    """Write a stage with an even dome, or one that shows a map, and round lamps."""
    stage = Usd.Stage.CreateNew(str(path))
    UsdGeom.SetStageUpAxis(stage, up)
    if dome is not False:
        light = UsdLux.DomeLight.Define(stage, "/Dome")
        light.CreateIntensityAttr(intensity)
        if dome is not None:
            light.CreateTextureFileAttr(str(dome))
    for index, (direction, angle) in enumerate(lamps):
        lamp = UsdLux.DistantLight.Define(stage, f"/Lamp{index}")
        lamp.CreateAngleAttr(angle)
        lamp.CreateNormalizeAttr(False)
        lamp.CreateIntensityAttr(1000.0)
        turn = Gf.Rotation(Gf.Vec3d(0, 0, 1), Gf.Vec3d(*map(float, direction)))
        UsdGeom.Xformable(lamp).AddOrientOp(UsdGeom.XformOp.PrecisionDouble).Set(turn.GetQuat())
    stage.GetRootLayer().Save()
    return path


def even(level=1.0) -> Environment:
    return Environment((LightMap(np.full((4, 8, 4), level, np.float32), np.eye(3)),))


def lamp_at(direction, half_deg=0.25, level=100.0) -> Environment:
    towards = np.asarray(direction, np.float64) / np.linalg.norm(direction)
    return Environment((), (LightDisc(np.full(4, level), towards, np.radians(half_deg)),))


def window(lens, angle, turn, size=24, focal_length_px=320.0):
    """Return a lens of finer pixels whose picture is cut to where a ray falls, and that place.

    Args:
        angle, turn: phi and psi of the ray [rad].
    """
    fine = replace(lens, focal_length_px=focal_length_px)
    away = radius_at(fine, np.array(angle)) * np.array([np.cos(turn), -np.sin(turn)])
    place = np.array([0.5 * size + 0.3, 0.5 * size - 0.1])
    return replace(fine, center_px=place - away, resolution=(size, size)), place


def ray(angle, turn):
    return np.array([np.sin(angle) * np.cos(turn), np.sin(angle) * np.sin(turn), -np.cos(angle)])


def draw(environment, lens, rotation=None):
    picture = Picture(environment, lens, np.eye(3) if rotation is None else rotation)
    return picture.draw(ALONE, lambda rows: None)


def middle_of(picture):
    """Return the centroid of a picture's light [px]."""
    level = picture.sum(axis=-1, dtype=np.float64)
    v, u = np.indices(level.shape) + 0.5
    return np.array([(u * level).sum(), (v * level).sum()]) / level.sum()


def solid_angles(lens):
    """Return the solid angle of every pixel [sr]: sin(phi) dphi / (r dr), NaN beyond the field."""
    angle = pixel_angles(lens, 0, lens.resolution[1])
    step = 1e-4
    rise = (radius_at(lens, angle + step) - radius_at(lens, angle - step)) / (2.0 * step)
    return np.sin(angle) / (radius_at(lens, angle) * rise)


def relative(photo: Path, setup: Setup):
    """Return (DN - black) / (white - black) of a photograph of raw values."""
    black, white = setup.sensor.black_level, setup.sensor.white_level
    return (np.rint(read_image(photo).pixels * 65535.0) - black) / (white - black)


# --- Lens --------------------------------------------------------------------------------------


@pytest.mark.parametrize("lens", LENSES.values(), ids=LENSES)
def test_image_height_and_angle_are_each_others_inverse(lens):
    angle = np.linspace(0.0, np.radians(lens.max_angle_deg), 2001)
    back = inverse_projection(lens)(radius_at(lens, angle))
    assert np.abs(back - angle).max() < 1e-11


@pytest.mark.parametrize("lens", LENSES.values(), ids=LENSES)
def test_pixels_fill_the_solid_angle_of_the_field(lens):
    within = pixel_angles(lens, 0, lens.resolution[1]) <= np.radians(lens.max_angle_deg)
    expected = 2.0 * np.pi * (1.0 - np.cos(np.radians(lens.max_angle_deg)))
    assert solid_angles(lens)[within].sum() == pytest.approx(expected, rel=4e-3)


def test_lens_that_folds_or_darkens_within_its_angle_is_refused():
    folds = replace(LENSES["opencv"], distortion=np.array([-0.4, 0.0, 0.0, 0.0]))
    with pytest.raises(UsageError, match=r"turns back .* at 5\d\.\d\d degrees cannot hold 92"):
        inverse_projection(folds)
    dark = replace(LENSES["equidistant"], vignetting=np.array([-0.5]))
    with pytest.raises(UsageError, match=r"grows dark at 81\.\d\d degrees"):
        inverse_projection(dark)
    with pytest.raises(UsageError, match="no orthographic lens holds 200"):
        fisheye(100, "orthographic", 200.0)


# --- Orientation -------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("direction", "aim"),
    [(-Z, (0.0, 0.0)), (X, (1.0, 0.0)), (Y, (0.0, -1.0)), (-X, (-1.0, 0.0)), (-Y, (0.0, 1.0))],
)
def test_lamp_is_seen_where_the_camera_convention_puts_it(direction, aim):
    # At 90 degrees from the axis: right for +X, up for +Y; the camera looks along -Z.
    lens = fisheye(120, "equidistant", 200.0)
    seen = middle_of(draw(lamp_at(direction, 3.0), lens))
    expected = lens.center_px + np.array(aim) * lens.focal_length_px * np.pi / 2.0
    assert np.abs(seen - expected).max() < 0.15  # of a lamp 3.6 px wide, its shade included
    assert not draw(lamp_at(Z), lens).any()


@pytest.mark.parametrize("name", LENSES)
def test_lamp_off_axis_is_seen_at_its_projected_place(name):
    angle, turn = np.radians(55.0), np.radians(130.0)
    lens, place = window(LENSES[name], angle, turn)
    assert np.abs(middle_of(draw(lamp_at(ray(angle, turn)), lens)) - place).max() < 0.02


@pytest.mark.parametrize(("u", "direction"), [(0.5, Z), (0.25, X), (0.0, -Z), (0.75, -X)])
def test_dome_map_is_seen_as_usd_lux_says(u, direction):
    values = np.zeros((64, 128, 4), np.float32)
    column = round(u * 128)
    values[31:33, [column - 1, column % 128]] = 1.0
    turned = rotation_of((-37.0, 12.0), np.eye(3))
    environment = Environment((LightMap(values, turned),))
    # A camera whose -Z is the lamp's direction in the turned world.
    towards = turned @ direction
    side = np.cross(Y, -towards)
    side /= np.linalg.norm(side)
    camera = np.column_stack([side, np.cross(-towards, side), -towards])
    lens = fisheye(200, vignetting=NO_VIGNETTING)
    assert np.abs(middle_of(draw(environment, lens, camera)) - 100.0).max() < 0.05


@pytest.mark.parametrize("up", ["Y", "Z"])
def test_views_stand_upright_in_the_stages_world(up):
    to_panorama = Environment((), (), up).panorama_from_world
    upward = Y if up == "Y" else Z
    ahead = rotation_of((0.0, 0.0), to_panorama)
    assert np.allclose(ahead @ Y, upward)
    zenith = rotation_of((0.0, 90.0), to_panorama)
    assert np.allclose(zenith @ -Z, upward)
    left = rotation_of((90.0, 0.0), to_panorama)
    assert np.allclose(np.cross(ahead @ -Z, left @ -Z), upward)


def test_panorama_shows_a_lamp_of_a_z_up_stage_at_its_pole():
    environment = replace(lamp_at(Z, 5.0), up_axis="Z")
    seen = panorama(environment, 90)
    assert seen[0].all()
    assert not seen[4:].any()
    # +Y of the world is behind the panorama's middle: -Z, at u = 0.
    environment = replace(lamp_at(Y, 5.0), up_axis="Z")
    rows, columns = np.nonzero(panorama(environment, 90)[..., 0])
    assert 42 <= rows.min() and rows.max() <= 47
    assert set(columns) <= {0, 1, 2, 177, 178, 179}


@pytest.mark.parametrize("half_angle_deg", [0.05, 0.2665, 3.0, 40.0])
@pytest.mark.parametrize("direction", [Y, (0.3, 0.67, -0.5), (0.0, 0.0, -1.0)])
def test_panorama_keeps_the_flux_and_the_place_of_a_disc(half_angle_deg, direction):
    direction = np.asarray(direction) / np.linalg.norm(direction)
    lamp = lamp_at(direction, half_angle_deg)
    seen = panorama(lamp, 90)[..., 0]
    flux = seen * texel_solid_angles(90, 180)[:, None]
    (disc,) = lamp.discs
    assert flux.sum() == pytest.approx(disc.solid_angle * disc.values[0], rel=1e-12)
    middle = np.einsum("ij,ijk->k", flux, texel_directions(90, 180))
    assert np.arccos(min(middle @ direction / np.linalg.norm(middle), 1.0)) < np.radians(1.5)
    inside = np.radians(half_angle_deg - 3.0)
    if inside > 0.0:
        covered = texel_directions(90, 180) @ direction > np.cos(inside)
        covered[:15] = covered[-15:] = False  # texels at the poles are small, and so noisy
        assert covered.any()
        assert np.allclose(seen[covered], disc.values[0], rtol=0.15)
        assert seen[covered].mean() == pytest.approx(disc.values[0], rel=2e-3)


def test_panorama_of_a_map_at_its_own_size_is_the_map():
    values = np.random.default_rng(3).random((32, 64, 4)).astype(np.float32)
    environment = Environment((LightMap(values, np.eye(3)),))
    assert np.abs(panorama(environment, 32) - values).max() < 1e-12
    finer = panorama(environment, 64, Workers("cpu", 2))
    assert np.abs(finer - values.repeat(2, 0).repeat(2, 1)).max() < 1e-12


# --- Flux --------------------------------------------------------------------------------------


@pytest.mark.parametrize("name", LENSES)
def test_small_lamp_keeps_its_flux_anywhere(name):
    rng = np.random.default_rng(11)
    # The pixels' solid angles change ever faster towards the edge of an orthographic picture.
    for tilt in np.radians([0.0, 20.0, 48.0, 58.0 if name == "orthographic" else 77.0]):
        turn = rng.uniform(0.0, 2.0 * np.pi)
        lens, _ = window(LENSES[name], tilt, turn)
        environment = lamp_at(ray(tilt, turn))
        shade = vignetting(lens, pixel_angles(lens, 0, 24) ** 2)
        flux = np.nansum(draw(environment, lens)[..., 0] / shade * solid_angles(lens))
        expected = 100.0 * environment.discs[0].solid_angle
        assert flux == pytest.approx(expected, rel=2e-3), (name, tilt)


def test_lamp_of_a_few_texels_keeps_its_flux():
    values = np.zeros((256, 512, 4), np.float32)
    values[100:102, 7:9] = 50.0
    lens = fisheye(240, vignetting=NO_VIGNETTING)
    area = 2.0 * (2.0 * np.pi / 512) * (np.cos(np.pi * 100 / 256) - np.cos(np.pi * 102 / 256))
    for azimuth in (0.0, 31.4):
        picture = draw(
            Environment((LightMap(values, np.eye(3)),)),
            lens,
            rotation_of((azimuth, 5.0), np.eye(3)),
        )
        flux = np.nansum(picture[..., 1] * solid_angles(lens))
        assert flux == pytest.approx(50.0 * area, rel=2e-3)


def test_light_adds_up():
    lens = LENSES["equisolid"]
    lamp = lamp_at([0.2, 0.1, -1.0], 3.0)
    both = Environment(even().maps, lamp.discs)
    total = draw(both, lens).sum(dtype=np.float64)
    assert total == pytest.approx(sum(draw(part, lens).sum() for part in (even(), lamp)), rel=1e-4)


def test_irradiance_has_its_closed_forms():
    assert even(2.0).irradiance(Y) == pytest.approx(2.0 * np.pi, rel=1e-4)
    half = np.radians(10.0)
    lamp = lamp_at([0.0, 1.0, 1.0], 10.0, level=3.0)
    facing = 3.0 * np.pi * np.sin(half) ** 2
    assert lamp.irradiance(np.array([0.0, 1.0, 1.0]) / np.sqrt(2.0)) == pytest.approx(facing)
    assert lamp.irradiance(Y) == pytest.approx(facing / np.sqrt(2.0))
    assert lamp.irradiance(-Y) == pytest.approx(0.0)
    assert even(2.0).mean() == pytest.approx(2.0)
    assert lamp.mean() == pytest.approx(3.0 * np.sin(0.5 * half) ** 2)


# --- Glare and vignetting ----------------------------------------------------------------------


def test_vignetting_is_the_lens_polynomial():
    lens = fisheye(300, vignetting=(-0.1, 0.02, -0.005))
    picture = draw(even(), lens)
    for degrees in (0.0, 30.0, 60.0, 89.0):
        phi = np.radians(degrees)
        expected = 1.0 - 0.1 * phi**2 + 0.02 * phi**4 - 0.005 * phi**6
        column = int(150.0 + lens.focal_length_px * phi)
        assert picture[150, column, 0] == pytest.approx(expected, abs=2e-3)


def test_glare_veils_the_picture_by_its_mean():
    lens = fisheye(200, vignetting=NO_VIGNETTING, glare=0.03)
    clear = draw(lamp_at(-Z, 20.0, level=7.0), lens)
    veiled = clear.copy()
    add_glare(veiled, lens)
    held = pixel_angles(lens, 0, 200) <= np.pi / 2.0
    mean = clear[held].mean(dtype=np.float64)
    assert mean == pytest.approx(7.0 * (20.0 / 90.0) ** 2, rel=5e-3)
    assert veiled[100, 100, 0] == pytest.approx(0.97 * 7.0 + 0.03 * mean, rel=1e-5)
    assert veiled[100, 190, 0] == pytest.approx(0.03 * mean, rel=1e-5)
    assert veiled[2, 2, 0] == pytest.approx(0.03 * mean, rel=1e-5)  # beyond the circle
    assert veiled[held].mean(dtype=np.float64) == pytest.approx(mean, rel=1e-5)


# --- Sensor ------------------------------------------------------------------------------------


@pytest.mark.parametrize(("bits", "iso"), [(14, 100.0), (12, 800.0)])
def test_photon_transfer_curve_is_a_line_of_slope_one_over_gain(bits, iso):
    sensor = Sensor(full_well=40000.0, read_noise=5.0, bits=bits, black_level=64)
    rng = np.random.default_rng(5)
    levels = np.linspace(0.02, 0.9, 12)
    values = [sensor.expose(np.full(200_000, level), iso, rng).astype(float) for level in levels]
    mean = np.array([value.mean() for value in values]) - sensor.black_level
    variance = np.array([value.var() for value in values])
    slope, intercept = np.polyfit(mean, variance, 1, w=1.0 / variance)
    assert mean == pytest.approx(levels * (sensor.white_level - 64), rel=2e-3)
    assert slope == pytest.approx(1.0 / sensor.gain(iso), rel=5e-3)
    expected = sensor.read_noise_dn(iso) ** 2 + 1.0 / 12.0  # rounding adds a twelfth
    assert intercept == pytest.approx(expected, abs=0.02 * variance[0])


def test_dark_frame_has_read_noise_about_the_black_level():
    sensor = Sensor(read_noise=8.0)
    dark = sensor.expose(np.zeros(100_000), 400.0, np.random.default_rng(1)).astype(float)
    assert dark.mean() == pytest.approx(512.0, abs=0.05)
    assert dark.std() == pytest.approx(np.hypot(sensor.read_noise_dn(400.0), 12**-0.5), rel=0.02)


def test_sensor_clips_at_its_largest_value():
    sensor = Sensor(bits=12, black_level=128)
    bright = sensor.expose(np.array([1.5, 1e9, np.float32(3e38)]), 100.0, np.random.default_rng(1))
    assert (bright == 4095).all()
    exact = replace(sensor, is_noisy=False).expose(np.array([0.0, 0.5, 1.0]), 100.0, None)
    assert exact.tolist() == [128, 2112, 4095]


def test_exposures_multiply_time_iso_aperture_and_filter():
    bracket = exposure_list([0.5, 0.25], iso=[100.0, 400.0], f_number=4.0, nd_factor=[1.0, 8.0])
    assert bracket.exposure == pytest.approx([0.5 / 16.0, 0.25 * 4.0 / 16.0 / 8.0])
    series = exposure_series(5, 1.5, 0.1)
    assert series.time_s == pytest.approx(0.1 * 2.0 ** np.array([3.0, 1.5, 0.0, -1.5, -3.0]))


@pytest.mark.parametrize(
    ("changes", "match"),
    [
        ({"exposures": exposure_list([0.1, -1.0])}, "time_s of an exposure is -1"),
        ({"exposures": exposure_list([0.1], nd_factor=0.5)}, "nd_factor of an exposure is 0.5"),
        ({"exposures": exposure_list([])}, "0 exposures"),
        ({"exposures": (exposure_series(),)}, "1 brackets for 3 views"),
        ({"views": ()}, "at least one view"),
        ({"sensor": Sensor(bits=40)}, "40 bits"),
        ({"lens": fisheye(100, glare=0.7)}, "glare is 0.7"),
        ({"rotation_error_deg": np.nan}, "rotation error is nan"),
        ({"file_kind": "gif"}, "no format or curve 'gif'"),
        ({"curve": "log"}, "no format or curve 'log'"),
        ({"truth_height": -3}, "height of the truth is -3"),
        ({"sensor_constant": -1.0}, "sensor constant is -1"),
    ],
)
def test_setup_that_makes_no_sense_is_refused(tmp_path, changes, match):
    with pytest.raises(UsageError, match=match):
        photograph(tmp_path / "none.usda", tmp_path / "out", Setup(**changes))
    assert not (tmp_path / "out").exists()


# --- Whole shoots ------------------------------------------------------------------------------


def small(camera_file, **changes) -> Setup:
    given = {
        "camera": camera_file,
        "lens": fisheye(64),
        "exposures": exposure_series(3, 2.0),
        "sensor": Sensor(is_noisy=False),
        "truth_height": 32,
    }
    return Setup(**{**given, **changes})


def test_even_light_gives_even_camera_values(tmp_path, camera_file):
    stage = room(tmp_path / "even.usda", intensity=3.0)
    setup = small(
        camera_file,
        lens=fisheye(64, vignetting=NO_VIGNETTING),
        sensor=Sensor(bits=16, black_level=1000, is_noisy=False),
    )
    shoot = read_shoot(open_stage(photograph(stage, tmp_path / "out", setup)))
    assert len(shoot.views) == 3
    inside = pixel_angles(setup.lens, 0, 64) <= np.radians(89.0)
    expected = 0.18 / setup.exposures.exposure[1]
    truth = read_truth(tmp_path / "out")
    assert truth.values[..., 1] == pytest.approx(expected, rel=1e-6)
    # The lamp is D65, so R and B have their own levels: those of the integral.
    nm = np.arange(400.0, 701.0, 10.0)
    camera = read_sensitivity(camera_file)
    spectrum = illuminant("D65", nm)
    unit = spectrum / (spectrum @ xyz_weights(nm)[:, 1])
    response = 10.0 * (3.0 * unit) @ camera.value
    assert truth.values[0, 0] == pytest.approx(truth.constants["sensorConstant"] * response)
    for view in shoot.views:
        for photo, exposure in zip(view.bracket.images, view.bracket.exposure, strict=True):
            seen = relative(photo, setup)
            level = truth.values[0, 0] * exposure
            step = 1.0 / (setup.sensor.white_level - 1000)
            assert np.abs(seen - np.minimum(level, 1.0))[inside].max() < 0.51 * step + 1e-6


@pytest.mark.parametrize("up", ["Y", "Z"])
def test_photographs_show_the_true_panorama(tmp_path, camera_file, up):
    towards = texel_directions(64, 128)
    waves = np.stack([np.sin(3.0 * towards @ axis + k) for k, axis in enumerate(np.eye(3))], -1)
    part = Part("", {"": (2.0 + waves).astype(np.float32)}, {}, "float", "lin_rec709_scene")
    write_exr(tmp_path / "map.exr", [part])
    stage = room(tmp_path / "room.usda", dome=tmp_path / "map.exr", up=up)
    lens = fisheye(128, vignetting=(-0.1, 0.01))
    views = ((20.0, 10.0), (200.0, -30.0))
    setup = small(camera_file, lens=lens, views=views, truth_height=128)
    shoot = read_shoot(open_stage(photograph(stage, tmp_path / "out", setup)))
    truth = read_truth(tmp_path / "out")
    v, u = (np.indices((128, 128)) + 0.5) - 64.0
    radius = np.hypot(u, v)
    angle = radius / lens.focal_length_px
    rays = np.stack(
        [np.sin(angle) * u / radius, -np.sin(angle) * v / radius, -np.cos(angle)], axis=-1
    )
    inside = angle < np.radians(88.0)
    to_panorama = np.eye(3) if up == "Y" else np.array([[1, 0, 0], [0, 0, 1], [0, -1, 0]])
    for view in shoot.views:
        seen = relative(view.bracket.images[1], setup) / view.bracket.exposure[1]
        rho = seen / (1.0 - 0.1 * angle**2 + 0.01 * angle**4)[..., None]
        across, down = latlong_coordinates(rays @ (to_panorama @ truth.rotations[view.name]).T)
        expected = truth.values[
            np.minimum(down * 128, 127).astype(int), np.minimum(across * 256, 255).astype(int)
        ]
        error = np.abs(rho / expected - 1.0)[inside]
        assert np.median(error) < 0.01
        assert error.max() < 0.15


def test_shoot_layer_tells_what_a_photographer_knows(tmp_path, camera_file):
    stage = room(tmp_path / "even.usda", lamps=[(Y, 4.0)])
    lens = replace(LENSES["opencv"], glare=0.01)
    setup = small(
        camera_file,
        lens=lens,
        views=(*THREE_LEVEL, (0.0, 90.0)),
        vignetting_error=0.02,
        rotation_error_deg=0.5,
        shutter_error=0.05,
        states_noise=True,
        seed=7,
    )
    shoot = read_shoot(open_stage(photograph(stage, tmp_path / "out", setup)))
    truth = read_truth(tmp_path / "out")
    assert shoot.model == "acme"
    assert shoot.time.startswith("2026-")
    phi = np.radians(lens.max_angle_deg)
    for view in shoot.views:
        turn = truth.rotations[view.name].T @ view.rotation
        assert np.degrees(np.arccos((np.trace(turn) - 1.0) / 2.0)) == pytest.approx(0.5, abs=1e-6)
        stated, true = (
            1.0 + sum(a * phi ** (2 * k) for k, a in enumerate(item.vignetting, start=1))
            for item in (view.lens, truth.lens)
        )
        assert stated / true == pytest.approx(1.02)
        assert view.lens.glare == 0.01
        assert view.bracket.gain == pytest.approx(setup.sensor.gain(100.0))
        assert view.bracket.read_noise == pytest.approx(setup.sensor.read_noise_dn(100.0))
        assert (view.bracket.white_level, view.bracket.black_level) == (16383.0, 512.0)
    axes = [view.rotation @ -Z for view in shoot.views]
    assert np.degrees(np.arccos(axes[3] @ Y)) < 0.6
    factors = np.array(truth.constants["exposureFactors"])
    assert factors.shape == (12,)
    assert 0.005 < np.abs(factors - 1.0).max() < 0.25
    # Relative light of mean 100 cd/m^2; the meters read the light itself.
    light = read_environment(stage, read_sensitivity(camera_file))
    assert light.mean()[3] == pytest.approx(100.0)
    assert shoot.illuminance_lx == pytest.approx(light.irradiance(Y)[3])
    assert shoot.illuminance_direction == pytest.approx(Y)
    assert shoot.luminance == pytest.approx(spot(light, shoot.luminance_direction)[3])
    assert shoot.luminance_weights.sum() == pytest.approx(1.0)


def test_absolute_light_keeps_its_units(tmp_path, camera_file):
    path = room(tmp_path / "even.usda")
    stage = Usd.Stage.Open(str(path))
    dome = stage.GetPrimAtPath("/Dome")
    dome.ApplyAPI("SpectralLightAPI")
    dome.GetAttribute("inputs:spectral:units").Set("absolute")
    dome.GetAttribute("inputs:intensity").Set(250.0)
    stage.Save()
    shoot = read_shoot(open_stage(photograph(path, tmp_path / "out", small(camera_file))))
    assert shoot.luminance == pytest.approx(250.0, rel=1e-5)  # RGB of an absolute light is cd/m^2
    assert shoot.illuminance_lx == pytest.approx(250.0 * np.pi, rel=1e-4)


def test_photographs_hold_what_the_exif_of_a_camera_holds(tmp_path, camera_file):
    stage = room(tmp_path / "even.usda")
    exposures = exposure_list([0.5, 1 / 60], iso=[400.0, 400.0], f_number=5.6)
    for kind in KINDS:
        setup = small(camera_file, exposures=exposures, file_kind=kind, views=((0.0, 0.0),))
        photograph(stage, tmp_path / kind, setup)
        name = f"01{KINDS[kind].suffix}"
        attributes = read_image(tmp_path / kind / "view0" / name).attributes
        assert attributes["ExposureTime"] == pytest.approx(1 / 60, rel=1e-4), kind
        assert attributes["FNumber"] == pytest.approx(5.6, rel=1e-4)
        iso = attributes.get("Exif:PhotographicSensitivity", attributes.get("Exif:ISOSpeed"))
        assert iso == 400
        assert attributes["Model"] == "acme"
        assert attributes["Exif:DateTimeOriginal"] == "2026:03:20 12:00:02"


@pytest.mark.parametrize("kind", ["png", "exr"])
def test_raw_values_are_the_same_in_every_kind_of_file(tmp_path, camera_file, kind):
    stage = room(tmp_path / "even.usda", lamps=[(-Z, 20.0)])
    setups = {name: small(camera_file, file_kind=name, sensor=Sensor()) for name in ("tif", kind)}
    shoots = {
        name: read_shoot(open_stage(photograph(stage, tmp_path / name, setup)))
        for name, setup in setups.items()
    }
    for of_tif, of_kind in zip(shoots["tif"].views, shoots[kind].views, strict=True):
        for shot in range(3):
            levels = []
            for bracket, scale in ((of_tif.bracket, 65535.0), (of_kind.bracket, None)):
                full = scale if scale and kind == "tif" else 1.0
                pixels = read_image(bracket.images[shot]).pixels.astype(np.float64)
                if bracket.white_level[0] > 1.0:
                    pixels = np.rint(pixels * 65535.0)
                black, white = bracket.black_level, bracket.white_level
                levels.append((pixels - black) / (white - black) / full)
            assert np.abs(levels[0] - levels[1]).max() < 1e-6


@pytest.mark.parametrize("curve", CURVES)
def test_developed_pictures_follow_their_curve(tmp_path, camera_file, curve):
    stage = room(tmp_path / "even.usda", lamps=[(-Z, 20.0)])
    raw = small(camera_file, sensor=Sensor(bits=16, is_noisy=False), views=((0.0, 0.0),))
    photograph(stage, tmp_path / "raw", raw)
    setup = replace(raw, file_kind="png8", curve=curve)
    shoot = read_shoot(open_stage(photograph(stage, tmp_path / "out", setup)))
    level, light = np.loadtxt(tmp_path / "out" / "truth" / "response.txt").T
    assert level.tolist() == list(range(256))
    assert (np.diff(light) > 0.0).all()
    assert (light[0], light[-1]) == (0.0, 1.0)
    bracket = shoot.views[0].bracket
    assert (bracket.black_level, bracket.white_level) == (0.0, 255.0)
    for shot in range(3):
        developed = np.rint(255.0 * read_image(bracket.images[shot]).pixels).astype(int)
        truth = np.clip(relative(tmp_path / "raw" / "view0" / f"0{shot}.tif", raw), 0.0, 1.0)
        bound = np.gradient(light)[developed]
        assert (np.abs(light[developed] - truth) <= bound + 1e-4).all()


def test_same_seed_gives_the_same_bytes_whatever_the_threads(tmp_path, camera_file):
    stage = room(tmp_path / "room.usda", lamps=[(-Z, 5.0)])
    setup = small(camera_file, lens=fisheye(100, glare=0.02), sensor=Sensor(), seed=3)
    for name, threads, seed in (("a", 1, 3), ("b", 3, 3), ("c", 2, 4)):
        photograph(stage, tmp_path / name, replace(setup, seed=seed), threads=threads)
    files = sorted(path.relative_to(tmp_path / "a") for path in (tmp_path / "a").rglob("*.tif"))
    assert len(files) == 9
    for file in (*files, Path("truth/truth.exr")):
        one, two, other = ((tmp_path / name / file).read_bytes() for name in "abc")
        assert one == two
        assert (one == other) == (file.suffix == ".exr")
    again = {(tmp_path / "a" / file).read_bytes() for file in files}
    assert len(again) == len(files)  # no noise is used twice


def test_one_bracket_may_differ_from_the_others(tmp_path, camera_file):
    stage = room(tmp_path / "room.usda")
    dark = exposure_list([0.01], nd_factor=64.0)
    setup = small(camera_file, views=((0.0, 0.0), (0.0, 0.0)), exposures=(exposure_series(3), dark))
    shoot = read_shoot(open_stage(photograph(stage, tmp_path / "out", setup)))
    assert [len(view.bracket.images) for view in shoot.views] == [3, 1]
    assert shoot.views[1].bracket.nd_factor.tolist() == [64.0]


def test_camera_keeps_its_constant_in_another_light(tmp_path, camera_file):
    first, second = (room(tmp_path / f"{k}.usda", intensity=k) for k in (1.0, 5.0))
    photograph(first, tmp_path / "first", small(camera_file))
    constant = read_truth(tmp_path / "first").constants["sensorConstant"]
    photograph(second, tmp_path / "second", small(camera_file, sensor_constant=constant))
    ratio = read_truth(tmp_path / "second").values / read_truth(tmp_path / "first").values
    assert ratio == pytest.approx(5.0, rel=1e-6)


# --- Light that is read ------------------------------------------------------------------------


def test_camera_values_are_the_integral_of_light_and_sensitivity(tmp_path, camera_file):
    pixels = np.random.default_rng(2).random((8, 16, 3)).astype(np.float32)
    part = Part("", {"": pixels}, {}, "float", "lin_rec709_scene")
    write_exr(tmp_path / "map.exr", [part])
    camera = read_sensitivity(camera_file)
    light = read_environment(tmp_path / "map.exr", camera, "FL2")
    stage = room(tmp_path / "stage.usda", dome=tmp_path / "map.exr")
    dome = read_lights(open_stage(stage), 0, camera.wavelength_nm, illuminant="FL2").domes[0]
    spectra = dome.coefficients.astype(np.float64) @ dome.basis
    assert light.maps[0].values[..., :3] == pytest.approx(10.0 * spectra @ camera.value, rel=1e-5)


def test_cameras_of_colour_science_and_of_files_agree(realdata):
    named = read_sensitivity("Nikon 5100 (NPL)")
    filed = read_sensitivity(str(realdata / "cameras" / "Nikon_D5100_380_780_5.json"))
    assert filed.name == "Nikon D5100"
    assert named.wavelength_nm.tolist() == filed.wavelength_nm.tolist()
    ratio = named.value.sum(axis=0) / filed.value.sum(axis=0)
    assert ratio == pytest.approx(ratio[1], rel=1e-2)


@pytest.mark.parametrize(
    ("name", "text", "match"),
    [
        ("gone.csv", None, "cannot be read"),
        ("a.csv", "400,1,2\n", "fewer than|not three|two or more|must|empty"),
        ("b.csv", "nm,R,G,B\n400,1,1,1\n410,1,x,1\n", r"b\.csv:3: not a row"),
        ("c.csv", "400,1,1,1\n400,1,1,1\n", "must ascend"),
        ("d.csv", "400,1,1,1\n410,1,-1,1\n", "negative"),
        ("e.csv", "400,0,1,1\n410,0,1,1\n", "zero throughout"),
        ("f.json", "{}", "layout of rawtoaces"),
        ("g.json", "[[[", "layout of rawtoaces"),
        ("h.json", json.dumps({"header": 3, "spectral_data": []}), "layout of rawtoaces"),
    ],
)
def test_file_that_is_no_camera_is_refused(tmp_path, name, text, match):
    if text is not None:
        (tmp_path / name).write_text(text)
    with pytest.raises(UsageError, match=match):
        read_sensitivity(str(tmp_path / name))


def test_stage_without_light_to_see_is_refused(tmp_path, camera_file):
    dark = room(tmp_path / "dark.usda", dome=False)
    with pytest.raises(LayerError, match="no light reaches the camera"):
        photograph(dark, tmp_path / "out", small(camera_file))
    point = room(tmp_path / "point.usda", lamps=[(Y, 0.0)])
    with pytest.raises(LayerError, match=r"Lamp0.*inputs:angle is 0"):
        photograph(point, tmp_path / "out", small(camera_file))
    assert [path.name for path in tmp_path.iterdir() if "out" in path.name] == []


def test_meter_looks_at_an_even_surface():
    values = np.random.default_rng(0).uniform(0.5, 1.5, (90, 180, 4)).astype(np.float32)
    values[30:60, 20:50] = 1.0
    environment = Environment((LightMap(values, np.eye(3)),))
    direction = even_direction(environment)
    assert spot(environment, direction) == pytest.approx(1.0)


def test_luminance_weights_are_the_least_squares_fit():
    rng = np.random.default_rng(4)
    values = rng.random((32, 64, 4)).astype(np.float32)
    values[..., 3] = values[..., :3] @ [0.3, 0.6, 0.1]
    environment = Environment((LightMap(values, np.eye(3)),))
    assert luminance_weights(environment) == pytest.approx([0.3, 0.6, 0.1], abs=1e-5)
    values[..., 3] = values[..., 1] - 0.5 * values[..., 2] + 0.5 * values[..., 0]
    weights = luminance_weights(Environment((LightMap(values, np.eye(3)),)))
    assert weights.min() == 0.0


# --- The room that ships -----------------------------------------------------------------------


@pytest.fixture(scope="module")
def make_room():
    with pytest.MonkeyPatch.context() as patch:
        patch.syspath_prepend(str(ROOM.parent))
        yield importlib.import_module("make_room")


def test_shipped_room_is_small_and_has_nothing_to_be_found_in():
    assert [str(found) for found in validate(ROOM)] == []
    assert max(file.stat().st_size for file in ROOM.parent.iterdir() if file.is_file()) < 1_000_000


def test_shipped_room_is_as_bright_as_its_readme_says(make_room):
    dome = read_lights(open_stage(ROOM), 0, make_room.WAVELENGTH_NM).domes[0]
    assert dome.absolute
    assert dome.coefficients.shape == (512, 1024, 6)
    weights = dome.basis @ xyz_weights(make_room.WAVELENGTH_NM, absolute=True)
    luminance = dome.coefficients @ weights[:, 1]
    assert luminance.min() > 0.0
    assert luminance.max() == pytest.approx(12000.0, rel=0.01)
    assert luminance.max() / luminance.min() > 1e5
    tubes = np.concatenate(make_room.TUBES)
    assert np.degrees(make_room.TUBE_WIDTH / np.linalg.norm(tubes, axis=1)).min() > 0.6
    # The rendition for other tools: the same light, half as fine.
    shown = read_image(ROOM.with_name("room_rgb.exr")).pixels
    exact = dome.coefficients @ (weights @ xyz_to_rgb("lin_rec709_scene").T)
    exact = exact.reshape(256, 2, 512, 2, 3).mean(axis=(1, 3))
    level = exact.max(axis=-1, keepdims=True)
    assert (np.abs(shown - np.maximum(exact, 0.0)) <= 0.02 * level).all()


def test_shipped_room_is_what_its_script_makes(make_room):
    shipped = read_image(ROOM.with_name("room.exr")).pixels
    rows = [40, 150, 260, 400]
    made = make_room.rounded(make_room.coefficients(512, rows=rows))
    same = np.isclose(made, shipped[rows], rtol=0.04, atol=1e-3)
    assert same.mean() > 0.99


# --- Files and commands ------------------------------------------------------------------------


def test_folder_that_holds_something_is_left_alone(tmp_path, camera_file):
    (tmp_path / "out").mkdir()
    (tmp_path / "out" / "mine.txt").touch()
    with pytest.raises(UsageError, match="is there already"):
        photograph(room(tmp_path / "room.usda"), tmp_path / "out", small(camera_file))
    assert [path.name for path in (tmp_path / "out").iterdir()] == ["mine.txt"]


def test_interrupted_shoot_leaves_nothing(tmp_path, camera_file, monkeypatch):
    def interrupt(*_given):
        raise KeyboardInterrupt

    monkeypatch.setattr(photographer, "write_truth", interrupt)
    stage = room(tmp_path / "room.usda")
    with pytest.raises(KeyboardInterrupt):
        photograph(stage, tmp_path / "out", small(camera_file))
    assert [path.name for path in tmp_path.iterdir()] == ["room.usda"]


def test_lens_comes_from_a_layer(tmp_path):
    stage = Usd.Stage.CreateNew(str(tmp_path / "lens.usda"))
    prim = UsdGeom.Camera.Define(stage, "/Lens").GetPrim()
    write_lens(prim, LENSES["opencv"])
    stage.SetDefaultPrim(prim)
    stage.Save()
    lens = lens_of_layer(tmp_path / "lens.usda")
    assert lens.distortion == pytest.approx(LENSES["opencv"].distortion)
    with pytest.raises(LayerError, match="no Camera has FisheyeCameraAPI"):
        lens_of_layer(room(tmp_path / "room.usda"))


def test_command_photographs(tmp_path, camera_file):
    stage = room(tmp_path / "room.usda", up="Z", lamps=[(Z, 6.0)])
    given = f"{stage} -o {tmp_path / 'out'} --size 48 --exposures 2 --time 1/30 --views 0,180,up"
    given += f" --camera {camera_file} --glare 0.01 --rotation-error 1 --bits 12 -q"
    result = CliRunner().invoke(command, given.split(), obj=GlobalOptions(), catch_exceptions=False)
    assert result.exit_code == 0
    assert result.stdout.strip() == str(tmp_path / "out" / "shoot.usda")
    shoot = read_shoot(open_stage(tmp_path / "out" / "shoot.usda"))
    assert shoot.up_axis == "Z"
    assert shoot.views[0].bracket.white_level == 4095.0
    assert shoot.views[0].bracket.black_level == 128.0
    assert shoot.views[0].bracket.exposure_time_s == pytest.approx([1 / 15, 1 / 60])
    assert (shoot.views[2].rotation @ -Z) @ Z > np.cos(np.radians(1.1))
    wrong = CliRunner().invoke(command, [*given.split(), "--time", "soon"], obj=GlobalOptions())
    assert wrong.exit_code == 2


def test_rotation_about_an_axis_is_counterclockwise():
    assert np.allclose(rotation_about(Z, np.pi / 2.0) @ X, Y)
