"""The light map of a captured panorama: each class of lamps with a recovery of its own."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from usdskin.errors import ImageError, UsageError
from usdskin.estimate.light.light_map import LightMap, rows_per_block
from usdskin.images import open_rows, read_headers, read_image
from usdskin.notes import Note
from usdskin.prims import CapturedPanorama, Recovery, SpectralCamera

FloatImage = NDArray[np.float32]

_CHANNELS = ("R", "G", "B")


@dataclass(frozen=True, slots=True, eq=False)
class Mixture:
    """Which recoveries make the light, and how much of each is in a texel."""

    recoveries: tuple[Recovery, ...]
    """One for each class."""

    weights: FloatImage | None
    """Share of each class, adding up to 1, shape [height, width, classes]; None: one class."""

    source: str
    """``only``, ``named``, ``map`` or ``estimated``."""

    @property
    def names(self) -> tuple[str, ...]:
        """Names of the classes."""
        return tuple(recovery.light_class for recovery in self.recoveries)


def find_mixture(
    capture: CapturedPanorama,
    camera: SpectralCamera,
    light_class: str | None,
    class_map: Path | None,
    notes: list[Note],
) -> Mixture:
    """Return the classes of lamps of a capture, and where they are.

    Args:
        capture: The capture.
        camera: The calibration, with a recovery for each class.
        light_class: The only class, where one is named.
        class_map: Picture of the classes, where one is given; else they are told apart by their
            chromaticity (``usdskin.estimate.classes``).
        notes: Takes what makes the classes uncertain.

    Raises:
        UsageError: There is no such class, or a map of a single class.
        ImageError: The panorama or the map cannot be used.
    """
    if light_class is not None and class_map is not None:
        raise UsageError("--class and --class-map exclude each other; a map holds several classes")
    if light_class is not None:
        return Mixture((_named(camera, light_class),), None, "named")
    if len(camera.recoveries) == 1:
        if class_map is not None:
            raise UsageError(
                f"--class-map {class_map}: {camera.where} knows one class of light, "
                f"{camera.recoveries[0].light_class}; calibrate with a chart in each, or leave "
                "the map out"
            )
        return Mixture(camera.recoveries, None, "only")
    names = tuple(recovery.light_class for recovery in camera.recoveries)
    height, width = panorama_size(capture)
    if class_map is not None:
        from usdskin.estimate.classes import read_class_map

        weights = read_class_map(class_map, names, height, width)
        return Mixture(camera.recoveries, np.asarray(weights, np.float32), "map")
    from usdskin.estimate.classes import estimate_class_weights

    pixels = np.empty((height, width, 3), np.float32)
    for begin, block in _panorama_rows(capture, height, width):
        np.divide(block, np.float32(capture.scale), out=pixels[begin : begin + len(block)])
    weights = estimate_class_weights(pixels, camera, notes, clipped=_clipped(capture))
    return Mixture(camera.recoveries, np.asarray(weights, np.float32), "estimated")


def _named(camera: SpectralCamera, name: str) -> Recovery:
    for recovery in camera.recoveries:
        if recovery.light_class == name:
            return recovery
    known = ", ".join(recovery.light_class for recovery in camera.recoveries)
    raise UsageError(f"--class {name}: {camera.where} has no such class of light; it has {known}")


def _clipped(capture: CapturedPanorama) -> FloatImage | None:
    """Return the share of each texel that was saturated, where the capture kept it."""
    if capture.stddev_file is None:
        return None
    image = read_image(capture.stddev_file, part="quality", channels=["clipped"])
    return image.pixels[..., 0]


def panorama_size(capture: CapturedPanorama) -> tuple[int, int]:
    """Return height and width of a capture's panorama.

    Raises:
        ImageError: It cannot be read, or is no latlong map.
    """
    header = read_headers(capture.panorama_file)[0]
    if header.width != 2 * header.height:
        raise ImageError(
            f"{capture.panorama_file} ({capture.where}): {header.width} x {header.height} pixels "
            "are not twice as wide as high, so no latlong panorama; name the capture's own"
        )
    return header.height, header.width


def captured_map(
    capture: CapturedPanorama,
    camera: SpectralCamera,
    mixture: Mixture,
    is_absolute: bool,
    darkened: dict[int, int],
) -> LightMap:
    """Return the light that the calibration recovers from a capture.

    Coefficient 3k + j is what class k gives to channel j of the panorama, whose pixels are rho
    times the capture's scale; so row 3k + j of the basis is column j of class k's recovery matrix
    divided by that scale. Where classes meet, a surface is taken to reflect them alike in each
    channel (J. von Kries, 1902): they give to channel j in proportion to their shares of luminance
    times the camera value that their light has of that luminance. Noise in the dark can give a
    texel camera values that no light has, and a spectrum with less than no energy: such texels are
    black.

    Args:
        capture: The capture.
        camera: The calibration.
        mixture: Its classes of lamps.
        is_absolute: Whether what comes out is, or will be made, absolute.
        darkened: Takes how many texels were made black, by the first row of their block.
    """
    height, width = panorama_size(capture)
    basis = np.concatenate([recovery.matrix.T for recovery in mixture.recoveries])
    lamps = None if mixture.weights is None else _lamp_values(camera, mixture)

    energy = basis.sum(axis=1).astype(np.float32)

    def blocks() -> Iterable[tuple[int, FloatImage]]:
        for begin, block in _panorama_rows(capture, height, width):
            coefficients = block
            if mixture.weights is not None and lamps is not None:
                shares = mixture.weights[begin : begin + block.shape[0]]
                coefficients = _parted(block, shares, lamps)
            dark = coefficients @ energy < 0.0
            darkened[begin] = int(np.count_nonzero(dark))
            if darkened[begin]:
                coefficients[dark] = 0.0
            yield begin, coefficients

    return LightMap(
        height=height,
        width=width,
        basis=basis / capture.scale,
        wavelength_nm=camera.wavelength_nm,
        is_absolute=is_absolute,
        classes=mixture.names,
        blocks=blocks,
    )


def _lamp_values(camera: SpectralCamera, mixture: Mixture) -> FloatImage:
    """Return the camera values of every class's lamp at luminance 1, shape [classes, 3]."""
    from usdskin.estimate.classes import read_lamps

    lamps = read_lamps(camera)
    rows = [lamps.names.index(name) for name in mixture.names]
    return np.asarray(lamps.camera_values[rows], np.float32)


def _parted(block: FloatImage, shares: FloatImage, lamps: FloatImage) -> FloatImage:
    """Return camera values parted by class, shape [height, width, 3 classes]; their sum stays.

    Args:
        block: Camera values, shape [height, width, 3].
        shares: Of the classes in luminance, shape [height, width, classes].
        lamps: Of ``_lamp_values``.
    """
    light = shares @ lamps
    reflected = block / np.where(light > 0.0, light, np.float32(1.0))
    parts = shares[..., :, None] * lamps * reflected[..., None, :]
    return np.asarray(parts.reshape(*block.shape[:2], -1), np.float32)


def _panorama_rows(
    capture: CapturedPanorama, height: int, width: int
) -> Iterable[tuple[int, FloatImage]]:
    """Give the panorama's pixels as stored, a block of rows at a time."""
    count = rows_per_block(width)
    with open_rows(capture.panorama_file, channels=_CHANNELS) as reader:
        for begin in range(0, height, count):
            block = reader.rows(begin, min(begin + count, height))
            if not np.isfinite(block).all():
                row, column = np.argwhere(~np.isfinite(block).all(axis=-1))[0]
                raise ImageError(
                    f"{capture.panorama_file} ({capture.where}): the pixel at x {column}, y "
                    f"{begin + row} is {_shown(block[row, column])}; capture the panorama anew"
                )
            yield begin, block


def _shown(pixel: Sequence[float] | FloatImage) -> str:
    return ", ".join(f"{float(value):g}" for value in pixel)
