"""Lights of UsdLux that have a place: rectangles, disks, spheres and cylinders.

A light has the luminance of its intensity (a white light of intensity 1 and exposure 0 has 1),
whatever its size; ``inputs:normalize`` divides it by its area in the world [m^2] (UsdLux,
LightAPI). A sphere that is treated as a point, or has no radius, keeps the light that the sphere
sends far away: radiant intensity pi R^2 L. A cylinder that is treated as a line, or has no radius,
has 2 R L per length. Both are finite without a radius where the light is normalised.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from pxr import Usd, UsdLux

from usdskin.colorimetry import linear_color_space, linearize, rgb_to_xyz, xyz_to_rgb
from usdskin.errors import ImageError, LayerError, UsdSkinError
from usdskin.images import read_headers, read_image
from usdskin.layers import describe
from usdskin.render.domes import placed, rgb_channels
from usdskin.render.ies import IntensityProfile, read_ies
from usdskin.render.light_files import DEFAULT_COLOR_SPACE, asset_file, map_color_space
from usdskin.render.light_inputs import (
    Context,
    LightPrim,
    check_brightness,
    constant_spectrum,
    light_input,
    number,
    rgb_spectra,
)
from usdskin.render.local_lights import Kind, LocalLight, Shaping
from usdskin.render.texels import mend_values
from usdskin.spectrum import SpectralQuantity
from usdskin.uplift import deepest_dip, reflectance_basis

FloatArray = NDArray[np.float64]

TYPES = (UsdLux.RectLight, UsdLux.DiskLight, UsdLux.SphereLight, UsdLux.CylinderLight)

_TOLERANCE = 1e-4
"""Largest relative difference of scales, and cosine between axes, that is still none."""


@dataclass(frozen=True, slots=True)
class _Shape:
    """Extent of a light, and what its channels' spectra are per nominal radiance."""

    kind: Kind
    half: tuple[float, float]
    """As of ``LocalLight``."""

    factor: float
    """Of a point [m^2], of a line [m], else [1]; normalised, each per square metre."""


def is_local(prim: Usd.Prim) -> bool:
    """Return whether a prim is a light of the kinds read here."""
    return any(prim.IsA(kind) for kind in TYPES)


def read_local(
    light: LightPrim, to_world: FloatArray, meters_per_unit: float, context: Context
) -> LocalLight:
    """Read a light that has a place.

    Args:
        light: The prim and what every light has.
        to_world: Its local-to-world transform in scene units, column vectors, shape [4, 4].
        meters_per_unit: Length of a scene unit [m].
        context: How lights are read.

    Raises:
        LayerError: An opinion cannot be used.
        ImageError: The picture on a rectangle is missing, broken or of the wrong kind.
    """
    axes, scale = _axes(light.prim, to_world)
    shape = _shape(light.prim, scale * meters_per_unit, context)
    if shape.factor == 0.0:
        context.note(
            "light-without-area",
            light.prim,
            "without a radius and not normalised it has no power; set inputs:radius, or "
            "inputs:normalize",
        )
    shaping = _shaping(light.prim, context)
    radiance, texture = _radiance(light, shaping, context)
    radiance = radiance * (shape.factor * light.scale)
    peak = float(np.abs(radiance).max(initial=0.0))
    if texture is not None:
        peak *= max(float(np.abs(texture).max(initial=0.0)), 1.0)
    check_brightness(light, peak)
    return LocalLight(
        path=light.path,
        kind=shape.kind,
        center=np.array(to_world[:3, 3] * meters_per_unit, dtype=np.float64),
        axes=axes,
        half=shape.half,
        radiance=radiance,
        absolute=light.is_absolute,
        shaping=shaping,
        texture=texture,
    )


# --- Shapes ------------------------------------------------------------------------------------


def _axes(prim: Usd.Prim, to_world: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return a light's unit axes in the world as rows, and the scales along them.

    A mirroring transform keeps the side that shines: -z goes where the transform takes it.
    """
    columns = to_world[:3, :3].T.copy()
    if not np.isfinite(to_world).all():
        raise LayerError(f"{describe(prim)}: its transform is not finite; mend its xformOps")
    scale = np.linalg.norm(columns, axis=1)
    flat = scale <= 1e-9 * max(float(scale.max()), 1e-30)
    thin = prim.IsA(UsdLux.RectLight) or prim.IsA(UsdLux.DiskLight)
    if flat[:2].any() or (flat[2] and not thin):
        raise LayerError(
            f"{describe(prim)}: its transform flattens it, so it has no area; mend its xformOps"
        )
    if flat[2]:  # a flat light needs no depth
        columns[2] = np.cross(columns[0], columns[1])
    axes = columns / np.linalg.norm(columns, axis=1, keepdims=True)
    sheared = max(abs(float(axes[a] @ axes[b])) for a, b in ((0, 1), (0, 2), (1, 2)))
    if sheared > _TOLERANCE:
        raise LayerError(
            f"{describe(prim)}: its transform shears it (axes {sheared:.2g} off the right angle, "
            "as a cosine), which no light of UsdLux can be; rotate below the uneven scale"
        )
    x = axes[0]
    y = axes[1] - (axes[1] @ x) * x
    y /= np.linalg.norm(y)
    z = np.cross(x, y)
    return np.stack([x, y, z if z @ axes[2] > 0.0 else -z]), scale


def _shape(prim: Usd.Prim, scale: FloatArray, context: Context) -> _Shape:
    """Return a light's extent after its transform; ``scale`` is in metres per scene unit."""
    normalize = bool(light_input(prim, "normalize", context)[1])
    if prim.IsA(UsdLux.RectLight):
        width = _length(prim, "width", context) * float(scale[0])
        height = _length(prim, "height", context) * float(scale[1])
        return _Shape(
            "rect", (width / 2.0, height / 2.0), 1.0 / (width * height) if normalize else 1.0
        )
    if prim.IsA(UsdLux.DiskLight):
        radius = _length(prim, "radius", context) * _even(prim, scale[:2])
        factor = 1.0 / (math.pi * radius * radius) if normalize else 1.0
        return _Shape("disk", (radius, radius), factor)
    authored = number(prim, "radius", context, minimum=0.0)
    if prim.IsA(UsdLux.SphereLight):
        radius = authored * _even(prim, scale) if authored else 0.0
        area = 4.0 * math.pi * radius * radius
        if authored == 0.0 or _is_treated(prim, "treatAsPoint", context):
            return _Shape("point", (0.0, 0.0), 0.25 if normalize else area / 4.0)
        return _Shape("sphere", (radius, radius), 1.0 / area if normalize else 1.0)
    length = _length(prim, "length", context) * float(scale[0])
    radius = authored * _even(prim, scale[1:]) if authored else 0.0
    area = 2.0 * math.pi * radius * length
    if authored == 0.0 or _is_treated(prim, "treatAsLine", context):
        return _Shape(
            "line", (length / 2.0, 0.0), 1.0 / (math.pi * length) if normalize else 2.0 * radius
        )
    return _Shape("cylinder", (length / 2.0, radius), 1.0 / area if normalize else 1.0)


def _length(prim: Usd.Prim, name: str, context: Context) -> float:
    value = number(prim, name, context, minimum=0.0)
    if value == 0.0:
        raise LayerError(
            f"{describe(prim)}: inputs:{name} is 0, so it has no area; author more than 0"
        )
    return value


def _is_treated(prim: Usd.Prim, name: str, context: Context) -> bool:
    return bool(prim.GetAttribute(name).Get(context.time))


def _even(prim: Usd.Prim, scale: FloatArray) -> float:
    """Return the one scale of a round light."""
    if scale.max() > scale.min() * (1.0 + _TOLERANCE):
        kind = str(prim.GetTypeName())
        raise LayerError(
            f"{describe(prim)}: its transform scales it unevenly "
            f"({', '.join(f'{value / scale.max():.4g}' for value in scale)} of each other), and a "
            f"{kind} stays round; scale it evenly, or use a RectLight or a mesh that emits"
        )
    return float(scale.mean())


# --- Spectra -----------------------------------------------------------------------------------


def _radiance(
    light: LightPrim, shaping: Shaping, context: Context
) -> tuple[FloatArray, NDArray[np.float32] | None]:
    """Return the spectra of a light's channels, and the picture that weighs them."""
    source = "rgb" if light.shows_rgb else light.spectral.source
    if source in ("basis", "bands"):
        raise LayerError(
            f"{describe(light.prim)}: inputs:spectral:source is {source}, a map of directions, "
            f"which a {light.prim.GetTypeName()} has not; use tabulated, or a DomeLight"
        )
    if source != "rgb":
        emission = light.spectral.emission
        if source == "tabulated" and emission is not None:
            if emission.quantity is SpectralQuantity.IRRADIANCE:
                raise LayerError(
                    f"{describe(light.prim)}: spectrum:emission:quantity is irradiance, which a "
                    f"{light.prim.GetTypeName()} gives each place another; give its radiance"
                )
        spectrum = constant_spectrum(light, context)
        if not shaping.has_color:
            return spectrum[None], None
        tint = reflectance_basis(context.wavelength_nm, DEFAULT_COLOR_SPACE, context.observer)
        return tint * spectrum, None
    texture, space = _texture(light, shaping, context)
    spectra = rgb_spectra(light, space, context)
    weights = np.ones((1, 3)) if texture is None else texture.reshape(-1, 3)
    depth, _, count = deepest_dip(weights, spectra)
    if count:
        context.note(
            "uplift-negative",
            light.prim,
            f"its spectrum dips below zero, by {-depth:.1%} of the peak; XYZ stays exact",
        )
    if texture is None and not shaping.has_color:
        return spectra.sum(axis=0)[None], None
    return spectra, texture


def _texture(
    light: LightPrim, shaping: Shaping, context: Context
) -> tuple[NDArray[np.float32] | None, str]:
    """Return the picture on a rectangle in a linear RGB space, and that space."""
    if not light.prim.IsA(UsdLux.RectLight):
        return None, DEFAULT_COLOR_SPACE
    attribute, _ = light_input(light.prim, "texture:file", context)
    path = asset_file(attribute, context.time)
    if path is None:
        return None, DEFAULT_COLOR_SPACE
    where = f"{path} ({describe(attribute)})"
    try:
        chosen = rgb_channels(where, read_headers(path)[0].channel_names)
        image = read_image(path, channels=chosen)
    except ImageError as error:
        raise placed(error, path, where) from None
    pixels = image.pixels
    if pixels.shape[2] == 1:
        pixels = np.repeat(pixels, 3, axis=2)
    pixels = mend_values(pixels, context.bad_pixels, where, light.path, context.notes)
    space = map_color_space(attribute, image.color_space, image.sample_type)
    pixels = linearize(pixels, space)
    space = linear_color_space(space)
    if shaping.has_color and space != DEFAULT_COLOR_SPACE:  # a tint multiplies in its own space
        matrix = xyz_to_rgb(DEFAULT_COLOR_SPACE) @ rgb_to_xyz(space)
        pixels, space = pixels @ matrix.T.astype(np.float32), DEFAULT_COLOR_SPACE
    return np.ascontiguousarray(pixels, dtype=np.float32), space


# --- Shaping -----------------------------------------------------------------------------------


def _shaping(prim: Usd.Prim, context: Context) -> Shaping:
    """Return how a light's emission depends on direction."""
    if not prim.HasAPI(UsdLux.ShapingAPI):
        if any(name.startswith("inputs:shaping:") for name in prim.GetAuthoredPropertyNames()):
            context.note(
                "light-shaping-ignored", prim, "inputs:shaping without ShapingAPI; apply it"
            )
        return Shaping()
    angle = number(prim, "shaping:cone:angle", context)
    softness = number(prim, "shaping:cone:softness", context)
    focus = number(prim, "shaping:focus", context)
    tint = np.array(light_input(prim, "shaping:focusTint", context)[1], dtype=np.float64)
    if not np.isfinite(tint).all() or tint.min() < 0.0:
        raise LayerError(
            f"{describe(prim)}: inputs:shaping:focusTint is {tuple(tint)}; author three numbers "
            "that are not negative"
        )
    emits_behind = prim.IsA(UsdLux.SphereLight) or prim.IsA(UsdLux.CylinderLight)
    cuts = softness > 0.0 or angle < (180.0 if emits_behind else 90.0)
    return Shaping(
        cone_angle=math.radians(max(angle, 0.0)) if cuts else None,
        cone_softness=min(max(softness, 0.0), 1.0),
        focus=max(focus, 0.0),
        focus_tint=(float(tint[0]), float(tint[1]), float(tint[2])),
        profile=_profile(prim, context),
        angle_scale=number(prim, "shaping:ies:angleScale", context),
    )


def _profile(prim: Usd.Prim, context: Context) -> IntensityProfile | None:
    attribute, _ = light_input(prim, "shaping:ies:file", context)
    path = asset_file(attribute, context.time)
    if path is None:
        return None
    try:
        profile = read_ies(path)
    except UsdSkinError as error:
        raise LayerError(f"{describe(attribute)}: {error}") from None
    if light_input(prim, "shaping:ies:normalize", context)[1]:
        return profile.scaled(1.0 / profile.mean())
    return profile
