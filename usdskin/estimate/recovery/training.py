"""What a calibration learns from: one chart in one light, measured twice."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from usdskin.spectrum import check_grid

FloatArray = NDArray[np.float64]

REPEATABILITY = 0.01
"""Relative standard deviation of a camera value beyond its own: light that is uneven between
camera and spectrophotometer, ageing, spectrophotometer [1]. It sets from where on a patch's own
``camera_stddev`` counts, nothing else: only the ratios of patches matter."""

DARKNESS = 0.01
"""Camera value below which errors no longer shrink with it, of the brightest: glare and the
sensor's own noise are left there [1]."""

MAX_PATCHES = 2000
"""Largest chart that leaving out every patch in turn has memory for."""

MIN_INDEPENDENCE = 1e-6
"""Smallest third singular value of camera values, of the first, that tells three colours [1]."""


@dataclass(frozen=True, slots=True, eq=False)
class Training:
    """Camera values and colour signals of the patches of one chart in one light.

    Raises:
        ValueError: Shapes disagree, a number is not finite, a signal or the light is black, or a
            name is used twice.
    """

    patches: tuple[str, ...]
    """Names of the m patches."""

    camera_values: FloatArray
    """P, camera values rho, shape [m, 3]."""

    signals: FloatArray
    """Lambda, radiance of the patches [W m^-2 sr^-1 nm^-1, or relative], shape [m, n]."""

    wavelength_nm: FloatArray
    """Band centres [nm], strictly ascending, shape [n]."""

    illuminant: FloatArray
    """E, radiance of the perfect diffuser at the chart, in the unit of the signals, shape [n]."""

    camera_stddev: FloatArray | None = None
    """Standard error of each camera value, in the unit of rho, shape [m, 3]."""

    light_class: str = ""
    """Name of the class of light the chart stood in."""

    def __post_init__(self) -> None:
        """Copy the arrays to read-only float64 and check them together."""
        for name in ("camera_values", "signals", "wavelength_nm", "illuminant", "camera_stddev"):
            value = getattr(self, name)
            if value is not None:
                array = np.array(value, dtype=np.float64)
                array.setflags(write=False)
                object.__setattr__(self, name, array)
        object.__setattr__(self, "patches", tuple(self.patches))
        self._check_shapes()
        self._check_values()

    def _check_shapes(self) -> None:
        check_grid(self.wavelength_nm)
        m, n = len(self.patches), self.wavelength_nm.size
        if max(m, n) > MAX_PATCHES:
            raise ValueError(
                f"{m} patches in {n} bands are more than the {MAX_PATCHES} that can be used"
            )
        wanted = {
            "camera_values": (m, 3),
            "signals": (m, n),
            "illuminant": (n,),
            "camera_stddev": (m, 3),
        }
        for name, shape in wanted.items():
            value = getattr(self, name)
            if value is not None and value.shape != shape:
                raise ValueError(
                    f"{name} has shape {value.shape}, but {m} patches in {n} bands need {shape}"
                )
        if n < 3:
            raise ValueError(f"{n} bands cannot hold three colors; give three or more")
        if len(set(self.patches)) != m:
            twice = next(name for name in self.patches if self.patches.count(name) > 1)
            raise ValueError(f"two patches are named {twice!r}")

    def _check_values(self) -> None:
        for name in ("camera_values", "signals", "illuminant", "camera_stddev"):
            value = getattr(self, name)
            if value is not None and not np.isfinite(value).all():
                raise ValueError(f"{name} must be finite")
        if not (self.illuminant >= 0.0).all() or not self.illuminant.any():
            raise ValueError("the light must not be black, nor negative in any band")
        for name in ("camera_values", "signals"):
            dark = np.flatnonzero(getattr(self, name).sum(axis=1) <= 0.0)
            if dark.size:
                raise ValueError(f"patch {self.patches[dark[0]]!r} is black in its {name}")
        if self.camera_stddev is not None and not (self.camera_stddev >= 0.0).all():
            raise ValueError("a standard deviation must not be negative")

    def errors(self, white: FloatArray) -> FloatArray:
        """Return how wrong each camera value may be, in units of ``REPEATABILITY``.

        ``sqrt(P^2 + (DARKNESS white)^2 + (stddev / REPEATABILITY)^2)``: errors of one relative
        size, but for dark values and where a patch is known worse than that.

        Args:
            white: Camera values of something white, shape [..., 3].

        Returns:
            Standard deviations over ``REPEATABILITY``, in the unit of rho, shape [..., m, 3].
        """
        variance = self._ordinary_variance(white)
        if self.camera_stddev is not None:
            variance = variance + (self.camera_stddev / REPEATABILITY) ** 2
        return np.asarray(np.sqrt(variance))

    def poorness(self, white: FloatArray) -> FloatArray:
        """Return by how much a patch's squared error exceeds that of an ordinary patch.

        Args:
            white: Camera values of something white, shape [..., 3].

        Returns:
            Factors, 1 where no deviation is stated and else more, shape [..., m].
        """
        scale = white[..., None, :] ** 2
        ordinary = (self._ordinary_variance(white) / scale).sum(axis=-1)
        return np.asarray((self.errors(white) ** 2 / scale).sum(axis=-1) / ordinary)

    def _ordinary_variance(self, white: FloatArray) -> FloatArray:
        return np.asarray(self.camera_values**2 + (DARKNESS * white[..., None, :]) ** 2)


def channel_scale(camera_values: FloatArray) -> FloatArray:
    """Return the root mean square of every channel, shape [3].

    Raises:
        ValueError: A channel is zero throughout.
    """
    scale = np.asarray(np.sqrt((camera_values**2).mean(axis=0)))
    if not (scale > 0.0).all():
        raise ValueError(f"the camera's channel {'RGB'[int(scale.argmin())]} is zero throughout")
    return scale


def check_independent(camera_values: FloatArray) -> float:
    """Refuse camera values that do not tell three colours apart.

    Args:
        camera_values: P, shape [m, 3].

    Returns:
        The condition number of P, its channels made equally large: by how much the relative
        error of the camera's worst known mixture of channels exceeds that of its best.

    Raises:
        ValueError: There are fewer than three patches, or they lie in a plane or on a line.
    """
    count = camera_values.shape[0]
    if count < 3:
        raise ValueError(f"{count} patches cannot train three channels; three at least are needed")
    values = np.linalg.svd(camera_values / channel_scale(camera_values), compute_uv=False)
    if values[2] <= MIN_INDEPENDENCE * values[0]:
        raise ValueError(
            f"the camera values of all {count} patches are mixtures of fewer than three colors; "
            "use a chart with more colors"
        )
    return float(values[0] / values[2])
