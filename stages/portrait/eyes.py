"""Eyeballs: white, iris and pupil, under a clear cornea with its tear film.

Texture coordinates look along the gaze: the eyeball's disc fills the picture.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np
from anatomy import Eye
from numpy.typing import NDArray

from usdskin.meshfiles import MeshFile

FloatArray = NDArray[np.float64]

IRIS_M = 5.6e-3
"""Radius of the iris [m]; people's differ little from it."""

PUPIL_M = 1.7e-3
"""Radius of the pupil in bright light [m]."""

CORNEA_M = 8.2e-3
"""Radius of curvature of the cornea [m]; 7.8e-3 is usual."""

TEAR_FILM_M = 1.0e-4
"""How far the clear surface lies above the white [m]."""

TEXTURE_PX = 768

_AROUND = 72


def eyeball(eye: Eye, gaze: FloatArray, source: Path) -> MeshFile:
    """Return white, iris and pupil as one surface.

    Args:
        eye: Where.
        gaze: Unit vector the eye looks along.
        source: File the mesh is said to come from.
    """
    radius = float(eye.radii[0])
    rim = np.arcsin(IRIS_M / radius)
    angle = np.linspace(np.pi, rim, 40)
    white = np.stack([radius * np.sin(angle), radius * np.cos(angle)], axis=1)
    # Behind its rim the iris dips by 0.3 mm and comes forward again towards the pupil.
    at = np.linspace(1.0, 0.0, 14)[1:]
    depth = white[-1, 1] - 3e-4 * np.sin(np.pi * np.minimum(1.0, 2.0 * (1.0 - at)) / 2.0)
    iris = np.stack([IRIS_M * at, depth], axis=1)
    return _turned(np.concatenate([white, iris]), eye, gaze, source)


def cornea(eye: Eye, gaze: FloatArray, source: Path) -> MeshFile:
    """Return the clear surface: the tear film on the white and the cornea's bulge."""
    radius = float(eye.radii[0]) + TEAR_FILM_M
    angle = np.concatenate([np.linspace(np.pi, 0.9, 24), np.linspace(0.9, 0.0, 49)[1:]])
    rim = np.arcsin(IRIS_M * 1.06 / radius)
    # The cap's centre lies on the axis so that it meets the white at the rim.
    center = radius * np.cos(rim) - np.sqrt(CORNEA_M**2 - (radius * np.sin(rim)) ** 2)
    cap = center * np.cos(angle) + np.sqrt(
        np.maximum(CORNEA_M**2 - (center * np.sin(angle)) ** 2, 0.0)
    )
    # A smooth maximum rounds the groove where the two meet.
    softness = 1.2e-4
    both = 0.5 * (radius + cap + np.sqrt((cap - radius) ** 2 + softness**2))
    distance = np.where(angle < 1.2, both, radius)
    profile = np.stack([distance * np.sin(angle), distance * np.cos(angle)], axis=1)
    return _turned(profile, eye, gaze, source)


def paint(seed: int) -> NDArray[np.float32]:
    """Return the eyeball's reflectance, linear Rec. 709, shape [TEXTURE_PX, TEXTURE_PX, 3].

    Args:
        seed: For fibres and veins.
    """
    random = np.random.default_rng(seed)
    y, x = np.mgrid[0:TEXTURE_PX, 0:TEXTURE_PX]
    x = (x + 0.5) / TEXTURE_PX * 2.0 - 1.0
    y = 1.0 - (y + 0.5) / TEXTURE_PX * 2.0
    radius, turn = np.hypot(x, y), np.arctan2(y, x)
    rim = IRIS_M / 0.0149
    inner = PUPIL_M / 0.0149
    along = np.clip((radius - inner) / (rim - inner), 0.0, 1.0)

    fibres = np.zeros_like(radius)
    for frequency, amount in ((23, 0.5), (41, 0.45), (67, 0.4), (113, 0.3)):
        phase, bend = random.uniform(0.0, 2.0 * np.pi, 2)
        fibres += amount * np.sin(frequency * turn + phase + 1.6 * np.sin(5 * along + bend))
    fibres = fibres / 1.65
    ring = np.exp(-(((along - 0.32 - 0.04 * np.sin(7 * turn) * np.sin(3 * turn)) / 0.16) ** 2))
    brown = np.array([0.088, 0.042, 0.018])
    amber = np.array([0.20, 0.105, 0.040])
    iris = brown * (1.0 + 0.45 * fibres[..., None]) + ring[..., None] * (amber - brown) * (
        0.75 + 0.25 * fibres[..., None]
    )
    iris *= (1.0 - 0.75 * _step(0.80, 1.0, along))[..., None]

    white = np.array([0.66, 0.60, 0.55]) * np.ones_like(iris)
    away = np.clip((radius - rim) / (0.75 - rim), 0.0, 1.0)
    veins = np.zeros_like(radius)
    for _ in range(26):
        at, reach, wave = random.uniform(-np.pi, np.pi), random.uniform(0.45, 0.8), random.normal()
        bent = turn - at - 0.06 * np.sin(14.0 * radius * wave + at)
        veins += np.exp(-((np.angle(np.exp(1j * bent)) * radius / 0.006) ** 2)) * _step(
            reach, reach + 0.2, radius
        )
    red = np.clip(0.30 * veins * away + 0.22 * away**2, 0.0, 0.6)
    white *= 1.0 - red[..., None] * np.array([0.12, 0.52, 0.50])

    color = iris + (white - iris) * _step(0.965 * rim, 1.05 * rim, radius)[..., None]
    color *= _step(0.93 * inner, 1.07 * inner, radius)[..., None]
    return np.clip(color, 0.002, 1.0).astype(np.float32)


def _turned(profile: FloatArray, eye: Eye, gaze: FloatArray, source: Path) -> MeshFile:
    """Return the surface of revolution of (radius, depth) [m] about the gaze, poles closed."""
    turn = 2.0 * np.pi * np.arange(_AROUND) / _AROUND
    ring = profile[1:-1]
    around = np.stack(
        [
            ring[:, :1] * np.cos(turn),
            ring[:, :1] * np.sin(turn),
            np.broadcast_to(ring[:, 1:], (len(ring), _AROUND)),
        ],
        axis=2,
    ).reshape(-1, 3)
    poles = np.array([[0.0, 0.0, profile[0, 1]], [0.0, 0.0, profile[-1, 1]]])
    points = np.concatenate([poles, around])
    here = np.arange(_AROUND)
    after = (here + 1) % _AROUND
    first = 2 + np.arange(len(ring) - 1)[:, None] * _AROUND
    quads = np.stack(
        [first + here, first + after, first + _AROUND + after, first + _AROUND + here], axis=2
    ).reshape(-1, 4)
    last = 2 + (len(ring) - 1) * _AROUND
    back = np.stack([np.zeros_like(here), 2 + after, 2 + here], axis=1)
    front = np.stack([np.ones_like(here), last + here, last + after], axis=1)
    indices = np.concatenate([quads.ravel(), back.ravel(), front.ravel()]).astype(np.int32)
    counts = np.concatenate([np.full(len(quads), 4), np.full(2 * _AROUND, 3)]).astype(np.int32)
    st = 0.5 + 0.5 * points[:, :2] / eye.radii[0]
    shape = eye.radii * np.array([1.0, 1.0, 0.0]) + np.array([0.0, 0.0, eye.radii[0]])
    placed = (points / eye.radii[0]) @ _frame(gaze).T * shape + eye.center
    return MeshFile(source, placed, counts, indices, st=st, st_indices=indices.copy())


def _frame(gaze: FloatArray) -> FloatArray:
    """Return the rotation whose third column is the gaze and whose second stays upright."""
    right = np.cross([0.0, 1.0, 0.0], gaze)
    right /= np.linalg.norm(right)
    return np.stack([right, np.cross(gaze, right), gaze], axis=1)


def _step(low: float, high: float, value: FloatArray) -> FloatArray:
    t = np.clip((value - low) / (high - low), 0.0, 1.0)
    return t * t * (3.0 - 2.0 * t)
