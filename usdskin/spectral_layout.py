"""Channel names of spectral EXR files.

Fichet, Pacanowski and Wilkie, "An OpenEXR Layout for Spectral Images", JCGT 10(3), 2021: emissive
channels are ``S0.<number><unit>``, reflective ones ``T.<number><unit>``; the number has a decimal
comma, the unit is metre or hertz with any SI prefix.
"""

from __future__ import annotations

import math
import re
from collections.abc import Sequence
from typing import Literal

_CHANNEL = re.compile(
    r"^(?P<layer>S0|T)\.(?P<number>\d+(?:[.,]\d*)?(?:[eE][+-]?\d+)?)"
    r"(?P<prefix>da|[YZEPTGMkhdcmunp])?(?P<unit>m|Hz)$"
)
_SI_PREFIXES = {
    **{"Y": 1e24, "Z": 1e21, "E": 1e18, "P": 1e15, "T": 1e12, "G": 1e9, "M": 1e6, "k": 1e3},
    **{"h": 1e2, "da": 1e1, "": 1.0, "d": 1e-1, "c": 1e-2, "m": 1e-3, "u": 1e-6, "n": 1e-9},
    "p": 1e-12,
}
_SPEED_OF_LIGHT = 299792458.0  # [m s^-1], exact (SI)


def channel_name(wavelength_nm: float, layer: Literal["S0", "T"] = "S0") -> str:
    """Return the channel name of a wavelength [nm], such as ``S0.550,000000nm``."""
    number = f"{float(wavelength_nm):.6f}".replace(".", ",")
    return f"{layer}.{number}nm"


def spectral_channels(names: Sequence[str]) -> list[tuple[float, str]]:
    """Return (wavelength [nm], name) of the spectral channels among ``names``, ascending.

    Emissive channels are taken where there are any, else the reflective ones. A decimal point is
    read as a comma is.
    """
    layers: dict[str, list[tuple[float, str]]] = {"S0": [], "T": []}
    for name in names:
        match = _CHANNEL.match(name)
        if match is None:
            continue
        number = float(match["number"].replace(",", ".")) * _SI_PREFIXES[match["prefix"] or ""]
        if number > 0.0 and math.isfinite(number):
            metres = number if match["unit"] == "m" else _SPEED_OF_LIGHT / number
            # 1e-9 nm is far below what a name's digits mean: drop the noise of the scaling.
            layers[match["layer"]].append((round(metres * 1e9, 9), name))
    return sorted(layers["S0"] or layers["T"])
