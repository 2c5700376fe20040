"""The small functions of the kernels against closed forms and float64 sums."""

from __future__ import annotations

import numpy as np
import pytest
import warp as wp
from kernel_probes import probe_fresnel, probe_gloss, probe_means, probe_texture

from usdskin.device import Workers
from usdskin.render.gloss import add_reflections
from usdskin.render.lights import DomeLight, Lights
from usdskin.render.lobe_albedo import dielectric_response, schlick_response
from usdskin.render.textures import Texture, mip_pyramid, pack_textures
from usdskin.render.textures import sample_texture as reference_sample
from usdskin.warp_kernels import structs

PREFILTER_RTOL = 1e-2
"""Fixed directions, each reading a blurred level, and a bilinear grid of nodes."""


def _run(kernel, count, inputs, dtype, device):
    out = wp.zeros(count, dtype=dtype, device=device)
    wp.launch(kernel, dim=count, inputs=inputs, outputs=[out], device=device)
    return out.numpy()


@pytest.mark.slow
def test_mean_ramp_and_step_are_the_averages_over_the_rectangle(device):
    """Against a fine float64 midpoint sum, over positions inside, across and outside the kink."""
    rng = np.random.default_rng(3)
    a, b = rng.uniform(-0.02, 0.02, (2, 400))
    b[:80] *= 1e-4  # nearly a line
    x = rng.uniform(-1.3, 1.3, 400) * (np.abs(a) + np.abs(b))
    x[-40:] = rng.uniform(-1, 1, 40)
    at = np.stack([x, a, b], axis=-1).astype(np.float32)

    found = _run(probe_means, 400, [wp.array(at, dtype=wp.vec3f, device=device)], wp.vec2f, device)

    unit = (np.arange(801) + 0.5) / 400.5 - 1.0
    values = (
        at[:, 0, None, None].astype(float)
        + at[:, 1, None, None] * unit[:, None]
        + at[:, 2, None, None] * unit
    )
    size = np.abs(at[:, 1:]).sum(axis=1)
    np.testing.assert_allclose(
        found[:, 0] / size, np.maximum(values, 0).mean((1, 2)) / size, rtol=1e-5, atol=2e-4
    )
    np.testing.assert_allclose(found[:, 1], (values > 0).mean((1, 2)), atol=3e-3)


def test_mean_ramp_is_exact_where_the_kink_does_not_cross(device):
    at = np.float32([[0.5, 0.1, 0.2], [-0.5, 0.1, 0.2], [0.3, 0.0, 0.0], [0.0, 0.0, 0.0]])
    found = _run(probe_means, 4, [wp.array(at, dtype=wp.vec3f, device=device)], wp.vec2f, device)
    np.testing.assert_array_equal(found[:, 0], np.float32([0.5, 0.0, 0.3, 0.0]))


def test_ramp_on_its_kink_has_the_mean_of_a_uniform_square(device):
    """E[max(a s + a t, 0)] = a / 3 for s, t uniform in [-1, 1]."""
    at = np.float32([[0.0, 0.01, 0.01]])
    found = _run(probe_means, 1, [wp.array(at, dtype=wp.vec3f, device=device)], wp.vec2f, device)
    np.testing.assert_allclose(found[0], [0.01 / 3.0, 0.5], rtol=1e-5)


@pytest.mark.parametrize("wrap", ["repeat", "clamp", "mirror", "black"])
def test_texture_lookup_equals_the_reference(wrap, device):
    rng = np.random.default_rng(5)
    pixels = rng.random((13, 22, 4)).astype(np.float32)
    texture = Texture("t", mip_pyramid(pixels), wrap, wrap, (0.1, 0.2, 0.3, 0.4))
    packed = pack_textures([texture])
    materials = structs.Materials()
    materials.texel = wp.array(packed.texels, dtype=wp.vec4f, device=device)
    materials.texture_level = wp.array(packed.levels, dtype=wp.vec3i, device=device)
    materials.texture_info = wp.array(packed.info, dtype=wp.vec3i, device=device)
    materials.texture_border = wp.array(packed.borders, dtype=wp.vec4f, device=device)
    at = np.zeros((300, 3), np.float32)
    at[:, :2] = rng.uniform(-1.5, 2.5, (300, 2))

    found = _run(
        probe_texture,
        300,
        [materials, 0, wp.array(at, dtype=wp.vec3f, device=device)],
        wp.vec4f,
        device,
    )

    expected = reference_sample(texture, at[:, :2])
    np.testing.assert_allclose(found, expected, atol=2e-5)


def _gloss_field(coefficients, alphas, device):
    dome = DomeLight("/d", coefficients.astype(np.float32), np.eye(3), np.eye(3), False)
    field = structs.Lights()
    field.group_count = 1
    lights = Lights((dome,), ())
    add_reflections(field, lights, (np.zeros((0, 4), int),), alphas, Workers(device, 1))
    return field


@pytest.mark.parametrize("alpha", [0.0, 0.01, 0.09, 0.25, 1.0])
def test_prefiltered_uniform_light_is_itself(alpha, device):
    field = _gloss_field(np.full((16, 32, 3), 2.5), (alpha,), device)
    direction = np.random.default_rng(1).normal(size=(50, 3)).astype(np.float32)
    direction /= np.linalg.norm(direction, axis=1, keepdims=True)
    found = _run(
        probe_gloss,
        50,
        [field, alpha, wp.array(direction, dtype=wp.vec3f, device=device)],
        wp.vec4f,
        device,
    )
    np.testing.assert_allclose(found[:, :3], 2.5, rtol=1e-4)


def test_prefiltered_light_is_the_lobes_average(device):
    """Against float64 importance sampling of the same lobe, dense, on a smooth asymmetric sky."""
    rows, columns = 64, 128
    polar = np.pi * (np.arange(rows) + 0.5) / rows
    turns = (np.arange(columns) + 0.5) / columns
    sky = (
        1.0
        + 0.5 * np.cos(polar)[:, None]
        + 0.3 * np.sin(polar)[:, None] * np.sin(2 * np.pi * turns)
    )
    alpha = 0.16
    field = _gloss_field(np.repeat(sky[:, :, None], 3, axis=2), (alpha,), device)
    axis = np.float32([[0.6, 0.64, -0.48]])
    found = _run(
        probe_gloss,
        1,
        [field, alpha, wp.array(axis, dtype=wp.vec3f, device=device)],
        wp.vec4f,
        device,
    )[0, 0]

    u, v = np.meshgrid((np.arange(400) + 0.5) / 400, 2 * np.pi * (np.arange(400) + 0.5) / 400)
    cosine = np.sqrt((1 - u) / (1 + (alpha**2 - 1) * u))
    sine = np.sqrt(1 - cosine**2)
    n = axis[0].astype(float)
    t = np.cross(n, [0, 1, 0])
    t /= np.linalg.norm(t)
    half = (
        (sine * np.cos(v))[..., None] * t
        + (sine * np.sin(v))[..., None] * np.cross(n, t)
        + cosine[..., None] * n
    )
    toward = 2 * cosine[..., None] * half - n
    nl = np.maximum(toward @ n, 0)
    weight = 2 * nl / (nl + np.sqrt(alpha**2 + (1 - alpha**2) * nl**2))
    light = 1.0 + 0.5 * toward[..., 1] + 0.3 * toward[..., 0]
    np.testing.assert_allclose(found, (weight * light).sum() / weight.sum(), rtol=PREFILTER_RTOL)


def test_directional_albedo_never_exceeds_one():
    """White furnace of one lobe: F0 = 1 reflects at most all, and a mirror reflects all."""
    table = schlick_response()[..., :2]
    total = table.sum(axis=2)
    assert total.max() <= 1.0 + 2e-3
    np.testing.assert_allclose(total[0, 1:], 1.0, atol=5e-3)
    assert (table >= 0).all()
    for f0 in (0.0, 0.028, 0.3, 1.0):
        table = dielectric_response(f0)[..., 0]
        assert table.min() >= 0.0 and table.max() <= 1.0 + 2e-3


def test_mirror_has_schlicks_fresnel(device):
    field = _gloss_field(np.ones((4, 8, 3)), (), device)
    cosine = np.linspace(0.1, 1.0, 20)
    at = np.stack([np.zeros(20), cosine], axis=-1).astype(np.float32)
    found = _run(probe_fresnel, 20, [field, wp.array(at, dtype=wp.vec2f, device=device)], wp.vec2f,
                 device)  # fmt: skip
    f0 = 0.04
    schlick = f0 + (1 - f0) * (1 - cosine) ** 5
    np.testing.assert_allclose(f0 * found[:, 0] + found[:, 1], schlick, atol=6e-3)
