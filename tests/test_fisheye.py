"""Fisheye projections: on the host, and as the kernels know them."""

from __future__ import annotations

import numpy as np
import pytest
import warp as wp

from usdskin.capture.views.panorama import lens_tables
from usdskin.errors import LayerError
from usdskin.fisheye import (
    angle_to_radius,
    check_lens,
    max_radius,
    pixel_solid_angle,
    project,
    radius_slope,
    radius_to_angle,
    scaled,
    unproject,
    vignetting,
)
from usdskin.prims.lenses import FisheyeLens
from usdskin.warp_kernels import fisheye

HOST_PX = 1e-9
KERNEL_PX = 1e-3

LENSES = {
    "equidistant": ("equidistant", 90.0, ()),
    "equidistant 220": ("equidistant", 110.0, ()),
    "equidistant 360": ("equidistant", 180.0, ()),
    "equisolid": ("equisolid", 92.5, ()),
    "equisolid 360": ("equisolid", 180.0, ()),
    "stereographic": ("stereographic", 90.0, ()),
    "stereographic 290": ("stereographic", 145.0, ()),
    "orthographic": ("orthographic", 90.0, ()),
    "opencv": ("opencv", 95.0, (0.03, 0.002, -0.004, 0.0006)),
    "opencv barrel": ("opencv", 110.0, (-0.02, 0.003, -0.001, 0.0002)),
    "opencv undistorted": ("opencv", 150.0, (0.0, 0.0, 0.0, 0.0)),
}


def make_lens(name: str, radius: float = 1800.0) -> FisheyeLens:
    """Return a lens whose circle has ``radius`` [px] in a picture of 20 megapixels."""
    projection, angle, k = LENSES[name]
    lens = FisheyeLens(
        projection,
        1.0,
        np.array([2739.37, 1821.81]),
        (5472, 3648),
        distortion=np.array([*k, 0.0, 0.0, 0.0, 0.0][:4]),
        max_angle_deg=angle,
        vignetting=np.array([-0.05, 0.004]),
    )
    focal = radius / max_radius(lens)
    return FisheyeLens(
        projection,
        focal,
        lens.center_px,
        lens.resolution,
        lens.distortion,
        angle,
        lens.vignetting,
    )


def positions(lens: FisheyeLens, count: int = 20000) -> np.ndarray:
    """Return positions all over the circle, its rim and its centre among them."""
    rng = np.random.default_rng(3)
    radius = max_radius(lens) * np.sqrt(rng.random(count))
    radius[:4] = [0.0, 1e-6, max_radius(lens), max_radius(lens) * (1.0 - 1e-9)]
    around = 2.0 * np.pi * rng.random(count)
    offset = np.stack([radius * np.cos(around), radius * np.sin(around)], axis=-1)
    return lens.center_px + offset


# --- Laws --------------------------------------------------------------------------------------


@pytest.mark.parametrize("name", LENSES)
def test_pixel_to_ray_to_pixel_is_the_pixel(name):
    lens = make_lens(name)
    check_lens(lens, "lens")
    at = positions(lens)
    rays = unproject(lens, at)
    np.testing.assert_allclose(np.linalg.norm(rays, axis=-1), 1.0, atol=1e-14)
    assert np.abs(project(lens, rays) - at).max() < HOST_PX


@pytest.mark.parametrize("name", LENSES)
def test_rays_of_any_length_project_alike(name):
    lens = make_lens(name)
    rays = unproject(lens, positions(lens, 200))
    assert np.abs(project(lens, 1e-3 * rays) - project(lens, 7e5 * rays)).max() < HOST_PX


@pytest.mark.parametrize("name", LENSES)
def test_slope_is_the_derivative_of_image_height(name):
    lens = make_lens(name)
    phi = np.linspace(0.01, 0.99, 50) * np.radians(lens.max_angle_deg)
    step = 1e-5
    numeric = (angle_to_radius(lens, phi + step) - angle_to_radius(lens, phi - step)) / (2 * step)
    np.testing.assert_allclose(radius_slope(lens, phi), numeric, rtol=1e-7)


@pytest.mark.parametrize("name", [name for name in LENSES if name != "orthographic"])
def test_pixels_add_up_to_the_solid_angle_of_the_circle(name):
    """2 pi (1 - cos phi_max), by the midpoint rule over polar coordinates of the picture."""
    lens = make_lens(name)
    count = 4000
    radius = (np.arange(count) + 0.5) / count * max_radius(lens)
    at = lens.center_px + np.stack([radius * 0.6, radius * 0.8], axis=-1)
    total = (pixel_solid_angle(lens, at) * 2.0 * np.pi * radius).sum() * max_radius(lens) / count
    expected = 2.0 * np.pi * (1.0 - np.cos(np.radians(lens.max_angle_deg)))
    np.testing.assert_allclose(total, expected, rtol=2e-6)


# --- Closed forms and outside values -----------------------------------------------------------


@pytest.mark.parametrize(
    ("projection", "height"),
    [
        ("equidistant", np.pi / 3.0),
        ("equisolid", 1.0),
        ("stereographic", 2.0 / np.sqrt(3.0)),
        ("orthographic", np.sqrt(3.0) / 2.0),
        ("opencv", np.pi / 3.0),
    ],
)
def test_image_height_at_60_degrees(projection, height):
    lens = FisheyeLens(projection, 100.0, np.array([200.0, 200.0]), (400, 400))
    np.testing.assert_allclose(angle_to_radius(lens, np.pi / 3.0), 100.0 * height, rtol=1e-15)
    np.testing.assert_allclose(radius_to_angle(lens, 100.0 * height), np.pi / 3.0, rtol=1e-15)


def test_solid_angle_of_equidistant_pixels_is_that_of_the_textbook():
    """sin(phi) / (phi f^2): 1, .955, .827, .637 at 0, 30, 60, 90 degrees."""
    lens = FisheyeLens("equidistant", 100.0, np.array([200.0, 200.0]), (400, 400))
    phi = np.radians([0.0, 30.0, 60.0, 90.0])
    at = lens.center_px + np.stack([100.0 * phi, 0.0 * phi], axis=-1)
    found = pixel_solid_angle(lens, at) * 100.0**2
    np.testing.assert_allclose(found, [1.0, 0.955, 0.827, 0.637], atol=5e-4)


def test_opencv_lens_is_that_of_opencv():
    """OpenCV counts from the middle of the first pixel, and looks along +Z with y down."""
    import cv2

    lens = make_lens("opencv")
    rays = unproject(lens, positions(lens, 500)[4:])
    rays = rays[rays[:, 2] < -0.05]
    focal, (cx, cy) = lens.focal_length_px, lens.center_px - 0.5
    matrix = np.array([[focal, 0.0, cx], [0.0, focal, cy], [0.0, 0.0, 1.0]])
    points = (rays * [1.0, -1.0, -1.0])[None]
    theirs, _ = cv2.fisheye.projectPoints(points, np.zeros(3), np.zeros(3), matrix, lens.distortion)
    assert np.abs(project(lens, rays) - (theirs[0] + 0.5)).max() < 1e-6


def test_image_x_runs_right_and_y_down():
    """The camera looks along -Z with +Y up."""
    lens = FisheyeLens("equidistant", 100.0, np.array([180.0, 220.0]), (400, 400))
    rays = np.array([[0.0, 0.0, -1.0], [1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [1.0, 1.0, -np.sqrt(2)]])
    quarter = 50.0 * np.pi
    diagonal = 25.0 * np.pi / np.sqrt(2.0)
    expected = [[0, 0], [quarter, 0], [0, -quarter], [diagonal, -diagonal]]
    assert np.abs(project(lens, rays) - lens.center_px - expected).max() < HOST_PX


def test_beyond_the_largest_angle_there_is_no_picture():
    lens = FisheyeLens(
        "equidistant", 100.0, np.array([200.0, 200.0]), (400, 400), max_angle_deg=80.0
    )
    rays = [[0.0, np.sin(angle), -np.cos(angle)] for angle in np.radians([79.9, 80.1, 180.0])]
    assert np.isnan(project(lens, rays)).all(axis=-1).tolist() == [False, True, True]
    down = max_radius(lens) + np.array([0.01, -0.01])
    at = lens.center_px + np.stack([np.zeros(2), down], axis=-1)
    assert np.isnan(unproject(lens, at)).all(axis=-1).tolist() == [True, False]
    assert np.isnan(pixel_solid_angle(lens, at)).tolist() == [True, False]


def test_vignetting_is_an_even_polynomial():
    lens = make_lens("equidistant")
    np.testing.assert_allclose(vignetting(lens, 1.2), 1.0 - 0.05 * 1.44 + 0.004 * 1.44**2)
    assert vignetting(lens, 0.0) == 1.0


# --- Pictures of another size ------------------------------------------------------------------


def test_reduced_pictures_show_the_same():
    lens = make_lens("opencv")
    small = scaled(lens, (1368, 912), "shoot.usda </View>")
    rays = unproject(lens, positions(lens, 500))
    assert np.abs(4.0 * project(small, rays) - project(lens, rays)).max() < HOST_PX
    assert scaled(lens, lens.resolution, "") is lens
    rounded = scaled(lens, (1000, 667), "")  # 666.67 rows
    assert rounded.center_px[1] == pytest.approx(lens.center_px[1] * 667 / 3648)


def test_cropped_pictures_are_refused():
    message = (
        r"shoot.usda </View>: .* 5472 x 3078 .* fisheye:resolution is 5472 x 3648.* not cropped"
    )
    with pytest.raises(LayerError, match=message):
        scaled(make_lens("opencv"), (5472, 3078), "shoot.usda </View>")


# --- Lenses that cannot be ---------------------------------------------------------------------


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        (("orthographic", 95.0, (), ()), "95 deg, but image height stops growing at 90 deg"),
        (("stereographic", 180.0, (), ()), "180 deg, but image height stops growing at 180 deg"),
        # phi - 0.2 phi^3 turns back where 0.6 phi^2 = 1: 73.97 degrees.
        (("opencv", 90.0, (-0.2, 0.0, 0.0, 0.0), ()), "stops growing at 73.97 deg"),
        (("equidistant", 0.0, (), ()), "maxAngle is 0 deg"),
        (("equidistant", 200.0, (), ()), "maxAngle is 200 deg"),
        # 1 - 0.4 phi^2 is 0 at 90.59 degrees.
        (("equidistant", 95.0, (), (-0.4,)), "falls to 0 at 90.59 deg"),
    ],
)
def test_lens_that_ends_before_its_largest_angle_is_refused_naming_it(changes, message):
    projection, angle, k, v = changes
    lens = FisheyeLens(
        projection,
        900.0,
        np.array([2000.0, 1500.0]),
        (4000, 3000),
        np.array([*k, 0.0, 0.0, 0.0, 0.0][:4]),
        angle,
        np.array(v),
    )
    with pytest.raises(LayerError, match=f"lens.usda </Lens>: .*{message}"):
        check_lens(lens, "lens.usda </Lens>")


def test_axis_outside_the_picture_is_refused():
    lens = FisheyeLens("equidistant", 900.0, np.array([4100.0, 1500.0]), (4000, 3000))
    with pytest.raises(LayerError, match=r"fisheye:center is \(4100, 1500\), outside the picture"):
        check_lens(lens, "lens.usda </Lens>")


# --- In kernels --------------------------------------------------------------------------------

wp.set_module_options({"enable_backward": False})


@wp.kernel
def _probe_kernel(
    lens: fisheye.Lens,
    ray: wp.array[wp.vec3f],
    at: wp.array[wp.vec2f],
    projected_out: wp.array[wp.vec4f],
    back_out: wp.array[wp.vec4f],
):
    i = wp.tid()
    projected_out[i] = fisheye.project(lens, ray[i])
    back_out[i] = fisheye.project(lens, fisheye.unproject(lens, at[i]))


@pytest.mark.parametrize("name", [name for name in LENSES if "360" not in name])
def test_kernels_project_as_the_host_does(name, device):
    """To 1e-3 px, and with the host's vignetting; 360 degree lenses draw one point as a circle."""
    lens = make_lens(name)
    at = positions(lens)
    at[2:4] = lens.center_px + (max_radius(lens) - 0.01) * np.eye(2)
    rays = unproject(lens, at)
    projected = wp.empty(len(at), dtype=wp.vec4f, device=device)
    back = wp.empty(len(at), dtype=wp.vec4f, device=device)
    wp.launch(
        _probe_kernel,
        dim=len(at),
        inputs=[
            lens_tables(lens, device),
            wp.array(rays.astype(np.float32), dtype=wp.vec3f, device=device),
            wp.array(at.astype(np.float32), dtype=wp.vec2f, device=device),
        ],
        outputs=[projected, back],
        device=device,
    )
    angle = radius_to_angle(lens, np.hypot(*(at - lens.center_px).T))
    assert np.abs(projected.numpy()[:, :2] - at).max() < KERNEL_PX
    assert np.abs(back.numpy()[:, :2] - at).max() < KERNEL_PX
    np.testing.assert_allclose(projected.numpy()[:, 2], 1.0 / vignetting(lens, angle), rtol=1e-5)
