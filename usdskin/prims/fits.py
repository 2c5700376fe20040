"""What ``SkinMaterialAPI`` says about the fit a skin came from <-> ``SkinFitRecord``."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from pxr import Usd, Vt

from usdskin.prims.spectra import read_spectrum, write_spectrum
from usdskin.prims.values import DEFAULT_TIME, read_schema
from usdskin.spectrum import Spectrum

FloatArray = NDArray[np.float64]


@dataclass(frozen=True, slots=True, eq=False)
class SkinFitRecord:
    """A fit, as the material keeps it; None where it does not say."""

    convention: str
    """Token of ``fit:convention``."""

    parameters: tuple[str, ...] = ()
    """``wrap``, ``A[..]``, ``B[..]`` and others."""

    values: FloatArray | None = None
    """The fitted numbers, shape [n]."""

    covariance: FloatArray | None = None
    """Their covariance, shape [n, n]."""

    wrap_stddev: float | None = None
    """Standard deviation of l [1]."""

    alpha_stddev: float | None = None
    """Standard deviation of alpha [1]."""

    residual: float | None = None
    """Root mean square residual relative to the largest reading [1]."""

    reach_deg: float | None = None
    """Largest angle between normal and light [deg]."""

    needed_reach_deg: float | None = None
    """The angle it should be [deg]."""

    reflectance_stddev: Spectrum | None = None
    """Standard deviation of S [1]."""

    scattering_stddev: Spectrum | None = None
    """Standard deviation of Ss [1]."""


_NUMBERS = {
    "wrap_stddev": "fit:wrapStddev",
    "alpha_stddev": "fit:alphaStddev",
    "residual": "fit:residual",
    "reach_deg": "fit:reach",
    "needed_reach_deg": "fit:neededReach",
}
_SPECTRA = {"reflectance_stddev": "reflectanceStddev", "scattering_stddev": "scatteringStddev"}


def read_skin_fit(prim: Usd.Prim) -> SkinFitRecord | None:
    """Return the fit that a Material with ``SkinMaterialAPI`` came from, or None.

    Raises:
        LayerError: An opinion cannot be used.
    """
    values = read_schema(prim, "SkinMaterialAPI", DEFAULT_TIME)
    if values["fit:convention"] == "none":
        return None
    parameters = tuple(values["fit:parameters"] or ())
    covariance = values["fit:covariance"]
    count = len(parameters)
    if covariance is not None:
        covariance = covariance.reshape(count, count) if count else None
    return SkinFitRecord(
        convention=values["fit:convention"],
        parameters=parameters,
        values=values["fit:values"],
        covariance=covariance,
        reflectance_stddev=read_spectrum(prim, "reflectanceStddev"),
        scattering_stddev=read_spectrum(prim, "scatteringStddev"),
        **{field: values[name] for field, name in _NUMBERS.items()},
    )


def write_skin_fit(prim: Usd.Prim, fit: SkinFitRecord) -> None:
    """Author the fit of a Material that has ``SkinMaterialAPI`` already.

    Numbers that are not finite (what readings do not tell) are left out; in the covariance they
    are the largest float, so that the row still says that nothing is known.
    """
    prim.GetAttribute("fit:convention").Set(fit.convention)
    if fit.parameters:
        prim.GetAttribute("fit:parameters").Set(Vt.TokenArray(fit.parameters))
    for field, name in (("values", "fit:values"), ("covariance", "fit:covariance")):
        array = getattr(fit, field)
        if array is not None:
            finite = np.nan_to_num(np.ravel(array), nan=0.0)
            prim.GetAttribute(name).Set(Vt.DoubleArray.FromNumpy(finite.astype(np.float64)))
    for field, name in _NUMBERS.items():
        number = getattr(fit, field)
        if number is not None and np.isfinite(number):
            prim.GetAttribute(name).Set(float(number))
    for field, name in _SPECTRA.items():
        spectrum = getattr(fit, field)
        if spectrum is not None:
            write_spectrum(prim, name, spectrum)
