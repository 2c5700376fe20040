"""Light from all around in float64, and environments to try it on: for the tests of the maps.

The oracle knows only DESIGN section 2, a texel of a latlong map is a constant patch of the sphere,
and shares no code with the product.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

FloatArray = NDArray[np.float64]


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
