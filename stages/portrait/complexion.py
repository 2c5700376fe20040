"""The skin's pigments over the head, as weights of a few spectra.

Every texel gets a fraction of melanin and of blood; ``skin_spectra`` makes a reflectance of them,
and the weights are those of the basis whose sum is nearest to it.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import warp as wp
from numpy.typing import NDArray

from skin_spectra import WAVELENGTH_NM, Pigments, reflectance

FloatArray = NDArray[np.float64]
Float32Array = NDArray[np.float32]

MELANIN, BLOOD = 0.020, 0.014
"""Fractions of the cheek's plain skin [1]."""

CORNERS = (
    Pigments(0.012, 0.006),
    Pigments(0.012, 0.080),
    Pigments(0.050, 0.020),
    Pigments(0.300, 0.010),
)
"""Skins whose spectra are the basis: pale, flushed, tanned, and hair."""


def basis() -> FloatArray:
    """Return the reflectances that the weights multiply [1], shape [4, band_count]."""
    return np.stack([reflectance(WAVELENGTH_NM, corner) for corner in CORNERS])


@dataclass(frozen=True, slots=True, eq=False)
class Landmarks:
    """Places on the head [m], shape [3] each."""

    eyes: FloatArray
    """Midway between the eyes."""

    half_gap: float
    """From there to an eye's centre [m]."""

    mouth: FloatArray
    nose_tip: FloatArray
    skull: FloatArray
    """Inside the head, at the height of the eyes above the ears."""


@dataclass(frozen=True, slots=True, eq=False)
class Texels:
    """What is known of the covered texels."""

    position: Float32Array
    """Position [m], shape [texel_count, 3]."""

    normal: Float32Array
    """Unit normal, shape [texel_count, 3]."""

    mask: dict[str, Float32Array]
    """Shares of ``lips``, ``ears``, ``eyelids`` and ``inside-mouth``, shape [texel_count]."""


@wp.kernel(enable_backward=False)
def _noise_kernel(
    # In:
    point: wp.array(dtype=wp.vec3f),
    frequency: wp.float32,
    octaves: wp.int32,
    seed: wp.int32,
    # Out:
    value: wp.array(dtype=wp.float32),
):
    """Sum gradient noise over octaves.

    Launch dimension: [point_count].

    Args:
        point: Positions [m], shape [point_count].
        frequency: Of the first octave [m^-1]; each following has twice that and half the height.
        octaves: How many.
        seed: Seed.
        value: About -1..1, shape [point_count].
    """
    i = wp.tid()
    state = wp.rand_init(seed)
    total = float(0.0)
    height = float(1.0)
    scale = float(frequency)
    for _k in range(octaves):
        total += height * wp.noise(state, point[i] * scale)
        height = height * 0.5
        scale = scale * 2.0
    value[i] = total


def noise(position: Float32Array, size_m: float, octaves: int, seed: int) -> Float32Array:
    """Return noise of about -1..1 whose largest grains have a given size."""
    value = wp.zeros(len(position), dtype=wp.float32, device="cpu")
    point = wp.array(np.ascontiguousarray(position), dtype=wp.vec3f, device="cpu")
    wp.launch(
        _noise_kernel,
        dim=len(position),
        inputs=[point, 1.0 / size_m, octaves, seed, value],
        device="cpu",
    )
    return value.numpy()


def smooth(low: float, high: float, value: NDArray) -> NDArray:
    """Return 0 below ``low``, 1 above ``high`` and a smooth way between (either order)."""
    t = np.clip((value - low) / (high - low), 0.0, 1.0)
    return t * t * (3.0 - 2.0 * t)


def scalp(position: NDArray, marks: Landmarks) -> NDArray:
    """Return how much hair grows at points of the head, 0..1: the hairline of a shorn head.

    Args:
        position: Positions [m], shape [point_count, 3].
        marks: Landmarks.
    """
    x, y, z = ((position - marks.skull) / 0.1).T
    around = np.degrees(np.arctan2(np.abs(x), z))
    up = np.degrees(np.arctan2(y, np.hypot(x, z)))
    # Height of the hairline over the way around: brow, temple, sideburn, behind the ear, nape.
    line = np.interp(
        around,
        [0.0, 18.0, 34.0, 46.0, 58.0, 70.0, 79.0, 86.0, 97.0, 112.0, 140.0, 180.0],
        [37.5, 38.5, 40.0, 34.0, 22.0, 6.0, -14.0, -10.0, 0.0, -22.0, -36.0, -40.0],
    )
    ragged = noise(position.astype(np.float32), 0.006, 3, 71) * 2.4
    return smooth(-2.5, 3.5, up - line + ragged)


def pigments(texels: Texels, marks: Landmarks) -> tuple[NDArray, NDArray, NDArray]:
    """Return melanin and blood fractions, and the share that is hair, shape [texel_count] each."""
    p = texels.position
    eye = (p - marks.eyes) / marks.half_gap
    side = np.abs(eye[:, 0])
    mouth = p - marks.mouth
    front = smooth(-0.2, 0.5, texels.normal[:, 2])

    def spot(x: float, y: float, width: float, height: float) -> NDArray:
        """Return a soft spot on both halves of the face; in half eye distances from the eyes."""
        fall = ((side - x) / width) ** 2 + ((eye[:, 1] - y) / height) ** 2
        return np.exp(-fall) * smooth(0.0, 0.06, p[:, 2] - marks.skull[2])

    def mark(name: str) -> NDArray:
        return texels.mask[name]

    mottle = noise(p, 0.022, 4, 11)
    fine = noise(p, 0.0035, 3, 12)
    veins = noise(p, 0.009, 2, 13)

    blood = np.full(len(p), BLOOD)
    blood *= np.exp(0.32 * mottle + 0.16 * fine)
    blood *= 1.0 + 1.15 * spot(1.25, -1.15, 0.75, 0.6)
    nose = np.exp(-((np.linalg.norm(p - marks.nose_tip, axis=1) / 0.017) ** 2))
    blood *= 1.0 + 1.2 * nose
    blood *= 1.0 + 1.6 * mark("ears")
    blood *= 1.0 + 0.7 * mark("eyelids")
    blood *= 1.0 + 0.45 * spot(0.95, -0.55, 0.55, 0.22)
    blood *= 1.0 - 0.30 * spot(0.0, 1.9, 2.2, 0.9)
    blood *= 1.0 + 0.5 * smooth(0.012, 0.0, np.abs(mouth[:, 1])) * spot(0.0, -2.2, 0.95, 0.5)
    blood *= 1.0 + 0.2 * smooth(1.50, 1.42, p[:, 1])
    lips = smooth(0.25, 0.85, mark("lips"))
    blood += lips * (0.060 * (1.0 + 0.25 * fine) - blood)
    blood += mark("inside-mouth") * 0.08

    melanin = np.full(len(p), MELANIN)
    melanin *= np.exp(0.16 * noise(p, 0.03, 3, 21) + 0.10 * fine)
    melanin *= 1.0 + 0.22 * spot(0.95, -0.6, 0.5, 0.25) + 0.15 * mark("eyelids")
    melanin *= 1.0 + 0.15 * spot(0.0, 2.2, 2.5, 0.8)
    melanin *= 1.0 - 0.25 * lips
    freckle = smooth(0.42, 0.62, noise(p, 0.0030, 1, 22)) * smooth(-0.3, 0.6, veins)
    melanin *= 1.0 + 1.1 * freckle * (spot(1.0, -0.9, 1.1, 0.5) + 0.25 * spot(0.0, -0.6, 0.7, 0.6))
    mole = smooth(0.66, 0.74, noise(p, 0.0055, 1, 37))
    melanin *= 1.0 + 2.0 * mole * front

    return melanin, blood, hair_share(texels, marks)


def hair_share(texels: Texels, marks: Landmarks) -> NDArray:
    """Return the share of the skin under stubble or at the foot of hair, shape [texel_count]."""
    p = texels.position
    mouth = p - marks.mouth
    random = np.random.default_rng(5).uniform(0.0, 1.0, len(p)).astype(np.float32)

    # The beard: moustache, chin and jaw, fading up the cheek and down the neck.
    x = np.abs(mouth[:, 0])
    cheek = -0.004 + 0.95 * np.maximum(x - 0.030, 0.0)
    jaw = smooth(0.010, -0.006, mouth[:, 1] - cheek) * smooth(-0.088, -0.060, mouth[:, 1])
    lip = smooth(0.0235, 0.017, mouth[:, 1]) * smooth(0.038, 0.026, x)
    beard = np.maximum(jaw, lip) * smooth(marks.skull[2] - 0.005, marks.skull[2] + 0.02, p[:, 2])
    bare = smooth(0.10, 0.5, texels.mask["lips"]) + texels.mask["inside-mouth"]
    beard *= 1.0 - np.clip(bare, 0.0, 1.0)
    beard *= 0.75 + 0.35 * noise(p, 0.012, 2, 51)
    share = beard * (0.10 + 0.42 * (random < 0.16))

    head = scalp(p, marks) * (1.0 - smooth(0.2, 0.7, texels.mask["ears"]))
    share = np.maximum(share, head * (0.52 + 0.30 * random))
    return np.clip(share, 0.0, 0.95)


def weights(melanin: NDArray, blood: NDArray, hair: NDArray) -> Float32Array:
    """Return the weights of ``basis()`` for pigments, shape [texel_count, 4]."""
    spectra = basis()
    melanin_at = np.geomspace(0.004, 0.2, 24)
    blood_at = np.geomspace(0.002, 0.2, 24)
    table = np.array(
        [[reflectance(WAVELENGTH_NM, Pigments(m, b)) for b in blood_at] for m in melanin_at]
    )
    fitted = np.linalg.lstsq(spectra.T, table.reshape(-1, table.shape[2]).T, rcond=None)[0]
    fitted = fitted.T.reshape(24, 24, 4).astype(np.float32)

    def position(value: NDArray, at: NDArray) -> tuple[NDArray, NDArray]:
        place = np.interp(np.log(value), np.log(at), np.arange(24.0))
        whole = np.clip(place.astype(np.int32), 0, 22)
        return whole, (place - whole).astype(np.float32)[:, None]

    i, u = position(melanin, melanin_at)
    j, v = position(blood, blood_at)
    found = (fitted[i, j] * (1 - u) + fitted[i + 1, j] * u) * (1 - v) + (
        fitted[i, j + 1] * (1 - u) + fitted[i + 1, j + 1] * u
    ) * v
    share = hair.astype(np.float32)[:, None]
    return found * (1.0 - share) + np.float32([0.0, 0.0, 0.0, 1.0]) * share
