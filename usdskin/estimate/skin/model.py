"""Equation (1) for one light, as a function of what is to be found, with its derivatives.

``I_c = exp(-s delta_c) p [A_c max(N.L, 0) + B_c max((N.L + l)/(1 + l), 0)] + lobes``, readings
over E_c/pi; p is what the lobes leave (1 without them). Only A_c = alpha S_c, B_c = alpha S_c Ss_c
and l can be told from readings.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from usdskin.estimate.skin.lobe import Lobe, LobeGeometry
from usdskin.estimate.skin.readings import Readings

FloatArray = NDArray[np.float64]

LEAST_ROUGHNESS = 0.05
_LOBE_FIELDS = ("weight", "roughness1", "roughness2", "mix")
_LARGEST_DELTA = 1e5
_STEP = 1e-5


def lambert_kernel(cosine: FloatArray) -> FloatArray:
    """Return max(N.L, 0)."""
    return np.asarray(np.maximum(cosine, 0.0))


def wrap_kernel(cosine: FloatArray, wrap: FloatArray | float) -> FloatArray:
    """Return max((N.L + l)/(1 + l), 0)."""
    return np.asarray(np.maximum((cosine + wrap) / (1.0 + wrap), 0.0))


@dataclass(frozen=True, slots=True, eq=False)
class Coefficients:
    """All numbers of the model, free and fixed."""

    wrap: float
    """l [1]."""

    lambert: FloatArray
    """A [1], shape [c]."""

    wrapped: FloatArray
    """B [1], shape [c]."""

    lobe: Lobe | None = None
    """The lustre; None: none."""

    delta: FloatArray | None = None
    """delta [m^-1], shape [c]; None: 0."""


@dataclass(frozen=True, slots=True, eq=False)
class Freedom:
    """Which numbers are free."""

    wrap: bool = True
    """Whether l is."""

    scattering: FloatArray | None = None
    """Ss that is known [1], shape [c], so that B = Ss A; None: B is free."""

    delta: bool = False
    """Whether delta is."""

    lobes: int = 0
    """How many GGX lobes are free: 0, 1 or 2."""


class SkinModel:
    """The model at the geometry of some readings."""

    def __init__(self, readings: Readings, freedom: Freedom) -> None:
        self.cosine = readings.cosine
        self.freedom = freedom
        self.channels = readings.values.shape[1]
        self.names = readings.names
        self.thickness = readings.thickness
        self._direct = lambert_kernel(self.cosine)
        # Lobes need a view; without one there is no model with lobes to ask for.
        self._gloss = LobeGeometry(readings) if readings.view is not None else None

    # --- Numbers as one vector: shared ones first, then those of each channel -----------------

    @property
    def shared_names(self) -> list[str]:
        """Names of what all channels share, in order."""
        fields = {0: (), 1: _LOBE_FIELDS[:2], 2: _LOBE_FIELDS}[self.freedom.lobes]
        return ["wrap"] * self.freedom.wrap + [f"specular:{field}" for field in fields]

    @property
    def channel_names(self) -> list[str]:
        """Names of what each channel has of its own, in order."""
        names = ["A"] if self.freedom.scattering is not None else ["A", "B"]
        return names + ["delta"] * self.freedom.delta

    @property
    def parameter_names(self) -> list[str]:
        """Names of all free numbers, in the order of the vector."""
        each = [f"{kind}[{name}]" for kind in self.channel_names for name in self.names]
        return self.shared_names + each

    def pack(self, coefficients: Coefficients) -> FloatArray:
        """Return the free numbers as a vector, shape [p]."""
        shared: list[float] = []
        for name in self.shared_names:
            holder = coefficients if name == "wrap" else coefficients.lobe
            shared.append(getattr(holder, name.removeprefix("specular:")))
        kinds = {
            "A": coefficients.lambert,
            "B": coefficients.wrapped,
            "delta": coefficients.delta,
        }
        own = [np.asarray(kinds[kind], dtype=np.float64) for kind in self.channel_names]
        return np.concatenate([np.array(shared, dtype=np.float64), *own])

    def unpack(self, vector: FloatArray, fixed: Coefficients) -> Coefficients:
        """Return all numbers: the free ones of a vector, the others as fixed."""
        shared = dict(zip(self.shared_names, vector.tolist(), strict=False))
        own = vector[len(shared) :].reshape(-1, self.channels)
        kinds = dict(zip(self.channel_names, own, strict=True))
        wrap = shared.pop("wrap", fixed.wrap)
        lobe = fixed.lobe
        if shared and lobe is not None:
            fields = {name.removeprefix("specular:"): value for name, value in shared.items()}
            lobe = replace(lobe, **fields)
        lambert = kinds["A"]
        scattering = self.freedom.scattering
        wrapped = kinds["B"] if scattering is None else lambert * scattering
        return Coefficients(wrap, lambert, wrapped, lobe, kinds.get("delta", fixed.delta))

    def bounds(self) -> tuple[FloatArray, FloatArray]:
        """Return the least and the largest value of every free number, shapes [p]."""
        limits = {
            "wrap": (0.0, 1.0),
            "specular:weight": (0.0, 1.0),
            "specular:roughness1": (LEAST_ROUGHNESS, 1.0),
            "specular:roughness2": (LEAST_ROUGHNESS, 1.0),
            "specular:mix": (0.0, 1.0),
            "A": (0.0, np.inf),
            "B": (0.0, np.inf),
            "delta": (0.0, _LARGEST_DELTA),
        }
        rows = [limits[name] for name in self.shared_names]
        rows += [limits[name] for name in self.channel_names for _ in range(self.channels)]
        low, high = np.array(rows).T
        return low, high

    def index(self) -> NDArray[np.intp]:
        """Return where a channel's columns of the Jacobian belong in the vector, [c, m + k]."""
        shared, own = len(self.shared_names), len(self.channel_names)
        result = np.empty((self.channels, shared + own), np.intp)
        result[:, :shared] = np.arange(shared)
        for channel in range(self.channels):
            result[channel, shared:] = shared + channel + self.channels * np.arange(own)
        return result

    # --- Values -----------------------------------------------------------------------------

    def values(self, at: Coefficients) -> FloatArray:
        """Return the readings that the model predicts, shape [q, c]."""
        return np.asarray(self.passed(at) * self._below(at) + self.shine(at)[:, None])

    def _below(self, at: Coefficients) -> FloatArray:
        """Return the braces of equation (1), which the lobes and the body attenuate, [q, c]."""
        light = self._direct[:, None] * at.lambert
        return np.asarray(light + wrap_kernel(self.cosine, at.wrap)[:, None] * at.wrapped)

    def shine(self, at: Coefficients) -> FloatArray:
        """Return what the lobes add, shape [q]."""
        if at.lobe is None or self._gloss is None:
            return np.zeros(len(self.cosine))
        return self._gloss.reflected(at.lobe)

    def passed(self, at: Coefficients) -> FloatArray:
        """Return what lobes and body leave of the diffuse part [1], shape [q, 1] or [q, c]."""
        left = np.ones((len(self.cosine), 1))
        if at.lobe is not None and self._gloss is not None:
            left = self._gloss.passed(at.lobe)[:, None]
        return left * self._through(at)

    def _through(self, at: Coefficients) -> FloatArray:
        if at.delta is None or self.thickness is None:
            return np.ones((1, 1))
        return np.asarray(np.exp(-self.thickness[:, None] * at.delta))

    def jacobian(self, at: Coefficients, wrap_step: float = 0.0) -> FloatArray:
        """Return the derivative of every value by its own m + k numbers, shape [q, c, m + k].

        Args:
            at: Where.
            wrap_step: Half the width over which the derivative by l is averaged [1]: a reading
                near acos(-l) tells much about l on one side of it, and nothing on the other.
        """
        through = self.passed(at)
        below = self._below(at)
        shape = below.shape
        wrapped = wrap_kernel(self.cosine, at.wrap)
        columns: list[FloatArray] = []
        if self.freedom.wrap:
            rises = self._wrap_slope(at.wrap, wrap_step)
            columns.append(np.broadcast_to(rises[:, None] * at.wrapped * through, shape))
        if self.freedom.lobes:
            columns += self._lobe_columns(at, below * self._through(at))
        if self.freedom.scattering is None:
            columns.append(np.broadcast_to(self._direct[:, None] * through, shape))
            columns.append(np.broadcast_to(wrapped[:, None] * through, shape))
        else:
            both = self._direct[:, None] + wrapped[:, None] * self.freedom.scattering
            columns.append(np.broadcast_to(both * through, shape))
        if self.freedom.delta:
            assert self.thickness is not None
            columns.append(-self.thickness[:, None] * below * through)
        return np.stack(columns, axis=-1)

    def _wrap_slope(self, wrap: float, step: float) -> FloatArray:
        """Return the derivative of the wrap kernel by l, or its average around l, shape [q]."""
        low, high = max(wrap - step, 0.0), min(wrap + step, 1.0)
        if high - low < 1e-9:
            lit = self.cosine + wrap > 0.0
            return np.where(lit, (1.0 - self.cosine) / (1.0 + wrap) ** 2, 0.0)
        rise = wrap_kernel(self.cosine, high) - wrap_kernel(self.cosine, low)
        return np.asarray(rise / (high - low))

    def _lobe_columns(self, at: Coefficients, diffuse: FloatArray) -> list[FloatArray]:
        """Return the derivatives by the lobes' numbers, by differences (one-sided at a bound)."""
        assert at.lobe is not None and self._gloss is not None
        columns = []
        for name in self.shared_names:
            if name == "wrap":
                continue
            field = name.removeprefix("specular:")
            value = getattr(at.lobe, field)
            low = max(value - _STEP, 0.0 if field in ("weight", "mix") else LEAST_ROUGHNESS)
            high = min(value + _STEP, 1.0)
            below, above = replace(at.lobe, **{field: low}), replace(at.lobe, **{field: high})
            dims = (self._gloss.passed(above) - self._gloss.passed(below)) / (high - low)
            adds = (self._gloss.reflected(above) - self._gloss.reflected(below)) / (high - low)
            columns.append(np.asarray(dims[:, None] * diffuse + adds[:, None]))
        return columns
