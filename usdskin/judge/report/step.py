"""Report on a proof: one HTML file that needs nothing else, and its numbers beside it.

Reads:  ``proof.json`` in a folder and the files it names, made sure to be those it was made with.
Writes: ``report.html``, ``report.json`` and ``report.csv``.
"""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import ExitStack
from dataclasses import dataclass, field
from pathlib import Path

from usdskin.errors import UsageError
from usdskin.images import replacing
from usdskin.judge.report.figures_file import as_csv, as_json, content_of
from usdskin.judge.report.findings import (
    budget_section,
    patches_section,
    skin_section,
    spectra_section,
    tones_section,
)
from usdskin.judge.report.lights import light_section, read_light_pictures
from usdskin.judge.report.markup import Markup, element
from usdskin.judge.report.page import page
from usdskin.judge.report.pictures import pictures_section, renders_section
from usdskin.judge.report.proof import PROOF_NAME, Proof, read_proof
from usdskin.judge.report.provenance import provenance_section, read_records
from usdskin.judge.report.quality import capture_section, quality_picture, read_capture
from usdskin.judge.report.rasters import embed
from usdskin.judge.report.shown import section
from usdskin.judge.report.verdict import headline, verdict_section
from usdskin.judge.report.views import read_views
from usdskin.notes import Note
from usdskin.replacing import check_writable, scratch_beside

__all__ = ["Report", "write_report"]


@dataclass(frozen=True, slots=True)
class Report:
    """What was written."""

    paths: tuple[Path, ...]
    """``report.html``, ``report.json`` and ``report.csv``."""

    verdict: str
    """The headline."""

    missing: tuple[str, ...]
    """Sections that were left out, for the proof has nothing to show there."""

    notes: list[Note] = field(default_factory=list)
    """What could not be shown."""


def write_report(folder: Path, output: Path | None = None) -> Report:
    """Write the report of a proof.

    Args:
        folder: Folder that ``usdskin prove`` has filled.
        output: HTML file to write; ``report.html`` in the folder by default. The numbers are
            written beside it, under the same name with .json and .csv.

    Returns:
        What was written.

    Raises:
        ProofError: The proof is missing or broken, or a file of it is missing or has changed.
        UsdSkinError: A file cannot be read or written.
    """
    proof = read_proof(folder)
    paths = _outputs(proof, folder / "report.html" if output is None else output)
    absent = proof.absent_files()
    notes: list[Note] = []
    for name in absent:
        notes.append(Note("file-absent", name, f"{PROOF_NAME} lists it, and it is not there"))
    with scratch_beside(paths[0]) as scratch:
        sections, missing, data, numbers = _sections(proof, scratch, absent, notes)
    text = page(f"{proof.title}: proof of colour", headline(proof), sections, data)
    with ExitStack() as stack:
        written = (text, as_json(numbers), as_csv(numbers))
        for path, content in zip(paths, written, strict=True):
            temporary = stack.enter_context(replacing(path))
            Path(temporary).write_text(content, "utf-8", newline="\n")
    return Report(paths, headline(proof)[0], tuple(missing), notes)


def _outputs(proof: Proof, output: Path) -> tuple[Path, Path, Path]:
    if output.suffix.lower() not in (".html", ".htm"):
        raise UsageError(f"-o/--output {output}: a report is HTML; end the name in .html.")
    paths = (output, output.with_suffix(".json"), output.with_suffix(".csv"))
    taken = {(proof.folder / name).resolve() for name in (PROOF_NAME, *proof.files)}
    for path in paths:
        if path.resolve() in taken:
            raise UsageError(f"{path}: is a file of the proof; write to another name.")
        check_writable(path)
    return paths


def _sections(
    proof: Proof, scratch: Path, absent: list[str], notes: list[Note]
) -> tuple[list[Markup], list[str], Markup | None, dict[str, object]]:
    renders = read_views(proof, scratch, notes)
    compared, data = pictures_section(renders)
    capture = read_capture(proof, notes)
    lights = read_light_pictures(proof, scratch, notes)
    made = {
        "Truth and reproduction": compared,
        "Renders": renders_section(renders),
        "Chart patches": patches_section(proof),
        "Tones of skin": tones_section(proof),
        "Error budget": budget_section(proof),
        "Spectra": spectra_section(proof),
        "Light": light_section(lights, scratch),
        "Skin parameters": skin_section(proof),
        "Capture": capture_section(capture, _quality(proof, scratch)),
    }
    if proof.comparisons and made["Chart patches"] is None:
        del made["Chart patches"]  # they stand in for a truth, which is there
    missing = [title for title, found in made.items() if found is None]
    sections = [verdict_section(proof), *(found for found in made.values() if found is not None)]
    sections.append(provenance_section(proof, read_records(proof, notes), absent))
    if missing or notes or proof.missing:
        told = _absences(missing, proof.missing, notes)
        sections.append(section("missing", "Not in this report", *told))
    return sections, missing, data, content_of(proof, capture, missing)


def _absences(missing: list[str], said: tuple[str, ...], notes: list[Note]) -> Iterator[Markup]:
    for sentence in said:
        yield element("p", f"The proof says: {sentence}.")
    if missing:
        yield element("p", f"The proof holds nothing for: {', '.join(missing)}.")
    if notes:
        yield element("ul", *(element("li", str(note)) for note in notes))


def _quality(proof: Proof, scratch: Path) -> Markup | None:
    import numpy as np

    from usdskin.images import read_image

    path = quality_picture(proof)
    if path is None:
        return None
    pixels = np.rint(np.clip(read_image(path).pixels[..., :3], 0.0, 1.0) * 255.0)
    raster = embed(pixels.astype(np.uint8), scratch)
    return raster.image("The panorama with clipped, moved and unseen parts marked")
