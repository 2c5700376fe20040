"""Mattes by name: the specification's hashes and headers, and coverage that adds up to alpha."""

from __future__ import annotations

import itertools
import json
from pathlib import Path

import numpy as np
import OpenEXR
import pytest

from usdskin.progress import SilentProgress
from usdskin.render.aovs import MATTES, requested_aovs
from usdskin.render.cryptomatte import (
    RANKS,
    _ranked,
    matte_id,
    matte_parts,
    metadata,
    murmur_hash,
)
from usdskin.render.overrides import RenderOverrides
from usdskin.render.render import render_stage


@pytest.mark.parametrize(
    ("text", "expected"),
    [
        ("", 0),
        ("test", 0xBA6BD213),
        ("Hello, world!", 0xC0363E43),
        ("The quick brown fox jumps over the lazy dog", 0x2E4FF723),
    ],
)
def test_hash_is_murmurhash3_x86_32(text, expected):
    """Published test vectors of MurmurHash3_x86_32 with seed 0."""
    assert murmur_hash(text) == expected


@pytest.mark.parametrize(
    ("name", "expected"),
    [
        ("hello", 6.0705627102400005616e-17),
        ("cube", -4.08461912519e15),
        ("sphere", 2.79018604383e15),
        ("plane", 3.66557617593e-11),
        ("равнина", -1.3192631212399999468e-25),
        ("mädchen", 6.2361298211599995797e25),
    ],
)
def test_id_is_that_of_the_reference_implementation(name, expected):
    """Values of Psyop/Cryptomatte, nuke/cryptomatte_utilities_tests.py, class CryptoHashing."""
    found = np.array([matte_id(name)], np.uint32).view(np.float32)[0]
    np.testing.assert_allclose(found, expected, rtol=1e-7)


def test_ids_of_paths_and_layers_are_those_of_another_renderer():
    """Gaffer's GafferScene tests: a path's id, and the key of the layer crypto_object."""
    path = "/GAFFERBOT/C_torso_GRP/C_head_GRP/C_head_CPT/C_head001_REN"
    assert matte_id(path) == 4226998693
    assert "cryptomatte/f834d0a/name" in metadata("crypto_object", [])


def test_no_id_is_an_infinity_or_denormal():
    ids = np.array([matte_id(f"/World/Prim_{k}") for k in range(3000)], np.uint32)
    exponent = ids >> 23 & 255
    assert exponent.min() > 0 and exponent.max() < 255
    hashes = np.array([murmur_hash(f"/World/Prim_{k}") for k in range(3000)], np.uint32)
    assert (hashes != ids).any(), "some of these needed it"


def test_header_names_what_the_specification_asks_for():
    header = metadata("crypto_object", ["/World/Ball", 'a"b'])
    assert set(header) == {
        f"cryptomatte/f834d0a/{key}" for key in ("name", "hash", "conversion", "manifest")
    }
    assert header["cryptomatte/f834d0a/name"] == "crypto_object"
    assert header["cryptomatte/f834d0a/hash"] == "MurmurHash3_32"
    assert header["cryptomatte/f834d0a/conversion"] == "uint32_to_float32"
    manifest = json.loads(header["cryptomatte/f834d0a/manifest"])
    assert manifest == {name: f"{matte_id(name):08x}" for name in ("/World/Ball", 'a"b')}


def test_slots_of_one_name_are_joined_and_the_widest_comes_first():
    ids = np.float32([10.0, 20.0, 30.0])
    label = np.int32([[2, 0, 2, -1], [1, -1, -1, -1], [-1, -1, -1, -1]])
    coverage = np.float32([[0.25, 0.375, 0.25, 0.0], [1.0, 0, 0, 0], [0, 0, 0, 0]])
    ranked = _ranked(label, coverage, ids)
    assert ranked.shape == (3, RANKS, 2)
    np.testing.assert_array_equal(ranked[0, :3], [[30, 0.5], [10, 0.375], [0, 0]])
    np.testing.assert_array_equal(ranked[1, :2], [[20, 1.0], [0, 0]])
    assert not ranked[2].any()


def test_parts_hold_two_pairs_each_as_floats():
    ranked = np.arange(2 * 3 * RANKS * 2, dtype=np.float32).reshape(2, 3, RANKS, 2)
    parts = matte_parts("m", ranked, ["a"], {"more": 1})
    assert [part.name for part in parts] == ["m00", "m01", "m02"]
    assert list(parts[1].channels) == ["m01.R", "m01.G", "m01.B", "m01.A"]
    np.testing.assert_array_equal(parts[1].channels["m01.B"], ranked[:, :, 3, 0])
    assert all(part.sample_type == "float" and part.attributes["more"] == 1 for part in parts)


def test_cryptomatte_asks_for_both_mattes():
    assert [aov.source for aov in requested_aovs(["cryptomatte"], False)] == list(MATTES)
    assert [aov.source for aov in requested_aovs(["N", "crypto_material"], False)][-1] == MATTES[1]


STAGE = """#usda 1.0
(
    defaultPrim = "World"
    metersPerUnit = 1
    upAxis = "Y"
)
def Xform "World"
{
    def Sphere "Ball" (prepend apiSchemas = ["MaterialBindingAPI"])
    {
        double radius = 0.1
        rel material:binding = </World/Red>
    }
    def Cube "Box"
    {
        double size = 0.1
        double3 xformOp:translate = (0.12, 0.03, 0)
        uniform token[] xformOpOrder = ["xformOp:translate"]
    }
    def Mesh "Veil" (prepend apiSchemas = ["MaterialBindingAPI"])
    {
        int[] faceVertexCounts = [4]
        int[] faceVertexIndices = [0, 1, 2, 3]
        point3f[] points = [(-0.2, -0.2, 0.15), (0.2, -0.2, 0.15), (0.2, 0, 0.15), (-0.2, 0, 0.15)]
        rel material:binding = </World/Glass>
    }
    def Material "Red"
    {
        token outputs:surface.connect = </World/Red/S.outputs:surface>
        def Shader "S"
        {
            uniform token info:id = "UsdPreviewSurface"
            color3f inputs:diffuseColor = (0.8, 0.1, 0.1)
            token outputs:surface
        }
    }
    def Material "Glass"
    {
        token outputs:surface.connect = </World/Glass/S.outputs:surface>
        def Shader "S"
        {
            uniform token info:id = "UsdPreviewSurface"
            float inputs:opacity = 0.25
            token outputs:surface
        }
    }
    def Camera "Camera"
    {
        float focalLength = 0.5
        float horizontalAperture = 0.5
        float verticalAperture = 0.5
        float2 clippingRange = (0.01, 10)
        double3 xformOp:translate = (0, 0, 0.6)
        uniform token[] xformOpOrder = ["xformOp:translate"]
    }
    def DomeLight "Sky" (prepend apiSchemas = ["SpectralLightAPI"])
    {
        uniform token inputs:spectral:source = "rgb"
    }
}
"""


def mattes(path):
    """Return beauty, and by layer the decoded mattes {name: coverage}, as a compositor would."""
    with OpenEXR.File(str(path), separate_channels=True) as file:
        parts = {part.header["name"]: part for part in file.parts}
        header = {key: value for key, value in file.parts[0].header.items()}
        found = {}
        for key in [key for key in header if key.endswith("/manifest")]:
            layer = header[key.replace("/manifest", "/name")]
            pairs = [
                (parts[f"{layer}{k:02d}"].channels[f"{layer}{k:02d}.{a}"].pixels,
                 parts[f"{layer}{k:02d}"].channels[f"{layer}{k:02d}.{b}"].pixels)
                for k in range(3) for a, b in ("RG", "BA")
            ]  # fmt: skip
            found[layer] = {
                name: sum(np.where(ids.view(np.uint32) == int(code, 16), share, 0.0)
                          for ids, share in pairs)
                for name, code in json.loads(header[key]).items()
            }  # fmt: skip
            for first, second in itertools.pairwise(pairs):
                assert (first[1] >= second[1]).all(), "ranks descend"
        beauty = {name: channel.pixels for name, channel in parts["beauty"].channels.items()}
    return beauty, found


@pytest.fixture(scope="module")
def picture(tmp_path_factory) -> Path:
    folder = tmp_path_factory.mktemp("mattes")
    layer = folder / "shot.usda"
    layer.write_text(STAGE)
    overrides = RenderOverrides(
        width=48, samples=16, png=False, threads=2, dome="hide", aovs=("cryptomatte",),
        device="cpu",
    )  # fmt: skip
    render_stage(layer, folder / "out.exr", overrides, SilentProgress())
    return folder / "out.exr"


def test_coverage_of_all_objects_is_the_alpha_of_the_beauty(picture):
    beauty, found = mattes(picture)
    assert set(found) == set(MATTES)
    for layer in found.values():
        np.testing.assert_allclose(sum(layer.values()), beauty["A"], atol=1e-5)
    partly = (beauty["A"] > 0.02) & (beauty["A"] < 0.98)
    assert partly.any()


def test_veil_covers_as_much_as_it_is_opaque_and_leaves_the_rest_to_what_is_behind(picture):
    _, found = mattes(picture)
    objects = found["crypto_object"]
    assert set(objects) == {"/World/Ball", "/World/Box", "/World/Veil"}
    assert objects["/World/Veil"][28, 24] == pytest.approx(0.25)
    assert objects["/World/Ball"][28, 24] == pytest.approx(0.75)
    assert objects["/World/Ball"][20, 24] == pytest.approx(1.0)


def test_materials_go_by_their_paths_and_displaycolor_has_a_name(picture):
    _, found = mattes(picture)
    objects, materials = found["crypto_object"], found["crypto_material"]
    for prim, material in (
        ("/World/Ball", "/World/Red"),
        ("/World/Veil", "/World/Glass"),
        ("/World/Box", "displayColor"),
    ):
        np.testing.assert_allclose(objects[prim], materials[material], atol=1e-6)
        assert objects[prim].max() > 0.2


def test_rays_and_raster_give_the_same_mattes(picture, monkeypatch):
    """The GPU's way, without rasterisation, on the CPU."""
    from usdskin.render import cryptomatte

    _, expected = mattes(picture)
    monkeypatch.setattr(
        cryptomatte.raster,
        "rasterize_band",
        lambda projection, offsets, *_: cryptomatte.wp.empty(
            (0, 0), dtype=cryptomatte.wp.int32, device=offsets.device
        ),
    )
    overrides = RenderOverrides(
        width=48, samples=16, png=False, dome="hide", aovs=("cryptomatte",), device="cpu"
    )
    traced = picture.with_name("traced.exr")
    monkeypatch.setattr("usdskin.render.render.integrate", _blank(48))
    render_stage(picture.with_name("shot.usda"), traced, overrides, SilentProgress())
    _, found = mattes(traced)
    for name, coverage in expected["crypto_object"].items():
        difference = np.abs(found["crypto_object"][name] - coverage)
        assert difference.max() <= 1 / 16 + 1e-6 and (difference > 1e-6).mean() < 0.01


def _blank(size):
    from usdskin.render.integrate import Picture

    return lambda *_, **__: Picture(np.zeros((size, size, 4), np.float32), None)
