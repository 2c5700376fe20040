"""The solved light of sets against light found with Mitsuba 3, band by band.

Mitsuba is given numbers, not USD: corners, reflectances, lamps. Photons of our own on its shapes
and rays (``mitsuba_photon_peer.py``) tell walls from one another to .1 %; that they are right is
checked against Mitsuba's path integrator (``mitsuba_set_peer.py``), which is noisier; in the yard,
where most paths end in the sky, it alone is asked. ``python tests/test_solve_mitsuba.py [SET]
[CELLS] [PHOTONS]`` prints the table of docs/sets.md.
"""

from __future__ import annotations

import importlib.util
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray

from usdskin.judge.truth.geometry import first_surfaces
from usdskin.judge.truth.panorama import see
from usdskin.judge.truth.radiosity import make_model, solve
from usdskin.judge.truth.sets import SetScene, read_set
from usdskin.judge.truth.sources import look_at_sky
from usdskin.latlong import texel_directions, texel_solid_angles

FloatArray = NDArray[np.float64]

pytestmark = [
    pytest.mark.slow,
    pytest.mark.skipif(
        importlib.util.find_spec("mitsuba") is None,
        reason="mitsuba is not installed; the extra `test` has it",
    ),
]

BOUND = 5.0e-3
HEIGHT = 32
SKY_ROWS = 256
NM = np.array([420.0, 440.0, 460.0, 490.0, 520.0, 550.0, 580.0, 600.0, 620.0, 640.0, 660.0, 690.0])
STAGES = Path(__file__).resolve().parents[1] / "stages"
SETS = ("room_fluorescent", "hall_incandescent", "mixed_window")
YARD = "outdoor_sun"


def peer(scene: SetScene, folder: Path, script: str, **job: int) -> dict[str, FloatArray]:
    """What a script finds."""
    surfaces, lamps = scene.surfaces, scene.lamps
    np.savez(
        folder / "job.npz", corner=surfaces.corner, along=surfaces.along, across=surfaces.across,
        reflectance=surfaces.reflectance, lamp_kind=[lamp.kind for lamp in lamps],
        lamp_center=[lamp.center for lamp in lamps], lamp_axes=[lamp.axes for lamp in lamps],
        lamp_half=[lamp.half for lamp in lamps],
        lamp_radiance=[lamp.radiance[0] for lamp in lamps],
        origin=scene.capture_point, height=HEIGHT, **far(scene), **job,
    )  # fmt: skip
    paths = [str(folder / "job.npz"), str(folder / "peer.npz")]
    path = str(Path(__file__).with_name(f"{script}.py"))
    subprocess.run([sys.executable, path, *paths], check=True, timeout=3000)
    with np.load(folder / "peer.npz") as result:
        return dict(result)


def far(scene: SetScene) -> dict[str, FloatArray]:
    """What shines without a place: one sky and one sun."""
    if not scene.skies:
        return {}
    (sky,), (sun,) = scene.skies, scene.suns
    ways = texel_directions(SKY_ROWS, 2 * SKY_ROWS)
    values = look_at_sky(sky, ways.reshape(-1, 3)) @ sky.basis
    return {
        "sky": values.reshape(*ways.shape[:2], -1),
        "sun_direction": sun.direction,
        "sun_irradiance": sun.irradiance,
    }


def photons(scene: SetScene, folder: Path, count: int) -> dict[str, FloatArray]:
    return peer(scene, folder, "mitsuba_photon_peer", photons=count, groups=10, bounces=300, grid=1)


def paths(scene: SetScene, folder: Path, samples: int) -> dict[str, FloatArray]:
    return peer(scene, folder, "mitsuba_set_peer", samples=samples, groups=16, depth=40)


def ours(scene: SetScene, cells: int) -> tuple[FloatArray, dict[str, FloatArray]]:
    """The panorama of all classes, and weights of the parts of it that are compared."""
    model = make_model(scene, cells)
    seen = see(model, solve(model)[0], HEIGHT)
    directions = texel_directions(HEIGHT, 2 * HEIGHT)
    met, _ = first_surfaces(model.surfaces.planes(), scene.capture_point, directions.reshape(-1, 3))
    met = met.reshape(directions.shape[:2])
    cover = sum(seen.lamp_cover, np.zeros(met.shape))
    plain = cover == 0.0
    for axis in (0, 1):
        for step in (-1, 1):
            plain &= (np.roll(met, step, axis) == met) & (np.roll(cover, step, axis) == 0.0)
    size = np.broadcast_to(texel_solid_angles(HEIGHT, 2 * HEIGHT)[:, None], met.shape)
    weights = {}
    for name in sorted(set(scene.surfaces.names)):
        own = [k for k, other in enumerate(scene.surfaces.names) if other == name]
        weight = size * (np.isin(met, own) & plain)
        if weight.sum() > 0.2:
            weights[name.rpartition("/")[2]] = weight
    for axis in range(3):
        for sign in (1.0, -1.0):
            weights[f"{sign:+g}{'xyz'[axis]}"] = size * np.maximum(sign * directions[..., axis], 0)
    return sum(seen.classes.values()), weights


def differences(
    found: FloatArray, groups: FloatArray, weights: dict[str, FloatArray]
) -> Iterator[tuple[str, FloatArray, FloatArray]]:
    """Each part's name, ratio less 1 and the relative error of the groups' mean, by band."""
    for name, weight in weights.items():
        each = np.einsum("ghwb,hw->gb", groups, weight)
        mean = each.mean(axis=0)
        error = each.std(axis=0, ddof=1) / np.sqrt(len(each)) / mean
        yield name, np.einsum("hwb,hw->b", found, weight) / mean - 1.0, error


@pytest.mark.parametrize("name", SETS)
def test_a_set_matches_photons_by_region_and_by_irradiance(tmp_path: Path, name: str):
    """Walls, ceiling, floor and six normals, twelve bands, to 0.5 % (and the noise of photons)."""
    scene = read_set(STAGES / name / "set.usda", NM, [])
    theirs = photons(scene, tmp_path, 2_000_000)
    found, weights = ours(scene, 1500)
    assert len(weights) >= 10
    for part, off, error in differences(found, theirs["picture"], weights):
        print(part, np.round(100.0 * off, 2), np.round(100.0 * error.max(), 2))
        assert (error < BOUND).all(), part
        assert (np.abs(off) <= BOUND + 2.0 * error).all(), part


def test_photons_agree_with_mitsubas_path_integrator(tmp_path: Path):
    """Of the office, to half a percent and the noise of paths."""
    scene = read_set(STAGES / "room_fluorescent" / "set.usda", NM[[1, 5, 10]], [])
    found = photons(scene, tmp_path, 1_000_000)["picture"].mean(axis=0)
    theirs = paths(scene, tmp_path, 4096)
    _, weights = ours(scene, 100)
    for part, off, error in differences(found, theirs["picture"], weights):
        print(part, np.round(100.0 * off, 2), np.round(100.0 * error, 2))
        assert (np.abs(off) <= BOUND + 3.0 * error).all(), part


def test_the_yard_matches_mitsubas_path_integrator(tmp_path: Path):
    """House, lawn, terrace and six normals under sun and sky, twelve bands, to 0.5 %."""
    scene = read_set(STAGES / YARD / "set.usda", NM, [])
    theirs = paths(scene, tmp_path, 8192)
    found, weights = ours(scene, 1500)
    assert len(weights) >= 9
    for part, off, error in differences(found, theirs["picture"], weights):
        print(part, np.round(100.0 * off, 2), np.round(100.0 * error.max(), 2))
        assert (error < 0.5 * BOUND).all(), part
        assert (np.abs(off) <= BOUND + 2.0 * error).all(), part


def main() -> None:
    """Print the table of docs/sets.md [%]: least and largest difference of the bands."""
    import tempfile

    names = sys.argv[1:2] or (*SETS, YARD)
    cells = int(sys.argv[2]) if len(sys.argv) > 2 else 1500
    count = int(sys.argv[3]) if len(sys.argv) > 3 else 4_000_000
    for name in names:
        scene = read_set(STAGES / name / "set.usda", NM, [])
        with tempfile.TemporaryDirectory() as folder:
            if name == YARD:
                theirs = paths(scene, Path(folder), 65536)
            else:
                theirs = photons(scene, Path(folder), count)
        found, weights = ours(scene, cells)
        for part, off, error in differences(found, theirs["picture"], weights):
            low, high, noise = 100 * off.min(), 100 * off.max(), 100 * error.max()
            print(f"| {name} | {part} | {low:+.2f} to {high:+.2f} | {noise:.2f} |", flush=True)


if __name__ == "__main__":
    main()
