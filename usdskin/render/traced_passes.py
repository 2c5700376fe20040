"""The samples of a traced pixel: how many, in what passes, and where in the pixel."""

from __future__ import annotations

import hashlib
from dataclasses import dataclass
from typing import Any

import numpy as np
import warp as wp

from usdskin.render.film import sample_offsets
from usdskin.render.integrate import WHOLE, Share

FIRST_SAMPLES = 16
"""Samples every pixel gets before any of them is judged."""

LEARNING = 4
"""Of these, samples from which blocks of pixels learn what they see."""

LEARNING_WEIGHT = 0.25
"""Weight of what they change; the rest of the first samples makes up for it."""

SPLIT_CAMERAS = 4
"""Least camera samples of a pass that takes several directions of light for each."""

LARGEST_SPLIT = 4
"""Most directions of light for one camera sample: a surface point costs a fourth of a direction."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Sampling:
    """How a picture is sampled."""

    samples: int
    """Most samples per pixel."""

    target_error: float
    """Standard error of a pixel's Y, relative to it, at which its sampling stops; 0 for never."""

    floor: float
    """Y below which errors count as if the pixel were this bright."""

    pixel_filter: str
    key: int
    """Of the seed and the frame."""

    share: Share = WHOLE
    """Which of the samples to take."""


@dataclass(frozen=True, slots=True)
class Pass:
    """Some samples of every pixel that takes part."""

    first: int
    """Index of the first direction of light in every pixel's sequence."""

    first_camera: int
    """Index of the first camera sample."""

    offsets: Any
    """Positions of the camera samples [px], on the device."""

    split: int
    """Directions of light that each of them takes."""

    weight: float = 1.0
    """Weight of what they change."""

    @property
    def count(self) -> int:
        """Directions of light that a pixel takes."""
        return len(self.offsets) * self.split


def sampling_key(seed: int, frame: float | None) -> int:
    """Return the key of a picture's random numbers, 32 bits that differ for every frame."""
    label = f"{seed}" if frame is None else f"{seed}/{frame:.6f}"
    return int.from_bytes(hashlib.sha256(label.encode()).digest()[:4], "little")


def list_passes(settings: Sampling, device: str, *, sharp: bool, learns: bool) -> list[Pass]:
    """Return the passes: the first samples, and then as many as there are before.

    Later passes of a ``sharp`` picture take several directions of light for each camera sample:
    what is noisy is the light. Every pass has its own camera samples. Where blocks of pixels
    ``learn``, the first samples are two passes: that to learn from weighs little, and the other
    makes up for it. The two halves of a pass are evenly spread over the pixel.
    """
    samples, begin = settings.share.size(settings.samples), settings.share.first(settings.samples)
    first = min(samples, FIRST_SAMPLES)
    moved = 16 * settings.share.index  # more than there are passes
    offsets = sample_offsets(first, settings.pixel_filter, _shift(moved))
    found = [(0, 0, offsets, 1, 1.0)]
    if learns and first == FIRST_SAMPLES:
        rest = first - LEARNING
        late = (first - LEARNING_WEIGHT * LEARNING) / rest
        early = np.arange(first) % (first // LEARNING) == 0
        found = [
            (0, 0, offsets[early], 1, LEARNING_WEIGHT),
            (LEARNING, LEARNING, offsets[~early], 1, late),
        ]
    taken = cameras_taken = first
    while taken < samples:
        more = min(taken, samples - taken)
        split = min(LARGEST_SPLIT, max(1, more // SPLIT_CAMERAS)) if sharp else 1
        cameras = max(1, more // split)
        shift = _shift(moved + len(found))
        offsets = sample_offsets(cameras, settings.pixel_filter, shift)
        found.append((taken, cameras_taken, offsets, split, 1.0))
        taken += cameras * split
        cameras_taken += cameras
    return [
        Pass(
            begin + at_sample,
            begin + at_camera,
            wp.array(np.concatenate([at[0::2], at[1::2]]), dtype=wp.vec2f, device=device),
            split,
            weight,
        )
        for at_sample, at_camera, at, split, weight in found
        if len(at)
    ]


def _shift(number: int) -> tuple[float, float]:
    return 0.754877666 * number % 1.0, 0.569840290 * number % 1.0
