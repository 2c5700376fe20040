"""Find the corners of a calibration board in photographs, through OpenCV's detectors."""

from __future__ import annotations

import re
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from usdskin.errors import ImageError, UsageError
from usdskin.images import read_image

FloatArray = NDArray[np.float64]
Picture = NDArray[np.uint8]

_DEFAULT_DICTIONARY = "4x4_50"
_DEFAULT_MARKER = 0.75
"""Side of a marker over that of a square, where neither is given [1]."""

_LEAST_CORNERS = 8
_GRAMMAR = "charuco:7x5[,SQUARE,MARKER][,DICTIONARY] or chessboard:9x6"


@dataclass(frozen=True, slots=True)
class Board:
    """A flat board with corners at known places."""

    kind: str
    """``charuco`` or ``chessboard``."""

    columns: int
    """Squares of a ChArUco board, inner corners of a chessboard, along its rows."""

    rows: int
    """The same along its columns."""

    marker: float = _DEFAULT_MARKER
    """Side of a marker over that of a square [1]."""

    dictionary: str = _DEFAULT_DICTIONARY
    """Markers in use, as in ``cv2.aruco.DICT_4X4_50``."""


@dataclass(frozen=True, slots=True, eq=False)
class BoardView:
    """The corners found in one photograph."""

    path: Path
    """The photograph."""

    resolution: tuple[int, int]
    """Its width and height [px]."""

    board: FloatArray
    """Corners on the board [squares], shape [corner_count, 2]."""

    pixel: FloatArray
    """The same corners in the photograph [px], shape [corner_count, 2]."""

    @property
    def is_usable(self) -> bool:
        """Whether the corners determine where the board was."""
        return len(self.board) >= _LEAST_CORNERS and not _is_line(self.board)


def parse_board(text: str) -> Board:
    """Return the board that ``--board`` describes.

    Raises:
        UsageError: It describes none, or one whose markers the dictionary has not enough of.
    """
    match = re.fullmatch(r"(charuco|chessboard):(\d+)x(\d+)((?:,[\w.]+)*)", text.strip().lower())
    if match is None:
        raise UsageError(f"--board {text}: no board; write it as {_GRAMMAR}")
    kind, columns, rows = match[1], int(match[2]), int(match[3])
    if not (3 <= columns <= 100 and 3 <= rows <= 100):
        raise UsageError(f"--board {text}: a board has 3 to 100 columns and rows")
    further = match[4].split(",")[1:]
    numbers = [float(word) for word in further if re.fullmatch(r"\d+(\.\d*)?|\.\d+", word)]
    names = [word for word in further if re.search(r"[a-z_]", word)]
    fitting = (
        len(numbers) in (0, 2) and len(names) <= 1 and len(numbers) + len(names) == len(further)
    )
    if not fitting or (kind == "chessboard" and further):
        raise UsageError(f"--board {text}: does not read as {_GRAMMAR}; both lengths in one unit")
    if kind == "chessboard":
        return Board(kind, columns, rows)
    marker = numbers[1] / numbers[0] if numbers and numbers[0] > 0.0 else _DEFAULT_MARKER
    if numbers and not 0.1 <= numbers[1] / max(numbers[0], 1e-9) < 1.0:
        raise UsageError(
            f"--board {text}: a marker of {numbers[1]:g} does not fit a square of {numbers[0]:g}; "
            "give the sides of a square and of a marker, in this order"
        )
    dictionary = names[0].removeprefix("dict_") if names else _DEFAULT_DICTIONARY
    _check_dictionary(text, dictionary, columns * rows // 2)
    return Board(kind, columns, rows, marker, dictionary)


def _dictionaries() -> dict[str, int]:
    """Return the names of OpenCV's dictionaries of markers, in lower case, with their numbers."""
    import cv2

    names = [name for name in dir(cv2.aruco) if name.startswith("DICT_")]
    return {name[5:].lower(): int(getattr(cv2.aruco, name)) for name in names}


def _check_dictionary(text: str, name: str, marker_count: int) -> None:
    import cv2

    known = _dictionaries()
    if name not in known:
        raise UsageError(
            f"--board {text}: this OpenCV ({cv2.__version__}) has no dictionary {name!r}; it has "
            f"{', '.join(sorted(known))}"
        )
    size = len(cv2.aruco.getPredefinedDictionary(known[name]).bytesList)
    if size < marker_count:
        raise UsageError(
            f"--board {text}: needs {marker_count} markers and dictionary {name!r} has {size}; "
            "name the one the board was printed from"
        )


def find_board(path: Path, board: Board) -> BoardView:
    """Return the corners of a board that a photograph shows; there may be none.

    Pixels are taken as they are stored: a photograph's orientation tag is not applied, for the
    sensor does not turn with it.

    Raises:
        ImageError: The file cannot be read.
    """
    grey = _grey(path)
    places, pixels = (_charuco if board.kind == "charuco" else _chessboard)(grey, board)
    # OpenCV counts from the middle of the first pixel, we from its corner.
    return BoardView(path, (grey.shape[1], grey.shape[0]), places, pixels + 0.5)


def _is_line(points: FloatArray) -> bool:
    return float(np.linalg.svd(points - points.mean(axis=0))[1][1]) < 0.5


def _grey(path: Path) -> Picture:
    """Return a photograph in 8 bits for the detectors; linear data are brightened."""
    image = read_image(path)
    grey = image.pixels[:, :, : min(3, image.pixels.shape[2])].mean(axis=2)
    finite = np.isfinite(grey)
    if not finite.any():
        raise ImageError(f"{path}: holds no finite pixel; export it again")
    grey = np.where(finite, grey, 0.0)
    if image.sample_type != "uint8":
        white = float(np.percentile(grey[::4, ::4], 99.5))
        grey = np.sqrt(np.clip(grey / max(white, 1e-12), 0.0, 1.0))
    return np.asarray(np.rint(255.0 * np.clip(grey, 0.0, 1.0)), dtype=np.uint8)


def _charuco(grey: Picture, board: Board) -> tuple[FloatArray, FloatArray]:
    import cv2

    dictionary = cv2.aruco.getPredefinedDictionary(_dictionaries()[board.dictionary])
    best = np.zeros((0, 2)), np.zeros((0, 2))
    # Boards with an even number of rows printed before OpenCV 4.6 begin with a white square.
    for legacy in (False, True)[: 1 if board.rows % 2 else 2]:
        pattern = cv2.aruco.CharucoBoard((board.columns, board.rows), 1.0, board.marker, dictionary)
        pattern.setLegacyPattern(legacy)
        corners, ids, _, _ = cv2.aruco.CharucoDetector(pattern).detectBoard(grey)
        if ids is not None and len(ids) > len(best[0]):
            places = np.asarray(pattern.getChessboardCorners(), dtype=np.float64)
            best = places[np.ravel(ids), :2], np.asarray(corners, np.float64).reshape(-1, 2)
    # Detectors before OpenCV 5 return corners half a pixel off (its issue 25539).
    return best[0], _refined(grey, *best, 0.5 * (1.0 - board.marker))


def _chessboard(grey: Picture, board: Board) -> tuple[FloatArray, FloatArray]:
    import cv2

    flags = cv2.CALIB_CB_NORMALIZE_IMAGE | cv2.CALIB_CB_EXHAUSTIVE | cv2.CALIB_CB_ACCURACY
    found, corners = cv2.findChessboardCornersSB(grey, (board.columns, board.rows), flags=flags)
    if not found:
        return np.zeros((0, 2)), np.zeros((0, 2))
    row, column = np.divmod(np.arange(board.columns * board.rows), board.columns)
    places = np.column_stack([column, row]).astype(np.float64)
    # It errs by up to 1 px where the lens bends the board.
    return places, _refined(grey, places, np.asarray(corners, np.float64).reshape(-1, 2), 0.3)


def _refined(grey: Picture, places: FloatArray, pixels: FloatArray, reach: float) -> FloatArray:
    """Return corners at the saddle points of the picture.

    Args:
        grey: The photograph.
        places: Corners on the board [squares].
        pixels: The corners, from the middle of the first pixel [px].
        reach: Half of the side of the window to look at, in squares where the board is seen the
            most foreshortened.
    """
    import cv2

    criteria = (cv2.TERM_CRITERIA_COUNT + cv2.TERM_CRITERIA_EPS, 100, 1e-4)
    refined = pixels.copy()
    for index, pixel in enumerate(pixels):
        steps = np.linalg.norm(places - places[index], axis=1)
        lengths = np.linalg.norm(pixels - pixel, axis=1)
        near = (steps > 0.0) & (steps < 2.5)
        square = float((lengths[near] / steps[near]).min(initial=np.inf))
        half = int(np.clip(reach * square, 2.0, 20.0)) if np.isfinite(square) else 2
        corner = pixel.astype(np.float32).reshape(1, 1, 2)
        refined[index] = cv2.cornerSubPix(grey, corner, (half, half), (-1, -1), criteria)[0, 0]
    return refined
