"""What a render was asked for: flags before authored settings before fallbacks.

Reads:  a stage's RenderSettings prim, with ``SkinRenderSettingsAPI`` or without, and the flags.
Makes:  ``RenderJob``: what all pictures share, the products to write
        (``usdskin.render.products``) and the frames.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, get_args

import numpy as np
from numpy.typing import NDArray

from usdskin.colorimetry import Observer, color_space_names, illuminant, linear_color_space
from usdskin.errors import LayerError, UsageError, UsdSkinError
from usdskin.frames import frame_path, has_placeholder, with_placeholder
from usdskin.notes import Note
from usdskin.prims import read_render_settings_api
from usdskin.render.job import Frame, RenderJob, RenderSettings
from usdskin.render.memory import check_memory
from usdskin.render.opinions import (
    choose,
    one_of,
    real_number,
    several_of,
    truth,
    wavelengths,
    whole_number,
)
from usdskin.render.overrides import RenderOverrides
from usdskin.render.products import Product, read_products

# isort: split
# After ours, which register the schemas.
from pxr import Sdf, Usd, UsdRender

SAMPLES_LIMIT = 4096
TRACED_SAMPLES = 64
"""Samples per pixel where nobody says how many and light is traced."""

MOTION_LIMIT = 256
"""As ``usdskin:motionSamples`` limits it."""

LEVEL_LIMIT = 8
"""As ``usdskin:subdivisionLevel`` limits it: every level has four times the faces."""

SEED_LIMIT = 2**31 - 1

OBSERVERS = get_args(Observer)
PIXEL_FILTERS = ("box", "triangle", "gaussian", "blackmanHarris")
DOMES = ("auto", "show", "hide")
PURPOSES = ("default", "render", "proxy", "guide")
COMPRESSIONS = ("none", "rle", "zips", "zip", "piz")
"""Lossless ones: data and spectra are read back as they were written."""


def resolve_settings(
    stage: Usd.Stage, overrides: RenderOverrides, output: Path | None, notes: list[Note]
) -> RenderJob:
    """Return what to render: flags win over authored settings, and these over fallbacks.

    Args:
        stage: Stage to render, with the overrides' variants and attributes applied
            (``apply_overrides``).
        overrides: The flags.
        output: Picture to write instead of the stage's products.
        notes: Takes what the stage asks for and will not get.

    Raises:
        UsageError: A flag's value is wrong, or names what the stage has not.
        LayerError: An authored value is wrong.
        DeviceError: The pictures need more memory than there is.
    """
    settings = read_settings(stage, overrides)
    prim = stage.GetPrimAtPath(settings.prim_path) if settings.prim_path else None
    frames = _frames(stage, overrides)
    spectral = choose(
        [prim] if prim else (),
        "usdskin:spectralOutput",
        truth,
        False,
        "--spectral",
        overrides.spectral_output,
    )
    products = read_products(
        stage,
        prim,
        overrides,
        output,
        spectral=spectral,
        time=frames[0].time,
        traced=settings.integrator == "traced",
        notes=notes,
    )
    _check_places(products, frames)
    for product in products:
        check_memory(product, settings.wavelength_nm.size)
    return RenderJob(overrides=overrides, settings=settings, products=products, frames=frames)


def read_settings(stage: Usd.Stage, overrides: RenderOverrides) -> RenderSettings:
    """Return what all pictures share; needs neither a camera nor a product.

    Raises:
        UsageError: A flag's value is wrong, or names what the stage has not.
        LayerError: An authored value is wrong.
    """
    if overrides.white is not None or overrides.view is not None:
        from usdskin.render.preview import check_display  # loads OpenColorIO

        check_display(overrides.white or "scene", overrides.view)
    prim = _settings_prim(stage, overrides.settings)
    if prim is None:
        return _read_settings(stage, (), overrides)
    read_render_settings_api(prim, Usd.TimeCode.EarliestTime())  # refuses what is misspelt
    return _read_settings(stage, (prim,), overrides)


def _settings_prim(stage: Usd.Stage, requested: str | None) -> Usd.Prim | None:
    """Return the RenderSettings prim that was asked for, or the stage's own, or None."""
    path = requested or str(stage.GetMetadata("renderSettingsPrimPath") or "")
    if not path:
        return None
    prim = stage.GetPrimAtPath(path) if Sdf.Path.IsValidPathString(path) else None
    if prim and prim.IsA(UsdRender.Settings):
        return prim
    if requested:
        there = [str(item.GetPath()) for item in stage.Traverse() if item.IsA(UsdRender.Settings)]
        raise UsageError(
            f"-rs/--settings {path}: the stage has no such RenderSettings prim; it has "
            f"{', '.join(there) or 'none'}."
        )
    raise LayerError(
        f"{stage.GetRootLayer().GetDisplayName()}: renderSettingsPrimPath = {path!r} names no "
        "RenderSettings prim; correct the path, or name another with -rs."
    )


def _frames(stage: Usd.Stage, overrides: RenderOverrides) -> tuple[Frame, ...]:
    """Return the frames asked for, else the stage's first, else its one moment."""
    if overrides.frames is not None:
        return tuple(Frame(float(number)) for number in overrides.frames)
    if not stage.HasAuthoredMetadata("startTimeCode"):
        return (Frame(None),)
    start = stage.GetStartTimeCode()
    if not math.isfinite(start):
        raise LayerError(
            f"{stage.GetRootLayer().GetDisplayName()}: startTimeCode = {start} is no time; correct "
            "it, or give the frames with -f."
        )
    return (Frame(start),)


def _check_places(products: tuple[Product, ...], frames: tuple[Frame, ...]) -> None:
    """Check that every frame has a file name of its own, before anything is rendered."""
    for product in products:
        for file in product.files:
            if len(frames) > 1 and not has_placeholder(file):
                raise UsageError(
                    f"{file}: {len(frames)} frames need a place for the number, such as "
                    f"{with_placeholder(file)}."
                )
            for frame in frames:
                frame_path(file, frame.number)


def _integrator(value: Any) -> str:
    return one_of(("map", "traced"))(value)


def _purposes(value: Any) -> frozenset[str]:
    return frozenset(several_of(PURPOSES)(value))


def _color_space(value: Any) -> str:
    name = one_of(color_space_names())(value)
    if linear_color_space(name) != name:
        raise ValueError(f"pictures are rendered linear; use {linear_color_space(name)}.")
    return name


def _mask(stage: Usd.Stage, paths: Sequence[str] | None) -> tuple[str, ...] | None:
    if paths is None:
        return None
    for path in paths:
        valid = path.startswith("/") and Sdf.Path.IsValidPathString(path)
        if not (valid and Sdf.Path(path).IsAbsoluteRootOrPrimPath() and stage.GetPrimAtPath(path)):
            raise UsageError(f"--mask {path}: the stage has no such prim; give its path.")
    return tuple(str(Sdf.Path(path)) for path in paths)


@dataclass(frozen=True, slots=True)
class _Opinion:
    """Where one setting may be said, and what is right for it."""

    attribute: str
    flag: str
    check: Callable[[Any], Any]
    override: str
    """Field of ``RenderOverrides``."""


_OPINIONS = {
    "integrator": _Opinion("usdskin:integrator", "--integrator", _integrator, "integrator"),
    "samples_per_pixel": _Opinion(
        "usdskin:samplesPerPixel", "-p/--samples", whole_number(1, SAMPLES_LIMIT), "samples"
    ),
    "target_error": _Opinion(
        "usdskin:targetError", "--target-error", real_number(0.0, 1.0), "target_error"
    ),
    "bounces": _Opinion("usdskin:bounces", "--bounces", whole_number(0, 1), "bounces"),
    "motion_samples": _Opinion("usdskin:motionSamples", "", whole_number(0, MOTION_LIMIT), ""),
    "pixel_filter": _Opinion(
        "usdskin:pixelFilter", "--filter", one_of(PIXEL_FILTERS), "pixel_filter"
    ),
    "seed": _Opinion("usdskin:seed", "--seed", whole_number(0, SEED_LIMIT), "seed"),
    "wavelength_nm": _Opinion("usdskin:wavelengths", "--wavelengths", wavelengths, "wavelength_nm"),
    "observer": _Opinion("usdskin:observer", "--observer", one_of(OBSERVERS), "observer"),
    "subdivision_level": _Opinion(
        "usdskin:subdivisionLevel", "--level", whole_number(0, LEVEL_LIMIT), "subdivision_level"
    ),
    "dome": _Opinion("usdskin:dome", "--dome", one_of(DOMES), "dome"),
    "purposes": _Opinion("includedPurposes", "--purposes", _purposes, "purposes"),
    "material_purposes": _Opinion(
        "materialBindingPurposes", "", several_of(("full", "preview", "")), ""
    ),
    "color_space": _Opinion("renderingColorSpace", "", _color_space, ""),
}


def _read_settings(
    stage: Usd.Stage, prims: Sequence[Usd.Prim], given: RenderOverrides
) -> RenderSettings:
    integrator = _OPINIONS["integrator"]
    traced = "traced" == choose(
        prims, integrator.attribute, integrator.check, "map", integrator.flag, given.integrator
    )
    values: dict[str, Any] = {
        name: choose(
            prims,
            opinion.attribute,
            opinion.check,
            TRACED_SAMPLES
            if traced and name == "samples_per_pixel"
            else opinion.check(_fallback(opinion.attribute)),
            opinion.flag,
            getattr(given, opinion.override) if opinion.override else None,
        )
        for name, opinion in _OPINIONS.items()
    }
    if traced and given.spectral_method == "brute":
        raise UsageError("--spectral brute is an oracle for maps; use --integrator map with it.")
    if not traced:
        _refuse_traced_flags(given)
    _check_illuminant(given.illuminant, values["wavelength_nm"])
    return RenderSettings(
        **values,
        prim_path=str(prims[0].GetPath()) if prims else None,
        spectral_method=given.spectral_method or "factorised",
        mask=_mask(stage, given.mask),
        illuminant=given.illuminant,
        bad_pixels=given.bad_pixels or "error",
        ev="auto" if given.ev is None else given.ev,
        white=given.white or "scene",
        view=given.view,
        compression=choose((), "", one_of(COMPRESSIONS), "zip", "--compression", given.compression),
        skip_existing=given.skip_existing,
        threads=given.threads,
        device=given.device,
    )


def _refuse_traced_flags(given: RenderOverrides) -> None:
    for name in ("target_error", "bounces"):
        value, flag = getattr(given, name), _OPINIONS[name].flag
        if value:
            raise UsageError(
                f"{flag} {value:g}: means something for --integrator traced only; give that too, "
                f"or leave {flag} out."
            )


def _check_illuminant(name: str | None, wavelength_nm: NDArray[np.float64]) -> None:
    """Refuse a name that is no lamp's, whether or not the stage has a light to take it."""
    if name is None:
        return
    try:
        illuminant(name, wavelength_nm)
    except UsdSkinError as error:
        raise UsageError(f"--illuminant {name}: {error}") from None


def _fallback(attribute: str) -> Any:
    """Return what the schema says where nobody has an opinion."""
    if attribute == "renderingColorSpace":
        return "lin_rec709_scene"  # UsdRender leaves it to the renderer
    registry = Usd.SchemaRegistry()
    if attribute.startswith("usdskin:"):
        definition = registry.FindAppliedAPIPrimDefinition("SkinRenderSettingsAPI")
    else:
        definition = registry.FindConcretePrimDefinition("RenderSettings")
    return definition.GetAttributeFallbackValue(attribute)
