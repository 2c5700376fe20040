"""Recover spectra of objects a chart did not hold: ``python -m benchmarks.recovery [--quick]``.

Every estimator under five lamps, from data that comes with colour-science: the Nikon D5100 as the
National Physical Laboratory measured it, the ColorChecker of 24 patches and the 190 reflectances
of rawtoaces, and as objects never trained on the 99 of CIE 2017. Camera values of patches err by
1 %, the spectrophotometer by 0.3 %, camera values of objects by 0.5 %, all of the value and with
a fresh seed each time. README.md beside this file says what the rows mean.
"""

from __future__ import annotations

import argparse
import sys
import time
from collections.abc import Iterator
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from benchmarks.measure import machine
from benchmarks.report import Row, Section, as_markdown, as_text, write_json
from usdskin.colorimetry import illuminant
from usdskin.differences import delta_e_of_signals, goodness_of_fit, relative_rmse
from usdskin.estimate.recovery import (
    ESTIMATORS,
    Responsivity,
    Training,
    estimate_responsivity,
    recover,
)
from usdskin.estimate.recovery.candidate import generalized_inverse
from usdskin.prims.cameras import Recovery
from usdskin.spectrum import DEFAULT_WAVELENGTHS_NM, resample

FloatArray = NDArray[np.float64]

GRID = DEFAULT_WAVELENGTHS_NM
GFC_BARS = {"A": 0.97, "FL2": 0.98, "FL11": 0.99, "D55": 0.97}
LAMPS = (*GFC_BARS, "LED-B3")
CAMERA = "Nikon 5100 (NPL)"
PATCH_NOISE, SPECTRO_NOISE, OBJECT_NOISE = 0.01, 0.003, 0.005
DELTA_E_BAR, P95_BAR, RATIO_BAR = 1.7, 3.5, 5.0
SEEDS, QUICK_SEEDS = 8, 2
COLUMNS = ("", "GFC", "dE2000 mean / p95", "RMSE, % of peak", "bar")


# --- What ships with colour-science ------------------------------------------------------------


def camera() -> FloatArray:
    """Return the responsivity, shape [61, 3]."""
    from colour import MSDS_CAMERA_SENSITIVITIES

    measured = MSDS_CAMERA_SENSITIVITIES[CAMERA]
    return resample(measured.wavelengths, measured.values.T, GRID).T


def classic_chart() -> FloatArray:
    """Return the 24 reflectances of the ColorChecker that N. Ohta measured, shape [24, 61]."""
    from colour import SDS_COLOURCHECKERS

    patches = SDS_COLOURCHECKERS["ColorChecker N Ohta"].values()
    return np.array(
        [resample(each.wavelengths, each.values, GRID, outside="hold") for each in patches]
    )


def large_chart() -> FloatArray:
    """Return the 190 reflectances that rawtoaces trains on, shape [190, 61]."""
    from colour.characterisation import read_training_data_rawtoaces_v1

    table = read_training_data_rawtoaces_v1()
    return resample(table.wavelengths, table.values.T, GRID, outside="hold")


def objects() -> FloatArray:
    """Return the 99 reflectances of CIE 224:2017, shape [99, 61]."""
    from colour import SpectralShape
    from colour.quality.cfi2017 import load_TCS_CIE2017

    table = load_TCS_CIE2017(SpectralShape(380, 780, 5))
    return resample(table.wavelengths, table.values.T, GRID, outside="hold")


# --- One calibration ---------------------------------------------------------------------------


def train(reflectances: FloatArray, lamp: str, t: FloatArray, noise: float, seed: int) -> Training:
    """Return what camera and spectrophotometer say of a chart."""
    light = illuminant(lamp, GRID)
    rng = np.random.default_rng(seed)
    signals = reflectances * light
    values = signals @ t
    values *= 1.0 + noise * rng.standard_normal(values.shape)
    signals = signals * (
        1.0 + noise * SPECTRO_NOISE / PATCH_NOISE * rng.standard_normal(signals.shape)
    )
    names = tuple(str(k) for k in range(len(signals)))
    return Training(names, values, signals, GRID, light, light_class=lamp)


@dataclass(frozen=True, slots=True)
class Errors:
    """Of 99 objects not trained on."""

    gfc: float
    delta_e: float
    p95: float
    rmse: float

    @classmethod
    def of(cls, matrix: FloatArray, lamp: str, t: FloatArray, held_out: FloatArray, seed: int):
        light = illuminant(lamp, GRID)
        signals = held_out * light
        rng = np.random.default_rng(1000 + seed)
        values = signals @ t * (1.0 + OBJECT_NOISE * rng.standard_normal((len(signals), 3)))
        spectra = values @ matrix.T
        delta_e = delta_e_of_signals(spectra, signals, light, GRID)
        return cls(
            float(goodness_of_fit(spectra, signals).mean()),
            float(delta_e.mean()),
            float(np.percentile(delta_e, 95.0)),
            float(relative_rmse(spectra, signals, light.max()).mean()),
        )


def mean(errors: list[Errors]) -> Errors:
    """Return the mean of every figure over the seeds."""
    return Errors(*np.mean([list(asdict(each).values()) for each in errors], axis=0).tolist())


def estimators(training: Training) -> Iterator[tuple[str, FloatArray, Recovery]]:
    """Yield every estimator's matrix of one calibration."""
    responsivity = estimate_responsivity([training])
    for name in ESTIMATORS:
        recovery = recover(training, responsivity, name)
        yield name, recovery.matrix, recovery
    plain = recover(training, responsivity, lamp=0.0)
    yield "regression, lamp = 0", plain.matrix, plain


# --- The tables --------------------------------------------------------------------------------


def compare(title: str, reflectances: FloatArray, seeds: int, raw: dict[str, Any]) -> list[Section]:
    """Return a table per lamp: every estimator on the same seeds."""
    t, held_out, sections = camera(), objects(), []
    for lamp in LAMPS:
        found: dict[str, list[Errors]] = {}
        told: dict[str, list[Recovery]] = {}
        for seed in range(seeds):
            training = train(reflectances, lamp, t, PATCH_NOISE, seed)
            for name, matrix, recovery in estimators(training):
                found.setdefault(name, []).append(Errors.of(matrix, lamp, t, held_out, seed))
                told.setdefault(name, []).append(recovery)
            exact = np.linalg.pinv(t).T
            found.setdefault("pinv of the exact t", []).append(
                Errors.of(exact, lamp, t, held_out, seed)
            )
        means = {name: mean(errors) for name, errors in found.items()}
        raw[f"{title}, {lamp}"] = {name: asdict(each) for name, each in means.items()}
        rows = [_row(name, errors) for name, errors in means.items()]
        rows += _told(told)
        if lamp in GFC_BARS:
            rows += _bars(means, lamp)
        sections.append(Section(f"{title} under {lamp}, {seeds} seeds", COLUMNS, rows))
    return sections


def _row(name: str, errors: Errors) -> Row:
    label = f"{name} (default)" if name == ESTIMATORS[0] else name
    return Row(
        label,
        f"{errors.gfc:.4f}",
        f"{errors.delta_e:.2f} / {errors.p95:.2f}",
        f"{100.0 * errors.rmse:.2f}",
    )


def _told(told: dict[str, list[Recovery]]) -> list[Row]:
    """Return what a calibration says of itself, without the objects."""
    rows = []
    for name in ("regression", "wiener"):
        each = told[name]
        rows.append(
            Row(
                f"  {name}: left-out patches",
                f"{np.mean([r.loo_gfc for r in each]):.4f}",
                f"{np.mean([r.loo_delta_e_2000 for r in each]):.2f}",
                f"{100.0 * np.mean([r.loo_rmse for r in each]):.2f}",
            )
        )
    grey = np.mean([r.grey_delta_e or 0.0 for r in told["wiener"]])
    skin = np.mean([r.skin_delta_e or 0.0 for r in told["wiener"]])
    rows.append(Row("  wiener: expected of grey / skin", "", f"{grey:.2f} / {skin:.2f}"))
    identity = np.mean([r.identity_error for r in told["regression"]])
    rows.append(Row("  regression: |G t - I|", f"{identity:.1e}"))
    return rows


def _bars(means: dict[str, Errors], lamp: str) -> list[Row]:
    default, exact = means[ESTIMATORS[0]], means["pinv of the exact t"]
    ratio = (1.0 - exact.gfc) / (1.0 - default.gfc)
    bar = GFC_BARS[lamp]
    return [
        Row("default: GFC", f"{default.gfc:.4f}", "", "", f">= {bar:g}", default.gfc >= bar),
        Row("default: dE2000 mean", "", f"{default.delta_e:.2f}", "", f"<= {DELTA_E_BAR:g}",
            default.delta_e <= DELTA_E_BAR),
        Row("default: dE2000 p95", "", f"{default.p95:.2f}", "", f"<= {P95_BAR:g}",
            default.p95 <= P95_BAR),
        Row("(1 - GFC) of the exact t's pinv over the default's", f"{ratio:.1f}x", "", "",
            f">= {RATIO_BAR:g}x", ratio >= RATIO_BAR),
    ]  # fmt: skip


def identities(raw: dict[str, Any]) -> Section:
    """Return how exactly noise-free calibrations without ridge invert t."""
    t, reflectances = camera(), classic_chart()
    known = Responsivity.known(GRID, t)
    worst: dict[str, float] = {}
    for lamp in LAMPS:
        training = train(reflectances, lamp, t, 0.0, 0)
        signals = training.signals
        plain = recover(training, known, ridge=0.0, exponent=0.0, lamp=0.0)
        components = np.linalg.svd(signals)[2][:3].T
        wiener = recover(training, known, "wiener", ridge=0.0, noise=np.full(3, PATCH_NOISE))
        pca = recover(training, known, "pca", exponent=0.0)
        assert wiener.prior_covariance is not None
        for name, found, expected in (
            ("regression: G t = I", plain.matrix.T @ t, np.eye(3)),
            ("regression = G_C, C = Lambda^T Lambda", plain.matrix,
             generalized_inverse(t, signals.T @ signals)),
            ("pca = G_C, C = U U^T", pca.matrix, generalized_inverse(t, components @ components.T)),
            ("wiener without noise = G_C of its prior", wiener.matrix,
             generalized_inverse(t, wiener.prior_covariance)),
        ):  # fmt: skip
            error = float(np.abs(found - expected).max() / np.abs(expected).max())
            worst[name] = max(worst.get(name, 0.0), error)
    raw["identities"] = worst
    rows = [
        Row(name, f"{error:.0e}", "", "", "<= 1e-8", error <= 1e-8) for name, error in worst.items()
    ]
    title = "Identities without noise and ridge, largest relative deviation over the lamps"
    return Section(title, ("", "deviation", "", "", "bar"), rows)


def cost(raw: dict[str, Any]) -> Section:
    """Return how long a calibration of 140 patches takes, imports apart."""
    training = train(large_chart()[:140], "FL2", camera(), PATCH_NOISE, 0)
    rows = []
    for name in ESTIMATORS:
        laps = []
        for _ in range(4):
            begun = time.perf_counter()
            recover(training, estimate_responsivity([training]), name)
            laps.append(time.perf_counter() - begun)
        raw.setdefault("seconds", {})[name] = laps[1:]
        took = float(np.median(laps[1:]))
        rows.append(Row(name, f"{took:.2f} s", "", "", "< 1 s", took < 1.0))
    title = "Responsivity and recovery of 140 patches in 61 bands"
    return Section(title, ("", "time", "", "", "bar"), rows)


def main() -> int:
    """Run it all and print the tables; 1 where a bar is missed."""
    parser = argparse.ArgumentParser(prog="python -m benchmarks.recovery", description=__doc__)
    parser.add_argument("--quick", action="store_true", help="two seeds, the small chart only")
    parser.add_argument("--json", type=Path, metavar="FILE", help="write every figure")
    parser.add_argument("--markdown", type=Path, metavar="FILE", help="write the tables")
    given = parser.parse_args()
    about, raw = machine(), {}
    sections = [identities(raw), cost(raw)]
    seeds = QUICK_SEEDS if given.quick else SEEDS
    sections += compare("ColorChecker, 24 patches,", classic_chart(), seeds, raw)
    if not given.quick:
        sections += compare("rawtoaces, 190 patches,", large_chart(), seeds, raw)
    print(as_text(about, sections))
    if given.markdown:
        given.markdown.write_text(as_markdown(about, sections))
    if given.json:
        write_json(given.json, about, sections, raw)
    return 1 if any(row.is_met is False for section in sections for row in section.rows) else 0


if __name__ == "__main__":
    sys.exit(main())
