"""``prove``: the whole chain on a set whose truth is known, judged."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from usdskin.commands.options import StepCommand
from usdskin.commands.reporter import GlobalOptions, Reporter
from usdskin.errors import EXIT_FINDINGS, UsageError

if TYPE_CHECKING:
    from usdskin.judge.proof.prove import Proof
    from usdskin.judge.proof.record import StepRecord

_PATH = click.Path(path_type=Path)
_OF_SETS = (
    *("capture", "scale_error", "solve_height", "fisheye", "exposures", "tones", "budget"),
    *("light", "camera", "chart", "check"),
)
"""What is about the virtual shoot of a set, or about its truth."""


@click.command("prove", cls=StepCommand)
@click.argument("folder", metavar="FOLDER", type=_PATH)
@click.option("-o", "--output", type=_PATH, required=True, metavar="DIR", help="Folder to fill.")
@click.option(
    "--capture",
    type=click.Choice(["ideal", "realistic"]),
    default="realistic",
    show_default=True,
    help="ideal: exact camera values, so that recovery alone is judged; realistic: photographs "
    "with 1 % of glare, 2 % of vignetting left, 1 degree of rotation, and noise.",
)
@click.option(
    "--scale-error",
    type=float,
    default=0.0,
    metavar="SHARE",
    help="Error that all readings of light share, such as 0.03.  [default: 0]",
)
@click.option(
    "--class-captures",
    is_flag=True,
    help="Capture the place with each kind of lamps alone too, where there are several.",
)
@click.option(
    "--estimator",
    type=click.Choice(["regression", "literal", "tsvd", "pca", "wiener", "smooth"]),
    default="regression",
    show_default=True,
    help="As for calibrate camera.",
)
@click.option(
    "--integrator",
    type=click.Choice(["map", "traced", "both"]),
    default="both",
    show_default=True,
    help="How the pictures are rendered.",
)
@click.option(
    "--size",
    type=click.Choice(["tiny", "preview", "full"]),
    default="preview",
    show_default=True,
    help="How much is computed; the next five say it in numbers.",
)
@click.option("--solve-height", type=click.IntRange(min=8), help="Rows of the true light.")
@click.option("--fisheye", type=click.IntRange(min=64), help="Width of the photographs [px].")
@click.option("--exposures", type=click.IntRange(2, 99), help="Photographs in a bracket.")
@click.option("-w", "--width", type=click.IntRange(min=8), help="Width of the renders [px].")
@click.option(
    "-p", "--samples", type=click.IntRange(min=1), help="Samples per pixel of traced renders."
)
@click.option("--subject", metavar="VARIANT", help="Subject of the shot, such as bust or portrait.")
@click.option("--tone", metavar="VARIANT", help="Tone of its skin.")
@click.option("--tones", is_flag=True, help="Compare all tones of its skin too.")
@click.option("--budget", is_flag=True, help="Judge single faults too, and draw them.")
@click.option(
    "--lustre", is_flag=True, help="Let the true skin shine, and measure it without polarisers."
)
@click.option(
    "--light",
    type=_PATH,
    metavar="LIGHT.usda",
    help="True light that was solved before; its classes are LIGHT_<class>.usda.",
)
@click.option("--camera", metavar="NAME|FILE", help="Measured camera.")
@click.option("--chart", metavar="classic24|FILE", help="Color chart.  [default: classic24]")
@click.option(
    "--observer",
    type=click.Choice(["cie1931_2", "cie1964_10", "cie2015_2"]),
    help="Color-matching functions.  [default: cie1931_2]",
)
@click.option("--seed", type=click.IntRange(min=0), help="Of everything random.  [default: 0]")
@click.option("--resume", is_flag=True, help="Keep the steps that are done and unchanged.")
@click.option("--check", is_flag=True, help="End with exit code 4 where a bar is missed.")
@click.pass_obj
def prove(
    options: GlobalOptions, /, folder: Path, output: Path, check: bool, **given: Any
) -> int | None:
    r"""Prove the whole chain on FOLDER: a virtual shoot, every step, and the truth beside it.

    FOLDER holds a set, set.usda and shot.usda. Its true light is solved, photographed with the
    faults of a real shoot, captured, calibrated, estimated; its skin is measured and fitted; and
    the shot is rendered with the truth and with the estimates, and compared. DIR gets every layer
    and picture on the way, and proof.json, which says what each step did and how to do it by hand.

    FOLDER may also hold a real shoot, shoot.usda and a chart.usda with measured spectra for each
    kind of light. Then the patches of the charts are what is judged, and options about the truth or
    about virtual cameras are refused; --class-captures takes shoot_CLASS.usda, the place in the
    light of each class alone.

    \b
    Examples:
        usdskin prove stages/room_fluorescent -o out
        usdskin prove stages/mixed_window -o out --size full --tones --budget
        usdskin prove stages/outdoor_sun -o ideal --capture ideal --integrator map --check
    """
    with Reporter(options) as reporter:
        from usdskin.judge.proof.options import ProofOptions, size_of
        from usdskin.judge.proof.prove import prove as run
        from usdskin.judge.proof.real import is_real_shoot
        from usdskin.plots.budget import draw_budget

        if is_real_shoot(folder):
            _refuse_options_of_sets(folder)
        numbers = ("solve_height", "fisheye", "exposures", "width", "samples")
        size = size_of(given.pop("size"), **{name: given.pop(name) for name in numbers})
        integrator = given.pop("integrator")
        asked = {name: value for name, value in given.items() if value is not None}
        proof = run(
            folder,
            output,
            ProofOptions(
                size=size,
                integrators=("map", "traced") if integrator == "both" else (integrator,),
                device=options.device,
                threads=options.threads,
                **asked,
            ),
            reporter.progress(),
            lambda step, kept: _tell(reporter, step, kept),
            draw_budget,
        )
        _judge(reporter, proof)
        reporter.wrote([proof.path])
        missed = any(not bar["met"] for bar in proof.bars)
        return EXIT_FINDINGS if check and missed else None


def _refuse_options_of_sets(folder: Path) -> None:
    context = click.get_current_context()
    for name in _OF_SETS:
        if context.get_parameter_source(name) is not click.core.ParameterSource.DEFAULT:
            raise UsageError(
                f"--{name.replace('_', '-')} is for sets, whose truth is known; {folder} is a real "
                "shoot, so leave it out"
            )


def _tell(reporter: Reporter, step: StepRecord, kept: bool) -> None:
    reporter.event("step", name=step.name, seconds=step.seconds, kept=kept, notes=[*step.notes])
    if not reporter.json and not reporter.quiet:
        took = "kept" if kept else f"{step.seconds:.1f} s"
        click.echo(f"{step.name}: {step.title} ({took})", err=True)


def _judge(reporter: Reporter, proof: Proof) -> None:
    reporter.event("proof", bars=proof.bars, comparisons=proof.content["comparisons"])
    if reporter.json or reporter.quiet:
        return
    for row in proof.content["comparisons"]:
        found = row["result"]["deltaE2000"]
        text = (
            f"{row['name']}, {row['integrator']}: dE2000 mean {found['mean']:.3f}, "
            f"p95 {found['p95']:.3f}, max {found['max']:.3f}"
        )
        noise = (row.get("noise") or {}).get("deltaE2000")
        if noise is not None and noise["max"] > 0.0:
            text += (
                f"; two renders of the truth are {noise['mean']:.3f} apart, p95 {noise['p95']:.3f}"
            )
        click.echo(text, err=True)
    for row in proof.content.get("patches", []):
        for kind, title in (("leaveOneOut", "left out in turn"), ("relit", "relit")):
            found = (row[kind] or {}).get("deltaE2000")
            if found is not None:
                click.echo(
                    f"patches in {row['class']}, {title}: dE2000 mean {found['mean']:.3f}, "
                    f"p95 {found['p95']:.3f}, max {found['max']:.3f}; GFC {row[kind]['gfc']:.4f}",
                    err=True,
                )
    for text in proof.content["missing"]:
        click.echo(f"missing: {text}", err=True)
    for bar in proof.bars:
        met = "met" if bar["met"] else "MISSED"
        if not bar["met"] and bar["noise"] > bar["bar"]:
            met += f", but the noise of two truths is {bar['noise']:.3f}: give more --samples"
        click.echo(f"bar {bar['name']}: {bar['value']:.3f} of {bar['bar']:g}, {met}", err=True)


COMMANDS = (prove,)
