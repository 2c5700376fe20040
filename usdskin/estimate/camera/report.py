"""What a calibration found, for people and for programs."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any

import numpy as np

from usdskin.estimate.camera.patches import UsedPatches
from usdskin.estimate.camera.step import CalibrationResult
from usdskin.prims import Recovery, SpectralCamera

_WORST = 3


@dataclass(frozen=True, slots=True, eq=False)
class CalibrationReport:
    """The figures of one calibration."""

    camera: SpectralCamera
    used: tuple[UsedPatches, ...]

    def lines(self) -> Iterator[str]:
        """Yield what a person wants to read."""
        camera = self.camera
        noise = ", ".join(f"{100.0 * value:.2f}" for value in camera.noise)
        yield f"camera: {camera.model or 'not named'}, {camera.lens or 'lens not named'}"
        yield f"camera values: relative noise of R, G, B {noise} %"
        yield (
            "dE2000: CIE 1931, a perfect diffuser has Y 100 and is the white; each patch left out "
            "in turn"
        )
        for recovery, used in zip(camera.recoveries, self.used, strict=True):
            yield from _lines(recovery, used)

    def as_dict(self) -> dict[str, Any]:
        """Return the same as plain values."""
        return {
            "units": self.camera.units,
            "noise": [float(value) for value in self.camera.noise],
            "classes": [
                _fields(recovery, used)
                for recovery, used in zip(self.camera.recoveries, self.used, strict=True)
            ],
        }


def report_of(result: CalibrationResult) -> CalibrationReport:
    """Return the report of a calibration."""
    return CalibrationReport(result.camera, result.used)


def _lines(recovery: Recovery, used: UsedPatches) -> Iterator[str]:
    left_out = f", left out: {', '.join(used.left_out)}" if used.left_out else ""
    count = len(used.names)
    yield f"{recovery.light_class}: {recovery.estimator} from {count} patches{left_out}"
    yield (
        f"  GFC {recovery.loo_gfc:.4f}, RMSE {100.0 * recovery.loo_rmse:.2f} % of the light's "
        f"peak, dE2000 {recovery.loo_delta_e_2000:.2f}"
    )
    yield (
        f"  condition {recovery.condition:.3g}, |G t - I| {recovery.identity_error:.2g}, "
        f"negative energy {100.0 * recovery.negative_share:.2f} %"
    )
    if recovery.patch_delta_e_2000 is not None and len(recovery.patches):
        order = np.argsort(-recovery.patch_delta_e_2000, kind="stable")[:_WORST]
        worst = [f"{recovery.patches[i]} {recovery.patch_delta_e_2000[i]:.1f}" for i in order]
        yield f"  largest dE2000: {', '.join(worst)}"
    if recovery.grey_delta_e is not None and recovery.skin_delta_e is not None:
        yield (
            f"  expected dE2000 of a grey {recovery.grey_delta_e:.2f}, of skin "
            f"{recovery.skin_delta_e:.2f}"
        )


def _fields(recovery: Recovery, used: UsedPatches) -> dict[str, Any]:
    fields: dict[str, Any] = {
        "class": recovery.light_class,
        "estimator": recovery.estimator,
        "patches": len(used.names),
        "leftOut": list(used.left_out),
        "ridge": recovery.ridge,
        "condition": recovery.condition,
        "identityError": recovery.identity_error,
        "gfc": recovery.loo_gfc,
        "rmse": recovery.loo_rmse,
        "deltaE2000": recovery.loo_delta_e_2000,
        "negativeShare": recovery.negative_share,
    }
    if recovery.grey_delta_e is not None:
        fields |= {
            "greyDeltaE2000": recovery.grey_delta_e,
            "skinDeltaE2000": recovery.skin_delta_e,
        }
    return fields
