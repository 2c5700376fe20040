"""Rows of ``usdskin info`` about charts, calibrated cameras and estimated lights."""

from __future__ import annotations

from typing import Any

Row = dict[str, Any]


def chart_row(prim: Any) -> Row:
    """Return what a prim with ``ColorChartAPI`` holds."""
    from usdskin.prims import read_color_chart

    chart = read_color_chart(prim)
    spectra = "signals" if chart.signals is not None or chart.signals_file else "reflectances"
    if chart.camera_values is not None or chart.camera_values_file:
        seen = "values"
    else:
        seen = "photographs" if chart.view is not None else "picture"
    return {
        "name": chart.name or chart.layout or None,
        "class": chart.light_class,
        "patches": len(chart.patches) if chart.patches else None,
        "camera": seen,
        "spectra": spectra,
        "units": chart.units,
        "model": chart.model or None,
    }


def spectral_camera_row(prim: Any) -> Row:
    """Return the settings of a camera with ``SpectralCameraAPI``."""
    from usdskin.prims.values import DEFAULT_TIME, read_schema

    values = read_schema(prim, "SpectralCameraAPI", DEFAULT_TIME)
    noise, grid = values["spectral:noise"], values["spectral:wavelengths"]
    iso = values["spectral:settings:iso"]
    return {
        "model": values["spectral:settings:model"] or None,
        "lens": values["spectral:settings:lens"] or None,
        "whiteBalance": values["spectral:settings:whiteBalance"] or None,
        "iso": None if iso is None else [float(value) for value in iso],
        "bands": None if grid is None else f"{len(grid)}, {grid[0]:g}-{grid[-1]:g} nm",
        "units": values["spectral:units"],
        "noise [%]": None if noise is None else [round(100.0 * float(v), 3) for v in noise],
    }


def recovery_rows(prim: Any) -> list[Row]:
    """Return one row for each class of light of a calibrated camera."""
    from usdskin.prims.applied import instances
    from usdskin.prims.values import DEFAULT_TIME, read_schema

    schema = "SpectralRecoveryAPI"
    rows = []
    for name in instances(prim, schema):
        values = read_schema(prim, schema, DEFAULT_TIME, name)
        posterior, lamp = values["posteriorStddev"], values["illuminant"]
        row: Row = {
            "class": name,
            "estimator": values["estimator"],
            "patches": len(values["patches"] or ()),
            "GFC": values["looGfc"],
            "RMSE": values["looRmse"],
            "dE2000": values["looDeltaE2000"],
            "condition": values["condition"],
            "|Gt-I|": values["identityError"],
            "negative": values["negativeShare"],
        }
        if posterior is not None and lamp is not None:
            row["stddev [% of peak]"] = round(100.0 * float(posterior.max() / lamp.max()), 3)
            row["dE grey"] = values["greyDeltaE2000"]
            row["dE skin"] = values["skinDeltaE2000"]
        rows.append(row)
    return rows


def light_estimate_row(prim: Any) -> Row:
    """Return how the spectrum of a light came about, and what it is like."""
    from usdskin.prims import read_light_estimate

    found = read_light_estimate(prim)
    assert found is not None
    shares = zip(found.classes, found.class_shares, strict=True)
    row: Row = {
        "origin": found.origin,
        "lamp": found.illuminant or None,
        "classes": {name: round(share, 3) for name, share in shares} or None,
        "scale": found.scale,
        "CCT [K]": found.cct,
        "Duv": found.duv,
        "Ra": found.cri,
        "Rf": found.fidelity,
        "SSI": None if found.ssi is None else f"{found.ssi:.0f} {found.ssi_reference}",
        "illuminance": found.illuminance,
        "clipped": found.clipped_share,
        "negative": found.negative_share,
    }
    if found.grey_delta_e is not None:
        row |= {"dE grey": found.grey_delta_e, "dE skin": found.skin_delta_e}
    return row


_SHOWN_NM = (450.0, 550.0, 650.0)


def skin_row(prim: Any) -> Row:
    """Return a skin material as a person would want to read it."""
    from usdskin.prims import read_skin, read_skin_fit

    # isort: split
    from pxr import Usd

    skin, fit = read_skin(prim, Usd.TimeCode.EarliestTime()), read_skin_fit(prim)
    row: Row = {
        **_with_error("l", skin.wrap, fit.wrap_stddev if fit else None),
        **_with_error("alpha", skin.alpha, fit.alpha_stddev if fit else None),
    }
    for name, spectrum, stddev in (
        ("S", skin.reflectance, fit.reflectance_stddev if fit else None),
        ("Ss", skin.scattering, fit.scattering_stddev if fit else None),
    ):
        row |= _at_shown(name, spectrum, stddev)
    row |= _facing(skin)
    row["specular"] = skin.specular_weight or None
    maps = {
        "albedo": skin.albedo_file,
        "weights": skin.weights_file,
        "normal": skin.normal_file,
        "bump": skin.bump_file,
        "displacement": skin.displacement_file,
        "specular weight": skin.specular_weight_file,
        "roughness": skin.specular_roughness_file,
    }
    row["maps"] = ", ".join(name for name, file in maps.items() if file is not None) or None
    if isinstance(skin.opacity, float):
        row["opacity [1/m]"] = skin.opacity or None
    else:
        values = skin.opacity.value
        row["opacity [1/m]"] = [_digits(values.min(), 4), _digits(values.max(), 4)]
    if fit is not None:
        row["residual"] = fit.residual
        if fit.reach_deg is not None and fit.needed_reach_deg is not None:
            row["reach [deg]"] = round(fit.reach_deg)
            row["needed reach [deg]"] = round(fit.needed_reach_deg)
    return row


def _with_error(name: str, value: float, error: float | None) -> Row:
    row: Row = {name: _digits(value, 4)}
    return row if error is None else row | {f"{name} +-": _digits(error, 2)}


def _digits(value: float, count: int) -> float:
    return float(f"{value:.{count}g}")


def _at_shown(name: str, spectrum: Any, stddev: Any) -> Row:
    """Return a spectrum at a few wavelengths, and the median of its standard deviation there."""
    import numpy as np

    column = f"{name} at 450, 550, 650 nm"
    if spectrum is None:
        return {column: None}
    nm = spectrum.wavelength_nm
    row: Row = {column: [round(float(v), 3) for v in np.interp(_SHOWN_NM, nm, spectrum.value)]}
    if stddev is not None:
        error = float(np.median(np.interp(_SHOWN_NM, nm, stddev.value)))
        row[f"{name} +-"] = _digits(error, 2)
    return row


def _facing(skin: Any) -> Row:
    """Return L*, a*, b* and ITA under D65, as an integrating sphere reads them (SCI)."""
    import numpy as np

    from usdskin.colorimetry import illuminant, xyz_to_lab, xyz_weights
    from usdskin.spectrum import DEFAULT_WAVELENGTHS_NM

    if skin.reflectance is None:
        return {}
    grid = DEFAULT_WAVELENGTHS_NM
    spread = 0.0 if skin.scattering is None else skin.scattering.resample(grid)
    weights = illuminant("D65", grid)[:, None] * xyz_weights(grid)
    gain = 1.0 if skin.wrap_normalization == "energy" else 1.0 + skin.wrap
    lit = skin.alpha * skin.reflectance.resample(grid) * (1.0 + gain * spread) + skin.f0
    lightness, a, b = xyz_to_lab(lit @ weights, weights.sum(axis=0))
    return {
        "L*a*b* (D65, SCI)": [round(float(value), 1) for value in (lightness, a, b)],
        "ITA [deg]": round(float(np.degrees(np.arctan2(lightness - 50.0, b))), 1),
    }


def transfer_row(prim: Any) -> dict[str, Any]:
    """Return where a prim's baked shadows are."""
    from usdskin.prims.transfers import read_transfer

    transfer = read_transfer(prim)
    assert transfer is not None
    return {
        "file": transfer.file.name,
        "vertices": transfer.row_count,
        "rings": transfer.rings,
        "subdivisionLevel": transfer.subdivision_level,
    }
