"""Motion blur: a picture as the mean of pictures at moments while the shutter is open.

Reads:  the camera's shutter, and whether anything changes while it is open.
Makes:  ``Exposure``, the moments and the share of the samples that each of them takes.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass, fields
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from usdskin.errors import LayerError
from usdskin.layers import describe
from usdskin.notes import Note
from usdskin.progress import Progress
from usdskin.render.cameras import Camera, read_camera
from usdskin.render.integrate import Picture, Share
from usdskin.render.job import Frame, RenderSettings
from usdskin.render.meshes import MeshArrays
from usdskin.render.products import Product

# isort: split
# After ours, which register the schemas.
from pxr import Gf, Usd, UsdGeom, UsdRender

MAP_MOMENTS = 8
TRACED_MOMENTS = 16
"""Most moments of a picture where nobody says how many."""

_SAMPLES_PER_MOMENT = 8
"""Of a traced picture where nobody says how many."""

_CARRIERS = ("Camera", "Xform", "Scope", "")
"""Types of prims that show nothing themselves."""


@dataclass(frozen=True, slots=True, eq=False)
class Exposure:
    """The time a shutter is open in which something moves."""

    opens: float
    closes: float
    """Time codes of the stage."""

    cameras: tuple[Camera, ...]
    """The camera at every moment."""

    scene_moves: bool
    """Whether anything but the camera moves."""

    @property
    def middle(self) -> Usd.TimeCode:
        """When data parts are taken."""
        return Usd.TimeCode(0.5 * (self.opens + self.closes))

    @property
    def moments(self) -> tuple[Usd.TimeCode, ...]:
        """The middles of equal parts of the time the shutter is open."""
        return _moments(self.opens, self.closes, len(self.cameras))

    def shares(self) -> Iterator[tuple[Share, Usd.TimeCode, Camera]]:
        """Yield the samples, time and camera of every moment.

        Neighbouring shares of a pixel's lattice lie side by side in the pixel, so they are dealt
        to times in another order: a moving edge would lean otherwise.
        """
        count = len(self.cameras)
        step = max(1, round(0.618034 * count))
        while np.gcd(step, count) != 1:
            step += 1
        for index in range(count):
            at = index * step % count
            yield Share(index, count), self.moments[at], self.cameras[at]


def find_exposure(
    stage: Usd.Stage,
    product: Product,
    frame: Frame,
    settings: RenderSettings,
    notes: list[Note],
) -> Exposure | None:
    """Return when to expose a picture, or None where nothing moves while the shutter is open.

    Args:
        stage: The stage.
        product: Its camera, whose ``shutter:open`` and ``shutter:close`` count from the frame.
        frame: Which frame.
        settings: Samples and moments.
        notes: Takes a shutter that has no frame to count from.

    Raises:
        LayerError: The shutter closes before it opens, or a camera cannot be used.
    """
    if not product.motion_blur:
        return None
    prim = stage.GetPrimAtPath(product.camera)
    opens, closes = _shutter(UsdGeom.Camera(prim), frame.time)
    if opens == closes:
        return None
    if frame.number is None:
        what = "the stage has no startTimeCode for the shutter to count from; give frames with -f."
        notes.append(Note("motion-blur-ignored", product.camera, what))
        return None
    opens, closes = frame.number + opens, frame.number + closes
    cameras = tuple(
        read_camera(
            stage,
            product.camera,
            time,
            product.resolution,
            product.pixel_aspect_ratio,
            product.conform_policy,
            notes,
            product.depth_of_field,
        )
        for time in _moments(opens, closes, _moment_count(settings))
    )
    scene_moves = _scene_moves(stage, opens, closes)
    if not scene_moves and all(_alike(camera, cameras[0]) for camera in cameras):
        return None
    return Exposure(opens, closes, cameras, scene_moves)


def _shutter(camera: UsdGeom.Camera, time: Usd.TimeCode) -> tuple[float, float]:
    opens = float(camera.GetShutterOpenAttr().Get(time))
    closes = float(camera.GetShutterCloseAttr().Get(time))
    if not (np.isfinite(opens) and np.isfinite(closes) and opens <= closes):
        raise LayerError(
            f"{describe(camera.GetPrim())}: shutter:open is {opens:g}, shutter:close {closes:g}, "
            "so no light gets in; let it close at the same time or later."
        )
    return opens, closes


def _moment_count(settings: RenderSettings) -> int:
    samples = settings.samples_per_pixel
    if settings.motion_samples:
        return min(settings.motion_samples, samples)
    if settings.integrator == "traced":
        return min(max(samples // _SAMPLES_PER_MOMENT, 2), TRACED_MOMENTS, samples)
    return min(samples, MAP_MOMENTS)


def _moments(opens: float, closes: float, count: int) -> tuple[Usd.TimeCode, ...]:
    steps = (np.arange(count) + 0.5) / count
    return tuple(Usd.TimeCode(float(opens + (closes - opens) * step)) for step in steps)


def _alike(one: Camera, other: Camera) -> bool:
    return all(
        np.array_equal(getattr(one, entry.name), getattr(other, entry.name))
        for entry in fields(Camera)
    )


def _scene_moves(stage: Usd.Stage, opens: float, closes: float) -> bool:
    """Return whether anything that is not a camera's changes in an interval of time."""
    roots = [stage.GetPseudoRoot(), *stage.GetPrototypes()]
    for root in roots:
        for prim in Usd.PrimRange.AllPrims(root):
            # Most prims hold still, so what costs more is asked of those that do not.
            if _changes(prim, opens, closes) and not _shows_nothing(prim):
                return True
    return False


def _changes(prim: Usd.Prim, opens: float, closes: float) -> bool:
    if prim.IsA(UsdGeom.PointInstancer) and _is_propelled(UsdGeom.PointInstancer(prim), opens):
        return True
    return any(
        _varies(attribute, opens, closes)
        for attribute in prim.GetAuthoredAttributes()
        if attribute.ValueMightBeTimeVarying()
    )


def _is_propelled(instancer: UsdGeom.PointInstancer, time: float) -> bool:
    """Return whether velocities move the instances, which takes no more than one sample."""
    speeds = (instancer.GetVelocitiesAttr(), instancer.GetAngularVelocitiesAttr())
    return any(np.any(np.array(speed.Get(time) or [0.0])) for speed in speeds)


def _varies(attribute: Usd.Attribute, opens: float, closes: float) -> bool:
    between = attribute.GetTimeSamplesInInterval(Gf.Interval(opens, closes))
    first = attribute.Get(opens)
    return any(attribute.Get(time) != first for time in [closes, *between])


def _shows_nothing(prim: Usd.Prim) -> bool:
    """Return whether a prim, with all below it, is of no account to the scene."""
    if prim.IsA(UsdRender.SettingsBase):
        return True
    below = Usd.PrimRange(prim, Usd.TraverseInstanceProxies(Usd.PrimAllPrimsPredicate))
    return all(item.GetTypeName() in _CARRIERS for item in below)


def topology_notes(middle: Iterable[MeshArrays], moment: Iterable[MeshArrays]) -> list[Note]:
    """Return notes on meshes that are put together differently at two moments."""
    before = {mesh.path: mesh.triangles for mesh in middle}
    return [
        Note(
            "topology-changes",
            mesh.path,
            "its faces change while the shutter is open; each moment shows those of its sample.",
        )
        for mesh in moment
        if mesh.path in before and not np.array_equal(before[mesh.path], mesh.triangles)
    ]


def unkept_note(partial: Path) -> Note:
    """Return the note that a picture's finished part is not kept."""
    what = "a picture with motion blur is neither resumed nor shown before it is finished."
    return Note("partial-not-kept", str(partial), what)


def mean_picture(pictures: Iterable[Picture], count: int) -> Picture:
    """Return the mean of pictures of equal size: of their light, parts and visibility.

    The variance is that of the mean, and samples are counted together.
    """
    sums: dict[str, NDArray[np.float64]] = {}
    with_spectrum = with_extra = False
    for picture in pictures:
        values: Mapping[str, NDArray[np.float32]] = dict(picture.extra)
        values = {**values, "xyza": picture.xyza}
        if picture.spectrum is not None:
            values["spectrum"], with_spectrum = picture.spectrum, True
        if picture.unshadowed is not None:
            values["unshadowed"], with_extra = picture.unshadowed, True
            values["visibility"] = picture.extra["visibility"] * picture.unshadowed
        for name, value in values.items():
            sums[name] = sums.get(name, 0.0) + value.astype(np.float64)
    if with_extra:
        whole = sums["unshadowed"]
        sums["visibility"] = count * sums["visibility"] / np.where(whole > 0.0, whole, 1.0)
        sums["variance"] = sums["variance"] / count
        sums["sampleCount"] = sums["sampleCount"] * count
    mean = {name: np.asarray(value / count, np.float32) for name, value in sums.items()}
    xyza, spectrum = mean.pop("xyza"), mean.pop("spectrum") if with_spectrum else None
    return Picture(xyza, spectrum, mean, mean.pop("unshadowed", None))


class SharedProgress:
    """Shows the work of all moments as one piece."""

    def __init__(self, progress: Progress, count: int) -> None:
        """Set up the progress of ``count`` moments."""
        self._progress, self._count, self._finished = progress, count, 0

    def start(self, total: int, label: str) -> None:
        """Begin a moment; the first of them begins the work."""
        if not self._finished:
            self._progress.start(self._count * total, label)

    def advance(self, count: int = 1) -> None:
        """Count units as done."""
        self._progress.advance(count)

    def done(self) -> None:
        """End a moment; the last of them ends the work."""
        self._finished += 1
        if self._finished == self._count:
            self._progress.done()
