"""Veiling glare, found in the corners that a fisheye's picture leaves dark."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from numpy.typing import NDArray

from usdskin.judge.shoot.photographer import add_glare, fisheye
from usdskin.notes import Note
from usdskin.photographs.glare import find_glare, subtract_glare

SIZE = 160


def picture(glare: float, noise: float = 0.0, seed: int = 0) -> tuple[NDArray, NDArray, NDArray]:
    """An uneven picture without its veil, the veiled one, and its variance."""
    lens = fisheye(SIZE, glare=glare)
    random = np.random.default_rng(seed)
    v, u = np.indices((SIZE, SIZE)) + 0.5
    radius = np.hypot(u - lens.center_px[0], v - lens.center_px[1])
    clear = np.zeros((SIZE, SIZE, 3), np.float32)
    clear[radius < 80.0] = [0.2, 0.5, 0.1]
    clear[30:40, 90:100] = 40.0
    veiled = clear.copy()
    add_glare(veiled, lens)
    veiled += (noise * random.normal(size=veiled.shape)).astype(np.float32)
    return clear, veiled, np.full_like(veiled, noise**2)


@pytest.mark.parametrize("glare", [0.002, 0.01, 0.04])
def test_glare_is_found_and_taken_off(glare: float):
    clear, veiled, variance = picture(glare, noise=2e-3)
    notes: list[Note] = []
    found = find_glare(veiled, variance, fisheye(SIZE), "view", notes)
    assert found == pytest.approx(glare, rel=0.05)
    assert not notes
    subtract_glare(veiled, variance, replace(fisheye(SIZE), glare=found))
    inside = clear > 0.0
    assert np.abs(veiled[inside].mean() / clear[inside].mean() - 1.0) < 1e-4
    assert veiled[35, 95, 1] == pytest.approx(clear[35, 95, 1], rel=2e-3)


def test_corners_of_noise_hold_no_glare():
    for seed in range(8):
        _, veiled, variance = picture(0.0, noise=0.01, seed=seed)
        assert find_glare(veiled, variance, fisheye(SIZE), "view", []) == 0.0


@pytest.mark.parametrize(
    ("corner", "everywhere"),
    [(0.05, 0.0), (0.0, 0.3)],  # one is lit; all are
    ids=["uneven", "too much"],
)
def test_what_is_no_veil_is_told_and_left(corner: float, everywhere: float):
    """A lamp beside the picture, and a lens that draws beyond its stated angle."""
    _, veiled, variance = picture(0.01)
    veiled[:20, :20] += corner
    beyond = veiled[..., 0] < 0.1
    veiled[beyond] += everywhere
    notes: list[Note] = []
    assert find_glare(veiled, variance, fisheye(SIZE), "</Shoot/view0>", notes) == 0.0
    (note,) = notes
    assert (note.code, note.path) == ("glare-unclear", "</Shoot/view0>")
    assert "state fisheye:glare" in note.message


def test_a_picture_that_fills_its_frame_tells_nothing():
    _, veiled, variance = picture(0.01)
    lens = replace(fisheye(SIZE), focal_length_px=2.0 * fisheye(SIZE).focal_length_px)
    assert find_glare(veiled, variance, lens, "view", []) == 0.0
