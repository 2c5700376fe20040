"""Real heads under real light, and files that were broken in the wild.

The pictures are small and looked at by numbers only: finite, where the head is, lit from where the
map is bright. ``USDSKIN_REALDATA`` names the folder with the data (``conftest.py``).
"""

from __future__ import annotations

import json
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

from usdskin import cli
from usdskin.images import read_image

pytestmark = pytest.mark.realdata

HEADS = {
    "ict": ("ict_facekit/generic_neutral_mesh.obj", ("--skin", "M_Face", "--skin", "M_BackHead")),
    "lee": ("leeperrysmith/LeePerrySmith.obj", ("--units", "dm", "--flip-v")),
    "makehuman": ("makehuman/base.obj", ("--group", "body", "--units", "dm")),
}
"""Mesh file and what its file does not say."""

MAPS = (
    "empty_warehouse_01_1k.hdr",
    "hotel_interior_1k.exr",
    "immenstadter_horn_1k.hdr",
    "royal_esplanade_512.exr",
    "st_fagans_interior_1k.hdr",
)

SKIN = """
            over "{name}" (prepend apiSchemas = ["SpectralDistributionAPI:reflectance",
                "SpectralDistributionAPI:scattering"])
            {{
                float inputs:skin:alpha = 0.7
                float inputs:skin:specular:weight = 1
                {albedo}
                uniform token spectrum:reflectance:quantity = "reflectance"
                double[] spectrum:reflectance:wavelengths = [400, 450, 500, 550, 575, 600, 650, 700]
                double[] spectrum:reflectance:values = [.18, .24, .30, .30, .29, .45, .58, .62]
                uniform token spectrum:scattering:quantity = "scattering"
                double[] spectrum:scattering:wavelengths = [400, 450, 500, 550, 575, 600, 650, 700]
                double[] spectrum:scattering:values = [.05, .08, .12, .16, .18, .50, .80, .90]
            }}"""


def write_shot(folder: Path, head: str, data: Path) -> Path:
    """Import a head and frame it from the front; return the stage."""
    from pxr import Usd, UsdGeom

    file, options = HEADS[head]
    asset = folder / f"{head}.usda"
    assert cli.main(["-q", "import", str(data / "heads" / file), "-o", str(asset), *options]) == 0
    stage = Usd.Stage.Open(str(asset))
    extent = UsdGeom.BBoxCache(Usd.TimeCode.Default(), ["default"])
    bounds = extent.ComputeWorldBound(stage.GetDefaultPrim()).GetRange()
    low, high = np.array(bounds.GetMin()), np.array(bounds.GetMax())
    if head == "makehuman":  # the whole body; the head is the top seventh
        low[1] += (high[1] - low[1]) * 6.0 / 7.0
    (x, y, z), size = (low + high) / 2.0, float((high - low)[1])
    albedo = ""
    if head == "lee":
        albedo = f"asset inputs:skin:albedo:file = @{data}/heads/leeperrysmith/color.jpg@"
    skins = [
        prim.GetName() for prim in stage.Traverse() if "SkinMaterialAPI" in prim.GetAppliedSchemas()
    ]
    shot = folder / f"{head}.shot.usda"
    shot.write_text(f"""#usda 1.0
(
    metersPerUnit = {UsdGeom.GetStageMetersPerUnit(stage)}
)
def Xform "World"
{{
    def "Head" (references = @./{asset.name}@)
    {{
        over "materials"
        {{{"".join(SKIN.format(name=name, albedo=albedo) for name in skins)}
        }}
    }}
    def Camera "Camera"
    {{
        float focalLength = 50
        float horizontalAperture = 14.4
        float verticalAperture = 14.4
        float2 clippingRange = ({size}, {10 * size})
        double3 xformOp:translate = ({x}, {y}, {z + 4 * size})
        uniform token[] xformOpOrder = ["xformOp:translate"]
    }}
    def DomeLight "Sky"
    {{
        asset inputs:texture:file = @{data / "hdri" / MAPS[0]}@
    }}
}}
""")
    return shot


@pytest.fixture(scope="module", params=HEADS)
def shot(request, tmp_path_factory, realdata):
    return write_shot(tmp_path_factory.mktemp(request.param), request.param, realdata)


def render_under(shot: Path, sky: Path, *arguments: str) -> int:
    texture = f"/World/Sky.inputs:texture:file={sky}"
    given = ("-w", "96", "--level", "0", "--no-png", "--set", texture, *arguments)
    return cli.main(["-q", "render", str(shot), str(shot.with_suffix(".exr")), *given])


def light_of(sky: Path) -> tuple[np.ndarray, float]:
    """Return the sum of a map's luminance times direction, and times solid angle."""
    rgb = np.maximum(read_image(sky, channels=("R", "G", "B")).pixels.astype(float), 0.0)
    rows, columns = rgb.shape[:2]
    v, u = np.meshgrid(
        np.pi * (np.arange(rows) + 0.5) / rows,
        2 * np.pi * (np.arange(columns) + 0.5) / columns,
        indexing="ij",
    )
    flux = rgb @ [0.2126, 0.7152, 0.0722] * np.sin(v) * (np.pi / rows) * (2 * np.pi / columns)
    toward = (np.sin(v) * np.sin(u), np.cos(v), -np.sin(v) * np.cos(u))
    return np.array([(flux * axis).sum() for axis in toward]), float(flux.sum())


@pytest.mark.parametrize("name", MAPS)
def test_heads_under_captured_light_are_lit_from_where_the_map_is_bright(shot, name, realdata):
    sky = realdata / "hdri" / name
    assert render_under(shot, sky, "--bad-pixels", "clamp") == 0
    pixels = read_image(shot.with_suffix(".exr")).pixels
    alpha = pixels[..., 3]
    assert np.isfinite(pixels).all()
    assert pixels[..., :3].min() >= 0.0
    assert alpha.min() == 0.0 and alpha.max() == 1.0 and 0.15 < alpha.mean() < 0.85
    assert (pixels[alpha == 0.0] == 0.0).all()
    # What a white surface shows, averaged over its orientations, is a quarter of the flux over pi.
    inside = alpha == 1.0
    toward, flux = light_of(sky)
    luminance = pixels[..., :3] @ [0.2126, 0.7152, 0.0722]
    assert 0.1 < luminance[inside].mean() / (flux / (4.0 * np.pi)) < 1.0
    assert pixels[inside][:, 0].mean() > pixels[inside][:, 2].mean()
    # The heads are nearly symmetrical: the brighter half is the one that the light comes from.
    half = pixels.shape[1] // 2
    left, right = (
        luminance[:, side][inside[:, side]].mean() for side in (slice(0, half), slice(half, None))
    )
    if abs(toward[0]) > 0.05 * flux:
        assert np.sign(right - left) == np.sign(toward[0])


def test_maps_with_negative_light_are_refused_unless_they_are_clamped(shot, realdata, capfd):
    assert render_under(shot, realdata / "hdri/royal_esplanade_512.exr") == 3
    (line,) = capfd.readouterr().err.splitlines()
    assert "2866 of 131072 pixels are no light" in line
    assert "--bad-pixels clamp" in line


# --- Every stage at hand, whole and broken

ADDED = """#usda 1.0
(
    metersPerUnit = 1
    subLayers = [@{file}@]
)
def Camera "AddedCamera"
{{
    float2 clippingRange = (0.01, 100000)
    float horizontalAperture = 40
    float verticalAperture = 40
    float focalLength = 30
    double3 xformOp:translate = (0, 0, 20)
    uniform token[] xformOpOrder = ["xformOp:translate"]
}}
def DomeLight "AddedSky"
{{
}}
"""
"""A stage with a camera and a light, so that the other's geometry is read and drawn."""

STAGES = (".usd", ".usda", ".usdc", ".usdz", ".sdf")
PICTURES = (".exr", ".bmp", ".jpg")

REFUSED = {
    "testUsdGeomMesh/mesh.usda": "faceVertexCounts add up to 12 corners, but faceVertexIndices",
    "testUsdGeomPointInstancer/instancer.usda": "names prototype 4, but there is none",
    "SmallObjectTest/test.usda": "@./StinsonBeach.hdr@, which is not there",
    "coordSysRegression/model.usda": "primvars:st has 24 indices, but vertex",
    "coordSysRegression/root.usda": "primvars:st has 24 indices, but vertex",
    "testUsdImagingGLColorOpacityPrimvar/color_opacity_primvar.usda": "2 values, but constant",
    "testUsdImagingGLDomeLight/multiDomeLights.usda": "@UVtemplate_1x1.tex@, which is not there",
    "testUsdImagingGLPointInstancer/pi_bad_schema_input.usda": "prototype 0, but there is none",
    "testUsdImagingGLUsdUdims/usdUdimsSymlinked.usda": "@symlink_<UDIM>.jpg@, which is not there",
    "testUsdImagingGLUsdUdims/usdUdimsTextureFallback.usda": "@missingTexture_<UDIM>.jpg@",
}
"""Whole stages that are not drawn even with a camera and a light added, and why: arrays that do
not fit one another, missing prototypes, and files that OpenUSD makes when its tests run."""

# USD writes these past its own diagnostics while it looks into a corrupt crate.
UNAVOIDABLE = ("failed call to posix_madvise(", "TypeError: No to_python (by-value) converter")


def commands_for(file: Path, folder: Path, number: int) -> list[list[str]]:
    """Return what a stranger's file is tried with."""
    if file.suffix in PICTURES:
        return [["info", str(file)]]
    if file.suffix == ".sdf":  # text layers under an older name
        renamed = folder / f"{number}.usda"
        renamed.write_bytes(file.read_bytes())
        file = renamed
    added = folder / f"{number}.added.usda"
    added.write_text(ADDED.format(file=file))
    small = ("-r", "32", "32", "-p", "1", "--threads", "1", "--no-png")
    return [
        ["info", str(file)],
        ["validate", str(file)],
        ["render", str(file), f"{number}.exr", *small],
        ["render", str(added), f"{number}.exr", "-cam", "/AddedCamera", *small],
    ]


def sweep(data: Path, folder: Path, step: int) -> None:
    """Try every ``step``-th file; each command in a child with limits of time and memory."""
    files = sorted(path for name in ("stages", "malformed") for path in (data / name).rglob("*"))
    files = [path for path in files if path.suffix in STAGES + PICTURES][::step]
    assert len(files) > 200 // step
    commands = [
        {"arguments": ["-q", *command], "seconds": 120, "bytes": 6 * 2**30}
        for number, file in enumerate(files)
        for command in commands_for(file, folder, number)
    ]
    runner = [sys.executable, str(Path(__file__).with_name("fork_runs.py"))]
    lines = "\n".join(json.dumps(command) for command in commands)
    ran = subprocess.run(
        runner, input=lines, capture_output=True, text=True, cwd=folder, check=True
    )
    results = [json.loads(line) for line in ran.stdout.splitlines()]
    assert len(results) == len(commands)
    drawn = [result for result in results if "/AddedCamera" in result["arguments"]]
    stages = [file for file in files if file.suffix in STAGES]
    surprises = []
    for file, result in zip(stages, drawn, strict=True):
        reason = REFUSED.get("/".join(file.parts[-2:]))
        expected = (3,) if reason else (0,)
        if not file.is_relative_to(data / "stages"):
            expected = (0, 3)
        if result["code"] not in expected or (reason or "") not in result["error"]:
            surprises.append((str(file), result["error"]))
        elif result["code"] == 0 and not (folder / result["arguments"][3]).exists():
            surprises.append((str(file), "no picture"))
    assert surprises == []
    pictures = list(folder.glob("*.exr"))
    assert len(pictures) > 50 // step
    assert all(np.isfinite(read_image(picture).pixels).all() for picture in pictures)
    assert [result for result in results if not _is_orderly(result)] == []


def _is_orderly(result: dict) -> bool:
    """Return whether a command succeeded, or said in one line why it did not."""
    lines = [line for line in result["error"].splitlines() if not line.startswith(UNAVOIDABLE)]
    errors = [line for line in lines if line.startswith("usdskin: error: ")]
    notes = [line for line in lines if line.startswith("usdskin: note: ")]
    return (
        result["code"] in (0, 3, 4)
        and len(errors) == (result["code"] == 3)
        and len(errors) + len(notes) == len(lines)
    )


def test_a_sample_of_real_and_broken_stages_is_read_or_refused(realdata, tmp_path):
    sweep(realdata, tmp_path, step=31)


@pytest.mark.slow
def test_every_real_and_broken_stage_is_read_or_refused(realdata, tmp_path):
    sweep(realdata, tmp_path, step=1)
