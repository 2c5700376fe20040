"""The lights of a stage, with their spectra on one wavelength grid.

Reads: ``DomeLight``, ``DomeLight_1``, ``DistantLight`` and, for integrators that know places,
``RectLight``, ``DiskLight``, ``SphereLight`` and ``CylinderLight`` prims of UsdLux, plain (RGB) or
with ``SpectralLightAPI``. Other kinds of light are noted.
"""

from __future__ import annotations

import math
from collections.abc import Collection, Iterator
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import ArrayLike, NDArray
from pxr import Usd, UsdGeom, UsdLux

from usdskin.colorimetry import DEFAULT_OBSERVER, Observer
from usdskin.errors import LayerError
from usdskin.layers import describe
from usdskin.notes import Note
from usdskin.render.domes import DomeLight, read_dome, turn_dome
from usdskin.render.light_inputs import (
    Context,
    LightPrim,
    check_brightness,
    constant_spectrum,
    light_input,
    number,
    read_light_prim,
    rgb_spectra,
)
from usdskin.render.local_light_prims import is_local, read_local
from usdskin.render.local_lights import LocalLight
from usdskin.render.texels import BadPixels
from usdskin.spectrum import SpectralQuantity, check_grid
from usdskin.uplift import deepest_dip

__all__ = [
    "DistantLight",
    "DomeLight",
    "Lights",
    "LocalLight",
    "check_lit",
    "only_turned",
    "read_lights",
    "turn_lights",
]


@dataclass(frozen=True, slots=True, eq=False)
class DistantLight:
    """Light from one direction, or from a small disc around it."""

    path: str
    """Prim path."""

    direction: NDArray[np.float64]
    """Unit vector towards the light, world space, shape [3]."""

    angle_deg: float
    """Angular diameter of the disc [deg]; 0 is perfectly parallel light."""

    irradiance: NDArray[np.float64]
    """On a surface that faces the light [W m^-2 nm^-1, or relative], shape [band_count]."""

    absolute: bool
    """Whether irradiance is in W m^-2 nm^-1."""


@dataclass(frozen=True, slots=True, eq=False)
class Lights:
    """All light of a stage that reaches the picture."""

    domes: tuple[DomeLight, ...]
    """Dome lights; their light adds up."""

    distants: tuple[DistantLight, ...]
    """Distant lights."""

    locals: tuple[LocalLight, ...] = ()
    """Lights with a place, where the integrator knows places."""

    @property
    def all(self) -> tuple[DomeLight | DistantLight | LocalLight, ...]:
        """All lights in the order in which they are numbered."""
        return (*self.domes, *self.distants, *self.locals)

    @property
    def absolute(self) -> bool:
        """Whether the picture is in absolute units; false without a light."""
        return any(light.absolute for light in self.all)

    @property
    def paths(self) -> tuple[str, ...]:
        """Prim paths in the order in which lights are numbered."""
        return tuple(light.path for light in self.all)


def read_lights(
    stage: Usd.Stage,
    time: Usd.TimeCode | float,
    wavelength_nm: ArrayLike,
    observer: Observer = DEFAULT_OBSERVER,
    illuminant: str | None = None,
    bad_pixels: BadPixels = "error",
    notes: list[Note] | None = None,
    places: bool = False,
) -> Lights:
    """Read the lights of a stage.

    Args:
        stage: The stage.
        time: Time to read at.
        wavelength_nm: Band centres [nm], strictly ascending, shape [band_count].
        observer: Whose colour-matching functions relate spectra and RGB.
        illuminant: Lamp, by name or file, that every RGB light is taken to be. It wins over what
            the lights say; ``None`` leaves it to them, and D65 where they say nothing.
        bad_pixels: Whether map pixels that are no light (negative, NaN, infinite) are refused, or
            clamped with a note.
        notes: Takes what cannot be honoured.
        places: Whether the integrator knows places. Where it does not, each light that has one is
            noted and left out, and links of lights to prims are noted.

    Returns:
        Visible lights in the order of the stage; there may be none.

    Raises:
        LayerError: An opinion cannot be used, or absolute and relative lights are mixed.
        ImageError: A map is missing, broken or of the wrong kind, or has bad pixels.
        UsageError: ``illuminant`` cannot be used.
    """
    grid = np.array(wavelength_nm, dtype=np.float64)
    check_grid(grid)
    context = Context(
        wavelength_nm=grid,
        time=Usd.TimeCode(time),
        observer=observer,
        illuminant=illuminant,
        bad_pixels=bad_pixels,
        notes=[] if notes is None else notes,
        places=places,
    )
    cache = UsdGeom.XformCache(context.time)
    domes: list[DomeLight] = []
    distants: list[DistantLight] = []
    local: list[LocalLight] = []
    meters = UsdGeom.GetStageMetersPerUnit(stage)
    read: list[LightPrim] = []
    for prim in _light_prims(stage, context):
        is_dome = prim.IsA(UsdLux.DomeLight) or prim.IsA(UsdLux.DomeLight_1)
        light = read_light_prim(prim, context)
        _refuse_mixed_units(light, read)
        read.append(light)
        to_world = np.array(cache.GetLocalToWorldTransform(prim)).T
        if is_dome:
            domes.append(read_dome(light, to_world, context))
        elif is_local(prim):
            local.append(read_local(light, to_world, meters, context))
        else:
            distants.append(_read_distant(light, to_world, context))
    return Lights(tuple(domes), tuple(distants), tuple(local))


def turn_lights(
    stage: Usd.Stage,
    time: Usd.TimeCode,
    lights: Lights,
    paths: Collection[str],
    notes: list[Note],
) -> Lights | None:
    """Return lights of which some have been turned since they were read, and nothing else changed.

    Args:
        stage: The stage.
        time: Time to read at.
        lights: The lights at another time.
        paths: Which of them have other transforms.
        notes: Takes what cannot be honoured.

    Returns:
        The lights, sharing the arrays of ``lights``; None where they have to be read again.

    Raises:
        LayerError: A transform cannot be used.
    """
    context = Context(np.zeros(0), time, notes=notes)
    cache = UsdGeom.XformCache(time)
    domes, distants = list(lights.domes), list(lights.distants)
    for k, dome in enumerate(domes):
        if dome.path in paths:
            prim = stage.GetPrimAtPath(dome.path)
            to_world = np.array(cache.GetLocalToWorldTransform(prim)).T
            turned = turn_dome(dome, prim, to_world, context)
            if turned is None:
                return None
            domes[k] = turned
    for k, distant in enumerate(distants):
        if distant.path in paths:
            prim = stage.GetPrimAtPath(distant.path)
            to_world = np.array(cache.GetLocalToWorldTransform(prim)).T
            distants[k] = replace(distant, direction=_towards(prim, to_world))
    return replace(lights, domes=tuple(domes), distants=tuple(distants))


def only_turned(lights: Lights, before: Lights) -> bool:
    """Return whether lights differ from others at most in how those far away are turned."""
    if lights is before:
        return True
    if [len(kind) for kind in (lights.domes, lights.distants, lights.locals)] != [
        len(kind) for kind in (before.domes, before.distants, before.locals)
    ]:
        return False
    domes = zip(lights.domes, before.domes, strict=True)
    distants = zip(lights.distants, before.distants, strict=True)
    return (
        all(a.coefficients is b.coefficients and a.basis is b.basis for a, b in domes)
        and all(a.irradiance is b.irradiance and a.angle_deg == b.angle_deg for a, b in distants)
        and all(a is b for a, b in zip(lights.locals, before.locals, strict=True))
    )


def check_lit(stage: Usd.Stage, lights: Lights, notes: list[Note]) -> None:
    """Refuse a stage in which nothing shines.

    Raises:
        LayerError: There is no light, or only such that the integrator cannot show.
    """
    if lights.paths:
        return
    name = stage.GetRootLayer().identifier
    waiting = [note.path for note in notes if note.code == "light-needs-traced"]
    if waiting:
        more = f" and {len(waiting) - 1} more" if len(waiting) > 1 else ""
        raise LayerError(
            f"{name}: all its light has a place (<{waiting[0]}>{more}), which reflectance maps do "
            "not know; use --integrator traced, or add a DomeLight or a DistantLight."
        )
    raise LayerError(
        f"{name}: no light shines; add a DomeLight or a DistantLight, or make one visible."
    )


def _light_prims(stage: Usd.Stage, context: Context) -> Iterator[Usd.Prim]:
    """Yield the visible lights of the kinds that are rendered; note the others."""
    prims = iter(Usd.PrimRange.Stage(stage, Usd.TraverseInstanceProxies()))
    for prim in prims:
        if prim.IsA(UsdGeom.PointInstancer):
            prims.PruneChildren()
            for below in Usd.PrimRange(prim, Usd.TraverseInstanceProxies()):
                if below.HasAPI(UsdLux.LightAPI):
                    context.note(
                        "light-not-supported",
                        below,
                        "a light in the prototypes of a point instancer; it does not shine",
                    )
            continue
        if not prim.HasAPI(UsdLux.LightAPI):
            continue
        visibility = UsdGeom.Imageable(prim).ComputeVisibility(context.time)
        if visibility == UsdGeom.Tokens.invisible:
            continue
        if prim.IsA(UsdLux.PortalLight):
            context.note(
                "light-not-supported",
                prim,
                "a portal, which guides sampling; the dome shines whole",
            )
        elif any(
            prim.IsA(kind) for kind in (UsdLux.DomeLight, UsdLux.DomeLight_1, UsdLux.DistantLight)
        ):
            yield prim
        elif is_local(prim) and context.places:
            yield prim
        elif is_local(prim):
            context.note(
                "light-needs-traced",
                prim,
                f"a {prim.GetTypeName()} has a place, which reflectance maps do not know; it does "
                "not shine; use --integrator traced",
            )
        else:
            kind = str(prim.GetTypeName()) or "prim without a type"
            context.note("light-not-supported", prim, f"a light of type {kind}; it does not shine")


def _refuse_mixed_units(light: LightPrim, read: list[LightPrim]) -> None:
    if read and read[0].is_absolute != light.is_absolute:
        absolute, relative = (light, read[0]) if light.is_absolute else (read[0], light)
        raise LayerError(
            f"{describe(relative.prim)}: is relative, but <{absolute.path}> has absolute units; "
            "author the same inputs:spectral:units on all lights (absolute RGB is in cd/m^2)"
        )


def _read_distant(
    light: LightPrim, to_world: NDArray[np.float64], context: Context
) -> DistantLight:
    """Read a distant light, which shines along its -Z axis.

    The light fills a disc of angular radius t (half of ``inputs:angle``) with radiance L. A
    surface facing it receives

        E = int_disc L cos d omega = L pi sin^2(t)      for t up to 90 degrees, L pi beyond;

    ``inputs:normalize`` first divides L by the disc's sizeFactor (UsdLux, LightAPI):
    ``pi sin^2(t)`` up to 90 degrees, ``pi (2 - sin^2(t))`` beyond, so that intensity is
    illuminance. An angle of 0 is parallel light, for which sizeFactor is 1 whether normalised or
    not: intensity is illuminance. A spectrum that is tabulated as irradiance is E itself.
    """
    source = "rgb" if light.shows_rgb else light.spectral.source
    if source in ("basis", "bands"):
        raise LayerError(
            f"{describe(light.prim)}: inputs:spectral:source is {source}, a map, which a distant "
            "light has not; use tabulated, or a DomeLight"
        )
    direction = _towards(light.prim, to_world)
    angle = min(max(number(light.prim, "angle", context), 0.0), 360.0)
    if source == "rgb":
        spectrum = rgb_spectra(light, "lin_rec709_scene", context).sum(axis=0)
        depth, _, count = deepest_dip(np.ones((1, 1)), spectrum[None])
        if count:
            context.note(
                "uplift-negative",
                light.prim,
                f"its spectrum dips below zero, by {-depth:.1%} of the peak; XYZ stays exact",
            )
    else:
        spectrum = constant_spectrum(light, context)
    emission = light.spectral.emission
    is_irradiance = (
        source == "tabulated"
        and emission is not None
        and emission.quantity is SpectralQuantity.IRRADIANCE
    )
    normalize = bool(light_input(light.prim, "normalize", context)[1])
    factor = 1.0 if is_irradiance else _facing_factor(angle, normalize)
    irradiance = spectrum * (factor * light.scale)
    check_brightness(light, float(np.abs(irradiance).max()))
    return DistantLight(
        path=light.path,
        direction=direction,
        angle_deg=angle,
        irradiance=irradiance,
        absolute=light.is_absolute,
    )


def _towards(prim: Usd.Prim, to_world: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return the unit vector towards a distant light."""
    direction = to_world[:3, :3] @ np.array([0.0, 0.0, 1.0])
    length = float(np.linalg.norm(direction))
    if not (math.isfinite(length) and length > 0.0):
        raise LayerError(
            f"{describe(prim)}: its transform flattens its axis or is not finite; mend its xformOps"
        )
    return np.asarray(direction / length)


def _facing_factor(angle_deg: float, normalize: bool) -> float:
    """Return the irradiance of a facing surface per radiance of the disc [sr]."""
    half = math.radians(angle_deg) / 2.0
    if half == 0.0:
        return 1.0
    projected = math.pi * math.sin(min(half, math.pi / 2.0)) ** 2
    if not normalize:
        return projected
    if half <= math.pi / 2.0:
        return 1.0
    return projected / (math.pi * (2.0 - math.sin(half) ** 2))
