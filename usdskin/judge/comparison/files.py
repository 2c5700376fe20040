"""What there is to compare in a picture: the files that belong together, and what their parts say.

Reads: ``X.exr`` (beauty first, data parts beside it) with its sibling ``X.spectral.exr``, or either
alone; of other makers any EXR with R, G, B or spectral channels.
"""

from __future__ import annotations

from collections.abc import Mapping
from contextlib import AbstractContextManager
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from usdskin.colorimetry import color_space_names, rgb_to_xyz
from usdskin.errors import ImageError
from usdskin.image_files import ImageHeader
from usdskin.images import RowReader, open_rows, read_headers, read_image
from usdskin.spectral_layout import spectral_channels

FloatArray = NDArray[np.float64]

SPECTRAL_SUFFIX = ".spectral.exr"
_RGB = ("R", "G", "B")
_MOST_MB = 2**15  # of a file that is read a block at a time
_CHECKED_ROWS, _CHECKED_BLOCKS = 16, 16
_HALF, _LEAST_HALF = 2e-3, 1e-6  # what half floats round away


@dataclass(frozen=True, slots=True)
class PictureFile:
    """One EXR file and the headers of its parts."""

    path: Path
    parts: tuple[ImageHeader, ...]

    def part(self, name: str) -> int | None:
        """Return the index of a part by its name, or of the part that has a layer of that name."""
        for index, header in enumerate(self.parts):
            if header.name == name:
                return index
        for index, header in enumerate(self.parts):
            if any(channel.split(".")[0] == name for channel in header.channel_names):
                return index
        return None

    @property
    def spectral_part(self) -> int | None:
        """Index of the first part with spectra."""
        for index, header in enumerate(self.parts):
            if spectral_channels(header.channel_names):
                return index
        return None

    @property
    def color_part(self) -> int | None:
        """Index of the first part with R, G and B."""
        for index, header in enumerate(self.parts):
            if set(_RGB) <= set(header.channel_names):
                return index
        return None


@dataclass(frozen=True, slots=True)
class ComparedPicture:
    """The files of one picture."""

    path: Path
    """As it was named."""

    beauty: PictureFile | None
    """File with colours and data parts."""

    spectral: PictureFile | None
    """File with spectra."""

    @property
    def stem(self) -> str:
        """Its name without ``.spectral`` and suffix."""
        return self.path.name.removesuffix(".exr").removesuffix(".spectral")

    @property
    def headers(self) -> ImageHeader:
        """Header of the part that is compared."""
        file = self.spectral or self.beauty
        assert file is not None
        index = file.spectral_part if self.spectral is not None else file.color_part
        return file.parts[index or 0]

    @property
    def size(self) -> tuple[int, int]:
        """Width and height [px]."""
        return self.headers.width, self.headers.height

    @property
    def observer(self) -> str | None:
        """Observer its colours were made for, as its maker noted."""
        for file in (self.beauty, self.spectral):
            if file is not None and "usdskin/observer" in file.parts[0].attributes:
                return str(file.parts[0].attributes["usdskin/observer"])
        return None

    @property
    def units(self) -> str | None:
        """``absolute`` or ``relative``, as its maker noted."""
        for file in (self.spectral, self.beauty):
            if file is None:
                continue
            attributes = file.parts[0].attributes
            said = attributes.get("usdskin/units") or attributes.get("emissiveUnits")
            if said:
                return "absolute" if str(said).startswith("W") else "relative"
        return None

    @property
    def wavelength_nm(self) -> FloatArray:
        """Band centres [nm], shape [band_count]."""
        assert self.spectral is not None
        header = self.spectral.parts[self.spectral.spectral_part or 0]
        return np.array([nm for nm, _ in spectral_channels(header.channel_names)])

    def data(self, name: str) -> tuple[PictureFile, int] | None:
        """Return the file and part that holds a data part, if any."""
        if self.beauty is None:
            return None
        index = self.beauty.part(name)
        return None if index is None else (self.beauty, index)


def open_picture(path: Path) -> ComparedPicture:
    """Return the files of a picture, and check that there is something to compare.

    Args:
        path: ``X.exr`` or ``X.spectral.exr``; the other of the two is taken too where it is there.

    Raises:
        ImageError: The file is missing or broken, or has neither colours nor spectra.
    """
    named = PictureFile(path, read_headers(path))
    if named.spectral_part is None and named.color_part is None:
        found = ", ".join(named.parts[0].channel_names[:8]) if named.parts else "none"
        raise ImageError(
            f"{path}: nothing to compare; a picture has channels R, G, B or spectral ones such as "
            f"S0.550,000000nm, this one has {found}."
        )
    if named.spectral_part is not None:
        name = path.name.removesuffix(SPECTRAL_SUFFIX) + ".exr"
        other = path.with_name(name)
        beside = other.is_file() and other != path and path.name.endswith(SPECTRAL_SUFFIX)
        beauty = PictureFile(other, read_headers(other)) if beside else named
        return _checked(ComparedPicture(path, beauty, named))
    other = path.with_name(path.name.removesuffix(".exr") + SPECTRAL_SUFFIX)
    spectral = None
    if other.is_file():
        spectral = PictureFile(other, read_headers(other))
        if spectral.spectral_part is None:
            raise ImageError(f"{other}: no spectral channels; write it anew or remove it.")
    return _checked(ComparedPicture(path, named, spectral))


def _checked(picture: ComparedPicture) -> ComparedPicture:
    """Return the picture if its files fit together and its spectra are radiances of some bands."""
    if picture.spectral is not None:
        header = picture.spectral.parts[picture.spectral.spectral_part or 0]
        bands = spectral_channels(header.channel_names)
        if bands[0][1].startswith("T."):
            raise ImageError(
                f"{picture.spectral.path}: reflectances (channels T.), not radiances (S0.); light "
                "them, that is render with them, and compare the pictures."
            )
        if len(bands) < 2:
            raise ImageError(
                f"{picture.spectral.path}: one band is no spectrum; render with more wavelengths."
            )
    sizes = {
        (file.path.name, part.width, part.height)
        for file in (picture.beauty, picture.spectral)
        if file is not None
        for part in file.parts
    }
    if len({size[1:] for size in sizes}) > 1:
        said = ", ".join(f"{name} {width} x {height}" for name, width, height in sorted(sizes))
        raise ImageError(f"{picture.path}: its files differ in size ({said}); render them anew.")
    _check_same_render(picture)
    return picture


def _check_same_render(picture: ComparedPicture) -> None:
    """Refuse spectra beside a picture of another render, whose preview is not that picture.

    A render without ``--spectral`` leaves the spectra of the one before where they are.
    """
    beauty, spectral = picture.beauty, picture.spectral
    if beauty is None or spectral is None or beauty.path == spectral.path:
        return
    parts = [file.parts[file.color_part or 0] for file in (beauty, spectral)]
    if beauty.color_part is None or spectral.color_part is None:
        return
    if any("usdskin/version" not in part.attributes for part in parts):
        return
    height = parts[0].height
    with (
        open_rows(beauty.path, _MOST_MB, part=beauty.color_part, channels=_RGB) as colors,
        open_rows(spectral.path, _MOST_MB, part=spectral.color_part, channels=_RGB) as preview,
    ):
        for begin in range(0, height, max(_CHECKED_ROWS, height // _CHECKED_BLOCKS)):
            end = min(begin + _CHECKED_ROWS, height)
            pair = [reader.rows(begin, end).astype(np.float64) for reader in (colors, preview)]
            here, there = (np.where(np.isfinite(values), values, 0.0) for values in pair)
            largest = np.maximum(np.abs(here), np.abs(there)).max(axis=-1, keepdims=True)
            if (np.abs(here - there) > _HALF * largest + _LEAST_HALF).any():
                raise ImageError(
                    f"{spectral.path}: is of another render than {beauty.path.name} beside it; "
                    "render both again with --spectral, or remove the one that is out of date."
                )


def color_space_of(file: PictureFile, index: int) -> str:
    """Return the linear RGB space of a part; Rec. 709 where it says none.

    Raises:
        ImageError: It names a space that is not known here.
    """
    name = file.parts[index].color_space or "lin_rec709_scene"  # OpenEXR's default
    if name not in color_space_names() or not name.startswith("lin_"):
        raise ImageError(
            f"{file.path}: colours in {name!r} cannot be compared; write it in a linear space such "
            "as lin_rec709_scene."
        )
    return name


def read_colors(picture: ComparedPicture) -> FloatArray:
    """Return the tristimulus values of a beauty, its exposure divided out.

    Returns:
        XYZ [cd m^-2, or relative], shape [height, width, 3].
    """
    file = picture.beauty
    assert file is not None and file.color_part is not None
    index = file.color_part
    pixels = read_image(file.path, part=index, channels=_RGB).pixels.astype(np.float64)
    scale = exposure_scale(file, index)
    return np.asarray(pixels @ (rgb_to_xyz(color_space_of(file, index)).T / scale))


def exposure_scale(file: PictureFile, index: int) -> float:
    """Return the factor that a beauty's camera applied, 1 where the header tells none."""
    return stated_exposure_scale(file.path, file.parts[index].attributes)


def stated_exposure_scale(path: Path, header: Mapping[str, Any]) -> float:
    """Return the factor that a beauty's header tells, 1 where it tells none.

    Raises:
        ImageError: It is no positive number.
    """
    said = header.get("usdskin/exposureScale", "1")
    try:
        scale = float(said)
    except ValueError:
        scale = np.nan
    if not 0.0 < scale < np.inf:
        raise ImageError(f"{path}: usdskin/exposureScale is {said!r}; it must be positive.")
    return scale


def read_alpha(picture: ComparedPicture) -> NDArray[np.float32] | None:
    """Return the coverage of each pixel where the picture has one, shape [height, width]."""
    for file in (picture.beauty, picture.spectral):
        if file is None:
            continue
        for index, header in enumerate(file.parts):
            if {*_RGB, "A"} <= set(header.channel_names) and header.name in ("", "beauty"):
                return read_image(file.path, part=index, channels=("A",)).pixels[..., 0]
    return None


def read_irradiance(picture: ComparedPicture) -> FloatArray | None:
    """Return the XYZ of the irradiance at each pixel's middle, where the picture has it.

    Returns:
        XYZ [lx, or relative], shape [height, width, 3].
    """
    found = picture.data("irradiance")
    if found is None:
        return None
    file, index = found
    header = file.parts[index]
    names = [name for name in header.channel_names if name.startswith("irradiance.")]
    wanted = [f"irradiance.{c}" for c in "RGB"]
    if not set(wanted) <= set(names):
        raise ImageError(f"{file.path}: its part irradiance lacks one of {', '.join(wanted)}.")
    pixels = read_image(file.path, part=index, channels=wanted).pixels.astype(np.float64)
    return np.asarray(pixels @ rgb_to_xyz(color_space_of(file, index)).T)


def spectral_rows(picture: ComparedPicture) -> AbstractContextManager[RowReader]:
    """Return a context in which rows of a picture's spectra are read, bands ascending."""
    assert picture.spectral is not None
    index = picture.spectral.spectral_part or 0
    names = [name for _, name in spectral_channels(picture.spectral.parts[index].channel_names)]
    return open_rows(picture.spectral.path, _MOST_MB, part=index, channels=names)
