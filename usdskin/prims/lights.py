"""``SpectralLightAPI`` <-> ``SpectralLight``."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from pxr import Usd

from usdskin.prims.applied import check_applied_schemas
from usdskin.prims.spectra import read_spectrum, write_spectrum
from usdskin.prims.values import DEFAULT_TIME, PrimError, Problem, read_schema
from usdskin.prims.writing import write_schema
from usdskin.spectrum import SpectralQuantity, Spectrum

_EMISSION_QUANTITIES = (
    SpectralQuantity.RADIANCE,
    SpectralQuantity.IRRADIANCE,
    SpectralQuantity.RELATIVE,
)
_PHYSICAL_SOURCES = {
    "white": "rgb",
    "blackbody": "blackbody",
    "illuminant D": "illuminantD",
    "custom": "tabulated",
}


@dataclass(frozen=True, slots=True, eq=False)
class SpectralLight:
    """What a light says about its spectrum; the defaults are the schema's fallbacks."""

    source: str = "rgb"
    """``rgb``, ``tabulated``, ``blackbody``, ``illuminantD``, ``basis`` or ``bands``."""

    illuminant: str = "D65"
    """Name of the spectral power distribution of an RGB light."""

    illuminant_file: Path | None = None
    """Text file of it, which wins over the name."""

    emission: Spectrum | None = None
    """Spectrum of a tabulated light [``emission.quantity.unit``]."""

    coefficients_file: Path | None = None
    """Latlong EXR with one channel per row of the basis."""

    basis: NDArray[np.float64] | None = None
    """Spectral basis [W m^-2 sr^-1 nm^-1 per coefficient], shape [rank, band_count]."""

    basis_wavelength_nm: NDArray[np.float64] | None = None
    """Wavelengths of the columns of the basis [nm], shape [band_count]."""

    bands_file: Path | None = None
    """Latlong spectral EXR."""

    scale: float = 1.0
    """Extra factor on the radiance [1]."""

    units: str = "relative"
    """``absolute`` or ``relative``."""

    class_map_file: Path | None = None
    """Latlong image of lamp classes."""


_FIELDS = {
    "source": "inputs:spectral:source",
    "illuminant": "inputs:spectral:illuminant",
    "illuminant_file": "inputs:spectral:illuminant:file",
    "coefficients_file": "inputs:spectral:coefficients:file",
    "basis_wavelength_nm": "inputs:spectral:basis:wavelengths",
    "bands_file": "inputs:spectral:bands:file",
    "scale": "inputs:spectral:scale",
    "units": "inputs:spectral:units",
    "class_map_file": "inputs:spectral:classMap:file",
}


def read_spectral_light(
    prim: Usd.Prim, time: Usd.TimeCode | float = DEFAULT_TIME
) -> SpectralLight | None:
    """Return what a light says about its spectrum.

    Without ``SpectralLightAPI``, the attributes ``physical:illuminant`` and
    ``physical:customIlluminant`` of OpenUSD's physical-lighting proposal are read.

    Args:
        prim: Light prim.
        time: Time to read at.

    Returns:
        The values, or None for a light that is plain RGB.

    Raises:
        LayerError: An opinion cannot be used, or one of ours is misspelt.
    """
    check_applied_schemas(prim)
    if not prim.HasAPI("SpectralLightAPI"):
        return _read_physical(prim, time)
    values = read_schema(prim, "SpectralLightAPI", time)
    fields = {field: values[name] for field, name in _FIELDS.items()}
    basis = values["inputs:spectral:basis"]
    if basis is not None:
        fields["basis"] = basis.reshape(-1, len(fields["basis_wavelength_nm"]))
    emission = read_spectrum(prim, "emission", time, _EMISSION_QUANTITIES)
    if fields["source"] == "tabulated" and emission is None:
        text = 'is "tabulated", but SpectralDistributionAPI:emission is not applied; add it'
        raise PrimError(prim, Problem("missing-value", "inputs:spectral:source", text))
    return SpectralLight(emission=emission, **fields)


def write_spectral_light(
    prim: Usd.Prim, light: SpectralLight, folder: str | Path | None = None
) -> None:
    """Apply ``SpectralLightAPI`` to a light and author its spectrum.

    The rendition for other tools, ``inputs:color`` or an RGB texture, is up to the caller.

    Args:
        prim: Light prim, written at the stage's edit target.
        light: What to write.
        folder: Folder the layer is going to be written to; see ``write_schema``.

    Raises:
        LayerError: The prim is no light, or a file cannot be named from the layer.
    """
    values = {name: getattr(light, field) for field, name in _FIELDS.items()}
    values["inputs:spectral:basis"] = light.basis
    write_schema(prim, "SpectralLightAPI", values, folder)
    if light.emission is not None:
        write_spectrum(prim, "emission", light.emission)


def _read_physical(prim: Usd.Prim, time: Usd.TimeCode | float) -> SpectralLight | None:
    attribute = prim.GetAttribute("physical:illuminant")
    token = attribute.Get(time) if attribute else None
    if token is None:
        return None
    if token not in _PHYSICAL_SOURCES:
        text = f'is "{token}"; use one of {", ".join(_PHYSICAL_SOURCES)}'
        raise PrimError(prim, Problem("unknown-token", "physical:illuminant", text))
    source = _PHYSICAL_SOURCES[token]
    emission = _custom_illuminant(prim, time) if source == "tabulated" else None
    return SpectralLight(source=source, emission=emission)


def _custom_illuminant(prim: Usd.Prim, time: Usd.TimeCode | float) -> Spectrum:
    name = "physical:customIlluminant"
    attribute = prim.GetAttribute(name)
    pairs = np.array(attribute.Get(time) if attribute else [], dtype=np.float64).reshape(-1, 2)
    try:
        if (pairs[:, 1] < 0.0).any():
            raise ValueError("radiance must not be negative")
        return Spectrum(SpectralQuantity.RADIANCE, pairs[:, 0], pairs[:, 1])
    except ValueError as error:
        text = f"cannot be used: {error}; give pairs of wavelength [nm] and radiance"
        raise PrimError(prim, Problem("wrong-value", name, text)) from None
