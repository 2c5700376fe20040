"""Whole pictures against laws: what goes in as a stage comes out as the radiance it must have."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from usdskin.image_output import Part, write_exr
from usdskin.images import read_image, read_spectral
from usdskin.progress import SilentProgress
from usdskin.render.overrides import RenderOverrides
from usdskin.render.render import render_stage

ALPHA, WRAP, S, SS = 0.5, 0.3, 0.6, 0.8
FURNACE = ALPHA * S * (1.0 + (1.0 + WRAP) * SS)

SKIN = f"""
    def Material "Skin" (prepend apiSchemas = ["SkinMaterialAPI",
        "SpectralDistributionAPI:reflectance", "SpectralDistributionAPI:scattering"])
    {{
        float inputs:skin:alpha = {ALPHA}
        float inputs:skin:wrap = {WRAP}
        uniform token spectrum:reflectance:quantity = "reflectance"
        double[] spectrum:reflectance:wavelengths = [400, 700]
        double[] spectrum:reflectance:values = [{S}, {S}]
        uniform token spectrum:scattering:quantity = "scattering"
        double[] spectrum:scattering:wavelengths = [400, 700]
        double[] spectrum:scattering:values = [{SS}, {SS}]
    }}
"""

UNIFORM = """
    def DomeLight "Dome" (prepend apiSchemas = ["SpectralLightAPI",
        "SpectralDistributionAPI:emission"])
    {
        uniform token inputs:spectral:source = "tabulated"
        uniform token inputs:spectral:units = "absolute"
        uniform token spectrum:emission:quantity = "radiance"
        double[] spectrum:emission:wavelengths = [380, 720]
        double[] spectrum:emission:values = [0.01, 0.01]
    }
"""


def stage_text(*prims: str, up: str = "Y", meters: float = 1.0, scale: float = 1.0) -> str:
    """Return a stage with a skin sphere of radius 0.1 m, seen from +Z (or -Y where Z is up)."""
    view = (0.0, 0.0, 0.5 * scale)
    turn = ""
    order = '["xformOp:translate"]'
    if up == "Z":
        view = (0.0, -0.5 * scale, 0.0)
        turn = "double xformOp:rotateX = 90"
        order = '["xformOp:translate", "xformOp:rotateX"]'
    return f"""#usda 1.0
(
    defaultPrim = "World"
    metersPerUnit = {meters}
    upAxis = "{up}"
)
def Xform "World"
{{
    def Sphere "Ball" (prepend apiSchemas = ["MaterialBindingAPI"])
    {{
        double radius = {0.1 * scale}
        rel material:binding = </World/Skin>
    }}
    def Camera "Camera"
    {{
        float focalLength = {0.5 * scale}
        float horizontalAperture = {0.25 * scale}
        float verticalAperture = {0.25 * scale}
        float2 clippingRange = ({0.01 * scale}, {10 * scale})
        double3 xformOp:translate = {view}
        {turn}
        uniform token[] xformOpOrder = {order}
    }}
    {"".join(prims)}
}}
"""


def rendered(tmp_path: Path, text: str, name: str = "shot", **overrides):
    """Render a stage's text; return beauty and, where asked for, the spectra."""
    layer = tmp_path / f"{name}.usda"
    layer.write_text(text)
    out = tmp_path / f"{name}.exr"
    given = {"width": 48, "png": False, "samples": 4, "threads": 2, **overrides}
    render_stage(layer, out, RenderOverrides(**given), SilentProgress())
    beauty = read_image(out).pixels
    spectral = tmp_path / f"{name}.spectral.exr"
    return beauty, read_spectral(spectral)[1] if given.get("spectral_output") else None


def test_uniform_light_gives_the_furnace_value_everywhere(tmp_path):
    beauty, spectrum = rendered(tmp_path, stage_text(SKIN, UNIFORM), spectral_output=True)
    inside = beauty[..., 3] == 1.0
    assert inside.mean() > 0.3
    np.testing.assert_allclose(spectrum[inside], 0.01 * FURNACE, rtol=1e-4)


def test_energy_normalization_divides_the_wrap_term(tmp_path):
    skin = SKIN.replace(
        "float inputs:skin:wrap =", 'token inputs:skin:wrapNormalization = "energy"\n'
        "        float inputs:skin:wrap ="
    )  # fmt: skip
    beauty, spectrum = rendered(tmp_path, stage_text(skin, UNIFORM), spectral_output=True)
    inside = beauty[..., 3] == 1.0
    np.testing.assert_allclose(spectrum[inside], 0.01 * ALPHA * S * (1.0 + SS), rtol=1e-4)


def test_beauty_is_the_tristimulus_integral_of_the_spectra(tmp_path):
    from usdskin.colorimetry import xyz_to_rgb, xyz_weights
    from usdskin.spectrum import DEFAULT_WAVELENGTHS_NM

    beauty, spectrum = rendered(tmp_path, stage_text(SKIN, UNIFORM), spectral_output=True)
    weights = xyz_weights(DEFAULT_WAVELENGTHS_NM, "cie1931_2", True)
    rgb = spectrum @ weights @ xyz_to_rgb("lin_rec709_scene").T
    np.testing.assert_allclose(beauty[..., :3], rgb, atol=1e-5 * rgb.max())


def lobed_map(rows: int = 32) -> np.ndarray:
    """An asymmetric map: each axis direction has a colour of its own."""
    polar = np.pi * (np.arange(rows) + 0.5) / rows
    turns = (np.arange(2 * rows) + 0.5) / (2 * rows)
    v, u = np.meshgrid(polar, turns, indexing="ij")
    x = np.sin(v) * np.sin(2 * np.pi * u)
    y, z = np.cos(v), -np.sin(v) * np.cos(2 * np.pi * u)
    rgb = [np.maximum(axis, 0) ** 8 * 4 + 0.05 for axis in (x, y, z)]
    return np.stack(rgb, axis=-1).astype(np.float32)


def rgb_dome(tmp_path: Path, body: str = "") -> str:
    """Return a dome with the lobed map."""
    part = Part("rgb", {"": lobed_map()}, color_space="lin_rec709_scene")
    write_exr(tmp_path / "map.exr", [part])
    return f"""
    def DomeLight "Dome"
    {{
        asset inputs:texture:file = @./map.exr@
        {body}
    }}
"""


def brightest(beauty: np.ndarray, channel: int) -> tuple[float, float]:
    """Return the (x, y) of a channel's excess over the others, in [-1, 1], y up."""
    value = np.maximum(beauty[..., channel] - beauty[..., :3].mean(axis=-1), 0) ** 4
    rows, columns = np.indices(value.shape)
    size = value.shape[0]
    x = (value * columns).sum() / value.sum() / (size - 1) * 2 - 1
    y = 1 - (value * rows).sum() / value.sum() / (size - 1) * 2
    return x, y


def test_dome_axes_light_the_sides_they_should(tmp_path):
    """u = .25 is +X (red), v = 0 is +Y (green), u = .5 is +Z (blue), seen from +Z."""
    beauty, _ = rendered(tmp_path, stage_text(SKIN, rgb_dome(tmp_path)))
    red, green, blue = (brightest(beauty, k) for k in range(3))
    assert red[0] > 0.4 and abs(red[1]) < 0.3
    assert green[1] > 0.4 and abs(green[0]) < 0.3
    assert abs(blue[0]) < 0.3 and abs(blue[1]) < 0.3


def test_the_dome_keeps_its_pole_on_y_in_a_z_up_stage(tmp_path):
    """Seen from -Y with +Z up: +X is right, +Z (blue) is up, and +Y (green) is behind."""
    beauty, _ = rendered(tmp_path, stage_text(SKIN, rgb_dome(tmp_path), up="Z"))
    red, blue = brightest(beauty, 0), brightest(beauty, 2)
    assert red[0] > 0.4 and abs(red[1]) < 0.3
    assert blue[1] > 0.4 and abs(blue[0]) < 0.3
    middle = beauty[24, 24]
    assert middle[1] < middle[0] + 0.2 * beauty[..., 1].max()


def test_a_rotated_dome_turns_the_light(tmp_path):
    """Rotating by 90 degrees about +Y takes +Z to +X: the blue lobe is on the right."""
    turned = rgb_dome(
        tmp_path,
        'double xformOp:rotateY = 90\n        uniform token[] xformOpOrder = ["xformOp:rotateY"]',
    )
    beauty, _ = rendered(tmp_path, stage_text(SKIN, turned))
    blue = brightest(beauty, 2)
    assert blue[0] > 0.4 and abs(blue[1]) < 0.3


def test_centimetre_and_metre_stages_give_the_same_picture(tmp_path):
    dome = rgb_dome(tmp_path)
    metres, _ = rendered(tmp_path, stage_text(SKIN, dome), "m")
    centimetres, _ = rendered(
        tmp_path, stage_text(SKIN, dome, meters=0.01, scale=100.0), "cm"
    )  # fmt: skip
    np.testing.assert_allclose(centimetres, metres, atol=2e-5 * metres.max())


def test_threads_and_tiles_do_not_change_a_bit(tmp_path, monkeypatch):
    text = stage_text(SKIN, rgb_dome(tmp_path))
    one, _ = rendered(tmp_path, text, threads=1)
    two, _ = rendered(tmp_path, text, threads=2)
    monkeypatch.setattr("usdskin.render.integrate.TILE_PIXELS", 100)
    tiles, _ = rendered(tmp_path, text, threads=3)
    np.testing.assert_array_equal(one, two)
    np.testing.assert_array_equal(one, tiles)


def test_the_brute_force_oracle_agrees(tmp_path):
    text = stage_text(SKIN, rgb_dome(tmp_path))
    given = {"spectral_output": True, "width": 12, "samples": 1}
    _, fast = rendered(tmp_path, text, "fast", **given)
    _, brute = rendered(tmp_path, text, "brute", spectral_method="brute", **given)
    peak = brute.max(axis=-1, keepdims=True)
    lit = peak[..., 0] > 0
    # The map's interpolation (2.5e-4 of the peak) is all that separates the two.
    assert (np.abs(fast - brute) / brute.max())[lit].max() < 1e-3


DISTANT = """
    def DistantLight "Sun" (prepend apiSchemas = ["SpectralLightAPI",
        "SpectralDistributionAPI:emission"])
    {
        float inputs:angle = 0
        uniform token inputs:spectral:source = "tabulated"
        uniform token inputs:spectral:units = "absolute"
        uniform token spectrum:emission:quantity = "irradiance"
        double[] spectrum:emission:wavelengths = [380, 720]
        double[] spectrum:emission:values = [1, 1]
    }
"""


def test_a_distant_light_is_summed_in_closed_form(tmp_path):
    """From +Z along the view: C = E alpha S / pi (cos + Ss (cos + l) / (1 + l)) at every pixel."""
    text = stage_text(SKIN, DISTANT)
    layer = tmp_path / "sun.usda"
    layer.write_text(text)
    render_stage(
        layer,
        tmp_path / "sun.exr",
        RenderOverrides(width=48, samples=1, png=False, spectral_output=True, aovs=("N",)),
        SilentProgress(),
    )
    _, spectrum = read_spectral(tmp_path / "sun.spectral.exr")
    normal = read_image(tmp_path / "sun.exr", part="N").pixels
    hit = np.linalg.norm(normal, axis=-1) > 0.5
    cosine = normal[hit][:, 2]
    expected = ALPHA * S / np.pi * (cosine + SS * (cosine + WRAP) / (1 + WRAP))
    found = spectrum[hit][:, 30]
    np.testing.assert_allclose(found / found.max(), expected / expected.max(), atol=2e-4)


def test_a_hidden_dome_leaves_alpha_and_a_shown_one_fills_the_picture(tmp_path):
    text = stage_text(SKIN, rgb_dome(tmp_path))
    hidden, _ = rendered(tmp_path, text, "hidden")
    shown, _ = rendered(tmp_path, text, "shown", dome="show")
    assert hidden[0, 0, 3] == 0.0 and hidden[0, 0, :3].max() == 0.0
    assert shown[..., 3].min() == 1.0 and shown[0, 0, :3].min() > 0.0
    inside = hidden[..., 3] == 1.0
    np.testing.assert_array_equal(hidden[inside], shown[inside])


def test_light_from_behind_is_weakened_by_the_body(tmp_path):
    """Uniform light: exp(-s delta) multiplies the share of the wrap term from behind, l / (1 + l).

    Int over N.L <= 0 of (N.L + l)/(1 + l) dL / pi = l^2 / (1 + l) of the whole 1 + l.
    """
    delta, thickness = 200.0, 0.005
    skin = SKIN.replace(
        "float inputs:skin:wrap =",
        f"float inputs:skin:opacity = {delta}\n        float inputs:skin:thickness = {thickness}\n"
        "        float inputs:skin:wrap =",
    )
    beauty, spectrum = rendered(tmp_path, stage_text(skin, UNIFORM), spectral_output=True)
    inside = beauty[..., 3] == 1.0
    back = WRAP**2 / (1.0 + WRAP)
    passed = (1.0 + WRAP) - back * (1.0 - np.exp(-delta * thickness))
    np.testing.assert_allclose(spectrum[inside], 0.01 * ALPHA * S * (1.0 + SS * passed), rtol=1e-4)


@pytest.mark.parametrize("weight", [0.0, 1.0])
def test_lustre_takes_its_light_from_the_diffuse_part(tmp_path, weight):
    """In the furnace a skin of reflectance 1 stays at or below 1 with any lustre."""
    skin = SKIN.replace(f"alpha = {ALPHA}", f"alpha = {1.0 / (1.0 + (1.0 + WRAP) * SS)}").replace(
        f"[{S}, {S}]", "[1, 1]"
    )
    skin = skin.replace(
        "float inputs:skin:wrap =",
        f"float inputs:skin:specular:weight = {weight}\n        float inputs:skin:wrap =",
    )
    beauty, spectrum = rendered(tmp_path, stage_text(skin, UNIFORM), spectral_output=True)
    inside = beauty[..., 3] == 1.0
    assert spectrum[inside].max() <= 0.01 * (1.0 + 2e-3)
    assert spectrum[inside].min() >= 0.01 * (1.0 - 2e-2)


GROUND = """
    def Mesh "Ground"
    {
        uniform token subdivisionScheme = "none"
        uniform bool doubleSided = true
        point3f[] points = [(-3, -0.1, 3), (3, -0.1, 3), (3, -0.1, -3), (-3, -0.1, -3)]
        int[] faceVertexCounts = [4]
        int[] faceVertexIndices = [0, 1, 2, 3]
        color3f[] primvars:displayColor = [(0.4, 0.3, 0.2)]
    }
"""

BEHIND = """
    def Sphere "Behind"
    {
        double radius = 0.1
        color3f[] primvars:displayColor = [(0.1, 0.6, 0.2)]
        double3 xformOp:translate = (0.08, 0.03, -0.1)
        uniform token[] xformOpOrder = ["xformOp:translate"]
    }
"""


@pytest.mark.parametrize("pixel_filter", ["box", "blackmanHarris"])
def test_rasterized_and_traced_surfaces_are_the_same(tmp_path, monkeypatch, pixel_filter):
    text = stage_text(SKIN, rgb_dome(tmp_path), BEHIND)
    given = {"width": 64, "pixel_filter": pixel_filter}
    rasterized, _ = rendered(tmp_path, text, "raster", **given)
    monkeypatch.setattr("usdskin.render.integrate.project", lambda *_: None)
    traced, _ = rendered(tmp_path, text, "traced", **given)
    different = np.abs(rasterized - traced).max(axis=-1) > 1e-4 * traced.max()
    # A sample on a silhouette may fall on either side by float32 rounding.
    assert different.mean() < 2e-3


def test_geometry_through_the_near_plane_is_clipped_by_rays(tmp_path):
    """The ground runs behind the camera: it still fills the lower part of the picture."""
    beauty, _ = rendered(tmp_path, stage_text(SKIN, rgb_dome(tmp_path), GROUND))
    assert beauty[-1, :, 3].min() == 1.0
    assert beauty[0, :, 3].max() < 1.0


def test_an_orthographic_camera_sees_the_sphere_at_its_size(tmp_path):
    """0.25 m wide: the disc of radius 0.1 m covers pi 0.16 of the picture."""
    text = stage_text(SKIN, UNIFORM).replace(
        "float focalLength", 'token projection = "orthographic"\n        float focalLength'
    )  # fmt: skip
    text = text.replace("horizontalAperture = 0.25", "horizontalAperture = 2.5").replace(
        "verticalAperture = 0.25", "verticalAperture = 2.5"
    )
    beauty, _ = rendered(tmp_path, text, width=128)
    assert beauty[..., 3].mean() == pytest.approx(np.pi * 0.16, rel=5e-3)
