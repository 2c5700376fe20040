"""Read what the figure of a skin shows: the material, its fit and the readings of the fit."""

from __future__ import annotations

import re

import numpy as np
from numpy.typing import NDArray
from pxr import Usd

from usdskin.errors import LayerError
from usdskin.estimate.skin.covariance import Noise
from usdskin.estimate.skin.lobe import Lobe
from usdskin.estimate.skin.model import Coefficients, Freedom, SkinModel
from usdskin.estimate.skin.readings import Readings, readings_from_angles
from usdskin.layers import describe
from usdskin.notes import Note
from usdskin.plots.skin import DrawnSkin
from usdskin.plots.skin_fit import DrawnFit
from usdskin.prims import (
    SkinFitRecord,
    SkinParameters,
    SkinSamples,
    read_skin,
    read_skin_fit,
    read_skin_samples,
)

FloatArray = NDArray[np.float64]

_SAMPLES = "SkinSampleAPI"
_CHANNELS = ("R", "G", "B")
_LEAST_SCALE = 1e-6
_NAME = re.compile(r"^(A|B|delta)\[(.*)\]$")


def read_drawn_skin(prim: Usd.Prim, notes: list[Note] | None = None) -> DrawnSkin:
    """Return what the figure of a skin shows, in its chosen variants.

    Args:
        prim: A Material with ``SkinMaterialAPI``.
        notes: Takes what the layer does not say.

    Raises:
        LayerError: An opinion cannot be used, or the readings are not those of the fit.
    """
    skin, record = read_skin(prim), read_skin_fit(prim)
    if record is not None and not record.parameters:
        record = None  # split by the convention, but not fitted
    return DrawnSkin(
        where=describe(prim),
        name=_name(prim),
        skin=skin,
        record=record,
        fit=None if record is None else _fit(prim, skin, record, notes),
    )


def _name(prim: Usd.Prim) -> str:
    sets = prim.GetVariantSets()
    chosen = [f"{name} {sets.GetVariantSelection(name)}" for name in sets.GetNames()]
    return ", ".join([str(prim.GetPath()), *chosen])


def _fit(
    prim: Usd.Prim, skin: SkinParameters, record: SkinFitRecord, notes: list[Note] | None
) -> DrawnFit | None:
    """Return the readings in a material's layer and the fitted model at them, if there are any."""
    stage = prim.GetStage()
    if not any(other.HasAPI(_SAMPLES) for other in stage.Traverse()):
        return None
    samples = read_skin_samples(stage)
    if samples.values is None or samples.theta_i is None:
        return None
    where = samples.where
    numbers = _numbers(record, samples.values.shape[1], where)
    readings = _readings(samples)
    lobe = _lobe(skin, record)
    if lobe is not None and readings.view is None and notes is not None:
        text = "residuals hold the lustre, since the readings have no samples:thetaR"
        notes.append(Note("plot-without-lustre", where, text))
    delta = numbers.get("delta")
    wrap = _wrap(record, skin)
    at = Coefficients(wrap, numbers["A"], numbers["B"], lobe, delta)
    predicted = SkinModel(readings, Freedom()).values(at)
    assert readings.mask is not None
    beyond = ["lustre"] * (lobe is not None and readings.view is not None)
    beyond += ["attenuation"] * (delta is not None and readings.thickness is not None)
    return DrawnFit(
        names=_titles(samples),
        theta_deg=readings.theta_deg,
        values=readings.values,
        predicted=predicted,
        sigma=_sigma(readings, predicted),
        used=readings.mask,
        wrap=wrap,
        lambert=numbers["A"],
        wrapped=numbers["B"],
        covariance=_covariance(record, len(numbers["A"])),
        beyond=" and ".join(beyond),
    )


def _numbers(record: SkinFitRecord, columns: int, where: str) -> dict[str, FloatArray]:
    """Return A, B and perhaps delta of every column."""
    found: dict[str, list[float]] = {}
    values = np.zeros(0) if record.values is None else record.values
    for name, value in zip(record.parameters, values, strict=False):
        match = _NAME.match(name)
        if match:
            found.setdefault(match[1], []).append(float(value))
    if any(len(found.get(kind, ())) != columns for kind in "AB") or (
        len(found.get("delta", [0.0] * columns)) != columns
    ):
        raise LayerError(
            f"{where}: has {columns} values per reading, but fit:parameters name "
            f"{len(found.get('A', ()))} of A and {len(found.get('B', ()))} of B; estimate the "
            "skin again"
        )
    return {kind: np.array(row) for kind, row in found.items()}


def _wrap(record: SkinFitRecord, skin: SkinParameters) -> float:
    if record.values is not None and "wrap" in record.parameters:
        return float(record.values[record.parameters.index("wrap")])
    return skin.wrap


def _covariance(record: SkinFitRecord, columns: int) -> FloatArray | None:
    """Return the covariance of l, A and B in this order."""
    if record.covariance is None or "wrap" not in record.parameters:
        return None
    rows = [record.parameters.index("wrap")]
    for kind in "AB":
        rows += [i for i, name in enumerate(record.parameters) if name.startswith(f"{kind}[")]
    assert len(rows) == 1 + 2 * columns  # _numbers
    return np.asarray(record.covariance[np.ix_(rows, rows)])


def _lobe(skin: SkinParameters, record: SkinFitRecord) -> Lobe | None:
    if not any(name.startswith("specular:") for name in record.parameters):
        return None
    return Lobe(skin.specular_weight, skin.roughness1, skin.roughness2, skin.mix, skin.f0)


def _readings(samples: SkinSamples) -> Readings:
    assert samples.theta_i is not None and samples.values is not None  # _fit
    thickness = samples.thickness
    if thickness is not None:
        thickness = np.broadcast_to(thickness, samples.theta_i.shape)
    return readings_from_angles(
        samples.theta_i,
        samples.theta_r,
        samples.azimuth,
        samples.values if samples.white is None else samples.values / samples.white,
        thickness=thickness,
        mask=samples.mask,
        where=samples.where,
    )


def _titles(samples: SkinSamples) -> tuple[str, ...]:
    assert samples.values is not None  # _fit
    if samples.wavelength_nm is not None:
        return tuple(f"{nm:g} nm" for nm in samples.wavelength_nm)
    count = samples.values.shape[1]
    return _CHANNELS if count == 3 else tuple(f"channel {index + 1}" for index in range(count))


def _sigma(readings: Readings, predicted: FloatArray) -> FloatArray:
    """Return standard deviations in the usual proportions, of the size that residuals say."""
    sigma = Noise().sigma(predicted)
    scaled = ((readings.values - predicted) / sigma)[readings.mask]
    scale = float(np.sqrt((scaled**2).mean())) if scaled.size else 1.0
    return np.asarray(sigma * max(scale, _LEAST_SCALE))
