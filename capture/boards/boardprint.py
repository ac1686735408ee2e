"""Boards to print, true to scale."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from capture.boards.board import Board, charuco_board

# Width and height in millimetres, upright.
PAPERS = {
    "a4": (210.0, 297.0),
    "a3": (297.0, 420.0),
    "a2": (420.0, 594.0),
    "a1": (594.0, 841.0),
    "a0": (841.0, 1189.0),
    "letter": (215.9, 279.4),
    "legal": (215.9, 355.6),
    "tabloid": (279.4, 431.8),
}
_MM_PER_INCH = 25.4
# What printers leave white, and the strip beneath the board for the ruler and the text.
_MARGIN_MM = 8.0
_FOOT_MM = 17.0
_RULER_MM = 100.0


def board_figure(board: Board, paper: str) -> Any:
    """A matplotlib Figure of the paper's size with the board on it, every side as long as the board says.

    ValueError if the board doesn't fit on the paper: it says on which it would, and which squares would fit.
    """
    from matplotlib.collections import PatchCollection
    from matplotlib.figure import Figure
    from matplotlib.patches import Rectangle

    width, height = _page(board, paper)
    figure = Figure(figsize=(width / _MM_PER_INCH, height / _MM_PER_INCH))
    axis = figure.add_axes((0, 0, 1, 1))
    axis.set_xlim(0, width)
    axis.set_ylim(0, height)
    axis.axis("off")
    columns, rows = board.square_counts
    side = 1000 * board.square
    left = (width - columns * side) / 2
    top = height - max(_MARGIN_MM, (height - _FOOT_MM - rows * side) / 2)
    dark = [Rectangle((left + x, top - y - tall), wide, tall) for x, y, wide, tall in dark_areas(board)]
    # No outline, and no smoothing that would leave hairlines between neighbours.
    axis.add_collection(
        PatchCollection(dark, facecolor="black", edgecolor="none", linewidth=0, antialiased=False)
    )
    _draw_foot(axis, board, width)
    return figure


def dark_areas(board: Board) -> NDArray[np.float64]:
    """The black rectangles of a board, (n, 4) millimetres: left, top, width and height from its top left corner."""
    side = 1000 * board.square
    columns, rows = board.square_counts
    areas = [
        (column * side, row * side, side, side)
        for row in range(rows)
        for column in range(columns)
        if (row + column) % 2 == 0
    ]
    if board.marker is None:
        return np.array(areas)
    made = charuco_board(board)
    dictionary = made.getDictionary()
    modules = dictionary.markerSize + 2  # the marker's black border is one module wide
    module = 1000 * board.marker / modules
    for number, corners in zip(made.getIds().ravel(), made.getObjPoints(), strict=True):
        # OpenCV's board has y down, as here.
        left, top = 1000 * np.asarray(corners)[:, :2].min(axis=0)
        picture = np.asarray(dictionary.generateImageMarker(int(number), modules, None, 1)).reshape(
            modules, modules
        )
        for row, line in enumerate(picture < 128):
            for begin, end in _runs(line):
                areas.append((left + begin * module, top + row * module, (end - begin) * module, module))
    return np.array(areas)


def _runs(line: NDArray[np.bool_]) -> list[tuple[int, int]]:
    """Where stretches of true begin and end."""
    steps = np.flatnonzero(np.diff(np.concatenate([[0], line.astype(np.int8), [0]])))
    return [(int(begin), int(end)) for begin, end in steps.reshape(-1, 2)]


def _page(board: Board, paper: str) -> tuple[float, float]:
    """The paper's width and height in millimetres, turned so that the board fits."""
    if paper.lower() not in PAPERS:
        raise ValueError(f"--paper {paper}: is not known; use one of {', '.join(PAPERS)}")
    upright = PAPERS[paper.lower()]
    needed = _needed(board)
    for page in (upright, upright[::-1]):
        if _fits(needed, page):
            return page
    square_counts = np.array(board.square_counts)
    largest = max(
        float(((np.array(page) - [2 * _MARGIN_MM, _MARGIN_MM + _FOOT_MM]) / square_counts).min())
        for page in (upright, upright[::-1])
    )
    roomy = next(
        (name for name, page in PAPERS.items() if _fits(needed, page) or _fits(needed, page[::-1])), None
    )
    share = "" if board.marker is None else f" --marker-mm {_tenths(largest * board.marker / board.square)}"
    fitting = f"--square-mm {_tenths(largest)}{share}" + (f", or --paper {roomy}" if roomy else "")
    raise ValueError(
        f"a board of {needed[0]:.0f}x{needed[1]:.0f} mm with its margins doesn't fit on {paper}"
        f" ({upright[0]:.0f}x{upright[1]:.0f} mm); these would: {fitting}"
    )


def _needed(board: Board) -> tuple[float, float]:
    columns, rows = board.square_counts
    side = 1000 * board.square
    return columns * side + 2 * _MARGIN_MM, rows * side + _MARGIN_MM + _FOOT_MM


def _fits(needed: tuple[float, float], page: tuple[float, float]) -> bool:
    return needed[0] <= page[0] + 1e-6 and needed[1] <= page[1] + 1e-6


def _tenths(side: float) -> str:
    return f"{np.floor(10 * side) / 10:g}"


def _draw_foot(axis: Any, board: Board, width: float) -> None:
    """A ruler to check the print by, and what to give the calibration."""
    left, level = _MARGIN_MM, 11.0
    axis.plot([left, left + _RULER_MM], [level, level], color="black", linewidth=0.6, solid_capstyle="butt")
    for mark in range(0, int(_RULER_MM) + 1, 10):
        tall = 2.5 if mark % 50 == 0 else 1.5
        axis.plot(
            [left + mark] * 2, [level, level + tall], color="black", linewidth=0.6, solid_capstyle="butt"
        )
    axis.text(left + _RULER_MM + 2, level, "100 mm: measure it", fontsize=7, va="bottom")
    axis.text(
        left,
        5.0,
        f"--board {board.spec}   (print at 100 %, glue onto something flat and stiff; if the ruler differs, give the"
        " measured sides)",
        fontsize=5.5 if width < 220 else 7,
        va="bottom",
    )
