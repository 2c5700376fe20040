"""``SpectralCameraAPI`` and ``SpectralRecoveryAPI`` <-> ``SpectralCamera``."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray
from pxr import Sdf, Usd, UsdGeom, Vt

from usdskin.errors import LayerError
from usdskin.layers import describe
from usdskin.prims.applied import check_applied_schemas, instances
from usdskin.prims.charts import ColorChart, read_color_chart, write_color_chart
from usdskin.prims.values import DEFAULT_TIME, PrimError, Problem, read_schema
from usdskin.prims.writing import write_schema

FloatArray = NDArray[np.float64]

_RECOVERY = "SpectralRecoveryAPI"


@dataclass(frozen=True, slots=True, eq=False)
class Recovery:
    """How camera values become spectra in one class of light, and how well."""

    light_class: str
    """Name of the class, such as ``tubes``."""

    matrix: FloatArray
    """Spectrum = matrix @ rho [W m^-2 sr^-1 nm^-1, or relative], shape [n, 3]."""

    estimator: str
    """``regression``, ``literal``, ``tsvd``, ``pca``, ``wiener`` or ``smooth``."""

    illuminant: FloatArray
    """Radiance of a perfect diffuser in this light, shape [n]."""

    condition: float
    """Condition number of the inverted matrix [1]."""

    identity_error: float
    """Largest deviation of G t from the identity [1]."""

    loo_gfc: float
    """Mean goodness of fit, leaving each patch out in turn [1]."""

    loo_rmse: float
    """Mean root mean square error relative to the light's peak, likewise [1]."""

    loo_delta_e_2000: float
    """Mean CIEDE2000, likewise [1]."""

    negative_share: float
    """Share of the energy of the recovered patches that is negative [1]."""

    ridge: float = 0.0
    """Weight of the regularisation that leave-one-out chose [1]."""

    prior_covariance: FloatArray | None = None
    """Covariance of the prior, shape [n, n]; ``wiener`` alone has one."""

    posterior_stddev: FloatArray | None = None
    """Of the recovered spectrum of a perfect diffuser, shape [n]; ``wiener`` alone has one."""

    grey_delta_e: float | None = None
    """Expected CIEDE2000 of a perfect diffuser [1]; ``wiener`` alone has one."""

    skin_delta_e: float | None = None
    """Expected CIEDE2000 of skin [1]; ``wiener`` alone has one."""

    patches: tuple[str, ...] = ()
    """Names of the m patches."""

    patch_gfc: FloatArray | None = None
    """Goodness of fit of each patch when it is left out, shape [m]."""

    patch_rmse: FloatArray | None = None
    """Error of each patch relative to the light's peak, likewise, shape [m]."""

    patch_delta_e_2000: FloatArray | None = None
    """CIEDE2000 of each patch, likewise, shape [m]."""


@dataclass(frozen=True, slots=True, eq=False)
class SpectralCamera:
    """A camera that was calibrated against spectra."""

    where: str
    """``layer.usda </Prim/path>``, for errors."""

    wavelength_nm: FloatArray
    """Band centres [nm], shape [n]."""

    responsivity: FloatArray
    """t: rho = spectrum @ t, band widths included, shape [n, 3]."""

    noise: FloatArray
    """Standard deviation of a camera value relative to it [1], shape [3]."""

    recoveries: tuple[Recovery, ...]
    """One for each class of light, in order."""

    units: str = "relative"
    """``absolute`` or ``relative``: what radiance the spectra are in."""

    model: str = ""
    """Model of the camera."""

    lens: str = ""
    """Model of the lens."""

    white_balance: str = ""
    """White balance and color matrix applied to the pictures; empty for raw values."""

    iso: FloatArray | None = None
    """ISO settings of the photographs, ascending; None: not stated."""

    charts: tuple[ColorChart, ...] = ()
    """What each recovery was made from."""


_SETTINGS = {
    "model": "spectral:settings:model",
    "lens": "spectral:settings:lens",
    "white_balance": "spectral:settings:whiteBalance",
    "units": "spectral:units",
    "iso": "spectral:settings:iso",
}
_NUMBERS = {
    "condition": "condition",
    "identity_error": "identityError",
    "loo_gfc": "looGfc",
    "loo_rmse": "looRmse",
    "loo_delta_e_2000": "looDeltaE2000",
    "negative_share": "negativeShare",
    "ridge": "ridge",
    "grey_delta_e": "greyDeltaE2000",
    "skin_delta_e": "skinDeltaE2000",
}
_ARRAYS = {
    "matrix": "matrix",
    "illuminant": "illuminant",
    "prior_covariance": "priorCovariance",
    "posterior_stddev": "posteriorStddev",
    "patch_gfc": "patchGfc",
    "patch_rmse": "patchRmse",
    "patch_delta_e_2000": "patchDeltaE2000",
}


def read_spectral_camera(stage: Usd.Stage) -> SpectralCamera:
    """Return the calibrated camera of a stage.

    Args:
        stage: Stage with one Camera that has ``SpectralCameraAPI``: the default prim, or the only
            one.

    Raises:
        LayerError: There is no such Camera or several, it lacks wavelengths, responsivity or
            recoveries, or an opinion cannot be used.
    """
    return spectral_camera(_camera_prim(stage))


def spectral_camera(prim: Usd.Prim) -> SpectralCamera:
    """Return the calibration of a Camera with ``SpectralCameraAPI``.

    Raises:
        LayerError: It lacks wavelengths, responsivity or recoveries, or an opinion cannot be used.
    """
    check_applied_schemas(prim)
    values = read_schema(prim, "SpectralCameraAPI", DEFAULT_TIME)
    for name in ("spectral:wavelengths", "spectral:responsivity"):
        if values[name] is None or not len(values[name]):
            text = "has no value; `usdskin calibrate camera` writes a whole calibration"
            raise PrimError(prim, Problem("missing-value", name, text))
    grid = values["spectral:wavelengths"]
    classes = instances(prim, _RECOVERY)
    if not classes:
        raise LayerError(
            f"{describe(prim)}: has no SpectralRecoveryAPI, so no way from camera values to "
            "spectra; `usdskin calibrate camera` writes one for each class of light"
        )
    settings = {field: values[name] for field, name in _SETTINGS.items()}
    if settings["iso"] is not None and not len(settings["iso"]):
        settings["iso"] = None
    return SpectralCamera(
        where=describe(prim),
        wavelength_nm=grid,
        responsivity=values["spectral:responsivity"].reshape(-1, 3),
        noise=_relative_noise(values["spectral:noise"]),
        recoveries=tuple(_read_recovery(prim, name, len(grid)) for name in classes),
        charts=tuple(
            read_color_chart(below)
            for below in Usd.PrimRange(prim)
            if below.HasAPI("ColorChartAPI")
        ),
        **settings,
    )


def _camera_prim(stage: Usd.Stage) -> Usd.Prim:
    default = stage.GetDefaultPrim()
    if default and default.HasAPI("SpectralCameraAPI"):
        return default
    found = [prim for prim in stage.Traverse() if prim.HasAPI("SpectralCameraAPI")]
    name = stage.GetRootLayer().GetDisplayName()
    if not found:
        raise LayerError(
            f"{name}: no prim has SpectralCameraAPI; `usdskin calibrate camera` writes such a layer"
        )
    if len(found) > 1:
        listed = ", ".join(f"<{prim.GetPath()}>" for prim in found)
        raise LayerError(
            f"{name}: several prims have SpectralCameraAPI ({listed}); set defaultPrim"
        )
    return found[0]


def _relative_noise(given: FloatArray | None) -> FloatArray:
    if given is None or not len(given):
        return np.zeros(3)
    return np.sqrt(np.diag(given.reshape(3, 3))) if len(given) == 9 else given


def _read_recovery(prim: Usd.Prim, name: str, count: int) -> Recovery:
    values = read_schema(prim, _RECOVERY, DEFAULT_TIME, name)
    for needed in ("matrix", "illuminant"):
        if values[needed] is None:
            full = f"recovery:{name}:{needed}"
            text = "has no value; `usdskin calibrate camera` writes a whole calibration"
            raise PrimError(prim, Problem("missing-value", full, text))
    if len(values["matrix"]) != 3 * count:
        text = f"has {len(values['matrix'])} values but spectral:wavelengths {count}; give 3 for "
        text += "each of them"
        raise PrimError(prim, Problem("unequal-lengths", f"recovery:{name}:matrix", text))
    fields: dict[str, Any] = {field: values[key] for field, key in (_NUMBERS | _ARRAYS).items()}
    fields["matrix"] = fields["matrix"].reshape(count, 3)
    if fields["prior_covariance"] is not None:
        fields["prior_covariance"] = fields["prior_covariance"].reshape(count, count)
    for field in set(_NUMBERS) - {"grey_delta_e", "skin_delta_e"}:
        if fields[field] is None:
            fields[field] = float("nan")
    return Recovery(
        light_class=name,
        estimator=values["estimator"],
        patches=tuple(values["patches"] or ()),
        **fields,
    )


def write_spectral_camera(
    stage: Usd.Stage, path: str | Sdf.Path, camera: SpectralCamera
) -> Usd.Prim:
    """Define a Camera and author a calibration, the charts it came from below it.

    Args:
        stage: Stage to write to, at its edit target.
        path: Path of the Camera; ``charts/<class>`` below it gets what each recovery was made from.
        camera: What to write.

    Returns:
        The Camera.

    Raises:
        LayerError: A class of light has a name that USD cannot use.
    """
    prim = UsdGeom.Camera.Define(stage, path).GetPrim()
    values: dict[str, Any] = {name: getattr(camera, field) for field, name in _SETTINGS.items()}
    values["spectral:wavelengths"] = camera.wavelength_nm
    values["spectral:responsivity"] = camera.responsivity
    values["spectral:noise"] = camera.noise
    write_schema(prim, "SpectralCameraAPI", values)
    for recovery in camera.recoveries:
        _write_recovery(prim, recovery)
    if camera.charts:
        charts = UsdGeom.Scope.Define(stage, prim.GetPath().AppendChild("charts")).GetPath()
        for recovery, chart in zip(camera.recoveries, camera.charts, strict=True):
            scope = UsdGeom.Scope.Define(stage, charts.AppendChild(recovery.light_class))
            write_color_chart(scope.GetPrim(), chart)
    return prim


def _write_recovery(prim: Usd.Prim, recovery: Recovery) -> None:
    name = recovery.light_class
    if not Sdf.Path.IsValidIdentifier(name):
        raise LayerError(
            f"{describe(prim)}: a class of light cannot be called {name!r}; use letters, digits "
            "and _ in chart:lightClass"
        )
    prim.ApplyAPI(_RECOVERY, name)
    prefix = f"recovery:{name}:"
    prim.GetAttribute(f"{prefix}estimator").Set(recovery.estimator)
    if recovery.patches:
        prim.GetAttribute(f"{prefix}patches").Set(Vt.TokenArray(recovery.patches))
    for field, key in _NUMBERS.items():
        number = getattr(recovery, field)
        if number is not None and np.isfinite(number):
            prim.GetAttribute(prefix + key).Set(float(number))
    for field, key in _ARRAYS.items():
        array = getattr(recovery, field)
        if array is not None:
            flat = np.ravel(array).astype(np.float64)
            prim.GetAttribute(prefix + key).Set(Vt.DoubleArray.FromNumpy(flat))
