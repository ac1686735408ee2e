"""Corners of a charuco board by their looks: which of those found are corners, and which were missed between them.

Markers lead to the corners that they touch. Where one is covered, cut off or washed out, the corners around it still
show: neighbours say where, and the picture says whether two dark and two bright squares meet there.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from capture.boards.board import Board
from capture.boards.cornerwindow import WINDOW_SHARE, clearances, half_windows, refined
from capture.boards.saddles import sample

Floats = NDArray[np.float64]
Cells = NDArray[np.int64]

# A corner this many squares off the plane that the others lie in was put together from the wrong markers.
_MAX_OFF_PLANE = 0.25
# A corner found by its neighbours may lie this many squares from where they say.
_MAX_OFF_NEIGHBOURS = 0.15
_NEIGHBOURS = 12
# Where a corner's four squares are looked at, as a share of the way to the markers.
_LOOK = 0.6
# Contrast over that of the board's other corners, below which a corner is washed out or covered; and the least step
# from any dark square to any bright one over the mean step, below which glare or a shadow's edge moves the corner.
_MIN_CONTRAST = 0.35
_MIN_STEP = 0.75


def plane_homography(cells: Cells, points: Floats) -> tuple[Floats | None, NDArray[np.bool_]]:
    """The homography from cells to points that most of them share, and which do; None where they determine none."""
    import cv2

    nothing = np.zeros(len(cells), bool)
    if len(cells) < 4 or np.linalg.matrix_rank(cells - cells.mean(axis=0)) < 2:
        return None, nothing
    clearance = clearances(cells, points)
    if not np.isfinite(clearance).any():
        return None, nothing
    off = _MAX_OFF_PLANE * float(np.nanmedian(clearance))
    plane, _ = cv2.findHomography(cells.astype(float), points, cv2.RANSAC, off, maxIters=2000)
    if plane is None:
        return None, nothing
    predicted = cv2.perspectiveTransform(cells[:, None].astype(float), plane)[:, 0]
    return np.asarray(plane, float), np.linalg.norm(predicted - points, axis=1) < off


def sound(
    picture: NDArray[np.uint8], cells: Cells, points: Floats, board: Board, legacy: bool
) -> NDArray[np.bool_]:
    """Which corners show two dark and two bright squares where the board has them, as much as the others do.

    cells, points : (n, 2). Returns (n,) bool; none where they lie on one line.
    """
    planes = _local_planes(cells, cells, points)
    mean, least = _steps(picture, cells, points, planes, board, legacy)
    usual = float(np.median(mean[mean > 0])) if (mean > 0).any() else np.inf
    return (mean > _MIN_CONTRAST * usual) & (least > _MIN_STEP * mean)


def with_neighbours(
    picture: NDArray[np.uint8], cells: Cells, points: Floats, board: Board, legacy: bool
) -> tuple[Cells, Floats]:
    """The corners, and those beside them that markers didn't lead to; cells, points : (n, 2)."""
    columns, rows = board.corner_counts
    tried = {(int(i), int(j)) for i, j in cells}
    size = np.array([picture.shape[1], picture.shape[0]])
    while True:
        beside = {
            (i + di, j + dj)
            for i, j in map(tuple, cells.tolist())
            for di in (-1, 0, 1)
            for dj in (-1, 0, 1)
            if 0 <= i + di < columns and 0 <= j + dj < rows
        } - tried
        if not beside:
            return cells, points
        tried |= beside
        new = np.array(sorted(beside), np.int64)
        predicted = np.array(
            [_mapped(plane, cell) for plane, cell in zip(_local_planes(new, cells, points), new, strict=True)]
        )
        inside = np.isfinite(predicted).all(axis=1)
        inside[inside] = ((predicted[inside] > 4) & (predicted[inside] < size - 5)).all(axis=1)
        new, predicted = new[inside], predicted[inside]
        if not len(new):
            continue
        together, places = np.concatenate([cells, new]), np.concatenate([points, predicted])
        side = clearances(together, places)
        windows = half_windows(np.where(np.isfinite(side), side, 10.0), WINDOW_SHARE, board.corner_margin)
        places[len(cells) :] = refined(picture, predicted, windows[len(cells) :])
        moved = np.linalg.norm(places[len(cells) :] - predicted, axis=1)
        good = sound(picture, together, places, board, legacy)[len(cells) :]
        good &= moved < _MAX_OFF_NEIGHBOURS * side[len(cells) :]
        cells = np.concatenate([cells, new[good]])
        points = np.concatenate([points, places[len(points) :][good]])


def _local_planes(wanted: Cells, cells: Cells, points: Floats) -> Floats:
    """Homographies (k, 3, 3) from cells to points about each wanted cell, by the nearest corners; NaN where none."""
    import cv2

    planes = np.full((len(wanted), 3, 3), np.nan)
    for k, cell in enumerate(wanted):
        nearest = np.argsort(np.linalg.norm(cells - cell, axis=1), kind="stable")[:_NEIGHBOURS]
        if len(nearest) < 4 or np.linalg.matrix_rank(cells[nearest] - cells[nearest].mean(axis=0)) < 2:
            continue
        plane, _ = cv2.findHomography((cells[nearest] - cell).astype(float), points[nearest])
        if plane is not None:
            planes[k] = plane
    return planes


def _mapped(plane: Floats, cell: Cells) -> Floats:
    """Where a plane about a cell puts that cell."""
    return np.asarray(plane[:2, 2] / plane[2, 2])


def _steps(
    picture: NDArray[np.uint8], cells: Cells, points: Floats, planes: Floats, board: Board, legacy: bool
) -> tuple[Floats, Floats]:
    """From dark to bright squares around each corner: the mean step and the least, (n,) grey levels."""
    look = _LOOK * min(board.corner_margin, 0.5)
    ends = np.column_stack([look * np.array([[-1, -1], [1, 1], [1, -1], [-1, 1]]), np.ones(4)])
    around = np.einsum("nij,kj->nki", planes, ends)
    with np.errstate(invalid="ignore", divide="ignore"):
        around = around[..., :2] / around[..., 2:] - (planes[:, :2, 2] / planes[:, 2:, 2])[:, None]
    known = np.isfinite(around).all(axis=(1, 2))
    values = np.zeros((len(cells), 4))
    values[known] = sample(picture.astype(np.float32), points[known, None] + around[known])
    # The square before an even cell is dark, except in the old layout of boards with an even number of rows.
    dark_first = (cells.sum(axis=1) % 2 == 0) != (legacy and board.rows % 2 == 0)
    values = np.where(dark_first[:, None], values, values[:, [2, 3, 0, 1]])
    dark, bright = values[:, :2], values[:, 2:]
    return bright.mean(axis=1) - dark.mean(axis=1), bright.min(axis=1) - dark.max(axis=1)
