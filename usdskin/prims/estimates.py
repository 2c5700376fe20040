"""``LightEstimateAPI`` <-> ``LightEstimate``."""

from __future__ import annotations

from dataclasses import dataclass

from pxr import Usd, Vt

from usdskin.prims.spectra import read_spectrum, write_spectrum
from usdskin.prims.values import DEFAULT_TIME, read_schema
from usdskin.prims.writing import write_schema
from usdskin.spectrum import SpectralQuantity, Spectrum

_MEAN_QUANTITIES = (SpectralQuantity.RADIANCE, SpectralQuantity.RELATIVE)


@dataclass(frozen=True, slots=True, eq=False)
class LightEstimate:
    """How the spectrum of a light came about, and what it is like; None where it is not known."""

    origin: str
    """``measured`` by a calibration, or ``assigned`` to a picture."""

    mean: Spectrum | None = None
    """Mean radiance over the sphere."""

    illuminant: str = ""
    """The lamp that was assigned."""

    classes: tuple[str, ...] = ()
    """Classes of lamps."""

    class_shares: tuple[float, ...] = ()
    """Share of the luminous flux of each [1]."""

    scale: float | None = None
    """Factor by which a reading corrected the calibration's own scale [1]."""

    cct: float | None = None
    """Correlated colour temperature of the mean [K]."""

    duv: float | None = None
    """Its distance from the Planckian locus [1]."""

    cri: float | None = None
    """CIE colour rendering index Ra of the mean [1]."""

    fidelity: float | None = None
    """CIE 2017 colour fidelity index Rf of the mean [1]."""

    ssi: float | None = None
    """Spectral similarity index of the mean [1]."""

    ssi_reference: str = ""
    """What it was held against, such as ``P3200`` or ``D55``."""

    illuminance: float | None = None
    """Of a surface that faces up [lx, or relative]."""

    peak_illuminance: float | None = None
    """Of the surface that gets most [lx, or relative]."""

    clipped_share: float | None = None
    """Share of the luminous flux in saturated pixels [1]."""

    negative_share: float | None = None
    """Share of the recovered energy that is negative [1]."""

    grey_delta_e: float | None = None
    """Expected CIEDE2000 of a perfect diffuser in this light [1]."""

    skin_delta_e: float | None = None
    """Expected CIEDE2000 of skin in this light [1]."""


_FIELDS = {
    "origin": "estimate:origin",
    "illuminant": "estimate:illuminant",
    "scale": "estimate:scale",
    "cct": "estimate:cct",
    "duv": "estimate:duv",
    "cri": "estimate:cri",
    "fidelity": "estimate:fidelity",
    "ssi": "estimate:ssi",
    "ssi_reference": "estimate:ssiReference",
    "illuminance": "estimate:illuminance",
    "peak_illuminance": "estimate:peakIlluminance",
    "clipped_share": "estimate:clippedShare",
    "negative_share": "estimate:negativeShare",
    "grey_delta_e": "estimate:greyDeltaE2000",
    "skin_delta_e": "estimate:skinDeltaE2000",
}


def read_light_estimate(prim: Usd.Prim) -> LightEstimate | None:
    """Return how a light's spectrum came about, or None where it does not say.

    Raises:
        LayerError: An opinion cannot be used.
    """
    if not prim.HasAPI("LightEstimateAPI"):
        return None
    values = read_schema(prim, "LightEstimateAPI", DEFAULT_TIME)
    shares = values["estimate:classShares"]
    return LightEstimate(
        mean=read_spectrum(prim, "mean", DEFAULT_TIME, _MEAN_QUANTITIES),
        classes=tuple(values["estimate:classes"] or ()),
        class_shares=() if shares is None else tuple(float(share) for share in shares),
        **{field: values[name] for field, name in _FIELDS.items()},
    )


def write_light_estimate(prim: Usd.Prim, estimate: LightEstimate) -> None:
    """Apply ``LightEstimateAPI`` to a light and author an estimate.

    Raises:
        LayerError: The prim is no light.
    """
    values = {name: getattr(estimate, field) for field, name in _FIELDS.items()}
    if estimate.classes:
        values["estimate:classes"] = Vt.TokenArray(estimate.classes)
        values["estimate:classShares"] = Vt.DoubleArray(estimate.class_shares)
    write_schema(prim, "LightEstimateAPI", values)
    if estimate.mean is not None:
        write_spectrum(prim, "mean", estimate.mean)
