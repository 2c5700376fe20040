"""Patches of color charts in pictures: layouts, planes, sampling, checks, detection."""

from __future__ import annotations

import json
import re
from dataclasses import replace
from functools import cache

import numpy as np
import pytest
import simulated_sensor

from usdskin.device import open_workers
from usdskin.errors import ImageError, LayerError
from usdskin.estimate.chart.check import LARGEST_ERROR, check_patches
from usdskin.estimate.chart.detect import find_corners
from usdskin.estimate.chart.fit import fit_spectra
from usdskin.estimate.chart.lattice import find_in_lattice
from usdskin.estimate.chart.layouts import LAYOUTS
from usdskin.estimate.chart.orders import laid_out_otherwise, listed_otherwise
from usdskin.estimate.chart.photograph import develop
from usdskin.estimate.chart.plane import UNIT_CORNERS, chart_plane
from usdskin.estimate.chart.sample import sample_patches
from usdskin.notes import Note
from usdskin.photographs.merge import CLIPPED, MOVED
from usdskin.prims import FisheyeLens
from usdskin.prims.charts import ColorChart

CLASSIC = LAYOUTS["classic24"]
SG = LAYOUTS["sg140"]
BLACK_FRAME = np.array([0.02, 0.02, 0.02])
"""Camera values of the frame and the gaps."""


@pytest.fixture(scope="module")
def workers():
    return open_workers("cpu", 2)


# --- A chart in front of a camera, by intersecting rays with its plane ---------------------------


@cache
def classic_spectra() -> np.ndarray:
    import colour

    shape = colour.SpectralShape(400, 700, 5)
    chart = colour.SDS_COLOURCHECKERS["ColorChecker N Ohta"]
    return np.array([sd.copy().align(shape).values for sd in chart.values()])


@cache
def camera(name: str = "Nikon 5100 (NPL)") -> np.ndarray:
    import colour

    shape = colour.SpectralShape(400, 700, 5)
    return colour.MSDS_CAMERA_SENSITIVITIES[name].copy().align(shape).values


@cache
def lamp(name: str) -> np.ndarray:
    import colour

    shape = colour.SpectralShape(400, 700, 5)
    return colour.SDS_ILLUMINANTS[name].copy().align(shape).values


def classic_values(light: str = "D55") -> np.ndarray:
    """Return camera values with 1 for the perfect diffuser's green."""
    values = (classic_spectra() * lamp(light)) @ camera()
    return values / (lamp(light) @ camera())[1]


def pose(tilt_deg=(0.0, 0.0, 0.0), center=(0.0, 0.0, -1.0)) -> tuple[np.ndarray, np.ndarray]:
    """Return the rotation of a chart (x right, y up, z to the camera) and its middle."""
    x, y, z = np.radians(tilt_deg)
    about_x = [[1, 0, 0], [0, np.cos(x), -np.sin(x)], [0, np.sin(x), np.cos(x)]]
    about_y = [[np.cos(y), 0, np.sin(y)], [0, 1, 0], [-np.sin(y), 0, np.cos(y)]]
    about_z = [[np.cos(z), -np.sin(z), 0], [np.sin(z), np.cos(z), 0], [0, 0, 1]]
    return np.array(about_x) @ about_y @ about_z, np.array(center)


def equidistant_rays(lens: FisheyeLens, u: np.ndarray, v: np.ndarray) -> np.ndarray:
    x, y = u - lens.center_px[0], lens.center_px[1] - v
    radius = np.hypot(x, y)
    phi = radius / lens.focal_length_px
    sine = np.sin(phi) / np.where(radius > 0.0, radius, 1.0)
    return np.stack([sine * x, sine * y, -np.cos(phi)], axis=-1)


def pinhole_rays(focal_px: float, center, u: np.ndarray, v: np.ndarray) -> np.ndarray:
    return np.stack([(u - center[0]) / focal_px, (center[1] - v) / focal_px, -np.ones_like(u)], -1)


def chart_points(rays, rotation, middle, size):
    """Return where rays meet the chart, 0 .. 1 over its patches, NaN where they do not."""
    normal = rotation[:, 2]
    with np.errstate(divide="ignore", invalid="ignore"):
        distance = (middle @ normal) / (rays @ normal)
    distance = np.where(distance > 0.0, distance, np.nan)
    local = (rays * distance[..., None] - middle) @ rotation
    return np.stack([local[..., 0] / size[0] + 0.5, 0.5 - local[..., 1] / size[1]], axis=-1)


def paint(points, layout, colors, background, frame=0.06, gap=0.1):
    """Return the color at chart points."""
    count = np.array([layout.columns, layout.rows])
    sides = count + (count - 1) * gap
    cell = points * sides / (1.0 + gap)
    index = np.floor(cell)
    within = (cell - index) * (1.0 + gap)
    inside = ((index >= 0) & (index < count) & (within <= 1.0)).all(axis=-1)
    framed = ((points > -frame) & (points < 1.0 + frame)).all(axis=-1)
    table = np.empty((layout.rows, layout.columns, 3))
    table[layout.positions[:, 1], layout.positions[:, 0]] = colors
    column, row = (np.where(inside, index[..., k], 0).astype(int) for k in (0, 1))
    painted = np.where(framed[..., None], BLACK_FRAME, background)
    return np.where(inside[..., None], table[row, column], painted)


def photograph(rays_of, size, layout, colors, rotation, middle, background=0.3, samples=3):
    """Return a picture of a chart, shape [height, width, 3]; ``rays_of`` takes positions."""
    width, height = size
    sides = np.array([layout.columns, layout.rows]) + 0.1 * (
        np.array([layout.columns, layout.rows]) - 1
    )
    extent = 0.6 * sides / sides[0]
    total = np.zeros((height, width, 3))
    for j in range(samples):
        for i in range(samples):
            u = np.arange(width) + (i + 0.5) / samples
            v = np.arange(height) + (j + 0.5) / samples
            points = chart_points(rays_of(*np.meshgrid(u, v)), rotation, middle, extent)
            total += paint(points, layout, colors, background)
    return (total / samples**2).astype(np.float32), extent


def true_corners(project, rotation, middle, extent):
    local = (UNIT_CORNERS - 0.5) * [1.0, -1.0] * extent
    return project(local @ rotation[:, :2].T + middle)


def pinhole_project(focal_px, center):
    def to_picture(points):
        return np.stack(
            [
                center[0] - focal_px * points[..., 0] / points[..., 2],
                center[1] + focal_px * points[..., 1] / points[..., 2],
            ],
            axis=-1,
        )

    return to_picture


def pinhole_picture(tilt=(0.0, 0.0, 0.0), colors=None):
    """Return a picture through a pinhole, and where its corners are."""
    picture, corners = _pinhole_picture(tilt, None if colors is None else colors.tobytes())
    return picture.copy(), corners.copy()


@cache
def _pinhole_picture(tilt, packed):
    layout, size = CLASSIC, (480, 360)
    colors = None if packed is None else np.frombuffer(packed).reshape(24, 3)
    colors = classic_values() if colors is None else colors
    focal, center = 0.9 * size[0], (0.5 * size[0], 0.5 * size[1])
    rotation, middle = pose(tilt)
    picture, extent = photograph(
        lambda u, v: pinhole_rays(focal, center, u, v),
        size,
        layout,
        colors,
        rotation,
        middle,
    )
    return picture, true_corners(pinhole_project(focal, center), rotation, middle, extent)


def fisheye_picture(layout, colors, lens, tilt, middle, **kwargs):
    """Return a picture through an equidistant lens, and where its corners are."""
    rotation, middle = pose(tilt, middle)

    def to_picture(points):
        across = np.hypot(points[..., 0], points[..., 1])
        phi = np.arctan2(across, -points[..., 2])
        offset = phi * lens.focal_length_px / across
        return lens.center_px + offset[..., None] * points[..., :2] * [1.0, -1.0]

    picture, extent = photograph(
        lambda u, v: equidistant_rays(lens, u, v),
        lens.resolution,
        layout,
        colors,
        rotation,
        middle,
        **kwargs,
    )
    return picture, true_corners(to_picture, rotation, middle, extent)


def fisheye(**changes) -> FisheyeLens:
    given = {
        "projection": "equidistant",
        "focal_length_px": 260.0,
        "center_px": np.array([301.3, 297.8]),
        "resolution": (600, 600),
        "max_angle_deg": 65.0,
        "vignetting": np.array([-0.25, 0.03]),
    }
    return FisheyeLens(**{**given, **changes})


def signals(light: str = "D55") -> np.ndarray:
    return classic_spectra() * lamp(light)


def random_colors(layout, seed=1):
    return np.random.default_rng(seed).uniform(0.02, 0.9, (len(layout.names), 3))


TILTS = [(0.0, 0.0, 0.0), (20.0, -25.0, 8.0), (-30.0, 10.0, 170.0)]


# --- Layouts -------------------------------------------------------------------------------------


def test_names_of_the_classic_are_those_of_the_published_data():
    import colour

    for name in ("ColorChecker N Ohta", "BabelColor Average", "ISO 17321-1"):
        assert tuple(colour.SDS_COLOURCHECKERS[name]) == CLASSIC.names


def test_patches_are_known_by_cell_number_and_other_spellings():
    spellings = {"A1": 0, "B1": 6, "D6": 23, "d06": 23, "Dark_Skin": 0, "white": 18, "24": 23}
    assert {name: CLASSIC.index(name) for name in spellings} == spellings
    assert CLASSIC.index("E1") is None
    assert [SG.index(name) for name in ("A1", "A10", "B1", "n10", "A01", "140")] == [
        0, 9, 10, 139, 0, 139,
    ]  # fmt: skip


@pytest.mark.parametrize("layout", LAYOUTS.values(), ids=LAYOUTS)
def test_patches_fill_the_rectangle_of_the_corners(layout):
    low, high = layout.centers - layout.half_size, layout.centers + layout.half_size
    np.testing.assert_allclose(low.min(axis=0), 0.0, atol=1e-12)
    np.testing.assert_allclose(high.max(axis=0), 1.0, atol=1e-12)
    assert len(set(map(tuple, layout.positions))) == len(layout.names)


def test_the_digital_sg_has_its_border_of_greys():
    """White, grey and black follow one another around the chart, as the makers show it."""
    border = [k for k, (x, y) in enumerate(SG.positions) if x in (0, 13) or y in (0, 9)]
    assert SG.names[border[0]] == "A1"
    assert len(border) == 44


# --- The plane of the chart ----------------------------------------------------------------------


@pytest.mark.parametrize("lens", [None, fisheye()], ids=["flat", "fisheye"])
def test_points_of_a_chart_come_back(lens):
    corners = [[150.0, 160.0], [420.0, 130.0], [440.0, 330.0], [140.0, 310.0]]
    plane = chart_plane(corners, lens, "chart")
    np.testing.assert_allclose(plane.to_picture(UNIT_CORNERS), corners, atol=1e-9)
    points = np.random.default_rng(2).random((50, 2))
    np.testing.assert_allclose(plane.to_chart(plane.to_picture(points)), points, atol=1e-12)


def test_straight_edges_of_a_chart_are_bent_by_a_fisheye():
    corners = [[100.0, 100.0], [500.0, 100.0], [500.0, 300.0], [100.0, 300.0]]
    middle = chart_plane(corners, fisheye(), "chart").to_picture([0.5, 0.0])
    assert middle[0] == pytest.approx(301.3, abs=3.0)
    assert middle[1] < 90.0


@pytest.mark.parametrize(
    ("corners", "said"),
    [
        ([[0, 0], [0, 9], [9, 9], [9, 0]], "run counter-clockwise"),
        ([[0, 0], [9, 9], [9, 0], [0, 9]], "no convex quadrilateral"),
        ([[0, 0], [9, 0], [2, 2], [0, 9]], "no convex quadrilateral"),
        ([[0, 0], [5, 0], [9, 0], [0, 9]], "no convex quadrilateral"),
        ([[3, 3]] * 4, "no convex quadrilateral"),
    ],
    ids=["mirrored", "crossed", "dented", "three on a line", "one point"],
)
def test_corners_that_are_no_view_of_a_rectangle_are_refused(corners, said):
    with pytest.raises(LayerError, match=f"^chart.usda </C>: the chart's corners .* {said}"):
        chart_plane(corners, None, "chart.usda </C>")


def test_corner_outside_the_fisheye_circle_is_named():
    corners = [[250, 250], [590, 20], [350, 350], [250, 350]]
    with pytest.raises(LayerError, match=r"the chart's top right corner \(590, 20\) lies outside"):
        chart_plane(corners, fisheye(), "chart")


# --- Sampling ------------------------------------------------------------------------------------


@pytest.mark.parametrize("tilt", TILTS)
def test_patches_of_a_pinhole_picture_are_what_was_painted(tilt):
    picture, corners = pinhole_picture(tilt=tilt)
    samples = sample_patches(picture, None, None, CLASSIC, corners)
    np.testing.assert_allclose(samples.values, classic_values(), rtol=1e-5)
    assert samples.evenness.max() < 1e-5


@pytest.mark.parametrize("layout", LAYOUTS.values(), ids=LAYOUTS)
@pytest.mark.parametrize("tilt", TILTS[1:])
def test_patches_of_a_fisheye_picture_are_what_was_painted(layout, tilt):
    """The chart spans up to 55 degrees from the axis, where a flat homography is far off."""
    colors = random_colors(layout)
    lens, middle = fisheye(focal_length_px=260.0), (0.1, -0.08, -0.42)
    picture, corners = fisheye_picture(layout, colors, lens, tilt, middle)
    samples = sample_patches(picture, None, None, layout, corners, lens)
    np.testing.assert_allclose(samples.values, colors, rtol=1e-3)
    if layout is SG:
        flat = sample_patches(picture, None, None, layout, corners)
        assert np.abs(flat.values / colors - 1.0).max() > 0.3


def test_corners_clicked_two_pixels_off_change_nothing():
    picture, corners = pinhole_picture(tilt=TILTS[1])
    off = corners + np.random.default_rng(4).uniform(-2.0, 2.0, (4, 2))
    samples = sample_patches(picture, None, None, CLASSIC, off)
    np.testing.assert_allclose(samples.values, classic_values(), rtol=1e-3)


def test_standard_error_covers_the_noise_of_independent_and_of_smoothed_pixels():
    picture, corners = pinhole_picture()
    rng = np.random.default_rng(3)
    noise = 0.02 * rng.standard_normal(picture.shape)
    smooth = noise.copy()
    for axis in (0, 1):
        smooth = sum(np.roll(smooth, k, axis) for k in (-1, 0, 1)) / 3.0
    for added in (noise, smooth):
        variance = np.full(picture.shape, added.var(), np.float32)
        noisy = (picture + added).astype(np.float32)
        samples = sample_patches(noisy, variance, None, CLASSIC, corners)
        pull = (samples.values - classic_values()) / samples.stddev
        # Of 9 blocks and 3 parameters: Student's t of 6 degrees of freedom, of deviation 1.22.
        assert 0.6 < np.sqrt(np.mean(pull**2)) < 1.5


def test_value_is_that_at_the_middle_where_light_falls_off():
    picture, corners = pinhole_picture(tilt=TILTS[1])
    lit = picture * np.linspace(0.5, 1.5, picture.shape[1], dtype=np.float32)[None, :, None]
    samples = sample_patches(lit, None, None, CLASSIC, corners)
    middle = chart_plane(corners, None, "chart").to_picture(CLASSIC.centers)[:, 0]
    light = np.interp(middle - 0.5, np.arange(picture.shape[1]), np.linspace(0.5, 1.5, 480))
    np.testing.assert_allclose(samples.values, classic_values() * light[:, None], rtol=2e-4)
    assert 0.005 < np.median(samples.evenness) < 0.05
    assert (samples.stddev > 1e-3 * samples.values).all()


def test_dust_and_glints_do_not_count():
    picture, corners = pinhole_picture()
    rng = np.random.default_rng(5)
    spots = rng.random(picture.shape[:2]) < 0.05
    picture[spots] = np.where(rng.random(spots.sum()) < 0.5, 0.0, 5.0)[:, None]
    samples = sample_patches(picture, None, None, CLASSIC, corners)
    np.testing.assert_allclose(samples.values, classic_values(), rtol=1e-3)
    assert 0.03 < samples.rejected.mean() < 0.07


def test_saturated_and_moved_pixels_are_counted():
    picture, corners = pinhole_picture()
    status = np.zeros(picture.shape[:2], np.uint8)
    status[picture.max(axis=2) > 0.75] = CLIPPED
    status[:, 240:] |= MOVED
    samples = sample_patches(picture, None, status, CLASSIC, corners)
    bright = classic_values().max(axis=1) > 0.75
    np.testing.assert_array_equal(samples.clipped, bright.astype(float))
    np.testing.assert_array_equal(samples.moved, CLASSIC.positions[:, 0] >= 3)


def test_chart_too_small_or_outside_is_refused_by_the_name_of_the_patch():
    picture, corners = pinhole_picture()
    with pytest.raises(
        ImageError, match=r"^chart: patch dark skin: its middle covers [0-9]+ pixels"
    ):
        sample_patches(picture, None, None, CLASSIC, 300.0 + 30.0 * UNIT_CORNERS)
    with pytest.raises(
        ImageError, match=r"^chart: patch .*: lies outside the picture of 480 x 360"
    ):
        sample_patches(picture, None, None, CLASSIC, corners + np.array([400.0, 0.0]))


# --- Development ---------------------------------------------------------------------------------


def scene_through(lens, rho, glare):
    """Return what a sensor sees of rho: vignetting, then a veil over the circle."""
    height, width = rho.shape[:2]
    x = np.arange(width) + 0.5 - lens.center_px[0]
    y = np.arange(height)[:, None] + 0.5 - lens.center_px[1]
    phi = np.hypot(x, y) / lens.focal_length_px
    inside = phi <= np.radians(lens.max_angle_deg)
    a2, a4 = lens.vignetting
    seen = np.where(inside[..., None], rho * (1.0 + a2 * phi**2 + a4 * phi**4)[..., None], 0.0)
    return (1.0 - glare) * seen + glare * seen[inside].mean(axis=0) * inside[..., None]


def test_photographs_become_camera_values_free_of_glare_and_vignetting(tmp_path, workers):
    """A bracket of three 14-bit photographs with noise; the patches within 0.3 %, the black 2 %."""
    lens = fisheye(glare=0.03)
    rho, corners = fisheye_picture(CLASSIC, classic_values(), lens, TILTS[1], (0.05, 0.02, -0.5))
    view = simulated_sensor.photograph(tmp_path, scene_through(lens, rho, 0.03), [1.0, 0.25, 0.06])
    chart = ColorChart(where="c", view=replace(view, lens=lens), layout="classic24")
    developed = develop(chart, workers, tmp_path)
    assert developed.lens.resolution == (600, 600)
    samples = sample_patches(
        developed.values, developed.variance, developed.status, CLASSIC, corners, developed.lens
    )
    relative = np.abs(samples.values / classic_values() - 1.0).max(axis=1)
    assert relative[:23].max() < 0.006
    assert relative[23] < 0.02
    pull = (samples.values - classic_values()) / samples.stddev
    assert np.sqrt(np.mean(pull**2)) < 1.5


def test_glare_left_in_shows(tmp_path, workers):
    lens = fisheye(glare=0.03)
    rho, corners = fisheye_picture(CLASSIC, classic_values(), lens, TILTS[0], (0.05, 0.02, -0.5))
    view = simulated_sensor.photograph(tmp_path, scene_through(lens, rho, 0.03), [1.0, 0.25])
    chart = ColorChart(where="c", view=replace(view, lens=replace(lens, glare=0.0)))
    developed = develop(chart, workers, tmp_path)
    samples = sample_patches(
        developed.values, developed.variance, developed.status, CLASSIC, corners, developed.lens
    )
    assert (samples.values / classic_values() - 1.0)[23].max() > 0.1


def test_floating_point_picture_is_taken_as_camera_values(tmp_path, workers):
    picture, _ = pinhole_picture()
    file = simulated_sensor.write_picture(tmp_path / "chart.exr", picture, "float")
    developed = develop(ColorChart(where="c", image_file=file), workers, tmp_path)
    np.testing.assert_array_equal(developed.values, picture)
    assert developed.variance is None
    assert developed.lens is None


@pytest.mark.parametrize("sample_type", ["uint8", "uint16"])
def test_picture_of_integers_is_refused(tmp_path, workers, sample_type):
    file = simulated_sensor.write_picture(tmp_path / "chart.png", np.ones((8, 8, 3)), sample_type)
    with pytest.raises(ImageError, match=f"chart.png: holds {sample_type}, .* chart:view"):
        develop(ColorChart(where="c", image_file=file), workers, tmp_path)


def test_picture_that_cannot_be_used_is_refused(tmp_path, workers):
    broken = np.ones((8, 8, 3))
    broken[3, 5] = np.nan
    file = simulated_sensor.write_picture(tmp_path / "nan.exr", broken, "float")
    with pytest.raises(ImageError, match=r"nan\.exr: the pixel at x 5, y 3 is"):
        develop(ColorChart(where="c", image_file=file), workers, tmp_path)
    with pytest.raises(LayerError, match=r"^c.usda </C>: names no picture of the chart"):
        develop(ColorChart(where="c.usda </C>"), workers, tmp_path)
    view = simulated_sensor.photograph(tmp_path, np.ones((8, 8, 3)), [1.0])
    with pytest.raises(LayerError, match="has both chart:view and chart:image:file"):
        develop(ColorChart(where="c", image_file=file, view=view), workers, tmp_path)
    raw = ColorChart(where="c", image_file=tmp_path / "chart.NEF")
    with pytest.raises(ImageError, match=r"chart\.NEF: is a raw photograph"):
        develop(raw, workers, tmp_path)


# --- Detection -----------------------------------------------------------------------------------


@pytest.mark.parametrize("tilt", [*TILTS, (5.0, 5.0, 90.0), (10.0, 0.0, -90.0)])
def test_chart_is_found_however_it_lies(tilt):
    picture, corners = pinhole_picture(tilt=tilt)
    found = find_corners(picture, CLASSIC, signals())
    words = {170.0: "upside down", 90.0: "turned left", -90.0: "turned right"}
    assert found.orientation.startswith(words.get(tilt[2], "upright"))
    assert np.abs(found.corners - corners).max() < 3.0
    np.testing.assert_allclose(found.samples.values, classic_values(), rtol=1e-3)


@pytest.mark.parametrize("light", ["A", "FL11"])
def test_chart_is_found_among_lamps_in_noise_through_a_fisheye(light):
    lens = fisheye(focal_length_px=400.0, resolution=(900, 880), center_px=np.array([455.0, 440.0]))
    picture, corners = fisheye_picture(
        CLASSIC, classic_values(light), lens, (12.0, -15.0, 5.0), (0.12, 0.05, -0.9), samples=2
    )
    rng = np.random.default_rng(6)
    picture *= 1.0 + 0.02 * rng.standard_normal(picture.shape)
    picture[40:120, 250:700] = 60.0
    picture[720:, :] *= 0.2
    found = find_corners(picture.astype(np.float32), CLASSIC, signals(light), lens=lens)
    assert np.abs(found.corners - corners).max() < 4.0
    np.testing.assert_allclose(found.samples.values, classic_values(light), rtol=0.01)


@pytest.mark.parametrize("what", ["no chart", "other colors", "mirrored"])
def test_what_is_not_the_chart_is_not_found(what):
    colors = classic_values()
    if what == "other colors":
        colors = colors[np.random.default_rng(7).permutation(24)]
    picture, _ = pinhole_picture(colors=colors)
    if what == "mirrored":
        picture = picture[:, ::-1].copy()
    if what == "no chart":
        picture[:] = np.random.default_rng(8).random((45, 60, 3)).repeat(8, 0).repeat(8, 1)
    with pytest.raises(LayerError, match=r"is not found in its picture, .* --corners"):
        find_corners(picture, CLASSIC, signals())


def smooth_reflectances(count, seed=1):
    """Return broad bumps on a base of their own, shape [count, 61]."""
    rng = np.random.default_rng(seed)
    nm = np.arange(400.0, 701.0, 5.0)
    middle, width = rng.uniform(400.0, 700.0, (count, 1)), rng.uniform(30.0, 120.0, (count, 1))
    base, height = rng.uniform(0.02, 0.3, (count, 1)), rng.uniform(0.1, 0.6, (count, 1))
    return base + height * np.exp(-0.5 * ((nm - middle) / width) ** 2)


@cache
def smooth_chart(name):
    """Return a picture of a chart of smooth reflectances, its corners, spectra and lens."""
    layout, lens = LAYOUTS[name], fisheye()
    spectra = smooth_reflectances(len(layout.names)) * lamp("D55")
    colors = spectra @ camera() / spectra.max()
    middle = (0.02, 0.01, -0.6)
    return *fisheye_picture(layout, colors, lens, TILTS[1], middle), spectra, lens


@pytest.mark.parametrize("layout", LAYOUTS.values(), ids=LAYOUTS)
@pytest.mark.parametrize(("column", "row", "turn"), [(0, 0, 0), (2, -1, 0), (-1, 3, 2), (1, 2, 1)])
def test_chart_is_found_in_a_grid_that_is_off_by_cells_and_turned(layout, column, row, turn):
    picture, corners, spectra, lens = smooth_chart(layout.name)
    plane = chart_plane(corners, lens, "chart")
    pitch = 2.0 * layout.half_size * (1.0 + layout.gap)
    # Its cells, seen as a grid of as many columns and rows that begins elsewhere.
    count = np.array([layout.columns, layout.rows])
    half = 0.5 / (1.0 + layout.gap)
    cell = UNIT_CORNERS * (count - 1 + 2.0 * half) - half
    quarter = np.linalg.matrix_power(np.array([[0, -1], [1, 0]]), turn)
    middle = 0.5 * (count - 1)
    begin = np.round(middle - quarter @ middle) + np.array([column, row])
    off = plane.to_picture(layout.centers[0] + pitch * (begin + cell @ quarter.T))
    found = find_in_lattice(picture, layout, chart_plane(off, lens, "grid"), fit_spectra(spectra))
    assert found is not None
    np.testing.assert_allclose(found[0], corners, atol=1e-6)
    assert found[1] > 0.2


def test_the_digital_sg_is_found():
    spectra = smooth_reflectances(140) * lamp("FL11")
    colors = spectra @ camera() / (spectra @ camera()).max()
    lens = fisheye(focal_length_px=420.0, resolution=(720, 720), center_px=np.array([361.0, 358.0]))
    middle = (0.02, 0.01, -0.62)
    picture, corners = fisheye_picture(SG, colors, lens, (6.0, -8.0, 5.0), middle, samples=2)
    found = find_corners(picture, SG, spectra, lens=lens)
    assert np.abs(found.corners - corners).max() < 1.0
    np.testing.assert_allclose(found.samples.values, colors, rtol=0.01)


# --- Checks --------------------------------------------------------------------------------------

LIGHTS = ["A", "FL2", "FL11", "D55", "LED-B3"]


def noisy(light, noise=0.01, seed=0):
    rng = np.random.default_rng(seed)
    return classic_values(light) * (1.0 + noise * rng.standard_normal((24, 3)))


@pytest.mark.parametrize("light", LIGHTS)
@pytest.mark.parametrize("noise", [0.0, 0.01, 0.03])
def test_chart_in_order_is_kept_whole(light, noise):
    notes: list[Note] = []
    for seed in range(5):
        check = check_patches(
            "c",
            CLASSIC.names,
            noisy(light, noise, seed),
            signals(light),
            layout=CLASSIC,
            notes=notes,
        )
        assert check.keep.all()
        assert check.typical_error < 0.004 + 1.5 * noise
    assert not notes


def reordered(values, how):
    """Return camera values as a chart in disorder gives them."""
    grid = values.reshape(4, 6, 3)
    return {
        "rotated by 180 degrees": grid[::-1, ::-1],
        "mirrored left to right": grid[:, ::-1],
        "mirrored top to bottom": grid[::-1],
        "listed column by column where the spectra are": grid.transpose(1, 0, 2),
        "listed from a chart turned to the left": np.rot90(grid),
        "listed from a chart turned to the right": np.rot90(grid, -1),
        "shifted by one patch towards the end": np.roll(values, 1, axis=0),
    }[how].reshape(24, 3)


@pytest.mark.parametrize("light", LIGHTS)
@pytest.mark.parametrize(
    "how",
    [
        "rotated by 180 degrees",
        "mirrored left to right",
        "mirrored top to bottom",
        "listed column by column where the spectra are",
        "listed from a chart turned to the left",
        "listed from a chart turned to the right",
        "shifted by one patch towards the end",
    ],
)
def test_wrong_order_is_named(light, how):
    with pytest.raises(LayerError, match=f"^c.usda </C>: the patches' camera values look {how}"):
        check_patches(
            "c.usda </C>",
            CLASSIC.names,
            reordered(noisy(light), how),
            signals(light),
            layout=CLASSIC,
        )


def test_spectra_listed_by_columns_are_named():
    by_columns = signals().reshape(4, 6, -1).transpose(1, 0, 2).reshape(24, -1)
    with pytest.raises(
        LayerError, match="row by row where the spectra are listed column by column"
    ):
        check_patches("c", CLASSIC.names, noisy("D55"), by_columns, layout=CLASSIC)


def test_reversed_list_without_a_layout_is_named():
    with pytest.raises(LayerError, match="look listed from the last to the first"):
        check_patches("c", CLASSIC.names, noisy("D55")[::-1], signals())


def test_shuffled_patches_are_refused():
    order = np.random.default_rng(9).permutation(24)
    with pytest.raises(
        LayerError, match=r"do not follow their spectra: half of them are off by .* linear"
    ):
        check_patches("c", CLASSIC.names, noisy("D55")[order], signals(), layout=CLASSIC)


@pytest.mark.parametrize("light", LIGHTS)
@pytest.mark.parametrize("pair", [(2, 12), (0, 1), (14, 16), (18, 23)])
def test_swapped_pair_is_named(light, pair):
    values = noisy(light)
    values[list(pair)] = values[list(pair[::-1])]
    first, second = (re.escape(CLASSIC.names[k]) for k in pair)
    with pytest.raises(LayerError, match=f"patches {first} and {second} look swapped"):
        check_patches("c", CLASSIC.names, values, signals(light), layout=CLASSIC)


def test_outlier_is_left_out_and_named():
    values, notes = noisy("D55"), []
    values[7] *= [1.5, 1.2, 0.9]
    check = check_patches("c", CLASSIC.names, values, signals(), notes=notes)
    np.testing.assert_array_equal(np.flatnonzero(~check.keep), [7])
    assert np.isnan(check.errors[7])
    assert [note.code for note in notes] == ["patch-outlier"]
    assert "left out patch purplish blue: its camera value is" in notes[0].message


def test_saturated_and_black_patches_are_left_out_and_named():
    values, notes = noisy("D55"), []
    clipped = np.zeros(24)
    clipped[18:20] = [1.0, 0.02]
    values[18:20] = 0.6
    values[23] = 1e-4
    check = check_patches(
        "c",
        CLASSIC.names,
        values,
        signals(),
        layout=CLASSIC,
        stddev=np.full((24, 3), 1e-3),
        clipped=clipped,
        notes=notes,
    )
    np.testing.assert_array_equal(np.flatnonzero(~check.keep), [18, 19, 23])
    assert [note.code for note in notes] == ["patch-saturated", "patch-black"]
    assert "white 9.5 (.05 D), neutral 8 (.23 D); add a shorter one" in notes[0].message


def test_rotation_is_named_though_patches_are_saturated():
    clipped = np.zeros(24)
    clipped[[3, 5]] = 1.0
    values = reordered(noisy("FL2"), "rotated by 180 degrees")
    values[[3, 5]] = 7.0
    with pytest.raises(LayerError, match="look rotated by 180 degrees"):
        check_patches("c", CLASSIC.names, values, signals("FL2"), layout=CLASSIC, clipped=clipped)


def test_rotation_is_named_where_patches_are_missing_and_listed_in_any_order():
    listed = np.random.default_rng(10).permutation(24)[:15]
    values = reordered(noisy("FL2"), "rotated by 180 degrees")[listed]
    cells = [f"{'ABCD'[k // 6]}{k % 6 + 1}" for k in listed]
    with pytest.raises(LayerError, match="look rotated by 180 degrees"):
        check_patches("c", cells, values, signals("FL2")[listed], layout=CLASSIC)


def test_doubtful_chart_is_kept_and_noted():
    notes: list[Note] = []
    check = check_patches("c", CLASSIC.names, noisy("D55") ** 0.8, signals(), notes=notes)
    assert check.keep.all()
    assert [note.code for note in notes] == ["patches-doubtful"]


@pytest.mark.parametrize("light", LIGHTS)
def test_values_encoded_for_a_display_are_refused(light):
    with pytest.raises(LayerError, match=r"do not follow their spectra: .* pictures are linear"):
        check_patches("c", CLASSIC.names, noisy(light) ** (1 / 2.2), signals(light))


def test_fewer_than_three_patches_are_refused():
    clipped = np.ones(24)
    clipped[[0, 4]] = 0.0
    with pytest.raises(
        LayerError, match=r"^c: 2 of its 24 patches can be used, dark skin, blue fl"
    ):
        check_patches("c", CLASSIC.names, noisy("D55"), signals(), clipped=clipped)


@pytest.mark.parametrize("light", LIGHTS)
def test_greys_alone_are_refused_as_of_one_color(light):
    with pytest.raises(LayerError, match="the 6 patches that can be used are nearly of one or two"):
        check_patches("c", CLASSIC.names[18:], noisy(light)[18:], signals(light)[18:])


@pytest.mark.parametrize("scale", [1e-6, 1.0, 1e5])
def test_units_do_not_matter(scale):
    first = check_patches("c", CLASSIC.names, noisy("D55"), signals())
    other = check_patches("c", CLASSIC.names, scale * noisy("D55"), signals() / scale)
    np.testing.assert_allclose(first.errors, other.errors, rtol=1e-6)


@pytest.mark.realdata
def test_order_is_told_for_seventeen_measured_cameras_under_five_lights(realdata):
    """The margin of ``LARGEST_ERROR``: printed, and the cameras are used for nothing else here."""
    import scipy.io

    wavelength = np.arange(400, 701, 5)
    table = scipy.io.loadmat(realdata / "charts" / "gretagDigitalColorSG.mat")
    sg = np.array([np.interp(wavelength, table["wavelength"].ravel(), r) for r in table["data"].T])
    rng = np.random.default_rng(11)
    right, wrong = {0.01: [], 0.03: []}, []
    for file in sorted((realdata / "cameras").glob("*.json")):
        data = json.loads(file.read_text())["spectral_data"]["data"]["main"]
        sensitivity = np.array([data[str(nm)] for nm in wavelength])
        for light in LIGHTS:
            for layout, reflectance in ((CLASSIC, classic_spectra()), (SG, sg)):
                fit = fit_spectra(reflectance * lamp(light))
                values = (reflectance * lamp(light)) @ sensitivity
                for noise, found in right.items():
                    with_noise = values * (1.0 + noise * rng.standard_normal(values.shape))
                    found.append(fit.error(with_noise))
                orders = [*laid_out_otherwise(layout), *listed_otherwise(len(values))]
                orders.append(("shuffled", rng.permutation(len(values))))
                wrong += [fit.error(values[order]) for _, order in orders]
    print({noise: max(found) for noise, found in right.items()}, min(wrong), np.median(wrong))
    assert max(right[0.01]) < 0.2 * LARGEST_ERROR
    assert max(right[0.03]) < 0.4 * LARGEST_ERROR
    assert min(wrong) > 1.5 * LARGEST_ERROR
