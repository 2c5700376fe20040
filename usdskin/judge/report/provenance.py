"""Where everything came from: commands, files with hashes, versions."""

from __future__ import annotations

from usdskin import __version__
from usdskin.errors import UsdSkinError
from usdskin.judge.report.markup import Markup, element, fragment
from usdskin.judge.report.proof import PROOF_NAME, Proof
from usdskin.judge.report.shown import NONE, note, number, number_cell, section, size, table
from usdskin.layers import open_stage
from usdskin.notes import Note

__all__ = ["LayerRecord", "provenance_section", "read_records"]

LayerRecord = tuple[str, str, str, str, str]
"""Layer, step, version, when, and settings, each as it is shown."""


def read_records(proof: Proof, notes: list[Note]) -> list[LayerRecord]:
    """Return what the proof's layers say of who made them.

    Args:
        proof: Names the layers.
        notes: Takes layers that cannot be opened.
    """
    records = []
    for name in sorted(set(proof.layers.values())):
        if not name.endswith((".usd", ".usda", ".usdc")):
            continue
        if name not in proof.files or not (proof.folder / name).is_file():
            continue
        path = proof.file(name)
        try:
            stage = open_stage(path, notes)
            data = stage.GetRootLayer().customLayerData.get("usdskin", {})
        except UsdSkinError as error:
            notes.append(Note("layer-not-read", str(path), str(error)))
            continue
        if not isinstance(data, dict):
            continue
        for step, record in sorted(data.items()):
            if not isinstance(record, dict):
                continue
            settings = record.get("settings", {})
            items = sorted(settings.items()) if isinstance(settings, dict) else []
            shown = ", ".join(f"{key} {_setting(value)}" for key, value in items)
            records.append(
                (
                    name,
                    str(step),
                    str(record.get("version", NONE)),
                    str(record.get("created", NONE)),
                    shown,
                )
            )
    return records


def _setting(value: object) -> str:
    if isinstance(value, float):
        return f"{value:g}"
    if isinstance(value, str | int):
        return str(value)
    try:
        return "[" + ", ".join(_setting(item) for item in value) + "]"  # type: ignore[attr-defined]
    except TypeError:
        return str(value)


def provenance_section(proof: Proof, records: list[LayerRecord], absent: list[str]) -> Markup:
    """Return the section of commands, files and versions.

    Args:
        proof: Its steps and files.
        records: What the layers say of themselves.
        absent: Files that the proof had and that are not in the folder any more.
    """
    return section(
        "provenance",
        "Provenance",
        note(
            f"Proved with usdskin {proof.version}, reported by {__version__}. "
            f"sha256 of {PROOF_NAME}: ",
            element("code", proof.digest),
        ),
        _steps(proof),
        _records(records),
        _files(proof, set(absent)),
    )


def _steps(proof: Proof) -> Markup | None:
    if not proof.steps:
        return None
    commands = [step.command for step in proof.steps if step.command]
    heads = [("Step", False), ("Command, to be run in the proof's folder", False), ("s", True)]
    rows = []
    for step in proof.steps:
        notes = [element("p", text, class_="note") for text in step.notes]
        rows.append(
            element(
                "tr",
                element("th", step.title or step.name, scope="row"),
                element("td", _command(step.command), *notes),
                number_cell(number(step.seconds, 1)),
            )
        )
    all_at_once = element(
        "div",
        element("button", "Copy all commands", type="button", class_="copy",
                data_copies="all-commands"),
        element("pre", "\n".join(commands), id="all-commands", class_="unseen"),
        class_="tools",
    )  # fmt: skip
    return fragment(
        all_at_once if commands else None, table("Commands to reproduce it", heads, rows, "steps")
    )


def _command(command: str) -> Markup | str:
    if not command:
        return NONE
    button = element("button", "Copy", type="button", class_="copy", aria_label=f"Copy {command}")
    return element("div", element("code", command), button, class_="command")


def _records(records: list[LayerRecord]) -> Markup | None:
    if not records:
        return None
    heads = [(text, False) for text in ("Layer", "Made by", "Version", "When", "Settings")]
    rows = [
        element(
            "tr",
            element("th", element("code", layer), scope="row"),
            *(element("td", text) for text in rest),
        )
        for layer, *rest in records
    ]
    inner = table("What the layers say of themselves", heads, rows, "records")
    return element("details", element("summary", f"Layers ({len(records)})"), inner)


def _files(proof: Proof, absent: set[str]) -> Markup | None:
    if not proof.files:
        return None
    heads = [("File", False), ("Size", True), ("sha256", False)]
    rows = [
        element(
            "tr",
            element("th", element("code", name), " (not here)" if name in absent else None,
                    scope="row"),
            number_cell(size(file.bytes)),
            element("td", element("code", file.sha256, class_="hash")),
        )
        for name, file in sorted(proof.files.items())
    ]  # fmt: skip
    inner = table("Files, as they were when the proof ended", heads, rows, "files")
    return element("details", element("summary", f"Files and hashes ({len(rows)})"), inner)
