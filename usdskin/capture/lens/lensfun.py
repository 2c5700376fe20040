"""Read a lens of Lensfun's database, ``.xml``.

Lensfun measures in three ways ("About coordinate systems in Lensfun" in its ``modifier.cpp``,
0.3.99; 0.3.4 differs in what it calls the real focal length): the projection and Adobe's models in
focal lengths; ``ptlens``, ``poly3`` and ``poly5`` in halves of the shorter side, and the vignetting
``pa`` in halves of the diagonal, both of a picture with the crop factor and aspect ratio of the
calibration. A picture's diagonal is that of 36 x 24 mm over the camera's crop factor. ``ptlens`` is
``r' = (a r^3 + b r^2 + c r + 1 - a - b - c) r`` with r the ideal image height at the nominal focal
length, or at ``real-focal`` over (1 - a - b - c) where that is given.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from xml.etree import ElementTree

import numpy as np
from numpy.typing import NDArray

from usdskin.capture.lens.curve import IDEAL, Curve, FileLens, named
from usdskin.errors import UsageError, UsdSkinError
from usdskin.notes import Note

FloatArray = NDArray[np.float64]

_TYPES = {
    "fisheye": "equidistant",
    "equisolid": "equisolid",
    "stereographic": "stereographic",
    "orthographic": "orthographic",
    "thoby": "thoby",
}
_FULL_FRAME_DIAGONAL_MM = float(np.hypot(36.0, 24.0))
_DEFAULT_ASPECT = 1.5
_CROP_TOLERANCE = 0.02


@dataclass(frozen=True, slots=True)
class LensfunChoice:
    """Which of a database's entries is meant."""

    lens: str | None = None
    """Part of the lens's name."""

    resolution: tuple[int, int] | None = None
    """Width and height of the pictures [px]."""

    crop_factor: float | None = None
    """Of the camera [1]; that of the calibration where ``None``."""

    focal_length_mm: float | None = None
    """As engraved on the lens [mm]."""

    f_number: float | None = None
    """Of the pictures, for the vignetting."""


def read_lensfun(path: Path, choice: LensfunChoice, notes: list[Note]) -> FileLens:
    """Return a fisheye lens of a database.

    Args:
        path: File of the database.
        choice: Which entries are meant.
        notes: Takes what was left out.

    Raises:
        UsageError: The choice leaves several entries, or none.
        UsdSkinError: The file is no database of Lensfun's.
    """
    if choice.resolution is None:
        raise UsageError(
            f"{path}: a Lensfun lens fits pictures of any size; give theirs, such as "
            "--resolution 6000x4000"
        )
    lens, calibration = _choose_lens(path, choice)
    where = f"{path} {_name(lens)!r}"
    calibrated_crop = _crop(lens, calibration)
    crop = choice.crop_factor or calibrated_crop
    if crop < calibrated_crop * (1.0 - _CROP_TOLERANCE):
        raise UsageError(
            f"{where}: was calibrated with a crop factor of {calibrated_crop:g} and does not reach "
            f"the edge of pictures with {crop:g}; choose another entry or calibrate the lens"
        )
    width, height = choice.resolution
    px_per_mm = float(np.hypot(width, height)) * crop / _FULL_FRAME_DIAGONAL_MM
    diagonal_mm = _FULL_FRAME_DIAGONAL_MM / calibrated_crop
    half_side_mm = 0.5 * diagonal_mm / float(np.hypot(_aspect(where, lens, calibration), 1.0))

    distortion = _choose_distortion(where, calibration, choice)
    focal_mm = _focal(where, lens, distortion, choice)
    projection = _TYPES[_text(lens, "type")]
    height_mm, real_focal_mm, ideal = _height(
        where, IDEAL[projection], distortion, focal_mm, half_side_mm
    )
    vignetting = _vignetting(where, calibration, choice, focal_mm, notes)
    unit_px = px_per_mm * (
        real_focal_mm if vignetting is not None and vignetting[0] == "acm" else 0.5 * diagonal_mm
    )
    terms = np.concatenate([[1.0], vignetting[1]]) if vignetting is not None else None
    return FileLens(
        where=where,
        radius=lambda angle: px_per_mm * height_mm(angle),
        center_px=_center(lens, width, height),
        resolution=choice.resolution,
        exact=named(projection, px_per_mm * real_focal_mm) if ideal else None,
        not_radial=_tangential(distortion, px_per_mm * real_focal_mm, IDEAL[projection]),
        vignetting=None
        if terms is None
        else lambda radius: np.asarray(
            np.polynomial.polynomial.polyval((radius / unit_px) ** 2, terms)
        ),
    )


def _choose_lens(
    path: Path, choice: LensfunChoice
) -> tuple[ElementTree.Element, ElementTree.Element]:
    try:
        root = ElementTree.fromstring(path.read_bytes())
    except ElementTree.ParseError as error:
        raise UsdSkinError(
            f"{path}: is no XML ({error}); give a file of Lensfun's data/db"
        ) from None
    if root.tag != "lensdatabase":
        raise UsdSkinError(f"{path}: is no lens database of Lensfun's; its root is <{root.tag}>")
    fisheyes = [lens for lens in root.findall("lens") if _text(lens, "type") in _TYPES]
    wanted = (choice.lens or "").casefold()
    found = [
        (lens, calibration)
        for lens in fisheyes
        if any(wanted in name.casefold() for name in _names(lens))
        for calibration in lens.findall("calibration") or [ElementTree.Element("calibration")]
    ]
    if not found:
        listed = "; ".join(sorted({_name(lens) for lens in fisheyes})) or "none at all"
        raise UsageError(f"{path}: no fisheye lens {choice.lens!r}; --lens names one of: {listed}")
    if len(found) > 1 and choice.crop_factor is not None:
        usable = [
            pair for pair in found if _crop(*pair) <= choice.crop_factor * (1.0 + _CROP_TOLERANCE)
        ]
        nearest = max((_crop(*pair) for pair in usable), default=0.0)
        found = [pair for pair in usable if _crop(*pair) == nearest] or found
    if len(found) > 1:
        listed = "; ".join(f"{_name(pair[0])} (crop factor {_crop(*pair):g})" for pair in found)
        raise UsageError(
            f"{path}: several lenses fit; choose by --lens and the camera's --crop-factor: {listed}"
        )
    return found[0]


def _names(lens: ElementTree.Element) -> list[str]:
    makers = [element.text or "" for element in lens.findall("maker")]
    models = [element.text or "" for element in lens.findall("model")]
    return [*models, *(f"{maker} {model}" for maker in makers for model in models)]


def _name(lens: ElementTree.Element) -> str:
    return _text(lens, "model") or "a lens without a name"


def _text(element: ElementTree.Element, tag: str) -> str:
    return (element.findtext(tag) or "").strip()


def _crop(lens: ElementTree.Element, calibration: ElementTree.Element) -> float:
    return _number(
        _name(lens), "cropfactor", calibration.get("cropfactor") or _text(lens, "cropfactor")
    )


def _aspect(where: str, lens: ElementTree.Element, calibration: ElementTree.Element) -> float:
    text = calibration.get("aspect-ratio") or _text(lens, "aspect-ratio")
    if not text:
        return _DEFAULT_ASPECT
    sides = [_number(where, "aspect-ratio", part) for part in text.split(":")]
    return sides[0] / sides[1] if len(sides) == 2 else sides[0]


def _number(where: str, name: str, text: str | None) -> float:
    try:
        value = float(text or "")
    except ValueError:
        value = float("nan")
    if not np.isfinite(value) or (name in ("cropfactor", "aspect-ratio", "focal") and value <= 0.0):
        raise UsdSkinError(f"{where}: {name} is {text!r}; a number is needed, so correct the file")
    return value


def _choose_distortion(
    where: str, calibration: ElementTree.Element, choice: LensfunChoice
) -> ElementTree.Element | None:
    entries = calibration.findall("distortion")
    if choice.focal_length_mm is not None and entries:
        focals = [_number(where, "focal", entry.get("focal")) for entry in entries]
        entries = [
            entry
            for entry, focal in zip(entries, focals, strict=True)
            if abs(focal / choice.focal_length_mm - 1.0) < 1e-3
        ]
        if not entries:
            raise UsageError(
                f"{where}: has no distortion for --focal-length {choice.focal_length_mm:g}, only "
                f"for {', '.join(f'{focal:g}' for focal in focals)} mm"
            )
    if len(entries) > 1:
        listed = ", ".join(str(entry.get("focal")) for entry in entries)
        raise UsageError(f"{where}: is a zoom lens; choose one of --focal-length {listed}")
    return entries[0] if entries else None


def _focal(
    where: str,
    lens: ElementTree.Element,
    distortion: ElementTree.Element | None,
    choice: LensfunChoice,
) -> float:
    if distortion is not None:
        return _number(where, "focal", distortion.get("focal"))
    element = lens.find("focal")
    stated = element.get("value") if element is not None else None
    if choice.focal_length_mm is None and stated is None:
        raise UsageError(f"{where}: says no focal length; give --focal-length")
    return choice.focal_length_mm or _number(where, "focal", stated)


def _height(
    where: str,
    ideal: Curve,
    distortion: ElementTree.Element | None,
    focal_mm: float,
    half_side_mm: float,
) -> tuple[Curve, float, bool]:
    """Return image height [mm] over the angle, real focal length [mm], and if there is no more."""
    model = "none" if distortion is None else distortion.get("model", "")

    def term(name: str) -> float:
        assert distortion is not None
        return _number(where, name, distortion.get(name, "0"))

    if model in ("poly3", "ptlens"):
        a, c = (term("a"), term("c")) if model == "ptlens" else (0.0, 0.0)
        b = term("b") if model == "ptlens" else term("k1")
        rest = 1.0 - a - b - c
        real = _real_focal(where, distortion, focal_mm * rest)

        def hugin(angle: FloatArray) -> FloatArray:
            r = real / rest * ideal(angle) / half_side_mm
            return np.asarray(half_side_mm * r * (((a * r + b) * r + c) * r + rest))

        return hugin, real, False
    real = _real_focal(where, distortion, focal_mm)
    if model == "none":
        return lambda angle: real * ideal(angle), real, True
    if model == "poly5":
        unit, even = half_side_mm / real, [term("k1"), term("k2")]
    elif model == "acm":
        unit, even = 1.0, [term("k1"), term("k2"), term("k3")]
    else:
        raise UsdSkinError(f"{where}: distortion model {model!r} is unknown; calibrate the lens")

    def polynomial(angle: FloatArray) -> FloatArray:
        r = ideal(angle)
        return np.asarray(
            real * r * np.polynomial.polynomial.polyval((r / unit) ** 2, [1.0, *even])
        )

    return polynomial, real, False


def _real_focal(where: str, distortion: ElementTree.Element | None, otherwise_mm: float) -> float:
    given = None if distortion is None else distortion.get("real-focal")
    return otherwise_mm if given is None else _number(where, "focal", given)


def _tangential(
    distortion: ElementTree.Element | None, focal_px: float, ideal: Curve
) -> Curve | None:
    if distortion is None or distortion.get("model") != "acm":
        return None
    k4, k5 = (float(distortion.get(name, "0")) for name in ("k4", "k5"))
    return lambda angle: 3.0 * float(np.hypot(k4, k5)) * focal_px * ideal(angle) ** 2


def _vignetting(
    where: str,
    calibration: ElementTree.Element,
    choice: LensfunChoice,
    focal_mm: float,
    notes: list[Note],
) -> tuple[str, list[float]] | None:
    """Return model and terms of the vignetting at an f-number and the farthest distance."""
    entries = [
        entry
        for entry in calibration.findall("vignetting")
        if abs(_number(where, "focal", entry.get("focal")) / focal_mm - 1.0) < 1e-3
    ]
    stops = sorted({_number(where, "aperture", entry.get("aperture")) for entry in entries})
    listed = ", ".join(f"{stop:g}" for stop in stops)
    if choice.f_number is None:
        if entries:
            message = f"its vignetting is left out; --f-number takes it over, one of {listed}"
            notes.append(Note("vignetting-left-out", where, message))
        return None
    fitting = [
        entry
        for entry in entries
        if abs(_number(where, "aperture", entry.get("aperture")) / choice.f_number - 1.0) < 0.02
    ]
    if not fitting:
        raise UsageError(
            f"{where}: has no vignetting for --f-number {choice.f_number:g}, only for "
            f"{listed or 'none at all'}; leave it out and measure the vignetting"
        )
    entry = max(fitting, key=lambda item: _number(where, "distance", item.get("distance", "0")))
    model = entry.get("model", "")
    names = {"pa": ("k1", "k2", "k3"), "acm": ("alpha1", "alpha2", "alpha3")}
    if model not in names:
        raise UsdSkinError(f"{where}: vignetting model {model!r} is unknown; leave --f-number out")
    return model, [_number(where, name, entry.get(name, "0")) for name in names[model]]


def _center(lens: ElementTree.Element, width: int, height: int) -> FloatArray:
    """Return the axis [px]; Lensfun states it in halves of the shorter side off the middle."""
    element = lens.find("center")
    shift = [0.0, 0.0]
    if element is not None:
        shift = [_number(_name(lens), axis, element.get(axis, "0")) for axis in ("x", "y")]
    return np.array([width, height]) / 2.0 + 0.5 * (min(width, height) - 1) * np.array(shift)
