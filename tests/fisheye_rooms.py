"""Fisheye views of known environments in float64, with none of the code under test."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np


def turn(axis, degrees):
    """Return the rotation by an angle about an axis (Rodrigues), shape [3, 3]."""
    x, y, z = np.asarray(axis, dtype=np.float64) / np.linalg.norm(axis)
    cross = np.array([[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]])
    angle = np.radians(degrees)
    return np.eye(3) + np.sin(angle) * cross + (1.0 - np.cos(angle)) * cross @ cross


def random_turn(rng, degrees):
    return turn(rng.normal(size=3), degrees)


def angle_between(first, second):
    """Return the angle between two rotations [deg]."""
    return np.degrees(2.0 * np.arcsin(np.linalg.norm(first - second) / np.sqrt(8.0)))


def horizontal(*azimuths):
    """Return cameras that look level, shape [count, 3, 3]."""
    return np.array([turn([0, 1, 0], azimuth) for azimuth in azimuths])


UP = turn([1, 0, 0], 90.0)
"""A camera that looks at +Y."""


def mottle(rng, points, waves=48):
    """Return smooth random values of points in space, deviation 1, shape of points[..., 0].

    They are plane waves of 5 cm to 4 m with random phases.
    """
    total = np.zeros(points.shape[:-1])
    for length in np.geomspace(0.05, 4.0, waves):
        wave = rng.normal(size=3)
        wave *= 2.0 * np.pi / length / np.linalg.norm(wave)
        total += np.sin(points @ wave + rng.uniform(0.0, 2.0 * np.pi))
    return total / np.sqrt(0.5 * waves)


def directions(height, width):
    """Return those of a latlong's texels: the left edge is -Z, a quarter +X, the top +Y."""
    turns = 2.0 * np.pi * (np.arange(width) + 0.5) / width
    polar = np.pi * (np.arange(height) + 0.5) / height
    turns, polar = np.meshgrid(turns, polar)
    return np.stack(
        [np.sin(polar) * np.sin(turns), np.cos(polar), -np.sin(polar) * np.cos(turns)], axis=-1
    )


def room(seed, height=512, *, lamp=300.0, eye=(0.0, 0.0, 0.0)):
    """Return a latlong of a room 4.6 m by 3 m by 6 m with lamps, pictures and mottled walls.

    Four decades lie between the lamps and the darkest picture. The camera is at ``eye`` [m] from
    the usual place. Shape [height, 2 height, 3].
    """
    rng = np.random.default_rng(seed)
    rays = directions(height, 2 * height)
    low, high = np.array([-2.0, -1.2, -3.5]), np.array([2.6, 1.8, 2.5])
    reach = np.where(rays > 0.0, high - eye, low - eye) / rays
    points = eye + rays * reach.min(axis=-1)[..., None]
    axis = np.argmin(reach, axis=-1)
    wall = 2 * axis + (np.take_along_axis(rays, axis[..., None], -1)[..., 0] > 0.0)
    value = rng.uniform(0.15, 0.8, (6, 3))[wall] * np.exp(0.2 * mottle(rng, points))[..., None]
    for _ in range(60):
        which, middle, half = rng.integers(6), rng.uniform(low, high), rng.uniform(0.05, 0.45, 3)
        across = np.arange(3) != which // 2
        inside = np.all((np.abs(points - middle) < half)[..., across], axis=-1)
        value[inside & (wall == which)] *= rng.uniform(0.05, 2.0, 3)
    for x in (-1.0, 1.2):
        tube = (np.abs(points[..., 0] - x) < 0.06) & (np.abs(points[..., 2] + 0.4) < 0.8)
        value[tube & (wall == 3)] = lamp
    return value


def sample(environment, rays):
    """Return bilinear samples of a latlong, float64, shape [..., 3]."""
    height, width = environment.shape[:2]
    u = np.arctan2(rays[..., 0], -rays[..., 2]) / (2.0 * np.pi) * width - 0.5
    v = np.arccos(np.clip(rays[..., 1], -1.0, 1.0)) / np.pi * height - 0.5
    column, row = np.floor(u).astype(int), np.floor(v).astype(int)
    s, t = (u - column)[..., None], (v - row)[..., None]
    left, right = column % width, (column + 1) % width
    top, bottom = np.clip(row, 0, height - 1), np.clip(row + 1, 0, height - 1)
    return (1.0 - t) * ((1.0 - s) * environment[top, left] + s * environment[top, right]) + t * (
        (1.0 - s) * environment[bottom, left] + s * environment[bottom, right]
    )


@dataclass(frozen=True)
class Shot:
    """What a virtual camera does wrong."""

    noise: float = 0.0
    """Standard deviation of a pixel, relative; in the dark, of a tenth of the median [1]."""

    vignetting: float = 0.0
    """What stays of it at 90 degrees [1]."""

    glare: float = 0.0
    """Share of the light spread evenly over the picture [1]."""


PERFECT = Shot()
REALISTIC = Shot(noise=0.01, vignetting=0.02, glare=0.01)


def photograph(environment, rotation, *, size=360, max_angle=90.0, shot=PERFECT, seed=0):
    """Return an equidistant picture that fills its square, shape [size, size, 3], and its mask.

    Each pixel is the mean of 2 x 2 rays. The focal length is size / 2 / max_angle.
    """
    focal = 0.5 * size / np.radians(max_angle)
    steps = (np.arange(2 * size) + 0.5) / 2.0 - 0.5 * size
    x, y = np.meshgrid(steps, steps)
    phi, psi = np.hypot(x, y) / focal, np.arctan2(-y, x)
    rays = np.stack([np.sin(phi) * np.cos(psi), np.sin(phi) * np.sin(psi), -np.cos(phi)], axis=-1)
    fine = sample(environment, rays @ rotation.T)
    fine *= (1.0 + shot.vignetting * (phi / (0.5 * np.pi)) ** 2)[..., None]
    picture = fine.reshape(size, 2, size, 2, 3).mean(axis=(1, 3))
    valid = phi.reshape(size, 2, size, 2).max(axis=(1, 3)) <= np.radians(max_angle)
    mean = picture[valid].mean(axis=0)
    picture = (1.0 - shot.glare) * picture + shot.glare * mean
    if shot.noise:
        rng = np.random.default_rng(seed)
        spread = shot.noise * np.hypot(picture, 0.1 * np.median(picture[valid]))
        picture = picture + spread * rng.normal(size=picture.shape)
    return np.where(valid[..., None], picture, 0.0).astype(np.float32), valid
