"""The white of a comparison: a perfect diffuser at the truth's brightest irradiance."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from usdskin.colorimetry import DEFAULT_OBSERVER, Observer
from usdskin.errors import UsageError
from usdskin.judge.comparison.files import ComparedPicture, read_irradiance
from usdskin.notes import Note

FloatArray = NDArray[np.float64]
Mask = NDArray[np.bool_]


def diffuser_white(
    truth: ComparedPicture,
    mask: Mask,
    observer: Observer,
    given: tuple[float, float, float] | None,
) -> tuple[FloatArray, str]:
    """Return the XYZ of the perfect diffuser, and where it was found.

    The part ``irradiance`` holds what falls on the surface at each pixel's middle, shadows left
    out; a perfect diffuser sends a pi-th of it.

    Args:
        truth: The true picture.
        mask: Pixels that are judged.
        observer: Whose eyes.
        given: XYZ to be taken in place of the picture's, if any.

    Raises:
        UsageError: The truth has no irradiance, or not for this observer.
    """
    if given is not None:
        xyz = np.array(given, dtype=np.float64)
        if not (np.isfinite(xyz).all() and (xyz > 0.0).all()):
            raise UsageError("--diffuser: X, Y and Z of a white are positive numbers.")
        return xyz, "--diffuser"
    found = read_irradiance(truth)
    remedy = "render the truth with --aov irradiance, or give --diffuser X,Y,Z."
    if found is None:
        raise UsageError(
            f"{truth.path}: no part irradiance, so no white to compare under; {remedy}"
        )
    if (truth.observer or DEFAULT_OBSERVER) != observer:
        raise UsageError(
            f"{truth.path}: its irradiance is seen by {truth.observer or DEFAULT_OBSERVER}, not by "
            f"{observer}; render the truth for that observer, or give --diffuser X,Y,Z."
        )
    y = np.where(mask & np.isfinite(found).all(axis=-1), found[..., 1], -np.inf)
    row, column = np.unravel_index(int(np.argmax(y)), y.shape)
    xyz = found[row, column] / np.pi
    if not (np.isfinite(xyz).all() and (xyz > 0.0).all()):
        raise UsageError(
            f"{truth.path}: its part irradiance is black within the mask (it holds domes and "
            "distant lights alone); give --diffuser X,Y,Z."
        )
    return xyz, f"irradiance of the truth at column {column}, row {row}"


def note_bright(luminance: FloatArray, truth: ComparedPicture, notes: list[Note]) -> None:
    """Tell where the truth is brighter than what is meant to be its white.

    Args:
        luminance: Of the judged pixels, as a share of Y_n.
        truth: The true picture.
        notes: Takes the note.
    """
    brighter = float((luminance > 1.0).mean())
    if brighter > 0.0:
        notes.append(
            Note(
                "brighter-than-white",
                str(truth.path),
                f"{brighter:.2%} of the mask is brighter than the perfect diffuser (up to "
                f"{luminance.max():.3g} Y_n); lustre is, but so is light that the part irradiance "
                "leaves out (lamps other than domes and distant lights): give --diffuser then.",
            )
        )
