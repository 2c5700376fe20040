"""Skin's lustre against Mitsuba 3's ``roughdielectric``, ``roughplastic`` and our own lobes.

A plate of black skin reflects; Mitsuba's BSDF is asked for its values alone and integrated here
in float64. The two differ in how they mask: ours is Smith's height-correlated function, Mitsuba's
the product of both directions' shares, which loses light at grazing angles. ``masking`` exchanges
the one for the other, in closed form.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from traced_scenes import Body, add_body, add_dome, add_view, box, new_stage, ready, soft_room

from usdskin.estimate.skin.lobe import directional_albedo
from usdskin.progress import SilentProgress
from usdskin.render.integrate import integrate
from usdskin.render.uploading import upload

FloatArray = np.ndarray[Any, np.dtype[np.float64]]
Sky = Callable[[FloatArray], FloatArray]

INDEX = 1.4
F0 = ((INDEX - 1.0) / (INDEX + 1.0)) ** 2
ROUGHNESS = (0.1, 0.2, 0.4, 0.7)
ANGLES_DEG = (0.0, 35.0, 60.0, 75.0, 85.0)
BOTH = (0.2, 0.4, 0.3)
"""Roughness of two lobes, and the share of the second."""

BOUND = 0.02
"""Of the project: GGX within 2 % of Mitsuba's."""

MAP_BOUND, ROUGH_BOUND = 0.03, 0.15
"""Of what is prefiltered: up to a roughness of 0.4, and at 0.7."""

SLOW = pytest.mark.slow

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
    mi: Any, roughness: float, view: FloatArray, sky: FloatArray, kind: str = "roughdielectric",
    count: int = 64,
) -> FloatArray:  # fmt: skip
    """Return what Mitsuba's lobe reflects towards ``view``: with our masking, and as it is."""
    lamp = float(sky[LAMP])
    beside = sky.copy()
    beside[LAMP] = sky[LAMP[0] + 1, LAMP[1]]
    more = {"diffuse_reflectance": {"type": "rgb", "value": [0.0, 0.0, 0.0]}}
    bsdf = rough(mi, roughness, kind, **(more if kind == "roughplastic" else {}))
    parts = []
    toward, weight = half_vectors(roughness, view, count)
    parts.append((toward, weight * seen(beside, to_world(toward))))
    extra = lamp - float(beside[LAMP])
    if extra > 0.0:
        toward, angle = lamp_directions(40)
        parts.append((toward, np.full(len(toward), extra * angle)))
    total = np.zeros(2)
    for toward, weight in parts:
        found = values(mi, bsdf, view, toward, 0) * weight
        ratio = masking(roughness**2, toward[:, 2], float(view[2]))
        total += (found * ratio).sum(), found.sum()
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


def expected(mi: Any, sky: FloatArray) -> FloatArray:
    """Return Mitsuba's figures with our masking, and as it is, [2, plate, angle]."""
    rows = np.array(
        [[peer(mi, each, view_at(angle), sky) for angle in ANGLES_DEG] for each in ROUGHNESS]
    )
    both = (1.0 - BOTH[2]) * rows[1] + BOTH[2] * rows[2]
    return np.moveaxis(np.concatenate([rows, both[None]]), 2, 0)


def said(name: str, found: FloatArray, exact: FloatArray) -> str:
    return f"{name}: found over Mitsuba's, %\n{np.round(100.0 * (found / exact - 1.0), 2)}"


@pytest.mark.parametrize("name", ["uniform", "lamp", pytest.param("gradient", marks=SLOW)])
def test_lobes_reflect_what_mitsubas_reflect(tmp_path, mi, name):
    sky = sky_of(name)
    found, exact = ours(tmp_path, sky, 256), expected(mi, sky)
    for which, bound in (("traced", BOUND), ("map", MAP_BOUND)):
        far = np.abs(found[which] / exact[0] - 1.0)
        smooth = np.array([*ROUGHNESS, BOTH[1]]) < 0.5
        assert far[smooth].max() < bound, said(which, found[which], exact[0])
        assert far.max() < (bound if which == "traced" else ROUGH_BOUND), said(
            which, found[which], exact[0]
        )
    # Mitsuba as it is: its masking differs where rough surfaces are seen at a slant, by 20 %.
    alike = np.ones_like(exact[0], bool)
    alike[2:4, np.array(ANGLES_DEG) > 75.0] = False
    alike[3, np.array(ANGLES_DEG) > 35.0] = False
    alike[4, np.array(ANGLES_DEG) > 75.0] = False
    far = np.abs(found["traced"] / exact[1] - 1.0)
    assert far[alike].max() < BOUND, said("as it is", found["traced"], exact[1])


def test_albedo_tables_are_mitsubas_white_furnace(mi):
    """Between the tables' nodes too, and with Mitsuba's surface of a plastic as well."""
    white = np.ones((ROWS, 2 * ROWS))
    for roughness in ROUGHNESS:
        for angle in ANGLES_DEG:
            view = view_at(angle)
            exact = [
                peer(mi, roughness, view, white, kind=kind)[0]
                for kind in ("roughdielectric", "roughplastic")
            ]
            found = directional_albedo(roughness, view[2:], F0)[0]
            assert found == pytest.approx(exact[0], rel=0.01)
            assert found == pytest.approx(exact[1], rel=0.01)


@pytest.mark.parametrize("roughness", [0.1, 0.4, 0.7])
def test_white_skin_with_lustre_gives_back_no_less_than_white_plastic(tmp_path, mi, roughness):
    """All of uniform light. Mitsuba's ``roughplastic`` is as good only where it is smooth: what its
    masking takes from a rough surface is lost, where ours leaves it to the skin below."""
    stage = new_stage()
    points, faces = box([-1.0, -0.2, -1.0], [1.0, 0.0, 1.0])
    look = {"weight": 1.0, "roughness1": roughness, "roughness2": roughness, "f0": F0}
    add_body(stage, Body(points=points, faces=faces, specular=look))
    add_dome(stage, tmp_path, np.ones((8, 16, 1)))
    add_view(stage, np.array([0.0, 2.0, 0.0]), np.zeros(3), 0.1)
    view = ready(stage, 16)
    more = {"diffuse_reflectance": {"type": "rgb", "value": [1.0, 1.0, 1.0]}}
    plastic = rough(mi, roughness, "roughplastic", **more)
    count = 48
    u, v = np.meshgrid((np.arange(count) + 0.5) / count, (np.arange(count) + 0.5) / count)
    sine, turn = np.sqrt(u.ravel()), 2.0 * np.pi * v.ravel()
    toward = np.stack([sine * np.cos(turn), sine * np.sin(turn), np.sqrt(1.0 - sine**2)], axis=-1)
    for angle in ANGLES_DEG[::2]:
        local = view_at(angle)
        back = to_world(local)
        camera = looking(view.camera, np.array([0.1, 0.0, 0.05]) + 1.5 * back, back)
        seeing = replace(view, camera=camera)
        traced, mapped = seeing.spectra(256, parts=False).mean(), seeing.mapped(1).mean()
        below = values(mi, plastic, local, toward, 1) / toward[:, 2]
        above = peer(mi, roughness, local, np.ones((ROWS, 2 * ROWS)))[0]
        exact = np.pi * below.mean() + above
        assert mapped == pytest.approx(1.0, abs=1e-3)
        assert 1.0 - 5e-3 <= traced <= 1.0 + 5e-3
        assert exact <= mapped + 1e-3
        if roughness < 0.2:
            assert mapped == pytest.approx(exact, rel=BOUND)
