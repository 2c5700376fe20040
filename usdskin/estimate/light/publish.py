"""The last part of every way to a light: its maps, its report and its layer, all or nothing."""

from __future__ import annotations

import time
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path

from usdskin.estimate.light.layer import Background, write_light_layer
from usdskin.estimate.light.light_map import LightMap
from usdskin.estimate.light.maps import Form, MapFiles, write_maps
from usdskin.estimate.light.report import LightReport
from usdskin.estimate.light.summary import report_light
from usdskin.estimate.light.totals import Totals
from usdskin.layers import reload_open_copy
from usdskin.notes import Note
from usdskin.progress import Progress
from usdskin.replacing import replace_all, scratch_beside


@dataclass(frozen=True, slots=True, eq=False)
class LightResult:
    """What a step did."""

    paths: tuple[Path, ...]
    """Files written, the layer first."""

    report: LightReport
    """What was found."""

    notes: list[Note]
    """What needs attention."""

    seconds: dict[str, float]
    """Time each part took [s]."""


class Clock:
    """Adds up the time of named parts."""

    def __init__(self) -> None:
        """Start with none."""
        self.seconds: dict[str, float] = {}

    @contextmanager
    def __call__(self, part: str) -> Iterator[None]:
        """Count the time of the block as that of a part."""
        began = time.perf_counter()
        try:
            yield
        finally:
            self.seconds[part] = self.seconds.get(part, 0.0) + time.perf_counter() - began


def publish_light(
    light: LightMap,
    totals: Totals,
    background: Background,
    form: Form,
    files: MapFiles,
    output: Path,
    progress: Progress,
    clock: Clock,
) -> tuple[tuple[Path, ...], LightReport]:
    """Write a light's pictures and its layer; they appear together, when all are complete.

    Args:
        light: The light.
        totals: Its sums.
        background: Where it comes from.
        form: ``basis`` or ``bands``.
        files: Names of the pictures.
        output: The layer.
        progress: Told how far the work is.
        clock: Told the time each part took.

    Returns:
        The files, the layer first, and the report.

    Raises:
        LayerError: The layer cannot be written.
        ImageError: A picture cannot be read or written.
    """
    with scratch_beside(output) as scratch:
        with clock("write"):
            written = write_maps(light, files, scratch, progress)
            if background.weights is not None and files.classes is not None:
                from usdskin.estimate.classes import write_class_map

                write_class_map(scratch / files.classes.name, background.weights, light.classes)
        with clock("report"):
            report = report_light(
                light,
                totals,
                written,
                form,
                origin=background.origin,
                recoveries=background.recoveries,
                scale=background.scale,
                clipped_share=background.clipped_share,
                illuminant=background.illuminant,
            )
        write_light_layer(light, files, report.estimate(), background, output, scratch)
        paths = (output, *files.paths())
        replace_all(scratch, paths)
    reload_open_copy(output)
    return paths, report
