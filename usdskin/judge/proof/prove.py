"""The proof: a virtual shoot of a set whose truth is known, through every step, against the truth.

    prove(folder, output, options, progress, tell) -> Proof

Each step is the one that users run, reads layers and writes layers; only the first (the true light
and skin) and the last (the comparisons) know the truth.

Reads:  ``set.usda`` and ``shot.usda`` of a folder.
Writes: a folder; ``proof.json`` in it says what is where, and appears when all is done.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from usdskin.judge.proof.bars import bars_of
from usdskin.judge.proof.budget import judge_faults
from usdskin.judge.proof.chain import Chain
from usdskin.judge.proof.compare import compare_render
from usdskin.judge.proof.light import light_files
from usdskin.judge.proof.options import ProofOptions
from usdskin.judge.proof.real import is_real_shoot, prove_shoot
from usdskin.judge.proof.record import Doing, StepRecord
from usdskin.judge.proof.render import develop_like, render_shot, render_words, spectral_of
from usdskin.judge.proof.shots import ShotParts, write_shot
from usdskin.judge.proof.skin import SHOT_SKIN, tones_of
from usdskin.judge.proof.spectra import (
    light_spectra,
    patch_spectra,
    read_material,
    skin_numbers,
    skin_spectra,
)
from usdskin.judge.proof.steps import Draw, Tell
from usdskin.judge.proof.tones import judge_tone
from usdskin.progress import Progress
from usdskin.spectrum import DEFAULT_WAVELENGTHS_NM

NAMES = ("truth", "light", "chain")
"""The shots: true light and skin; estimated light, true skin; estimated light and skin."""


@dataclass(frozen=True, slots=True, eq=False)
class Proof:
    """What was proved."""

    path: Path
    """``proof.json``."""

    steps: Sequence[StepRecord]
    """The steps, in order."""

    content: Mapping[str, Any]
    """What ``proof.json`` holds beside steps and files."""

    @property
    def bars(self) -> list[dict[str, Any]]:
        """The bars and what was reached."""
        return list(self.content["bars"])


def prove(
    folder: str | Path,
    output: str | Path,
    options: ProofOptions | None = None,
    progress: Progress | None = None,
    tell: Tell | None = None,
    draw: Draw | None = None,
) -> Proof:
    """Prove what the chain does to a set.

    Args:
        folder: Holds ``set.usda`` and ``shot.usda``; or, without a truth, ``shoot.usda`` and
            charts, see ``prove_shoot``.
        output: Folder to fill.
        options: What is proved, and how.
        progress: Told how far each step is.
        tell: Told of every step that is done, and whether it was kept from before.
        draw: Draws the rows of an error budget to a file.

    Raises:
        UsdSkinError: A step failed, or the folder is no set.
    """
    if is_real_shoot(Path(folder)):
        given = options or ProofOptions()
        given.check()
        return Proof(*prove_shoot(Path(folder), Path(output), given, progress, tell))
    street = _Street(Path(folder), Path(output), options or ProofOptions(), progress, tell, draw)
    return street.run()


class _Street(Chain):
    """The whole proof: the chain, and what is judged of it."""

    def run(self) -> Proof:
        """Do all steps and write ``proof.json``."""
        try:
            self._true_light()
            self._base_shot()
            self._true_skin()
            if self.options.capture == "ideal":
                self._expose_exactly()
            else:
                self._photograph()
            self._calibrate()
            self._estimate_light()
            self._measure_skin()
            self._shots()
            pictures = self._render()
            comparisons = self._compare()
            tones = self._tones() if self.options.tones else []
            budget = self._budget() if self.options.budget else []
        finally:
            self.progress.done()
        content = self._content(pictures, comparisons, tones, budget)
        path = self.journal.finish(content)
        return Proof(path, tuple(self.journal.steps), content)

    # --- The judgement ------------------------------------------------------------------------

    def _shots(self) -> None:
        place = self.place
        thickness = read_material(place.truth_skin)[0].thickness
        parts = {
            "truth": (place.truth_light, place.truth_skin),
            "light": (place["light.usda"], place.truth_skin),
            "chain": (place["light.usda"], place["skin.usda"]),
        }

        def run(doing: Doing) -> None:
            for name, (light, skin) in parts.items():
                shot = ShotParts(light, skin, thickness)
                doing.writes.append(write_shot(self.base, shot, place.shot(name)))

        self._step(
            "shots",
            "write the three shots",
            "",
            [self.base, *dict.fromkeys(file for pair in parts.values() for file in pair)],
            run,
        )

    def _render(self) -> list[dict[str, Any]]:
        place, options = self.place, self.options
        pictures = []
        for integrator in options.integrators:
            for name in NAMES:
                shot, output = place.shot(name), place.render(name, integrator)
                model = place.render("truth", integrator)

                def run(
                    doing: Doing,
                    shot: Path = shot,
                    output: Path = output,
                    integrator: Any = integrator,
                    model: Path = model,
                ) -> None:
                    done = render_shot(shot, output, integrator, options, self.progress)
                    if output != model:
                        develop_like(output, model, options.observer)
                    doing.writes += done.writes
                    doing.notes += done.notes

                reads = [*light_files(shot)]
                reads += [] if output == model else [model.with_suffix(".png")]
                self._step(
                    f"render-{name}-{integrator}",
                    f"render the shot {name} by {integrator}",
                    place.command("render", shot, *render_words(output, integrator, options)),
                    reads,
                    run,
                )
                if name == "truth" and integrator == "traced":
                    self._render_again(shot, integrator)
                pictures.append(
                    {
                        "name": name,
                        "integrator": integrator,
                        "beauty": place.name_of(output),
                        "spectral": place.name_of(spectral_of(output)),
                        "png": place.name_of(output.with_suffix(".png")),
                    }
                )
        return pictures

    def _render_again(self, shot: Path, integrator: Any) -> None:
        """Render the truth with other samples, to tell noise from error."""
        place, options = self.place, self.options
        output, seed = place.render("again", integrator), options.seed + 1

        def run(doing: Doing) -> None:
            done = render_shot(shot, output, integrator, options, self.progress, seed)
            doing.writes += done.writes

        self._step(
            f"render-again-{integrator}",
            f"render the truth again by {integrator}, with other samples",
            place.command("render", shot, *render_words(output, integrator, options, seed)),
            light_files(shot),
            run,
        )

    def _noise(self, integrator: str) -> dict[str, Any] | None:
        """Return the colour difference between the truth and itself with other samples."""
        again = self.place.render("again", integrator)
        if integrator != "traced" or not again.exists():
            return None
        truth, maps = self.place.render("truth", integrator), self.place["differences/again.exr"]

        def run(doing: Doing) -> None:
            done = compare_render(truth, again, maps, self.options.observer, self.place)
            doing.writes += done.writes
            doing.facts["deltaE2000"] = done.facts["result"]["deltaE2000"]

        record = self._step(
            f"noise-{integrator}",
            f"measure the noise of renders by {integrator}",
            self.place.command("compare", truth, again, "--select", SHOT_SKIN, "-o", maps),
            [truth, again, spectral_of(truth), spectral_of(again)],
            run,
        )
        return dict(record.facts)

    def _compare(self) -> list[dict[str, Any]]:
        place, options = self.place, self.options
        found = []
        for integrator in options.integrators:
            truth = place.render("truth", integrator)
            noise = self._noise(integrator)
            for name in NAMES[1:]:
                picture = place.render(name, integrator)
                maps = place[f"differences/{name}_{integrator}.exr"]

                def run(
                    doing: Doing, truth: Path = truth, picture: Path = picture, maps: Path = maps
                ) -> None:
                    done = compare_render(truth, picture, maps, options.observer, place)
                    doing.writes += done.writes
                    doing.notes += done.notes
                    doing.facts.update(done.facts)

                record = self._step(
                    f"compare-{name}-{integrator}",
                    f"compare {name} by {integrator} with the truth",
                    place.command("compare", truth, picture, "--select", SHOT_SKIN, "-o", maps),
                    [truth, picture, spectral_of(truth), spectral_of(picture)],
                    run,
                )
                found.append(
                    {
                        "name": name,
                        "integrator": integrator,
                        "truth": place.name_of(truth),
                        "picture": place.name_of(picture),
                        "maps": place.name_of(maps),
                        "png": place.name_of(maps.with_suffix(".png")),
                        "result": record.facts["result"],
                        "noise": noise,
                    }
                )
        return found

    def _tones(self) -> list[dict[str, Any]]:
        place, options, rows = self.place, self.options, []
        for tone in tones_of(self.base):
            record = self._step(
                f"tone-{tone}",
                f"judge the skin {tone} under the same light",
                "",
                [self.shot, *light_files(place.truth_light), *light_files(place["light.usda"])],
                lambda doing, tone=tone: judge_tone(  # type: ignore[misc]
                    self.shot, tone, place, options, self.progress, doing
                ),
                {"options": options.as_json()},
                clears=[place[f"tones/{tone}"]],
            )
            rows.append(record.facts["row"])
        return rows

    def _budget(self) -> list[dict[str, Any]]:
        place, options, truth = self.place, self.options, self.truth

        def run(doing: Doing) -> None:
            judge_faults(truth, self.base, place, options, self.progress, doing)
            if self._draw is not None:
                doing.writes.append(self._draw(doing.facts["rows"], place["budget.svg"]))

        record = self._step(
            "budget",
            "judge every fault by itself",
            "",
            [
                self.base,
                place.truth_skin,
                *light_files(truth.light),
                *(file for layer in truth.classes.values() for file in light_files(layer)),
            ],
            run,
            {"options": options.as_json()},
            clears=[place["budget"]],
        )
        return list(record.facts["rows"])

    def _content(
        self,
        pictures: list[dict[str, Any]],
        comparisons: list[dict[str, Any]],
        tones: list[dict[str, Any]],
        budget: list[dict[str, Any]],
    ) -> dict[str, Any]:
        place, truth = self.place, self.truth
        items = light_spectra(truth.light, place["light.usda"])
        items += patch_spectra(place["camera.usda"])
        items += skin_spectra(place.truth_skin, place["skin.usda"])
        layers: dict[str, Any] = {
            "truthLight": place.name_of(truth.light),
            "truthClasses": {name: place.name_of(file) for name, file in truth.classes.items()},
            "charts": {name: place.name_of(place.chart(name)) for name in truth.classes},
            "capture": "capture.usda",
            "camera": "camera.usda",
            "light": "light.usda",
            "samples": "samples.usda",
            "skin": "skin.usda",
            "truthSkin": place.name_of(place.truth_skin),
        }
        if place.shoot().exists():
            layers["shoot"] = place.name_of(place.shoot())
        return {
            "set": place.name_of(self.shot.parent),
            "title": self.title,
            "settings": self.options.as_json(),
            "layers": layers,
            "missing": [],
            "pictures": pictures,
            "comparisons": comparisons,
            "spectra": {"wavelengths": DEFAULT_WAVELENGTHS_NM.tolist(), "items": items},
            "skin": skin_numbers(place.truth_skin, place["skin.usda"]),
            "tones": tones,
            "budget": budget,
            "bars": bars_of(comparisons, self.options, len(truth.classes) > 1),
        }
