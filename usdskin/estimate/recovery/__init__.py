"""From camera values to spectra: the generalised inverses, and how good they are."""

from usdskin.estimate.recovery.recover import ESTIMATORS, recover
from usdskin.estimate.recovery.responsivity import (
    Responsivity,
    estimate_responsivity,
    in_one_unit,
)
from usdskin.estimate.recovery.training import Training

__all__ = [
    "ESTIMATORS",
    "Responsivity",
    "Training",
    "estimate_responsivity",
    "in_one_unit",
    "recover",
]
