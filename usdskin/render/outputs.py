"""A picture's arrays as the files a product asks for.

Writes: ``OUT.exr`` (beauty and data parts), ``OUT.spectral.exr`` and ``OUT.png``.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from usdskin import __version__
from usdskin.colorimetry import xyz_to_rgb
from usdskin.image_output import Part, write_exr, write_spectral_exr
from usdskin.notes import Note
from usdskin.render.aovs import MATTES, TRACED_SOURCES
from usdskin.render.cameras import Camera
from usdskin.render.checkpoint import Arrays
from usdskin.render.cryptomatte import matte_parts, metadata
from usdskin.render.integrate import DeviceScene, Picture
from usdskin.render.job import RenderSettings
from usdskin.render.preview import render_png
from usdskin.render.products import Product

FloatImage = NDArray[np.float32]


@dataclass(frozen=True, slots=True, eq=False)
class Shot:
    """What the headers of a picture tell about where it came from."""

    stage: str
    """File name of the stage."""

    frame: float | None
    digest: str
    """Hash of the settings."""

    prim_paths: tuple[str, ...]
    """Path of every primId."""

    material_names: tuple[str, ...]
    """Path of every material; ``displayColor`` shows what is bound to none."""

    absolute: bool
    """Whether radiance is in W m^-2 sr^-1 nm^-1."""

    scene_white: NDArray[np.float64]
    """XYZ of a perfect diffuser under the mean light, shape [3]."""


def exposed_rgb(picture: Picture, camera: Camera, settings: RenderSettings) -> FloatImage:
    """Return the beauty: linear RGB of the rendering space at the camera's exposure, and alpha."""
    matrix = xyz_to_rgb(settings.color_space) * camera.exposure_scale
    beauty = np.empty_like(picture.xyza)
    np.matmul(picture.xyza[..., :3], matrix.T.astype(np.float32), out=beauty[..., :3])
    beauty[..., 3] = picture.xyza[..., 3]
    return beauty


def write_picture(
    product: Product,
    files: dict[str, Path],
    picture: Picture,
    data: dict[str, FloatImage],
    scene: DeviceScene,
    camera: Camera,
    settings: RenderSettings,
    shot: Shot,
    notes: list[Note],
) -> list[Path]:
    """Write the files of one product at one frame; each appears whole or not at all.

    Args:
        product: What to write.
        files: File of each kind that is wanted: ``exr``, ``spectral``, ``png``.
        picture: The rendered arrays.
        data: Pixel-centre data (``collect_data``).
        scene: The scene it was rendered from.
        camera: The camera it was rendered through.
        settings: The settings it was rendered with.
        shot: What goes into the headers.
        notes: Takes that the PNG could not be adapted to its white.

    Returns:
        The files written, in order.
    """
    beauty = exposed_rgb(picture, camera, settings)
    header = _header(shot, product, settings, camera)
    placed = placement_attributes(camera)
    written = []
    if "exr" in files:
        parts = []
        if product.beauty:
            parts.append(
                Part(
                    "beauty",
                    {"": beauty},
                    {**header, **placed},
                    "half" if product.half else "float",
                    settings.color_space,
                )
            )
        for aov in product.aovs:
            if aov.source in MATTES:
                names = matte_names(shot)[aov.source]
                parts += matte_parts(aov.name, data[aov.source], names, placed)
                if product.beauty:  # where most programs look for it
                    first = {**parts[0].attributes, **metadata(aov.name, names)}
                    parts[0] = replace(parts[0], attributes=first)
                continue
            if aov.source in TRACED_SOURCES:
                part = _traced_part(aov.name, picture.extra[aov.source], camera, settings)
            else:
                part = _data_part(aov.name, aov.source, data, scene, settings, shot)
            parts.append(replace(part, attributes={**part.attributes, **placed}))
        write_exr(
            files["exr"],
            parts,
            settings.compression,
            pixel_aspect_ratio=camera.pixel_aspect_ratio,
        )
        written.append(files["exr"])
    if "spectral" in files:
        if picture.spectrum is None:
            raise ValueError("the picture was rendered without spectra")
        write_spectral_exr(
            files["spectral"],
            settings.wavelength_nm,
            picture.spectrum,
            beauty,
            "W.m^-2.sr^-1.nm^-1" if shot.absolute else "relative",
            {**header, **placed},
            settings.compression,
            color_space=settings.color_space,
            pixel_aspect_ratio=camera.pixel_aspect_ratio,
        )
        written.append(files["spectral"])
    if "png" in files:
        render_png(
            files["png"],
            beauty,
            color_space=settings.color_space,
            ev=settings.ev,
            white=settings.white,
            scene_white_xyz=shot.scene_white,
            view=settings.view,
            observer=settings.observer,
            metadata=header,
            notes=notes,
        )
        written.append(files["png"])
    return written


def output_notes(picture: Picture, files: dict[str, Path], product: Product) -> list[Note]:
    """Return notes that nothing is seen, and that spectra of an earlier render are left beside.

    Args:
        picture: The rendered arrays.
        files: What is written of it.
        product: What it is of.
    """
    notes = []
    if not picture.xyza[..., 3].any():
        text = "sees nothing: look at its transform and clipping range, at --mask and purposes."
        notes.append(Note("nothing-seen", product.camera, text))
    if "exr" in files and "spectral" not in files:
        left = files["exr"].with_suffix(".spectral.exr")
        if left.is_file():
            text = "is left of an earlier render; remove it, or render with --spectral."
            notes.append(Note("spectra-left", str(left), text))
    return notes


def previewing(
    product: Product, camera: Camera, settings: RenderSettings, shot: Shot
) -> Callable[[Path, Arrays], None]:
    """Return what writes a PNG of an unfinished picture; what is not finished is transparent."""
    width, height = product.resolution

    def write(path: Path, arrays: Arrays) -> None:
        picture = Picture(arrays["xyza"].reshape(height, width, 4).copy(), None)
        render_png(
            path,
            exposed_rgb(picture, camera, settings),
            color_space=settings.color_space,
            ev=settings.ev,
            white=settings.white,
            scene_white_xyz=shot.scene_white,
            view=settings.view,
            observer=settings.observer,
        )

    return write


def _header(
    shot: Shot, product: Product, settings: RenderSettings, camera: Camera
) -> dict[str, str]:
    header = {
        "usdskin/version": __version__,
        "usdskin/stage": shot.stage,
        "usdskin/camera": camera.path,
        "usdskin/seed": str(settings.seed),
        "usdskin/samples": str(settings.samples_per_pixel),
        "usdskin/integrator": settings.integrator,
        "usdskin/observer": settings.observer,
        "usdskin/units": "W.m^-2.sr^-1.nm^-1" if shot.absolute else "relative",
        "usdskin/exposureScale": repr(float(camera.exposure_scale)),
        "usdskin/settingsHash": shot.digest,
    }
    if shot.frame is not None:
        header["usdskin/frame"] = f"{shot.frame:g}"
    if product.prim_path:
        header["usdskin/product"] = product.prim_path
    return header


def placement_attributes(camera: Camera) -> dict[str, Any]:
    """Return header attributes that tell where a picture was seen from.

    ``worldToCamera`` is OpenEXR's standard attribute: it multiplies row vectors from the right, as
    all its matrices do, and takes the positions [m] of the part P to the camera, which looks along
    its -Z. ``usdskin/projection`` is ``perspective`` or ``orthographic``.

    Args:
        camera: The camera.
    """
    return {
        "worldToCamera": np.linalg.inv(camera.to_world).T,
        "usdskin/projection": "orthographic" if camera.orthographic else "perspective",
    }


def _traced_part(name: str, values: FloatImage, camera: Camera, settings: RenderSettings) -> Part:
    """Return a part that tracing measured: light as exposed RGB, like the beauty, or numbers."""
    if values.ndim == 2:
        return Part(name, {name: values})
    matrix = xyz_to_rgb(settings.color_space) * camera.exposure_scale
    rgb = values @ matrix.T.astype(np.float32)
    return Part(name, {name: rgb}, {}, "float", settings.color_space)


def matte_names(shot: Shot) -> dict[str, tuple[str, ...]]:
    """Return what each matte tells apart, by matte."""
    return dict(zip(MATTES, (shot.prim_paths, shot.material_names), strict=True))


def _data_part(
    name: str,
    source: str,
    data: dict[str, FloatImage],
    scene: DeviceScene,
    settings: RenderSettings,
    shot: Shot,
) -> Part:
    if source == "N":
        return Part(name, {"N": data["normal"]})
    if source == "P":
        return Part(name, {"P": data["position"]})
    if source == "Z":
        return Part(name, {"Z": data["depth"]})
    if source == "st":
        return Part(name, {"st": data["st"]})
    if source == "albedo":
        return Part(name, {"albedo": _albedo(data, scene)}, {}, "float", settings.color_space)
    if source == "irradiance":
        rgb = data["irradiance"] @ xyz_to_rgb(settings.color_space).T.astype(np.float32)
        return Part(name, {"irradiance": rgb}, {}, "float", settings.color_space)
    if source == "primId":
        face = data["face"]
        ids = np.zeros(face.shape, np.uint32)
        ids[face >= 0] = scene.faces.prim[face[face >= 0]] + 1
        names = {
            "usdskin/primIds": "\n".join(f"{k + 1} {p}" for k, p in enumerate(shot.prim_paths))
        }
        return Part(name, {"primId": ids}, names, "uint")
    raise ValueError(f"unknown data part {source!r}")


def _albedo(data: dict[str, FloatImage], scene: DeviceScene) -> FloatImage:
    """Return the RGB reflectance under D65 of what the pixel's middle sees."""
    face = data["face"]
    result = np.zeros((*face.shape, 3), np.float32)
    material = np.where(face >= 0, scene.faces.material[np.maximum(face, 0)], -1)
    for index in np.unique(material[material >= 0]):
        bases = scene.albedo[index]
        at = material == index
        weights = data["base"][at]
        if len(bases) == 1:
            result[at] = bases[0]
        else:
            count = min(len(bases), 4)
            result[at] = weights[:, :count] @ bases[:count]
    return result
