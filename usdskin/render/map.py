"""The paper's reflectance map: a surface's radiance towards every normal, as a latlong picture.

Reads:  a layer with lights, and with a skin material where the map is to be skin's.
Writes: ``MAP.exr``, a spectral EXR (Fichet et al. 2021), and ``MAP.png``. u and v mean the normal's
        direction as in UsdLux's latlong maps.
"""

from __future__ import annotations

import time as clock
from dataclasses import replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from usdskin import __version__, compilation
from usdskin.colorimetry import xyz_to_rgb, xyz_weights
from usdskin.device import open_workers
from usdskin.errors import LayerError, UsageError
from usdskin.image_output import write_spectral_exr
from usdskin.latlong import latlong_directions
from usdskin.notes import Note
from usdskin.prims import SkinParameters
from usdskin.progress import Progress
from usdskin.render.job import RenderReport, RenderSettings
from usdskin.render.light_maps import build_light_field
from usdskin.render.lights import Lights, read_lights
from usdskin.render.materials import SkinMaterial, read_materials
from usdskin.render.opening import opened
from usdskin.render.overrides import MapOverrides, RenderOverrides
from usdskin.render.preview import render_png
from usdskin.render.products import check_pictures
from usdskin.render.scene import mean_white
from usdskin.render.settings import read_settings
from usdskin.render.surface_rows import SpectralFrame, wraps_of
from usdskin.render.surfaces import band_groups, build_surfaces
from usdskin.warp_kernels import normals, reflectance_map, structs

# isort: split
# After ours, which register the schemas.
import warp as wp
from pxr import Usd, UsdShade

DEFAULT_WIDTH = 512
"""Width of a map nobody gave a size [px]."""


def write_map(
    layer_path: Path, output: Path, overrides: MapOverrides, progress: Progress
) -> RenderReport:
    """Write I(lambda, n) of a layer's light.

    The surface is the layer's skin material, or a white one (alpha = 1, S = 1, no scattering).

    Args:
        layer_path: Layer with a light; it is read, never changed.
        output: Spectral EXR to write; the picture is written beside it.
        overrides: What flags say.
        progress: Told about the work.

    Raises:
        UsdSkinError: The layer, an option or a file cannot be used.
    """
    begun = clock.perf_counter()
    notes: list[Note] = []
    width = _checked_width(overrides, output)
    png = output.with_suffix(".png")
    check_pictures((output, png), layer_path)
    flags = RenderOverrides(
        wavelength_nm=overrides.wavelength_nm,
        observer=overrides.observer,
        illuminant=overrides.illuminant,
        bad_pixels=overrides.bad_pixels,
        ev=overrides.ev,
        white=overrides.white,
        view=overrides.view,
        threads=overrides.threads,
        device=overrides.device,
    )
    with opened(layer_path, flags, notes) as stage:
        settings = read_settings(stage, flags)
        time = (
            Usd.TimeCode.EarliestTime()
            if overrides.frame is None
            else Usd.TimeCode(overrides.frame)
        )
        lights = _chosen_lights(stage, time, settings, overrides.light_prim, notes)
        skin = _chosen_skin(stage, time, settings, overrides, notes)
        frame = SpectralFrame(
            settings.wavelength_nm, settings.observer, lights.absolute, settings.color_space
        )
    xyz, spectrum = _shade(lights, skin, frame, width, settings, progress)
    progress.advance(1)
    progress.done()
    computed = clock.perf_counter()
    rgb = (xyz @ xyz_to_rgb(settings.color_space).T).astype(np.float32)
    header = {
        "usdskin/version": __version__,
        "usdskin/stage": layer_path.name,
        "usdskin/material": skin.path or "white",
        "usdskin/wrap": repr(skin.parameters.wrap),
        "usdskin/observer": settings.observer,
    }
    units = "W.m^-2.sr^-1.nm^-1" if lights.absolute else "relative"
    write_spectral_exr(
        output, settings.wavelength_nm, spectrum, rgb, units, header,
        settings.compression, color_space=settings.color_space,
    )  # fmt: skip
    opaque = np.ones((*rgb.shape[:2], 1), np.float32)
    render_png(
        png, np.concatenate([rgb, opaque], axis=-1), color_space=settings.color_space,
        ev=settings.ev, white=settings.white, scene_white_xyz=mean_white(lights, frame),
        view=settings.view, observer=settings.observer, metadata=header, notes=notes,
    )  # fmt: skip
    seconds = {"map": computed - begun, "write": clock.perf_counter() - computed}
    return RenderReport([output, png], notes, seconds)


def _checked_width(overrides: MapOverrides, output: Path) -> int:
    """Return the map's width; refuse flags that no layer could make right."""
    width = DEFAULT_WIDTH if overrides.width is None else overrides.width
    if width < 4 or width > 8192 or width % 2:
        raise UsageError(f"-w/--width {width}: must be an even number from 4 to 8192.")
    if overrides.wrap is not None and not 0.0 <= overrides.wrap <= 1.0:
        raise UsageError(f"--wrap {overrides.wrap:g}: must be from 0 to 1.")
    if output.suffix.lower() != ".exr":
        raise UsageError(f"-o/--output {output}: a map is a spectral EXR; end the name in .exr.")
    return width


def _chosen_lights(
    stage: Usd.Stage,
    time: Usd.TimeCode,
    settings: RenderSettings,
    requested: str | None,
    notes: list[Note],
) -> Lights:
    lights = read_lights(
        stage, time, settings.wavelength_nm, settings.observer, settings.illuminant,
        settings.bad_pixels, notes,
    )  # fmt: skip
    if requested is not None:
        found = [dome.path for dome in lights.domes]
        found += [distant.path for distant in lights.distants]
        if requested not in found:
            raise UsageError(
                f"--light {requested}: no such light shines; the layer has "
                f"{', '.join(found) or 'none'}."
            )
        lights = Lights(
            tuple(dome for dome in lights.domes if dome.path == requested),
            tuple(distant for distant in lights.distants if distant.path == requested),
        )
    if not lights.domes and not lights.distants:
        raise LayerError(
            f"{stage.GetRootLayer().identifier}: no light shines; a reflectance map needs a "
            "DomeLight or a DistantLight."
        )
    return lights


def _chosen_skin(
    stage: Usd.Stage,
    time: Usd.TimeCode,
    settings: RenderSettings,
    overrides: MapOverrides,
    notes: list[Note],
) -> SkinMaterial:
    """Return the material asked for, the only one, or a white surface; without its textures."""
    paths = [
        str(prim.GetPath())
        for prim in stage.Traverse()
        if prim.IsA(UsdShade.Material) and prim.HasAPI("SkinMaterialAPI")
    ]
    chosen = overrides.material
    if chosen is None and len(paths) == 1:
        chosen = paths[0]
    if chosen is not None and overrides.wrap is not None:
        raise UsageError(
            f"--wrap {overrides.wrap:g}: is for a white surface, and this map is <{chosen}>'s; "
            "leave it out, or change the material's inputs:skin:wrap."
        )
    if chosen is None:
        wrap = SkinParameters().wrap if overrides.wrap is None else overrides.wrap
        return SkinMaterial("", SkinParameters(wrap=wrap))
    if chosen not in paths:
        raise UsageError(
            f"--material {chosen}: no skin material there; the layer has "
            f"{', '.join(paths) or 'none'}."
        )
    material = read_materials(stage, [chosen], time, notes, settings.color_space)[chosen]
    assert isinstance(material, SkinMaterial)
    if material.albedo is not None or material.weights is not None:
        notes.append(
            Note("texture-ignored", chosen, "a map has no texture coordinates; S alone is shown")
        )
    skin = replace(material.parameters, albedo_file=None, weights_file=None, specular_weight=0.0)
    return replace(material, parameters=skin, albedo=None, weights=None, weights_high=None,
                   thickness_primvar=None)  # fmt: skip


def _shade(
    lights: Lights,
    skin: SkinMaterial,
    frame: SpectralFrame,
    width: int,
    settings: RenderSettings,
    progress: Progress,
) -> tuple[NDArray[np.float64], NDArray[np.float32]]:
    """Return XYZ [h, w, 3] and spectra [h, w, bands] at the middle of every texel."""
    workers = open_workers(settings.device, settings.threads)
    compilation.prepare((normals, reflectance_map), workers.device, progress)
    progress.start(1, "map")
    height, bands = width // 2, len(frame.wavelength_nm)
    wraps = wraps_of([skin])
    light = build_light_field(lights, wraps, workers, bands)
    surfaces = build_surfaces([skin], light.basis, frame, wraps, {}, {}, workers.device)
    turns, polar = np.meshgrid(
        (np.arange(width) + 0.5) / width, np.pi * (np.arange(height) + 0.5) / height
    )
    directions = latlong_directions(turns.ravel(), polar.ravel()).astype(np.float32)
    spectrum = np.zeros((len(directions), bands), np.float32)
    normal = wp.array(directions, dtype=wp.vec3f, device=workers.device)

    def work(begin: int, end: int) -> None:
        tile = structs.Film()
        tile.first_pixel = begin
        tile.channel = wp.zeros(
            (end - begin, surfaces.max_rows), dtype=wp.vec4f, device=workers.device
        )
        tile.xyza = wp.zeros(end - begin, dtype=wp.vec4f, device=workers.device)
        tile.spectrum = wp.zeros(
            (end - begin, band_groups(bands)), dtype=wp.vec4f, device=workers.device
        )
        normals.shade_normals(normal, light.device_lights, surfaces.device_materials, tile)
        spectrum[begin:end] = tile.spectrum.numpy().reshape(end - begin, -1)[:, :bands]

    workers.run(len(directions), 8192 if workers.device == "cpu" else len(directions), work)
    weights = xyz_weights(frame.wavelength_nm, frame.observer, frame.absolute)
    image = spectrum.reshape(height, width, bands)
    return image @ weights, image
