"""UsdUVTexture, UsdTransform2d and the primvar readers of UsdPreviewSurface 2.6."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from usdskin.errors import LayerError
from usdskin.layers import describe
from usdskin.render.connections import Network, is_node_output, shader_name
from usdskin.render.inputs import Color, Four, Input, PrimvarInput, TextureInput

# isort: split
# After ours, which register the schemas.
from pxr import Gf, Sdf, Usd, UsdShade

READERS = {
    "UsdPrimvarReader_float": 1,
    "UsdPrimvarReader_int": 1,
    "UsdPrimvarReader_float2": 2,
    "UsdPrimvarReader_float3": 3,
    "UsdPrimvarReader_normal": 3,
    "UsdPrimvarReader_point": 3,
    "UsdPrimvarReader_vector": 3,
    "UsdPrimvarReader_float4": 4,
}
"""Nodes that read a primvar of numbers, and how many."""

_OUTPUTS = ("rgb", "r", "g", "b", "a")
_WRAPS = ("black", "clamp", "repeat", "mirror", "useMetadata")
_ENCODINGS = ("raw", "sRGB", "auto")
_RAW = ("raw", "data", "identity")

_CHAIN_LIMIT = 64
"""Most UsdTransform2d nodes in a row."""


def read_primvar_node(network: Network, node: UsdShade.Shader, width: int) -> PrimvarInput | None:
    """Return what a UsdPrimvarReader reads; None, with a note, where it names no primvar.

    Args:
        network: The stage's shaders.
        node: The reader.
        width: Numbers that are asked for, of which the reader may give more, or one for all.
    """
    name = network.token(node, "varname", "", ()).removeprefix("primvars:")
    if not name:
        network.note("primvar-without-name", node.GetPrim(), "inputs:varname is empty; not shown")
        return None
    own_width = READERS[str(node.GetShaderId())]
    source = network.source(node, "fallback")
    held = source is not None and not is_node_output(source)
    fallback = network.numbers(source, own_width) if held else (0.0,) * own_width
    return PrimvarInput(name, (fallback * width if own_width == 1 else fallback)[:width])


def read_texture_node(
    network: Network, node: UsdShade.Shader, output: Usd.Attribute, width: int
) -> Input:
    """Return what comes out of a UsdUVTexture.

    Args:
        network: The stage's shaders.
        node: The texture.
        output: The output that is asked for.
        width: 3 for a color, 1 for a number, which takes the red of a color.

    Raises:
        LayerError: The picture is missing, or an input of the node cannot be used.
    """
    name = output.GetName().removeprefix("outputs:")
    # Houdini connects to a fifth output that the specification lacks.
    channel = "rgb" if name == "rgba" else name
    if channel not in _OUTPUTS:
        raise LayerError(
            f"{describe(node.GetPrim())}: {output.GetName()} is no output of a UsdUVTexture; "
            f"connect to one of {', '.join(_OUTPUTS)}"
        )
    if width == 1 and channel == "rgb":
        network.note("color-taken-as-number", node.GetPrim(), "a number takes the red of rgb")
        channel = "r"
    fallback = _four(network, node, "fallback", (0.0, 0.0, 0.0, 1.0))
    file, encoding = _file(network, node)
    if file is None:
        network.note("texture-without-file", node.GetPrim(), "no file; its fallback is shown")
        return _constant(fallback, channel, width)
    primvar, matrix = _coordinates(network, node)
    return TextureInput(
        file=file,
        channel=channel,
        source_color_space=encoding,
        scale=_four(network, node, "scale", (1.0, 1.0, 1.0, 1.0)),
        bias=_four(network, node, "bias", (0.0, 0.0, 0.0, 0.0)),
        fallback=fallback,
        wrap_s=network.token(node, "wrapS", "useMetadata", _WRAPS),
        wrap_t=network.token(node, "wrapT", "useMetadata", _WRAPS),
        primvar=primvar,
        st_matrix=matrix,
    )


def _constant(values: Four, channel: str, width: int) -> float | Color:
    if channel == "rgb":
        return values[:3]
    value = values["rgba".index(channel)]
    return value if width == 1 else (value, value, value)


def _four(network: Network, node: UsdShade.Shader, name: str, fallback: Four) -> Four:
    source = network.source(node, name)
    if source is None or is_node_output(source):
        return fallback
    red, green, blue, alpha = network.numbers(source, 4)
    return red, green, blue, alpha


def _file(network: Network, node: UsdShade.Shader) -> tuple[str | None, str]:
    """Return a texture's file and how it is encoded."""
    source = network.source(node, "file")
    asset = None if source is None or is_node_output(source) else network.value(source)
    encoding = network.token(node, "sourceColorSpace", "auto", _ENCODINGS)
    if source is None or not isinstance(asset, Sdf.AssetPath) or not asset.path:
        return None, encoding
    named = str(source.GetColorSpace())
    if encoding == "auto" and named:
        if named in _RAW or named in _ENCODINGS:
            encoding = "raw" if named in _RAW else named
        elif Gf.ColorSpace.IsValid(named):
            encoding = named
        else:
            what = f"the color space {named} is not known; taken as auto"
            network.note("color-space-not-supported", node.GetPrim(), what)
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
            found = read_primvar_node(network, node, 2)
            name = found.name if found else "st"
            return name, matrix[:2] if found else _fixed(network, node, None, matrix)
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
    network: Network,
    node: UsdShade.Shader,
    source: Usd.Attribute | None,
    matrix: NDArray[np.float64],
) -> NDArray[np.float64]:
    """Return the map to one texel for all, as UsdUVTexture says of coordinates not connected."""
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


def _resolve(attribute: Usd.Attribute, asset: Sdf.AssetPath) -> str:
    if asset.resolvedPath:
        return str(asset.resolvedPath)
    layer = attribute.GetPropertyStack()[0].layer
    if "<UDIM>" in asset.path:
        tiled = UsdShade.UdimUtils.ResolveUdimPath(asset.path, layer)
        if tiled:
            return str(tiled)
    raise LayerError(
        f"{describe(attribute)}: {attribute.GetName()} names @{asset.path}@, which is not there; "
        "restore it or correct the path"
    )
