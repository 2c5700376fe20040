"""A proof by tone of skin: the same light on every skin of the shot's library.

Each tone is rendered by map, which has no noise, under the true and the estimated light, and with
a fit to its own goniometric readings.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any

from usdskin.estimate.skin.step import estimate_skin
from usdskin.judge.proof.compare import compare_render
from usdskin.judge.proof.fit import fit_options, goniometer_setup
from usdskin.judge.proof.options import ProofOptions
from usdskin.judge.proof.place import Place
from usdskin.judge.proof.record import Doing
from usdskin.judge.proof.render import render_shot
from usdskin.judge.proof.shots import ShotParts, subject_and_tone, write_base, write_shot
from usdskin.judge.proof.skin import even_skin, write_true_skin
from usdskin.judge.skin.goniometer import read_goniometer
from usdskin.progress import Progress


@dataclass(frozen=True, slots=True)
class ToneFiles:
    """Where the files of a tone lie."""

    folder: Path
    """A folder of its own."""

    def __getitem__(self, name: str) -> Path:
        """Return a file by its name."""
        return self.folder / name


def judge_tone(
    shot: Path, tone: str, place: Place, options: ProofOptions, progress: Progress, doing: Doing
) -> None:
    """Render and compare one tone; the row of ``proof.json`` is the fact ``row``.

    Args:
        shot: The set's shot.
        tone: Variant of its skin.
        place: The proof's folder, with the true and the estimated light.
        options: What the proof is told.
        progress: Told how far it is.
        doing: Takes files, notes and the row.
    """
    at = ToneFiles(place[f"tones/{tone}"])
    variants = subject_and_tone(options.subject, tone)
    base = write_base(shot, place.truth_light, variants, at["base.usda"])
    skin = even_skin(base, options.lustre)
    true_skin = write_true_skin(skin, base, at["truth.skin.usda"])
    samples = read_goniometer(true_skin, at["samples.usda"], goniometer_setup(options))
    found = estimate_skin(samples, at["skin.usda"], fit_options(skin, options), progress)
    doing.notes += found.notes
    doing.writes += [base, true_skin, samples, found.path]
    light = place["light.usda"]
    parts = {
        "truth": ShotParts(place.truth_light, true_skin, skin.thickness),
        "light": ShotParts(light, true_skin, skin.thickness),
        "chain": ShotParts(light, found.path, skin.thickness),
    }
    results: dict[str, dict[str, Any]] = {}
    for name, part in parts.items():
        written = write_shot(base, part, at[f"{name}.usda"])
        picture = at[f"{name}_map.exr"]
        rendered = render_shot(written, picture, "map", options, progress)
        doing.writes += [written, *rendered.writes]
        if name != "truth":
            maps = at[f"{name}_map.difference.exr"]
            compared = compare_render(at["truth_map.exr"], picture, maps, options.observer, place)
            doing.writes += compared.writes
            results[name] = compared.facts["result"]
    doing.facts["row"] = {
        "tone": tone,
        "integrator": "map",
        "deltaE2000": results["light"]["deltaE2000"],
        "gfc": results["light"]["spectral"]["gfc"],
        "chain": {
            "deltaE2000": results["chain"]["deltaE2000"],
            "gfc": results["chain"]["spectral"]["gfc"],
        },
    }
