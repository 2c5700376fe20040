"""UsdUVTexture, UsdTransform2d and the primvar readers of UsdPreviewSurface 2.6."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from usdskin.errors import LayerError
from usdskin.layers import describe
from usdskin.render.connections import Network, is_node_output, shader_name
from usdskin.render.inputs import Four, Input, PrimvarInput, TextureInput

# isort: split
# After ours, which register the schemas.
from pxr import Sdf, Usd, UsdShade

_CHANNELS = ("rgb", "r", "g", "b", "a")
_WRAPS = ("black", "clamp", "repeat", "mirror", "useMetadata")
_COLOR_SPACES = ("raw", "sRGB", "auto")
_TEXTURE_SPACES = {
    "": "auto", "auto": "auto", "raw": "raw", "data": "raw", "identity": "raw", "unknown": "auto",
    "lin_rec709_scene": "raw", "linear": "raw",
    "sRGB": "sRGB", "srgb_rec709_scene": "sRGB", "srgb_texture": "sRGB",
    "srgb_rec709_display": "sRGB",
}  # fmt: skip
"""``sourceColorSpace`` for the color space a texture's asset attribute may name."""

_CHAIN_LIMIT = 64
"""Most UsdTransform2d nodes in a row."""


def read_primvar_node(network: Network, node: UsdShade.Shader, width: int, wanted: int) -> PrimvarInput | None:
    name = network.token(node, "varname", "", ()).removeprefix("primvars:")
    if not name:
        network.note("primvar-without-name", node.GetPrim(), "inputs:varname is empty; not shown")
        return None
    source = network.source(node, "fallback")
    fallback = (0.0,) * width if source is None else network.numbers(source, width)
    return PrimvarInput(name, fallback[:wanted] if wanted > 1 else fallback[:1])


def read_texture_node(network: Network, node: UsdShade.Shader, source: Usd.Attribute, channel: str) -> Input:
    output = source.GetName().removeprefix("outputs:")
    if output == "rgba" or (output == "rgb" and channel == "r"):
        output = "rgb" if channel == "rgb" else "r"
    if output not in _CHANNELS:
        raise LayerError(
            f"{describe(node.GetPrim())}: {source.GetName()} is no output of a UsdUVTexture; "
            f"connect to one of {', '.join(_CHANNELS)}"
        )
    fallback = _four(network, node, "fallback", (0.0, 0.0, 0.0, 1.0))
    file, encoding = _file(network, node)
    if file is None:
        network.note("texture-without-file", node.GetPrim(), "no file; its fallback is shown")
        return fallback[:3] if output == "rgb" else fallback["rgba".index(output)]
    primvar, matrix = _coordinates(network, node)
    return TextureInput(
        file=file,
        channel=output,
        source_color_space=encoding,
        scale=_four(network, node, "scale", (1.0, 1.0, 1.0, 1.0)),
        bias=_four(network, node, "bias", (0.0, 0.0, 0.0, 0.0)),
        fallback=fallback,
        wrap_s=network.token(node, "wrapS", "useMetadata", _WRAPS),
        wrap_t=network.token(node, "wrapT", "useMetadata", _WRAPS),
        primvar=primvar,
        st_matrix=matrix,
    )


def _four(network: Network, node: UsdShade.Shader, name: str, fallback: Four) -> Four:
    source = network.source(node, name)
    if source is None or is_node_output(source):
        return fallback
    red, green, blue, alpha = network.numbers(source, 4)
    return red, green, blue, alpha


def _file(network: Network, node: UsdShade.Shader) -> tuple[Path | None, str]:
    """Return a texture's file and its ``sourceColorSpace``."""
    source = network.source(node, "file")
    asset = None if source is None or is_node_output(source) else network.value(source)
    encoding = network.token(node, "sourceColorSpace", "auto", _COLOR_SPACES)
    if source is None or asset is None or not getattr(asset, "path", ""):
        return None, encoding
    if encoding == "auto":
        named = str(source.GetColorSpace())
        if named not in _TEXTURE_SPACES:
            what = f"the color space {named} is not known; taken as auto"
            network.note("color-space-not-supported", node.GetPrim(), what)
        encoding = _TEXTURE_SPACES.get(named, "auto")
    return _resolve(source, asset), encoding


def _coordinates(network: Network, node: UsdShade.Shader) -> tuple[str, NDArray[np.float64]]:
    """Return the primvar with a texture's coordinates, and the map from one to the other."""
    matrix = np.eye(3)
    name = "st"
    for _ in range(_CHAIN_LIMIT):
        source = network.source(node, name)
        if source is None or not is_node_output(source):
            return "st", _fixed(network, node, source, matrix)
        node = UsdShade.Shader(source.GetPrim())
        identifier = node.GetShaderId()
        if identifier == "UsdPrimvarReader_float2":
            found = read_primvar_node(network, node, 2, 2)
            return (
                (found.name, matrix[:2]) if found else ("st", _fixed(network, node, None, matrix))
            )
        if identifier != "UsdTransform2d":
            what = f"texture coordinates come from a shader {shader_name(node)}; st is shown"
            network.note("shader-not-supported", node.GetPrim(), what)
            return "st", matrix[:2]
        matrix = matrix @ _transform(network, node)
        name = "in"
    raise LayerError(
        f"{describe(node.GetPrim())}: the connections of {_CHAIN_LIMIT} UsdTransform2d form a "
        "loop; remove one"
    )


def _fixed(
    network: Network, node: UsdShade.Shader, source: Usd.Attribute | None, matrix: NDArray[np.float64]
) -> NDArray[np.float64]:
    """Return the map that gives one texel everywhere, as UsdUVTexture says of unconnected st."""
    what = "texture coordinates are not connected; one texel is shown everywhere"
    network.note("texture-without-st", node.GetPrim(), what)
    s, t = (0.0, 0.0) if source is None else network.numbers(source, 2)
    fixed = np.zeros((2, 3))
    fixed[:, 2] = (matrix @ (s, t, 1.0))[:2]
    return fixed


def _transform(network: Network, node: UsdShade.Shader) -> NDArray[np.float64]:
    """Return the matrix of a UsdTransform2d: scale, then rotate, then translate."""
    plain: dict[str, tuple[float, ...]] = {
        "scale": (1.0, 1.0),
        "rotation": (0.0,),
        "translation": (0.0, 0.0),
    }
    for name, fallback in plain.items():
        source = network.source(node, name)
        if source is not None and not is_node_output(source):
            plain[name] = network.numbers(source, len(fallback))
    angle = math.radians(plain["rotation"][0])
    turn = np.array([[math.cos(angle), -math.sin(angle)], [math.sin(angle), math.cos(angle)]])
    matrix = np.eye(3)
    matrix[:2, :2] = turn @ np.diag(plain["scale"])
    matrix[:2, 2] = plain["translation"]
    return matrix


def _resolve(attribute: Usd.Attribute, asset: Sdf.AssetPath) -> Path:
    if asset.resolvedPath:
        return Path(asset.resolvedPath)
    layer = attribute.GetPropertyStack()[0].layer
    if "<UDIM>" in asset.path and UsdShade.UdimUtils.ResolveUdimTilePaths(asset.path, layer):
        return Path(layer.ComputeAbsolutePath(asset.path))
    raise LayerError(
        f"{describe(attribute)}: {attribute.GetName()} names @{asset.path}@, which is not there; "
        "restore it or correct the path"
    )


