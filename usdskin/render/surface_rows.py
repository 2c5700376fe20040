"""The spectra of materials: every product of a reflectance and a light channel is one row.

Reads: a material with its wavelengths, and the spectra of the light's channels. Makes:
``MaterialRows``. The kernels add up scalar weights of these rows, and the wavelengths appear once
per pixel (DESIGN section 2, exact factorisation).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from usdskin.colorimetry import Observer, illuminant, xyz_weights
from usdskin.errors import LayerError
from usdskin.render.detail import bump_frame, normal_frame
from usdskin.render.inputs import Input, PrimvarInput, TextureInput
from usdskin.render.materials import SkinMaterial, SurfaceMaterial
from usdskin.render.meshes import Frame
from usdskin.render.passage import Passage, factorised_passage, sampled
from usdskin.spectrum import resample
from usdskin.uplift import light_basis, reflectance_basis
from usdskin.warp_kernels import structs

FloatArray = NDArray[np.float64]

PREVIEW, SKIN, DOME = 0, 1, 2
"""``Materials.kind``."""

SPECULAR_WORKFLOW, PRESENCE, GLOSSY, TINTED, EMISSIVE, CLEARCOAT = 1, 2, 4, 8, 16, 32
RELIEF, LUSTRE_MAPS, PLAIN = 64, 128, 256
"""``Materials.flags``."""


@dataclass(frozen=True, slots=True, eq=False)
class SpectralFrame:
    """What spectra are sampled on and looked at with."""

    wavelength_nm: FloatArray
    """Band centres [nm], shape [bands]."""

    observer: Observer
    absolute: bool
    """Whether the lights are in W m^-2 sr^-1 nm^-1."""

    color_space: str
    """The rendering space, which RGB inputs are in."""


@dataclass(slots=True, eq=False)
class MaterialRows:
    """One material: its rows of spectra, and where the weights of the rows come from."""

    kind: int
    bases: FloatArray
    """Reflectances the base weights multiply, shape [base_count, bands]."""
    rows: list[FloatArray] = field(default_factory=list)
    """Spectra of four channels each, shape [4, bands]."""
    diffuse_count: int = 0
    """How many rows, the first ones, are diffuse."""
    exit_count: int = 0
    """How many of them, the first ones, light other surfaces."""
    indirect_row: int = -1
    """The first row of light from other surfaces, -1 where there is none."""
    receivers: list[FloatArray] = field(default_factory=list)
    """What light from other surfaces is multiplied by, per pass and base, shape [bands] each."""
    wrap: float = 0.0
    flags: int = 0
    passage: Passage | None = None
    constant: FloatArray = field(default_factory=lambda: np.zeros((structs.INPUT_COUNT, 4)))
    inputs: dict[int, TextureInput | PrimvarInput] = field(default_factory=dict)
    frames: dict[int, Frame] = field(default_factory=dict)
    """Frames that maps lie along, by input."""
    weighs: bool = False
    """Whether the base inputs are basis weights, not a color."""


def wraps_of(materials: Sequence[SkinMaterial | SurfaceMaterial]) -> tuple[float, ...]:
    """Return the distinct wraps l of the skin materials, ascending; 0 where there are none."""
    found = {_wrap(material) for material in materials if isinstance(material, SkinMaterial)}
    return tuple(sorted(found)) or (0.0,)


def _wrap(skin: SkinMaterial) -> float:
    return float(np.float32(skin.parameters.wrap))


def gloss_alphas(
    materials: Sequence[SkinMaterial | SurfaceMaterial], ladder: tuple[float, ...]
) -> tuple[float, ...]:
    """Return the GGX alphas to prefilter, ascending: the ladder, cut to what is in use."""
    found: set[float] = set()
    widens = False
    for material in materials:
        widens |= _widens(material)
        if isinstance(material, SkinMaterial):
            skin = material.parameters
            if material.is_lustrous and material.lustre_roughness is not None:
                return ladder
            if material.is_lustrous:
                found |= {skin.roughness1**2, skin.roughness2**2}
        elif material.reflective:
            lobes = [material.roughness]
            if material.clearcoat != 0.0:
                lobes.append(material.clearcoat_roughness)
            for roughness in lobes:
                if not isinstance(roughness, float | int):
                    return ladder
                found.add(float(roughness) ** 2)
    if not found:
        return ()
    # Seen at a slant a lobe is up to twice as narrow (``usdskin.render.lobe_albedo``).
    halves = {0.5 * alpha for alpha in found if alpha > 0.003}
    widest = 1.0 if widens else max(found)
    found |= halves | {alpha for alpha in ladder if min(found | halves) < alpha <= widest}
    return tuple(sorted({round(float(alpha), 6) for alpha in found}))


def _widens(material: SkinMaterial | SurfaceMaterial) -> bool:
    """Return whether relief below the footprint widens a material's reflections."""
    if isinstance(material, SkinMaterial) and material.bump is not None:
        return material.is_lustrous
    lustrous = material.is_lustrous if isinstance(material, SkinMaterial) else material.reflective
    return lustrous and isinstance(material.normal, TextureInput)


def dome_rows(light: FloatArray) -> MaterialRows:
    """Return what the camera sees of the domes: the light's channels themselves."""
    return MaterialRows(DOME, np.ones((1, light.shape[2])), list(light), len(light))


def skin_rows(
    material: SkinMaterial,
    light: FloatArray,
    frame: SpectralFrame,
    thickness_range: dict[str, float],
) -> MaterialRows:
    """Return the rows of eq. (1), each with alpha / pi, and of the lustre above it.

    S J1, S Ss J2, then per term of exp(-s delta) S Ss g_k J2 and S g_k J1: the light that crosses
    the body, which reaches the last of them only where rays measure the way (``traced``).
    """
    skin = material.parameters
    nm = frame.wavelength_nm
    row = MaterialRows(SKIN, _skin_bases(material, frame), wrap=_wrap(material))
    row.weighs = material.weights is not None
    base = material.albedo or material.weights
    if base is not None:
        row.inputs[structs.INPUT_BASE] = base
    if material.weights_high is not None:
        row.inputs[structs.INPUT_BASE_HIGH] = material.weights_high
    scattering = sampled(skin.scattering, nm, 0.0)
    if skin.wrap_normalization == "energy":
        scattering = scattering / (1.0 + skin.wrap)
    opacity = sampled(skin.opacity, nm, 0.0)
    passes = [row.bases, row.bases * scattering]
    if opacity.max(initial=0.0) > 0.0:
        row.passage = factorised_passage(material, opacity, thickness_range)
        passes += [row.bases * scattering * through for through in row.passage.spectra]
        passes += [row.bases * through for through in row.passage.spectra]
    row.receivers = [skin.alpha / np.pi * spectrum for part in passes[:2] for spectrum in part]
    for reflectances in passes:
        for spectrum in skin.alpha / np.pi * reflectances:
            row.rows += list(light * spectrum)
    row.diffuse_count = len(row.rows)
    row.exit_count = 2 * len(row.bases) * len(light)
    row.constant[structs.INPUT_BASE, 0] = 1.0
    row.constant[structs.INPUT_OPACITY, 0] = 1.0
    row.constant[structs.INPUT_THICKNESS] = skin.thickness
    if material.thickness_primvar is not None:
        row.inputs[structs.INPUT_THICKNESS] = PrimvarInput(
            material.thickness_primvar, (skin.thickness,)
        )
    _add_detail(row, material)
    if material.is_lustrous:
        row.flags |= GLOSSY
        if material.lustre is not None or material.lustre_roughness is not None:
            row.flags |= LUSTRE_MAPS
        if material.lustre is not None:
            row.inputs[structs.INPUT_LUSTRE] = material.lustre
        if material.lustre_roughness is not None:
            row.inputs[structs.INPUT_LUSTRE_ROUGHNESS] = material.lustre_roughness
            ratio = skin.roughness2 / skin.roughness1 if skin.roughness1 > 0.0 else 1.0
            row.constant[structs.INPUT_LUSTRE_ROUGHNESS, 0] = ratio
        row.constant[structs.INPUT_SPECULAR, 0] = skin.f0
        row.constant[structs.INPUT_LOBES] = (
            skin.specular_weight, skin.roughness1**2, skin.roughness2**2, skin.mix,
        )  # fmt: skip
        row.rows += list(light)
    return row


def _add_detail(row: MaterialRows, material: SkinMaterial | SurfaceMaterial) -> None:
    """Add the normal and height maps, and what they lie along."""
    normal, frame = material.normal, normal_frame(material)
    if frame is not None:
        row.frames[structs.INPUT_NORMAL] = frame
    if isinstance(normal, TextureInput | PrimvarInput):
        row.inputs[structs.INPUT_NORMAL] = normal
    elif isinstance(normal, tuple):
        row.constant[structs.INPUT_NORMAL, :3] = normal
    frame = bump_frame(material)
    if frame is not None and isinstance(material, SkinMaterial) and material.bump is not None:
        row.frames[structs.INPUT_BUMP] = frame
        row.inputs[structs.INPUT_BUMP] = material.bump
        row.constant[structs.INPUT_BUMP, 0] = material.parameters.bump_depth
    row.flags |= RELIEF * bool(row.frames)


def _skin_bases(material: SkinMaterial, frame: SpectralFrame) -> FloatArray:
    """Return S, or the reflectances that a texture weighs."""
    skin = material.parameters
    if material.albedo is not None:
        return reflectance_basis(frame.wavelength_nm, frame.color_space, frame.observer)
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
        return resample(
            skin.weights_wavelength_nm, skin.weights_basis, frame.wavelength_nm, outside="hold"
        )
    return sampled(skin.reflectance, frame.wavelength_nm, 1.0)[None]


def preview_rows(
    material: SurfaceMaterial, light: FloatArray, frame: SpectralFrame
) -> MaterialRows:
    """Return diffuse / pi, the white and the tinted reflections, and the emission."""
    nm = frame.wavelength_nm
    rgb = reflectance_basis(nm, frame.color_space, frame.observer)
    row = MaterialRows(PREVIEW, rgb)
    base = material.diffuse_color
    if material.reflectance is not None:
        row.bases = material.reflectance.resample(nm)[None]
        row.constant[structs.INPUT_BASE, 0] = 1.0
    elif isinstance(base, TextureInput | PrimvarInput):
        row.inputs[structs.INPUT_BASE] = base
    else:
        row.bases = (np.asarray(base, float)[:3] @ rgb)[None]
        row.constant[structs.INPUT_BASE, 0] = 1.0
    row.flags |= SPECULAR_WORKFLOW * material.use_specular_workflow
    row.flags |= PRESENCE * (material.opacity_mode == "presence")
    row.receivers = list(row.bases / np.pi)
    for spectrum in row.receivers:
        row.rows += list(light * spectrum)
    row.diffuse_count = row.exit_count = len(row.rows)
    if material.reflective:
        row.flags |= GLOSSY
        row.rows += list(light)
        tinted = material.use_specular_workflow or material.metallic != 0.0
        if tinted:
            row.flags |= TINTED
            for spectrum in rgb if material.use_specular_workflow else row.bases:
                row.rows += list(light * spectrum)
        if material.clearcoat != 0.0:
            row.flags |= CLEARCOAT
    emission = material.emissive_color
    if not isinstance(emission, tuple) or any(value != 0.0 for value in emission):
        row.flags |= EMISSIVE
        row.rows.append(_emission_rows(frame))
    _add_detail(row, material)
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
    spectra = light_basis(illuminant("D65", nm), nm, frame.color_space, frame.observer)
    weights = xyz_weights(nm, frame.observer, frame.absolute)
    relative = xyz_weights(nm, frame.observer, False)
    scale = relative[:, 1].sum() / weights[:, 1].sum()
    return np.concatenate([spectra * scale, np.zeros((1, len(nm)))])


def add_indirect_rows(rows: list[MaterialRows]) -> NDArray[np.int32]:
    """Give every surface a row for each way it is lit by another one: pairs of their spectra.

    What a surface sends out are its first rows, and its emission; on another they are multiplied
    by that one's reflectances. These rows come before the emission, which stays the last.

    Args:
        rows: All materials and, last, the dome.

    Returns:
        Where each material's rows begin in the list of all that surfaces send out, and the length
        of that list, shape [material_count + 1].
    """
    sent = [row.rows[: row.exit_count] + row.rows[_emission_begin(row) :] for row in rows[:-1]]
    begins = np.cumsum([0, *(len(each) for each in sent), 0])
    everything = np.array([spectrum for each in sent for spectrum in each])
    for row in rows[:-1]:
        row.indirect_row = _emission_begin(row)
        emission = row.rows[row.indirect_row :]
        row.rows = row.rows[: row.indirect_row]
        for receiver in row.receivers:
            row.rows += list(everything * receiver)
        row.rows += emission
    return np.asarray(begins, np.int32)


def _emission_begin(row: MaterialRows) -> int:
    return len(row.rows) - (1 if row.flags & EMISSIVE else 0)


def row_parts(row: MaterialRows) -> NDArray[np.int32]:
    """Return what each row shows: 0 diffuse, 1 specular, 2 emission, 3 indirect, [row_count]."""
    parts = np.ones(len(row.rows), np.int32)
    parts[: row.diffuse_count] = 0
    if row.indirect_row >= 0:
        parts[row.indirect_row :] = 3
    parts[_emission_begin(row) :] = 2
    if row.kind == DOME:
        parts[:] = 2
    return parts
