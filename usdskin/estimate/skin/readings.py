"""Readings of skin: from where it was lit and seen, and how much light came back."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import ArrayLike, NDArray

from usdskin.errors import LayerError

FloatArray = NDArray[np.float64]
Mask = NDArray[np.bool_]

LARGEST_RADIANS = 3.2
"""Angles that all stay below this are radians: in degrees they would tell nothing."""

LARGEST_THICKNESS_M = 0.05
"""No light that could be read crosses more skin [m]; millimetres taken for metres are above it."""

_UNIT_TOLERANCE = 1e-3


@dataclass(frozen=True, slots=True, eq=False)
class Readings:
    """What came back from skin, q readings in c channels or bands.

    Raises:
        ValueError: Shapes do not belong together.
        LayerError: A number is not finite, or a direction is no unit vector.
    """

    light: FloatArray
    """Unit vectors from the skin towards the light [1], shape [q, 3]."""

    normal: FloatArray
    """Unit normals of the skin [1], shape [q, 3] or [3]."""

    values: FloatArray
    """Radiance over that of a perfect diffuser which faces the light [1], shape [q, c]."""

    view: FloatArray | None = None
    """Unit vectors from the skin towards the camera [1], shape [q, 3]; None: not known."""

    stddev: FloatArray | None = None
    """Standard deviation of the values [1], shape [q, c]; None: not known."""

    thickness: FloatArray | None = None
    """Way of the light through the body [m], shape [q]; None: it goes through none."""

    mask: Mask | None = None
    """Which readings to use, shape [q]; None: all."""

    where: str = "readings"
    """``layer.usda </Prim/path>``, for errors and notes."""

    names: tuple[str, ...] = ()
    """Names of the channels, or wavelengths, shape [c]; empty: numbered."""

    def __post_init__(self) -> None:
        """Copy everything to float64, and check it together."""
        values = np.array(self.values, dtype=np.float64)
        values = values[:, None] if values.ndim == 1 else values
        if values.ndim != 2 or not values.size:
            raise ValueError(f"readings have shape {values.shape}, not [q, c]")
        count, channels = values.shape
        object.__setattr__(self, "values", values)
        shapes: dict[str, tuple[int, ...]] = {
            "light": (count, 3),
            "normal": (count, 3),
            "view": (count, 3),
            "stddev": (count, channels),
            "thickness": (count,),
        }
        for name, shape in shapes.items():
            given = getattr(self, name)
            if given is None:
                continue
            array = np.array(given, dtype=np.float64)
            if array.shape == (3,) and shape == (count, 3):
                array = np.tile(array, (count, 1))
            if array.shape != shape:
                raise ValueError(f"{name} has shape {array.shape}, but the readings need {shape}")
            object.__setattr__(self, name, array)
        mask = np.ones(count, bool) if self.mask is None else np.array(self.mask, dtype=bool)
        if mask.shape != (count,):
            raise ValueError(f"mask has shape {mask.shape}, but there are {count} readings")
        object.__setattr__(self, "mask", mask)
        names = self.names or tuple(str(index) for index in range(channels))
        if len(names) != channels:
            raise ValueError(f"{len(names)} names for {channels} channels")
        object.__setattr__(self, "names", names)
        self._check_numbers(mask)

    def _check_numbers(self, mask: Mask) -> None:
        for name in ("values", "light", "normal", "view", "stddev", "thickness"):
            array = getattr(self, name)
            if array is None:
                continue
            broken = ~np.isfinite(array.reshape(len(array), -1)).all(axis=1) & mask
            if broken.any():
                raise LayerError(
                    f"{self.where}: reading [{int(np.flatnonzero(broken)[0])}]: its {name} is not "
                    "a finite number; correct it, or leave the reading out by the mask"
                )
        for name in ("light", "normal", "view"):
            array = getattr(self, name)
            if array is None:
                continue
            with np.errstate(invalid="ignore"):
                length = np.linalg.norm(array, axis=1)
                broken = (np.abs(length - 1.0) > _UNIT_TOLERANCE) & mask
            if broken.any():
                first = int(np.flatnonzero(broken)[0])
                raise LayerError(
                    f"{self.where}: reading [{first}]: its {name} direction has length "
                    f"{length[first]:.4g}; give unit vectors"
                )
            safe = np.where(length > 0.5, length, 1.0)
            object.__setattr__(self, name, array / safe[:, None])
        stddev = self.stddev
        if stddev is not None and (stddev[mask] <= 0.0).any():
            first = int(np.flatnonzero((stddev <= 0.0).any(axis=1) & mask)[0])
            raise LayerError(
                f"{self.where}: reading [{first}]: its standard deviation is not above zero; "
                "leave them all out where they are not known"
            )
        thickness = self.thickness
        if thickness is not None and (thickness[mask] < 0.0).any():
            first = int(np.flatnonzero((thickness < 0.0) & mask)[0])
            raise LayerError(
                f"{self.where}: reading [{first}]: its thickness {thickness[first]:g} m is below "
                "zero; a way through the body is 0 or longer"
            )
        if thickness is not None and (thickness[mask] > LARGEST_THICKNESS_M).any():
            first = int(np.flatnonzero((thickness > LARGEST_THICKNESS_M) & mask)[0])
            raise LayerError(
                f"{self.where}: reading [{first}]: its thickness is {thickness[first]:g} m, which "
                f"no light crosses; give metres ({thickness[first] / 1000.0:g} if these are mm)"
            )

    @property
    def cosine(self) -> FloatArray:
        """N.L [1], shape [q]."""
        return np.asarray(np.clip((self.light * self.normal).sum(axis=1), -1.0, 1.0))

    @property
    def theta_deg(self) -> FloatArray:
        """Angle between normal and light [deg], shape [q]."""
        return np.asarray(np.degrees(np.arccos(self.cosine)))

    @property
    def view_cosine(self) -> FloatArray:
        """N.V [1], 1 where the view is not known, shape [q]."""
        if self.view is None:
            return np.ones(len(self.values))
        return np.asarray(np.clip((self.view * self.normal).sum(axis=1), -1.0, 1.0))

    @property
    def mirror_deg(self) -> FloatArray:
        """Angle between the view and the mirrored light [deg], 180 if not known, shape [q]."""
        if self.view is None:
            return np.full(len(self.values), 180.0)
        mirrored = 2.0 * self.cosine[:, None] * self.normal - self.light
        return np.asarray(np.degrees(np.arccos(np.clip((mirrored * self.view).sum(1), -1.0, 1.0))))

    def part(self, keep: Mask | NDArray[np.intp]) -> Readings:
        """Return some of the readings, by mask or by index."""

        def of(array: FloatArray | None) -> FloatArray | None:
            return None if array is None else array[keep]

        assert self.mask is not None
        return replace(
            self,
            light=self.light[keep],
            normal=self.normal[keep],
            values=self.values[keep],
            view=of(self.view),
            stddev=of(self.stddev),
            thickness=of(self.thickness),
            mask=self.mask[keep],
        )


def readings_from_angles(
    theta_i_deg: ArrayLike,
    theta_r_deg: ArrayLike | None,
    azimuth_deg: ArrayLike | None,
    values: ArrayLike,
    *,
    stddev: ArrayLike | None = None,
    thickness: ArrayLike | None = None,
    mask: ArrayLike | None = None,
    where: str = "readings",
    names: Sequence[str] = (),
) -> Readings:
    """Return readings of a goniometer.

    Args:
        theta_i_deg: Angles between normal and light [deg], shape [q]; beyond 90 the light comes
            from behind. A negative one is on the other side of the normal.
        theta_r_deg: Angles between normal and camera [deg], signed likewise, shape [q] or [];
            None: not known.
        azimuth_deg: Angles between the planes of incidence and view [deg], shape [q] or []; 0 (and
            None) where positive angles lie on one side, 180 where they face each other.
        values: Radiance over that of a perfect diffuser which faces the light [1], shape [q, c].
        stddev: Standard deviation of the values [1], shape [q, c].
        thickness: Way of the light through the body [m], shape [q].
        mask: Which readings to use, shape [q].
        where: ``layer.usda </Prim/path>``, for errors and notes.
        names: Names of the channels, or wavelengths.

    Raises:
        LayerError: The angles are radians or beyond their range, or a value is not finite.
        ValueError: Shapes do not belong together.
    """
    incident = np.atleast_1d(np.asarray(theta_i_deg, dtype=np.float64))
    _check_angles(where, "theta_i", incident, 180.0)
    largest = float(np.abs(incident).max())
    if 0.0 < largest <= LARGEST_RADIANS:
        raise LayerError(
            f"{where}: theta_i reaches {largest:.4g} only, so the angles seem to be radians; "
            "give degrees"
        )
    view = None
    if theta_r_deg is not None:
        seen = np.broadcast_to(np.asarray(theta_r_deg, dtype=np.float64), incident.shape)
        _check_angles(where, "theta_r", seen, 90.0)
        turned = np.asarray(0.0 if azimuth_deg is None else azimuth_deg, dtype=np.float64)
        turned = np.broadcast_to(turned, incident.shape)
        _check_angles(where, "azimuth", turned, 360.0)
        view = _directions(seen, turned)

    return Readings(
        light=_directions(incident, np.zeros_like(incident)),
        normal=np.array([0.0, 0.0, 1.0]),
        values=np.asarray(values, dtype=np.float64),
        view=view,
        stddev=_array(stddev),
        thickness=_array(thickness),
        mask=None if mask is None else np.asarray(mask, dtype=bool),
        where=where,
        names=tuple(names),
    )


def _array(given: ArrayLike | None) -> FloatArray | None:
    return None if given is None else np.asarray(given, dtype=np.float64)


def _directions(polar_deg: FloatArray, azimuth_deg: FloatArray) -> FloatArray:
    """Return unit vectors at some angles to +Z, shape [q, 3]."""
    polar, around = np.radians(polar_deg), np.radians(azimuth_deg)
    across = np.sin(polar)
    return np.stack([across * np.cos(around), across * np.sin(around), np.cos(polar)], axis=-1)


def _check_angles(where: str, name: str, angles: FloatArray, largest: float) -> None:
    with np.errstate(invalid="ignore"):
        broken = ~(np.abs(angles) <= largest + 1e-9)
    if broken.any():
        first = int(np.flatnonzero(broken)[0])
        hint = ""
        if name == "theta_r" and np.isfinite(angles[first]):
            hint = " (are light and view exchanged, or was the camera behind the skin?)"
        raise LayerError(
            f"{where}: reading [{first}]: {name} is {angles[first]:g} degrees, beyond "
            f"{largest:g}{hint}; correct it"
        )
