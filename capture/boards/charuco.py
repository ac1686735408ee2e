"""ChArUco boards in photographs: markers tell which corner is which, so that any part of the board will do."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import numpy as np
from numpy.typing import NDArray

from capture.boards.board import Board, Detection, charuco_board
from capture.boards.cornerwindow import clearances, measured

Floats = NDArray[np.float64]

# Long sides in pixels at which a photograph is searched until most of the board is found; small ones are enlarged.
_SEARCH_SIDES = (2000, 4000)
_SMALL = 1000
_ENOUGH = 0.6
# A corner this many squares off the plane that the others lie in was put together from the wrong markers.
_MAX_OFF_PLANE = 0.25


def charuco_detection(grey: NDArray[np.uint8], board: Board) -> Detection | None:
    """The corners of a charuco board in a photograph; None where fewer than four are seen.

    Both layouts of boards with an even number of rows are tried: OpenCV changed it with version 4.6.
    """
    cells, points, factor = np.empty((0, 2), np.int64), np.empty((0, 2)), 1.0
    for scale, picture in _pictures(grey):
        candidates = [_corners(picture, board, legacy) for legacy in (False, True)[: 2 - board.rows % 2]]
        found = max(candidates, key=lambda each: len(each[0]))
        if len(found[0]) > len(cells):
            (cells, points), factor = found, scale
        if len(cells) >= _ENOUGH * len(board.corners):
            break
    if len(cells) < 4:
        return None
    points = (points + 0.5) / factor - 0.5
    precise, others, useful = measured(grey, cells, points, board.corner_margin)
    size = (grey.shape[1], grey.shape[0])
    return Detection(cells, board.cell_points(cells), precise, others, size).subset(useful)


def markers_seen(grey: NDArray[np.uint8], dictionary: Any) -> NDArray[np.int64]:
    """The numbers of the markers of a dictionary in a photograph, sorted."""
    import cv2

    _, picture = next(_pictures(grey))
    _, numbers, _ = cv2.aruco.ArucoDetector(dictionary).detectMarkers(picture)
    return np.array([], np.int64) if numbers is None else np.unique(numbers)


def _pictures(grey: NDArray[np.uint8]) -> Iterator[tuple[float, NDArray[np.uint8]]]:
    """The photograph at the scales of the search, with their factors."""
    longest = max(grey.shape)
    if longest <= _SMALL:
        yield 1.0, grey
        yield 2.0, _resized(grey, 2.0)
        return
    for side in (side for side in _SEARCH_SIDES if side < longest):
        yield side / longest, _resized(grey, side / longest)
    if longest <= _SEARCH_SIDES[-1]:
        yield 1.0, grey


def _resized(grey: NDArray[np.uint8], factor: float) -> NDArray[np.uint8]:
    import cv2

    how = cv2.INTER_AREA if factor < 1 else cv2.INTER_CUBIC
    return np.asarray(cv2.resize(grey, None, fx=factor, fy=factor, interpolation=how), np.uint8)


def _corners(grey: NDArray[np.uint8], board: Board, legacy: bool) -> tuple[NDArray[np.int64], Floats]:
    """Cells and points of the corners that OpenCV puts together from markers and that lie in one plane."""
    import cv2

    detector = cv2.aruco.CharucoDetector(charuco_board(board, legacy))
    found, numbers, _, _ = detector.detectBoard(grey)
    nothing = np.empty((0, 2), np.int64), np.empty((0, 2))
    if numbers is None or len(numbers) < 4:
        return nothing
    columns, _ = board.corner_counts
    cells = np.column_stack([numbers.ravel() % columns, numbers.ravel() // columns]).astype(np.int64)
    points = found.reshape(-1, 2).astype(float)
    clearance = clearances(cells, points)
    side = float(np.nanmedian(clearance)) if np.isfinite(clearance).any() else np.inf
    if not np.isfinite(side) or np.linalg.matrix_rank(cells - cells.mean(axis=0)) < 2:
        return nothing
    homography, _ = cv2.findHomography(
        cells.astype(float), points, cv2.RANSAC, _MAX_OFF_PLANE * side, maxIters=2000
    )
    if homography is None:
        return nothing
    predicted = cv2.perspectiveTransform(cells[:, None].astype(float), homography)[:, 0]
    flat = np.linalg.norm(predicted - points, axis=1) < _MAX_OFF_PLANE * side
    return (cells[flat], points[flat]) if flat.sum() >= 4 else nothing
