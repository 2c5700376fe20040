"""The light map of a captured panorama: each class of lamps with a recovery of its own."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from usdskin.errors import UsageError
from usdskin.estimate.classes.lamps import read_lamps
from usdskin.estimate.light.additivity import check_additivity
from usdskin.estimate.light.light_map import LightMap
from usdskin.estimate.light.naming import check_names
from usdskin.estimate.light.pictures import clipped_share, panorama_rows, panorama_size
from usdskin.estimate.light.switched import Switched, luminance_shares, switched_captures
from usdskin.notes import Note
from usdskin.prims import CapturedPanorama, Recovery, SpectralCamera
from usdskin.spectrum import band_widths

FloatImage = NDArray[np.float32]


@dataclass(frozen=True, slots=True, eq=False)
class Mixture:
    """Which recoveries make the light, and how much of each is in a texel."""

    recoveries: tuple[Recovery, ...]
    """One for each class."""

    weights: FloatImage | None
    """Share of each class, adding up to 1, shape [height, width, classes]; None: one class."""

    switched: Switched | None = None
    """What every class was measured to give; None: the weights and von Kries tell."""

    @property
    def names(self) -> tuple[str, ...]:
        """Names of the classes."""
        return tuple(recovery.light_class for recovery in self.recoveries)


def find_mixture(
    capture: CapturedPanorama,
    camera: SpectralCamera,
    light_class: str | None,
    class_map: Path | None,
    class_captures: Mapping[str, CapturedPanorama],
    notes: list[Note],
) -> Mixture:
    """Return the classes of lamps of a capture, and where they are.

    Args:
        capture: The capture.
        camera: The calibration, with a recovery for each class.
        light_class: The only class, where one is named.
        class_map: Picture of the classes, where one is given.
        class_captures: Captures of the place with one class alone, where there are some. Without
            either, classes are told apart by their chromaticity (``usdskin.estimate.classes``).
        notes: Takes what makes the classes uncertain.

    Raises:
        UsageError: There is no such class, a map of a single class, or too few captures.
        ImageError: A panorama or the map cannot be used.
        LayerError: Captures do not fit together.
    """
    if class_captures and (light_class is not None or class_map is not None):
        flag = "--class" if class_map is None else "--class-map"
        raise UsageError(f"{flag} and --class-capture exclude each other; captures say it all")
    if light_class is not None and class_map is not None:
        raise UsageError("--class and --class-map exclude each other; a map holds several classes")
    if light_class is not None:
        return Mixture((_named(camera, light_class),), None)
    if len(camera.recoveries) == 1:
        if class_map is not None or class_captures:
            flag = f"map {class_map}" if class_map else f"capture {next(iter(class_captures))}"
            raise UsageError(
                f"--class-{flag}: {camera.where} knows one class of light, "
                f"{camera.recoveries[0].light_class}; calibrate with a chart in each, or leave "
                "it out"
            )
        return Mixture(camera.recoveries, None)
    names = tuple(recovery.light_class for recovery in camera.recoveries)
    if class_captures:
        switched = switched_captures(capture, class_captures, camera)
        missing = next((name for name in names if name not in class_captures), None)
        given = check_additivity(capture, class_captures, missing, notes)
        check_names(given, class_captures, read_lamps(camera))
        weights = luminance_shares(switched, camera)
        return Mixture(camera.recoveries, weights, switched)
    height, width = panorama_size(capture)
    if class_map is not None:
        from usdskin.estimate.classes import read_class_map

        weights = read_class_map(class_map, names, height, width)
        return Mixture(camera.recoveries, np.asarray(weights, np.float32))
    from usdskin.estimate.classes import estimate_class_weights

    pixels = np.empty((height, width, 3), np.float32)
    for begin, block in panorama_rows(capture, height, width):
        np.divide(block, np.float32(capture.scale), out=pixels[begin : begin + len(block)])
    weights = estimate_class_weights(pixels, camera, notes, clipped=clipped_share(capture))
    return Mixture(camera.recoveries, np.asarray(weights, np.float32))


def _named(camera: SpectralCamera, name: str) -> Recovery:
    for recovery in camera.recoveries:
        if recovery.light_class == name:
            return recovery
    known = ", ".join(recovery.light_class for recovery in camera.recoveries)
    raise UsageError(f"--class {name}: {camera.where} has no such class of light; it has {known}")


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
    divided by that scale. What classes give was measured where each was captured alone; else, where
    they meet, a surface is taken to reflect them alike in each channel (J. von Kries, 1902): they
    give to channel j in proportion to their shares of luminance times the camera value that their
    light has of that luminance. Noise in the dark can give a texel camera values that no light has,
    and a spectrum with less than no energy: such texels are black.

    Args:
        capture: The capture.
        camera: The calibration.
        mixture: Its classes of lamps.
        is_absolute: Whether what comes out is, or will be made, absolute.
        darkened: Takes how many texels were made black, by the first row of their block.
    """
    height, width = panorama_size(capture)
    basis = np.concatenate([recovery.matrix.T for recovery in mixture.recoveries])
    energy = (basis @ band_widths(camera.wavelength_nm)).astype(np.float32)

    def blocks() -> Iterable[tuple[int, FloatImage]]:
        for begin, coefficients in _coefficients(capture, camera, mixture, height, width):
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


def _coefficients(
    capture: CapturedPanorama, camera: SpectralCamera, mixture: Mixture, height: int, width: int
) -> Iterator[tuple[int, FloatImage]]:
    """Give what each class gives to each channel, a block of rows at a time."""
    rows = panorama_rows(capture, height, width)
    if mixture.switched is not None:
        for (begin, block), (_, shares) in zip(rows, mixture.switched.blocks(), strict=True):
            parts = block[:, :, None, :] * shares
            yield begin, parts.reshape(*block.shape[:2], -1)
    elif mixture.weights is not None:
        lamps = _lamp_values(camera, mixture)
        for begin, block in rows:
            yield begin, _parted(block, mixture.weights[begin : begin + len(block)], lamps)
    else:
        yield from rows


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
