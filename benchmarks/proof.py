"""The product's standing proof on all sets: ``python -m benchmarks.proof [--quick]``.

Every set is proved (``usdskin prove``) with exact camera values (recovery alone), with a realistic
capture, and with a realistic capture whose readings err by 3 %, by the default and by the paper's
literal estimator. The light of a set is solved once. Rendered by map, which has no noise, so that
what is told is the estimates' error; ``--traced`` adds traced pictures.

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
        light: Path | None = None
        for camera in arguments.cameras:
            for estimator in arguments.estimators:
                for condition, given in CONDITIONS.items():
                    tones = arguments.tones and condition == "realistic" and estimator != "literal"
                    options = ProofOptions(
                        **given,
                        estimator=estimator,
                        integrators=("map", "traced") if arguments.traced else ("map",),
                        size=size_of(arguments.size),
                        subject=arguments.subject,
                        camera=camera,
                        light=light,
                        tones=tones,
                    )
                    output = folder / f"{name}-{len(list(folder.iterdir()))}"
                    row = {
                        "set": name,
                        "camera": camera,
                        "condition": condition,
                        "estimator": estimator,
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
    parser.add_argument("--traced", action="store_true")
    parser.add_argument("--tones", action="store_true")
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
    if arguments.json:
        arguments.json.write_text(json.dumps(kept, indent=1))
    return 0


if __name__ == "__main__":
    sys.exit(main())
