"""The skin's pigments over the head, as weights of a few spectra.

Every texel gets a fraction of melanin and of blood; the library's ``skin_spectra`` makes a
reflectance of them, and the weights are those of the basis whose sum is nearest to it.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import warp as wp
from bake import workers
from library import TONES, WAVELENGTH_NM, Pigments, reflectance
from numpy.typing import NDArray

FloatArray = NDArray[np.float64]
Float32Array = NDArray[np.float32]

TONE = "tone3"
"""The library's skin that the cheek's plain skin is."""

MELANIN, BLOOD = TONES[TONE].melanin, TONES[TONE].blood
"""Its fractions [1]."""

LIPS_SCATTERING = 0.35
"""Scattering of their epidermis relative to that of other skin's [1]."""

CORNERS = (
    Pigments(0.020, 0.006),
    Pigments(0.020, 0.080, epidermis_scattering=0.0),
    Pigments(0.100, 0.020),
    Pigments(0.550, 0.010, epidermis_scattering=0.0),
)
"""Skins whose spectra are the basis: pale, lips, tanned, and hair, which only absorbs."""


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
    """Where the lips meet, in the middle."""

    mouth_half_width: float
    """From there to a corner of the mouth [m]."""

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
    total = wp.float32(0.0)
    height = wp.float32(1.0)
    scale = wp.float32(frequency)
    for _k in range(octaves):
        total += height * wp.noise(state, point[i] * scale)
        height = height * 0.5
        scale = scale * 2.0
    value[i] = total


def noise(position: Float32Array, size_m: float, octaves: int, seed: int) -> Float32Array:
    """Return noise of about -1..1 whose largest grains have a given size."""
    value = np.zeros(len(position), np.float32)

    def work(begin: int, end: int) -> None:
        point = wp.array(position[begin:end], dtype=wp.vec3f, device="cpu", copy=False)
        part = wp.array(value[begin:end], dtype=wp.float32, device="cpu", copy=False)
        inputs = [point, 1.0 / size_m, octaves, seed, part]
        wp.launch(_noise_kernel, dim=end - begin, inputs=inputs, device="cpu")

    position = np.ascontiguousarray(position, np.float32)
    workers().run(len(position), 1 << 18, work)
    return value


def smooth(low: float, high: float, value: NDArray) -> NDArray:
    """Return 0 below ``low``, 1 above ``high`` and a smooth way between (either order)."""
    t = np.clip((value - low) * (1.0 / (high - low)), 0.0, 1.0)
    return t * t * (3.0 - 2.0 * t)


def scalp(position: NDArray, marks: Landmarks) -> NDArray:
    """Return how much hair grows at points of the head, 0..1: the hairline of a shorn head.

    Args:
        position: Positions [m], shape [point_count, 3].
        marks: Landmarks.
    """
    x, y, z = ((position - marks.skull.astype(np.float32)) / np.float32(0.1)).T
    around = np.degrees(np.arctan2(np.abs(x), z))
    up = np.degrees(np.arctan2(y, np.hypot(x, z)))
    # Height of the hairline over the way around: brow, temple, sideburn, behind the ear, nape.
    line = np.interp(
        around,
        [0.0, 18.0, 31.0, 41.0, 49.0, 55.0, 60.0, 67.0, 72.0, 92.0, 99.0, 115.0, 140.0, 180.0],
        [34.0, 35.0, 36.5, 30.0, 20.0, 8.0, -13.0, -17.0, -4.5, -4.0, -14.0, -26.0, -36.0, -40.0],
    )
    ragged = noise(position.astype(np.float32), 0.006, 3, 71) * 3.2
    return smooth(-4.0, 6.0, up - line + ragged)


BROW = np.array(
    [
        # Along the brow: distance from the middle of the face, height over the eyes, half width.
        (0.00, 0.0110, 0.0180, 0.0040), (0.20, 0.0190, 0.0205, 0.0050),
        (0.45, 0.0290, 0.0230, 0.0044), (0.70, 0.0400, 0.0240, 0.0032),
        (1.00, 0.0535, 0.0165, 0.0010),
    ]
)  # fmt: skip
"""The brows' outline [m]."""


def brow(position: NDArray, marks: Landmarks) -> NDArray:
    """Return where the brows are, 0..1, shape [point_count]."""
    place = position - marks.eyes.astype(np.float32)
    x = np.abs(place[:, 0])
    height = np.interp(x, BROW[:, 1], BROW[:, 2])
    half = np.interp(x, BROW[:, 1], BROW[:, 3])
    across = np.abs(place[:, 1] - height) / half
    ends = smooth(BROW[0, 1] - 0.002, BROW[0, 1] + 0.006, x) * smooth(0.056, 0.048, x)
    return smooth(1.25, 0.35, across) * ends * (position[:, 2] > marks.eyes[2] - 0.03)


def pigments(texels: Texels, marks: Landmarks) -> tuple[NDArray, NDArray, NDArray, NDArray]:
    """Return melanin and blood fractions and the shares of hair and lips, [texel_count] each."""
    p = texels.position
    eye = (p - marks.eyes.astype(np.float32)) / np.float32(marks.half_gap)
    side = np.abs(eye[:, 0])
    mouth = p - marks.mouth.astype(np.float32)
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

    blood = np.full(len(p), BLOOD, np.float32)
    blood *= np.exp(0.40 * mottle + 0.30 * fine)
    blood *= 1.0 + 0.9 * spot(1.25, -1.15, 0.75, 0.6)
    nose = np.exp(-((np.linalg.norm(p - marks.nose_tip.astype(np.float32), axis=1) / 0.017) ** 2))
    blood *= 1.0 + 1.0 * nose
    blood *= 1.0 + 1.2 * mark("ears")
    blood *= 1.0 + 0.7 * mark("eyelids")
    blood *= 1.0 + 0.25 * spot(0.95, -0.55, 0.55, 0.22)
    blood *= 1.0 - 0.30 * spot(0.0, 1.9, 2.2, 0.9)
    blood *= 1.0 + 0.5 * smooth(0.012, 0.0, np.abs(mouth[:, 1])) * spot(0.0, -2.2, 0.95, 0.5)
    blood *= 1.0 + 0.2 * smooth(1.50, 1.42, p[:, 1])
    lips = smooth(0.15, 0.95, mark("lips") + 0.12 * fine)
    lines = noise(p * np.float32([1.0, 0.12, 0.12]), 0.0011, 2, 14)
    blood += lips * (0.046 * np.exp(0.35 * lines + 0.25 * mottle) - blood)
    blood += mark("inside-mouth") * 0.08

    melanin = np.full(len(p), MELANIN, np.float32)
    melanin *= np.exp(0.18 * noise(p, 0.03, 3, 21) + 0.13 * fine)
    melanin *= 1.0 + 0.22 * spot(0.95, -0.6, 0.5, 0.25) + 0.15 * mark("eyelids")
    melanin *= 1.0 + 0.15 * spot(0.0, 2.2, 2.5, 0.8)
    melanin *= 1.0 - lips * (0.45 - 0.1 * lines)
    freckle = smooth(0.42, 0.62, noise(p, 0.0030, 1, 22)) * smooth(-0.3, 0.6, veins)
    melanin *= 1.0 + 1.1 * freckle * (spot(1.0, -0.9, 1.1, 0.5) + 0.25 * spot(0.0, -0.6, 0.7, 0.6))
    mole = smooth(0.66, 0.74, noise(p, 0.0055, 1, 37))
    melanin *= 1.0 + 2.0 * mole * front

    return melanin, blood, hair_share(texels, marks), lips


def hair_share(texels: Texels, marks: Landmarks) -> NDArray:
    """Return the share of the skin under stubble or at the foot of hair, shape [texel_count]."""
    p = texels.position
    mouth = p - marks.mouth.astype(np.float32)
    grain = noise(p, 0.0006, 2, 52)

    # The beard: moustache, chin and jaw, fading up the cheek and down the neck.
    x = np.abs(mouth[:, 0])
    cheek = -0.004 + 0.95 * np.maximum(x - 0.030, 0.0)
    jaw = smooth(0.010, -0.006, mouth[:, 1] - cheek) * smooth(-0.070, -0.045, mouth[:, 1])
    lip = smooth(0.0235, 0.017, mouth[:, 1]) * smooth(0.038, 0.026, x)
    beard = np.maximum(jaw, lip) * smooth(marks.skull[2] - 0.005, marks.skull[2] + 0.02, p[:, 2])
    bare = smooth(0.10, 0.5, texels.mask["lips"]) + texels.mask["inside-mouth"]
    bare = bare + smooth(0.05, 0.4, texels.mask["ears"])
    beard *= 1.0 - np.clip(bare, 0.0, 1.0)
    beard *= 0.75 + 0.35 * noise(p, 0.012, 2, 51)
    share = beard * (0.16 + 0.42 * smooth(0.15, 0.5, grain))

    head = scalp(p, marks) * (1.0 - smooth(0.2, 0.7, texels.mask["ears"]))
    share = np.maximum(share, head * (0.90 + 0.08 * grain))
    share = np.maximum(share, 0.42 * brow(p, marks) * (0.8 + 0.5 * grain))
    return np.clip(share, 0.0, 0.95)


def weights(melanin: NDArray, blood: NDArray, hair: NDArray, lips: NDArray) -> Float32Array:
    """Return the weights of ``basis()`` for pigments, shape [texel_count, 4].

    The epidermis of lips has hardly any horn and is taken to be clearer.
    """
    melanin_at = np.geomspace(0.006, 0.3, 24)
    blood_at = np.geomspace(0.002, 0.2, 24)

    def place(value: NDArray, at: NDArray) -> tuple[NDArray, NDArray]:
        found = np.interp(np.log(value), np.log(at), np.arange(24.0))
        whole = np.clip(found.astype(np.int32), 0, 22)
        return whole, (found - whole).astype(np.float32)[:, None]

    i, u = place(melanin, melanin_at)
    j, v = place(blood, blood_at)

    def mixed(epidermis_scattering: float) -> NDArray:
        table = _fitted(melanin_at, blood_at, epidermis_scattering)
        low = table[i, j] * (1 - u) + table[i + 1, j] * u
        return low * (1 - v) + (table[i, j + 1] * (1 - u) + table[i + 1, j + 1] * u) * v

    part = lips.astype(np.float32)[:, None]
    found = mixed(1.0) * (1.0 - part) + mixed(LIPS_SCATTERING) * part
    share = hair.astype(np.float32)[:, None]
    return found * (1.0 - share) + np.float32([0.0, 0.0, 0.0, 1.0]) * share


def _fitted(melanin_at: FloatArray, blood_at: FloatArray, scattering: float) -> Float32Array:
    """Return the weights nearest to skins with each pair of fractions, shape [m, b, 4]."""
    skins = [Pigments(m, b, epidermis_scattering=scattering) for m in melanin_at for b in blood_at]
    table = np.array([reflectance(WAVELENGTH_NM, skin) for skin in skins])
    found = np.linalg.lstsq(basis().T, table.T, rcond=None)[0]
    return found.T.reshape(len(melanin_at), len(blood_at), 4).astype(np.float32)
