"""Luminous intensity distributions of lamps: files of IES LM-63 with Type C photometry.

The format is ANSI/IES LM-63 (1986 to 2019): a version line, keywords, ``TILT=``, then numbers that
may be broken into lines anywhere.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from usdskin.errors import UsdSkinError

FloatArray = NDArray[np.float64]

_STEPS_DEG = (90.0, 45.0, 30.0, 22.5, 15.0, 10.0, 7.5, 5.0, 2.5, 2.0, 1.0, 0.5, 0.25, 0.1)
"""Spacings tried for the even grid; the last one is used where none meets all angles."""

_HEMISPHERE = np.pi / 2.0 + 0.1
"""Range of theta up to which a profile covers half a sphere [rad]."""

_MOST_BYTES = 1 << 24
_MOST_VALUES = 1 << 21


@dataclass(frozen=True, slots=True, eq=False)
class ProfileGrid:
    """A profile over evenly spaced angles, both ends included."""

    theta_step: float
    """[rad]."""

    phi_step: float
    """[rad]."""

    value: FloatArray
    """Rows over theta from 0 to pi, columns over phi from 0 to 2 pi, shape [rows, columns]."""


@dataclass(frozen=True, slots=True, eq=False)
class IntensityProfile:
    """Luminous intensity over direction, linear in both angles between its samples."""

    theta_deg: FloatArray
    """Angles from straight down [deg], ascending within 0 to 180; zero outside, shape [n]."""

    phi_deg: FloatArray
    """Angles about the vertical [deg], from 0 to 360, shape [m]."""

    intensity: FloatArray
    """[cd], shape [n, m]."""

    def mean(self) -> float:
        """Return the mean intensity over the sphere, or the hemisphere that the angles cover [cd].

        It is what ``inputs:shaping:ies:normalize`` divides by, as in OpenUSD's hdEmbree, so that a
        light keeps its power.
        """
        theta = np.radians(self.theta_deg)
        over_phi = np.trapezoid(self.intensity, np.radians(self.phi_deg), axis=1)
        # Between samples: int (a + b theta) sin = [-(a + b theta) cos + b sin].
        slope = np.diff(over_phi) / np.diff(theta)
        ends = -over_phi * np.cos(theta)
        flux = float((ends[1:] - ends[:-1] + slope * np.diff(np.sin(theta))).sum())
        covers_half = theta[-1] - theta[0] <= _HEMISPHERE
        return flux / (2.0 * np.pi if covers_half else 4.0 * np.pi)

    def scaled(self, factor: float) -> IntensityProfile:
        """Return the profile times a factor."""
        return IntensityProfile(self.theta_deg, self.phi_deg, self.intensity * factor)

    def grid(self) -> ProfileGrid:
        """Return the profile on the widest even grid that holds its samples."""
        theta_step = _common_step(self.theta_deg)
        phi_step = _common_step(self.phi_deg)
        theta = np.linspace(0.0, 180.0, round(180.0 / theta_step) + 1)
        phi = np.linspace(0.0, 360.0, round(360.0 / phi_step) + 1)
        over_theta = np.stack(
            [
                np.interp(theta, self.theta_deg, column, left=0.0, right=0.0)
                for column in self.intensity.T
            ],
            axis=1,
        )
        value = np.stack([np.interp(phi, self.phi_deg, row) for row in over_theta])
        return ProfileGrid(np.radians(theta_step), np.radians(phi_step), value)


def _common_step(angle_deg: FloatArray) -> float:
    """Return the widest known spacing whose multiples hold all angles."""
    for step in _STEPS_DEG:
        if np.abs(angle_deg / step - np.round(angle_deg / step)).max() < 1e-6:
            return step
    return _STEPS_DEG[-1]


class _Numbers:
    """The numbers of a file, one after the other, with the lines they are in."""

    def __init__(self, path: Path, lines: list[str], first: int) -> None:
        self._path = path
        self._words = [
            (number, word)
            for number, line in enumerate(lines[first:], first + 1)
            for word in line.replace(",", " ").split()
        ]
        self._next = 0
        self._last_line = max(len(lines), 1)

    @property
    def line(self) -> int:
        """Line of the number that was read last."""
        return self._words[self._next - 1][0] if self._next else self._last_line

    @property
    def left(self) -> int:
        """How many are left."""
        return len(self._words) - self._next

    def one(self, what: str) -> float:
        """Return the next number."""
        if self._next >= len(self._words):
            raise UsdSkinError(
                f"{self._path}:{self._last_line}: the file ends before {what}; export it again"
            )
        line, word = self._words[self._next]
        self._next += 1
        try:
            value = float(word)
        except ValueError:
            value = np.nan
        if not np.isfinite(value):
            raise UsdSkinError(
                f"{self._path}:{line}: {word[:40]!r} stands where {what} is to be; write a number"
            )
        return value

    def count(self, what: str) -> int:
        """Return the next number, which counts something."""
        value = self.one(what)
        if not (value == int(value) and 1 <= value <= _MOST_VALUES):
            raise UsdSkinError(
                f"{self._path}:{self.line}: {what} is {value:g}; give a whole number above 0"
            )
        return int(value)

    def many(self, count: int, what: str) -> FloatArray:
        """Return the next numbers."""
        if count > self.left:
            raise UsdSkinError(
                f"{self._path}:{self._last_line}: the file has {self.left} numbers where {count} "
                f"of {what} are to be; export it again"
            )
        return np.array([self.one(what) for _ in range(count)])


def read_ies(path: str | Path) -> IntensityProfile:
    """Read a photometric file.

    Multiplier and ballast factor are applied. What the file says of the lamp's size, its power and
    the change of its flux with tilt (``TILT=INCLUDE``) is not used.

    Args:
        path: File of LM-63 with Type C photometry.

    Raises:
        UsdSkinError: The file is missing or cannot be used; the message names file and line.
    """
    path = Path(path)
    try:
        if path.stat().st_size > _MOST_BYTES:
            raise UsdSkinError(f"{path}: larger than {_MOST_BYTES >> 20} MiB, so no IES file")
        text = path.read_bytes().decode("latin-1")
    except OSError as error:
        raise UsdSkinError(f"{path}: {error.strerror}; restore it or correct the path") from None
    lines = text.replace("\r\n", "\n").replace("\r", "\n").split("\n")
    tilt = next((k for k, line in enumerate(lines) if line.strip().upper().startswith("TILT")), -1)
    if tilt < 0:
        raise UsdSkinError(f"{path}:1: no line TILT=, so no file of IES LM-63; export it as .ies")
    kind = lines[tilt].partition("=")[2].strip().upper()
    if kind not in ("NONE", "INCLUDE"):
        raise UsdSkinError(
            f"{path}:{tilt + 1}: TILT={kind[:40]} names another file; write TILT=NONE"
        )
    numbers = _Numbers(path, lines, tilt + 1)
    if kind == "INCLUDE":
        numbers.one("the lamp's geometry")
        numbers.many(2 * numbers.count("the number of tilts"), "tilts and their factors")
    return _read_table(path, numbers)


def _read_table(path: Path, numbers: _Numbers) -> IntensityProfile:
    numbers.one("the number of lamps")
    numbers.one("the lumens per lamp")
    factor = numbers.one("the candela multiplier")
    theta_count = numbers.count("the number of vertical angles")
    phi_count = numbers.count("the number of horizontal angles")
    photometry = numbers.one("the photometric type")
    if photometry != 1.0:
        kind = {2.0: "B", 3.0: "A"}.get(photometry, f"{photometry:g}")
        raise UsdSkinError(
            f"{path}:{numbers.line}: photometric type {kind}; only Type C (1) can be read, so "
            "convert it"
        )
    numbers.many(4, "the units and the size of the luminous opening")
    factor *= numbers.one("the ballast factor") * numbers.one("the ballast-lamp factor")
    numbers.one("the input watts")
    theta = numbers.many(theta_count, "the vertical angles")
    _check_ascending(path, numbers.line, theta, "vertical", 180.0)
    phi = numbers.many(phi_count, "the horizontal angles")
    phi_line = numbers.line
    _check_ascending(path, phi_line, phi, "horizontal", 360.0)
    values = numbers.many(theta_count * phi_count, "candela values") * factor
    if values.min() < 0.0 or not values.max() > 0.0:
        raise UsdSkinError(
            f"{path}:{numbers.line}: its intensity is negative somewhere, or nowhere above 0; "
            "correct the candela values or the multiplier"
        )
    if theta_count < 2:
        raise UsdSkinError(f"{path}:{numbers.line}: a single vertical angle; give two or more")
    around, table = _all_around(path, phi_line, phi, values.reshape(phi_count, theta_count))
    return IntensityProfile(theta, around, np.ascontiguousarray(table.T))


def _check_ascending(path: Path, line: int, angle: FloatArray, name: str, highest: float) -> None:
    if (np.diff(angle) <= 0.0).any() or angle[0] < 0.0 or angle[-1] > highest:
        raise UsdSkinError(
            f"{path}:{line}: the {name} angles of Type C ascend within 0 to {highest:g}, and these "
            f"go from {angle[0]:g} to {angle[-1]:g}; correct them"
        )


def _all_around(
    path: Path, line: int, phi: FloatArray, table: FloatArray
) -> tuple[FloatArray, FloatArray]:
    """Return horizontal angles from 0 to 360 and their rows, by the symmetry that LM-63 means.

    The last angle is 0 (the same all around), 90 (each quadrant alike), 180 (both sides of the
    plane 0-180 alike) or 360; from 90 to 270 both sides of that plane are alike.
    """
    if len(phi) == 1:
        return np.array([0.0, 360.0]), np.repeat(table, 2, axis=0)
    first, last = phi[0], phi[-1]
    if (first, last) == (0.0, 90.0):
        phi = np.concatenate([phi, 180.0 - phi[-2::-1]])
        table = np.concatenate([table, table[-2::-1]])
        last = 180.0
    if (first, last) == (0.0, 180.0):
        return (
            np.concatenate([phi, 360.0 - phi[-2::-1]]),
            np.concatenate([table, table[-2::-1]]),
        )
    if (first, last) == (90.0, 270.0):
        # The mirror of 90..270 is 90..-90; what is below 0 comes again above 270.
        turned = np.concatenate([180.0 - phi[:0:-1], phi, 540.0 - phi[-2::-1]])
        rows = np.concatenate([table[:0:-1], table, table[-2::-1]])
        at = np.unique(np.concatenate([[0.0, 360.0], turned[(turned > 0.0) & (turned < 360.0)]]))
        return at, np.stack([np.interp(at, turned, column) for column in rows.T], axis=1)
    if first == 0.0 and last == 360.0:
        return phi, table
    if first == 0.0 and 360.0 - last <= 1.5 * np.diff(phi).max():
        return np.append(phi, 360.0), np.concatenate([table, table[:1]])
    raise UsdSkinError(
        f"{path}:{line}: horizontal angles from {first:g} to {last:g}; Type C has 0 to 0, 90, 180 "
        "or 360, or 90 to 270"
    )
