"""What all steps of a proof share: its place, its journal, and who is told."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any

from usdskin.errors import LayerError
from usdskin.judge.proof.light import TrueLight
from usdskin.judge.proof.options import ProofOptions
from usdskin.judge.proof.place import Place
from usdskin.judge.proof.record import Doing, Journal, StepRecord
from usdskin.judge.proof.shots import check_shot, subject_and_tone
from usdskin.judge.shoot.chart_patches import read_chart
from usdskin.judge.shoot.sensitivity import read_sensitivity
from usdskin.layers import open_stage
from usdskin.progress import Progress, SilentProgress

Tell = Callable[[StepRecord, bool], None]
Draw = Callable[[Sequence[Mapping[str, Any]], Path], Path]


class Steps:
    """What all steps of one proof share."""

    def __init__(
        self,
        folder: Path,
        output: Path,
        options: ProofOptions,
        progress: Progress | None,
        tell: Tell | None,
        draw: Draw | None,
    ) -> None:
        options.check()
        self.set_layer, self.shot = folder / "set.usda", folder / "shot.usda"
        wanted = [self.shot, *([] if options.light else [self.set_layer])]
        missing = [layer.name for layer in wanted if not layer.is_file()]
        if missing:
            what = f"has no {' and no '.join(missing)}" if folder.is_dir() else "no such folder"
            raise LayerError(
                f"{folder}: {what}; name a set (set.usda and shot.usda) or a shoot (shoot.usda and "
                "charts), see docs/proof.md"
            )
        check_shot(self.shot, subject_and_tone(options.subject, options.tone))
        # What is wrong with these would show after minutes.
        read_sensitivity(options.camera)
        read_chart(options.chart)
        if options.light is not None:
            open_stage(options.light)
        self.options = options
        self.progress = progress or SilentProgress()
        self._tell, self._draw = tell, draw
        self.place = Place(output)
        self.base = self.place.shot("base")
        self.journal = Journal(output, options.resume)
        self.title = folder.resolve().name
        self.truth: TrueLight = TrueLight(self.place.truth_light, {})

    def _step(
        self,
        name: str,
        title: str,
        command: str,
        reads: Sequence[Path],
        run: Callable[[Doing], None],
        settings: Mapping[str, Any] | None = None,
        clears: Sequence[Path] = (),
    ) -> StepRecord:
        record = self.journal.step(
            name, title, command, reads, run, settings=settings, clears=clears
        )
        self.progress.done()
        if self._tell is not None:
            self._tell(record, self.journal.kept(record))
        return record
