"""Corners and pictures of a calibration board through a known fisheye lens, by other means."""

from __future__ import annotations

import cv2
import numpy as np

SQUARES = (7, 5)
TEXEL = 64  # per square


def corners_of(squares=SQUARES):
    """Return the inner corners of a board, in squares."""
    x, y = np.meshgrid(np.arange(1, squares[0]), np.arange(1, squares[1]))
    return np.column_stack([x.ravel(), y.ravel()]).astype(float)


def polynomial(f, k):
    """Return r(phi) of OpenCV's fisheye model [px]."""
    return lambda phi: f * phi * (1 + sum(c * phi ** (2 * i + 2) for i, c in enumerate(k)))


def project(points, radius, center):
    """Return pixels (corner of the first one at 0) and angles of points (x right, y down)."""
    across = np.hypot(points[:, 0], points[:, 1])
    phi = np.arctan2(across, points[:, 2])
    return center + (radius(phi) / across)[:, None] * points[:, :2], phi


def random_pose(rng, angle_deg, distance=(5.0, 9.0), tilt=0.5, squares=SQUARES):
    """Return rotation and translation of a board whose middle is at an angle from the axis."""
    phi, psi = np.radians(angle_deg), rng.uniform(0, 2 * np.pi)
    toward = np.array([np.sin(phi) * np.cos(psi), np.sin(phi) * np.sin(psi), np.cos(phi)])
    z = toward + tilt * rng.normal(size=3)
    z /= np.linalg.norm(z)
    x = np.cross(z, rng.normal(size=3))
    x /= np.linalg.norm(x)
    rotation = np.column_stack([x, np.cross(z, x), z])
    middle = rotation[:, :2] @ (np.array(squares) / 2)
    return rotation, toward * rng.uniform(*distance) - middle


def views(rng, radius, center, resolution, *, count, largest_deg, noise_px, reach_deg=100.0):
    """Return corners on the board and in the picture of boards all over the picture."""
    board, found = corners_of(), []
    while len(found) < count:
        rotation, translation = random_pose(rng, rng.uniform(0.0, largest_deg))
        points = board @ rotation[:, :2].T + translation
        pixels, phi = project(points, radius, center)
        inside = (pixels > 4).all(1) & (pixels < np.array(resolution) - 4).all(1)
        inside &= phi < np.radians(reach_deg)
        if inside.sum() >= 12:
            noise = noise_px * rng.normal(size=(inside.sum(), 2))
            found.append((board[inside], pixels[inside] + noise))
    return found


def texture(squares=SQUARES, legacy=False):
    """Return a ChArUco board as OpenCV draws it, or drew it up to 4.5, reflectance 0.05 to 0.9."""
    dictionary = cv2.aruco.getPredefinedDictionary(cv2.aruco.DICT_4X4_50)
    board = cv2.aruco.CharucoBoard(squares, 1.0, 0.75, dictionary)
    board.setLegacyPattern(legacy)
    drawn = board.generateImage((squares[0] * TEXEL, squares[1] * TEXEL), marginSize=0)
    return 0.05 + 0.85 * drawn / 255.0


def checkers(squares):
    """Return a plain chessboard."""
    x, y = np.meshgrid(*(np.arange(count * TEXEL) // TEXEL for count in squares))
    return 0.05 + 0.85 * ((x + y) % 2)


def picture(board, radius, center, resolution, rotation, translation, rng, subsamples=3):
    """Return an 8-bit picture of a board: area-sampled, with a white margin, noise of one step."""
    width, height = resolution
    rows, columns = board.shape
    margin = 0.6
    edge = np.linspace(-margin, 1 + margin, 60)
    outline = np.stack(np.meshgrid(edge * columns / TEXEL, edge * rows / TEXEL), -1).reshape(-1, 2)
    pixels, phi = project(outline @ rotation[:, :2].T + translation, radius, center)
    pixels = pixels[phi < np.radians(100)]
    x0, y0 = np.maximum(np.floor(pixels.min(0)).astype(int) - 1, 0)
    x1, y1 = np.minimum(np.ceil(pixels.max(0)).astype(int) + 1, [width, height])

    grid = (np.arange(subsamples) + 0.5) / subsamples
    u = (np.arange(x0, x1)[:, None] + grid).ravel() - center[0]
    v = (np.arange(y0, y1)[:, None] + grid).ravel() - center[1]
    u, v = np.meshgrid(u, v)
    r = np.hypot(u, v)
    table = np.linspace(0.0, np.radians(110), 4000)
    phi = np.interp(r, radius(table), table)
    rays = np.stack([np.sin(phi) * u / r, np.sin(phi) * v / r, np.cos(phi)], -1)
    along = (rotation[:, 2] @ translation) / (rays @ rotation[:, 2])
    place = (along[..., None] * rays - translation) @ rotation[:, :2] * TEXEL
    light = np.full(r.shape, 0.3)
    paper = (along > 0) & (phi < np.radians(100)) & (place > -margin * TEXEL).all(-1)
    paper &= (place < np.array([columns, rows]) + margin * TEXEL).all(-1)
    light[paper] = 0.9
    printed = paper & (place >= 0).all(-1) & (place < [columns, rows]).all(-1)
    cells = place[printed].astype(int)
    light[printed] = board[cells[:, 1], cells[:, 0]]
    whole = np.full((height, width), 0.3)
    whole[y0:y1, x0:x1] = light.reshape(y1 - y0, subsamples, x1 - x0, subsamples).mean((1, 3))
    noisy = 255.0 * whole + rng.normal(size=whole.shape)
    return np.clip(np.rint(noisy), 0, 255).astype(np.uint8)
