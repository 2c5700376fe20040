"""Rotations <-> vectors along their axis, as long as their angle [rad]."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

FloatArray = NDArray[np.float64]


def rotation_by(vector: FloatArray) -> FloatArray:
    """Return the rotation by a vector [rad] (Rodrigues' formula), shape [3, 3]."""
    angle = float(np.linalg.norm(vector))
    x, y, z = vector
    cross = np.array([[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]])
    first = np.sinc(angle / np.pi)
    second = 0.5 * np.sinc(0.5 * angle / np.pi) ** 2
    return np.asarray(np.eye(3) + first * cross + second * cross @ cross)


def vector_of(rotation: FloatArray) -> FloatArray:
    """Return the vector of a rotation by less than pi [rad], the inverse of ``rotation_by``."""
    skew = 0.5 * (rotation - rotation.T)
    sine_vector = np.array([skew[2, 1], skew[0, 2], skew[1, 0]])
    sine = float(np.linalg.norm(sine_vector))
    angle = np.arctan2(sine, 0.5 * (np.trace(rotation) - 1.0))
    return sine_vector * (angle / sine if sine > 0.0 else 1.0)
