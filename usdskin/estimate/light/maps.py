"""Write a light map's pictures a block of rows at a time.

Writes: coefficients (``c0``, ``c1``, ...) or bands (the layout of Fichet and others, see
``usdskin.spectral_layout``), and the RGB rendition for tools that know no spectra.
"""

from __future__ import annotations

from contextlib import ExitStack
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from usdskin import __version__
from usdskin.estimate.light.light_map import RENDITION_SPACE, LightMap
from usdskin.exr_rows import RowWriter, open_exr_writer
from usdskin.latlong import texel_solid_angles
from usdskin.progress import Progress
from usdskin.spectral_layout import channel_name
from usdskin.spectrum import band_widths

FloatArray = NDArray[np.float64]
FloatImage = NDArray[np.float32]

Form = Literal["basis", "bands"]

# The last bits of photographs are noise: higher levels cost time and save nothing.
_COMPRESSION = "zip:1"
# 61 channels of them took 8 times as long zipped as plain, and were 6 % smaller.
_BANDS_COMPRESSION = "none"

_BAND_ROWS = 16


@dataclass(frozen=True, slots=True)
class MapFiles:
    """The pictures of a light."""

    rendition: Path
    """RGB rendition."""

    coefficients: Path | None = None
    """Coefficients of the basis form."""

    bands: Path | None = None
    """Spectra of the bands form."""

    classes: Path | None = None
    """Shares of the classes of lamps, of mixed light."""

    def paths(self) -> tuple[Path, ...]:
        """Return those there are."""
        every = (self.coefficients, self.bands, self.rendition, self.classes)
        return tuple(path for path in every if path is not None)


def map_files(output: Path, form: Form, is_mixed: bool) -> MapFiles:
    """Return the names of the pictures beside a layer: they begin with its name."""
    begin = output.with_suffix("")

    def named(ending: str) -> Path:
        return begin.with_name(f"{begin.name}.{ending}.exr")

    return MapFiles(
        rendition=named("rgb"),
        coefficients=named("coefficients") if form == "basis" else None,
        bands=named("bands") if form == "bands" else None,
        classes=named("classes") if is_mixed else None,
    )


@dataclass(frozen=True, slots=True)
class WrittenMaps:
    """What was found on the way."""

    clipped_energy: float | None
    """Share of the energy of all bands that was negative and set to 0 [1]; None where nothing was
    cut off."""

    outside_rendition: float
    """Share of the sphere whose color the rendition cannot hold [1]."""


def write_maps(light: LightMap, files: MapFiles, scratch: Path, progress: Progress) -> WrittenMaps:
    """Write the pictures of a light, all but its classes.

    Args:
        light: The light.
        files: Their names.
        scratch: Folder they are written to, under those names.
        progress: Told of every row.

    Raises:
        ImageError: A picture cannot be read or written.
    """
    writer = _Maps(light)
    header = _header(light)
    with ExitStack() as stack:

        def opened(path: Path, names: list[str], space: str, **more: Any) -> RowWriter:
            options = {"attributes": header, "compression": _COMPRESSION} | more
            return stack.enter_context(
                open_exr_writer(
                    scratch / path.name,
                    light.width,
                    light.height,
                    names,
                    color_space=space,
                    **options,
                )
            )

        rendition = opened(files.rendition, ["R", "G", "B"], RENDITION_SPACE)
        coefficients = bands = None
        if files.coefficients is not None:
            names = [f"c{index}" for index in range(light.rank)]
            coefficients = opened(files.coefficients, names, "data")
        if files.bands is not None:
            names = [*"RGB", *map(channel_name, light.wavelength_nm)]
            bands = opened(
                files.bands,
                names,
                RENDITION_SPACE,
                attributes=header | _spectral_header(light),
                compression=_BANDS_COMPRESSION,
            )
        progress.start(light.height, "write")
        for begin, block in light.blocks():
            rgb = writer.rendition(begin, block)
            rendition.write(begin, rgb)
            if coefficients is not None:
                coefficients.write(begin, block)
            if bands is not None:
                writer.write_bands(bands, begin, block)
            progress.advance(block.shape[0])
        progress.done()
    return writer.written(files.bands is not None)


def _header(light: LightMap) -> dict[str, Any]:
    return {
        "usdskin/version": __version__,
        "usdskin/units": "absolute" if light.is_absolute else "relative",
        "software": f"usdskin {__version__}",
    }


def _spectral_header(light: LightMap) -> dict[str, Any]:
    units = "W.m^-2.sr^-1.nm^-1" if light.is_absolute else "relative"
    return {"spectralLayoutVersion": "1.0", "emissiveUnits": units}


class _Maps:
    def __init__(self, light: LightMap) -> None:
        self._rgb = light.rgb.astype(np.float32)
        self._wide = np.concatenate((light.rgb, light.basis), axis=1).astype(np.float32)
        widths_nm = band_widths(light.wavelength_nm)
        self._bands = np.concatenate((np.zeros(3), widths_nm)).astype(np.float32)
        self._total = (light.basis @ widths_nm).astype(np.float32)
        self._size = texel_solid_angles(light.height, light.width)
        self._negative = self._energy = self._outside = 0.0

    def rendition(self, begin: int, block: FloatImage) -> FloatImage:
        """Return linear RGB without negative values, which other tools cannot bear."""
        rgb = block @ self._rgb
        # Beyond rounding: a grey surface is not out of gamut.
        red, green, blue = np.moveaxis(rgb, -1, 0)
        lowest = np.minimum(np.minimum(red, green), blue)
        outside = lowest < -1e-3 * np.maximum(np.maximum(red, green), blue)
        rows = slice(begin, begin + block.shape[0])
        self._outside += float(self._size[rows] @ outside.sum(axis=1))
        return np.asarray(np.maximum(rgb, np.float32(0.0)), np.float32)

    def write_bands(self, writer: RowWriter, begin: int, block: FloatImage) -> None:
        """Write preview and spectra of some rows, negative values set to 0."""
        for first in range(0, block.shape[0], _BAND_ROWS):
            rows = block[first : first + _BAND_ROWS]
            count, width = rows.shape[:2]
            # One product, and few passes over it: memory is what this waits for.
            pixels = (rows.reshape(-1, rows.shape[2]) @ self._wide).reshape(count, width, -1)
            np.maximum(pixels, np.float32(0.0), out=pixels)
            writer.write(begin + first, pixels)
            size = self._size[begin + first : begin + first + count]
            energy = (rows @ self._total).sum(axis=1, dtype=np.float64)
            kept = (pixels @ self._bands).sum(axis=1, dtype=np.float64)
            self._negative += float(size @ (kept - energy))
            self._energy += float(size @ (2.0 * kept - energy))

    def written(self, is_cut: bool) -> WrittenMaps:
        """Return what was found."""
        share = self._negative / self._energy if self._energy > 0.0 else 0.0
        return WrittenMaps(max(share, 0.0) if is_cut else None, self._outside / (4.0 * np.pi))
