"""From fitted columns to the spectra of a skin material.

Columns that are wavelengths are spectra already. The three channels of a camera become spectra by
the skin prior. Where a spectrophotometer measured the same skin, its reflectance is S's shape and
size, and the fit tells how it is shared between the two terms.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from usdskin.colorimetry import xyz_weights
from usdskin.errors import LayerError
from usdskin.estimate.skin.convention import split
from usdskin.estimate.skin.fit import SkinFit
from usdskin.estimate.skin.inputs import Columns
from usdskin.estimate.skin.prior import LARGEST_UNLIKENESS, shipped_prior, skin_map
from usdskin.estimate.skin.spectra_of_channels import (
    ReflectanceOf,
    SkinSpectra,
    channel_rows,
    spectra_of_channels,
)
from usdskin.estimate.skin.surface import specular_included
from usdskin.notes import Note
from usdskin.prims import SkinSamples
from usdskin.spectrafiles import as_reflectances, read_spectra
from usdskin.spectrum import SpectralQuantity, Spectrum, resample

FloatArray = NDArray[np.float64]

_NOTED_DIFFERENCE = 0.1


@dataclass(frozen=True, slots=True, eq=False)
class MeasuredReflectance:
    """What a spectrophotometer says of the skin, the surface's mirror image taken out."""

    spectrum: Spectrum
    """Reflectance [1]."""

    geometry: str
    """``di8`` or ``45to0``."""

    def share(self, wrap: float) -> float:
        """Return k: the instrument reads alpha S (1 + k Ss) of eq. (1).

        In light from all of the upper half the wrap term gives (1 + 2 l) / (1 + l), lit at 45
        degrees (cos 45 + l) / ((1 + l) cos 45), where the Lambert term gives 1.

        Args:
            wrap: l [1].
        """
        if self.geometry == "di8":
            return (1.0 + 2.0 * wrap) / (1.0 + wrap)
        cosine = np.sqrt(0.5)
        return float((cosine + wrap) / ((1.0 + wrap) * cosine))


def measured_reflectance(samples: SkinSamples, notes: list[Note]) -> MeasuredReflectance | None:
    """Return the reflectance of a spectrophotometer, where the layer has one.

    Raises:
        LayerError: There are two, or a value is not above what the surface mirrors.
        UsdSkinError: The file cannot be used.
    """
    if samples.reflectance_file is not None and samples.reflectance is not None:
        raise LayerError(
            f"{samples.where}: has both samples:reflectance:file and "
            "SpectralDistributionAPI:reflectance; keep one of them"
        )
    spectrum = samples.reflectance
    if samples.reflectance_file is not None:
        table = read_spectra(samples.reflectance_file, notes)
        rows = as_reflectances(table, notes)
        if len(rows) > 1:
            text = f"{len(rows)} reflectances of {samples.reflectance_file.name} were averaged"
            notes.append(Note("reflectances-averaged", samples.where, text))
        values = np.asarray(rows.mean(axis=0))
        spectrum = Spectrum(SpectralQuantity.REFLECTANCE, table.wavelength_nm, values)
    if spectrum is None:
        return None
    if samples.specular_included:
        diffuse = specular_included(spectrum.value, where=samples.where)
        spectrum = replace(spectrum, value=diffuse)
    return MeasuredReflectance(spectrum, samples.reflectance_geometry)


def spectra_of_fit(
    fit: SkinFit, columns: Columns, measured: MeasuredReflectance | None, where: str,
    notes: list[Note],
) -> SkinSpectra:  # fmt: skip
    """Return the spectra of a material from a fit.

    Args:
        fit: What was fitted.
        columns: What its columns are.
        measured: Reflectance of a spectrophotometer; None: the readings alone.
        where: Place, for errors and notes.
        notes: Takes what limits the trust in the result.

    Raises:
        LayerError: The readings are not those of skin, or A and B cannot be split.
    """
    try:
        if columns.camera is None:
            found = _of_bands(fit, columns.wavelength_nm, where, notes)
        else:
            found = _of_channels(fit, columns, where, notes)
        return found if measured is None else _measured(found, fit, measured, where, notes)
    except ValueError as error:
        raise LayerError(f"{where}: {error}") from None


def _of_bands(fit: SkinFit, grid: FloatArray, where: str, notes: list[Note]) -> SkinSpectra:
    weights = np.ones(1) if grid.size == 1 else xyz_weights(grid)[:, 1]
    found = split(
        fit.lambert,
        fit.wrapped,
        weights,
        wrap=fit.wrap,
        covariance=fit.covariance,
        channel_names=tuple(f"{nm:g}" for nm in grid),
        where=where,
        notes=notes,
    )
    return SkinSpectra(
        wavelength_nm=grid,
        alpha=found.alpha,
        alpha_stddev=found.alpha_stddev,
        reflectance=found.reflectance,
        reflectance_stddev=found.reflectance_stddev,
        scattering=found.scattering,
        scattering_stddev=found.scattering_stddev,
    )


def _of_channels(fit: SkinFit, columns: Columns, where: str, notes: list[Note]) -> SkinSpectra:
    assert columns.camera is not None and columns.illuminant is not None
    grid, t = columns.wavelength_nm, columns.camera.responsivity
    rows = channel_rows(t, columns.illuminant)
    prior = shipped_prior(grid)
    unlike = float(skin_map(prior, rows.T).unlikeness(fit.lambert + fit.wrapped))
    if unlike > LARGEST_UNLIKENESS:
        listed = ", ".join(f"{value:.3g}" for value in fit.lambert + fit.wrapped)
        notes.append(
            Note(
                "unlike-skin",
                where,
                f"R, G, B of {listed} over a perfect diffuser are {unlike:.1f} standard deviations "
                "from the chromaticities of measured skin; its spectrum is a guess, and the light "
                "or the calibration may be another",
            )
        )
    return spectra_of_channels(
        fit.lambert,
        fit.wrapped,
        fit.covariance,
        wavelength_nm=grid,
        responsivity=t,
        illuminant=columns.illuminant,
        reflectance_of=reflectance_by_prior(grid, rows),
    )


def reflectance_by_prior(wavelength_nm: FloatArray, rows: FloatArray) -> ReflectanceOf:
    """Return the skin prior as what channel values mean.

    Args:
        wavelength_nm: Band centres [nm], shape [n].
        rows: From ``channel_rows``, shape [3, n].
    """
    prior = shipped_prior(wavelength_nm)

    def reflectance_of(values: FloatArray, covariance: FloatArray) -> tuple[FloatArray, FloatArray]:
        size = np.maximum(values, 1e-6 * max(float(values.max()), 1e-300))
        noise = np.sqrt(np.maximum(covariance.diagonal(), 0.0)) / size
        likeliest = skin_map(prior, rows.T, np.minimum(noise, 1.0))
        return np.maximum(likeliest(values), 0.0), likeliest.stddev(values)

    return reflectance_of


def _measured(
    found: SkinSpectra,
    fit: SkinFit,
    measured: MeasuredReflectance,
    where: str,
    notes: list[Note],
) -> SkinSpectra:
    """Return the spectra with S from the spectrophotometer: R = alpha S (1 + k Ss)."""
    grid = found.wavelength_nm
    seen = resample(measured.spectrum.wavelength_nm, measured.spectrum.value, grid, outside="hold")
    lit = found.alpha * (1.0 + measured.share(fit.wrap) * found.scattering)
    expected = found.reflectance * lit
    ratio = float(seen.sum() / expected.sum())
    if abs(ratio - 1.0) > _NOTED_DIFFERENCE:
        notes.append(
            Note(
                "reflectance-differs",
                where,
                f"the spectrophotometer reads {ratio:.2f} times what the fit expects it to; its "
                "reflectance is used: check the white of the readings, and that both are of the "
                "same skin",
            )
        )
    return replace(
        found,
        reflectance=seen / lit,
        # The instrument's own error is taken to be small beside that of the split.
        reflectance_stddev=seen / lit**2 * found.alpha * found.scattering_stddev,
    )
