"""The proof of a real shoot: no truth is known but the spectra of its charts.

    prove_shoot(folder, output, options, progress, tell) -> Proof

Reads:  ``shoot.usda`` and ``chart*.usda`` of a folder (charts may lie in folders of their own);
        ``samples.usda`` and ``shot.usda`` where they are there; where class captures are asked
        for, ``shoot_<class>.usda``, the place in the light of one class alone.
Writes: capture, camera, light, skin, pictures of the shot, and ``proof.json``.
"""

from __future__ import annotations

from collections.abc import Callable, Collection, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from usdskin.capture.step import CaptureOptions, capture_shoot
from usdskin.errors import UsageError
from usdskin.estimate.camera.step import CalibrationOptions, calibrate_camera
from usdskin.estimate.light.step import estimate_light
from usdskin.estimate.skin.step import SkinOptions, estimate_skin
from usdskin.judge.proof.light import estimate_options
from usdskin.judge.proof.options import Integrator, ProofOptions
from usdskin.judge.proof.patches import judge_patches
from usdskin.judge.proof.place import Place
from usdskin.judge.proof.record import Doing, Journal, StepRecord
from usdskin.judge.proof.render import render_shot, render_words, spectral_of
from usdskin.judge.proof.shots import ShotParts, subject_and_tone, write_base, write_shot
from usdskin.judge.proof.skin import even_skin, write_true_skin
from usdskin.judge.proof.spectra import patch_spectra
from usdskin.layers import open_stage, used_files
from usdskin.prims import read_color_charts, read_shoot
from usdskin.prims.samples import read_skin_samples
from usdskin.progress import Progress, SilentProgress
from usdskin.spectrum import DEFAULT_WAVELENGTHS_NM

Tell = Callable[[StepRecord, bool], None]

NAME = "chain"
"""The one picture of a real shoot: estimated light, and estimated skin where it was measured."""

NO_TRUTH = "the true light is not known: only the chart's patches are compared"
NO_SKIN = "no samples.usda: the skin is not estimated"
NO_SHOT = "no shot.usda: nothing is rendered"


def is_real_shoot(folder: Path) -> bool:
    """Return whether a folder holds a shoot and no set."""
    return (folder / "shoot.usda").is_file() and not (folder / "set.usda").is_file()


def find_charts(folder: Path) -> list[Path]:
    """Return the charts of a shoot: ``chart*.usda`` in its folder, or in folders of it."""
    found = [*folder.glob("chart*.usda"), *folder.glob("*/chart*.usda")]
    return sorted(path for path in found if path.parent.name != "truth")


def find_alone(folder: Path, classes: Collection[str]) -> dict[str, Path]:
    """Return the shoots of the place in the light of each class alone, by class.

    Args:
        folder: Holds them: ``shoot_<class>.usda``.
        classes: The classes that charts were photographed in.

    Raises:
        UsageError: There is one class, more than one has no shoot, or a shoot is of none of them.
    """
    if len(classes) < 2:
        raise UsageError(
            f"--class-captures: {folder} has charts of one class of light, {', '.join(classes)}; "
            "leave the option out, or add a chart in the light of the other lamps"
        )
    found = {path.stem.removeprefix("shoot_"): path for path in sorted(folder.glob("shoot_*.usda"))}
    for name in found:
        if name not in classes:
            raise UsageError(
                f"--class-captures: {found[name]}: no chart was photographed in the light of "
                f"{name}, only of {', '.join(classes)}; rename the layer, or add the chart"
            )
    missing = [f"shoot_{name}.usda" for name in classes if name not in found]
    if len(missing) > 1:
        raise UsageError(
            f"--class-captures: {folder} has no {' and no '.join(missing)}; photograph the place "
            "with each kind of lamps alone (one may go without), or leave the option out"
        )
    return found


def prove_shoot(
    folder: Path,
    output: Path,
    options: ProofOptions,
    progress: Progress | None = None,
    tell: Tell | None = None,
) -> tuple[Path, list[StepRecord], dict[str, Any]]:
    """Prove what can be proved of a real shoot.

    Args:
        folder: Holds ``shoot.usda`` and charts with measured spectra.
        output: Folder to fill.
        options: What the proof is told; what concerns virtual cameras counts for nothing.
        progress: Told how far each step is.
        tell: Told of every step.

    Returns:
        ``proof.json``, its steps, and what else it holds.

    Raises:
        UsdSkinError: A step failed, or the folder lacks charts or captures of classes.
    """
    charts = find_charts(folder)
    if not charts:
        raise UsageError(
            f"{folder}: has shoot.usda but no chart*.usda; photograph and measure a chart, see "
            "docs/estimation.md"
        )
    street = _RealStreet(folder, charts, output, options, progress or SilentProgress(), tell)
    return street.run()


class _RealStreet:
    """The steps of one real shoot."""

    def __init__(
        self,
        folder: Path,
        charts: Sequence[Path],
        output: Path,
        options: ProofOptions,
        progress: Progress,
        tell: Tell | None,
    ) -> None:
        self.folder, self.charts, self.options = folder, charts, options
        self.alone = find_alone(folder, self._classes()) if options.class_captures else {}
        self.place, self.journal = Place(output), Journal(output, options.resume)
        self.progress, self._tell = progress, tell
        self.missing = [NO_TRUTH]

    def run(self) -> tuple[Path, list[StepRecord], dict[str, Any]]:
        """Do all steps and write ``proof.json``."""
        place = self.place
        try:
            self._capture(self.folder / "shoot.usda", "")
            for name, shoot in self.alone.items():
                self._capture(shoot, name)
            self._calibrate()
            self._light()
            skin = self._skin()
            pictures = self._pictures(skin)
        finally:
            self.progress.done()
        layers: dict[str, Any] = {
            "shoot": place.name_of(self.folder / "shoot.usda"),
            "charts": {name: place.name_of(path) for name, path in self._classes().items()},
            "capture": "capture.usda",
            "camera": "camera.usda",
            "light": "light.usda",
        }
        if skin is not None:
            layers |= {"samples": place.name_of(self.folder / "samples.usda"), "skin": "skin.usda"}
        content = {
            "set": place.name_of(self.folder),
            "title": self.folder.resolve().name,
            "settings": {
                **self.options.as_json(),
                "capture": "real",
                "camera": read_shoot(open_stage(self.folder / "shoot.usda")).model,
            },
            "layers": layers,
            "missing": self.missing,
            "pictures": pictures,
            "comparisons": [],
            "patches": judge_patches(place["camera.usda"], place["light.usda"]),
            "spectra": {
                "wavelengths": DEFAULT_WAVELENGTHS_NM.tolist(),
                "items": patch_spectra(place["camera.usda"]),
            },
            "skin": [],
            "tones": [],
            "budget": [],
            "bars": [],
        }
        return self.journal.finish(content), list(self.journal.steps), content

    def _step(
        self,
        name: str,
        title: str,
        command: str,
        reads: Sequence[Path],
        run: Callable[[Doing], None],
        settings: Mapping[str, Any] | None = None,
    ) -> StepRecord:
        record = self.journal.step(name, title, command, reads, run, settings=settings)
        self.progress.done()
        if self._tell is not None:
            self._tell(record, self.journal.kept(record))
        return record

    def _classes(self) -> dict[str, Path]:
        found = {}
        for path in self.charts:
            for chart in read_color_charts(open_stage(path)):
                found[chart.light_class] = path
        return found

    def _capture(self, shoot: Path, light_class: str) -> None:
        """Capture the place in the whole light, or in that of a class alone."""
        output, stage = self.place.capture(light_class), open_stage(shoot)
        where = f" in the light of {light_class} alone" if light_class else ""
        images = [image for view in read_shoot(stage).views for image in view.bracket.images]
        given = CaptureOptions(
            refine_rotations=True, device=self.options.device, threads=self.options.threads
        )

        def run(doing: Doing) -> None:
            result = capture_shoot(shoot, output, given, self.progress)
            doing.writes += result.paths
            doing.notes += result.notes

        self._step(
            f"capture-{light_class}" if light_class else "capture",
            f"merge the photographs{where} to a panorama",
            self.place.command("capture", shoot, "-o", output, "--refine-rotations"),
            [*used_files(stage), *images],
            run,
        )

    def _calibrate(self) -> None:
        output, estimator = self.place["camera.usda"], self.options.estimator

        def run(doing: Doing) -> None:
            given = CalibrationOptions(
                estimator=estimator, device=self.options.device, threads=self.options.threads
            )
            result = calibrate_camera(self.charts, output, given, self.progress)
            doing.writes.append(result.path)
            doing.notes += result.notes

        reads = [file for chart in self.charts for file in self._chart_files(chart)]
        self._step(
            "camera",
            "calibrate the camera against the charts",
            self.place.command(
                "calibrate", "camera", *self.charts, "-o", output, "--estimator", estimator
            ),
            reads,
            run,
        )

    def _chart_files(self, layer: Path) -> list[Path]:
        stage = open_stage(layer)
        files = list(used_files(stage))
        for chart in read_color_charts(stage):
            files += [] if chart.view is None else chart.view.bracket.images
            named = (chart.signals_file, chart.illuminant_file, chart.reflectances_file)
            files += [file for file in (*named, chart.image_file) if file is not None]
        return files

    def _light(self) -> None:
        place = self.place
        capture, camera, output = place.capture(), place["camera.usda"], place["light.usda"]
        given, words, reads = estimate_options(place, self.alone)

        def run(doing: Doing) -> None:
            result = estimate_light(capture, camera, output, given, self.progress)
            doing.writes += result.paths
            doing.notes += result.notes

        self._step(
            "light",
            "estimate the light",
            place.command("estimate", "light", capture, "--camera", camera, "-o", output, *words),
            [*reads, camera],
            run,
        )

    def _skin(self) -> Path | None:
        samples, output = self.folder / "samples.usda", self.place["skin.usda"]
        if not samples.is_file():
            self.missing.append(NO_SKIN)
            return None
        specular = "fit" if self.options.lustre else "none"
        thickness = read_skin_samples(open_stage(samples)).thickness
        opacity = "none" if thickness is None or not np.ptp(thickness) else "fit"
        given = SkinOptions(
            specular=specular,  # type: ignore[arg-type]
            opacity=opacity,  # type: ignore[arg-type]
            device=self.options.device,
            threads=self.options.threads,
        )

        def run(doing: Doing) -> None:
            result = estimate_skin(samples, output, given, self.progress)
            doing.writes.append(result.path)
            doing.notes += result.notes

        self._step(
            "skin-fit",
            "estimate the skin",
            self.place.command(
                *("estimate", "skin", samples, "-o", output),
                *("--specular", specular, "--opacity", opacity),
            ),
            used_files(open_stage(samples)),
            run,
        )
        return output

    def _pictures(self, skin: Path | None) -> list[dict[str, Any]]:
        shot, place, options = self.folder / "shot.usda", self.place, self.options
        if not shot.is_file():
            self.missing.append(NO_SHOT)
            return []
        light, output = place["light.usda"], place.shot(NAME)

        def write(doing: Doing) -> None:
            variants = subject_and_tone(options.subject, options.tone)
            base = write_base(shot, light, variants, place.shot("base"))
            own = even_skin(base, options.lustre)
            used = skin or write_true_skin(own, base, place["shot_skin.usda"])
            doing.writes += [base, write_shot(base, ShotParts(light, used, own.thickness), output)]
            doing.writes += [] if skin else [used]

        self._step(
            "shots",
            "write the shot",
            "",
            [shot, light, *([skin] if skin else [])],
            write,
            {"subject": options.subject, "tone": options.tone, "lustre": options.lustre},
        )
        return [self._render(output, integrator) for integrator in options.integrators]

    def _render(self, shot: Path, integrator: Integrator) -> dict[str, Any]:
        place, options = self.place, self.options
        picture = place.render(NAME, integrator)

        def run(doing: Doing) -> None:
            done = render_shot(shot, picture, integrator, options, self.progress)
            doing.writes += done.writes
            doing.notes += done.notes

        self._step(
            f"render-{NAME}-{integrator}",
            f"render the shot by {integrator}",
            place.command("render", shot, *render_words(picture, integrator, options)),
            [*used_files(open_stage(shot)), place["light.coefficients.exr"]],
            run,
        )
        return {
            "name": NAME,
            "integrator": integrator,
            "beauty": place.name_of(picture),
            "spectral": place.name_of(spectral_of(picture)),
            "png": place.name_of(picture.with_suffix(".png")),
        }
