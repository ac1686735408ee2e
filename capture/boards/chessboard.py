"""Chessboards in photographs: found whole where they can be, otherwise the part that is seen."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
from numpy.typing import NDArray

from capture.boards.board import Board, Detection
from capture.boards.checkergrid import CheckerGrid, find_grid
from capture.boards.cornerwindow import measured

Floats = NDArray[np.float64]

# Long sides in pixels at which a photograph is searched: corners of sharp and of blurred photographs show at
# different scales.
_SEARCH_SIDES = (1000, 2000, 500)
_MAX_ENLARGEMENT = 2.0


def find_chessboard(grey: NDArray[np.uint8], board: Board) -> CheckerGrid | None:
    """The board's grid in a photograph, OpenCV's pixel convention, turned as printed if it was seen whole.

    Of a board partly seen, or of another size, whatever part was found.
    """
    best: CheckerGrid | None = None
    for factor, picture in _pictures(grey):
        grid = find_grid(picture)
        if grid is None:
            continue
        grid = _trimmed(grid.scaled(1 / factor), board.corner_counts)
        if best is None or len(grid.cells) > len(best.cells):
            best = grid
            if has_size(grid, board):
                break
    if best is None or not (has_size(best, board) or exceeds(best, board)):
        best = _found_by_opencv(grey, board) or best
    return _as_printed(best, board) if best is not None and has_size(best, board) else best


def has_size(grid: CheckerGrid, board: Board) -> bool:
    """Whether a grid has as many corners along its sides as the board, either way round."""
    return sorted(grid.size) == sorted(board.corner_counts)


def exceeds(grid: CheckerGrid, board: Board) -> bool:
    """Whether a grid has more corners along a side than fit on the board."""
    return bool((np.sort(grid.size) > np.sort(board.corner_counts)).any())


def ends_inside(grid: CheckerGrid, size: tuple[int, int]) -> bool:
    """Whether the picture, (width, height), would have shown more corners on every side, had there been any."""
    low, high = np.full(2, np.inf), np.full(2, -np.inf)
    table = {(int(i), int(j)): grid.points[k] for k, (i, j) in enumerate(grid.cells)}
    for (i, j), point in table.items():
        for di, dj in ((1, 0), (-1, 0), (0, 1), (0, -1)):
            inner = table.get((i - di, j - dj))
            if (i + di, j + dj) not in table and inner is not None:
                # A corner a square and a half further out would be in plain view a square further out.
                beyond = point + 1.5 * (point - inner)
                low, high = np.minimum(low, beyond), np.maximum(high, beyond)
    return bool((low > 0).all() and (high < np.array(size) - 1).all())


def chessboard_detection(grey: NDArray[np.uint8], grid: CheckerGrid, board: Board) -> Detection:
    """The corners of a grid, measured in the photograph."""
    points, others, useful = measured(grey, grid.cells, grid.points, board.corner_margin)
    size = (grey.shape[1], grey.shape[0])
    board_points = board.cell_points(grid.cells)
    detection = Detection(grid.cells, board_points, points, others, size, located=has_size(grid, board))
    return detection.subset(useful)


def _pictures(grey: NDArray[np.uint8]) -> Iterator[tuple[float, NDArray[np.uint8]]]:
    """The photograph at the scales of the search, with their factors."""
    import cv2

    longest = max(grey.shape)
    seen = set()
    for side in _SEARCH_SIDES:
        factor = min(side / longest, 1.0 if longest >= _SEARCH_SIDES[0] else _MAX_ENLARGEMENT)
        if side == _SEARCH_SIDES[0] and longest < side:
            factor = 1.0
        if factor in seen:
            continue
        seen.add(factor)
        if factor == 1.0:
            yield factor, grey
            continue
        how = cv2.INTER_AREA if factor < 1 else cv2.INTER_CUBIC
        size = (round(grey.shape[1] * factor), round(grey.shape[0] * factor))
        yield size[0] / grey.shape[1], np.asarray(cv2.resize(grey, size, interpolation=how), np.uint8)


def _trimmed(grid: CheckerGrid, counts: tuple[int, int]) -> CheckerGrid:
    """The grid without outer lines of a few outliers that make it larger than the board."""
    cells, points, dark = grid.cells, grid.points, grid.dark_first
    while (np.sort(cells.max(axis=0) + 1) > np.sort(counts)).any():
        ends = [(axis, end) for axis in (0, 1) for end in (0, int(cells[:, axis].max()))]
        filled = [(cells[:, axis] == end).sum() / len(np.unique(cells[:, 1 - axis])) for axis, end in ends]
        axis, end = ends[int(np.argmin(filled))]
        if min(filled) > 0.4:
            break
        keep = cells[:, axis] != end
        cells, points = cells[keep], points[keep]
        dark = dark if cells[:, axis].min() == 0 else not dark
        cells = cells - cells.min(axis=0)
    return CheckerGrid(cells, points, dark)


def _as_printed(grid: CheckerGrid, board: Board) -> CheckerGrid:
    """The grid turned so that its columns and rows are the board's; which end is first: see `capture.boards.board`."""
    turns = [grid]
    for _ in range(3):
        turns.append(turns[-1].turned())
    fitting = [turn for turn in turns if turn.size == board.corner_counts]
    dark = [turn for turn in fitting if turn.dark_first]
    return max(dark or fitting, key=_uprightness)


def _uprightness(grid: CheckerGrid) -> float:
    """Cosine of the angle between the grid's columns and the picture's x axis."""
    slope = np.polyfit(grid.cells[:, 0], grid.points, 1)[0]
    return float(slope[0] / np.linalg.norm(slope))


def _found_by_opencv(grey: NDArray[np.uint8], board: Board) -> CheckerGrid | None:
    """The whole board as OpenCV finds it; it bears more blur and finer squares."""
    import cv2

    columns, rows = board.corner_counts
    factor = min(1.0, _SEARCH_SIDES[0] / max(grey.shape))
    picture = grey
    if factor < 1:
        how = cv2.INTER_AREA
        picture = np.asarray(cv2.resize(grey, None, fx=factor, fy=factor, interpolation=how), np.uint8)
    flags = cv2.CALIB_CB_ADAPTIVE_THRESH | cv2.CALIB_CB_NORMALIZE_IMAGE
    found, corners = cv2.findChessboardCorners(picture, (columns, rows), flags=flags)
    if not found:
        return None
    points = np.asarray(corners, float).reshape(rows, columns, 2)
    row, column = np.mgrid[:rows, :columns]
    across, down = points[:, -1] - points[:, 0], points[-1] - points[0]
    turn = across.mean(axis=0)[0] * down.mean(axis=0)[1] - across.mean(axis=0)[1] * down.mean(axis=0)[0]
    if turn < 0:
        column = column[:, ::-1]
    cells = np.column_stack([column.ravel(), row.ravel()])
    table = np.empty_like(points)
    table[row, column] = points
    # The square after cell (0, 0), like all after even cells, has the colour of the one before it.
    middles = np.round((table[:-1, :-1] + table[1:, 1:]) / 2).astype(int)
    values = picture[middles[..., 1], middles[..., 0]]
    even = np.add.outer(np.arange(rows - 1), np.arange(columns - 1)) % 2 == 0
    dark_first = bool(values[even].mean() < values[~even].mean())
    return CheckerGrid(cells, points.reshape(-1, 2), dark_first).scaled(1 / factor)
