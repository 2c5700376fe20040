"""Skin's lustre against Mitsuba 3's ``roughdielectric``, ``roughplastic`` and our own lobes.

A plate of black skin reflects; Mitsuba's BSDF is asked for its values alone and integrated here
in float64. The two differ in how they mask: ours is Smith's height-correlated function, Mitsuba's the
product of both directions' shares, which loses light at grazing angles. ``correlated`` exchanges
the one for the other, in closed form.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from traced_scenes import NM, Body, add_body, add_dome, add_view, box, new_stage, ready, soft_room

from usdskin import fresnel
from usdskin.progress import SilentProgress
from usdskin.render.integrate import integrate
from usdskin.render.lobe_albedo import dielectric_albedo
from usdskin.render.uploading import upload

FloatArray = np.ndarray[Any, np.dtype[np.float64]]
Sky = Callable[[FloatArray], FloatArray]

INDEX = 1.4
F0 = ((INDEX - 1.0) / (INDEX + 1.0)) ** 2
ROUGHNESS = (0.1, 0.2, 0.4, 0.7)
ANGLES_DEG = (0.0, 20.0, 35.0, 60.0, 75.0, 85.0)
BOTH = (0.2, 0.4, 0.3)
"""Roughness of two lobes, and the share of the second."""

BOUND = 0.02
"""Of the project: GGX within 2 % of Mitsuba's."""

ROWS = 64
LAMP = (12, 53)
"""Texel of the lamp: 35 degrees from the plate's normal, where the view of 35 is mirrored to."""


# --- Mitsuba's half ------------------------------------------------------------------------------


@pytest.fixture(scope="module")
def mi() -> Any:
    """Mitsuba without LLVM."""
    module = pytest.importorskip("mitsuba", reason="the extra `test` has Mitsuba")
    module.set_variant("scalar_rgb")
    return module


def rough(mi: Any, roughness: float, kind: str = "roughdielectric", **more: Any) -> Any:
    """Return Mitsuba's BSDF of our surface."""
    about = {"distribution": "ggx", "alpha": roughness**2, "int_ior": INDEX, "ext_ior": 1.0}
    return mi.load_dict({"type": kind, **about, **more})


def values(mi: Any, bsdf: Any, view: FloatArray, toward: FloatArray, component: int) -> FloatArray:
    """Return f n.l of Mitsuba's, in its frame (z is the normal), shape [count]."""
    si = mi.SurfaceInteraction3f()
    si.wi = mi.Vector3f(*map(float, view))
    context = mi.BSDFContext()
    context.component = component
    return np.array([bsdf.eval(context, si, mi.Vector3f(*map(float, d)))[0] for d in toward])


def masking(alpha: float, nl: FloatArray, nv: float) -> FloatArray:
    """Return the height-correlated share over the product of both directions' (Heitz 2014)."""

    def root(cosine: FloatArray | float) -> FloatArray:
        return np.sqrt(1.0 + alpha**2 * (1.0 / np.square(cosine) - 1.0))

    a, b = root(nl), root(nv)
    return (2.0 / (a + b)) / (4.0 / ((1.0 + a) * (1.0 + b)))


def half_vectors(roughness: float, view: FloatArray, count: int) -> tuple[FloatArray, FloatArray]:
    """Return directions mirrored at normals drawn from D n.h, and the densities' inverses."""
    a2 = roughness**4
    u, v = np.meshgrid((np.arange(count) + 0.5) / count, (np.arange(count) + 0.5) / count)
    u, v = u.ravel(), 2.0 * np.pi * v.ravel()
    cosine = np.sqrt((1.0 - u) / (1.0 + (a2 - 1.0) * u))
    sine = np.sqrt(1.0 - cosine**2)
    half = np.stack([sine * np.cos(v), sine * np.sin(v), cosine], axis=-1)
    between = half @ view
    toward = 2.0 * between[:, None] * half - view
    density = a2 / (np.pi * (cosine**2 * (a2 - 1.0) + 1.0) ** 2) * cosine / (4.0 * between)
    used = (between > 0.0) & (toward[:, 2] > 1e-6)
    return toward[used], 1.0 / (density[used] * u.size)


def lamp_directions(count: int) -> tuple[FloatArray, float]:
    """Return directions over the lamp's texel in Mitsuba's frame, and the solid angle of each."""
    row, column = LAMP
    edge = np.cos(np.pi * np.array([row, row + 1]) / ROWS)
    y = edge[0] + (edge[1] - edge[0]) * (np.arange(count) + 0.5) / count
    turn = np.pi * (column + (np.arange(count) + 0.5) / count) / ROWS
    y, turn = (each.ravel() for each in np.meshgrid(y, turn))
    sine = np.sqrt(1.0 - y**2)
    world = np.stack([sine * np.sin(turn), y, -sine * np.cos(turn)], axis=-1)
    return to_local(world), float((edge[0] - edge[1]) * np.pi / ROWS / count**2)


def to_local(world: FloatArray) -> FloatArray:
    """Mitsuba's frame of the plate: z is world y, y is world -z."""
    return np.stack([world[..., 0], -world[..., 2], world[..., 1]], axis=-1)


def to_world(local: FloatArray) -> FloatArray:
    return np.stack([local[..., 0], local[..., 2], -local[..., 1]], axis=-1)


def peer(
    mi: Any, roughness: float, view: FloatArray, sky: FloatArray, *, correlated: bool,
    kind: str = "roughdielectric", component: int = 0, count: int = 96,
) -> float:  # fmt: skip
    """Return what Mitsuba's lobe reflects of a sky towards ``view`` (in its frame)."""
    lamp = float(sky[LAMP])
    beside = sky.copy()
    beside[LAMP] = sky[LAMP[0] + 1, LAMP[1]]
    more = {"diffuse_reflectance": {"type": "rgb", "value": [0.0, 0.0, 0.0]}}
    bsdf = rough(mi, roughness, kind, **(more if kind == "roughplastic" else {}))
    toward, weight = half_vectors(roughness, view, count)
    found = values(mi, bsdf, view, toward, component) * weight * seen(beside, to_world(toward))
    if correlated:
        found = found * masking(roughness**2, toward[:, 2], float(view[2]))
    total = float(found.sum())
    extra = lamp - float(beside[LAMP])
    if extra > 0.0:
        toward, angle = lamp_directions(40)
        found = values(mi, bsdf, view, toward, component)
        if correlated:
            found = found * masking(roughness**2, toward[:, 2], float(view[2]))
        total += extra * angle * float(found.sum())
    return total


# --- Skies ---------------------------------------------------------------------------------------


def seen(sky: FloatArray, world: FloatArray) -> FloatArray:
    """Return a latlong sky's texel in each direction."""
    polar = np.arccos(np.clip(world[:, 1], -1.0, 1.0)) / np.pi
    turn = np.arctan2(world[:, 0], -world[:, 2]) / (2.0 * np.pi) % 1.0
    row = np.minimum((polar * ROWS).astype(int), ROWS - 1)
    return np.asarray(sky[row, np.minimum((turn * 2 * ROWS).astype(int), 2 * ROWS - 1)])


def sky_of(name: str) -> FloatArray:
    if name == "uniform":
        return np.ones((ROWS, 2 * ROWS))
    gradient = soft_room(ROWS)[..., 1]
    if name == "lamp":
        gradient = 0.2 * gradient
        gradient[LAMP] += 400.0
    return gradient


def view_at(angle_deg: float) -> FloatArray:
    """A view in Mitsuba's frame, in the lamp's plane but on the other side of the normal."""
    lamp = lamp_directions(1)[0][0]
    away = -lamp[:2] / np.linalg.norm(lamp[:2])
    angle = np.radians(angle_deg)
    return np.array([*(np.sin(angle) * away), np.cos(angle)])


# --- Our half ------------------------------------------------------------------------------------


def ours(folder: Any, sky: FloatArray, samples: int) -> dict[str, FloatArray]:
    """Return what both integrators show of the plates, [plate, angle]; the last has two lobes."""
    stage = new_stage()
    looks = [(each, each, 0.0) for each in ROUGHNESS] + [BOTH]
    points, faces = box([-1.0, -0.2, -1.0], [1.0, 0.0, 1.0])
    for k, (first, second, mix) in enumerate(looks):
        look = {"weight": 1.0, "roughness1": first, "roughness2": second, "mix": mix, "f0": F0}
        plate = Body(points=points + [4.0 * k, 0.0, 0.0], faces=faces, alpha=0.0, specular=look)
        add_body(stage, plate, f"Plate{k}")
    add_dome(stage, folder, sky[..., None])
    add_view(stage, np.array([0.0, 2.0, 0.0]), np.zeros(3), 0.1)
    view = ready(stage, 16)
    device_scene, _ = upload(view.scene, view.workers, show_dome=False)
    found = {name: np.zeros((len(looks), len(ANGLES_DEG))) for name in ("traced", "map")}
    for j, angle in enumerate(ANGLES_DEG):
        back = to_world(view_at(angle))
        for k in range(len(looks)):
            target = np.array([4.0 * k + 0.1, 0.0, 0.05])
            seeing = replace(view, camera=looking(view.camera, target + 1.5 * back, back))
            found["traced"][k, j] = seeing.spectra(samples, parts=False).mean()
            picture = integrate(
                device_scene, seeing.camera, (1, 1), 1, "box", view.workers, SilentProgress(),
                spectral=True, show_dome=False,
            )  # fmt: skip
            assert picture.spectrum is not None
            found["map"][k, j] = picture.spectrum.mean()
    return found


def looking(camera: Any, origin: FloatArray, back: FloatArray) -> Any:
    """Return a camera whose rays are all one."""
    right = np.cross([0.31, 0.85, -0.42], back)
    right /= np.linalg.norm(right)
    frame = np.eye(4)
    frame[:3] = np.stack([right, np.cross(back, right), back, origin], axis=-1)
    width = 1e-7
    return replace(
        camera, to_world=frame, orthographic=True, window=(-width, width, -width, width),
        clip_near=1e-6, clip_far=1e6,
    )  # fmt: skip


# --- Comparisons ---------------------------------------------------------------------------------


def expected(mi: Any, sky: FloatArray, *, correlated: bool) -> FloatArray:
    """Return Mitsuba's figures, [plate, angle]."""
    rows = [
        [peer(mi, each, view_at(angle), sky, correlated=correlated) for angle in ANGLES_DEG]
        for each in ROUGHNESS
    ]
    both = [(1.0 - BOTH[2]) * a + BOTH[2] * b for a, b in zip(rows[1], rows[2], strict=True)]
    return np.array([*rows, both])


if __name__ == "__main__":
    import tempfile
    from pathlib import Path
    import mitsuba
    mitsuba.set_variant("scalar_rgb")
    np.set_printoptions(precision=2, suppress=True, linewidth=160)
    for name in ("uniform", "gradient", "lamp"):
        sky = sky_of(name)
        with tempfile.TemporaryDirectory() as folder:
            mine = ours(Path(folder), sky, 1024)
        a, b = (expected(mitsuba, sky, correlated=c) for c in (False, True))
        print(name); print(a)
        for which in mine:
            print(which, "over Mitsuba as it is, %"); print(100 * (mine[which] / a - 1))
            print(which, "over Mitsuba with our masking, %"); print(100 * (mine[which] / b - 1))
