"""``proof.json`` -> ``Proof``: what a proof found and which files it found it in.

Reads: ``proof.json`` and the hashes of the files it names. Everything is checked, for the folder
may have come by mail.
"""

from __future__ import annotations

import itertools
import json
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path, PurePosixPath
from typing import Any

from usdskin.judge.report.nodes import Node, ProofError
from usdskin.judge.report.records import (
    Bar,
    Cause,
    Comparison,
    Parameter,
    PatchClass,
    Picture,
    RecordedFile,
    Region,
    Spectra,
    Spread,
    Step,
    Tone,
)
from usdskin.layers import sha256

__all__ = ["PROOF_NAME", "Proof", "read_proof"]

PROOF_NAME = "proof.json"


@dataclass(frozen=True, slots=True)
class Proof:
    """All of ``proof.json``."""

    folder: Path
    version: str
    set_name: str
    title: str
    settings: Mapping[str, Any]
    steps: tuple[Step, ...]
    files: Mapping[str, RecordedFile]
    layers: Mapping[str, str]
    """Single layers by name, such as ``capture`` and ``light``."""

    pictures: tuple[Picture, ...]
    comparisons: tuple[Comparison, ...]
    wavelengths: tuple[float, ...]
    spectra: tuple[Spectra, ...]
    skin: tuple[Parameter, ...]
    tones: tuple[Tone, ...]
    budget: tuple[Cause, ...]
    bars: tuple[Bar, ...]
    patches: tuple[PatchClass, ...] = ()
    missing: tuple[str, ...] = ()
    """What the proof says of itself that it lacks."""

    digest: str = ""
    """SHA-256 of ``proof.json`` itself."""

    checked: set[str] = field(default_factory=set)
    """Files found as they were recorded."""

    def file(self, name: str) -> Path:
        """Return the path of a file, made sure to be what the proof was made with.

        Raises:
            ProofError: It is outside the folder, missing, or has changed.
        """
        path = _inside(self.folder, name)
        if not path.is_file():
            raise ProofError(
                f"{path}: is missing, and {self.folder / PROOF_NAME} names it; prove again"
            )
        recorded = self.files.get(name)
        if recorded is None:
            raise ProofError(
                f"{path}: has no sha256 in {PROOF_NAME}, so nobody can tell whether it is the file "
                "of the proof; prove again"
            )
        if name not in self.checked:
            if sha256(path) != recorded.sha256:
                raise ProofError(
                    f"{path}: has changed since the proof was made, its sha256 is another than in "
                    f"{PROOF_NAME}; prove again"
                )
            self.checked.add(name)
        return path

    def absent_files(self) -> list[str]:
        """Check every recorded file, and return those that are not there any more."""
        absent = []
        for name in sorted(self.files):
            if _inside(self.folder, name).is_file():
                self.file(name)
            else:
                absent.append(name)
        return absent


def _inside(folder: Path, name: str) -> Path:
    relative = PurePosixPath(name)
    windows = "\\" in name or ":" in name.split("/")[0]
    if not name or relative.is_absolute() or ".." in relative.parts or windows:
        raise ProofError(
            f"{folder / PROOF_NAME}: names the file {name!r}, which is not inside the folder; "
            "correct the path"
        )
    path = folder / relative
    if path.is_symlink() or not path.resolve().is_relative_to(folder.resolve()):
        raise ProofError(f"{path}: is a link out of the proof's folder; put the file itself there")
    return path


def read_proof(folder: Path) -> Proof:
    """Return the proof in a folder.

    Args:
        folder: Folder that ``usdskin prove`` has filled.

    Raises:
        ProofError: There is none, it is broken, or a value in it cannot be used.
    """
    path = folder / PROOF_NAME
    if not folder.is_dir():
        raise ProofError(f"{folder}: no such folder; name the one that `usdskin prove` filled")
    if not path.is_file():
        raise ProofError(
            f"{folder}: holds no {PROOF_NAME}; `usdskin prove FOLDER -o {folder}` writes it"
        )
    try:
        value = json.loads(path.read_text("utf-8"), parse_constant=_refuse_constant)
        json.dumps(value, ensure_ascii=False).encode("utf-8")  # half a surrogate pair is no text
        root = Node(value, str(path))
    except (ValueError, RecursionError) as error:
        reason = str(error).splitlines()[0] if str(error) else type(error).__name__
        raise ProofError(f"{path}: is no JSON ({reason}); prove again") from None
    except OSError as error:
        raise ProofError(f"{path}: cannot be read ({error.strerror})") from None
    spectra = root.optional("spectra")
    wavelengths = () if spectra is None else _numbers(spectra, "wavelengths") or ()
    if any(b <= a for a, b in itertools.pairwise(wavelengths)):
        raise ProofError(f"{path}.spectra.wavelengths: must ascend; prove again")
    return Proof(
        folder=folder,
        version=root.child("version").text(),
        set_name=root.child("set").text(),
        title=root.maybe_text("title") or root.child("set").text(),
        settings={} if (given := root.optional("settings")) is None else given.members(),
        steps=tuple(_step(node) for node in root.rows("steps")),
        files=_files(root),
        layers=_layers(root),
        pictures=tuple(_picture(node) for node in root.rows("pictures")),
        comparisons=tuple(_comparison(node) for node in root.rows("comparisons")),
        wavelengths=wavelengths,
        spectra=()
        if spectra is None
        else tuple(_spectra(node, len(wavelengths)) for node in spectra.rows("items")),
        skin=tuple(_parameter(node) for node in root.rows("skin")),
        tones=tuple(_tone(node) for node in root.rows("tones")),
        budget=tuple(_cause(node) for node in root.rows("budget")),
        bars=tuple(_bar(node) for node in root.rows("bars")),
        patches=tuple(_patch_class(node) for node in root.rows("patches")),
        missing=root.texts("missing"),
        digest=sha256(path),
    )


def _refuse_constant(name: str) -> float:
    raise ValueError(f"{name} is no number of JSON")


def _files(root: Node) -> dict[str, RecordedFile]:
    found = root.optional("files")
    if found is None:
        return {}
    rows = {}
    for name, node in found.entries():
        size = node.maybe_number("bytes")
        rows[name] = RecordedFile(
            node.child("sha256").text().lower(), None if size is None else int(size)
        )
    return rows


def _layers(root: Node) -> dict[str, str]:
    found = root.optional("layers")
    if found is None:
        return {}
    return {
        name: node.text()
        for name, node in found.entries()
        if node.value is not None and not isinstance(node.value, dict | list)
    }


def _step(node: Node) -> Step:
    return Step(
        node.child("name").text(),
        node.maybe_text("title"),
        node.maybe_text("command"),
        node.maybe_number("seconds"),
        node.texts("reads"),
        node.texts("writes"),
        node.texts("notes"),
    )


def _picture(node: Node) -> Picture:
    spectral = node.optional("spectral")
    return Picture(
        node.child("name").text(),
        node.child("integrator").text(),
        node.child("beauty").text(),
        None if spectral is None else spectral.text(),
    )


_SPREADS = ("deltaE2000", "deltaE76", "deltaL", "deltaA", "deltaB", "flip")


def _comparison(node: Node) -> Comparison:
    result = node.child("result")
    mask = result.optional("mask")
    maps = node.optional("maps")
    white = result.optional("white")
    pixels = None if mask is None else mask.maybe_number("pixels")
    spectral = result.optional("spectral")
    result.child("deltaE2000")
    return Comparison(
        name=node.child("name").text(),
        integrator=node.child("integrator").text(),
        truth=node.child("truth").text(),
        picture=node.child("picture").text(),
        maps=None if maps is None else maps.text(),
        observer=result.maybe_text("observer"),
        y_n=result.maybe_number("yN"),
        white=None if white is None else _chromaticity(white),
        white_from=result.maybe_text("whiteFrom"),
        mask_from="" if mask is None else mask.maybe_text("from"),
        mask_pixels=None if pixels is None else int(pixels),
        mask_share=None if mask is None else mask.maybe_number("share"),
        spreads={name: _spread(result.optional(name)) for name in _SPREADS},
        spectral={}
        if spectral is None
        else {
            name: value
            for name in ("rmse", "gfc", "p05gfc")
            if (value := spectral.maybe_number(name)) is not None
        },
        regions=tuple(
            Region(
                row.child("name").text(),
                int(row.child("pixels").number()),
                _spread(row.optional("deltaE2000")),
            )
            for row in result.rows("regions")
        ),
        noise=_inner_spread(node.optional("noise")),
    )


def _inner_spread(node: Node | None) -> Spread | None:
    return None if node is None else _spread(node.optional("deltaE2000"))


def _chromaticity(node: Node) -> tuple[float, float]:
    values = [item.number() for item in node.items()]
    if len(values) != 2 or not (values[0] > 0.0 and values[1] > 0.0 and sum(values) < 1.0):
        raise node.error("a chromaticity [x, y]")
    return values[0], values[1]


def _spread(node: Node | None) -> Spread:
    if node is None:
        return Spread()
    names = ("mean", "median", "p95", "max", "rms")
    return Spread(**{name: node.maybe_number(name) for name in names})


def _spectra(node: Node, count: int) -> Spectra:
    rows = {name: _numbers(node, name) for name in ("true", "estimated", "stddev")}
    for name, values in rows.items():
        if values is not None and len(values) != count:
            raise ProofError(
                f"{node.where}.{name}: has {len(values)} values for {count} wavelengths; "
                "prove again"
            )
    return Spectra(node.child("name").text(), node.maybe_text("kind"), **rows)


def _numbers(node: Node, name: str) -> tuple[float, ...] | None:
    found = node.optional(name)
    return None if found is None else tuple(item.number() for item in found.items())


def _parameter(node: Node) -> Parameter:
    values = (node.maybe_number(name) for name in ("true", "estimated", "stddev"))
    return Parameter(node.child("name").text(), *values)


def _tone(node: Node) -> Tone:
    return Tone(
        node.child("tone").text(),
        node.maybe_text("integrator"),
        _spread(node.child("deltaE2000")),
        node.maybe_number("gfc"),
        _inner_spread(node.optional("chain")),
    )


def _cause(node: Node) -> Cause:
    given = node.optional("setting")
    setting = "" if given is None else str(given.value)
    return Cause(node.child("cause").text(), setting, _spread(node.child("deltaE2000")))


def _patch_class(node: Node) -> PatchClass:
    left_out, relit = node.optional("leaveOneOut"), node.optional("relit")
    return PatchClass(
        node.child("class").text(),
        _inner_spread(left_out),
        None if left_out is None else left_out.maybe_number("gfc"),
        _inner_spread(relit),
        None if relit is None else relit.maybe_number("gfc"),
        None if relit is None else relit.maybe_number("lampGfc"),
        tuple(
            (
                row.child("name").text(),
                row.maybe_number("leaveOneOut"),
                row.maybe_number("relit"),
            )
            for row in node.rows("patches")
        ),
    )


def _bar(node: Node) -> Bar:
    return Bar(
        node.child("name").text(),
        node.maybe_number("value"),
        node.child("bar").number(),
        node.child("met").truth(),
    )
