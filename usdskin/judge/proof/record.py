"""What a proof did: its steps, kept while it runs, and ``proof.json`` when it has ended.

``Journal`` keeps every finished step with the hashes of what it read and wrote, so that a proof
that was interrupted goes on where it ended. ``proof.json`` itself appears only when all steps
are done.
"""

from __future__ import annotations

import hashlib
import json
import math
import os
import shutil
import time
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from usdskin import __version__
from usdskin.errors import LayerError, UsageError
from usdskin.layers import sha256
from usdskin.notes import Note
from usdskin.replacing import check_place, replacing

PROOF_NAME = "proof.json"
JOURNAL_NAME = ".steps.json"


@dataclass(frozen=True, slots=True)
class StepRecord:
    """One finished step."""

    name: str
    """Short name, unique in a proof."""

    title: str
    """What it does, for people."""

    command: str
    """The command line that does the same, to be run in the proof's folder; empty: none does."""

    key: str
    """Hash of the command, the settings and everything read."""

    seconds: float
    """Time it took [s]."""

    reads: tuple[str, ...]
    """Files read, relative to the proof's folder."""

    writes: tuple[str, ...]
    """Files written, relative to the proof's folder."""

    digests: tuple[str, ...]
    """SHA-256 of the files written."""

    notes: tuple[str, ...] = ()
    """What the step could not honour, or what needs attention."""

    facts: Mapping[str, Any] = field(default_factory=dict)
    """What it found, for ``proof.json``."""

    def as_json(self) -> dict[str, Any]:
        """Return the step as ``proof.json`` holds it."""
        return {
            "name": self.name,
            "title": self.title,
            "command": self.command,
            "seconds": round(self.seconds, 3),
            "reads": list(self.reads),
            "writes": list(self.writes),
            "notes": list(self.notes),
        }


@dataclass(slots=True)
class Doing:
    """What a step hands back while it works."""

    writes: list[Path] = field(default_factory=list)
    """Files written."""

    notes: list[Note] = field(default_factory=list)
    """What needs attention."""

    facts: dict[str, Any] = field(default_factory=dict)
    """What was found; JSON values."""


class Journal:
    """The steps of a proof, in the folder that it fills."""

    def __init__(self, folder: Path, resume: bool) -> None:
        """Open a folder: a new or empty one, or one with a proof that is to go on.

        Args:
            folder: Where the proof goes.
            resume: Whether steps that are done and unchanged are kept.

        Raises:
            UsageError: The folder holds something else, or a proof that was not to go on.
            UsdSkinError: It cannot be made or written to.
        """
        self.folder = folder
        self.steps: list[StepRecord] = []
        self._before: dict[str, StepRecord] = {}
        self._digests: dict[Path, str] = {}
        path = folder / JOURNAL_NAME
        try:
            if folder.exists() and not folder.is_dir():
                raise UsageError(f"{folder}: is a file; name a folder")
            if path.exists():
                self._before = _read_journal(path)
                if self._before and not resume:
                    raise UsageError(
                        f"{folder}: holds a proof already; go on with --resume or name another"
                    )
            elif folder.exists() and any(folder.iterdir()):
                raise UsageError(f"{folder}: is there already; name a folder that is new or empty")
            if not folder.exists():
                check_place(folder)
                folder.mkdir(parents=True)
            _write_json(path, []) if not self._before else None
        except OSError as error:
            raise LayerError(
                f"{folder}: cannot be used ({error.strerror}); choose another"
            ) from None

    def relative(self, path: Path) -> str:
        """Return how a file is named from the proof's folder."""
        return Path(os.path.relpath(path.resolve(), self.folder.resolve())).as_posix()

    def digest(self, path: Path) -> str:
        """Return the SHA-256 of a file, reading it once."""
        key = path.resolve()
        if key not in self._digests:
            self._digests[key] = sha256(path)
        return self._digests[key]

    def step(
        self,
        name: str,
        title: str,
        command: str,
        reads: Iterable[Path],
        run: Callable[[Doing], None],
        *,
        settings: Mapping[str, Any] | None = None,
        clears: Sequence[Path] = (),
    ) -> StepRecord:
        """Do a step, or keep what it did before from the same inputs.

        Args:
            name: Unique name.
            title: What it does.
            command: The command line that does the same.
            reads: Files it depends on.
            run: Does it; tells what was written, noted and found.
            settings: What else it depends on; JSON values.
            clears: Files and folders of earlier runs that are in its way.
        """
        files = sorted(set(reads), key=str)
        described = [name, command, __version__, dict(settings or {})]
        described += [[self.relative(file), self.digest(file)] for file in files]
        text = json.dumps(described, sort_keys=True, default=str)
        key = hashlib.sha256(text.encode()).hexdigest()
        before = self._before.get(name)
        if before is not None and before.key == key and self._is_intact(before):
            self.steps.append(before)
            return before
        self._drop_proof()
        for path in clears:
            _remove(path)
        doing, began = Doing(), time.perf_counter()
        run(doing)
        seconds = time.perf_counter() - began
        written = sorted(set(doing.writes), key=str)
        for path in written:
            self._digests.pop(path.resolve(), None)
        record = StepRecord(
            name=name,
            title=title,
            command=command,
            key=key,
            seconds=seconds,
            reads=tuple(self.relative(file) for file in files),
            writes=tuple(self.relative(file) for file in written),
            digests=tuple(self.digest(file) for file in written),
            notes=tuple(dict.fromkeys(str(note) for note in doing.notes)),
            facts=doing.facts,
        )
        self.steps.append(record)
        self._save()
        return record

    def kept(self, record: StepRecord) -> bool:
        """Return whether a step was kept from an earlier run."""
        return self._before.get(record.name) is record

    def finish(self, content: Mapping[str, Any]) -> Path:
        """Write ``proof.json``: the steps, the files with their hashes, and more.

        Args:
            content: What else it holds; JSON values.

        Returns:
            The file, complete on disk.
        """
        self._save()
        files = {}
        for step in self.steps:
            for name, digest in zip(step.writes, step.digests, strict=True):
                size = (self.folder / name).stat().st_size
                files[name] = {"sha256": digest, "bytes": size}
        whole = {
            "version": __version__,
            "steps": [step.as_json() for step in self.steps],
            "files": files,
            **content,
        }
        path = self.folder / PROOF_NAME
        _write_json(path, finite(whole))
        return path

    def _is_intact(self, record: StepRecord) -> bool:
        for name, digest in zip(record.writes, record.digests, strict=True):
            file = self.folder / name
            if not file.is_file() or self.digest(file) != digest:
                return False
        return True

    def _drop_proof(self) -> None:
        """A proof of before would be about other files from here on."""
        (self.folder / PROOF_NAME).unlink(missing_ok=True)

    def _save(self) -> None:
        done = {step.name for step in self.steps}
        # Later steps of an earlier run stay, should this one stop before it gets to them.
        later = [step for name, step in self._before.items() if name not in done]
        rows = [{**step.as_json(), "seconds": step.seconds, **_rest(step)} for step in self.steps]
        rows += [{**step.as_json(), "seconds": step.seconds, **_rest(step)} for step in later]
        _write_json(self.folder / JOURNAL_NAME, rows)


def _rest(step: StepRecord) -> dict[str, Any]:
    return {"key": step.key, "digests": list(step.digests), "facts": dict(step.facts)}


def _read_journal(path: Path) -> dict[str, StepRecord]:
    try:
        rows = json.loads(path.read_text("utf-8"))
        records = [
            StepRecord(
                name=row["name"],
                title=row["title"],
                command=row["command"],
                key=row["key"],
                seconds=float(row["seconds"]),
                reads=tuple(row["reads"]),
                writes=tuple(row["writes"]),
                digests=tuple(row["digests"]),
                notes=tuple(row["notes"]),
                facts=row["facts"],
            )
            for row in rows
        ]
    except (ValueError, KeyError, TypeError):
        raise LayerError(
            f"{path}: is damaged, so nothing can be kept; delete the folder and prove again"
        ) from None
    return {record.name: record for record in records}


def _remove(path: Path) -> None:
    if path.is_dir() and not path.is_symlink():
        shutil.rmtree(path)
    else:
        path.unlink(missing_ok=True)


def _write_json(path: Path, content: Any) -> None:
    text = json.dumps(content, indent=1, sort_keys=True, ensure_ascii=False, allow_nan=False)
    with replacing(path) as temporary:
        Path(temporary).write_text(text + "\n", "utf-8")


def finite(value: Any) -> Any:
    """Return a value with numbers that JSON has not as null."""
    if isinstance(value, float):
        return value if math.isfinite(value) else None
    if isinstance(value, Mapping):
        return {str(key): finite(item) for key, item in value.items()}
    if isinstance(value, list | tuple):
        return [finite(item) for item in value]
    return value
