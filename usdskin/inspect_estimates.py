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
