"""Read what the figure of a light shows: spectra summed over the map, and a picture for the eye."""

from __future__ import annotations

from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from pxr import Usd, UsdLux

from usdskin.colorimetry import (
    cat16,
    encode_srgb,
    linear_color_space,
    linearize,
    rgb_to_xyz,
    white_xyz,
    xyz_to_rgb,
    xyz_weights,
)
from usdskin.errors import LayerError
from usdskin.images import RowReader, open_rows, read_headers, read_image, spectral_channels
from usdskin.latlong import texel_solid_angles
from usdskin.layers import describe
from usdskin.plots.light import LightSpectra
from usdskin.prims import LightEstimate, SpectralLight, read_light_estimate, read_spectral_light

FloatArray = NDArray[np.float64]
FloatImage = NDArray[np.float32]

_ROWS_PER_BLOCK = 64
_WIDTH, _SMALL_WIDTH = 1440, 720
_SPACE = "lin_rec709_scene"
_KEY = 0.2


def read_light_spectra(prim: Usd.Prim) -> LightSpectra:
    """Return what the figure of a light shows.

    The mean over the sphere is what the layer says, or is summed over the light's map. What each
    class of lamps adds is summed over the coefficients, three of which belong to each class.

    Args:
        prim: A light with ``SpectralLightAPI``.

    Raises:
        LayerError: An opinion cannot be used, or the light has no spectrum of its own.
        ImageError: A map cannot be read.
    """
    where = describe(prim)
    light = read_spectral_light(prim)
    estimate = read_light_estimate(prim)
    if light is None or light.source not in ("basis", "bands", "tabulated"):
        raise LayerError(
            f"{where}: has no spectrum of its own to draw; `usdskin estimate light` gives it one"
        )
    if light.source == "basis":
        summed = _from_basis(light, estimate)
    elif estimate is not None and estimate.mean is not None:
        summed = _Summed(estimate.mean.wavelength_nm, estimate.mean.value)
    elif light.source == "bands":
        summed = _from_bands(light)
    else:
        assert light.emission is not None  # read_spectral_light
        emission = light.emission
        summed = _Summed(emission.wavelength_nm, light.scale * emission.value)
    return LightSpectra(
        where=where,
        wavelength_nm=summed.wavelength_nm,
        mean=summed.mean,
        classes=summed.classes,
        class_shares=summed.class_shares,
        units=light.units,
        estimate=estimate,
        picture=_picture(prim, summed.mean @ xyz_weights(summed.wavelength_nm)),
    )


@dataclass(frozen=True, slots=True, eq=False)
class _Summed:
    """What is found in a light's own spectra; see ``LightSpectra``."""

    wavelength_nm: FloatArray
    mean: FloatArray
    classes: dict[str, FloatArray] = field(default_factory=dict)
    class_shares: FloatImage | None = None


def light_files(prim: Usd.Prim) -> list[Path]:
    """Return the files that a figure of a light is drawn from."""
    light = read_spectral_light(prim)
    files = [] if light is None else [light.coefficients_file, light.bands_file]
    return [path for path in (*files, _texture(prim)) if path is not None]


# --- Spectra -----------------------------------------------------------------------------------


def _from_basis(light: SpectralLight, estimate: LightEstimate | None) -> _Summed:
    """Return the mean radiance, and the part of each class where there are several."""
    basis, wavelength_nm = light.basis, light.basis_wavelength_nm
    assert basis is not None and wavelength_nm is not None and light.coefficients_file is not None
    names = () if estimate is None else estimate.classes
    names = names if len(names) > 1 and 3 * len(names) == len(basis) else ()
    channels = [f"c{index}" for index in range(len(basis))]
    with open_rows(light.coefficients_file, channels=channels) as reader:
        means = light.scale * _sphere_mean(reader)
        shares = _class_shares(reader, basis @ xyz_weights(wavelength_nm)[:, 1]) if names else None
    mean = means @ basis
    if estimate is not None and estimate.mean is not None:
        mean = estimate.mean.resample(wavelength_nm)
    parts = [means[3 * k : 3 * k + 3] @ basis[3 * k : 3 * k + 3] for k in range(len(names))]
    return _Summed(wavelength_nm, mean, dict(zip(names, parts, strict=True)), shares)


def _class_shares(reader: RowReader, luminous: FloatArray) -> FloatImage:
    """Return the share of each class in the luminance of a map, small.

    Args:
        reader: The coefficients, three of each class.
        luminous: Luminance of each, shape [3 * class_count].

    Returns:
        Shares [1], shape [class_count, height, width]; NaN where there is no light.
    """
    factor = -(-reader.header.width // _SMALL_WIDTH)
    height, width = (size // factor for size in (reader.header.height, reader.header.width))
    weights = luminous.astype(np.float32)
    rows_at_once = max(_ROWS_PER_BLOCK // factor, 1)
    small = []
    for begin in range(0, height, rows_at_once):
        count = min(rows_at_once, height - begin)
        block = reader.rows(begin * factor, (begin + count) * factor)[:, : width * factor]
        by_class = (block * weights).reshape(*block.shape[:2], -1, 3).sum(axis=-1)
        small.append(by_class.reshape(count, factor, width, factor, -1).sum(axis=(1, 3)))
    luminance = np.maximum(np.moveaxis(np.concatenate(small), -1, 0), 0.0)
    total = luminance.sum(axis=0)
    return np.asarray(luminance / np.where(total > 0.0, total, np.nan), dtype=np.float32)


def _from_bands(light: SpectralLight) -> _Summed:
    assert light.bands_file is not None
    for part, header in enumerate(read_headers(light.bands_file)):
        bands = spectral_channels(header.channel_names)
        if bands:
            names = [name for _, name in bands]
            with open_rows(light.bands_file, 1 << 16, part=part, channels=names) as reader:
                return _Summed(
                    np.array([nm for nm, _ in bands]), light.scale * _sphere_mean(reader)
                )
    raise LayerError(f"{light.bands_file}: has no spectral channels such as S0.550,000000nm")


def _sphere_mean(reader: RowReader) -> FloatArray:
    """Return the mean of a latlong map over the sphere, shape [channel_count]."""
    height, width = reader.header.height, reader.header.width
    sizes = texel_solid_angles(height, width) / (4.0 * np.pi)
    total = np.zeros(len(reader.channel_names))
    for begin in range(0, height, _ROWS_PER_BLOCK):
        end = min(begin + _ROWS_PER_BLOCK, height)
        total += sizes[begin:end] @ reader.rows(begin, end).sum(axis=1, dtype=np.float64)
    return total


# --- Picture -----------------------------------------------------------------------------------


def _texture(prim: Usd.Prim) -> Path | None:
    asset: Any = UsdLux.DomeLight(prim).GetTextureFileAttr().Get() if prim else None
    return Path(asset.resolvedPath) if asset is not None and asset.resolvedPath else None


def _picture(prim: Usd.Prim, white: FloatArray) -> FloatImage | None:
    """Return the light's RGB rendition for the eye, small, or None where there is none."""
    path = _texture(prim)
    if path is None:
        return None
    image = read_image(path)
    space = image.color_space if image.color_space not in (None, "data", "unknown") else _SPACE
    assert space is not None
    rgb = np.asarray(linearize(_reduced(image.pixels[..., :3]), space), dtype=np.float64)
    adapted = cat16(white / white[1], white_xyz(_SPACE))
    matrix = xyz_to_rgb(_SPACE) @ adapted @ rgb_to_xyz(linear_color_space(space))
    return _displayed(rgb @ matrix.T)


def _reduced(pixels: FloatImage) -> FloatImage:
    """Return a map no wider than a figure shows, whose pixels are means of the map's."""
    height, width = pixels.shape[:2]
    factor = -(-width // _WIDTH)
    if factor == 1:
        return pixels
    rows, columns = height // factor * factor, width // factor * factor
    blocks = pixels[:rows, :columns].reshape(rows // factor, factor, columns // factor, factor, 3)
    return np.asarray(blocks.mean(axis=(1, 3)), dtype=np.float32)


def _displayed(linear: FloatArray) -> FloatImage:
    """Return sRGB with the mean luminance in the lower middle and a shoulder for the lamps.

    The logarithmic mean comes to a key, and luminance L is shown as L (1 + L / W^2) / (1 + L)
    (Reinhard et al., "Photographic tone reproduction for digital images", 2002, equation 4).
    """
    linear = np.maximum(linear, 0.0)
    luminance = linear @ np.array([0.2126, 0.7152, 0.0722])
    lit = luminance > 0.0
    if not lit.any():
        return np.zeros(linear.shape, np.float32)
    sizes = np.broadcast_to(texel_solid_angles(*luminance.shape)[:, None], luminance.shape)[lit]
    middle = float(np.median(luminance[lit]))
    mean = np.exp(sizes @ np.log(luminance[lit] + 1e-3 * middle) / sizes.sum())
    exposed = linear * (_KEY / mean)
    grey = luminance * (_KEY / mean)
    white = max(float(np.quantile(grey, 0.999)), 2.0)
    shown = grey * (1.0 + grey / white**2) / (1.0 + grey)
    display = exposed * (shown / np.maximum(grey, 1e-9))[..., None]
    return np.asarray(np.clip(encode_srgb(np.clip(display, 0.0, 1.0)), 0.0, 1.0), np.float32)
