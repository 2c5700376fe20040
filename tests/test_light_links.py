"""Which lights reach which prims, and whose shadows they see."""

from __future__ import annotations

import numpy as np
import pytest
import warp as wp
from light_stages import new_stage, read
from local_light_probes import probe_links
from pxr import Sdf, Usd, UsdGeom, UsdLux

from usdskin.render.light_links import read_links, upload_links

NOW = Usd.TimeCode.Default()
PRIMS = ("/Head/Skin", "/Head/Eye", "/Wall")


@pytest.fixture
def stage():
    stage = new_stage()
    for path in PRIMS:
        UsdGeom.Mesh.Define(stage, path)
    UsdLux.DomeLight.Define(stage, "/Sky")
    UsdLux.DistantLight.Define(stage, "/Sun")
    UsdLux.RectLight.Define(stage, "/Key")
    UsdLux.SphereLight.Define(stage, "/Bulb")
    return stage


def collection(stage, light, name="lightLink"):
    return Usd.CollectionAPI(stage.GetPrimAtPath(light), name)


def links(stage, prims=PRIMS):
    return read_links(stage, read(stage, places=True).paths, prims, NOW)


def lit(stage, prims=PRIMS):
    found = links(stage, prims)
    return found.lit[found.prim_set].astype(int).tolist()


def shadows(stage, prims=PRIMS):
    found = links(stage, prims)
    return found.shadows[found.prim_set].astype(int).tolist()


def test_by_default_everything_is_lit_at_no_cost(stage):
    found = links(stage)
    assert not found.active and found.lit.shape == (1, 4)
    assert upload_links(found, "cpu").prim_set.shape == (0,)


def test_lights_are_numbered_domes_distants_locals(stage):
    assert read(stage, places=True).paths == ("/Sky", "/Sun", "/Key", "/Bulb")
    collection(stage, "/Sun").CreateExcludesRel().AddTarget("/Wall")
    assert lit(stage) == [[1, 1, 1, 1], [1, 1, 1, 1], [1, 0, 1, 1]]


def test_excludes_take_out_what_is_below_them(stage):
    collection(stage, "/Key").CreateExcludesRel().AddTarget("/Head")
    assert lit(stage) == [[1, 1, 0, 1], [1, 1, 0, 1], [1, 1, 1, 1]]


def test_without_the_root_only_what_is_included_is_lit(stage):
    key = collection(stage, "/Key")
    key.CreateIncludeRootAttr(False)
    assert [row[2] for row in lit(stage)] == [0, 0, 0]
    key.CreateIncludesRel().AddTarget("/Head")
    assert [row[2] for row in lit(stage)] == [1, 1, 0]
    key.CreateExcludesRel().AddTarget("/Head/Eye")
    assert [row[2] for row in lit(stage)] == [1, 0, 0]


def test_expressions_select_prims(stage):
    key = collection(stage, "/Key")
    key.CreateIncludeRootAttr(False)
    key.CreateMembershipExpressionAttr(Sdf.PathExpression("//Eye"))
    assert [row[2] for row in lit(stage)] == [0, 1, 0]


def test_domes_are_linked_too(stage):
    collection(stage, "/Sky").CreateExcludesRel().AddTarget("/Wall")
    assert [row[0] for row in lit(stage)] == [1, 1, 0]


def test_shadow_links_are_apart_from_light_links(stage):
    collection(stage, "/Bulb", "shadowLink").CreateExcludesRel().AddTarget("/Head/Skin")
    assert lit(stage) == [[1] * 4] * 3
    assert [row[3] for row in shadows(stage)] == [0, 1, 1]


def test_shadows_can_be_turned_off(stage):
    api = UsdLux.ShadowAPI.Apply(stage.GetPrimAtPath("/Key"))
    assert [row[2] for row in shadows(stage)] == [1, 1, 1]
    api.CreateShadowEnableAttr(False)
    assert [row[2] for row in shadows(stage)] == [0, 0, 0]


def test_instances_are_linked_one_by_one(stage):
    UsdGeom.Mesh.Define(stage, "/Source/Part")
    for name in ("/A", "/B"):
        prim = UsdGeom.Xform.Define(stage, name).GetPrim()
        prim.GetReferences().AddInternalReference("/Source")
        prim.SetInstanceable(True)
    collection(stage, "/Key").CreateExcludesRel().AddTarget("/A")
    assert stage.GetPrimAtPath("/A/Part").IsInstanceProxy()
    assert [row[2] for row in lit(stage, ("/A/Part", "/B/Part"))] == [0, 1]


def test_prims_share_rows(stage):
    collection(stage, "/Key").CreateExcludesRel().AddTarget("/Wall")
    many = [f"/Head/Hair{k}" for k in range(50)] + ["/Wall/Brick"]
    found = links(stage, many)
    assert found.lit.shape == (2, 4) and len(found.prim_set) == 51


def test_kernels_ask_the_tables(stage, device):
    collection(stage, "/Key").CreateExcludesRel().AddTarget("/Wall")
    collection(stage, "/Bulb", "shadowLink").CreateExcludesRel().AddTarget("/Head/Skin")
    tables = links(stage)
    out = wp.zeros((3, 4), dtype=wp.vec2i, device=device)
    wp.launch(probe_links, (3, 4), [upload_links(tables, device), out], device=device)
    found = out.numpy()
    assert found[..., 0].tolist() == tables.lit[tables.prim_set].astype(int).tolist()
    assert found[..., 1].tolist() == tables.shadows[tables.prim_set].astype(int).tolist()
    plain = wp.zeros((3, 4), dtype=wp.vec2i, device=device)
    all_lit = read_links(new_stage(), (), PRIMS, NOW)
    wp.launch(probe_links, (3, 4), [upload_links(all_lit, device), plain], device=device)
    assert (plain.numpy() == np.ones((3, 4, 2))).all()
