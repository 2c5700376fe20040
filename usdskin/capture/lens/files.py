"""Read a lens from a file of OpenCV's, Hugin's or Lensfun's."""

from __future__ import annotations

from dataclasses import dataclass, field
from pathlib import Path

from usdskin.capture.lens.curve import FileLens, represent
from usdskin.capture.lens.hugin import read_hugin
from usdskin.capture.lens.lensfun import LensfunChoice, read_lensfun
from usdskin.capture.lens.opencv import read_opencv
from usdskin.errors import UsageError, UsdSkinError
from usdskin.notes import Note
from usdskin.prims.lenses import FisheyeLens


@dataclass(frozen=True, slots=True)
class ImportOptions:
    """What a file may leave open; all but the largest angle are refused where it does not."""

    max_angle_deg: float | None = None
    """Largest angle from the axis that holds picture [deg]."""

    model: str | None = None
    """``fisheye`` or ``omnidir``, for a file of OpenCV's that does not say it."""

    choice: LensfunChoice = field(default_factory=LensfunChoice)
    """Lens and pictures; for Hugin ``lens`` is the number of an image."""


def read_lens_file(path: Path, options: ImportOptions, notes: list[Note]) -> FisheyeLens:
    """Return the lens of a file.

    Args:
        path: ``.pto``, Lensfun's ``.xml``, or OpenCV's ``.yml``, ``.yaml``, ``.xml``, ``.json``.
        options: What the file leaves open.
        notes: Takes what was assumed or left out, and how far the lens is from the file's.

    Raises:
        UsageError: An option is missing, has no effect, or cannot be met.
        UsdSkinError: The file cannot be read, or its lens cannot be held.
        LayerError: The lens does not hold up to its largest angle.
    """
    if not path.is_file():
        raise UsdSkinError(f"{path}: no such file; check the name and the folder")
    return represent(_read(path, options, notes), options.max_angle_deg, notes)


def _read(path: Path, options: ImportOptions, notes: list[Note]) -> FileLens:
    suffix, choice = path.suffix.lower(), options.choice
    if suffix == ".pto":
        _refuse(path, "a Hugin project", options, "lens")
        if choice.lens is not None and not choice.lens.isdecimal():
            raise UsageError(f"--lens {choice.lens}: give the number of an image of {path}")
        return read_hugin(path, None if choice.lens is None else int(choice.lens))
    if suffix == ".xml" and b"<lensdatabase" in path.read_bytes()[:65536]:
        _refuse(
            path,
            "Lensfun",
            options,
            "lens",
            "resolution",
            "crop_factor",
            "focal_length_mm",
            "f_number",
        )
        return read_lensfun(path, choice, notes)
    if suffix in (".yml", ".yaml", ".xml", ".json"):
        _refuse(path, "OpenCV", options, "resolution", "model")
        return read_opencv(path, options.model, choice.resolution)
    raise UsageError(
        f"--from {path}: cannot read this kind of file; give Hugin's .pto, Lensfun's .xml or "
        "OpenCV's .yml, .yaml, .xml or .json"
    )


def _refuse(path: Path, kind: str, options: ImportOptions, *used: str) -> None:
    """Refuse options that a kind of file has no use for."""
    named = {
        "lens": options.choice.lens,
        "resolution": options.choice.resolution,
        "crop_factor": options.choice.crop_factor,
        "focal_length_mm": options.choice.focal_length_mm,
        "f_number": options.choice.f_number,
        "model": options.model,
    }
    for name, value in named.items():
        if value is not None and name not in used:
            flag = name.removesuffix("_mm").replace("_", "-")
            raise UsageError(f"--{flag} has no effect on {path}, a file of {kind}; leave it out")
