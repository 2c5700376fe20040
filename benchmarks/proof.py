"""The product's standing proof on all sets: ``python -m benchmarks.proof [--quick]``.

Every set is proved (``usdskin prove``) with exact camera values (recovery alone), with a realistic
capture, and with a realistic capture whose readings err by 3 %, by the default and by the paper's
literal estimator. The light of a set is solved once. Rendered by map, which has no noise, so that
what is told is the estimates' error; ``--traced`` adds traced pictures. ``--seeds`` repeats
realistic captures with other noise, rotations and corners. ``--class-captures`` captures mixed
light with each kind of lamp alone too.

Colour difference: CIEDE2000, CIE 1931 2 degrees, on the pixels of skin; Y and white are those of a
perfect diffuser at the truth's brightest irradiance.
"""

from __future__ import annotations

import argparse
import json
import shutil
import sys
import tempfile
from collections.abc import Iterator
from pathlib import Path
from typing import Any

from usdskin.errors import UsdSkinError
from usdskin.judge.proof.options import PROOF_CAMERA, ProofOptions, size_of
from usdskin.judge.proof.prove import prove

STAGES = Path(__file__).resolve().parents[1] / "stages"
SETS = ("room_fluorescent", "hall_incandescent", "outdoor_sun", "mixed_window")
CONDITIONS: dict[str, dict[str, Any]] = {
    "recovery alone": {"capture": "ideal"},
    "realistic": {"capture": "realistic"},
    "realistic, scale +3 %": {"capture": "realistic", "scale_error": 0.03},
}
ESTIMATORS = ("regression", "literal")


def rows(arguments: argparse.Namespace, folder: Path) -> Iterator[dict[str, Any]]:
    """Yield a row for every set, condition and estimator."""
    for name in arguments.sets:
        if not (STAGES / name / "set.usda").is_file():
            print(f"{name}: not there", file=sys.stderr)
            continue
        light = arguments.lights and arguments.lights / name / "light.usda"
        for camera in arguments.cameras:
            for estimator in arguments.estimators:
                for condition, given, seed in _draws(arguments.seeds, estimator):
                    tones = arguments.tones and condition == "realistic" and estimator != "literal"
                    tones = tones and seed == 0
                    options = ProofOptions(
                        **given,
                        estimator=estimator,
                        integrators=("map", "traced") if arguments.traced else ("map",),
                        size=size_of(arguments.size),
                        subject=arguments.subject,
                        camera=camera,
                        seed=seed,
                        light=light,
                        tones=tones,
                        class_captures=arguments.class_captures,
                    )
                    output = folder / f"{name}-{len(list(folder.iterdir()))}"
                    row = {
                        "set": name,
                        "camera": camera,
                        "condition": condition,
                        "estimator": estimator,
                        "seed": seed,
                    }
                    try:
                        proof = prove(STAGES / name, output, options)
                    except UsdSkinError as error:
                        # The literal estimator may recover so little that a step refuses it.
                        yield {**row, "refused": str(error)}
                        continue
                    if light is None:
                        light = output / "truth" / "light.usda"
                    content = proof.content
                    yield {
                        **row,
                        "classes": len(content["layers"]["truthClasses"]),
                        "bars": content["bars"],
                        "seconds": sum(step.seconds for step in proof.steps),
                        "comparisons": content["comparisons"],
                        "tones": content["tones"],
                    }


def _draws(seeds: int, estimator: str) -> Iterator[tuple[str, dict[str, Any], int]]:
    """Yield conditions; those with noise as often as is asked for, the baseline once."""
    for condition, given in CONDITIONS.items():
        is_noisy = given["capture"] != "ideal" and estimator != "literal"
        for seed in range(seeds if is_noisy else 1):
            yield condition, given, seed


def summary(kept: list[dict[str, Any]]) -> Iterator[str]:
    """Yield a table of what all draws gave: mean of the means (least to largest), p95, largest."""
    yield "| set | camera | capture | picture | mean (draws) | p95 | max | GFC | literal | missed |"
    yield "|---|---|---|---|---|---|---|---|---|---|"
    groups: dict[tuple[str, ...], list[tuple[dict[str, Any], list[dict[str, Any]]]]] = {}
    literal: dict[tuple[str, ...], str] = {}
    for row in kept:
        key = row["set"], row["camera"], row["condition"]
        for found in row.get("comparisons", ()):
            whole = *key, f"{found['name']}, {found['integrator']}"
            if row["estimator"] == "literal":
                literal[whole] = f"{found['result']['deltaE2000']['mean']:.1f}"
                continue
            bars = [bar for bar in row["bars"] if bar["name"].startswith(whole[-1])]
            groups.setdefault(whole, []).append((found["result"], bars))
        if "refused" in row and row["estimator"] == "literal":
            literal |= {whole: "refused" for whole in groups if whole[:3] == key}
    for whole, draws in groups.items():
        means = [result["deltaE2000"]["mean"] for result, _ in draws]
        span = f" ({min(means):.2f} to {max(means):.2f})" if len(means) > 1 else ""
        p95, largest = (max(r["deltaE2000"][name] for r, _ in draws) for name in ("p95", "max"))
        gfc = min(result["spectral"]["gfc"] for result, _ in draws)
        missed = sum(not all(bar["met"] for bar in bars) for _, bars in draws)
        yield (
            f"| {' | '.join(whole)} | {sum(means) / len(means):.2f}{span} | {p95:.2f} | "
            f"{largest:.2f} | {gfc:.4f} | {literal.get(whole, '')} | {missed} of {len(draws)} |"
        )


def show(row: dict[str, Any]) -> str:
    """Return a row as lines of a table."""
    lines = []
    if "refused" in row:
        return (
            f"| {row['set']} | {row['camera']} | {row['condition']} | {row['estimator']} | "
            f"refused: {row['refused']} | | | | | |"
        )
    for found in row["comparisons"]:
        numbers, spectral = found["result"]["deltaE2000"], found["result"]["spectral"]
        bars = [
            bar
            for bar in row["bars"]
            if bar["name"].startswith(f"{found['name']}, {found['integrator']}")
        ]
        verdict = "met" if all(bar["met"] for bar in bars) else "MISSED"
        lines.append(
            f"| {row['set']} | {row['camera']} | {row['condition']} | {row['estimator']} | "
            f"{found['name']}, {found['integrator']} | {numbers['mean']:.2f} | "
            f"{numbers['p95']:.2f} | {numbers['max']:.2f} | {spectral['gfc']:.4f} | "
            f"{verdict if row['estimator'] != 'literal' else ''} |"
        )
    for tone in row["tones"]:
        numbers, chain = tone["deltaE2000"], tone["chain"]["deltaE2000"]
        lines.append(
            f"| {row['set']} | {row['camera']} | {tone['tone']} | {row['estimator']} | light; chain"
            f" | {numbers['mean']:.2f}; {chain['mean']:.2f} | {numbers['p95']:.2f}; "
            f"{chain['p95']:.2f} | {numbers['max']:.2f}; {chain['max']:.2f} | {tone['gfc']:.4f} | |"
        )
    return "\n".join(lines)


def main() -> int:
    """Prove the sets and print the table."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--quick", action="store_true", help="tiny sizes")
    parser.add_argument("--size", default="preview", help="tiny, preview or full")
    parser.add_argument("--sets", nargs="+", default=list(SETS))
    parser.add_argument("--estimators", nargs="+", default=list(ESTIMATORS))
    parser.add_argument("--cameras", nargs="+", default=[PROOF_CAMERA])
    parser.add_argument("--subject", default="bust")
    parser.add_argument("--lights", type=Path, help="folder of lights solved before, by set")
    parser.add_argument("--seeds", type=int, default=1, help="draws of realistic captures")
    parser.add_argument("--traced", action="store_true")
    parser.add_argument("--tones", action="store_true")
    parser.add_argument("--class-captures", action="store_true")
    parser.add_argument("--json", type=Path, help="write the rows here too")
    arguments = parser.parse_args()
    if arguments.quick:
        arguments.size = "tiny"
    folder = Path(tempfile.mkdtemp(prefix="proof-"))
    print("| set | camera | capture | estimator | picture | mean | p95 | max | GFC | bar |")
    print("|---|---|---|---|---|---|---|---|---|---|", flush=True)
    kept = []
    try:
        for row in rows(arguments, folder):
            kept.append(row)
            print(show(row), flush=True)
    finally:
        shutil.rmtree(folder, ignore_errors=True)
    print("", *summary(kept), sep="\n")
    if arguments.json:
        arguments.json.write_text(json.dumps(kept, indent=1))
    return 0


if __name__ == "__main__":
    sys.exit(main())
