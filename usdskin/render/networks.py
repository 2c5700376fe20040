"""UsdShade networks of the preview nodes, followed from a surface's inputs to their sources.

The nodes are those of the UsdPreviewSurface specification 2.6: UsdPreviewSurface, UsdUVTexture,
UsdPrimvarReader and UsdTransform2d.
"""

from __future__ import annotations

import dataclasses
import math

from usdskin.notes import Note
from usdskin.render.connections import Network, is_node_output, shader_name
from usdskin.render.inputs import Color, Input, TextureInput
from usdskin.render.texture_nodes import READERS, read_primvar_node, read_texture_node

# isort: split
# After ours, which register the schemas.
from pxr import Gf, Usd, UsdShade

FALLBACKS: dict[str, float | str | Color] = {
    "diffuseColor": (0.18, 0.18, 0.18),
    "specularColor": (0.0, 0.0, 0.0),
    "emissiveColor": (0.0, 0.0, 0.0),
    "useSpecularWorkflow": 0.0,
    "metallic": 0.0,
    "roughness": 0.5,
    "clearcoat": 0.0,
    "clearcoatRoughness": 0.01,
    "opacity": 1.0,
    "opacityMode": "transparent",
    "opacityThreshold": 0.0,
    "ior": 1.5,
    "normal": (0.0, 0.0, 1.0),
    "displacement": 0.0,
}
"""Fallbacks of UsdPreviewSurface."""


def find_surface(reader: NetworkReader, prim: Usd.Prim) -> UsdShade.Shader | None:
    """Return the UsdPreviewSurface of a Material, or None where it has none."""
    output = UsdShade.Material(prim).GetSurfaceOutput()
    source = reader.follow(output.GetAttr()) if output else None
    shader = UsdShade.Shader(source.GetPrim()) if source and is_node_output(source) else None
    return shader if shader and shader.GetShaderId() == "UsdPreviewSurface" else None


def surface_of(reader: NetworkReader, prim: Usd.Prim) -> UsdShade.Shader | None:
    """Return the UsdPreviewSurface of a Material, or None, with a note, where it has none."""
    material = UsdShade.Material(prim)
    reader.note_outputs(material)
    output = material.GetSurfaceOutput()
    source = reader.follow(output.GetAttr()) if output else None
    shader = UsdShade.Shader(source.GetPrim()) if source and is_node_output(source) else None
    if shader and shader.GetShaderId() == "UsdPreviewSurface":
        return shader
    others = [
        str(item.GetFullName()).removeprefix("outputs:").removesuffix(":surface")
        for item in material.GetSurfaceOutputs()
        if item.GetAttr() != output.GetAttr() and item.HasConnectedSource()
    ]
    if shader:
        what = f"the surface shader {shader_name(shader)} is not known"
    elif others:
        what = f"it has shaders for {', '.join(others)} only, and no UsdPreviewSurface"
    else:
        reader.note("material-without-surface", prim, "no surface; displayColor is shown")
        return None
    reader.note("shader-not-supported", prim, f"{what}; displayColor is shown")
    return None


class NetworkReader(Network):
    """Reads the inputs of UsdPreviewSurfaces at one moment."""

    def __init__(
        self,
        stage: Usd.Stage,
        time: Usd.TimeCode | float,
        notes: list[Note],
        color_space: str = "lin_rec709_scene",
    ) -> None:
        super().__init__(stage, time, notes)
        self.color_space = color_space

    def note_outputs(self, material: UsdShade.Material) -> None:
        """Note what a material has besides a surface."""
        if material.GetVolumeOutput().HasConnectedSource():
            self.note("volume-ignored", material.GetPrim(), "a volume is connected; not shown")

    def note_unshown(self, shader: UsdShade.Shader) -> None:
        """Note inputs of a UsdPreviewSurface that have no effect here."""
        occlusion = self.source(shader, "occlusion")
        if occlusion is not None and (
            is_node_output(occlusion) or self.value(occlusion) not in (None, 1.0)
        ):
            what = "inputs:occlusion is set; no baked occlusion is shown"
            self.note("occlusion-ignored", shader.GetPrim(), what)

    def normal(self, shader: UsdShade.Shader) -> Input | None:
        """Return the normal of a UsdPreviewSurface in tangent space; None where it is (0, 0, 1).

        Raises:
            LayerError: Its value is no vector, or what it comes from cannot be read.
        """
        source = self.source(shader, "normal")
        if source is None:
            return None
        if is_node_output(source):
            node = self._node(shader, "normal", source, 3)
            if isinstance(node, TextureInput):
                return self._raw(node, UsdShade.Shader(source.GetPrim()))
            if node is not None:
                return node
            source = shader.GetInput("normal").GetAttr()
            if not source.HasAuthoredValue():
                return None
        x, y, z = self.numbers(source, 3)
        return None if x == y == 0.0 else (x, y, z)

    def _raw(self, value: TextureInput, node: UsdShade.Shader) -> TextureInput:
        """Return a normal map read as it is: a normal is no color."""
        decoded = value.source_color_space not in ("raw", "auto")
        if decoded or (value.source_color_space == "auto" and not value.file.endswith(".exr")):
            what = f"sourceColorSpace is {value.source_color_space}; a normal map is shown as raw"
            self.note("normal-map-not-raw", node.GetPrim(), what)
        return dataclasses.replace(value, source_color_space="raw")

    def displacement(self, prim: Usd.Prim) -> Input | None:
        """Return the displacement of a Material [stage units]; None, or a note, where it has none.

        It counts where the Material's outputs:displacement is connected to a UsdPreviewSurface.

        Raises:
            LayerError: Its value is no number, or what it comes from cannot be read.
        """
        outputs = UsdShade.Material(prim).GetDisplacementOutputs()
        sources = [self.follow(output.GetAttr()) for output in outputs]
        shaders = [UsdShade.Shader(item.GetPrim()) for item in sources if is_node_output(item)]
        for shader in shaders:
            if shader.GetShaderId() == "UsdPreviewSurface":
                return self._displacement(shader)
        surface = find_surface(self, prim)
        if shaders:
            what = f"a displacement by {shader_name(shaders[0])} is connected"
        elif surface is not None and self._displacement(surface) is not None:
            what = "inputs:displacement is set, but not the Material's outputs:displacement"
        else:
            return None
        self.note("displacement-ignored", prim, f"{what}; the surface stays where it is")
        return None

    def _displacement(self, shader: UsdShade.Shader) -> Input | None:
        source = self.source(shader, "displacement")
        if source is not None and is_node_output(source):
            node = self._node(shader, "displacement", source, 1)
            if node is not None:
                return node
        value = self.constant(shader, "displacement", -math.inf, math.inf)
        return value if value != 0.0 else None

    def color(self, shader: UsdShade.Shader, name: str) -> Input:
        """Return a color input of a UsdPreviewSurface.

        Raises:
            LayerError: Its value is no color, or what it comes from cannot be read.
        """
        fallback = FALLBACKS[name]
        assert isinstance(fallback, tuple)
        source = self.source(shader, name)
        if source is None:
            return fallback
        if is_node_output(source):
            node = self._node(shader, name, source, 3)
            if node is not None:
                return node
            source = shader.GetInput(name).GetAttr()
            if not source.HasAuthoredValue():
                return fallback
        values = self.numbers(source, 3)
        if min(values) < 0.0:
            what = f"{name} is {values}; negative parts are shown as 0"
            self.note("value-out-of-range", shader.GetPrim(), what)
        red, green, blue = (max(value, 0.0) for value in values)
        return self._converted(source, (red, green, blue))

    def _converted(self, attribute: Usd.Attribute, color: Color) -> Color:
        """Return a constant in the rendering space; without a word on it, it is linear Rec.709."""
        name = str(Usd.ColorSpaceAPI.ComputeColorSpaceName(attribute, None))
        if name in ("", "identity", "unknown", "raw", "data"):
            name = "lin_rec709_scene" if name == "" else self.color_space
        if name == self.color_space or not any(color):
            return color
        if not Gf.ColorSpace.IsValid(name):
            what = f"the color space {name} is not known; taken as linear Rec.709"
            self.note("color-space-not-supported", attribute, what)
            name = "lin_rec709_scene"
        source, target = Gf.ColorSpace(name), Gf.ColorSpace(self.color_space)
        red, green, blue = target.Convert(source, Gf.Vec3f(*color)).GetRGB()
        return float(red), float(green), float(blue)

    def share(self, shader: UsdShade.Shader, name: str) -> Input:
        """Return an input that runs from 0 to 1; constants beyond are cut off, with a note.

        Raises:
            LayerError: Its value is no number, or what it comes from cannot be read.
        """
        source = self.source(shader, name)
        if source is not None and is_node_output(source):
            node = self._node(shader, name, source, 1)
            if node is not None:
                return node
        return self.constant(shader, name, 0.0, 1.0)

    def constant(self, shader: UsdShade.Shader, name: str, low: float, high: float) -> float:
        """Return an input that cannot vary here; one that is connected to a shader is noted."""
        fallback = FALLBACKS[name]
        assert isinstance(fallback, float)
        source = self.source(shader, name)
        if source is not None and is_node_output(source):
            source = shader.GetInput(name).GetAttr()
            if name in ("ior", "opacityThreshold", "useSpecularWorkflow"):
                what = f"inputs:{name} is connected to a shader; its own value is shown"
                self.note("connection-ignored", shader.GetPrim(), what)
            source = source if source.HasAuthoredValue() else None
        if source is None:
            return fallback
        (value,) = self.numbers(source, 1)
        if not low <= value <= high:
            what = f"{name} is {value:g}; shown as {min(max(value, low), high):g}"
            self.note("value-out-of-range", shader.GetPrim(), what)
        return min(max(value, low), high)

    def whole(self, shader: UsdShade.Shader, name: str) -> int:
        """Return an input that is a whole number or a switch."""
        return int(self.constant(shader, name, 0.0, 1.0))

    def _node(
        self, shader: UsdShade.Shader, name: str, source: Usd.Attribute, width: int
    ) -> Input | None:
        """Return the texture or primvar an input is connected to; None, with a note, for others."""
        node = UsdShade.Shader(source.GetPrim())
        identifier = node.GetShaderId()
        if identifier == "UsdUVTexture":
            return read_texture_node(self, node, source, width)
        if READERS.get(identifier, 0) in (1, width, width + 1):
            return read_primvar_node(self, node, width)
        what = f"inputs:{name} comes from a shader {shader_name(node)}; its own value is shown"
        self.note("shader-not-supported", shader.GetPrim(), what)
        return None
