"""Shadowed pictures against Mitsuba 3's, of a body that another one takes light from.

The scene is that of ``test_mitsuba`` with a black box beside the body.
"""

from __future__ import annotations

import importlib.util
from pathlib import Path

import numpy as np
import pytest
from test_mitsuba import (
    BOUND,
    FOV_DEG,
    SIZE,
    TABLE_NM,
    TURNED,
    FloatArray,
    _author_dome,
    _author_mesh,
    _author_skin,
    blocks,
    camera,
    mitsuba,
    on_bands,
    spectra,
    turn,
)
from traced_scenes import Body, add_body, box

from usdskin.images import read_spectral
from usdskin.progress import SilentProgress
from usdskin.render.overrides import RenderOverrides
from usdskin.render.render import render_stage
from usdskin.spectrum import DEFAULT_WAVELENGTHS_NM as NM
from usdskin.spectrum import band_edges

# isort: split
# After ours, which register the schemas.
from pxr import Gf, Usd, UsdGeom

pytestmark = pytest.mark.skipif(
    importlib.util.find_spec("mitsuba") is None,
    reason="mitsuba is not installed; the extra `test` has it",
)

OPAQUE = 1.0e9


def occluder() -> tuple[FloatArray, np.ndarray]:
    """A slab above and before the body, oblique, seen in part: black skin."""
    points, faces = box([-0.9, -0.1, -0.5], [0.5, 0.1, 0.6])
    return points @ turn((1.0, 0.3, -0.6), 35.0).T + [-0.35, 0.95, 0.55], faces


def ours(folder: Path, wrap: float, scattering: FloatArray, delta: float) -> FloatArray:
    """Write a stage, trace it and return its spectra, shape [h, w, bands]."""
    stage = Usd.Stage.CreateNew(str(folder / "shot.usda"))
    UsdGeom.SetStageUpAxis(stage, "Y")
    UsdGeom.SetStageMetersPerUnit(stage, 1.0)
    _author_mesh(stage)
    _author_skin(stage, wrap, scattering)
    stage.GetPrimAtPath("/Skin").GetAttribute("inputs:skin:opacity").Set(delta)
    _author_dome(stage, folder, TURNED)
    points, faces = occluder()
    add_body(stage, Body(points=points, faces=faces, alpha=0.0), "Occluder")
    view = UsdGeom.Camera.Define(stage, "/Camera")
    view.AddTransformOp().Set(Gf.Matrix4d(camera("Y").T))
    view.CreateFocalLengthAttr(50.0)
    for attribute in (view.CreateHorizontalApertureAttr(), view.CreateVerticalApertureAttr()):
        attribute.Set(2.0 * 50.0 * np.tan(np.radians(FOV_DEG / 2.0)))
    view.CreateClippingRangeAttr(Gf.Vec2f(0.1, 100.0))
    stage.Save()
    asked = RenderOverrides(
        resolution=(SIZE, SIZE), samples=256, pixel_filter="box", spectral_output=True, png=False,
        integrator="traced",
    )  # fmt: skip
    render_stage(folder / "shot.usda", folder / "shot.exr", asked, SilentProgress())
    return read_spectral(folder / "shot.spectral.exr")[1].astype(np.float64)


def test_a_shaded_lambert_body_matches_mitsubas_path_tracer(tmp_path: Path):
    """Every block and every band, by Mitsuba's own envmap, diffuse and path."""
    points, faces = occluder()
    found = ours(tmp_path, 0.0, np.zeros(len(TABLE_NM)), OPAQUE)
    peer = mitsuba(
        tmp_path, "coefficients", "Y", TURNED, passes=2, samples=2048, occluder_points=points,
        occluder_faces=faces,
    )  # fmt: skip
    band = on_bands(spectra()["basis"])
    expected = (peer @ band) * (0.6 * on_bands(spectra()["reflectance"][None])[0])
    ratio = found.mean(axis=(0, 1)) / expected.mean(axis=(0, 1))
    assert np.abs(ratio - 1.0).max() <= BOUND
    expected = blocks(expected)
    is_lit = expected.max(axis=-1) > 0.1 * expected.max()
    assert is_lit.sum() >= 6
    assert np.abs(blocks(found)[is_lit] / expected[is_lit] - 1.0).max() <= 2.0 * BOUND


@pytest.mark.slow
@pytest.mark.parametrize("delta", [0.0, OPAQUE], ids=["clear", "opaque"])
def test_shaded_skin_matches_mitsuba_band_by_band(tmp_path: Path, delta: float):
    """With the wrap term, which a clear body lets through from behind and an opaque one stops."""
    points, faces = occluder()
    table = spectra()
    found = ours(tmp_path, 0.3, table["scattering"], delta)
    peer = mitsuba(
        tmp_path, "skin", "Y", TURNED, passes=6, samples=1024, wavelength_nm=TABLE_NM,
        basis=table["basis"], reflectance=table["reflectance"], scattering=table["scattering"],
        wrap=0.3, alpha=0.6, band_edges_nm=band_edges(NM), occluder_points=points,
        occluder_faces=faces, is_opaque=delta > 0.0,
    )  # fmt: skip
    peer = peer / np.diff(band_edges(NM))
    ratio = found.mean(axis=(0, 1)) / peer.mean(axis=(0, 1))
    assert np.abs(ratio - 1.0).max() <= BOUND
    assert np.abs(ratio.mean() - 1.0) <= 0.2 * BOUND
    unshaded = ours(tmp_path, 0.3, table["scattering"], 0.0 if delta else OPAQUE)
    assert np.abs(unshaded.mean() / found.mean() - 1.0) > 2.0 * BOUND, "the bodies look alike"
