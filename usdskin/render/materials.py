"""Materials of a stage as plain values: skin, and ``UsdPreviewSurface``.

Reads:  Material prims with ``SkinMaterialAPI`` or a ``UsdPreviewSurface`` network
        (``usdskin.render.networks``).
Makes:  ``SkinMaterial`` and ``SurfaceMaterial``, whose inputs are constants, textures or primvars.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Iterable
from dataclasses import dataclass
from pathlib import Path

from usdskin.errors import LayerError
from usdskin.layers import describe
from usdskin.notes import Note
from usdskin.prims import SkinParameters, check_applied_schemas, read_skin, read_spectrum
from usdskin.render.bindings import binding_notes, bound_material
from usdskin.render.inputs import Color, Input, PrimvarInput, TextureInput
from usdskin.render.networks import FALLBACKS, NetworkReader, find_surface, surface_of
from usdskin.spectrum import SpectralQuantity, Spectrum

# isort: split
# After ours, which register the schemas.
from pxr import Usd, UsdGeom, UsdShade

__all__ = [
    "Color",
    "Displacement",
    "Input",
    "PrimvarInput",
    "SkinMaterial",
    "SurfaceMaterial",
    "TextureInput",
    "binding_notes",
    "bound_material",
    "display_material",
    "read_materials",
    "required_primvars",
]

THICKNESS_PRIMVAR = "skin:thickness"
"""Primvar that wins over ``inputs:skin:thickness`` [m]."""

WEIGHTS_LIMIT = 8
"""Most spectra that weights may multiply."""

DISPLAY_COLOR = (0.18, 0.18, 0.18)
"""Grey of geometry without displayColor, the fallback of ``UsdPreviewSurface.diffuseColor``."""


@dataclass(frozen=True, slots=True, eq=False)
class Displacement:
    """How far vertices move along their normal."""

    amount: Input
    """Way, in ``unit``."""

    unit: float
    """What 1 stands for [m]."""


@dataclass(frozen=True, slots=True, eq=False)
class SurfaceMaterial:
    """A ``UsdPreviewSurface``; colors are linear, in the rendering space [1]."""

    path: str
    """Prim path; empty for ``display_material``."""

    use_specular_workflow: bool = False
    """Whether ``specular_color`` counts, or ``metallic`` and ``ior``."""

    diffuse_color: Input = DISPLAY_COLOR
    """Diffuse reflectance, or albedo where metallic [1]."""

    specular_color: Input = (0.0, 0.0, 0.0)
    """Reflectance at normal incidence, specular workflow only [1]."""

    emissive_color: Input = (0.0, 0.0, 0.0)
    """Emitted light; 1 is 1 nit, or the relative unit."""

    metallic: Input = 0.0
    """0..1 [1]."""

    roughness: Input = 0.5
    """GGX roughness before squaring, 0..1 [1]."""

    clearcoat: Input = 0.0
    """Amount of the second, white lobe, 0..1 [1]."""

    clearcoat_roughness: Input = 0.01
    """Its roughness before squaring, 0..1 [1]."""

    opacity: Input = 1.0
    """0..1 [1]."""

    opacity_mode: str = "transparent"
    """``transparent``: opacity scales the diffuse part; ``presence``: all of it."""

    opacity_threshold: float = 0.0
    """Where above 0: points below it are cut out, the others fully opaque [1]."""

    ior: float = 1.5
    """Index of refraction [1]."""

    normal: Input | None = None
    """Normal in tangent space [1]; None for that of the geometry."""

    displacement: Displacement | None = None
    """None where the surface stays where it is."""

    reflectance: Spectrum | None = None
    """Spectral reflectance that takes the place of ``diffuse_color`` [1]."""

    reflective: bool = True
    """False for what has no specular reflection at all: displayColor."""

    def inputs(self) -> tuple[Input, ...]:
        """Return all inputs that may vary over the surface."""
        return (
            self.diffuse_color,
            self.specular_color,
            self.emissive_color,
            self.metallic,
            self.roughness,
            self.clearcoat,
            self.clearcoat_roughness,
            self.opacity,
            *_shape_inputs(self.normal, self.displacement),
        )


@dataclass(frozen=True, slots=True, eq=False)
class SkinMaterial:
    """A Material with ``SkinMaterialAPI``, whatever other shaders it has."""

    path: str
    """Prim path."""

    parameters: SkinParameters
    """What the prim says."""

    albedo: TextureInput | None = None
    """RGB texture of S."""

    weights: TextureInput | None = None
    """Texture of the first four weights of ``parameters.weights_basis``."""

    weights_high: TextureInput | None = None
    """Texture of the weights from the fifth to the eighth, where the basis has so many."""

    normal: Input | None = None
    """Normal in tangent space [1]; None for that of the geometry."""

    bump: TextureInput | None = None
    """Height above the surface [``parameters.bump_depth``]."""

    displacement: Displacement | None = None
    """None where the surface stays where it is."""

    lustre: TextureInput | None = None
    """Texture of ``parameters.specular_weight``."""

    lustre_roughness: TextureInput | None = None
    """Texture of ``parameters.roughness1``."""

    thickness_primvar: str | None = None
    """Primvar that wins over ``parameters.thickness``; None where the thickness has no effect."""

    @property
    def is_lustrous(self) -> bool:
        """Whether there is a specular reflection anywhere."""
        return self.lustre is not None or self.parameters.specular_weight > 0.0

    def inputs(self) -> tuple[Input, ...]:
        """Return all inputs that may vary over the surface."""
        textures = (
            self.albedo, self.weights, self.weights_high, self.bump, self.lustre,
            self.lustre_roughness,
        )  # fmt: skip
        found: list[Input] = [item for item in textures if item is not None]
        found += _shape_inputs(self.normal, self.displacement)
        if self.thickness_primvar is not None:
            found.append(PrimvarInput(self.thickness_primvar, (self.parameters.thickness,)))
        return tuple(found)


def _shape_inputs(normal: Input | None, displacement: Displacement | None) -> list[Input]:
    found = [] if normal is None else [normal]
    return found if displacement is None else [*found, displacement.amount]


def display_material() -> SurfaceMaterial:
    """Return what shows geometry without a material: displayColor and displayOpacity, matte."""
    return SurfaceMaterial(
        path="",
        diffuse_color=PrimvarInput("displayColor", DISPLAY_COLOR),
        opacity=PrimvarInput("displayOpacity", (1.0,)),
        reflective=False,
    )


def required_primvars(materials: Iterable[SkinMaterial | SurfaceMaterial]) -> frozenset[str]:
    """Return the names of the primvars that materials read."""
    names = set()
    for material in materials:
        for value in material.inputs():
            if isinstance(value, TextureInput):
                names.add(value.primvar)
            elif isinstance(value, PrimvarInput):
                names.add(value.name)
    return frozenset(names)


def read_materials(
    stage: Usd.Stage,
    paths: Iterable[str],
    time: Usd.TimeCode | float,
    notes: list[Note],
    color_space: str = "lin_rec709_scene",
) -> dict[str, SurfaceMaterial | SkinMaterial]:
    """Read materials at one moment.

    Args:
        stage: The stage.
        paths: Prim paths of Materials, as ``bound_material`` gives them.
        time: When.
        notes: Takes what a material says and the picture does not show.
        color_space: The rendering space, which constant colors are converted to.

    Returns:
        Materials by path, in the order of ``paths``. One that cannot be shown is
        ``display_material`` under its own path, with a note.

    Raises:
        LayerError: A value cannot be used, a texture is missing, or connections form a loop.
    """
    reader = NetworkReader(stage, time, notes, color_space)
    return {path: _read_material(stage, str(path), time, reader, notes) for path in paths}


def _read_material(
    stage: Usd.Stage,
    path: str,
    time: Usd.TimeCode | float,
    reader: NetworkReader,
    notes: list[Note],
) -> SurfaceMaterial | SkinMaterial:
    prim = stage.GetPrimAtPath(path)
    if not prim or not prim.IsA(UsdShade.Material):
        raise LayerError(
            f"{stage.GetRootLayer().GetDisplayName()} <{path}>: is no Material; bind another"
        )
    check_applied_schemas(prim)
    if prim.HasAPI("SkinMaterialAPI"):
        return _read_skin_material(prim, time, reader, notes)
    surface = surface_of(reader, prim)
    if surface is None:
        return dataclasses.replace(display_material(), path=path)
    reflectance = read_spectrum(prim, "reflectance", time, (SpectralQuantity.REFLECTANCE,))
    return _read_surface(prim, surface, reader, reflectance)


def _read_surface(
    prim: Usd.Prim, surface: UsdShade.Shader, reader: NetworkReader, reflectance: Spectrum | None
) -> SurfaceMaterial:
    reader.note_unshown(surface)
    return SurfaceMaterial(
        path=str(prim.GetPath()),
        use_specular_workflow=reader.whole(surface, "useSpecularWorkflow") != 0,
        diffuse_color=reader.color(surface, "diffuseColor"),
        specular_color=reader.color(surface, "specularColor"),
        emissive_color=reader.color(surface, "emissiveColor"),
        metallic=reader.share(surface, "metallic"),
        roughness=reader.share(surface, "roughness"),
        clearcoat=reader.share(surface, "clearcoat"),
        clearcoat_roughness=reader.share(surface, "clearcoatRoughness"),
        opacity=reader.share(surface, "opacity"),
        opacity_mode=reader.token(
            surface, "opacityMode", str(FALLBACKS["opacityMode"]), ("transparent", "presence")
        ),
        opacity_threshold=reader.constant(surface, "opacityThreshold", 0.0, 1.0),
        ior=reader.constant(surface, "ior", 0.0, 100.0),
        normal=reader.normal(surface),
        displacement=_preview_displacement(prim, reader),
        reflectance=reflectance,
    )


def _preview_displacement(prim: Usd.Prim, reader: NetworkReader) -> Displacement | None:
    """Return the displacement of a Material's UsdPreviewSurface, which is in the stage's units."""
    amount = reader.displacement(prim)
    unit = UsdGeom.GetStageMetersPerUnit(prim.GetStage())
    return None if amount is None else Displacement(amount, unit)


def _read_skin_material(
    prim: Usd.Prim, time: Usd.TimeCode | float, reader: NetworkReader, notes: list[Note]
) -> SkinMaterial:
    parameters = read_skin(prim, time)
    path = str(prim.GetPath())
    for attribute in prim.GetAuthoredAttributes():
        if attribute.GetName().startswith("inputs:skin:") and attribute.HasAuthoredConnections():
            what = f"{attribute.GetName()} is connected; its own value is shown"
            notes.append(Note("connection-ignored", path, what))
    albedo = None
    if parameters.albedo_file is not None and parameters.weights_file is not None:
        raise LayerError(
            f"{describe(prim)}: has both inputs:skin:albedo:file and inputs:skin:weights:file; "
            "remove one of them"
        )
    if parameters.albedo_file is not None:
        encoding = parameters.albedo_color_space
        albedo = _skin_texture(parameters, parameters.albedo_file, "rgb", encoding=encoding)
    weights, high = _weights(prim, parameters)
    # Without opacity light from behind passes unweakened, however long its way.
    opaque = isinstance(parameters.opacity, Spectrum) or parameters.opacity > 0.0
    thickness = THICKNESS_PRIMVAR if opaque else None
    return SkinMaterial(
        path,
        parameters,
        albedo,
        weights,
        high,
        _skin_normal(prim, parameters, reader),
        _skin_texture(parameters, parameters.bump_file) if parameters.bump_depth else None,
        _skin_displacement(prim, parameters, reader),
        _skin_texture(parameters, parameters.specular_weight_file),
        _skin_texture(parameters, parameters.specular_roughness_file),
        thickness,
    )


def _skin_texture(
    skin: SkinParameters,
    file: Path | None,
    channel: str = "r",
    scale: float = 1.0,
    bias: float = 0.0,
    encoding: str = "raw",
) -> TextureInput | None:
    """Return a texture of a skin at its own coordinates; None where there is no file."""
    if file is None:
        return None
    return TextureInput(
        str(file),
        channel,
        encoding,
        scale=(scale, scale, scale, 1.0),
        bias=(bias, bias, bias, 0.0),
        wrap_s="repeat",
        wrap_t="repeat",
        primvar=skin.texcoord,
    )


def _skin_normal(prim: Usd.Prim, skin: SkinParameters, reader: NetworkReader) -> Input | None:
    """Return the normal map of a skin, else that of the UsdPreviewSurface beside it."""
    if skin.normal_file is not None:
        return _skin_texture(skin, skin.normal_file, "rgb", scale=2.0, bias=-1.0)
    surface = find_surface(reader, prim)
    return None if surface is None else reader.normal(surface)


def _skin_displacement(
    prim: Usd.Prim, skin: SkinParameters, reader: NetworkReader
) -> Displacement | None:
    """Return the displacement of a skin, else that of the UsdPreviewSurface beside it."""
    if skin.displacement_file is None:
        return _preview_displacement(prim, reader)
    amount = _skin_texture(skin, skin.displacement_file, bias=-skin.displacement_mid_level)
    assert amount is not None
    return Displacement(amount, skin.displacement_scale)


def _weights(
    prim: Usd.Prim, parameters: SkinParameters
) -> tuple[TextureInput | None, TextureInput | None]:
    """Return the textures of the first four weights, and of the rest."""
    if parameters.weights_file is None:
        return None, None
    count = 0 if parameters.weights_basis is None else len(parameters.weights_basis)
    if not 1 <= count <= WEIGHTS_LIMIT:
        raise LayerError(
            f"{describe(prim)}: inputs:skin:weights:basis has {count} spectra; give 1 to "
            f"{WEIGHTS_LIMIT} for the weights texture to multiply"
        )
    first, rest = (
        TextureInput(
            str(parameters.weights_file),
            "rgba",
            source_color_space="raw",
            wrap_s="repeat",
            wrap_t="repeat",
            primvar=parameters.texcoord,
            first_channel=channel,
        )
        for channel in (0, 4)
    )
    return first, rest if count > 4 else None
