"""The solved light of a set against Mitsuba 3's path tracer, band by band.

Mitsuba is given numbers, not USD: corners, reflectances, lamps. How: ``mitsuba_set_peer.py``.
"""

from __future__ import annotations

import importlib.util
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

from usdskin.judge.truth.geometry import first_surfaces
from usdskin.judge.truth.panorama import see
from usdskin.judge.truth.radiosity import make_model, solve
from usdskin.judge.truth.sets import SetScene, read_set
from usdskin.latlong import texel_directions, texel_solid_angles

pytestmark = [
    pytest.mark.slow,
    pytest.mark.skipif(
        importlib.util.find_spec("mitsuba") is None,
        reason="mitsuba is not installed; the extra `test` has it",
    ),
]

BOUND = 5.0e-3
HEIGHT = 32
NM = np.array([440.0, 550.0, 675.0])
ROOM = Path(__file__).resolve().parents[1] / "stages" / "room_fluorescent" / "set.usda"


def peer(scene: SetScene, folder: Path, samples: int) -> np.ndarray:
    """Mitsuba's panoramas, shape [groups, h, w, bands]."""
    surfaces, lamps = scene.surfaces, scene.lamps
    np.savez(
        folder / "job.npz", corner=surfaces.corner, along=surfaces.along, across=surfaces.across,
        reflectance=surfaces.reflectance, lamp_kind=[lamp.kind for lamp in lamps],
        lamp_center=[lamp.center for lamp in lamps], lamp_axes=[lamp.axes for lamp in lamps],
        lamp_half=[lamp.half for lamp in lamps],
        lamp_radiance=[lamp.radiance[0] for lamp in lamps],
        origin=scene.capture_point, height=HEIGHT, samples=samples, groups=8, depth=40,
    )  # fmt: skip
    script = Path(__file__).with_name("mitsuba_set_peer.py")
    paths = [str(folder / "job.npz"), str(folder / "peer.npz")]
    subprocess.run([sys.executable, str(script), *paths], check=True, timeout=3000)
    with np.load(folder / "peer.npz") as result:
        return np.asarray(result["picture"])


def test_room_matches_mitsuba_by_region_and_by_irradiance(tmp_path: Path):
    """Walls, ceiling, floor and six normals, to 0.5 % and two standard errors of Mitsuba's."""
    scene = read_set(ROOM, NM, [])
    theirs = peer(scene, tmp_path, samples=4096)
    model = make_model(scene, 1000)
    seen = see(model, solve(model)[0], HEIGHT)
    ours = seen.classes["tubes"]
    directions = texel_directions(HEIGHT, 2 * HEIGHT)
    met, _ = first_surfaces(model.surfaces.planes(), scene.capture_point, directions.reshape(-1, 3))
    met = met.reshape(ours.shape[:2])
    plain = sum(seen.lamp_cover) == 0.0
    for axis in (0, 1):
        for step in (-1, 1):
            plain &= np.roll(met, step, axis) == met
            plain &= np.roll(sum(seen.lamp_cover), step, axis) == 0.0
    size = np.broadcast_to(texel_solid_angles(HEIGHT, 2 * HEIGHT)[:, None], met.shape)
    weights = {}
    for name in sorted(set(scene.surfaces.names)):
        own = [k for k, other in enumerate(scene.surfaces.names) if other == name]
        weight = size * (np.isin(met, own) & plain)
        if weight.sum() > 0.2:
            weights[name] = weight
    for axis in range(3):
        for sign in (1.0, -1.0):
            weights[f"{sign:+g}{'xyz'[axis]}"] = size * np.maximum(sign * directions[..., axis], 0)
    assert len(weights) >= 11
    for name, weight in weights.items():
        groups = np.einsum("ghwb,hw->gb", theirs, weight)
        mean = groups.mean(axis=0)
        error = groups.std(axis=0, ddof=1) / np.sqrt(len(groups)) / mean
        ratio = np.einsum("hwb,hw->b", ours, weight) / mean
        print(name, np.round(100.0 * (ratio - 1.0), 2), np.round(100.0 * error, 2))
        assert (np.abs(ratio - 1.0) <= BOUND + 2.0 * error).all(), name
