"""What lamps take of one another's light: it is absorbed before it meets a surface."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from usdskin.judge.form_factors import first_blockers
from usdskin.judge.truth.geometry import Blockers
from usdskin.judge.truth.lamps import stops
from usdskin.render.local_lights import LocalLight

FloatArray = NDArray[np.float64]

_RAYS = 4181
_STEPS = (0.8566748838545029, 0.733891856627126, 0.6287067210378087, 0.5385972572236101)
"""What fills four dimensions evenly (Roberts 2018)."""
_OFF = 1e-6
"""How far from the lamp rays begin [m]."""


def taken_by_lamps(
    lamps: tuple[LocalLight, ...], blockers: Blockers, surface_count: int
) -> FloatArray:
    """Return the share of each lamp's flux that falls on other lamps first, shape [lamp_count].

    Args:
        lamps: The lamps.
        blockers: The surfaces, then the rectangular lamps.
        surface_count: How many surfaces there are.
    """
    result = np.zeros(len(lamps))
    for number, lamp in enumerate(lamps):
        begin, ways = _rays(lamp)
        found, _, _, far = first_blockers(blockers.planes(), begin, 1, ways)
        taken = found >= surface_count
        for other in lamps:
            if other is not lamp and other.kind != "rect":
                taken |= stops(other, begin, ways, far)
        result[number] = taken.mean()
    return result


def _rays(lamp: LocalLight) -> tuple[FloatArray, FloatArray]:
    """Return where rays leave a lamp, evenly, and their directions, by the cosine law."""
    s, t, p, q = (np.arange(1, _RAYS + 1)[:, None] * np.array(_STEPS) % 1.0).T
    a, b = lamp.half
    turn = 2.0 * np.pi * t
    ring = np.stack([np.cos(turn), np.sin(turn)], axis=1)
    zero = np.zeros(_RAYS)
    if lamp.kind == "cylinder":
        normal = np.column_stack([zero, ring])
        spot = np.column_stack([a * (2.0 * s - 1.0), b * ring])
    elif lamp.kind == "sphere":
        high = 2.0 * s - 1.0
        normal = np.column_stack([np.sqrt(1.0 - high**2)[:, None] * ring, high])
        spot = a * normal
    else:
        flat = np.sqrt(s)[:, None] * ring * a
        if lamp.kind == "rect":
            flat = np.stack([a * (2.0 * s - 1.0), b * (2.0 * t - 1.0)], axis=1)
        spot = np.column_stack([flat, zero])
        normal = np.broadcast_to([0.0, 0.0, -1.0], spot.shape)
    high = 2.0 * p - 1.0
    around = 2.0 * np.pi * q
    across = np.sqrt(1.0 - high**2)
    # The normal plus a point of the unit sphere: directions by the cosine law.
    ball = np.stack([across * np.cos(around), across * np.sin(around), high], axis=1)
    ways = normal + ball
    ways /= np.maximum(np.linalg.norm(ways, axis=1, keepdims=True), 1e-12)
    begin = lamp.center + (spot + _OFF * normal) @ lamp.axes
    return np.asarray(begin), np.asarray(ways @ lamp.axes)
