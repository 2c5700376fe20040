"""What each class of lamps gives, measured: captures of a place with one class switched on alone.

Light adds up, so camera values do, texel by texel and channel by channel: no color of any surface
has to be guessed, as a class map has to.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from usdskin.colorimetry import xyz_weights
from usdskin.errors import ImageError, LayerError, UsageError
from usdskin.estimate.light.pictures import panorama_rows, panorama_size
from usdskin.prims import CapturedPanorama, SpectralCamera

FloatImage = NDArray[np.float32]


@dataclass(frozen=True, slots=True, eq=False)
class Switched:
    """Captures of one place: with all its lamps, and with each class of them alone."""

    whole: CapturedPanorama
    """With all lamps on."""

    alone: tuple[CapturedPanorama | None, ...]
    """With each class alone; None for one class at most, whose light is what the others leave."""

    def blocks(self) -> Iterator[tuple[int, FloatImage]]:
        """Give each class's share of the camera values, a block of rows at a time.

        Yields:
            The first row, and shares that add up to 1 in each channel, shape [rows, width,
            classes, 3].
        """
        height, width = panorama_size(self.whole)
        captures = [capture for capture in self.alone if capture is not None]
        if len(captures) < len(self.alone):
            captures.append(self.whole)
        readers = [panorama_rows(capture, height, width) for capture in captures]
        for parts in zip(*readers, strict=True):
            found = [
                np.maximum(block, 0.0) / np.float32(capture.scale)
                for capture, (_, block) in zip(captures, parts, strict=True)
            ]
            if len(found) > len(self.alone) - self.alone.count(None):
                rest = np.maximum(found.pop() - sum(found), 0.0)
                found.insert(self.alone.index(None), rest)
            values = np.stack(found, axis=2)
            total = values.sum(axis=2, keepdims=True)
            dark = total <= 0.0
            even = np.float32(1.0 / len(self.alone))
            yield parts[0][0], np.where(dark, even, values / np.where(dark, 1.0, total))


def switched_captures(
    whole: CapturedPanorama, alone: Mapping[str, CapturedPanorama], camera: SpectralCamera
) -> Switched:
    """Check the captures of single classes against the whole one.

    Args:
        whole: With all lamps on.
        alone: With one class alone, by its name.
        camera: The calibration, with a recovery for each class.

    Raises:
        UsageError: A class is not known, or more than one has no capture.
        LayerError: A capture's frame is another's.
        ImageError: A panorama has another size.
    """
    names = [recovery.light_class for recovery in camera.recoveries]
    for name in alone:
        if name not in names:
            raise UsageError(
                f"--class-capture {name}: {camera.where} has no such class of light; it has "
                f"{', '.join(names)}"
            )
    missing = [name for name in names if name not in alone]
    if len(missing) > 1:
        raise UsageError(
            f"--class-capture: {', '.join(missing)} have none; all classes but one need a capture "
            "in which they shine alone"
        )
    size = panorama_size(whole)
    for name, capture in alone.items():
        other = panorama_size(capture)
        if other != size:
            raise ImageError(
                f"{capture.panorama_file} ({capture.where}): {other[1]} x {other[0]} pixels, but "
                f"{whole.panorama_file} has {size[1]} x {size[0]}; capture {name} at that size"
            )
        if capture.up_axis != whole.up_axis:
            raise LayerError(
                f"--class-capture {name} ({capture.where}): its up axis is {capture.up_axis}, that "
                f"of the whole capture, {whole.where}, is {whole.up_axis}; ingest both alike"
            )
    return Switched(whole, tuple(alone.get(name) for name in names))


def luminance_shares(switched: Switched, camera: SpectralCamera) -> FloatImage:
    """Return the share of each class in the luminance of every texel.

    Args:
        switched: The captures.
        camera: The calibration, whose recoveries say what camera values mean to the eye.

    Returns:
        Shares that add up to 1, shape [height, width, classes].
    """
    luminosity = xyz_weights(camera.wavelength_nm)[:, 1]
    eye = np.stack([luminosity @ recovery.matrix for recovery in camera.recoveries])
    height, width = panorama_size(switched.whole)
    weights = np.empty((height, width, len(eye)), np.float32)
    whole = panorama_rows(switched.whole, height, width)
    for (begin, shares), (_, block) in zip(switched.blocks(), whole, strict=True):
        values = np.einsum("ijc,ijkc,kc->ijk", block, shares, eye.astype(np.float32))
        values = np.maximum(values, 0.0)
        total = values.sum(axis=2, keepdims=True)
        lit = total > 0.0
        even = np.float32(1.0 / len(eye))
        weights[begin : begin + len(block)] = np.where(lit, values / np.where(lit, total, 1), even)
    return weights
