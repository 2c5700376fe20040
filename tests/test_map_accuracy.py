"""The light a picture reads at a normal, against dense float64 quadrature that shares no code.

The oracle knows only DESIGN section 2: a texel of a latlong map is a constant patch of the sphere.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest
import warp as wp
from numpy.typing import NDArray

from usdskin.render.device import Workers, open_workers
from usdskin.render.environment import build_environment
from usdskin.render.light_maps import LightField, build_light_field, dome_environment
from usdskin.render.lights import DomeLight, Lights
from usdskin.render.texels import factorize
from usdskin.render.zonal_maps import MAP_ERROR_TARGET, integrate_normals, to_device
from usdskin.warp_kernels import structs
from usdskin.warp_kernels.lookup import latlong_coordinates
from usdskin.warp_kernels.skin import diffuse_light

FloatArray = NDArray[np.float64]

WRAPS = (0.0, 0.3, 0.7, 1.0)
BOUND = 1.0e-3
"""Of the peak over all normals: DESIGN section 7."""

SPLIT_BOUND = 5.0e-3
"""Of the peak of J2, for its two parts."""

TURN = np.array([[0.36, 0.48, -0.8], [-0.8, 0.6, 0.0], [0.48, 0.64, 0.6]])
"""A rotation that no axis survives."""


# --- The oracle --------------------------------------------------------------------------------


def directions(azimuth: FloatArray, polar: FloatArray) -> FloatArray:
    """UsdLux: u = 0.5 is +Z, u = 0.25 is +X, v = 0 is +Y; azimuth = 2 pi u."""
    return np.stack(
        [np.sin(polar) * np.sin(azimuth), np.cos(polar), -np.sin(polar) * np.cos(azimuth)], -1
    )


class Oracle:
    """Integrals over the texels of a latlong map, in float64.

    On either side of its kink the kernel is linear in N.L, so a texel counts with Int dL and
    Int L dL (Gauss-Legendre); a texel that the kink may cross is split into parts of equal area.
    """

    def __init__(self, values: NDArray, to_world: FloatArray):
        finer = -(-64 // len(values))  # small texels are flat, and a split one is not missed
        self.values = values.astype(np.float64).repeat(finer, axis=0).repeat(finer, axis=1)
        self.to_world = to_world
        height, width = self.values.shape[:2]
        x, w = np.polynomial.legendre.leggauss(6)
        step_polar, step = np.pi / height, 2.0 * np.pi / width
        polar = step_polar * (np.arange(height)[:, None] + 0.5 + 0.5 * x)
        azimuth = step * (np.arange(width)[:, None] + 0.5 + 0.5 * x)
        row, column = 0.5 * step_polar * w * np.sin(polar), 0.5 * step * w
        flat = np.full(width, step)
        self.area = row.sum(1)[:, None] * flat
        sine, cosine = (row * np.sin(polar)).sum(1)[:, None], (row * np.cos(polar)).sum(1)[:, None]
        along, across = (column * np.sin(azimuth)).sum(1), (column * np.cos(azimuth)).sum(1)
        moment = np.stack([sine * along, cosine * flat, -sine * across], axis=-1)
        self.center = moment / self.area[..., None]
        flux = np.abs(self.values).max(-1) * self.area
        self.is_bright = flux > 1e-4 * flux.sum()
        self.reach = 0.505 * np.hypot(step_polar, step)

    def integrate(self, normals: NDArray, wrap: float, step: bool = False) -> FloatArray:
        """Int max((N.L + l)/(1 + l), 0) c dL, or Int_{N.L > 0} c dL; shape [count, r]."""
        local = normals.astype(np.float64) @ self.to_world
        height, width, channels = self.values.shape
        total = np.zeros((len(local), channels))
        rows = max(1, 500_000 // (width * len(local)))
        for top in range(0, height, rows):
            here = slice(top, min(top + rows, height))
            x = self.center[here].reshape(-1, 3) @ local.T
            x += wrap
            kernel = (x > 0.0).astype(float) if step else np.maximum(x, 0.0) / (1.0 + wrap)
            crossed = np.flatnonzero(np.abs(x, out=x) < self.reach)
            texel, normal = np.divmod(crossed, len(local))
            is_bright = self.is_bright[here].ravel()[texel]
            for chosen, parts in ((is_bright, 48), (~is_bright, max(2, 256 // height))):
                i, j = np.divmod(texel[chosen], width)
                kernel[texel[chosen], normal[chosen]] = self._split(
                    top + i, j, local[normal[chosen]], wrap, step, parts
                )
            weighted = self.values[here] * self.area[here, :, None]
            total += kernel.T @ weighted.reshape(-1, channels)
        return total

    def _split(
        self, i: NDArray, j: NDArray, normal: FloatArray, wrap: float, step: bool, parts: int
    ) -> FloatArray:
        height, width = self.values.shape[:2]
        part = (np.arange(parts) + 0.5) / parts
        top, bottom = np.cos(np.pi * i / height), np.cos(np.pi * (i + 1) / height)
        level = top[:, None] + (bottom - top)[:, None] * part
        azimuth = 2.0 * np.pi * (j[:, None] + part) / width
        n = normal[:, :, None]
        around = np.sin(azimuth) * n[:, 0] - np.cos(azimuth) * n[:, 2]
        x = np.sqrt(1.0 - level**2)[:, :, None] * around[:, None, :]
        x += (level * n[:, 1])[:, :, None] + wrap
        if step:
            return np.mean(x > 0.0, axis=(1, 2))
        return np.maximum(x, 0.0, out=x).mean(axis=(1, 2)) / (1.0 + wrap)


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


# --- Environments ------------------------------------------------------------------------------


def texel_directions(height: int) -> FloatArray:
    polar, azimuth = np.meshgrid(
        np.pi * (np.arange(height) + 0.5) / height,
        np.pi * (np.arange(2 * height) + 0.5) / height,
        indexing="ij",
    )
    return directions(azimuth, polar)


def overcast_sky(height: int = 64) -> tuple[FloatArray, FloatArray]:
    """The CIE overcast sky above dark ground."""
    up = texel_directions(height)[..., 1]
    luminance = np.where(up > 0.0, (1.0 + 2.0 * np.maximum(up, 0.0)) / 3.0, 0.08)
    tint = np.where(up[..., None] > 0.0, [0.8, 1.0, 1.3], [1.2, 1.0, 0.7])
    return luminance[..., None] * tint, np.array([0.0, 1.0, 0.0])


def room_with_a_lamp(height: int = 128) -> tuple[FloatArray, FloatArray]:
    """Walls, a ceiling, a floor, and one lamp of 2.8 by 5.6 degrees with three quarters of it."""
    toward = texel_directions(height)
    wall = np.abs(toward).argmax(axis=-1) * 2 + (
        np.take_along_axis(toward, np.abs(toward).argmax(-1)[..., None], -1)[..., 0] > 0
    )
    paint = np.random.default_rng(4).uniform(0.05, 0.4, (6, 3))
    room = paint[wall]
    row, column = int(0.22 * height), int(0.6 * height)
    room[row : row + 2, column : column + 4] = [900.0, 800.0, 650.0]
    lamp = toward[row : row + 2, column : column + 4].mean((0, 1))
    return room, lamp / np.linalg.norm(lamp)


def sky_with_sun(height: int = 1024) -> tuple[FloatArray, FloatArray]:
    """A disc of 0.5 degrees that holds 90 % of the flux; edge texels are covered in part."""
    sky, _ = overcast_sky(height)
    sun = np.array([0.52, 0.55, 0.653])
    sun /= np.linalg.norm(sun)
    i = int(np.arccos(sun[1]) / np.pi * height)
    j = int((np.arctan2(sun[0], -sun[2]) / (2 * np.pi) % 1.0) * 2 * height)
    reach = max(3, height // 256)
    rows, columns = np.arange(i - reach, i + reach + 1), np.arange(j - reach, j + reach + 1)
    sub = (np.arange(16) + 0.5) / 16
    polar, azimuth = np.meshgrid(
        np.pi * (rows[:, None] + sub).ravel() / height,
        np.pi * (columns[:, None] + sub).ravel() / height,
        indexing="ij",
    )
    inside = directions(azimuth, polar) @ sun > np.cos(np.radians(0.25))
    cover = inside.reshape(len(rows), 16, len(columns), 16).mean((1, 3))
    area = Oracle(np.ones((height, 2 * height, 1)), np.eye(3)).area
    block = np.ix_(rows, columns)
    flux = (sky[..., 1] * area).sum()
    sky[block] += 9.0 * flux / (cover * area[block]).sum() * cover[..., None] * [1.1, 1.0, 0.8]
    return sky, sun


def random_normals(count: int, seed: int) -> FloatArray:
    normals = np.random.default_rng(seed).normal(size=(count, 3))
    return normals / np.linalg.norm(normals, axis=1, keepdims=True)


def normals_at_kinks(lamp: FloatArray, wraps: tuple[float, ...], each: int) -> FloatArray:
    """Normals within a degree of N.L = 0 and N.L = -l of a lamp."""
    random = np.random.default_rng(7)
    across = np.linalg.svd(lamp[None])[2][1:]
    found = []
    for kink in {0.0, *(-wrap for wrap in wraps)}:
        angle = np.arccos(kink) + np.radians(random.uniform(-1.0, 1.0, each))
        turn = random.uniform(0.0, 2.0 * np.pi, (each, 1))
        around = np.cos(turn) * across[0] + np.sin(turn) * across[1]
        found.append(np.cos(angle)[:, None] * lamp + np.sin(angle)[:, None] * around)
    return np.concatenate(found)


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
    for group in range(lights.group_count):
        light = diffuse_light(lights, wrap_set, 3, group, n, latlong_coordinates(n))
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


def lit(
    environment: Environment, workers: Workers
) -> tuple[DomeLight, LightField, FloatArray, Oracle]:
    """A dome, its field, normals that matter, the brightest first, and the truth."""
    values, lamp = environment()
    light = dome(values)
    field = build_light_field(Lights((light,), ()), WRAPS, workers, values.shape[2])
    toward = TURN @ lamp
    normals = [toward[None], random_normals(24, 1), normals_at_kinks(toward, WRAPS, 8)]
    return light, field, as_stored(np.concatenate(normals)), Oracle(light.coefficients, TURN)


def share_of_peak(found: FloatArray, exact: FloatArray, peak: FloatArray) -> float:
    return float((np.abs(found - exact).max(axis=0) / peak.max(axis=0)).max())


@ENVIRONMENTS
def test_the_light_at_a_normal_is_the_integral_within_a_thousandth_of_the_peak(
    environment: Environment, workers: Workers
):
    _, field, normals, oracle = lit(environment, workers)
    lambert = oracle.integrate(normals, 0.0)
    for index, wrap in enumerate(WRAPS):
        wrapped = oracle.integrate(normals, wrap)
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
    _, field, normals, oracle = lit(environment, workers)
    lambert, half = oracle.integrate(normals, 0.0), oracle.integrate(normals, 0.0, step=True)
    for index, wrap in enumerate(WRAPS):
        wrapped = oracle.integrate(normals, wrap)
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
    exact = integrate_normals(tree, normals, wrap, 1, workers)[:2, 0, :, :3]
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
