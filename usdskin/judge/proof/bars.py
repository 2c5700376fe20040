"""What a proof has to reach: the bars, and which of them it reaches."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

from usdskin.judge.proof.options import ProofOptions

IDEAL = {False: 0.3, True: 0.5}
"""Mean dE2000 of recovery alone: one lamp, mixed light."""

REALISTIC = 0.4
"""Mean dE2000 of a realistic capture whose scale is exact."""

SCALE_ERROR = 0.8
"""The same with readings that err by up to three per cent."""

CHAIN_MEAN, CHAIN_P95 = 1.0, 2.5
"""dE2000 of the whole chain with the estimated skin."""


def bars_of(
    comparisons: Sequence[Mapping[str, Any]], options: ProofOptions, is_mixed: bool
) -> list[dict[str, Any]]:
    """Return every bar that a proof is held to, whether it is met, and the noise of what is judged.

    Where the noise, by which two renders of the truth differ, is above the bar, it tells nothing.

    Args:
        comparisons: As ``proof.json`` holds them.
        options: What the proof was told.
        is_mixed: Whether there is more than one class of light.
    """
    rows = []
    for comparison in comparisons:
        name, integrator = comparison["name"], comparison["integrator"]
        found = comparison["result"]["deltaE2000"]
        noise = (comparison.get("noise") or {}).get("deltaE2000", {})
        if name == "light":
            limits = {"mean": light_bar(options, is_mixed)}
        elif name == "chain":
            limits = {"mean": CHAIN_MEAN, "p95": CHAIN_P95}
        else:
            continue
        for statistic, bar in limits.items():
            value = float(found[statistic])
            rows.append(
                {
                    "name": f"{name}, {integrator}: dE2000 {statistic}",
                    "value": value,
                    "bar": bar,
                    "met": value <= bar,
                    "noise": float(noise.get(statistic, 0.0)),
                }
            )
    return rows


def light_bar(options: ProofOptions, is_mixed: bool) -> float:
    """Return the bar of the estimated light under the true skin."""
    if options.scale_error != 0.0:
        return SCALE_ERROR
    return IDEAL[is_mixed] if options.capture == "ideal" else REALISTIC
