"""Materials as the kernels evaluate them: weights of light channels, and the spectra those have.

Reads: materials with their wavelengths, and the spectra of the light's channels. Makes: the
``Materials`` struct. Every product of a reflectance and a light channel is one row of spectra,
so the kernels add up scalars and the wavelengths appear once per pixel (DESIGN section 2, exact
factorisation).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np
import warp as wp
from numpy.typing import NDArray

from usdskin.colorimetry import illuminant, xyz_to_rgb, xyz_weights
from usdskin.errors import LayerError
from usdskin.render.materials import (
    Input,
    PrimvarInput,
    SkinMaterial,
    SurfaceMaterial,
    TextureInput,
)
from usdskin.render.textures import Texture, pack_textures, read_texture
from usdskin.spectrum import Spectrum
from usdskin.uplift import light_basis, reflectance_basis
from usdskin.warp_kernels import structs

FloatArray = NDArray[np.float64]

THICKNESS_NODES = 24
"""The most interpolation nodes of exp(-s delta) over the body's thickness."""

THICKNESS_TOLERANCE = 1.0e-6

_SKIN, _PREVIEW, _DOME = 1, 0, 2
_SPECULAR_WORKFLOW, _PRESENCE, _GLOSSY, _TINTED, _EMISSIVE, _CLEARCOAT = 1, 2, 4, 8, 16, 32


@dataclass(frozen=True, slots=True, eq=False)
class SpectralFrame:
    """What spectra are sampled on and looked at with."""

    wavelength_nm: FloatArray
    """Band centres [nm], shape [bands]."""

    observer: str
    absolute: bool
    """Whether the lights are in W m^-2 sr^-1 nm^-1."""

    color_space: str
    """The rendering space, which RGB inputs are in."""


@dataclass(slots=True, eq=False)
class _Row:
    """One material under construction."""

    kind: int
    bases: FloatArray
    """Reflectances the base weights multiply, shape [base_count, bands]."""
    rows: list[FloatArray] = field(default_factory=list)
    """Spectra of four channels each, shape [4, bands]."""
    wrap: float = 0.0
    flags: int = 0
    nodes: FloatArray = field(default_factory=lambda: np.zeros(0))
    constant: FloatArray = field(default_factory=lambda: np.zeros((structs.INPUT_COUNT, 4)))
    inputs: dict[int, Input] = field(default_factory=dict)


@dataclass(frozen=True, slots=True, eq=False)
class Surfaces:
    """The materials of a stage on the device, and what they ask of the light and the meshes."""

    device_materials: structs.Materials
    max_rows: int
    """Most rows of a material: the size of a pixel's scratch."""

    albedo: tuple[FloatArray, ...]
    """RGB under D65 of each material's base weights, shape [base_count, 3] each."""


def wraps_of(materials: Sequence[SkinMaterial | SurfaceMaterial]) -> tuple[float, ...]:
    """Return the distinct wraps l of the skin materials, ascending; 0 where there are none."""
    found = {_wrap(material) for material in materials if isinstance(material, SkinMaterial)}
    return tuple(sorted(found)) or (0.0,)


def _wrap(skin: SkinMaterial) -> float:
    return float(np.float32(skin.parameters.wrap))


def gloss_alphas(
    materials: Sequence[SkinMaterial | SurfaceMaterial], ladder: tuple[float, ...]
) -> tuple[float, ...]:
    """Return the GGX alphas to prefilter, ascending: those in use, or the ladder where it varies."""
    found: set[float] = set()
    for material in materials:
        if isinstance(material, SkinMaterial):
            skin = material.parameters
            if skin.specular_weight > 0.0:
                found |= {skin.roughness1**2, skin.roughness2**2}
        elif material.reflective:
            for value in (material.roughness, material.clearcoat_roughness):
                if isinstance(value, TextureInput | PrimvarInput):
                    return ladder
            found.add(float(material.roughness) ** 2)  # type: ignore[arg-type]
            if material.clearcoat != 0.0:
                found.add(float(material.clearcoat_roughness) ** 2)  # type: ignore[arg-type]
    return tuple(sorted(round(float(alpha), 6) for alpha in found))


def build_surfaces(
    materials: Sequence[SkinMaterial | SurfaceMaterial],
    light_spectra: FloatArray,
    frame: SpectralFrame,
    wraps: tuple[float, ...],
    primvars: dict[str, int],
    thickness_range: dict[str, float],
    device: str,
) -> Surfaces:
    """Build the kernels' material tables.

    Args:
        materials: In the order the triangles' material indices count.
        light_spectra: Spectrum of every light channel, shape [groups, 4, bands].
        frame: Wavelengths, observer and units.
        wraps: Values of l that light maps exist for (``wraps_of``).
        primvars: Row of each primvar in the scene's corner values.
        thickness_range: Largest thickness [m] that a primvar gives to a material, by its path.
        device: Warp device.

    Raises:
        LayerError: A material cannot be evaluated; the message names it.
    """
    rows = [
        _skin_row(material, light_spectra, frame, thickness_range)
        if isinstance(material, SkinMaterial)
        else _preview_row(material, light_spectra, frame)
        for material in materials
    ]
    dome = _Row(_DOME, np.ones((1, len(frame.wavelength_nm))))
    dome.rows = list(light_spectra)
    rows.append(dome)
    return _upload(rows, frame, wraps, primvars, device)


def _skin_row(
    material: SkinMaterial,
    light: FloatArray,
    frame: SpectralFrame,
    thickness_range: dict[str, float],
) -> _Row:
    """Return S (J1 + Ss (J2front + exp(-s delta) J2back)) alpha / pi, and the lustre above it."""
    skin = material.parameters
    nm = frame.wavelength_nm
    row = _Row(_SKIN, _skin_bases(material, frame), wrap=_wrap(material))
    if len(row.bases) > 1:
        row.inputs[structs.INPUT_BASE] = material.albedo or material.weights  # type: ignore[assignment]
        if material.weights is not None and len(row.bases) > 4:
            row.inputs[structs.INPUT_BASE_HIGH] = material.weights_high  # type: ignore[assignment]
    scattering = _values(skin.scattering, nm, 0.0)
    if skin.wrap_normalization == "energy":
        scattering = scattering / (1.0 + skin.wrap)
    opacity = _values(skin.opacity, nm, 0.0)
    passes = [row.bases, row.bases * scattering]
    if opacity.max(initial=0.0) > 0.0:
        row.nodes = _thickness_nodes(material, opacity, thickness_range)
        passes += [row.bases * scattering * np.exp(-node * opacity) for node in row.nodes]
    for reflectances in passes:
        for spectrum in skin.alpha / np.pi * reflectances:
            row.rows += list(light * spectrum)
    row.constant[structs.INPUT_BASE, 0] = 1.0
    row.constant[structs.INPUT_OPACITY, 0] = 1.0
    row.constant[structs.INPUT_THICKNESS] = skin.thickness
    if material.thickness_primvar is not None:
        row.inputs[structs.INPUT_THICKNESS] = PrimvarInput(
            material.thickness_primvar, (skin.thickness,)
        )
    if skin.specular_weight > 0.0:
        row.flags |= _GLOSSY
        row.constant[structs.INPUT_SPECULAR, 0] = skin.f0
        row.constant[structs.INPUT_LOBES] = (
            skin.specular_weight, skin.roughness1**2, skin.roughness2**2, skin.mix,
        )  # fmt: skip
        row.rows += list(light)
    return row


def _skin_bases(material: SkinMaterial, frame: SpectralFrame) -> FloatArray:
    """Return S, or the reflectances that a texture weighs."""
    skin = material.parameters
    if material.albedo is not None:
        return reflectance_basis(frame.wavelength_nm, frame.color_space, frame.observer)  # type: ignore[arg-type]
    if material.weights is not None:
        if skin.weights_basis is None or skin.weights_wavelength_nm is None:
            raise LayerError(
                f"<{material.path}>: inputs:skin:weights:file has no inputs:skin:weights:basis; "
                "author the spectra the weights multiply."
            )
        if len(skin.weights_basis) > 8:
            raise LayerError(
                f"<{material.path}>: inputs:skin:weights:basis has {len(skin.weights_basis)} "
                "spectra; 8 are the most."
            )
        from usdskin.spectrum import resample

        return resample(
            skin.weights_wavelength_nm, skin.weights_basis, frame.wavelength_nm, outside="hold"
        )
    return _values(skin.reflectance, frame.wavelength_nm, 1.0)[None]


def _values(spectrum: Spectrum | float | None, nm: FloatArray, fallback: float) -> FloatArray:
    if spectrum is None:
        return np.full(len(nm), fallback)
    if isinstance(spectrum, Spectrum):
        return spectrum.resample(nm)
    return np.full(len(nm), float(spectrum))


def _thickness_nodes(
    material: SkinMaterial, opacity: FloatArray, thickness_range: dict[str, float]
) -> FloatArray:
    """Return Chebyshev nodes at which exp(-s delta) interpolates to the tolerance."""
    skin = material.parameters
    largest = max(thickness_range.get(material.path, 0.0), 0.0)
    if material.thickness_primvar is None or largest <= 0.0:
        return np.array([skin.thickness])
    test = np.linspace(0.0, largest, 257)
    extremes = np.array([opacity.min(), np.median(opacity), opacity.max()])
    exact = np.exp(-test[:, None] * extremes)
    for count in range(2, THICKNESS_NODES + 1):
        nodes = 0.5 * largest * (1.0 - np.cos(np.pi * (np.arange(count) + 0.5) / count))
        nodes = np.concatenate([[0.0], nodes[1:]])
        found = _lagrange(nodes, test) @ np.exp(-nodes[:, None] * extremes)
        if np.abs(found - exact).max() < THICKNESS_TOLERANCE:
            break
    return nodes


def _lagrange(nodes: FloatArray, at: FloatArray) -> FloatArray:
    weights = np.ones((len(at), len(nodes)))
    for k, node in enumerate(nodes):
        for j, other in enumerate(nodes):
            if j != k:
                weights[:, k] *= (at - other) / (node - other)
    return weights


def _preview_row(material: SurfaceMaterial, light: FloatArray, frame: SpectralFrame) -> _Row:
    nm = frame.wavelength_nm
    rgb = reflectance_basis(nm, frame.color_space, frame.observer)  # type: ignore[arg-type]
    row = _Row(_PREVIEW, rgb)
    base = material.diffuse_color
    if material.reflectance is not None:
        row.bases = material.reflectance.resample(nm)[None]
        row.constant[structs.INPUT_BASE, 0] = 1.0
    elif isinstance(base, TextureInput | PrimvarInput):
        row.inputs[structs.INPUT_BASE] = base
    else:
        row.bases = (np.asarray(base, float)[:3] @ rgb)[None]
        row.constant[structs.INPUT_BASE, 0] = 1.0
    row.flags |= _SPECULAR_WORKFLOW * material.use_specular_workflow
    row.flags |= _PRESENCE * (material.opacity_mode == "presence")
    for spectrum in row.bases / np.pi:
        row.rows += list(light * spectrum)
    if material.reflective:
        row.flags |= _GLOSSY
        row.rows += list(light)
        tinted = material.use_specular_workflow or material.metallic != 0.0
        if tinted:
            row.flags |= _TINTED
            for spectrum in rgb if material.use_specular_workflow else row.bases:
                row.rows += list(light * spectrum)
        if material.clearcoat != 0.0:
            row.flags |= _CLEARCOAT
    emission = material.emissive_color
    if not isinstance(emission, tuple) or any(value != 0.0 for value in emission):
        row.flags |= _EMISSIVE
        row.rows.append(_emission_rows(frame))
    values: dict[int, Input] = {
        structs.INPUT_METALLIC: material.metallic,
        structs.INPUT_ROUGHNESS: material.roughness,
        structs.INPUT_CLEARCOAT: material.clearcoat,
        structs.INPUT_CLEARCOAT_ROUGHNESS: material.clearcoat_roughness,
        structs.INPUT_OPACITY: material.opacity,
        structs.INPUT_EMISSION: emission,
        structs.INPUT_SPECULAR: material.specular_color
        if material.use_specular_workflow
        else ((material.ior - 1.0) / (material.ior + 1.0)) ** 2,
    }
    for which, value in values.items():
        if isinstance(value, TextureInput | PrimvarInput):
            row.inputs[which] = value
        elif isinstance(value, tuple):
            row.constant[which, : len(value)] = value
        else:
            row.constant[which] = value
    row.constant[structs.INPUT_OPACITY, 1] = material.opacity_threshold
    return row


def _emission_rows(frame: SpectralFrame) -> FloatArray:
    """Return the spectra of emitted RGB, 1 nit (or relative unit) of the space's white at 1."""
    nm = frame.wavelength_nm
    spectra = light_basis(illuminant("D65", nm), nm, frame.color_space, frame.observer)  # type: ignore[arg-type]
    weights = xyz_weights(nm, frame.observer, frame.absolute)  # type: ignore[arg-type]
    relative = xyz_weights(nm, frame.observer, False)  # type: ignore[arg-type]
    scale = relative[:, 1].sum() / weights[:, 1].sum()
    return np.concatenate([spectra * scale, np.zeros((1, len(nm)))])


@dataclass(slots=True, eq=False)
class _Slots:
    """Texture and primvar slots, and the textures they share."""

    primvars: dict[str, int]
    textures: list[Texture] = field(default_factory=list)
    known: dict[tuple[object, ...], int] = field(default_factory=dict)
    texture: list[int] = field(default_factory=list)
    primvar: list[int] = field(default_factory=list)
    channel: list[int] = field(default_factory=list)
    matrix: list[NDArray[np.float64]] = field(default_factory=list)

    def add(self, value: TextureInput | PrimvarInput) -> int:
        if isinstance(value, PrimvarInput):
            self._append(-1, self.primvars[value.name], -1, np.eye(2, 3))
        else:
            channel = {"rgb": -1, "rgba": -1, "r": 0, "g": 1, "b": 2, "a": 3}[value.channel]
            primvar = self.primvars[value.primvar]
            self._append(self._texture(value), primvar, channel, np.asarray(value.st_matrix))
        return len(self.texture) - 1

    def _append(self, texture: int, primvar: int, channel: int, matrix: FloatArray) -> None:
        self.texture.append(texture)
        self.primvar.append(primvar)
        self.channel.append(channel)
        self.matrix.append(matrix)

    def _texture(self, value: TextureInput) -> int:
        key = value.texture_key()
        if key not in self.known:
            self.known[key] = len(self.textures)
            self.textures.append(
                read_texture(
                    value.file,
                    value.source_color_space,
                    scale=value.scale,
                    bias=value.bias,
                    wrap_s=value.wrap_s,
                    wrap_t=value.wrap_t,
                )
            )
        return self.known[key]


def _upload(
    rows: list[_Row],
    frame: SpectralFrame,
    wraps: tuple[float, ...],
    primvars: dict[str, int],
    device: str,
) -> Surfaces:
    target = structs.Materials()
    slots = _Slots(primvars)
    slot = np.full((len(rows), structs.INPUT_COUNT), -1, np.int32)
    for m, row in enumerate(rows):
        for which, value in row.inputs.items():
            slot[m, which] = slots.add(value)  # type: ignore[arg-type]
    counts = np.array([len(row.rows) for row in rows], np.int32)
    spectra = np.concatenate([np.stack(row.rows) for row in rows]).transpose(0, 2, 1)
    weights = xyz_weights(frame.wavelength_nm, frame.observer, frame.absolute)  # type: ignore[arg-type]
    xyz = np.einsum("rbc,bx->xrc", spectra, weights)
    nodes = np.zeros((len(rows), max(1, *(len(row.nodes) for row in rows))))
    for m, row in enumerate(rows):
        nodes[m, : len(row.nodes)] = row.nodes

    def ints(values: object) -> wp.array:
        return wp.array(np.asarray(values, np.int32), dtype=wp.int32, device=device)

    def floats(values: NDArray, dtype: type) -> wp.array:
        return wp.array(np.ascontiguousarray(values, np.float32), dtype=dtype, device=device)

    target.kind = ints([row.kind for row in rows])
    target.row = ints(np.cumsum(counts) - counts)
    target.row_count = ints(counts)
    target.weight_count = ints([len(row.bases) for row in rows])
    target.wrap_set = ints([wraps.index(row.wrap) if row.wrap in wraps else 0 for row in rows])
    target.thickness_nodes = floats(nodes, wp.float32)
    target.thickness_count = ints([len(row.nodes) for row in rows])
    target.flags = ints([row.flags for row in rows])
    target.constant = floats(np.stack([row.constant for row in rows]), wp.vec4f)
    target.slot = ints(slot)
    target.slot_texture, target.slot_primvar = ints(slots.texture), ints(slots.primvar)
    target.slot_channel = ints(slots.channel)
    matrices = np.array(slots.matrix).reshape(-1, 2, 3)
    target.slot_matrix_u = floats(matrices[:, 0], wp.vec3f)
    target.slot_matrix_v = floats(matrices[:, 1], wp.vec3f)
    packed = pack_textures(slots.textures)
    target.texel = floats(packed.texels, wp.vec4f)
    target.texture_level = wp.array(packed.levels, dtype=wp.vec3i, device=device)
    target.texture_info = wp.array(packed.info, dtype=wp.vec3i, device=device)
    target.band = floats(spectra, wp.vec4f)
    target.xyz_x, target.xyz_y, target.xyz_z = (floats(part, wp.vec4f) for part in xyz)
    white = illuminant("D65", frame.wavelength_nm)
    to_rgb = xyz_weights(frame.wavelength_nm, frame.observer, False) @ xyz_to_rgb(frame.color_space).T  # type: ignore[arg-type]
    to_rgb = white[:, None] * to_rgb / (white @ to_rgb).mean()
    return Surfaces(target, int(counts.max()), tuple(row.bases @ to_rgb for row in rows))
