"""The colour difference between a picture and the true one (DESIGN: "Colour difference").

Reads: two pictures of ``comparison_files``. Tristimulus values are divided by Y_n of a perfect
diffuser at the truth's brightest irradiance and seen against that diffuser's chromaticity, the
white of L*a*b*, which is where both are adapted to. A difference of scale counts.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, get_args

import numpy as np
from numpy.typing import NDArray

from usdskin.colorimetry import (
    DEFAULT_OBSERVER,
    Observer,
    cat16,
    delta_e_2000,
    white_xyz,
    xyz_to_lab,
    xyz_to_rgb,
)
from usdskin.errors import ImageError, UsageError
from usdskin.judge.comparison.files import (
    ComparedPicture,
    open_picture,
    read_colors,
)
from usdskin.judge.comparison.flip import PIXELS_PER_DEGREE, flip_differences
from usdskin.judge.comparison.masks import (
    ID_PARTS,
    Labels,
    bright_pixels,
    check_mask,
    judged_pixels,
    read_labels,
)
from usdskin.judge.comparison.spectra import SpectralPair, compare_spectra
from usdskin.judge.comparison.white import diffuser_white, note_bright
from usdskin.notes import Note

FloatArray = NDArray[np.float64]
Mask = NDArray[np.bool_]

MOST_PIXELS_PER_DEGREE = 500.0
"""Beyond it FLIP's filters would be wider than most pictures; the eye resolves 60."""

_DISPLAY = "lin_rec709_scene"


@dataclass(frozen=True, slots=True)
class CompareOptions:
    """How two pictures are compared."""

    masks: tuple[str, ...] = ()
    """Rules that all hold in the mask: ``alpha``, ``all``, ``luminance:SHARE`` of Y_n in the truth,
    or a file. Without ``all`` or a file ``alpha`` holds, where the pictures have it."""

    select: tuple[str, ...] = ()
    """Prims and materials to judge, by path or pattern; all where none is given."""

    regions: str | None = None
    """Part that divides the mask: one of ``ID_PARTS``; ``none``; primId where it is there."""

    observer: Observer | None = None
    """Whose colour-matching functions; the truth's own by default."""

    diffuser: tuple[float, float, float] | None = None
    """XYZ of the perfect diffuser at the brightest irradiance, in place of the truth's AOV."""

    pixels_per_degree: float = PIXELS_PER_DEGREE
    """Viewing condition of FLIP."""


@dataclass(frozen=True, slots=True, eq=False)
class Comparison:
    """How far a picture is from the truth; maps are NaN outside the mask."""

    truth: Path
    picture: Path
    observer: str
    diffuser_xyz: FloatArray
    """XYZ of the perfect diffuser [cd m^-2, or relative], shape [3]."""

    white_from: str
    """Where it comes from, in words."""

    mask: Mask
    """Pixels that are judged, shape [height, width]."""

    mask_from: str
    """How they were chosen, in words."""

    maps: Mapping[str, FloatArray]
    """dE2000, dE76, dL, da, db, flip, and with spectra gfc and rmse, shape [height, width]."""

    spectral: Mapping[str, Any] | None
    """Spectral figures, where both pictures have spectra."""

    pixels_per_degree: float
    """Viewing condition of FLIP."""

    regions: Sequence[Mapping[str, Any]] = ()
    """Statistics by region."""

    regions_from: str | None = None
    """Part that told the regions."""

    stem: str = ""
    """The judged picture's name without suffixes."""

    notes: list[Note] = field(default_factory=list)
    """What the reader of the figures should know."""

    @property
    def white(self) -> tuple[float, float]:
        """Chromaticity x, y of the perfect diffuser."""
        x, y, _ = self.diffuser_xyz / self.diffuser_xyz.sum()
        return float(x), float(y)

    def statistics(self, name: str) -> dict[str, float]:
        """Return mean, median, p95 and max of a map within the mask."""
        return _statistics(self.maps[name][self.mask])

    def as_json(self) -> dict[str, Any]:
        """Return every figure, for programs."""
        signed = {}
        for key, name in (("deltaL", "dL"), ("deltaA", "da"), ("deltaB", "db")):
            values = self.maps[name][self.mask]
            signed[key] = {
                "mean": float(values.mean()),
                "rms": float(np.sqrt((values**2).mean())),
            }
        return {
            "truth": str(self.truth),
            "picture": str(self.picture),
            "observer": self.observer,
            "yN": float(self.diffuser_xyz[1]),
            "white": list(self.white),
            "whiteFrom": self.white_from,
            "mask": {
                "from": self.mask_from,
                "pixels": int(self.mask.sum()),
                "share": float(self.mask.mean()),
            },
            "deltaE2000": self.statistics("dE2000"),
            "deltaE76": self.statistics("dE76"),
            **signed,
            "spectral": None if self.spectral is None else dict(self.spectral),
            "flip": {**self.statistics("flip"), "pixelsPerDegree": self.pixels_per_degree},
            "regionsFrom": self.regions_from,
            "regions": [dict(region) for region in self.regions],
        }


def compare_pictures(
    truth: str | Path, picture: str | Path, options: CompareOptions | None = None
) -> Comparison:
    """Compare a picture with the truth.

    Args:
        truth: ``X.exr`` or ``X.spectral.exr``; the other is taken too where it is there.
        picture: What is judged, of the same size.
        options: Mask, regions, observer and white.

    Raises:
        ImageError: A file is missing or broken, sizes or units differ, pixels within the mask are
            not finite, or the mask is empty.
        UsageError: The observer or the white cannot be had from these files.
    """
    given = options or CompareOptions()
    if not 1.0 <= given.pixels_per_degree <= MOST_PIXELS_PER_DEGREE:
        raise UsageError(
            f"--ppd {given.pixels_per_degree:g}: a display has 1 to {MOST_PIXELS_PER_DEGREE:g} "
            "pixels per degree."
        )
    notes: list[Note] = []
    first, second = open_picture(Path(truth)), open_picture(Path(picture))
    if first.size != second.size:
        raise ImageError(
            f"{second.path}: {second.size[0]} x {second.size[1]} pixels, but {first.path} has "
            f"{first.size[0]} x {first.size[1]}; render both at one size."
        )
    absolute = _absolute(first, second, notes)
    observer = _observer(first, second, given)
    pair, colors = _colors(first, second, observer, absolute)
    if pair is not None and pair.resampled:
        notes.append(
            Note("grids-differ", str(second.path), f"spectra were brought to {pair.grid}.")
        )
    mask, mask_from = judged_pixels(first, second, given.masks, given.select, notes)
    check_mask(mask, mask_from, first)
    diffuser, white_from = diffuser_white(first, mask, observer, given.diffuser)
    luminance = colors[0][..., 1] / diffuser[1]
    mask, mask_from = bright_pixels(mask, mask_from, luminance, given.masks)
    check_mask(mask, mask_from, first)
    for xyz, of in zip(colors, (first, second), strict=True):
        _check_finite(xyz, mask, of)
    note_bright(luminance[mask], first, notes)
    maps = _difference_maps(colors, diffuser, mask, given.pixels_per_degree)
    spectral = None
    if pair is not None:
        spectral = _spectral_figures(pair, mask, first)
        maps["gfc"] = np.where(mask, pair.fit, np.nan)
        maps["rmse"] = np.where(mask, np.sqrt(pair.squared_error) / spectral["peak"], np.nan)
    labels, regions_from = _labels(first, given)
    return Comparison(
        truth=first.path,
        picture=second.path,
        observer=observer,
        diffuser_xyz=diffuser,
        white_from=white_from,
        mask=mask,
        mask_from=mask_from,
        maps=maps,
        spectral=spectral,
        pixels_per_degree=given.pixels_per_degree,
        regions=_region_figures(labels, mask, maps),
        regions_from=regions_from,
        stem=second.stem,
        notes=notes,
    )


# --- What the colours are ------------------------------------------------------------------------


def _absolute(first: ComparedPicture, second: ComparedPicture, notes: list[Note]) -> bool:
    units = (first.units, second.units)
    if None not in units and units[0] != units[1]:
        raise ImageError(
            f"{second.path}: radiance in {units[1]} units, but in {first.path} in {units[0]} ones; "
            "give the light of both the same units."
        )
    if None in units:
        silent = first if first.units is None else second
        notes.append(
            Note(
                "units-unknown",
                str(silent.path),
                "its header tells no units; taken to be those of the other picture.",
            )
        )
    return (units[0] or units[1] or "relative") == "absolute"


def _observer(first: ComparedPicture, second: ComparedPicture, given: CompareOptions) -> Observer:
    made = first.observer or DEFAULT_OBSERVER
    observer = given.observer or made
    if observer not in get_args(Observer):
        raise UsageError(f"--observer {observer}: choose one of {', '.join(get_args(Observer))}.")
    if first.spectral is None or second.spectral is None:
        for picture in (first, second):
            own = picture.observer or DEFAULT_OBSERVER
            if own != observer:
                raise UsageError(
                    f"--observer {observer}: the colours of {picture.path} are of {own}, and "
                    "without spectra in both pictures they cannot be another's; render with "
                    "--spectral."
                )
    return observer  # type: ignore[return-value]


def _colors(
    first: ComparedPicture, second: ComparedPicture, observer: Observer, absolute: bool
) -> tuple[SpectralPair | None, tuple[FloatArray, FloatArray]]:
    if first.spectral is not None and second.spectral is not None:
        pair = compare_spectra(first, second, observer, absolute)
        return pair, (pair.truth_xyz, pair.picture_xyz)
    for picture in (first, second):
        if picture.beauty is None or picture.beauty.color_part is None:
            raise ImageError(
                f"{picture.path}: it has spectra alone and the other picture has none; compare two "
                "of one kind."
            )
    return None, (read_colors(first), read_colors(second))


def _check_finite(xyz: FloatArray, mask: Mask, picture: ComparedPicture) -> None:
    bad = mask & ~np.isfinite(xyz).all(axis=-1)
    if bad.any():
        row, column = np.argwhere(bad)[0]
        raise ImageError(
            f"{picture.path}: {int(bad.sum())} pixels within the mask are not finite, the first at "
            f"column {column}, row {row}; render it anew, or mask them out."
        )


# --- Figures -------------------------------------------------------------------------------------


def _difference_maps(
    colors: tuple[FloatArray, FloatArray], diffuser: FloatArray, mask: Mask, ppd: float
) -> dict[str, FloatArray]:
    truth, picture = (xyz_to_lab(xyz[mask], diffuser) for xyz in colors)
    difference = picture - truth
    values = {
        "dE2000": delta_e_2000(picture, truth),
        "dE76": np.sqrt((difference**2).sum(axis=-1)),
        "dL": difference[:, 0],
        "da": difference[:, 1],
        "db": difference[:, 2],
    }
    maps = {}
    for name, value in values.items():
        maps[name] = np.full(mask.shape, np.nan)
        maps[name][mask] = value
    seen = [displayed(xyz, diffuser, mask) for xyz in colors]
    maps["flip"] = np.where(mask, flip_differences(seen[1], seen[0], ppd), np.nan)
    return maps


def displayed(xyz: FloatArray, diffuser: FloatArray, mask: Mask) -> FloatArray:
    """Return how a picture is shown to FLIP: the diffuser is display white, all else black.

    Args:
        xyz: Tristimulus values, shape [height, width, 3].
        diffuser: XYZ of the perfect diffuser, which becomes the display's white, shape [3].
        mask: Pixels that are judged; the others are black, so that they do not count.

    Returns:
        Linear Rec. 709 from 0 to 1, adapted by CAT16, shape [height, width, 3].
    """
    adapted = xyz_to_rgb(_DISPLAY) @ cat16(diffuser / diffuser[1], white_xyz(_DISPLAY))
    rgb = np.zeros(xyz.shape)
    rgb[mask] = np.clip(xyz[mask] / diffuser[1] @ adapted.T, 0.0, 1.0)
    return rgb


def _statistics(values: FloatArray) -> dict[str, float]:
    return {
        "mean": float(values.mean()),
        "median": float(np.median(values)),
        "p95": float(np.percentile(values, 95.0)),
        "max": float(values.max()),
    }


def _spectral_figures(pair: SpectralPair, mask: Mask, truth: ComparedPicture) -> dict[str, Any]:
    peak = float(pair.peak[mask].max())
    error = pair.squared_error[mask]
    fit = pair.fit[mask]
    if not peak > 0.0:
        raise ImageError(f"{truth.path}: its spectra are black within the mask; choose another.")
    return {
        "rmse": float(np.sqrt(error.mean()) / peak),
        "peak": peak,
        "gfc": float(fit.mean()),
        "p05gfc": float(np.percentile(fit, 5.0)),
        "mingfc": float(fit.min()),
        "grid": pair.grid,
    }


def _labels(truth: ComparedPicture, given: CompareOptions) -> tuple[Labels | None, str | None]:
    if given.regions == "none":
        return None, None
    if given.regions is None:
        labels = read_labels(truth, "primId")
        return labels, "primId" if labels is not None else None
    if given.regions not in ID_PARTS:
        raise UsageError(f"--regions {given.regions}: choose one of {', '.join(ID_PARTS)}, none.")
    labels = read_labels(truth, given.regions)
    if labels is None:
        raise UsageError(
            f"--regions {given.regions}: {truth.path} has no such part; render it with --aov "
            f"{'primId' if given.regions == 'primId' else 'cryptomatte'}."
        )
    return labels, given.regions


def _region_figures(
    labels: Labels | None, mask: Mask, maps: Mapping[str, FloatArray]
) -> list[dict[str, Any]]:
    if labels is None:
        return []
    found = []
    for index, name in enumerate(labels.names):
        inside = mask & (labels.index == index)
        if inside.any():
            found.append(
                {
                    "name": name,
                    "pixels": int(inside.sum()),
                    "deltaE2000": _statistics(maps["dE2000"][inside]),
                }
            )
    return sorted(found, key=lambda region: (-region["pixels"], region["name"]))
