"""Input as a stranger wrote it: the exit code, one line that helps, and nothing half-written.

Every case is one change to a stage that renders. The line on stderr names where, what and what to
do; neither USD nor OpenImageIO may add words of their own, and the output folder stays as it was.
"""

from __future__ import annotations

import os
import struct
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pytest

from usdskin import cli
from usdskin.image_output import Part, write_exr, write_png, write_spectral_exr

STAGE = """#usda 1.0
(
    metersPerUnit = 1
    renderSettingsPrimPath = "/Render"
)
def Camera "Cam"
{
    float2 clippingRange = (0.1, 100)
    double3 xformOp:translate = (0, 0, 5)
    uniform token[] xformOpOrder = ["xformOp:translate"]
}
def DomeLight "Sky" (prepend apiSchemas = ["SpectralLightAPI"])
{
    uniform token inputs:spectral:source = "rgb"
    uniform token inputs:spectral:illuminant = "D65"
    float inputs:intensity = 1
    color3f inputs:color = (1, 1, 1)
    asset inputs:texture:file = @./sky.exr@
}
def DistantLight "Sun" (prepend apiSchemas = ["SpectralLightAPI",
    "SpectralDistributionAPI:emission"])
{
    uniform token inputs:spectral:source = "tabulated"
    uniform token inputs:spectral:units = "relative"
    uniform token spectrum:emission:quantity = "relative"
    double[] spectrum:emission:wavelengths = [400, 700]
    double[] spectrum:emission:values = [0.5, 1]
}
def Mesh "Card" (prepend apiSchemas = ["MaterialBindingAPI"])
{
    int[] faceVertexCounts = [3]
    int[] faceVertexIndices = [0, 1, 2]
    point3f[] points = [(-1, -1, 0), (1, -1, 0), (0, 1, 0)]
    texCoord2f[] primvars:st = [(0, 0), (1, 0), (0, 1)] (interpolation = "vertex")
    uniform token subdivisionScheme = "none"
    rel material:binding = </Skin>
}
def Material "Skin" (
    prepend apiSchemas = ["SkinMaterialAPI", "SpectralDistributionAPI:reflectance",
        "SpectralDistributionAPI:scattering"]
)
{
    float inputs:skin:wrap = 0.3
    uniform token spectrum:reflectance:quantity = "reflectance"
    double[] spectrum:reflectance:wavelengths = [400, 700]
    double[] spectrum:reflectance:values = [0.3, 0.6]
    uniform token spectrum:scattering:quantity = "scattering"
    double[] spectrum:scattering:wavelengths = [400, 700]
    double[] spectrum:scattering:values = [0.1, 0.2]
}
def Mesh "Eye" (prepend apiSchemas = ["MaterialBindingAPI"])
{
    int[] faceVertexCounts = [3]
    int[] faceVertexIndices = [0, 1, 2]
    point3f[] points = [(0, -1, -1), (1, -1, -1), (0, 0, -1)]
    texCoord2f[] primvars:st = [(0, 0), (1, 0), (0, 1)] (interpolation = "vertex")
    uniform token subdivisionScheme = "none"
    rel material:binding = </Glass>
}
def Material "Glass"
{
    token outputs:surface.connect = </Glass/Surface.outputs:surface>
    def Shader "Surface"
    {
        uniform token info:id = "UsdPreviewSurface"
        color3f inputs:diffuseColor.connect = </Glass/Picture.outputs:rgb>
        float inputs:roughness = 0.3
        token outputs:surface
    }
    def Shader "Picture"
    {
        uniform token info:id = "UsdUVTexture"
        asset inputs:file = @./iris.png@
        token inputs:wrapS = "repeat"
        token inputs:sourceColorSpace = "auto"
        float2 inputs:st.connect = </Glass/Coordinates.outputs:result>
        float3 outputs:rgb
    }
    def Shader "Coordinates"
    {
        uniform token info:id = "UsdPrimvarReader_float2"
        string inputs:varname = "st"
        float2 outputs:result
    }
}
def RenderSettings "Render" (prepend apiSchemas = ["SkinRenderSettingsAPI"])
{
    int usdskin:samplesPerPixel = 1
    uniform int2 resolution = (8, 8)
    rel products = </Render/Main>
    def RenderProduct "Main"
    {
        token productName = "o.exr"
        rel camera = </Cam>
        rel orderedVars = </Render/Depth>
    }
    def RenderVar "Depth"
    {
        string sourceName = "Z"
    }
}
"""

MAP = np.ones((4, 8, 3), np.float32)


def write_map(name: str, *changes: tuple[tuple[int, int], float]) -> Callable[[], None]:
    """Return what writes a map whose texels (row, column) have changed values."""

    def write() -> None:
        pixels = MAP.copy()
        for (row, column), value in changes:
            pixels[row, column] = value
        write_exr(Path(name), [Part("", {"": pixels}, color_space="lin_rec709_scene")])

    return write


def write_bands(*wavelengths: float) -> Callable[[], None]:
    def write() -> None:
        pixels = np.ones((4, 8, len(wavelengths)), np.float32)
        write_spectral_exr(Path("bands.exr"), np.array(wavelengths), pixels, MAP, "relative")

    return write


def write_bytes(name: str, data: bytes) -> Callable[[], None]:
    return lambda: Path(name).write_bytes(data) and None


def truncate(name: str, share: float) -> Callable[[], None]:
    def cut() -> None:
        data = Path(name).read_bytes()
        Path(name).write_bytes(data[: int(len(data) * share)])

    return cut


def remove(name: str) -> Callable[[], None]:
    return lambda: Path(name).unlink()


def huge_png() -> None:
    """A header that promises a thousand million pixels and has none."""
    import zlib

    chunk = b"IHDR" + struct.pack(">IIBBBBB", 60000, 60000, 16, 6, 0, 0, 0)
    data = struct.pack(">I", 13) + chunk + struct.pack(">I", zlib.crc32(chunk))
    Path("iris.png").write_bytes(b"\x89PNG\r\n\x1a\n" + data)


@dataclass(frozen=True)
class Bad:
    """One wrong input."""

    name: str
    says: tuple[str, ...]
    """What the line must hold: the place, and the value or the remedy."""

    edits: tuple[tuple[str, str], ...] = ()
    arguments: tuple[str, ...] = ()
    prepare: Callable[[], None] | None = None
    code: int = 3
    stage: str = "shot.usda"
    output: str = "out/o.exr"


def edit(before: str, after: str) -> tuple[tuple[str, str], ...]:
    return ((before, after),)


INSTANCERS = """
def PointInstancer "Crowd"
{
    rel prototypes = </Crowd/Again>
    int[] protoIndices = [0]
    point3f[] positions = [(0, 0, 0)]
    def PointInstancer "Again"
    {
        rel prototypes = </Crowd>
        int[] protoIndices = [0]
        point3f[] positions = [(0, 0, 0)]
    }
}
def RenderSettings "Render" """

SKY_BANDS = (
    ('source = "rgb"', 'source = "bands"'),
    ("color3f inputs:color = (1, 1, 1)", "asset inputs:spectral:bands:file = @./bands.exr@"),
)
SKY_BASIS = """uniform token inputs:spectral:source = "basis"
    asset inputs:spectral:coefficients:file = @./c.exr@
    double[] inputs:spectral:basis = {basis}
    uniform double[] inputs:spectral:basis:wavelengths = {wavelengths}"""


def sky_basis(basis: str, wavelengths: str = "[400, 700]") -> tuple[tuple[str, str], ...]:
    after = SKY_BASIS.format(basis=basis, wavelengths=wavelengths)
    return edit('uniform token inputs:spectral:source = "rgb"', after)


def write_coefficients(count: int, value: float = 1.0) -> Callable[[], None]:
    def write() -> None:
        channels = {f"c{k}": np.full((4, 8), value, np.float32) for k in range(count)}
        write_exr(Path("c.exr"), [Part("", channels)])

    return write


CASES = [
    # The layer
    Bad("stage missing", ("nowhere.usda", "no such file"), stage="nowhere.usda"),
    Bad("stage is a folder", ("out", "not a file"), stage="out"),
    Bad("stage is empty", ("shot.usda",), prepare=write_bytes("shot.usda", b"")),
    Bad("stage is noise", ("shot.usda",), prepare=write_bytes("shot.usda", bytes(range(256)) * 9)),
    Bad("stage is cut short", ("shot.usda",), prepare=truncate("shot.usda", 0.7)),
    Bad("stage is a crate of noise", ("shot.usda",), prepare=write_bytes("shot.usda", b"PXR-USDC" + b"\xff" * 90)),
    Bad("stage is not UTF-8", ("shot.usda",), edits=edit('"Glass"', '"Gl\udcffss"')),
    Bad("stage is a picture", ("sky.exr",), stage="sky.exr"),
    Bad("metersPerUnit 0", ("shot.usda", "metersPerUnit"), edit("metersPerUnit = 1", "metersPerUnit = 0")),
    Bad("timeCodesPerSecond 0", ("shot.usda", "timeCodesPerSecond"), edit("metersPerUnit = 1", "timeCodesPerSecond = 0")),
    Bad("timeCodesPerSecond NaN", ("shot.usda", "timeCodesPerSecond"), edit("metersPerUnit = 1", "timeCodesPerSecond = nan")),
    Bad("upAxis X", ("shot.usda", "upAxis"), edit("metersPerUnit = 1", 'upAxis = "X"')),
    Bad("startTimeCode NaN", ("shot.usda", "startTimeCode"), edit("metersPerUnit = 1", "startTimeCode = nan")),
    # Cameras
    Bad("no camera", ("shot.usda", "amera"), (('def Camera "Cam"', 'def Xform "Cam"'), ("rel camera = </Cam>", ""))),
    Bad("two cameras", ("shot.usda", "/Cam", "/Second", "-cam"), (("rel camera = </Cam>", ""), ('def DomeLight "Sky"', 'def Camera "Second" {}\ndef DomeLight "Sky"'))),
    Bad("product's camera is none", ("/Sky", "amera"), edit("rel camera = </Cam>", "rel camera = </Sky>")),
    Bad("camera is not there", ("/Nope", "amera"), arguments=("-cam", "/Nope"), code=3),
    Bad("aperture 0", ("/Cam", "perture"), edit("float2 clippingRange", "float horizontalAperture = 0\n    float2 clippingRange")),
    Bad("aperture NaN", ("/Cam", "perture"), edit("float2 clippingRange", "float verticalAperture = nan\n    float2 clippingRange")),
    Bad("focal length negative", ("/Cam", "focalLength"), edit("float2 clippingRange", "float focalLength = -50\n    float2 clippingRange")),
    Bad("clipping range turned round", ("/Cam", "clippingRange"), edit("(0.1, 100)", "(100, 0.1)")),
    Bad("camera flattened", ("/Cam",), edit('double3 xformOp:translate = (0, 0, 5)\n    uniform token[] xformOpOrder = ["xformOp:translate"]', 'double3 xformOp:scale = (0, 1, 1)\n    uniform token[] xformOpOrder = ["xformOp:scale"]')),
    Bad("camera at NaN", ("/Cam",), edit("(0, 0, 5)", "(0, 0, nan)")),
    # Lights
    Bad("no light", ("shot.usda", "light"), (('def DomeLight "Sky"', 'def Xform "Sky"'), ('def DistantLight "Sun"', 'def Xform "Sun"'), ('["SpectralLightAPI"]', '["x"]'), ('["SpectralLightAPI",\n    "SpectralDistributionAPI:emission"]', '["y"]'))),
    Bad("no light left", ("shot.usda", "light"), arguments=("--set", "/Sky.visibility=invisible", "--set", "/Sun.visibility=invisible")),
    Bad("misspelt light schema", ("/Sky", "SpectralLigthAPI", "SpectralLightAPI"), edit('["SpectralLightAPI"]', '["SpectralLigthAPI"]')),
    Bad("misspelt distribution schema", ("/Sun", "SpectralDistibutionAPI"), edit('"SpectralDistributionAPI:emission"', '"SpectralDistibutionAPI:emission"')),
    Bad("misspelt light attribute", ("/Sky", "inputs:spectral:ilumiant"), edit("inputs:spectral:illuminant =", "inputs:spectral:ilumiant =")),
    Bad("spectral attribute without its schema", ("/Sky", "SpectralLightAPI"), edit('"Sky" (prepend apiSchemas = ["SpectralLightAPI"])', '"Sky"')),
    Bad("unknown source", ("/Sky", "inputs:spectral:source", "rbg"), edit('source = "rgb"', 'source = "rbg"')),
    Bad("unknown units", ("/Sun", "inputs:spectral:units", "watts"), edit('units = "relative"', 'units = "watts"')),
    Bad("mixed units", ("/Sky", "/Sun", "absolute"), (('units = "relative"', 'units = "absolute"'), ('quantity = "relative"', 'quantity = "irradiance"'))),
    Bad("unknown illuminant", ("/Sky", "FL99"), edit('illuminant = "D65"', 'illuminant = "FL99"')),
    Bad("illuminant file missing", ("/Sky", "lamp.csv"), edit('uniform token inputs:spectral:illuminant = "D65"', "asset inputs:spectral:illuminant:file = @./lamp.csv@")),
    Bad("illuminant file of words", ("lamp.csv",), edit('uniform token inputs:spectral:illuminant = "D65"', "asset inputs:spectral:illuminant:file = @./lamp.csv@"), prepare=write_bytes("lamp.csv", b"hello\nworld\n")),
    Bad("intensity negative", ("/Sky", "intensity"), edit("intensity = 1", "intensity = -1")),
    Bad("intensity NaN", ("/Sky", "intensity"), edit("intensity = 1", "intensity = nan")),
    Bad("exposure without bound", ("/Sky", "exposure"), edit("intensity = 1", "exposure = 1e30")),
    Bad("color negative", ("/Sky", "color"), edit("color = (1, 1, 1)", "color = (1, -1, 1)")),
    Bad("dome map missing", ("/Sky", "sky.exr"), prepare=remove("sky.exr")),
    Bad("dome map broken", ("sky.exr",), prepare=truncate("sky.exr", 0.6)),
    Bad("dome map is no picture", ("sky.exr",), prepare=write_bytes("sky.exr", b"no picture")),
    Bad("dome map format", ("/Sky", "mirroredBall"), edit("color3f inputs:color", 'token inputs:texture:format = "mirroredBall"\n    color3f inputs:color')),
    Bad("map with NaN", ("sky.exr", "--bad-pixels clamp"), prepare=write_map("sky.exr", ((1, 2), np.nan))),
    Bad("map with infinity", ("sky.exr", "--bad-pixels clamp"), prepare=write_map("sky.exr", ((0, 7), np.inf))),
    Bad("map with negative radiance", ("sky.exr", "-3", "--bad-pixels clamp"), prepare=write_map("sky.exr", ((3, 0), -3.0))),
    Bad("bands map missing", ("/Sky", "bands.exr"), SKY_BANDS),
    Bad("bands map without bands", ("bands.exr",), SKY_BANDS, prepare=write_map("bands.exr")),
    Bad("bands source without a file", ("/Sky", "bands"), edit('source = "rgb"', 'source = "bands"')),
    Bad("basis of unequal lengths", ("/Sky", "inputs:spectral:basis"), sky_basis("[1, 1, 1]"), prepare=write_coefficients(1)),
    Bad("basis not ascending", ("/Sky", "inputs:spectral:basis:wavelengths"), sky_basis("[1, 1]", "[700, 400]"), prepare=write_coefficients(1)),
    Bad("basis and map disagree", ("c.exr", "c1"), sky_basis("[1, 1, 1, 1]"), prepare=write_coefficients(1)),
    Bad("basis and map are negative", ("c.exr", "--bad-pixels clamp"), sky_basis("[1, 1]"), prepare=write_coefficients(1, -1.0)),
    Bad("basis with NaN", ("/Sky", "inputs:spectral:basis"), sky_basis("[1, nan]"), prepare=write_coefficients(1)),
    Bad("blackbody of 0 K", ("/Sky", "colorTemperature"), edit('source = "rgb"', 'source = "blackbody"\n    float inputs:colorTemperature = 0')),
    Bad("daylight of 1000 K", ("/Sky", "1000"), edit('source = "rgb"', 'source = "illuminantD"\n    float inputs:colorTemperature = 1000')),
    # Spectra
    Bad("wavelengths not ascending", ("shot.usda", "/Skin", "spectrum:reflectance:wavelengths"), edit("reflectance:wavelengths = [400, 700]", "reflectance:wavelengths = [700, 400]")),
    Bad("wavelengths repeated", ("/Skin", "spectrum:reflectance:wavelengths"), edit("reflectance:wavelengths = [400, 700]", "reflectance:wavelengths = [400, 400]")),
    Bad("wavelengths negative", ("/Skin", "spectrum:reflectance:wavelengths"), edit("reflectance:wavelengths = [400, 700]", "reflectance:wavelengths = [-400, 700]")),
    Bad("lengths unequal", ("/Skin", "spectrum:reflectance", "2", "3"), edit("reflectance:wavelengths = [400, 700]", "reflectance:wavelengths = [400, 550, 700]")),
    Bad("spectrum empty", ("/Skin", "spectrum:reflectance"), (("reflectance:wavelengths = [400, 700]", "reflectance:wavelengths = []"), ("[0.3, 0.6]", "[]"))),
    Bad("spectrum with NaN", ("/Skin", "spectrum:reflectance:values", "index 1"), edit("[0.3, 0.6]", "[0.3, nan]")),
    Bad("spectrum negative", ("/Skin", "spectrum:reflectance:values", "-0.6"), edit("[0.3, 0.6]", "[0.3, -0.6]")),
    Bad("emission negative", ("/Sun", "spectrum:emission:values"), edit("values = [0.5, 1]", "values = [0.5, -1]")),
    Bad("emission missing", ("/Sun", "emission"), edit('["SpectralLightAPI",\n    "SpectralDistributionAPI:emission"]', '["SpectralLightAPI"]')),
    Bad("wrong quantity", ("/Skin", "spectrum:reflectance:quantity"), edit('reflectance:quantity = "reflectance"', 'reflectance:quantity = "radiance"')),
    # Materials
    Bad("wrap of 2", ("/Skin", "inputs:skin:wrap", "2"), edit("wrap = 0.3", "wrap = 2")),
    Bad("wrap of NaN", ("/Skin", "inputs:skin:wrap"), edit("wrap = 0.3", "wrap = nan")),
    Bad("unknown token", ("/Skin", "inputs:skin:wrapNormalization", "papper", "paper"), edit("float inputs:skin:wrap = 0.3", 'token inputs:skin:wrapNormalization = "papper"')),
    Bad("misspelt skin schema", ("/Skin", "SkinMateralAPI"), edit('"SkinMaterialAPI"', '"SkinMateralAPI"')),
    Bad("skin texture missing", ("/Skin", "inputs:skin:albedo:file", "face.png"), edit("float inputs:skin:wrap", "asset inputs:skin:albedo:file = @./face.png@\n    float inputs:skin:wrap")),
    Bad("skin texture broken", ("/Skin", "face.png"), edit("float inputs:skin:wrap", "asset inputs:skin:albedo:file = @./face.png@\n    float inputs:skin:wrap"), prepare=write_bytes("face.png", b"\x89PNG\r\n\x1a\n....")),
    Bad("weights without a basis", ("/Skin", "inputs:skin:weights:basis"), edit("float inputs:skin:wrap", "asset inputs:skin:weights:file = @./sky.exr@\n    float inputs:skin:wrap")),
    Bad("weights of too few channels", ("sky.exr", "channel"), edit("float inputs:skin:wrap", "asset inputs:skin:weights:file = @./sky.exr@\n    double[] inputs:skin:weights:basis = [1, 1, 1, 1, 1, 1, 1, 1, 1, 1]\n    double[] inputs:skin:weights:basis:wavelengths = [400, 700]\n    float inputs:skin:wrap")),
    Bad("surface texture missing", ("/Glass/Picture", "iris.png"), prepare=remove("iris.png")),
    Bad("surface texture broken", ("iris.png",), prepare=truncate("iris.png", 0.5)),
    Bad("surface texture of 10^9 pixels", ("iris.png", "MiB"), prepare=huge_png),
    Bad("texture with NaN", ("iris.exr", "not finite"), edit("@./iris.png@", "@./iris.exr@"), prepare=write_map("iris.exr", ((1, 2), np.nan))),
    Bad("unknown wrap mode", ("wrapS", "reapet"), edit('wrapS = "repeat"', 'wrapS = "reapet"')),
    Bad("unknown source color space", ("sourceColorSpace", "srbg"), edit('sourceColorSpace = "auto"', 'sourceColorSpace = "srbg"')),
    Bad("shader loop", ("/Glass", "roughness"), (("float inputs:roughness = 0.3", "float inputs:roughness.connect = </Glass.inputs:r>"), ('token outputs:surface.connect', "float inputs:r.connect = </Glass.inputs:r>\n    token outputs:surface.connect"))),
    Bad("roughness NaN", ("/Glass", "roughness"), edit("roughness = 0.3", "roughness = nan")),
    Bad("material binding to a mesh", ("/Eye",), edit("rel material:binding = </Glass>", "rel material:binding = </Card>"), code=0),
    # Geometry
    Bad("index beyond the points", ("/Card", "faceVertexIndices"), edit("faceVertexIndices = [0, 1, 2]\n    point3f[] points = [(-1", "faceVertexIndices = [0, 1, 9]\n    point3f[] points = [(-1")),
    Bad("index negative", ("/Card", "faceVertexIndices"), edit("faceVertexIndices = [0, 1, 2]\n    point3f[] points = [(-1", "faceVertexIndices = [0, 1, -2]\n    point3f[] points = [(-1")),
    Bad("counts beyond the indices", ("/Card", "faceVertexCounts"), edit("faceVertexCounts = [3]\n    int[] faceVertexIndices = [0, 1, 2]\n    point3f[] points = [(-1", "faceVertexCounts = [4]\n    int[] faceVertexIndices = [0, 1, 2]\n    point3f[] points = [(-1")),
    Bad("points with NaN", ("/Card", "points", "nan"), edit("(-1, -1, 0)", "(-1, nan, 0)")),
    Bad("points with infinity", ("/Card", "points"), edit("(-1, -1, 0)", "(-1, inf, 0)")),
    Bad("primvar too short", ("/Card", "primvars:st"), edit("primvars:st = [(0, 0), (1, 0), (0, 1)]", "primvars:st = [(0, 0)]")),
    Bad("normals too short", ("/Card", "normals"), edit("point3f[] points = [(-1", "normal3f[] normals = [(0, 0, 1)]\n    point3f[] points = [(-1")),
    Bad("unknown subdivision scheme", ("/Card", "subdivisionScheme"), edit('subdivisionScheme = "none"\n    rel material:binding = </Skin>', 'subdivisionScheme = "catmul"\n    rel material:binding = </Skin>')),
    Bad("unknown orientation", ("/Card", "orientation"), edit("point3f[] points = [(-1", 'token orientation = "upsideDown"\n    point3f[] points = [(-1')),
    Bad("mesh at NaN", ("/Card",), edit("point3f[] points = [(-1", 'double3 xformOp:translate = (0, 0, nan)\n    uniform token[] xformOpOrder = ["xformOp:translate"]\n    point3f[] points = [(-1')),
    Bad("instancers in a circle", ("/Crowd",), edit('def RenderSettings "Render" ', INSTANCERS), code=0),
    # Settings
    Bad("resolution 0", ("/Render", "resolution", "0"), edit("(8, 8)", "(0, 8)")),
    Bad("resolution negative", ("/Render", "resolution"), edit("(8, 8)", "(8, -8)")),
    Bad("resolution 10^9", ("/Render", "resolution"), edit("(8, 8)", "(1000000000, 1000000000)")),
    Bad("resolution by flag 0", ("-r",), arguments=("-r", "0", "8"), code=2),
    Bad("resolution by flag 10^9", ("-r",), arguments=("-r", "1000000000", "1000000000"), code=2),
    Bad("width by flag 0", ("-w",), arguments=("-w", "0"), code=2),
    Bad("width by flag 10^9", ("-w",), arguments=("-w", "1000000000"), code=2),
    Bad("more memory than there is", ("16384",), arguments=("-r", "16384", "16384", "--spectral"), code=6),
    Bad("samples 0", ("/Render", "usdskin:samplesPerPixel"), edit("samplesPerPixel = 1", "samplesPerPixel = 0")),
    Bad("samples by flag 0", ("-p",), arguments=("-p", "0"), code=2),
    Bad("samples by flag 10^9", ("-p",), arguments=("-p", "1000000000"), code=2),
    Bad("level 99", ("/Render", "usdskin:subdivisionLevel", "99"), edit("int usdskin:samplesPerPixel", "int usdskin:subdivisionLevel = 99\n    int usdskin:samplesPerPixel")),
    Bad("level by flag 99", ("--level", "99"), arguments=("--level", "99"), code=2),
    Bad("unknown filter", ("/Render", "usdskin:pixelFilter"), edit("int usdskin:samplesPerPixel", 'token usdskin:pixelFilter = "sinc"\n    int usdskin:samplesPerPixel')),
    Bad("misspelt setting", ("/Render", "usdskin:samplePerPixel"), edit("usdskin:samplesPerPixel", "usdskin:samplePerPixel")),
    Bad("wavelengths of the settings", ("/Render", "usdskin:wavelengths"), edit("int usdskin:samplesPerPixel", "double[] usdskin:wavelengths = [500, 400]\n    int usdskin:samplesPerPixel")),
    Bad("wavelengths by flag", ("--wavelengths",), arguments=("--wavelengths", "700:400:5"), code=2),
    Bad("wavelengths by flag without end", ("--wavelengths",), arguments=("--wavelengths", "400:700:0"), code=2),
    Bad("settings prim missing", ("renderSettingsPrimPath", "/Rendre"), edit('renderSettingsPrimPath = "/Render"', 'renderSettingsPrimPath = "/Rendre"')),
    Bad("settings by flag", ("-rs", "/Rendre"), arguments=("-rs", "/Rendre"), code=2),
    Bad("product missing", ("/Render", "/Render/Mian"), edit("rel products = </Render/Main>", "rel products = </Render/Mian>")),
    Bad("unknown AOV", ("/Render/Depth", "Zz"), edit('sourceName = "Z"', 'sourceName = "Zz"'), code=0),
    Bad("unknown AOV by flag", ("--aov", "Zz"), arguments=("--aov", "N,Zz"), code=2),
    Bad("pixel aspect 0", ("/Render", "pixelAspectRatio"), edit("uniform int2 resolution", "float pixelAspectRatio = 0\n    uniform int2 resolution")),
    # Flags
    Bad("--set of no prim", ("--set", "/Nope"), arguments=("--set", "/Nope.a=1"), code=2),
    Bad("--set of no attribute", ("--set", "inputs:skin:wrap"), arguments=("--set", "/Skin.inputs:skin:warp=1"), code=2),
    Bad("--set of a wrong value", ("--set", "much"), arguments=("--set", "/Skin.inputs:skin:wrap=much"), code=2),
    Bad("--set without a value", ("--set",), arguments=("--set", "/Skin.inputs:skin:wrap"), code=2),
    Bad("--set beyond the limit", ("inputs:skin:wrap", "7"), arguments=("--set", "/Skin.inputs:skin:wrap=7")),
    Bad("--variant of no set", ("--variant", "look"), arguments=("--variant", "/Skin{look=old}"), code=2),
    Bad("--variant misspelt", ("--variant",), arguments=("--variant", "Skin=old"), code=2),
    Bad("--mask of no prim", ("--mask", "/Nope"), arguments=("--mask", "/Nope"), code=2),
    Bad("--purposes unknown", ("--purposes", "final"), arguments=("--purposes", "final"), code=2),
    Bad("--illuminant unknown", ("--illuminant", "FL99"), arguments=("--illuminant", "FL99"), code=2),
    Bad("--white unknown", ("--white", "FL99"), arguments=("--white", "FL99"), code=2),
    Bad("--view unknown", ("--view", "Nice"), arguments=("--view", "Nice"), code=2),
    Bad("--ev beyond reason", ("--ev",), arguments=("--ev", "1e9"), code=2),
    Bad("--integrator traced", ("--integrator",), arguments=("--integrator", "traced"), code=2),
    Bad("frames misspelt", ("-f", "1-x"), arguments=("-f", "1-x"), code=2),
    Bad("frames without a place", ("####",), arguments=("-f", "1-3"), code=2),
    Bad("frames without end", ("-f",), arguments=("-f", "1-1000000000"), code=2),
    Bad("--device unknown", ("--device", "gpu"), arguments=("--device", "gpu"), code=2),
    Bad("--device missing", ("cuda:99",), arguments=("--device", "cuda:99"), code=6),
    Bad("--threads 0", ("--threads",), arguments=("--threads", "0"), code=2),
    # Files to write
    Bad("folder is a file", ("sky.exr",), output="sky.exr/o.exr"),
    Bad("output is a folder", ("out/sub.exr",), output="out/sub.exr", prepare=lambda: Path("out/sub.exr").mkdir(), code=2),
    Bad("output of no kind", ("o.jpg", ".exr"), output="out/o.jpg", code=2),
    Bad("output without a suffix", (".exr",), output="out/o", code=2),
]  # fmt: skip


def listing(folder: Path) -> dict[str, int]:
    return {str(path): path.stat().st_mtime_ns for path in sorted(folder.rglob("*"))}


@pytest.fixture
def shot(tmp_path, monkeypatch):
    """Write the good stage and its files into an empty folder and go there."""
    monkeypatch.chdir(tmp_path)
    Path("out").mkdir()
    write_map("sky.exr")()
    write_png(Path("iris.png"), np.full((4, 4, 3), 90, np.uint8))
    return tmp_path


def render(case: Bad) -> int:
    text = STAGE
    for before, after in case.edits:
        assert text.count(before) >= 1, before
        text = text.replace(before, after)
    Path("shot.usda").write_bytes(text.encode(errors="surrogateescape"))
    if case.prepare is not None:
        case.prepare()
    return cli.main(["-q", "render", case.stage, case.output, *case.arguments])


def test_the_unchanged_stage_renders(shot, capfd):
    assert render(Bad("good", ())) == 0
    printed = capfd.readouterr()
    assert printed.out.split() == ["out/o.exr", "out/o.png"]
    assert printed.err == ""


@pytest.mark.parametrize("case", CASES, ids=[case.name for case in CASES])
def test_bad_input_is_one_line_and_leaves_nothing(case, shot, capfd):
    if case.prepare:
        pass
    code = render(case)
    printed = capfd.readouterr()
    if os.environ.get("QA_SHOW"):
        with open(os.environ["QA_SHOW"], "a") as log:
            log.write(f"{code} (want {case.code})  {case.name}\n    {printed.err.replace(str(shot), '$TMP')}\n")
    assert code == case.code, printed.err
