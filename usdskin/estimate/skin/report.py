"""What an estimate of skin found, for people and for programs."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any

import numpy as np

from usdskin.estimate.skin.fit import SkinFit
from usdskin.estimate.skin.spectra_of_channels import SkinSpectra


@dataclass(frozen=True, slots=True, eq=False)
class SkinReport:
    """The figures of one estimate."""

    fit: SkinFit
    """What was fitted."""

    spectra: SkinSpectra
    """What it means."""

    names: tuple[str, ...]
    """Names of the readings' columns."""

    by_prior: bool
    """Whether spectra come from a camera's channels by the skin prior."""

    shared: float = 1.0
    """What standard deviations were widened by because readings share errors [1]."""

    def lines(self) -> Iterator[str]:
        """Yield what a person wants to read."""
        fit, spectra = self.fit, self.spectra
        used, count = int(np.count_nonzero(fit.used)), len(fit.used)
        reach = fit.identifiability
        degrees = reach.reach_deg
        yield f"readings: {used} of {count} used, up to {degrees:.0f} degrees from the light"
        yield f"l {fit.wrap:.4f} +- {_error(fit.stddev[0])}"
        yield f"alpha {spectra.alpha:.4f} +- {_error(spectra.alpha_stddev)}"
        yield (
            f"S {_range(spectra.reflectance)}, +- {_error(np.median(spectra.reflectance_stddev))}"
            + (", by the skin prior" if self.by_prior else "")
        )
        yield (
            f"Ss {_range(spectra.scattering)}, +- {_error(np.median(spectra.scattering_stddev))}"
        )
        if fit.lobe is not None:
            lobe = fit.lobe
            yield (
                f"specular: weight {lobe.weight:.3f}, roughness {lobe.roughness1:.3f} and "
                f"{lobe.roughness2:.3f}, mix {lobe.mix:.2f}"
            )
        if fit.delta is not None:
            yield f"opacity: {_range(fit.delta)} 1/m"
        yield (
            f"residual: {100.0 * fit.residual_rms:.2f} % of the peak, "
            f"{fit.noise * self.shared:.2f} times the noise assumed"
        )
        yield from (f"told: {text}" for text in reach.told)
        yield from (f"not told: {text}" for text in reach.untold)

    def as_dict(self) -> dict[str, Any]:
        """Return the same as plain values."""
        fit, spectra = self.fit, self.spectra
        fields: dict[str, Any] = {
            "readings": len(fit.used),
            "used": int(np.count_nonzero(fit.used)),
            "reach": fit.identifiability.reach_deg,
            "neededReach": fit.identifiability.needed_deg,
            "wrap": fit.wrap,
            "wrapStddev": float(fit.stddev[0]),
            "alpha": spectra.alpha,
            "alphaStddev": spectra.alpha_stddev,
            "columns": list(self.names),
            "A": fit.lambert.tolist(),
            "B": fit.wrapped.tolist(),
            "residual": fit.residual_rms,
            "noise": fit.noise * self.shared,
            "told": list(fit.identifiability.told),
            "untold": list(fit.identifiability.untold),
        }
        if fit.lobe is not None:
            fields["specular"] = {
                "weight": fit.lobe.weight,
                "roughness1": fit.lobe.roughness1,
                "roughness2": fit.lobe.roughness2,
                "mix": fit.lobe.mix,
            }
        if fit.delta is not None:
            fields["opacity"] = fit.delta.tolist()
        return fields


def _error(value: Any) -> str:
    number = float(value)
    return f"{number:.4f}" if np.isfinite(number) and number < 1e6 else "not told"


def _range(values: Any) -> str:
    array = np.asarray(values)
    return f"{array.min():.3g} to {array.max():.3g}"
