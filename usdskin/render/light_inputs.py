"""What a light prim's own inputs say: how bright, which spectrum, seen through which map.

Reads: the ``inputs:`` of UsdLux (quantities as its schema documents them: a white light of
intensity 1 and exposure 0 has a luminance of 1) and ``SpectralLightAPI``.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray
from pxr import Usd, UsdLux

from usdskin.colorimetry import (
    DEFAULT_OBSERVER,
    Observer,
    daylight,
    illuminant,
    linear_color_space,
    planck_radiance,
    rgb_to_xyz,
    xyz_to_rgb,
    xyz_weights,
)
from usdskin.errors import LayerError, UsageError, UsdSkinError
from usdskin.layers import describe
from usdskin.notes import Note
from usdskin.prims import SpectralLight, read_spectral_light
from usdskin.render.light_collections import is_linked
from usdskin.render.light_files import DEFAULT_COLOR_SPACE, said_color_space
from usdskin.render.texels import BadPixels
from usdskin.spectrum import SpectralQuantity
from usdskin.uplift import light_basis

FloatArray = NDArray[np.float64]

DEFAULT_ILLUMINANT = "D65"

BRIGHTEST = 1e18
"""Highest radiance, and highest coefficient of a basis: their squares still fit a float32."""


@dataclass(frozen=True, slots=True, eq=False)
class Context:
    """How lights are read: the same for every light of a picture."""

    wavelength_nm: FloatArray
    """Band centres [nm], shape [band_count]."""

    time: Usd.TimeCode = field(default_factory=Usd.TimeCode.Default)
    """Time to read at."""

    observer: Observer = DEFAULT_OBSERVER
    """Whose colour-matching functions relate spectra and RGB."""

    illuminant: str | None = None
    """Lamp that RGB lights are taken to be, whatever they say themselves."""

    bad_pixels: BadPixels = "error"
    """What to do about map pixels that are no light."""

    notes: list[Note] = field(default_factory=list)
    """Takes what cannot be honoured."""

    places: bool = False
    """Whether light is followed from place to place: local lights shine, and links hold."""

    def note(self, code: str, prim: Usd.Prim, message: str) -> None:
        """Append a note about a prim."""
        self.notes.append(Note(code, str(prim.GetPath()), message))

    def luminance(self, spectrum: FloatArray) -> float:
        """Return Y in relative units of a spectrum, shape [band_count]."""
        return float(spectrum @ xyz_weights(self.wavelength_nm, self.observer)[:, 1])

    def nit(self) -> float:
        """Return the absolute radiance of a spectrum whose relative Y is 1, per nit."""
        relative = xyz_weights(self.wavelength_nm, self.observer)[:, 1]
        absolute = xyz_weights(self.wavelength_nm, self.observer, absolute=True)[:, 1]
        return float(relative.sum() / absolute.sum())


@dataclass(frozen=True, slots=True, eq=False)
class LightPrim:
    """A light prim with what it says about its spectrum."""

    prim: Usd.Prim
    """The prim."""

    spectral: SpectralLight
    """Its spectral opinions, or the fallbacks of a plain RGB light."""

    is_physical: bool
    """Whether those come from OpenUSD's physical-lighting proposal, on top of an RGB light."""

    scale: float
    """``intensity * 2^exposure``, times the spectral scale."""

    @property
    def path(self) -> str:
        """Prim path."""
        return str(self.prim.GetPath())

    @property
    def is_absolute(self) -> bool:
        """Whether radiance is in W m^-2 sr^-1 nm^-1."""
        return self.spectral.units == "absolute"

    @property
    def shows_rgb(self) -> bool:
        """Whether the RGB inputs (color, texture) shape the light."""
        return self.is_physical or self.spectral.source == "rgb"


def read_light_prim(prim: Usd.Prim, context: Context) -> LightPrim:
    """Read what every kind of light has, and note what is not honoured.

    Args:
        prim: Prim with ``LightAPI``.
        context: How lights are read.

    Raises:
        LayerError: An opinion cannot be used.
    """
    spectral = read_spectral_light(prim, context.time)
    is_physical = spectral is not None and not prim.HasAPI("SpectralLightAPI")
    spectral = SpectralLight() if spectral is None else spectral
    intensity = number(prim, "intensity", context, minimum=0.0)
    exposure = number(prim, "exposure", context)
    try:
        scale = intensity * math.pow(2.0, exposure) * spectral.scale
    except OverflowError:
        scale = math.inf
    if not math.isfinite(scale) or spectral.scale < 0.0:
        raise LayerError(
            f"{describe(prim)}: intensity {intensity:g} at exposure {exposure:g} times "
            f"inputs:spectral:scale {spectral.scale:g} is no brightness; lower the exposure"
        )
    _note_ignored(prim, context)
    return LightPrim(prim, spectral, is_physical, scale)


def check_brightness(light: LightPrim, peak: float) -> None:
    """Refuse a light whose peak is beyond ``BRIGHTEST``.

    Raises:
        LayerError: It is, or it is no number.
    """
    if not peak <= BRIGHTEST:
        raise LayerError(
            f"{describe(light.prim)}: its light has a peak of {peak:.3g}, beyond {BRIGHTEST:g}; "
            f"lower its spectrum, or its brightness of {light.scale:g} (intensity, exposure, scale)"
        )


def light_input(prim: Usd.Prim, name: str, context: Context) -> tuple[Usd.Attribute, Any]:
    """Return an input of a light and its value at the context's time.

    A value under the name that the input had before USD 21.05, without ``inputs:``, counts too.
    """
    attribute = prim.GetAttribute(f"inputs:{name}")
    if not (attribute and attribute.HasAuthoredValue()):
        old = prim.GetAttribute(name)
        if old and old.HasAuthoredValue():
            return old, old.Get(context.time)
    return attribute, attribute.Get(context.time) if attribute else None


def number(prim: Usd.Prim, name: str, context: Context, minimum: float = -math.inf) -> float:
    """Return a numeric input of a light.

    Raises:
        LayerError: It is no finite number, or below ``minimum``.
    """
    attribute, value = light_input(prim, name, context)
    if isinstance(value, (int, float)) and math.isfinite(value) and value >= minimum:
        return float(value)
    bound = "" if minimum == -math.inf else f" of at least {minimum:g}"
    raise LayerError(
        f"{describe(attribute or prim)}: inputs:{name} is {value}; author a finite number{bound}"
    )


def _note_ignored(prim: Usd.Prim, context: Context) -> None:
    """Note what is authored on a light and has no effect on the picture."""
    for name in ("diffuse", "specular"):
        value = light_input(prim, name, context)[1]
        if value is not None and value != 1.0:
            context.note(
                "light-multiplier-ignored",
                prim,
                f"inputs:{name} is {value:g}; the light shines on both alike",
            )
    for name in ("lightLink", "shadowLink") if not context.places else ():
        if is_linked(prim, name):
            context.note(
                "light-linking-ignored", prim, f"collection:{name}; the light reaches everything"
            )
    _note_shadows(prim, context)
    filters = prim.GetRelationship("light:filters")
    if filters and filters.GetTargets():
        context.note("light-filters-ignored", prim, "light:filters; the light is unfiltered")
    if prim.HasAPI(UsdLux.ShapingAPI) and not prim.IsA(UsdLux.BoundableLightBase):
        context.note("light-shaping-ignored", prim, "ShapingAPI; the light shines evenly")
    wired = [
        attribute.GetName()
        for attribute in prim.GetAuthoredAttributes()
        if attribute.GetName().startswith("inputs:") and attribute.HasAuthoredConnections()
    ]
    if wired:
        context.note(
            "light-connection-ignored",
            prim,
            f"{', '.join(wired)} connected to a shader; the value on the light is used",
        )


def _note_shadows(prim: Usd.Prim, context: Context) -> None:
    """Note what ``ShadowAPI`` says that has no effect."""
    if not prim.HasAPI(UsdLux.ShadowAPI):
        return
    kept = ("enable",) if context.places else ()
    names = [
        name
        for name in ("enable", "color", "distance", "falloff", "falloffGamma")
        if name not in kept and prim.GetAttribute(f"inputs:shadow:{name}").HasAuthoredValue()
    ]
    if names:
        text = ", ".join(f"inputs:shadow:{name}" for name in names)
        context.note("light-shadow-ignored", prim, f"{text}; shadows are as light makes them")


# --- Spectra -----------------------------------------------------------------------------------


def constant_spectrum(light: LightPrim, context: Context) -> FloatArray:
    """Return the spectrum of a light that is not RGB and has no map, without its scale.

    A black body in absolute units has Planck's radiance; in relative units it and daylight have
    Y = 1; daylight in absolute units has 1 cd m^-2. A tabulated spectrum is as authored.

    Raises:
        LayerError: The spectrum cannot be used.
    """
    source = light.spectral.source
    if source == "tabulated":
        emission = light.spectral.emission
        if emission is None:
            raise LayerError(
                f"{describe(light.prim)}: inputs:spectral:source is tabulated, but there is no "
                "SpectralDistributionAPI:emission; apply it"
            )
        if light.is_absolute and emission.quantity is SpectralQuantity.RELATIVE:
            raise LayerError(
                f"{describe(light.prim)}: inputs:spectral:units is absolute, but "
                "spectrum:emission:quantity is relative; give radiance, or make the units relative"
            )
        lowest = int(np.argmin(emission.value))
        if emission.value[lowest] < 0.0:
            raise LayerError(
                f"{describe(light.prim)}: spectrum:emission:values is {emission.value[lowest]:g} "
                f"at {emission.wavelength_nm[lowest]:g} nm; a light is never negative, so mend it"
            )
        return emission.resample(context.wavelength_nm)
    temperature = number(light.prim, "colorTemperature", context)
    lamp = daylight if source == "illuminantD" else planck_radiance
    spectrum = _named_at(light.prim, lambda: lamp(temperature, context.wavelength_nm))
    if source == "blackbody" and light.is_absolute:
        return spectrum
    luminance = context.luminance(spectrum)
    if luminance <= 0.0:
        raise LayerError(
            f"{describe(light.prim)}: a lamp of {temperature:g} K gives no visible light on this "
            "wavelength grid; raise inputs:colorTemperature"
        )
    relative: FloatArray = spectrum / luminance
    return relative * context.nit() if light.is_absolute else relative


def rgb_spectra(light: LightPrim, color_space: str, context: Context) -> FloatArray:
    """Return the spectra of the primaries of a light's RGB map, tinted, without its scale.

    The tint, ``inputs:color`` times the colour of ``inputs:colorTemperature`` where that is
    enabled, multiplies in its own colour space (that of the rendering, linear Rec. 709 unless the
    layer says otherwise); so the map is brought there first.

    Args:
        light: The light.
        color_space: Linear space of the map's pixels.
        context: How lights are read.

    Returns:
        Spectra such that ``radiance = rgb @ spectra``, shape [3, band_count].

    Raises:
        LayerError: The tint or the lamp cannot be used.
    """
    lamp, luminance = _assigned_lamp(light, context)
    tint, tint_space = _tint(light.prim, context)

    def lifted(space: str) -> FloatArray:
        return light_basis(lamp, context.wavelength_nm, space, context.observer)

    if tint.min() == tint.max():
        spectra = _named_at(light.prim, lambda: lifted(color_space)) * tint[0]
    else:
        to_tint = xyz_to_rgb(tint_space) @ rgb_to_xyz(color_space)
        spectra = (tint[:, None] * to_tint).T @ _named_at(light.prim, lambda: lifted(tint_space))
    scaled: FloatArray = spectra * (luminance * (context.nit() if light.is_absolute else 1.0))
    return scaled


def _named_at(prim: Usd.Prim, compute: Callable[[], FloatArray]) -> FloatArray:
    try:
        return compute()
    except LayerError:
        raise
    except UsdSkinError as error:
        raise LayerError(f"{describe(prim)}: {error}") from None


def _assigned_lamp(light: LightPrim, context: Context) -> tuple[FloatArray, float]:
    """Return the lamp an RGB light is taken to be, and the Y that its white has."""
    nm = context.wavelength_nm
    spectral = light.spectral
    if light.is_physical and spectral.source != "rgb":
        # The proposal's illuminant colours the RGB light; custom pairs are radiance as authored.
        lamp = constant_spectrum(light, context)
        return lamp, context.luminance(lamp)
    if context.illuminant is not None:
        try:
            return illuminant(context.illuminant, nm), 1.0
        except UsdSkinError as error:
            raise UsageError(f"--illuminant {context.illuminant}: {error}") from None
    name = str(spectral.illuminant_file or spectral.illuminant or DEFAULT_ILLUMINANT)
    return _named_at(light.prim, lambda: illuminant(name, nm)), 1.0


def _tint(prim: Usd.Prim, context: Context) -> tuple[FloatArray, str]:
    """Return the colour that multiplies an RGB light, and the linear space it does so in."""
    attribute, value = light_input(prim, "color", context)
    try:
        color = np.array([1.0, 1.0, 1.0] if value is None else value, dtype=np.float64)
    except (TypeError, ValueError):
        color = np.array([np.nan])
    if color.shape != (3,) or not np.isfinite(color).all() or color.min() < 0.0:
        raise LayerError(
            f"{describe(attribute)}: inputs:color is {value}; author three numbers that are not "
            "negative"
        )
    space = said_color_space(attribute) or DEFAULT_COLOR_SPACE
    space = linear_color_space(space)
    if light_input(prim, "enableColorTemperature", context)[1]:
        temperature = number(prim, "colorTemperature", context, minimum=1.0)
        warm = np.array(UsdLux.BlackbodyTemperatureAsRgb(temperature), dtype=np.float64)
        to_space = xyz_to_rgb(space) @ rgb_to_xyz(DEFAULT_COLOR_SPACE)
        color = color * np.maximum(to_space @ warm, 0.0)
    return color, space
