"""The pictures of a proof, all developed alike.

The PNGs of one integrator share exposure and white, those of the truth, or a wipe between two of
them would hide the very difference it is to show.
"""

from __future__ import annotations

import re
from pathlib import Path

import numpy as np

from usdskin.images import read_headers, read_image
from usdskin.judge.proof.options import Integrator, ProofOptions
from usdskin.judge.proof.record import Doing
from usdskin.progress import Progress
from usdskin.render.overrides import RenderOverrides
from usdskin.render.preview import render_png
from usdskin.render.render import render_stage

AOVS = ("N", "albedo", "primId", "irradiance", "cryptomatte")
"""Data that comparisons take masks and white from."""

MAP_SAMPLES = 4
"""Samples per pixel of renders by map."""

TARGET_ERROR = 0.002
"""Relative error at which the sampling of a traced pixel stops: the judge has to see less noise
than a shot's viewers do."""

_NUMBERS = re.compile(r"\(([-+.\deE]+), ([-+.\deE]+), ([-+.\deE]+)\)")


def render_shot(
    shot: Path,
    output: Path,
    integrator: Integrator,
    options: ProofOptions,
    progress: Progress,
    seed: int | None = None,
) -> Doing:
    """Render a shot with its spectra.

    Args:
        shot: The shot.
        output: Picture to write; its spectra and PNG come to lie beside it.
        integrator: How.
        options: Size, samples, seed and device count.
        progress: Told how far it is.
        seed: Of the samples; None: the proof's.
    """
    overrides = RenderOverrides(
        width=options.size.width,
        integrator=integrator,
        samples=samples_of(integrator, options),
        target_error=TARGET_ERROR if integrator == "traced" else None,
        seed=options.seed if seed is None else seed,
        spectral_output=True,
        observer=options.observer,
        aovs=AOVS,
        dome="hide",
        device=options.device,
        threads=options.threads,
    )
    report = render_stage(shot, output, overrides, progress)
    return Doing(writes=list(report.paths), notes=list(report.notes))


def render_words(
    output: Path, integrator: Integrator, options: ProofOptions, seed: int | None = None
) -> list[str | Path]:
    """Return the same as words of a command line."""
    words: list[str | Path] = [output, "--integrator", integrator, "-w", str(options.size.width)]
    words += ["-p", str(samples_of(integrator, options))]
    if integrator == "traced":
        words += ["--target-error", f"{TARGET_ERROR:g}"]
    words += [
        "--seed",
        str(options.seed if seed is None else seed),
        "--spectral",
        "--aov",
        ",".join(AOVS),
    ]
    return [*words, "--dome", "hide", "--observer", options.observer]


def samples_of(integrator: Integrator, options: ProofOptions) -> int:
    """Return the samples per pixel: maps have no noise, so that edges alone need them."""
    return options.size.samples if integrator == "traced" else MAP_SAMPLES


def spectral_of(picture: Path) -> Path:
    """Return the spectral file that goes with a picture."""
    return picture.with_name(f"{picture.stem}.spectral.exr")


def develop_like(picture: Path, model: Path, observer: str) -> None:
    """Develop the PNG of a picture anew, with another PNG's exposure and white.

    Args:
        picture: The picture; its PNG is replaced.
        model: Picture whose PNG says how.
        observer: Observer of both.
    """
    said = read_headers(model.with_suffix(".png"))[0].attributes
    white = _NUMBERS.search(str(said.get("usdskin/white", "")))
    found = read_image(picture, channels=("R", "G", "B", "A"))
    render_png(
        picture.with_suffix(".png"),
        np.asarray(found.pixels, dtype=np.float32),
        ev=float(said["usdskin/ev"]),
        white="none" if white is None else "scene",
        scene_white_xyz=None if white is None else [float(number) for number in white.groups()],
        observer=observer,  # type: ignore[arg-type]
    )
