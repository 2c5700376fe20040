"""What a photograph says about how it was taken.

Reads: EXIF, XMP and the standard attributes of EXR through OpenImageIO; raw files through rawpy
       (LibRaw), and those that are TIFF inside (DNG, NEF, ARW, CR2, ...) through OpenImageIO too.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from datetime import datetime
from pathlib import Path
from typing import Any

import OpenImageIO

from usdskin.errors import ImageError, UsageError
from usdskin.images import read_headers
from usdskin.photographs.frames import RAW_SUFFIXES

_TIME = ("ExposureTime",)
_F_NUMBER = ("FNumber",)
_ISO = (
    "Exif:PhotographicSensitivity",
    "Exif:ISOSpeedRatings",
    "Exif:ISOSpeed",
    "Exif:RecommendedExposureIndex",
    "Exif:StandardOutputSensitivity",
    "isoSpeed",
)
_MODEL = ("Model", "cameraModel")
_LENS = ("Exif:LensModel", "lensModel")
_MOMENT = ("Exif:DateTimeOriginal", "Exif:DateTimeDigitized", "DateTime")
_WHITE_BALANCE: Mapping[int | None, str] = {0: "auto", 1: "manual"}
"""Values of the EXIF tag WhiteBalance (CIPA DC-008, 4.6.5)."""

_FLIPS = {0: 1, 3: 3, 5: 8, 6: 6}
"""EXIF orientation by LibRaw's ``flip``."""

_TIFF = (b"II*\0", b"MM\0*")

_PLACEHOLDERS = ("", "----", "unknown", "n/a")


@dataclass(frozen=True, slots=True)
class Photo:
    """One photograph, without its pixels."""

    path: Path
    """The file."""

    width: int
    """Columns as stored [px]."""

    height: int
    """Rows as stored [px]."""

    sample_type: str
    """``uint8``, ``uint16``, ``raw``, ``half``, ``float``, ..."""

    exposure_time_s: float | None = None
    """Exposure time, which may be nonsense [s]; None where the file does not tell."""

    iso: float | None = None
    """Sensitivity setting, which may be nonsense [1]; None where the file does not tell."""

    f_number: float | None = None
    """F-number, which may be nonsense [1]; None where the file does not tell, as with lenses
    without contacts."""

    nd_factor: float = 1.0
    """Attenuation of a neutral density filter [1]; no file tells it."""

    model: str = ""
    """Make and model of the camera; empty where the file does not tell."""

    lens: str = ""
    """Model of the lens; empty where the file does not tell."""

    moment: datetime | None = None
    """When it was taken, with the offset from UTC where the file tells one."""

    orientation: int = 1
    """EXIF orientation, 1 to 8; pixels are stored without it."""

    white_balance: str = ""
    """``auto`` or ``manual`` of a developed picture; empty for raw values."""

    profile: str = ""
    """Name of its color profile."""

    heading_deg: float | None = None
    """Where the camera looked by its compass, clockwise from north [deg]."""

    pitch_deg: float | None = None
    """Angle of its axis above the horizon [deg]."""


def read_photo(path: Path) -> Photo:
    """Return what a photograph says about itself.

    Raises:
        ImageError: The file is missing or broken.
        UsageError: The file is raw, and the extra that reads such files is not installed.
    """
    if path.suffix.lower() in RAW_SUFFIXES:
        return _read_raw(path)
    header = read_headers(path)[0]
    return _photo(path, (header.width, header.height), header.channel_types[0], header.attributes)


def _photo(
    path: Path, size: tuple[int, int], sample_type: str, attributes: Mapping[str, Any]
) -> Photo:
    balance = _WHITE_BALANCE.get(_code(attributes, "Exif:WhiteBalance"), "")
    return Photo(
        path=path,
        width=size[0],
        height=size[1],
        sample_type=sample_type,
        exposure_time_s=_setting(attributes, _TIME),
        iso=_setting(attributes, _ISO),
        # Bodies write 0 for a lens that does not talk to them.
        f_number=_setting(attributes, _F_NUMBER) or None,
        model=_camera(attributes),
        lens=_text(attributes, _LENS),
        moment=_moment(attributes),
        orientation=_code(attributes, "Orientation") or 1,
        white_balance=balance if sample_type == "uint8" else "",
        profile=_text(attributes, ("ICCProfile:profile_description",)),
        heading_deg=_number(attributes, ("GPano:PoseHeadingDegrees",)),
        pitch_deg=_number(attributes, ("GPano:PosePitchDegrees",)),
    )


def _setting(attributes: Mapping[str, Any], names: tuple[str, ...]) -> float | None:
    """Return a setting as the camera wrote it, be it possible or not."""
    value = _number(attributes, names)
    is_rounded = value is not None and math.isfinite(value) and value > 0.0
    return _as_written(value) if is_rounded else value  # type: ignore[arg-type]


def _number(attributes: Mapping[str, Any], names: tuple[str, ...]) -> float | None:
    for name in names:
        value = attributes.get(name)
        if isinstance(value, tuple | list) and value:
            value = value[0]
        try:
            return float(value)  # type: ignore[arg-type]
        except (TypeError, ValueError):
            continue
    return None


def _code(attributes: Mapping[str, Any], name: str) -> int | None:
    value = _number(attributes, (name,))
    return None if value is None or not math.isfinite(value) else int(value)


def _as_written(value: float) -> float:
    """Return the number that was rounded to single precision: 1/60, 0.3, 5.6, not 0.0166666675."""
    candidates = (float(f"{value:.6g}"), 1.0 / float(f"{1.0 / value:.6g}"))
    return min(candidates, key=lambda candidate: abs(candidate - value))


def _text(attributes: Mapping[str, Any], names: tuple[str, ...]) -> str:
    for name in names:
        text = _decoded(str(attributes.get(name, "")))
        if text.lower() not in _PLACEHOLDERS:
            return text
    return ""


def _decoded(text: str) -> str:
    """Return a text on one line; bytes that are not UTF-8, as older software writes, as Latin-1."""
    data = text.encode("utf-8", "surrogateescape")
    try:
        text = data.decode("utf-8")
    except UnicodeDecodeError:
        text = data.decode("latin-1")
    return " ".join(text.replace("\0", " ").split())


def _camera(attributes: Mapping[str, Any]) -> str:
    make, model = _text(attributes, ("Make",)), _text(attributes, _MODEL)
    # "NIKON CORPORATION", "NIKON D850": the model repeats the make.
    is_said = not make or model.lower().startswith(make.split()[0].lower())
    return model if is_said else f"{make} {model}".strip()


def _moment(attributes: Mapping[str, Any]) -> datetime | None:
    text = _text(attributes, _MOMENT)
    fraction = _text(attributes, ("Exif:SubsecTimeOriginal", "Exif:SubsecTimeDigitized"))
    offset = _text(attributes, ("Exif:OffsetTimeOriginal", "Exif:OffsetTime"))
    if fraction.isdecimal():
        text += f".{fraction[:6]:0<6}"
    for pattern, value in (("%z", f"{text} {offset}"), ("", text)):
        for digits in (".%f", ""):
            try:
                return datetime.strptime(value, f"%Y:%m:%d %H:%M:%S{digits} {pattern}".strip())
            except ValueError:
                continue
    return None


# --- Raw files ---------------------------------------------------------------------------------


def import_rawpy(path: Path) -> Any:
    """Return the module ``rawpy``.

    Raises:
        UsageError: It is not installed; the message names the file that needs it.
    """
    try:
        import rawpy
    except ImportError:
        raise UsageError(
            f"{path}: raw photographs need rawpy; install it with `pip install 'usdskin[raw]'`, or "
            "give the JPEG or TIFF files alone with --only"
        ) from None
    return rawpy


def _read_raw(path: Path) -> Photo:
    rawpy = import_rawpy(path)
    if not path.is_file():
        raise ImageError(f"{path}: cannot read; no such file.")
    try:
        with rawpy.imread(str(path)) as raw:
            told = {
                "ExposureTime": raw.other.shutter_speed or None,
                "FNumber": raw.other.aperture or None,
                "isoSpeed": raw.other.iso_speed or None,
                "lensModel": raw.lens.model,
                "DateTime": f"{raw.other.timestamp:%Y:%m:%d %H:%M:%S}",
                "Orientation": _FLIPS.get(raw.sizes.flip, 1),
            }
            size = (raw.sizes.width, raw.sizes.height)
    except rawpy.LibRawError as error:
        raise ImageError(f"{path}: cannot read; {raw_reason(error)}") from None
    return _photo(path, size, "raw", {**told, **_tiff_attributes(path)})


def raw_reason(error: Exception) -> str:
    """Return what LibRaw says, and what to do, as the end of a message."""
    said = error.args[0] if error.args else b"it is broken"
    text = said.decode(errors="replace") if isinstance(said, bytes) else str(said)
    return f"{text[:1].lower()}{text[1:]}; restore a good copy."


def _tiff_attributes(path: Path) -> dict[str, Any]:
    """Return the attributes of a raw file that is TIFF inside; none where it is not."""
    with open(path, "rb") as file:
        if file.read(4) not in _TIFF:
            return {}
    # The ending of the name is not that of a TIFF file.
    OpenImageIO.attribute("try_all_readers", 1)
    try:
        source = OpenImageIO.ImageInput.open(str(path))
    finally:
        OpenImageIO.attribute("try_all_readers", 0)
    if source is None:
        OpenImageIO.geterror()
        return {}
    try:
        attributes = source.spec().extra_attribs
        return {attribute.name: attribute.value for attribute in attributes}
    finally:
        source.close()
