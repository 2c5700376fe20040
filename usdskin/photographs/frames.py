"""Photographs as rows of raw values, read in order in the memory of one block.

Reads: TIFF, PNG, JPEG and EXR through ``usdskin.images``; raw files through rawpy (LibRaw), an
optional extra. A raw file is demosaiced linearly, so that a saturated photosite spoils the pixels
beside it and no others, and keeps the camera's own values: no white balance, no colour matrix, no
curve, no scaling, black level left in.
"""

from __future__ import annotations

import tempfile
from contextlib import ExitStack
from dataclasses import dataclass, field
from pathlib import Path
from types import TracebackType
from typing import IO, Any

import numpy as np
from numpy.typing import NDArray

from usdskin.errors import ImageError, UsageError
from usdskin.images import RowReader, open_rows, read_headers

RAW_SUFFIXES = frozenset(
    ".3fr .arw .cr2 .cr3 .crw .dcr .dng .erf .fff .gpr .iiq .kdc .mef .mos .mrw .nef .nrw .orf "
    ".pef .raf .raw .rw2 .rwl .sr2 .srf .srw .x3f".split()
)
"""Endings of the names of raw files, in lower case."""

_FULL_SCALE = {"uint8": 255.0, "uint16": 65535.0}


@dataclass(slots=True, eq=False)
class Frame:
    """One opened photograph; a context manager that closes it."""

    path: Path
    """The file."""

    width: int
    """Columns [px]."""

    height: int
    """Rows [px]."""

    sample_type: str
    """``uint8``, ``uint16``, ``raw``, or what the file holds as numbers of other kinds: ``half``,
    ``float``, ..."""

    full_scale: float
    """Largest raw value [DN]: 255, 65535, the white level a raw file states, else 1."""

    black_level: NDArray[np.float64] | None
    """Raw value without light that a raw file states [DN], shape [3]; None for other files."""

    _source: _FileRows | _ScratchRows
    _open: ExitStack = field(default_factory=ExitStack)

    @property
    def is_integer(self) -> bool:
        """Whether raw values are whole numbers."""
        return self.sample_type in ("uint8", "uint16", "raw")

    @property
    def kind(self) -> str:
        """What the photographs of one bracket must agree in, in words."""
        kinds = {"uint8": "8-bit", "uint16": "16-bit", "raw": "raw"}
        return kinds.get(self.sample_type, "floating-point")

    def rows(self, begin: int, end: int) -> NDArray[np.float32]:
        """Return rows of raw values [DN], shape [end - begin, width, 3].

        Reading forward, even in leaps, is what files are good at; going back starts over.

        Raises:
            ImageError: The file is broken, or holds values that are no numbers.
        """
        block = self._source.rows(begin, end)
        block = block.astype(np.float32, copy=False)
        if not self.is_integer:
            self._refuse_non_finite(block, begin)
        return np.repeat(block, 3, axis=2) if block.shape[2] == 1 else block

    def _refuse_non_finite(self, block: NDArray[np.float32], begin: int) -> None:
        finite = np.isfinite(block)
        if not finite.all():
            y, x, channel = (int(index) for index in np.argwhere(~finite)[0])
            raise ImageError(
                f"{self.path}: the pixel at x {x}, y {begin + y} is {block[y, x, channel]}; export "
                "the photograph again with finite values"
            )

    def close(self) -> None:
        """Close the file and forget what was decoded."""
        self._open.close()

    def __enter__(self) -> Frame:
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        traceback: TracebackType | None,
    ) -> None:
        self.close()


@dataclass(slots=True, eq=False)
class _FileRows:
    """Rows of a picture file, still open."""

    reader: RowReader

    def rows(self, begin: int, end: int) -> NDArray[Any]:
        return self.reader.rows(begin, end)


@dataclass(slots=True, eq=False)
class _ScratchRows:
    """Rows of a decoded raw file, kept on disk."""

    file: IO[bytes]
    width: int

    def rows(self, begin: int, end: int) -> NDArray[Any]:
        row_bytes = self.width * 3 * 2
        self.file.seek(begin * row_bytes)
        held = self.file.read((end - begin) * row_bytes)
        return np.frombuffer(held, np.uint16).reshape(end - begin, self.width, 3)


def open_frame(path: str | Path, scratch: Path, max_mb: int = 2048) -> Frame:
    """Open one photograph.

    Args:
        path: The file. A raw file is known by the ending of its name.
        scratch: Folder that a raw file is decoded into; what is there goes when the frame is
            closed.
        max_mb: Refuse photographs that need more memory than this as float32 [MiB].

    Raises:
        ImageError: The file is missing, broken, too large, or neither grey nor RGB.
        UsageError: The file is raw, and the extra that reads such files is not installed.
    """
    path = Path(path)
    if path.suffix.lower() in RAW_SUFFIXES:
        return _open_raw(path, scratch, max_mb)
    with ExitStack() as stack:
        channels = _color_channels(path, read_headers(path)[0].channel_names)
        reader = stack.enter_context(open_rows(path, max_mb, channels=channels, as_stored=True))
        return Frame(
            path=path,
            width=reader.header.width,
            height=reader.header.height,
            sample_type=reader.sample_type,
            full_scale=_FULL_SCALE.get(reader.sample_type, 1.0),
            black_level=None,
            _source=_FileRows(reader),
            _open=stack.pop_all(),
        )


def _color_channels(path: Path, names: tuple[str, ...]) -> tuple[str, ...]:
    if {"R", "G", "B"} <= set(names):
        return ("R", "G", "B")
    gray = tuple(name for name in names if name != "A")
    if len(gray) == 1:
        return gray
    raise ImageError(
        f"{path}: has the channels {', '.join(names[:8])}; a photograph is grey or has R, G and B: "
        "export it so"
    )


def _open_raw(path: Path, scratch: Path, max_mb: int) -> Frame:
    try:
        import rawpy
    except ImportError:
        raise UsageError(
            f"{path}: raw photographs need rawpy; install it with `pip install 'usdskin[raw]'`, or "
            "export linear 16-bit TIFF files"
        ) from None
    if not path.is_file():
        raise ImageError(f"{path}: cannot read; no such file.")
    try:
        with rawpy.imread(str(path)) as raw:
            _refuse_large(path, raw.sizes.iwidth, raw.sizes.iheight, max_mb)
            pixels = raw.postprocess(
                demosaic_algorithm=rawpy.DemosaicAlgorithm.LINEAR,
                gamma=(1.0, 1.0),
                no_auto_bright=True,
                no_auto_scale=True,
                adjust_maximum_thr=0.0,
                user_wb=[1.0, 1.0, 1.0, 1.0],
                output_color=rawpy.ColorSpace.raw,
                output_bps=16,
                user_flip=0,
                # Values below black are noise like those above: subtracting here would cut them.
                user_black=0,
                user_cblack=[0, 0, 0, 0],
            )
            black = np.asarray(raw.black_level_per_channel, dtype=np.float64)
            white = [raw.white_level, *(raw.camera_white_level_per_channel or ())]
    except rawpy.LibRawError as error:
        said = error.args[0] if error.args else "it is broken"
        said = said.decode(errors="replace") if isinstance(said, bytes) else str(said)
        raise ImageError(f"{path}: cannot read; {said}; restore a good copy.") from None
    height, width = pixels.shape[:2]
    with ExitStack() as stack:
        file = stack.enter_context(tempfile.TemporaryFile(dir=scratch))
        pixels.tofile(file)
        return Frame(
            path=path,
            width=width,
            height=height,
            sample_type="raw",
            full_scale=float(min(level for level in white if level > 0)),
            black_level=np.array([black[0], (black[1] + black[3]) / 2.0, black[2]]),
            _source=_ScratchRows(file, width),
            _open=stack.pop_all(),
        )


def _refuse_large(path: Path, width: int, height: int, max_mb: int) -> None:
    need_mb = width * height * 3 * 4 / 2**20
    if need_mb > max_mb:
        raise ImageError(
            f"{path}: {width} x {height} pixels of 3 channels need {need_mb:.0f} MiB; the limit is "
            f"{max_mb} MiB."
        )
