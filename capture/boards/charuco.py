"""ChArUco boards in photographs: markers identify each corner, so that any part of the board will do."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from capture.boards.board import Board, Detection, aruco_dictionary, charuco_board
from capture.boards.charucocorners import plane_homography, sound, with_neighbours
from capture.boards.cornerwindow import HALF_PIXEL, measured

Floats = NDArray[np.float64]

# Long sides in pixels at which a photograph is searched until most of the board is found; small ones are enlarged.
_SEARCH_SIDES = (2000, 4000)
_SMALL = 1000
# Share of the corners that should be in the picture at which the search ends.
_ENOUGH = 0.9
# Windows beside markers are a few pixels wide: where they disagree by more, a finger or glare reaches into one.
_MAX_SPREAD_PX = 0.75
# A marker's outline is good to about a pixel; smaller ones don't determine their side over the square's.
_MIN_MARKER_PX = 25.0
# How many squares a marker may lie off the plane of the others, and how many markers may, before the board is another.
_MAX_MARKER_OFF = 0.4
_MAX_MISPLACED = 0.4
_MIN_MARKERS = 6


@dataclass(frozen=True, eq=False)
class Markers:
    """Markers in a picture. numbers : (m,). outlines : (m, 4, 2) pixels, OpenCV's convention."""

    numbers: NDArray[np.int64]
    outlines: Floats


def charuco_detection(grey: NDArray[np.uint8], board: Board) -> tuple[Detection | None, float | None]:
    """The corners of a charuco board in a photograph, and its markers' side over its squares' as seen.

    None where fewer than four corners are seen, and where markers are too small to measure. Both layouts of boards with
    an even number of rows are tried: OpenCV changed it with version 4.6.
    """
    cells, points, factor, layout = np.empty((0, 2), np.int64), np.empty((0, 2)), 1.0, False
    share = None
    for scale, picture in _pictures(grey):
        markers = find_markers(picture, str(board.dictionary))
        layouts = (False, True)[: 2 - board.rows % 2]
        candidates = [(*_corners(picture, board, markers, legacy), legacy) for legacy in layouts]
        seeds, places, legacy = max(candidates, key=lambda each: len(each[0]))
        if len(seeds) >= 4:
            seeds, places = with_neighbours(picture, seeds, places, board, legacy)
        if len(seeds) > len(cells):
            cells, points, factor, layout = seeds, places, scale, legacy
            share = _marker_share(cells, points, markers)
        if len(cells) and len(cells) >= _ENOUGH * _count_inside(cells, points / factor, board, grey.shape):
            break
    if len(cells) < 4:
        return None, share
    points = (points + 0.5) / factor - 0.5
    precise, others, useful = measured(grey, cells, points, board.corner_margin)
    useful &= np.linalg.norm(others - precise, axis=2).max(axis=0) < _MAX_SPREAD_PX
    useful &= sound(grey, cells, precise - HALF_PIXEL, board, layout)
    size = (grey.shape[1], grey.shape[0])
    return Detection(cells, board.cell_points(cells), precise, others, size).subset(useful), share


def find_markers(picture: NDArray[np.uint8], dictionary: str) -> Markers:
    """The markers of a dictionary in a picture."""
    import cv2

    outlines, numbers, _ = cv2.aruco.ArucoDetector(aruco_dictionary(dictionary)).detectMarkers(picture)
    if numbers is None:
        return Markers(np.empty(0, np.int64), np.empty((0, 4, 2)))
    return Markers(np.asarray(numbers, np.int64).ravel(), np.asarray(outlines, float).reshape(-1, 4, 2))


def search_picture(grey: NDArray[np.uint8]) -> NDArray[np.uint8]:
    """The photograph at the first scale of the search."""
    return next(_pictures(grey))[1]


def misplaced(markers: Markers, board: Board) -> bool:
    """Whether markers, all of them the board's by their numbers, lie elsewhere than on it in either of its layouts.

    False where they are too few to decide.
    """
    import cv2

    if len(markers.numbers) < _MIN_MARKERS:
        return False
    seen = markers.outlines.mean(axis=1)
    side = float(np.median(np.linalg.norm(np.diff(markers.outlines, axis=1), axis=2)))
    most = 0.0
    for legacy in (False, True)[: 2 - board.rows % 2]:
        printed = np.array(
            [np.mean(each, axis=0)[:2] for each in charuco_board(board, legacy).getObjPoints()]
        )
        own = printed[markers.numbers]
        plane, inside = cv2.findHomography(own, seen, cv2.RANSAC, _MAX_MARKER_OFF * side, maxIters=2000)
        if plane is not None:
            most = max(most, float(np.mean(inside)))
    return most < 1 - _MAX_MISPLACED


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


def _corners(
    picture: NDArray[np.uint8], board: Board, markers: Markers, legacy: bool
) -> tuple[NDArray[np.int64], Floats]:
    """Cells and points of the corners that OpenCV puts together from markers, lie in one plane and look like corners.

    One marker is enough for a corner, where OpenCV asks for both of those that it touches by default.
    """
    import cv2

    nothing = np.empty((0, 2), np.int64), np.empty((0, 2))
    if not len(markers.numbers):
        return nothing
    parameters = cv2.aruco.CharucoParameters()
    parameters.minMarkers = 1
    detector = cv2.aruco.CharucoDetector(charuco_board(board, legacy), parameters)
    outlines = [outline[None].astype(np.float32) for outline in markers.outlines]
    found, numbers, _, _ = detector.detectBoard(
        picture, markerCorners=outlines, markerIds=markers.numbers[:, None].astype(np.int32)
    )
    if numbers is None or len(numbers) < 4:
        return nothing
    columns, _ = board.corner_counts
    cells = np.column_stack([numbers.ravel() % columns, numbers.ravel() // columns]).astype(np.int64)
    points = found.reshape(-1, 2).astype(float)
    _, flat = plane_homography(cells, points)
    cells, points = cells[flat], points[flat]
    if len(cells) < 4:
        return nothing
    keep = sound(picture, cells, points, board, legacy)
    return cells[keep], points[keep]


def _count_inside(cells: NDArray[np.int64], points: Floats, board: Board, shape: tuple[int, ...]) -> int:
    """How many corners of the board the plane of those found puts into the picture."""
    import cv2

    plane, _ = plane_homography(cells, points)
    if plane is None:
        return len(board.corners)
    columns, rows = board.corner_counts
    every = np.column_stack([np.tile(np.arange(columns), rows), np.repeat(np.arange(rows), columns)])
    places = cv2.perspectiveTransform(every[:, None].astype(float), plane)[:, 0]
    margin = 0.01 * max(shape)
    return int(((places > margin) & (places < np.array([shape[1], shape[0]]) - margin)).all(axis=1).sum())


def _marker_share(cells: NDArray[np.int64], points: Floats, markers: Markers) -> float | None:
    """Side of the markers over that of the squares, by the plane of the corners."""
    import cv2

    plane, _ = plane_homography(cells, points)
    sides = np.linalg.norm(markers.outlines - np.roll(markers.outlines, 1, axis=1), axis=2).min(axis=1)
    large = sides > _MIN_MARKER_PX
    if plane is None or not large.any():
        return None
    outlines = markers.outlines[large]
    flat = cv2.perspectiveTransform(outlines.reshape(-1, 1, 2), np.linalg.inv(plane)).reshape(-1, 4, 2)
    return float(np.median(np.linalg.norm(flat - np.roll(flat, 1, axis=1), axis=2)))
