"""What the schema language cannot say about a schema's values, one table entry per schema.

A rule gets the values of all attributes of one applied schema, by name, and yields what is wrong
with them. Attributes without a value are None.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

Values = Mapping[str, Any]

_SIGNED_QUANTITIES = ("responsivity", "relative")
_PERCENT = 3.0
"""Largest reflectance [1]; fluorescent paper and lustre stay below it, percents do not."""


@dataclass(frozen=True, slots=True)
class Complaint:
    """What is wrong with an attribute, given the others of its schema."""

    code: str
    """Stable kebab-case name."""

    name: str
    """Name of the attribute in the schema."""

    message: str
    """What is wrong and what to do, to be read after the attribute's name."""


Rule = Callable[[Values], Iterator[Complaint]]


def _count(value: Any) -> int:
    return 0 if value is None else len(value)


def wavelengths(name: str, at_least: int = 0) -> Rule:
    """Return the rule that wavelengths are positive, ascending and in nanometres."""

    def rule(values: Values) -> Iterator[Complaint]:
        grid = values[name]
        if _count(grid) < at_least:
            text = f"has {_count(grid)} entries; give at least {at_least}"
            yield Complaint("too-few-wavelengths", name, text)
        if not _count(grid):
            return
        falls = np.flatnonzero(np.diff(grid) <= 0.0)
        if falls.size:
            at = int(falls[0]) + 1
            text = (
                f"is not ascending at index {at} ({grid[at]!s} after {grid[at - 1]!s}); "
                "sort the samples"
            )
            yield Complaint("not-ascending", name, text)
        elif grid[0] <= 0.0:
            text = f"starts at {grid[0]!s}; a wavelength is above 0 nm"
            yield Complaint("out-of-range", name, text)
        elif grid[-1] < 10.0:
            text = f"ends at {grid[-1]!s} nm, which looks like micrometres; multiply it by 1000"
            yield Complaint("out-of-range", name, text)

    return rule


def one_per(name: str, beside: str, *, columns: int = 1, or_single: bool = False) -> Rule:
    """Return the rule that an array has ``columns`` values for each entry of another."""

    def rule(values: Values) -> Iterator[Complaint]:
        if values[name] is None or (or_single and len(values[name]) <= 1):
            return
        count, expected = len(values[name]), columns * _count(values[beside])
        if count != expected:
            each = "one" if columns == 1 else str(columns)
            yield Complaint(
                "unequal-lengths",
                name,
                f"has {count} values but {beside} has {_count(values[beside])}; give {each} for "
                f"each of them",
            )

    return rule


def rows(name: str, row_length_of: str, rows_of: str | None = None) -> Rule:
    """Return the rule that a row-major matrix has whole rows, as long as another array."""

    def rule(values: Values) -> Iterator[Complaint]:
        if values[name] is None:
            return
        count, row = len(values[name]), _count(values[row_length_of])
        if row == 0 or count % row or count == 0:
            yield Complaint(
                "unequal-lengths",
                name,
                f"has {count} values, which are no whole rows of {row}, the number of "
                f"{row_length_of}; give every row one value per column",
            )
        elif rows_of is not None and _count(values[rows_of]) != count // row:
            yield Complaint(
                "unequal-lengths",
                name,
                f"has {count // row} rows but {rows_of} has {_count(values[rows_of])} entries; "
                "give one row for each",
            )

    return rule


def counts(name: str, allowed: Sequence[int], what: str) -> Rule:
    """Return the rule that an array has one of the allowed numbers of values."""

    def rule(values: Values) -> Iterator[Complaint]:
        if values[name] is not None and len(values[name]) not in allowed:
            yield Complaint("unequal-lengths", name, f"has {len(values[name])} values; give {what}")

    return rule


def above(name: str, bound: float, *, inclusive: bool = True, below: float = np.inf) -> Rule:
    """Return the rule that all values of an array lie in a range."""

    def rule(values: Values) -> Iterator[Complaint]:
        if values[name] is None:
            return
        array = np.ravel(values[name])
        low = array < bound if inclusive else array <= bound
        bad = np.flatnonzero(low | (array > below))
        if bad.size:
            at = int(bad[0])
            sign = "at least" if inclusive else "above"
            limit = f"{sign} {bound:g}" + ("" if np.isinf(below) else f" and at most {below:g}")
            text = f"is {array[at]!s} at index {at}; it must be {limit}"
            yield Complaint("out-of-range", name, text)

    return rule


def needed(token_name: str, token: str, *names: str) -> Rule:
    """Return the rule that attributes have values where a token asks for them."""

    def rule(values: Values) -> Iterator[Complaint]:
        if values[token_name] == token:
            for name in names:
                if values[name] is None:
                    text = f'has no value, but {token_name} is "{token}"; set it'
                    yield Complaint("missing-value", name, text)

    return rule


def together(name: str, *others: str) -> Rule:
    """Return the rule that one attribute needs others."""

    def rule(values: Values) -> Iterator[Complaint]:
        if values[name] is not None:
            for other in others:
                if values[other] is None:
                    yield Complaint("missing-value", other, f"has no value, but {name} has; set it")

    return rule


def either(first: str, second: str) -> Rule:
    """Return the rule that two attributes exclude each other."""

    def rule(values: Values) -> Iterator[Complaint]:
        if values[first] is not None and values[second] is not None:
            yield Complaint("conflict", second, f"is set beside {first}; remove one of them")

    return rule


def _distribution(values: Values) -> Iterator[Complaint]:
    if values["wavelengths"] is None and values["values"] is None:
        text = "has no samples; author wavelengths and values, or remove the applied schema"
        yield Complaint("missing-value", "values", text)
    elif values["values"] is None:
        yield Complaint("missing-value", "values", "has no samples; give one for each wavelength")
    elif _count(values["values"]) == 0:
        yield Complaint("missing-value", "values", "is empty; give one for each wavelength")
    elif values["quantity"] not in _SIGNED_QUANTITIES:
        negative = np.flatnonzero(values["values"] < 0.0)
        if negative.size:
            at = int(negative[0])
            yield Complaint(
                "negative-value",
                "values",
                f"is {values['values'][at]!s} at index {at}, but "
                f"{values['quantity'] or 'it'} is never negative; correct the "
                f"{negative.size} negative samples",
            )
    if values["quantity"] == "reflectance" and _count(values["values"]):
        at = int(np.argmax(values["values"]))
        if values["values"][at] > _PERCENT:
            yield Complaint(
                "looks-like-percent",
                "values",
                f"is {values['values'][at]!s} at index {at}, but a reflectance of all light is 1; "
                "divide percents by 100",
            )


def _levels(values: Values) -> Iterator[Complaint]:
    black, white = values["bracket:blackLevel"], values["bracket:whiteLevel"]
    if black is not None and white is not None and len(black) and len(white):
        if np.max(black) >= np.min(white):
            text = f"is {np.min(white)!s}, not above the black level {np.max(black)!s}; correct one"
            yield Complaint("out-of-range", "bracket:whiteLevel", text)


def _square(name: str) -> Rule:
    def rule(values: Values) -> Iterator[Complaint]:
        if values[name] is not None and round(len(values[name]) ** 0.5) ** 2 != len(values[name]):
            text = f"has {len(values[name])} values, which is no square matrix; give n rows of n"
            yield Complaint("unequal-lengths", name, text)

    return rule


def _recovery(values: Values) -> Iterator[Complaint]:
    if values["matrix"] is None:
        return
    count, rest = divmod(len(values["matrix"]), 3)
    if rest or not count:
        text = f"has {len(values['matrix'])} values; give 3 for each wavelength"
        yield Complaint("unequal-lengths", "matrix", text)
        return
    for name, expected in (
        ("illuminant", count),
        ("priorMean", count),
        ("priorCovariance", count**2),
        ("posteriorStddev", count),
    ):
        if values[name] is not None and len(values[name]) != expected:
            text = f"has {len(values[name])} values; {count} rows of the matrix ask for {expected}"
            yield Complaint("unequal-lengths", name, text)


def _directions(name: str) -> Rule:
    def rule(values: Values) -> Iterator[Complaint]:
        if values[name] is None:
            return
        vectors = np.reshape(values[name], (-1, 3))
        bad = np.flatnonzero(np.linalg.norm(vectors, axis=1) <= 0.0)
        if bad.size:
            text = f"is a vector of length 0 at index {bad[0]}; give it a direction"
            yield Complaint("out-of-range", name, text)

    return rule


RULES: Mapping[str, tuple[Rule, ...]] = {
    "SpectralDistributionAPI": (
        wavelengths("wavelengths"),
        one_per("values", "wavelengths"),
        _distribution,
    ),
    "SpectralLightAPI": (
        wavelengths("inputs:spectral:basis:wavelengths"),
        rows("inputs:spectral:basis", "inputs:spectral:basis:wavelengths"),
        needed(
            "inputs:spectral:source",
            "basis",
            "inputs:spectral:basis",
            "inputs:spectral:basis:wavelengths",
            "inputs:spectral:coefficients:file",
        ),
        needed("inputs:spectral:source", "bands", "inputs:spectral:bands:file"),
    ),
    "SpectralCameraAPI": (
        wavelengths("spectral:wavelengths"),
        one_per("spectral:responsivity", "spectral:wavelengths", columns=3),
        counts("spectral:noise", (0, 3, 9), "3, or 9 for a covariance"),
        above("spectral:settings:iso", 0.0, inclusive=False),
    ),
    "SpectralRecoveryAPI": (
        _recovery,
        above("illuminant", 0.0),
        above("posteriorStddev", 0.0),
        one_per("patchGfc", "patches"),
        one_per("patchRmse", "patches"),
        one_per("patchDeltaE2000", "patches"),
    ),
    "LightEstimateAPI": (
        one_per("estimate:classShares", "estimate:classes"),
        above("estimate:classShares", 0.0),
    ),
    "FisheyeCameraAPI": (above("fisheye:resolution", 1.0),),
    "CaptureAPI": (
        _directions("capture:illuminance:direction"),
        _directions("capture:luminance:direction"),
        above("capture:settings:iso", 0.0, inclusive=False),
    ),
    "ExposureBracketAPI": (
        one_per("bracket:exposureTimes", "bracket:images"),
        one_per("bracket:iso", "bracket:images", or_single=True),
        one_per("bracket:fNumbers", "bracket:images", or_single=True),
        one_per("bracket:ndFactors", "bracket:images", or_single=True),
        above("bracket:exposureTimes", 0.0, inclusive=False),
        above("bracket:iso", 0.0, inclusive=False),
        above("bracket:fNumbers", 0.0, inclusive=False),
        above("bracket:ndFactors", 1.0),
        one_per("bracket:gain", "bracket:images", or_single=True),
        one_per("bracket:readNoise", "bracket:images", or_single=True),
        above("bracket:gain", 0.0, inclusive=False),
        above("bracket:readNoise", 0.0),
        counts("bracket:blackLevel", (0, 1, 3), "one, or one per channel"),
        counts("bracket:whiteLevel", (0, 1, 3), "one, or one per channel"),
        _levels,
    ),
    "ColorChartAPI": (
        wavelengths("chart:wavelengths"),
        one_per("chart:cameraValues", "chart:patches", columns=3),
        rows("chart:signals", "chart:wavelengths", "chart:patches"),
        rows("chart:reflectances", "chart:wavelengths", "chart:patches"),
        either("chart:signals", "chart:signals:file"),
        either("chart:signals", "chart:reflectances"),
        either("chart:signals", "chart:reflectances:file"),
        either("chart:signals:file", "chart:reflectances"),
        either("chart:signals:file", "chart:reflectances:file"),
        either("chart:reflectances", "chart:reflectances:file"),
        either("chart:cameraValues", "chart:cameraValues:file"),
        either("chart:cameraValues", "chart:image:file"),
        either("chart:cameraValues:file", "chart:image:file"),
        above("chart:signals", 0.0),
        above("chart:reflectances", 0.0),
        counts("chart:corners", (0, 4), "the 4 corners"),
        above("chart:settings:iso", 0.0, inclusive=False),
    ),
    "SkinSampleAPI": (
        wavelengths("samples:wavelengths"),
        either("samples:light", "samples:thetaI"),
        either("samples:view", "samples:thetaR"),
        one_per("samples:view", "samples:light"),
        one_per("samples:normal", "samples:light", or_single=True),
        one_per("samples:thetaR", "samples:thetaI"),
        one_per("samples:azimuth", "samples:thetaI"),
        either("samples:values", "samples:values:file"),
        either("samples:thetaI", "samples:values:file"),
        either("samples:light", "samples:values:file"),
        above("samples:white", 0.0, inclusive=False),
        above("samples:thickness", 0.0),
        _directions("samples:light"),
        _directions("samples:view"),
        _directions("samples:normal"),
        above("samples:thetaI", 0.0, below=180.0),
        above("samples:thetaR", -90.0, below=90.0),
    ),
    "SkinMaterialAPI": (
        wavelengths("inputs:skin:weights:basis:wavelengths"),
        rows("inputs:skin:weights:basis", "inputs:skin:weights:basis:wavelengths"),
        above("inputs:skin:weights:basis", 0.0),
        together(
            "inputs:skin:weights:file",
            "inputs:skin:weights:basis",
            "inputs:skin:weights:basis:wavelengths",
        ),
        either("inputs:skin:albedo:file", "inputs:skin:weights:file"),
        _square("fit:covariance"),
        one_per("fit:values", "fit:parameters"),
    ),
    "SkinTransferAPI": (above("transfer:reach", 0.0),),
    "SkinRenderSettingsAPI": (wavelengths("usdskin:wavelengths", at_least=2),),
}
"""Rules by schema identifier; names as in ``schema.usda``."""
