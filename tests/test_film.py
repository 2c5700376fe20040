"""Where the samples of a pixel lie."""

from __future__ import annotations

import numpy as np
import pytest

from usdskin.render.film import sample_offsets

FILTERS = ["box", "triangle", "gaussian", "blackmanHarris"]


@pytest.mark.parametrize("name", FILTERS)
@pytest.mark.parametrize("count", [1, 2, 4, 9, 16, 64, 300])
def test_samples_are_centred_on_the_pixel(name, count):
    offsets = sample_offsets(count, name)
    assert offsets.shape == (count, 2)
    np.testing.assert_allclose(offsets.mean(axis=0), 0.0, atol=1e-6)


def test_box_samples_stay_inside_the_pixel_one_per_row_and_column():
    offsets = sample_offsets(16, "box")
    for axis in range(2):
        np.testing.assert_allclose(np.sort(offsets[:, axis]), (np.arange(16) + 0.5) / 16 - 0.5)


def test_triangle_filter_has_its_variance():
    """The triangle of radius 1 has variance 1/6."""
    offsets = sample_offsets(256, "triangle")
    np.testing.assert_allclose(offsets.var(axis=0), 1.0 / 6.0, rtol=0.02)


def test_an_edge_across_the_pixel_is_covered_by_its_share():
    """256 box samples see slanted half planes to 1 % on average, and never miss by a row."""
    offsets = sample_offsets(256, "box").astype(float)
    grid = (np.arange(512) + 0.5) / 512 - 0.5
    x, y = np.meshgrid(grid, grid)
    errors = []
    for angle in np.linspace(0.05, np.pi, 23):
        for shift in (-0.2, 0.0, 0.13):
            side = offsets @ [np.cos(angle), np.sin(angle)] < shift
            exact = (x * np.cos(angle) + y * np.sin(angle) < shift).mean()
            errors.append(abs(side.mean() - exact))
    assert np.mean(errors) < 0.01
    assert np.max(errors) <= 16 / 256  # one row of the lattice


def test_unknown_filter_is_a_programming_mistake():
    with pytest.raises(ValueError, match="unknown pixel filter"):
        sample_offsets(4, "sinc")
