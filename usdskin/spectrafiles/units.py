"""What files call quantities and units."""

from __future__ import annotations

import re

from usdskin.spectrum import SpectralQuantity

_QUANTITY_WORDS = (
    ("reflect", SpectralQuantity.REFLECTANCE),
    ("transmi", SpectralQuantity.TRANSMITTANCE),
    ("irradian", SpectralQuantity.IRRADIANCE),
    ("ambient", SpectralQuantity.IRRADIANCE),
    ("radian", SpectralQuantity.RADIANCE),
    ("emission", SpectralQuantity.RADIANCE),
    ("sensitivity", SpectralQuantity.RESPONSIVITY),
    ("responsivity", SpectralQuantity.RESPONSIVITY),
    ("relative", SpectralQuantity.RELATIVE),
)
_QUANTITY_KEYS = (
    "quantity",
    "spectral quantity",
    "spectralquantity",
    "meas_type",
    "measurement type",
    "measurement mode",
    "measuring mode",
    "mode",
)
_WATTS = {"W": 1.0, "mW": 1e-3, "uW": 1e-6, "nW": 1e-9, "kW": 1e3}
_METERS = {"m": 1.0, "cm": 1e-2, "mm": 1e-3, "um": 1e-6, "nm": 1e-9}
_LONGEST = 200
"""Characters of a heading with its unit."""

_PLAIN = str.maketrans("⁰¹²³⁴⁵⁶⁷⁸⁹⁻−–µμ", "0123456789---uu")
_DIVIDED_GROUP = re.compile(r"/\s*\(([^()]*)\)")
_FACTOR = re.compile(r"(/?)([A-Za-z]+)(?:\^|\*\*)?\(?(-?\d+)?\)?")
_IN_BRACKETS = re.compile(r"\s*[\[(]([^\[\]]*?)[\])]\s*$")

PERCENT = ("%", "percent", "pct", "per cent")
"""What files write for percent."""

RELATIVE = ("relative", "rel", "a.u.", "au", "arbitrary", "counts", "1", "-", "none")
"""What files write for units without a meaning."""


def quantity_of(text: str) -> SpectralQuantity | None:
    """Return the quantity that a word of the text names, None where there is none."""
    folded = text.casefold()
    return next((quantity for word, quantity in _QUANTITY_WORDS if word in folded), None)


def stated_quantity(metadata: dict[str, str], units: str) -> SpectralQuantity | None:
    """Return the quantity that a file's statements or its unit name."""
    for key in _QUANTITY_KEYS:
        if found := quantity_of(metadata.get(key, "")):
            return found
    unit = radiometric_unit(units)
    if unit is None:
        return None
    return SpectralQuantity.RADIANCE if unit[1] else SpectralQuantity.IRRADIANCE


def unit_in_brackets(text: str) -> tuple[str, str]:
    """Split ``A1 [%]`` into its name and the unit in brackets; without brackets it is empty."""
    match = _IN_BRACKETS.search(text) if len(text) <= _LONGEST else None
    if match is None:
        return text, ""
    unit = match[1].strip()
    if unit.casefold() in PERCENT or radiometric_unit(unit) is not None:
        return text[: match.start()].strip(), unit
    return text, ""


def radiometric_unit(units: str) -> tuple[float, bool] | None:
    """Return what a unit of spectral radiance or irradiance is in watt, metre and nanometre.

    Args:
        units: Such as ``mW/(m^2 sr nm)``, ``W m-2 sr-1 nm-1`` or ``µW/cm²/nm``.

    Returns:
        Its size [W m^-2 nm^-1, or W m^-2 sr^-1 nm^-1] and whether it is per steradian; None for
        anything else.
    """
    if len(units) > _LONGEST:
        return None
    text = re.sub(r"[·⋅･*.\s]+(?=[A-Za-z/(])", " ", units.strip().translate(_PLAIN))
    text = _DIVIDED_GROUP.sub(lambda match: "/" + "/".join(match[1].split()), text)
    size, powers = 1.0, {"W": 0, "area": 0, "sr": 0, "band": 0}
    position = 0
    for match in _FACTOR.finditer(text):
        if text[position : match.start()].strip(" []()1"):
            return None
        position = match.end()
        power = int(match[3] or 1) * (-1 if match[1] else 1)
        symbol = match[2]
        if symbol in _WATTS and power == 1:
            size, kind = size * _WATTS[symbol], "W"
        elif symbol == "sr" and power == -1:
            kind = "sr"
        elif symbol in _METERS and power == -2:
            size, kind = size * _METERS[symbol] ** -2, "area"
        elif symbol in _METERS and power == -1:
            size, kind = size * 1e-9 / _METERS[symbol], "band"
        else:
            return None
        powers[kind] += 1
    if text[position:].strip(" []()") or (powers["W"], powers["area"], powers["band"]) != (1, 1, 1):
        return None
    return (size, powers["sr"] == 1) if powers["sr"] <= 1 else None
