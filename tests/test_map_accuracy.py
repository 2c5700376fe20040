"""The light a picture reads at a normal, against dense float64 quadrature (``light_oracle``)."""

from __future__ import annotations

import functools
from collections.abc import Callable

import numpy as np
import pytest
import warp as wp
from light_oracle import (
    Oracle,
    directions,
    normals_at_kinks,
    overcast_sky,
    random_normals,
    room_with_a_lamp,
    sky_with_sun,
)
from numpy.typing import NDArray

from usdskin.device import Workers, open_workers
from usdskin.render.environment import build_environment
from usdskin.render.light_maps import LightField, build_light_field, dome_environment
from usdskin.render.lights import DomeLight, Lights
from usdskin.render.texels import factorize
from usdskin.render.zonal_maps import MAP_ERROR_TARGET, integrate_normals, to_device
from usdskin.warp_kernels import structs
from usdskin.warp_kernels.diffuse import diffuse_light
from usdskin.warp_kernels.lookup import frame_coordinates

FloatArray = NDArray[np.float64]

WRAPS = (0.0, 0.3, 0.7, 1.0)
BOUND = 1.0e-3
"""Of the peak over all normals: DESIGN section 7."""

SPLIT_BOUND = 1.0e-3
"""Of the peak of J2, for its two parts."""

TURN = np.array([[0.36, 0.48, -0.8], [-0.8, 0.6, 0.0], [0.48, 0.64, 0.6]])
"""A rotation that no axis survives."""


# --- The oracle ----------------------------------------------------------------------------------


def test_the_oracle_knows_the_closed_forms():
    normals = random_normals(6, 3)
    white = Oracle(np.ones((16, 32, 1)), TURN)
    for wrap in WRAPS:
        np.testing.assert_allclose(white.integrate(normals, wrap), np.pi * (1.0 + wrap), rtol=2e-5)
    np.testing.assert_allclose(white.integrate(normals, 0.0, step=True), 2 * np.pi, rtol=1e-4)
    upper = Oracle((np.arange(64) < 32)[:, None, None] * np.ones((64, 128, 1)), np.eye(3))
    cosine = normals[:, 1:2]  # a half sphere's irradiance on a plane tilted from it
    np.testing.assert_allclose(
        upper.integrate(normals, 0.0), np.pi * (1.0 + cosine) / 2.0, rtol=2e-5
    )


# --- What a picture reads ----------------------------------------------------------------------


@wp.kernel(enable_backward=False)
def _look_up_kernel(
    lights: structs.Lights,
    normal: wp.array[wp.vec3f],
    wrap_set: wp.int32,
    light_out: wp.array3d[wp.vec4f],
):
    """Read J1, J2 and H as the picture kernels do. Launch dimension: [normal_count]."""
    i = wp.tid()
    n = normal[i]
    at = wp.vec2f(0.0, 0.0)
    for group in range(lights.group_count):
        at = frame_coordinates(lights, group, n, at)
        light = diffuse_light(lights, wrap_set, 3, group, n, at)
        light_out[0, i, group] = light.lambert
        light_out[1, i, group] = light.wrap
        light_out[2, i, group] = light.front


def look_up(
    field: LightField, normals: NDArray, wrap_set: int, channels: int, device: str
) -> FloatArray:
    """J1, J2 and H at normals, shape [3, count, channels]."""
    groups = field.device_lights.group_count
    out = wp.zeros((3, len(normals), groups), dtype=wp.vec4f, device=device)
    given = wp.array(normals.astype(np.float32), dtype=wp.vec3f, device=device)
    wp.launch(
        _look_up_kernel,
        dim=len(normals),
        inputs=[field.device_lights, given, wrap_set],
        outputs=[out],
        device=device,
    )
    values = out.numpy().astype(np.float64).reshape(3, len(normals), -1)
    return values[:, :, :channels]


@pytest.fixture
def workers(device: str) -> Workers:
    # Debug builds of concurrent launches share Warp's static tile pointer, and crash.
    return open_workers(device, threads=1 if wp.config.mode == "debug" else None)


def dome(coefficients: NDArray, basis: FloatArray | None = None) -> DomeLight:
    rank = coefficients.shape[2]
    basis = np.eye(rank) if basis is None else basis
    return DomeLight("/dome", coefficients.astype(np.float32), basis, TURN, False)


def as_stored(normals: FloatArray) -> FloatArray:
    """The float32 normals a kernel is given, so that rounding them is no error of the map."""
    return normals.astype(np.float32).astype(np.float64)


Environment = Callable[[], tuple[FloatArray, FloatArray]]

ENVIRONMENTS = pytest.mark.parametrize(
    "environment",
    [
        pytest.param(overcast_sky, id="sky"),
        pytest.param(room_with_a_lamp, id="room"),
        pytest.param(sky_with_sun, id="sun"),
    ],
)


@functools.cache
def truth(
    environment: Environment,
) -> tuple[DomeLight, FloatArray, FloatArray, FloatArray, list[FloatArray]]:
    """A dome, normals that matter, the brightest first, and J1, H and every wrap's J2 at them."""
    values, lamp = environment()
    light = dome(values)
    toward = TURN @ lamp
    normals = as_stored(
        np.concatenate([toward[None], random_normals(20, 1), normals_at_kinks(toward, WRAPS, 6)])
    )
    oracle = Oracle(light.coefficients, TURN)
    half = oracle.integrate(normals, 0.0, step=True)
    wrapped = [oracle.integrate(normals, wrap) for wrap in WRAPS]
    return light, normals, wrapped[WRAPS.index(0.0)], half, wrapped


def share_of_peak(found: FloatArray, exact: FloatArray, peak: FloatArray) -> float:
    return float((np.abs(found - exact).max(axis=0) / peak.max(axis=0)).max())


@ENVIRONMENTS
def test_the_light_at_a_normal_is_the_integral_within_a_thousandth_of_the_peak(
    environment: Environment, workers: Workers
):
    light, normals, lambert, _, wraps = truth(environment)
    field = build_light_field(Lights((light,), ()), WRAPS, workers, 3)
    for index, (wrap, wrapped) in enumerate(zip(WRAPS, wraps, strict=True)):
        found = look_up(field, normals, index, 3, workers.device)
        assert share_of_peak(found[0], lambert, lambert) <= BOUND, f"J1, l = {wrap}"
        assert share_of_peak(found[1], wrapped, wrapped) <= BOUND, f"J2, l = {wrap}"


@ENVIRONMENTS
def test_the_wrap_term_splits_into_light_from_before_and_from_behind(
    environment: Environment, workers: Workers
):
    """J2front = (J1 + l H)/(1 + l) is the part with N.L > 0, J2back is the rest.

    H jumps where a texel crosses the horizon, which no map of nodes follows: hence a wider bound.
    """
    light, normals, lambert, half, wraps = truth(environment)
    field = build_light_field(Lights((light,), ()), WRAPS, workers, 3, split=True)
    for index, (wrap, wrapped) in enumerate(zip(WRAPS, wraps, strict=True)):
        front = (lambert + wrap * half) / (1.0 + wrap)
        j1, j2, h = look_up(field, normals, index, 3, workers.device)
        found = (j1 + wrap * h) / (1.0 + wrap)
        assert share_of_peak(found, front, wrapped) <= SPLIT_BOUND, f"front, l = {wrap}"
        assert share_of_peak(j2 - found, wrapped - front, wrapped) <= SPLIT_BOUND, (
            f"back, l = {wrap}"
        )


def many_lamps() -> tuple[FloatArray, FloatArray]:
    """Twenty lamps of all strengths in a dark room: more kinks than lamps are taken out."""
    random = np.random.default_rng(12)
    room = np.full((128, 256, 3), 0.05)
    for strength in 2.0 ** -np.arange(20):
        i, j = random.integers(8, 118), random.integers(0, 252)
        room[i : i + 3, j : j + 3] = 4000.0 * strength * random.uniform(0.5, 1.0, 3)
    return room, np.array([0.0, 1.0, 0.0])


def noise() -> tuple[FloatArray, FloatArray]:
    return np.random.default_rng(6).exponential(1.0, (96, 192, 3)) ** 3, np.array([0.0, 0.0, 1.0])


@pytest.mark.parametrize("environment", [noise, many_lamps, room_with_a_lamp, overcast_sky])
@pytest.mark.parametrize("wrap", [0.0, 0.3])
def test_the_error_a_map_reports_is_no_smaller_than_what_others_find(
    environment: Environment, wrap: float, workers: Workers
):
    """Interpolation alone: the map against the same tree at the normal itself."""
    values, lamp = environment()
    light = dome(values)
    field = build_light_field(Lights((light,), ()), (wrap,), workers, 3)
    toward = TURN @ lamp
    normals = as_stored(
        np.concatenate([random_normals(4000, 8), normals_at_kinks(toward, (wrap,), 400)])
    )
    everything = look_up(field, normals, 0, 3, workers.device)[:2]
    field.device_lights.map_offset.fill_(-1)
    smooth = everything - look_up(field, normals, 0, 3, workers.device)[:2]
    tree = to_device(dome_environment(light), workers.device)
    exact = integrate_normals(tree, normals @ TURN, wrap, 1, workers)[:2, 0, :, :3]
    error = np.linalg.norm(smooth - exact, axis=-1).max()
    measured = error / np.linalg.norm(everything, axis=-1).max()
    rounding = 2e-6
    assert field.map_errors[0] >= measured / 1.5 - rounding
    assert field.map_errors[0] <= MAP_ERROR_TARGET


# --- Few channels are all bands ----------------------------------------------------------------


def spectra(rank: int) -> FloatArray:
    """Lamp-like spectra on 61 bands: smooth curves with lines of one band each."""
    random = np.random.default_rng(rank)
    nm = np.linspace(400.0, 700.0, 61)
    middle, width = random.uniform(400, 700, (rank, 1)), random.uniform(20, 120, (rank, 1))
    curves = np.exp(-0.5 * ((nm - middle) / width) ** 2) + 0.05
    curves[np.arange(rank), random.integers(0, 61, rank)] += 3.0
    return curves


RANKS = pytest.mark.parametrize("rank", [3, 6, 10])


@RANKS
@pytest.mark.parametrize("wrap", WRAPS)
def test_factored_light_equals_61_bands_through_the_same_tree(
    rank: int, wrap: float, workers: Workers
):
    basis = np.linalg.qr(spectra(rank).T)[0].T  # orthonormal: both trees weigh texels alike
    random = np.random.default_rng(2)
    weights = random.exponential(1.0, (96, 192, rank)) ** 3 @ np.linalg.inv(basis @ spectra(rank).T)
    normals = random_normals(50, 5)
    found = []
    for values in (weights, weights @ basis):
        environment = build_environment(
            values.astype(np.float32), np.ones(values.shape[2]), TURN, max_lamps=0
        )
        tree = to_device(environment, workers.device)
        groups = -(-values.shape[2] // 4)
        light = integrate_normals(tree, normals, wrap, groups, workers)
        light = light.transpose(0, 2, 1, 3).reshape(3, len(normals), -1)[:, :, : values.shape[2]]
        found.append(light.astype(np.float64))
    factored, brute = found[0] @ basis, found[1]
    error = np.abs(factored - brute) / np.abs(brute).max(axis=-1, keepdims=True)
    assert error.max() <= 1e-5


@RANKS
def test_factored_skin_equals_61_bands_in_float64(rank: int, workers: Workers):
    """Texels that the field takes out one by one, so that nothing but the factoring is between."""
    random = np.random.default_rng(rank)
    height, count = 512, 48
    rows, columns = random.integers(100, 412, count), random.integers(0, 2 * height, count)
    weights = random.exponential(1.0, (count, rank)) + 0.5
    image = np.zeros((height, 2 * height, rank), np.float32)
    image[rows, columns] = weights
    basis = spectra(rank)
    field = build_light_field(Lights((dome(image, basis),), ()), WRAPS, workers, 61)
    normals = as_stored(random_normals(60, 11))
    nm = np.linspace(0.0, 1.0, 61)
    alpha, albedo, scattering = 0.6, 0.2 + 0.5 * nm**2, 0.9 * nm + 0.1 * np.sin(9 * nm) ** 2
    channel = field.basis.reshape(-1, 61)

    part = (np.arange(32) + 0.5) / 32
    top, bottom = np.cos(np.pi * rows / height), np.cos(np.pi * (rows + 1) / height)
    polar = np.arccos(top[:, None] + (bottom - top)[:, None] * part)
    azimuth = np.pi * (columns[:, None] + part) / height
    toward = directions(azimuth[:, None, :].repeat(32, 1), polar[:, :, None].repeat(32, 2))
    x = np.einsum("tijk,nk->ntij", toward, normals @ TURN)
    radiance = image[rows, columns].astype(np.float64) @ basis
    flux = radiance * ((top - bottom) * np.pi / height)[:, None]
    for index, wrap in enumerate(WRAPS):
        lambert = np.maximum(x, 0.0).mean((2, 3)) @ flux
        wrapped = (np.maximum(x + wrap, 0.0) / (1.0 + wrap)).mean((2, 3)) @ flux
        brute = alpha / np.pi * albedo * (lambert + scattering * wrapped)
        j1, j2, _ = look_up(field, normals, index, len(channel), workers.device) @ channel
        factored = alpha / np.pi * albedo * (j1 + scattering * j2)
        peak = brute.max(axis=-1, keepdims=True)
        is_lit = peak[:, 0] > 0.03 * peak.max()  # where flat texels are good enough
        assert (np.abs(factored - brute) / peak)[is_lit].max() <= 1e-5, f"l = {wrap}"


@RANKS
def test_a_spectral_map_is_factored_at_its_rank_without_loss(rank: int):
    random = np.random.default_rng(3)
    pixels = (random.exponential(1.0, (4000, rank)) ** 2 @ spectra(rank)).astype(np.float32)
    coefficients, basis = factorize(pixels)
    assert len(basis) == rank
    error = np.abs(coefficients.astype(np.float64) @ basis - pixels)
    assert (error / pixels.max(axis=1, keepdims=True)).max() <= 1e-5
