"""Light that a lens spreads over a chart, found and taken away."""

from dataclasses import replace

import numpy as np
import pytest
from test_recovery import train

from usdskin.estimate.recovery import estimate_responsivity, recover, without_stray_light

SHARES = np.array([0.002, 0.001, 0.003])


def glaring(lamp="FL2", noise=0.0, seed=0, shares=SHARES, **more):
    """Return a chart, and what was added to all its camera values."""
    clean = train(lamp, noise, seed, **more)
    added = shares * clean.camera_values.max(axis=0)
    return replace(clean, camera_values=clean.camera_values + added), added


@pytest.mark.parametrize("lamp", ["A", "FL2", "D55"])
def test_an_even_addition_is_found(lamp):
    chart, added = glaring(lamp, noise=0.002)
    (freed,), (found,) = without_stray_light([chart])
    assert np.allclose(found, added, rtol=0.2)
    assert np.allclose(freed.camera_values, chart.camera_values - found, rtol=1e-12)


def test_every_chart_has_its_own():
    first, added = glaring("FL2", 0.002)
    second, more = glaring("D55", 0.002, 1, shares=3.0 * SHARES)
    third = train("A", 0.002, 2)
    _, stray = without_stray_light([first, second, third])
    assert np.allclose(stray[0], added, rtol=0.2)
    assert np.allclose(stray[1], more, rtol=0.2)
    assert np.abs(stray[2] / third.camera_values.max(axis=0)).max() < 3e-4


def test_a_black_level_that_was_set_too_high_is_found_too():
    chart, added = glaring(noise=0.002, shares=-SHARES)
    _, (found,) = without_stray_light([chart])
    assert np.allclose(found, added, rtol=0.2)


@pytest.mark.parametrize("noise", [0.0, 0.01])
def test_next_to_nothing_is_taken_from_a_chart_without_any(noise):
    chart = train(noise=noise)
    _, (found,) = without_stray_light([chart])
    assert np.abs(found / chart.camera_values.max(axis=0)).max() < 2e-3 * (noise / 0.01 + 0.02)


def test_a_chart_of_few_patches_is_left_alone():
    chart, _ = glaring(noise=0.002)
    few = replace(
        chart,
        patches=chart.patches[:9],
        camera_values=chart.camera_values[:9],
        signals=chart.signals[:9],
    )
    (same,), (found,) = without_stray_light([few])
    assert not found.any()
    assert np.array_equal(same.camera_values, few.camera_values)


def test_no_patch_is_taken_below_nothing():
    chart, _ = glaring(shares=np.full(3, 0.2))
    (freed,), _ = without_stray_light([chart])
    assert (freed.camera_values > 0.0).all()


def test_the_recovery_is_as_if_there_had_been_none():
    clean = train(noise=0.002)
    glare, _ = glaring(noise=0.002, shares=np.full(3, 0.005))
    (freed,), _ = without_stray_light([glare])
    exact, wrong, right = (
        recover(chart, estimate_responsivity([chart])).matrix for chart in (clean, glare, freed)
    )
    assert np.linalg.norm(right - exact) < 0.2 * np.linalg.norm(wrong - exact)
