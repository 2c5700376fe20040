"""Input as a stranger wrote it: the exit code, one line that helps, and nothing half-written.

Every case is one change to a stage that renders. The line on stderr names where, what and what to
do; neither USD nor OpenImageIO adds words of its own, and no file is made or changed.
"""

from __future__ import annotations

import struct
import subprocess
import sys
import zlib
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pytest

from usdskin import cli
from usdskin.image_output import Part, write_exr, write_png

STAGE = """#usda 1.0
(
    metersPerUnit = 1
    renderSettingsPrimPath = "/Render"
)
def Camera "Cam"
{
    # camera
    float2 clippingRange = (0.1, 100)
    double3 xformOp:translate = (0, 0, 5)
    uniform token[] xformOpOrder = ["xformOp:translate"]
}
def DomeLight "Sky" (
    prepend apiSchemas = ["SpectralLightAPI"]
)
{
    # sky
    uniform token inputs:spectral:source = "rgb"
    uniform token inputs:spectral:illuminant = "D65"
    float inputs:intensity = 1
    color3f inputs:color = (1, 1, 1)
    asset inputs:texture:file = @./sky.exr@
}
def DistantLight "Sun" (
    prepend apiSchemas = ["SpectralLightAPI", "SpectralDistributionAPI:emission"]
)
{
    # sun
    uniform token inputs:spectral:source = "tabulated"
    uniform token inputs:spectral:units = "relative"
    uniform token spectrum:emission:quantity = "relative"
    double[] spectrum:emission:wavelengths = [400, 700]
    double[] spectrum:emission:values = [0.5, 1]
}
def Mesh "Card" (prepend apiSchemas = ["MaterialBindingAPI"])
{
    # card
    int[] faceVertexCounts = [3, 4]
    int[] faceVertexIndices = [0, 1, 2, 0, 2, 3, 4]
    point3f[] points = [(-1, -1, 0), (1, -1, 0), (0, 1, 0), (-1, 1, 0), (-1.5, 0, 0)]
    texCoord2f[] primvars:st = [(0, 0), (1, 0), (0, 1), (0, 2), (0, 3)] (interpolation = "vertex")
    uniform token orientation = "rightHanded"
    uniform token subdivisionScheme = "none"
    rel material:binding = </Skin>
}
def Material "Skin" (
    prepend apiSchemas = ["SkinMaterialAPI", "SpectralDistributionAPI:reflectance",
        "SpectralDistributionAPI:scattering"]
)
{
    # skin
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
        # surface
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
    # settings
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
BASIS = """uniform token inputs:spectral:source = "basis"
    asset inputs:spectral:coefficients:file = @./c.exr@
    uniform double[] inputs:spectral:basis:wavelengths = [400, 700]
    double[] inputs:spectral:basis"""
BANDS = """uniform token inputs:spectral:source = "bands"
    asset inputs:spectral:bands:file = @./bands.exr@"""
RGB = 'uniform token inputs:spectral:source = "rgb"'
LAMP = "asset inputs:spectral:illuminant:file = @./lamp.csv@"
D65 = 'uniform token inputs:spectral:illuminant = "D65"'
FACE = "asset inputs:skin:albedo:file = @./face.png@"
WEIGHTS = "asset inputs:skin:weights:file = @./sky.exr@"
ORDER = 'uniform token[] xformOpOrder = ["xformOp:translate"]'


def pixels(name: str, row: int, column: int, value: float) -> Callable[[], None]:
    """Return what writes a map of ones with one other pixel."""

    def write() -> None:
        changed = MAP.copy()
        changed[row, column] = value
        write_exr(Path(name), [Part("", {"": changed}, color_space="lin_rec709_scene")])

    return write


def coefficients(count: int, value: float = 1.0) -> Callable[[], None]:
    channels = {f"c{k}": np.full((4, 8), value, np.float32) for k in range(count)}
    return lambda: write_exr(Path("c.exr"), [Part("", channels)])


def data(name: str, content: bytes) -> Callable[[], None]:
    def write() -> None:
        Path(name).write_bytes(content)

    return write


def cut(name: str, share: float) -> Callable[[], None]:
    def shorten() -> None:
        content = Path(name).read_bytes()
        Path(name).write_bytes(content[: int(len(content) * share)])

    return shorten


def gone(name: str) -> Callable[[], None]:
    return lambda: Path(name).unlink()


def png(width: int, height: int) -> bytes:
    """Return a PNG whose header promises more pixels than it has."""
    content = b"\x89PNG\r\n\x1a\n"
    header = struct.pack(">IIBBBBB", width, height, 16, 6, 0, 0, 0)
    for kind, body in ((b"IHDR", header), (b"IDAT", zlib.compress(b"0")), (b"IEND", b"")):
        content += struct.pack(">I", len(body)) + kind + body
        content += struct.pack(">I", zlib.crc32(kind + body))
    return content


@dataclass(frozen=True)
class Bad:
    """One wrong input."""

    name: str
    says: str
    """Words the line must hold: the place, and the value or the remedy."""

    changes: tuple[str, ...] = ()
    """``before -> after`` each, in the stage's text."""

    files: Callable[[], object] | None = None
    """Changes files when the stage is written."""

    arguments: tuple[str, ...] = ()
    code: int = 3
    stage: str = "shot.usda"
    output: str = "out/o.exr"


def bad(name: str, says: str, *changes: str, **other) -> Bad:
    return Bad(name, says, changes, **other)


def flag(says: str, *arguments: str, code: int = 2) -> Bad:
    return Bad(" ".join(arguments), says, arguments=arguments, code=code)


# fmt: off
INSTANCERS = """def PointInstancer "Crowd"
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
def RenderSettings "Render\""""

CASES = [
    # The layer
    Bad("stage missing", "nowhere.usda no such file", stage="nowhere.usda"),
    Bad("stage is a folder", "out not a file", stage="out"),
    Bad("stage is a picture", "sky.exr USD layer", stage="sky.exr"),
    bad("stage is empty", "shot.usda", files=data("shot.usda", b"")),
    bad("stage is noise", "shot.usda", files=data("shot.usda", bytes(range(256)) * 9)),
    bad("stage is a broken crate", "shot.usda",
        files=data("shot.usda", b"PXR-USDC" + b"\xff" * 90)),
    bad("stage is cut short", "shot.usda:75:9: Expected", files=cut("shot.usda", 0.7)),
    bad("stage is not UTF-8", "shot.usda UTF-8", '"Glass" -> "Gl\udcffss"'),
    bad("metersPerUnit 0", "shot.usda metersPerUnit", "metersPerUnit = 1 -> metersPerUnit = 0"),
    bad("crowd of itself", "/Crowd prototypes", f'def RenderSettings "Render" -> {INSTANCERS}'),
    bad("time codes 0", "timeCodesPerSecond", "metersPerUnit = 1 -> timeCodesPerSecond = 0"),
    bad("time codes NaN", "timeCodesPerSecond", "metersPerUnit = 1 -> timeCodesPerSecond = nan"),
    bad("start NaN", "shot.usda startTimeCode", "metersPerUnit = 1 -> startTimeCode = nan"),
    bad("upAxis X", "shot.usda upAxis", 'metersPerUnit = 1 -> upAxis = "X"'),
    # Cameras
    bad("no camera", "shot.usda no camera", 'def Camera -> def Xform', "rel camera = </Cam> -> "),
    bad("two cameras", "/Cam /Second -cam", "rel camera = </Cam> -> ",
        'def DomeLight -> def Camera "Second" {}\ndef DomeLight'),
    bad("light as camera", "/Sky DomeLight -cam", "camera = </Cam> -> camera = </Sky>"),
    bad("aperture 0", "/Cam horizontalAperture", "# camera -> float horizontalAperture = 0"),
    bad("aperture NaN", "/Cam verticalAperture", "# camera -> float verticalAperture = nan"),
    bad("focal length -50", "/Cam focalLength -50", "# camera -> float focalLength = -50"),
    bad("clipping", "/Cam clippingRange (100, 0.1)", "(0.1, 100) -> (100, 0.1)"),
    bad("camera at NaN", "/Cam transform", "(0, 0, 5) -> (0, 0, nan)"),
    bad("camera flattened", "/Cam transform", "double3 xformOp:translate -> double3 xformOp:scale",
        '["xformOp:translate"] -> ["xformOp:scale"]'),
    bad("camera exposure", "/Cam exposure 1e+09", "# camera -> float exposure = 1e9"),
    # Lights
    bad("no light", "shot.usda no light shines",
        'DomeLight "Sky" ( -> DomeLight "Sky" (\nactive = false',
        'DistantLight "Sun" ( -> DistantLight "Sun" (\nactive = false'),
    bad("misspelt schema", "/Sky SpectralLigthAPI SpectralLightAPI",
        '["SpectralLightAPI"] -> ["SpectralLigthAPI"]'),
    bad("misspelt instance schema", "/Sun SpectralDistibutionAPI",
        '"SpectralDistributionAPI:emission" -> "SpectralDistibutionAPI:emission"'),
    bad("misspelt attribute", "/Sky inputs:spectral:ilumiant illuminant",
        "spectral:illuminant -> spectral:ilumiant"),
    bad("schema not applied", "/Sky SpectralLightAPI",
        'prepend apiSchemas = ["SpectralLightAPI"] -> kind = "group"'),
    bad("emission not applied", "/Sun SpectralDistributionAPI:emission",
        ', "SpectralDistributionAPI:emission"] -> ]'),
    bad("unknown source", "/Sky inputs:spectral:source rbg", 'source = "rgb" -> source = "rbg"'),
    bad("unknown units", "/Sun inputs:spectral:units W", 'units = "relative" -> units = "W"'),
    bad("mixed units", "/Sky /Sun absolute relative", 'units = "relative" -> units = "absolute"',
        'emission:quantity = "relative" -> emission:quantity = "irradiance"'),
    bad("unknown illuminant", "/Sky FL99 FL9", 'illuminant = "D65" -> illuminant = "FL99"'),
    bad("lamp file missing", "/Sky lamp.csv", f"{D65} -> {LAMP}"),
    bad("lamp file of words", "lamp.csv:2 world", f"{D65} -> {LAMP}",
        files=data("lamp.csv", b"hello\nworld\n")),
    bad("lamp file of one line", "lamp.csv", f"{D65} -> {LAMP}",
        files=data("lamp.csv", b"550,1\n")),
    bad("lamp negative", "lamp.csv -1", f"{D65} -> {LAMP}",
        files=data("lamp.csv", b"400,-1\n700,1")),
    bad("intensity negative", "/Sky intensity -1", "intensity = 1 -> intensity = -1"),
    bad("intensity NaN", "/Sky intensity nan", "intensity = 1 -> intensity = nan"),
    bad("exposure 1e30", "/Sky exposure", "intensity = 1 -> exposure = 1e30"),
    bad("intensity 1e30", "/Sky 1e+30", "intensity = 1 -> intensity = 1e30"),
    bad("color negative", "/Sky color (1, -1, 1)", "color = (1, 1, 1) -> color = (1, -1, 1)"),
    bad("sun at NaN", "/Sun transform", "# sun -> double3 xformOp:scale = (0, 0, nan)"
        '\n    uniform token[] xformOpOrder = ["xformOp:scale"]'),
    bad("map missing", "/Sky sky.exr", files=gone("sky.exr")),
    bad("map cut short", "sky.exr /Sky", files=cut("sky.exr", 0.9)),
    bad("map is no picture", "sky.exr /Sky", files=data("sky.exr", b"no picture")),
    bad("map format", "/Sky angular", '# sky -> token inputs:texture:format = "angular"'),
    bad("map with NaN", "sky.exr /Sky NaN --bad-pixels", files=pixels("sky.exr", 1, 2, np.nan)),
    bad("map with inf", "sky.exr infinite --bad-pixels", files=pixels("sky.exr", 0, 7, np.inf)),
    bad("map negative", "sky.exr -3 --bad-pixels", files=pixels("sky.exr", 3, 0, -3.0)),
    bad("bands missing", "/Sky bands.exr", f"{RGB} -> {BANDS}"),
    bad("bands without spectra", "bands.exr S0", f"{RGB} -> {BANDS}",
        files=pixels("bands.exr", 0, 0, 1.0)),
    bad("bands unnamed", "/Sky bands:file", 'source = "rgb" -> source = "bands"'),
    bad("basis and rows", "/Sky basis", f"{RGB} -> {BASIS} = [1, 1, 1]", files=coefficients(1)),
    bad("basis and channels", "c.exr c1", f"{RGB} -> {BASIS} = [1, 1, 1, 1]",
        files=coefficients(1)),
    bad("basis with NaN", "/Sky basis nan", f"{RGB} -> {BASIS} = [1, nan]", files=coefficients(1)),
    bad("basis negative", "c.exr --bad-pixels", f"{RGB} -> {BASIS} = [1, 1]",
        files=coefficients(1, -1.0)),
    bad("blackbody of 0 K", "/Sky 0 K",
        'source = "rgb" -> source = "blackbody"', "# sky -> float inputs:colorTemperature = 0"),
    bad("daylight of 999 K", "/Sky 999 K",
        'source = "rgb" -> source = "illuminantD"', "# sky -> float inputs:colorTemperature = 999"),
    # Spectra
    bad("not ascending", "shot.usda /Skin spectrum:reflectance:wavelengths",
        "reflectance:wavelengths = [400, 700] -> reflectance:wavelengths = [700, 400]"),
    bad("wavelength twice", "/Skin spectrum:reflectance:wavelengths",
        "reflectance:wavelengths = [400, 700] -> reflectance:wavelengths = [400, 400]"),
    bad("wavelength negative", "/Skin spectrum:reflectance:wavelengths -400",
        "reflectance:wavelengths = [400, 700] -> reflectance:wavelengths = [-400, 700]"),
    bad("lengths unequal", "/Skin spectrum:reflectance 2 3",
        "reflectance:wavelengths = [400, 700] -> reflectance:wavelengths = [400, 550, 700]"),
    bad("spectrum empty", "/Skin spectrum:reflectance",
        "reflectance:wavelengths = [400, 700] -> reflectance:wavelengths = []", "[0.3, 0.6] -> []"),
    bad("spectrum with NaN", "/Skin spectrum:reflectance:values 1", "[0.3, 0.6] -> [0.3, nan]"),
    bad("spectrum negative", "/Skin spectrum:reflectance:values -0.6", "[0.3, 0.6] -> [0.3, -0.6]"),
    bad("emission negative", "/Sun spectrum:emission:values -1", "[0.5, 1] -> [0.5, -1]"),
    bad("emission 1e300", "/Sun 1e+18", "[0.5, 1] -> [1e300, 1]"),
    bad("wrong quantity", "/Skin spectrum:reflectance:quantity radiance",
        'quantity = "reflectance" -> quantity = "radiance"'),
    # Materials
    bad("wrap 2", "/Skin inputs:skin:wrap 2", "wrap = 0.3 -> wrap = 2"),
    bad("wrap NaN", "/Skin inputs:skin:wrap nan", "wrap = 0.3 -> wrap = nan"),
    bad("unknown token", "/Skin wrapNormalization papper paper energy",
        '# skin -> token inputs:skin:wrapNormalization = "papper"'),
    bad("misspelt skin", "/Skin SkinMateralAPI", '"SkinMaterialAPI" -> "SkinMateralAPI"'),
    bad("skin texture missing", "/Skin albedo:file face.png", f"# skin -> {FACE}"),
    bad("skin texture broken", "face.png", f"# skin -> {FACE}", files=data("face.png", b"\x89PNG")),
    bad("weights without basis", "/Skin inputs:skin:weights:basis", f"# skin -> {WEIGHTS}"),
    bad("weights of 3 channels", "sky.exr 3 channels", f"""# skin -> {WEIGHTS}
        double[] inputs:skin:weights:basis = [1, 1, 1, 1, 1, 1, 1, 1]
        double[] inputs:skin:weights:basis:wavelengths = [400, 700]"""),
    bad("texture missing", "/Glass/Picture iris.png", files=gone("iris.png")),
    bad("texture cut short", "iris.png cut short", files=cut("iris.png", 0.8)),
    bad("texture of 10^9 pixels", "iris.png MB", files=data("iris.png", png(60000, 60000))),
    bad("texture with NaN", "iris.exr not finite 2 row 1", "iris.png -> iris.exr",
        files=pixels("iris.exr", 1, 2, np.nan)),
    bad("JPEG cut short", "iris.jpg cut short", "iris.png -> iris.jpg",
        files=data("iris.jpg", b"\xff\xd8\xff\xe0\0\x04ab\xff\xda\0\x04ab" + b"a" * 50)),
    bad("unknown wrap mode", "wrapS reapet repeat", 'wrapS = "repeat" -> wrapS = "reapet"'),
    bad("unknown color space", "sourceColorSpace srbg sRGB", '"auto" -> "srbg"'),
    bad("roughness NaN", "/Glass roughness nan", "roughness = 0.3 -> roughness = nan"),
    bad("shader loop", "/Glass loop",
        "inputs:roughness = 0.3 -> inputs:roughness.connect = </Glass.inputs:r>",
        "token outputs:surface.connect -> float inputs:r.connect = </Glass.inputs:r>\n"
        "    token outputs:surface.connect"),
    # Geometry
    bad("index 9 of 5", "/Card faceVertexIndices 9 5", "2, 3, 4] -> 2, 3, 9]"),
    bad("index -2", "/Card faceVertexIndices -2", "2, 3, 4] -> 2, 3, -2]"),
    bad("counts and indices", "/Card faceVertexCounts 8 7", "[3, 4] -> [4, 4]"),
    bad("points with NaN", "/Card point nan", "(-1, -1, 0) -> (-1, nan, 0)"),
    bad("points with inf", "/Card point inf", "(-1, -1, 0) -> (-1, inf, 0)"),
    bad("st too short", "/Card primvars:st", ", (0, 1), (0, 2), (0, 3)] -> ]"),
    bad("st with NaN", "/Card primvars:st", "(0, 2), (0, 3)] -> (0, 2), (0, nan)]"),
    bad("normals too short", "/Card normals 1", "# card -> normal3f[] normals = [(0, 0, 1)]"),
    bad("unknown scheme", "/Card subdivisionScheme catmul none",
        'Scheme = "none" -> Scheme = "catmul"'),
    bad("unknown orientation", "/Card orientation left", '"rightHanded" -> "left"'),
    bad("mesh at NaN", "/Card transform",
        f"# card -> double3 xformOp:translate = (0, 0, nan)\n{ORDER}"),
    # Settings
    bad("resolution 0", "/Render resolution 0", "(8, 8) -> (0, 8)"),
    bad("resolution -8", "/Render resolution -8", "(8, 8) -> (8, -8)"),
    bad("resolution 10^9", "/Render resolution 1000000000", "(8, 8) -> (1000000000, 1000000000)"),
    bad("pixel aspect 0", "/Render pixelAspectRatio 0", "# settings -> float pixelAspectRatio = 0"),
    bad("samples 0", "/Render samplesPerPixel 0", "samplesPerPixel = 1 -> samplesPerPixel = 0"),
    bad("level 99", "/Render subdivisionLevel 99",
        "# settings -> int usdskin:subdivisionLevel = 99"),
    bad("unknown filter", "/Render pixelFilter sinc",
        '# settings -> token usdskin:pixelFilter = "sinc"'),
    bad("misspelt setting", "/Render samplePerPixel samplesPerPixel",
        "usdskin:samplesPerPixel -> usdskin:samplePerPixel"),
    bad("settings' wavelengths", "/Render usdskin:wavelengths",
        "# settings -> uniform double[] usdskin:wavelengths = [500, 400]"),
    bad("settings missing", "renderSettingsPrimPath /Rendre", '= "/Render" -> = "/Rendre"'),
    bad("product missing", "/Render /Mian", "products = </Render/Main> -> products = </Mian>"),
    bad("variable missing", "/Render/Main /Deep", "Vars = </Render/Depth> -> Vars = </Deep>"),
    # Flags
    flag("/Nope /Cam", "-cam", "/Nope", code=3),
    flag("-r 0", "-r", "0", "8"),
    flag("-r 1000000000", "-r", "1000000000", "1000000000"),
    flag("-w 0", "-w", "0"),
    flag("-w 1000000000", "-w", "1000000000"),
    flag("-p 0", "-p", "0"),
    flag("-p 1000000000", "-p", "1000000000"),
    flag("--level 99", "--level", "99"),
    flag("--wavelengths 700:400:5", "--wavelengths", "700:400:5"),
    flag("--wavelengths 400:700:0", "--wavelengths", "400:700:0"),
    flag("--wavelengths bands", "--wavelengths", "400:700:1e-9"),
    flag("--wavelengths 550:550:5", "--wavelengths", "550:550:5"),
    flag("-rs /Rendre /Render", "-rs", "/Rendre"),
    flag("--aov Zz N", "--aov", "N,Zz"),
    flag("--set /Nope", "--set", "/Nope.a=1"),
    flag("--set inputs:skin:wrap", "--set", "/Skin.inputs:skin:warp=1"),
    flag("--set much float", "--set", "/Skin.inputs:skin:wrap=much"),
    flag("--set /prim.attribute=value", "--set", "/Skin.inputs:skin:wrap"),
    flag("--variant look", "--variant", "/Skin{look=old}"),
    flag("--variant {set=variant}", "--variant", "Skin=old"),
    flag("--mask /Nope", "--mask", "/Nope"),
    flag("--purposes final proxy", "--purposes", "final"),
    flag("--illuminant FL99", "--illuminant", "FL99"),
    flag("--white FL99", "--white", "FL99"),
    flag("--view Nice ACES", "--view", "Nice"),
    flag("--ev 1e9", "--ev", "1e9"),
    flag("--integrator rays", "--integrator", "rays"),
    flag("--aov visibility", "--aov", "visibility"),
    flag("--bounces 2", "--bounces", "2"),
    flag("-f 1-x", "-f", "1-x"),
    flag("o.####.exr", "-f", "1-3"),
    flag("-f 1000000000", "-f", "1-1000000000"),
    flag("--device gpu", "--device", "gpu"),
    flag("--device cuda:99", "--device", "cuda:99", code=6),
    flag("--threads 0", "--threads", "0"),
    # Files to write
    Bad("folder is a file", "sky.exr", output="sky.exr/o.exr"),
    Bad("output is a folder", "out/sub.exr folder", output="out/sub.exr", code=2,
        files=lambda: Path("out/sub.exr").mkdir()),
    Bad("output of another kind", "o.jpg .exr .png", output="out/o.jpg", code=2),
    Bad("output without a suffix", "out/o .exr .png", output="out/o", code=2),
    Bad("frame number in a still", "o.####.exr -f", output="out/o.####.exr", code=2),
]
# fmt: on


@pytest.fixture
def shot(tmp_path, monkeypatch):
    """Write the files of the good stage into an empty folder, and go there."""
    monkeypatch.chdir(tmp_path)
    Path("out").mkdir()
    pixels("sky.exr", 0, 0, 1.0)()
    write_png(Path("iris.png"), np.full((4, 4, 3), 90, np.uint8))
    return tmp_path


def write_shot(case: Bad) -> None:
    text = STAGE
    for change in case.changes:
        before, _, after = change.partition(" -> ")
        assert before in text, change
        text = text.replace(before, after)
    Path("shot.usda").write_bytes(text.encode(errors="surrogateescape"))
    if case.files is not None:
        case.files()


def listing(folder: Path) -> dict[str, int]:
    return {str(path): path.stat().st_mtime_ns for path in sorted(folder.rglob("*"))}


def render(case: Bad) -> int:
    return cli.main(["-q", "render", case.stage, case.output, *case.arguments])


def test_the_unchanged_stage_renders(shot, capfd):
    write_shot(Bad("good", ""))
    assert render(Bad("good", "")) == 0
    printed = capfd.readouterr()
    assert printed.out.split() == ["out/o.exr", "out/o.png"]
    assert printed.err == ""


@pytest.mark.parametrize("case", CASES, ids=lambda case: case.name)
def test_bad_input_is_one_line_that_says_where_and_leaves_nothing(case, shot, capfd):
    write_shot(case)
    before = listing(shot)
    code = render(case)
    printed = capfd.readouterr()
    assert code == case.code, printed.err
    assert printed.out == ""
    assert printed.err.startswith("usdskin: error: ")
    assert printed.err.count("\n") == 1
    assert case.name.startswith("stage") or "USD layer" not in printed.err
    for word in case.says.split():
        assert word in printed.err
    assert listing(shot) == before


FOG = 'string sourceName = "Z" -> string sourceName = "fog"'


@pytest.mark.parametrize(
    ("case", "code"),
    [
        (bad("lamp", "/Sun", "DistantLight -> SphereLight"), "light-needs-traced"),
        (bad("variable", "/Render/Fog", FOG, "Depth -> Fog"), "aov-not-written"),
        (bad("reference", "/Eye no.usda", 'Eye" ( -> Eye" (references = @./no.usda@\n'),
         "composition-error"),
        (bad("sublayer", "no.usda", "metersPerUnit -> subLayers = [@./no.usda@]\nmetersPerUnit"),
         "composition-error"),
        (bad("binding", "/Eye /Nope", "</Glass>\n -> </Nope>\n"), "binding-broken"),
        (bad("unapplied", "/Eye MaterialBindingAPI",
             'Eye" (prepend apiSchemas = ["MaterialBindingAPI"]) -> Eye"'), "binding-ignored"),
    ],
    ids=lambda value: getattr(value, "name", None),
)  # fmt: skip
def test_what_a_picture_does_not_show_is_told_in_a_note(case, code, shot, capfd):
    write_shot(case)
    assert render(case) == 0
    lines = capfd.readouterr().err.splitlines()
    assert all(line.startswith("usdskin: note: ") for line in lines)
    (line,) = [line for line in lines if code in line]
    for word in case.says.split():
        assert word in line


FULL_DISK = """
import os, resource
from usdskin import cli

command = ["-q", "render", "shot.usda", "out/o.exr", "--compression", "none", "--no-png"]
assert cli.main(command) == 0
size = os.path.getsize("out/o.exr")
for limit in (0, size // 2, size - 1000, size - 1):
    with open("out/o.exr", "w") as file:
        file.write("old")
    resource.setrlimit(resource.RLIMIT_FSIZE, (limit, -1))
    print(cli.main(command), os.listdir("out"), open("out/o.exr").read())
    resource.setrlimit(resource.RLIMIT_FSIZE, (-1, -1))
"""


def test_a_full_disk_leaves_the_old_file(shot):
    """A limit on the size of files stands in for the disk: its last byte counts as its first."""
    write_shot(Bad("good", ""))
    command = [sys.executable, "-c", FULL_DISK]
    ran = subprocess.run(command, capture_output=True, text=True, check=True)
    assert ran.stdout.splitlines() == ["out/o.exr"] + ["3 ['o.exr'] old"] * 4
    errors = ran.stderr.splitlines()
    assert len(errors) == 4
    assert all(line.startswith("usdskin: error: out/o.exr: cannot write; ") for line in errors)


@pytest.mark.parametrize(
    ("arguments", "says", "code"),
    [
        (["info", "nowhere.usda"], "nowhere.usda", 3),
        (["info", "good.obj"], "good.obj", 3),
        (["validate", "nowhere.usda"], "nowhere.usda", 3),
        (["map", "nowhere.usda", "-o", "out/m.exr"], "nowhere.usda", 3),
        (["map", "shot.usda", "-o", "out/m.jpg"], "out/m.jpg", 2),
        (["map", "shot.usda", "-o", "sky.exr/m.exr"], "sky.exr", 3),
        (["map", "shot.usda", "-o", "out/m.exr", "-w", "0"], "-w", 2),
        (["map", "shot.usda", "-o", "out/m.exr", "-w", "1000000000"], "-w", 2),
        (["map", "shot.usda", "-o", "out/m.exr", "--wrap", "2"], "--wrap", 2),
        (["map", "shot.usda", "-o", "out/m.exr", "--light", "/Cam"], "/Cam", 2),
        (["map", "shot.usda", "-o", "out/m.exr", "--material", "/Cam"], "/Cam", 2),
        (["import", "nowhere.obj", "-o", "out/a.usda"], "nowhere.obj", 3),
        (["import", "sky.exr", "-o", "out/a.usda"], "sky.exr", 2),
        (["import", "bad.obj", "-o", "out/a.usda"], "bad.obj", 3),
        (["import", "good.obj", "-o", "out/a.txt"], "out/a.txt", 2),
        (["import", "good.obj", "-o", "sky.exr/a.usda"], "sky.exr", 3),
        (["import", "good.obj", "-o", "out/a.usda", "--group", "hat"], "hat", 2),
        (["import", "good.obj", "-o", "out/a.usda", "--units", "mile"], "mile", 2),
        (["new", "sky.exr"], "sky.exr", 2),
        (["new", "sky.exr/project"], "sky.exr", 3),
    ],
    ids=lambda value: " ".join(value) if isinstance(value, list) else None,
)
def test_other_commands_refuse_bad_input_in_one_line_too(arguments, says, code, shot, capfd):
    write_shot(Bad("good", ""))
    Path("good.obj").write_text("v 0 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 3\n")
    Path("bad.obj").write_text("v 0 0 0\nf 1 2 3\n")
    before = listing(shot)
    assert cli.main(arguments) == code
    printed = capfd.readouterr()
    assert printed.out == ""
    assert printed.err.startswith("usdskin: error: ")
    assert printed.err.count("\n") == 1
    assert says in printed.err
    assert listing(shot) == before
