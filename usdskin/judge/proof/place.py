"""Where everything of a proof lies: the folder's layout, and the command lines that fill it."""

from __future__ import annotations

import os
import shlex
from dataclasses import dataclass
from pathlib import Path


@dataclass(frozen=True, slots=True)
class Place:
    """The files of one proof."""

    folder: Path
    """The proof's folder."""

    def __getitem__(self, name: str) -> Path:
        """Return a file or folder by its name from the proof's folder."""
        return self.folder / name

    @property
    def truth_light(self) -> Path:
        """The true light."""
        return self["truth/light.usda"]

    @property
    def truth_skin(self) -> Path:
        """The true skin."""
        return self["truth/skin.usda"]

    def room(self, light_class: str = "") -> Path:
        """Return the folder of the photographs of the place, in the light of one class or all."""
        return self[f"shoot/room{_of(light_class)}"]

    def shoot(self, light_class: str = "") -> Path:
        """Return the layer of these photographs."""
        return self[f"shoot/shoot{_of(light_class)}.usda"]

    def capture(self, light_class: str = "") -> Path:
        """Return the capture that is made of them."""
        return self[f"captures/{light_class}/capture.usda" if light_class else "capture.usda"]

    def chart(self, light_class: str) -> Path:
        """Return the layer of a chart."""
        return self[f"shoot/chart_{light_class}/chart.usda"]

    def truth_class(self, light_class: str) -> Path:
        """Return the true light of one class."""
        return self[f"truth/light_{light_class}.usda"]

    def shot(self, name: str) -> Path:
        """Return a shot."""
        return self[f"shots/{name}.usda"]

    def render(self, name: str, integrator: str) -> Path:
        """Return a picture."""
        return self[f"renders/{name}_{integrator}.exr"]

    def command(self, *words: str | Path | float | None) -> str:
        """Return a command line to be run in the proof's folder; paths are relative to it."""
        parts = ["usdskin"]
        for word in words:
            if word is None:
                continue
            if isinstance(word, Path):
                parts.append(self.name_of(word))
            else:
                parts.append(f"{word:g}" if isinstance(word, float) else word)
        return shlex.join(parts)

    def name_of(self, path: Path) -> str:
        """Return a path as it is named from the proof's folder."""
        return Path(os.path.relpath(path.resolve(), self.folder.resolve())).as_posix()


def _of(light_class: str) -> str:
    return f"_{light_class}" if light_class else ""
