"""Calibration boards: what is printed on them, and their corners in the board's own frame.

The frame is right-handed in metres: x right and y up as the board is printed, z out of its face towards the
viewer. Corners are counted from the top left, row by row; the first one is the origin. OpenCV's boards have y
down and z into the board instead; `Board.corners` is the one place where the two meet.

A chessboard doesn't number its four sides. Its first corner is the one whose outer square is dark.
Where that leaves a choice, as on boards with both counts even or both odd, the corner is taken that makes the board
most upright in the picture: a pose is then known up to half a turn about the board's centre (on a square board of
odd counts, a quarter turn).
"""

from __future__ import annotations

import re
from dataclasses import dataclass, replace
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from capture.arrays import frozen_array

Floats = NDArray[np.float64]

DEFAULT_DICTIONARY = "DICT_5X5_100"
_EXAMPLES = (
    "write chessboard:9x6:0.025 (columns x rows of inner corners, square side in metres)"
    " or charuco:7x5:0.030:0.022:DICT_5X5_100 (columns x rows of squares, square and marker side in metres,"
    " dictionary)"
)
# A square of so many metres isn't printed; a millimetre-sized one isn't seen.
_MILLIMETRES = 5.0


@dataclass(frozen=True)
class Board:
    """A calibration board.

    kind : chessboard, whose columns and rows count inner corners, or charuco, whose columns and rows count squares.
    square, marker : sides in metres. dictionary : OpenCV's name. The latter two belong to charuco boards only.
    """

    kind: Literal["chessboard", "charuco"]
    columns: int
    rows: int
    square: float
    marker: float | None = None
    dictionary: str | None = None

    def __post_init__(self) -> None:
        if self.kind not in ("chessboard", "charuco"):
            raise ValueError(f"a board of kind {self.kind!r} is not known; {_EXAMPLES}")
        if min(self.columns, self.rows) < 3:
            what = "inner corners" if self.kind == "chessboard" else "squares"
            raise ValueError(
                f"a {self.kind} of {self.columns}x{self.rows} {what} is too small; 3x3 is the least"
            )
        if not (np.isfinite(self.square) and self.square > 0):
            raise ValueError(f"square side is {self.square} m; it must be > 0")
        if self.square >= _MILLIMETRES:
            raise ValueError(
                f"square side is {self.square:g} m; sides are in metres, and this looks like millimetres:"
                f" {self.square / 1000:g}"
            )
        if self.kind == "chessboard":
            if self.marker is not None or self.dictionary is not None:
                raise ValueError("a chessboard has neither markers nor a dictionary; leave them out")
            return
        if self.marker is None or not 0 < self.marker < self.square:
            raise ValueError(
                f"marker side is {self.marker} m; it must lie between 0 and the square's, {self.square} m"
            )
        if self.dictionary is None:
            object.__setattr__(self, "dictionary", DEFAULT_DICTIONARY)
        available = len(aruco_dictionary(str(self.dictionary)).bytesList)
        needed = self.columns * self.rows // 2
        if needed > available:
            raise ValueError(
                f"a charuco board of {self.columns}x{self.rows} squares needs {needed} markers, but"
                f" {self.dictionary} holds {available}; use a larger dictionary, such as DICT_5X5_1000"
            )

    @property
    def spec(self) -> str:
        """The text that `parse_board` reads."""
        text = f"{self.kind}:{self.columns}x{self.rows}:{_metres(self.square)}"
        return text if self.marker is None else f"{text}:{_metres(self.marker)}:{self.dictionary}"

    @property
    def corner_counts(self) -> tuple[int, int]:
        """Columns and rows of the corners that are measured."""
        if self.kind == "chessboard":
            return self.columns, self.rows
        return self.columns - 1, self.rows - 1

    @property
    def square_counts(self) -> tuple[int, int]:
        """Columns and rows of squares, outer ones included."""
        columns, rows = self.corner_counts
        return columns + 1, rows + 1

    @property
    def corner_margin(self) -> float:
        """How far from a corner the pattern of four plain squares reaches, as a share of the square's side."""
        return 1.0 if self.marker is None else (self.square - self.marker) / (2 * self.square)

    @property
    def corners(self) -> Floats:
        """All corners by their numbers, (n, 3) metres, in the board's frame."""
        columns, rows = self.corner_counts
        return self.cell_points(
            np.column_stack([np.tile(np.arange(columns), rows), np.repeat(np.arange(rows), columns)])
        )

    def cell_points(self, cells: NDArray[np.int64]) -> Floats:
        """Points (n, 3) in metres of lattice cells (n, 2), column and row as printed, row downwards."""
        columns, rows = np.asarray(cells, float).T
        return np.column_stack([columns * self.square, -rows * self.square, np.zeros(len(columns))])


@dataclass(frozen=True, eq=False)
class Detection:
    """The corners of a board that were found in one photograph.

    cells : (n, 2) int, column and row of each corner as printed. board_points : (n, 3) metres, in the board's frame.
    points : (n, 2) float64, pixels; the centre of the first pixel is (0.5, 0.5).
    other_points : (k, n, 2), the same corners measured with other windows, so that the effect of the window can be
    measured. size : width and height of the photograph in pixels.
    located : false if only a part of a chessboard was seen, whose place on the board is not known: cells then count
        from the part's own first corner. Intrinsics don't need it, a pose does.
    """

    cells: NDArray[np.int64]
    board_points: Floats
    points: Floats
    other_points: Floats
    size: tuple[int, int]
    located: bool = True

    def __post_init__(self) -> None:
        count = len(self.cells)
        for name, columns in (("cells", 2), ("board_points", 3), ("points", 2)):
            shape = getattr(self, name).shape
            if shape != (count, columns):
                raise ValueError(f"{name} has shape {shape}; it must be ({count}, {columns})")
        if self.other_points.shape[1:] != (count, 2):
            raise ValueError(f"other_points has shape {self.other_points.shape}; it must be (k, {count}, 2)")
        object.__setattr__(self, "cells", frozen_array(self.cells, np.int64))
        for name in ("board_points", "points", "other_points"):
            object.__setattr__(self, name, frozen_array(getattr(self, name)))

    def subset(self, keep: NDArray[np.bool_]) -> Detection:
        """The same detection with fewer corners."""
        return replace(
            self,
            cells=self.cells[keep],
            board_points=self.board_points[keep],
            points=self.points[keep],
            other_points=self.other_points[:, keep],
        )


def parse_board(text: str) -> Board:
    """A board from text such as chessboard:9x6:0.025 or charuco:7x5:0.030:0.022:DICT_5X5_100.

    chessboard:COLUMNSxROWS:SQUARE counts inner corners; charuco:COLUMNSxROWS:SQUARE:MARKER[:DICTIONARY] counts
    squares. Sides in metres. ValueError says what is wrong and shows both forms.
    """
    kind, *parts = text.strip().split(":")
    lengths = {"chessboard": (2,), "charuco": (3, 4)}
    if kind.lower() not in lengths:
        raise ValueError(f"board {text!r}: {kind!r} is no kind of board; {_EXAMPLES}")
    if len(parts) not in lengths[kind.lower()]:
        raise ValueError(f"board {text!r}: has {len(parts)} parts after {kind!r}; {_EXAMPLES}")
    counts = re.fullmatch(r"(\d+)[xX×](\d+)", parts[0].strip())
    if counts is None:
        raise ValueError(f"board {text!r}: {parts[0]!r} is not COLUMNSxROWS; {_EXAMPLES}")
    square, *marker = (_number(text, part) for part in parts[1:3])
    try:
        return Board(
            "chessboard" if kind.lower() == "chessboard" else "charuco",
            int(counts[1]),
            int(counts[2]),
            square,
            marker[0] if marker else None,
            parts[3].strip() if len(parts) == 4 else None,
        )
    except ValueError as error:
        raise ValueError(f"board {text!r}: {error}") from error


def aruco_dictionary(name: str) -> Any:
    """OpenCV's dictionary of markers of this name; ValueError lists the names."""
    import cv2

    names = [known for known in dir(cv2.aruco) if known.startswith("DICT_")]
    key = next((known for known in names if known.upper() == name.upper()), None)
    if key is None:
        raise ValueError(f"dictionary {name!r} is not known; use one of {', '.join(names)}")
    return cv2.aruco.getPredefinedDictionary(getattr(cv2.aruco, key))


def charuco_board(board: Board, legacy: bool = False) -> Any:
    """OpenCV's object for a charuco board; `legacy` for the layout of its versions before 4.6."""
    import cv2

    if board.marker is None:
        raise ValueError(f"{board.spec} has no markers; it is no charuco board")
    made = cv2.aruco.CharucoBoard(
        (board.columns, board.rows), board.square, board.marker, aruco_dictionary(str(board.dictionary))
    )
    made.setLegacyPattern(legacy)
    return made


def _number(text: str, part: str) -> float:
    try:
        return float(part)
    except ValueError as error:
        raise ValueError(f"board {text!r}: {part!r} is not a length in metres; {_EXAMPLES}") from error


def _metres(side: float) -> str:
    return f"{side:.6g}"
