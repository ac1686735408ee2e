"""Chessboard corners in a picture, on an integer lattice, however much of the board the picture shows.

OpenCV finds a board whose size is known and that is seen whole. This finds whatever part of any board is there, so
that cut-off views count, and so that a board of another size can be named.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from capture.arrays import frozen_array
from capture.boards.saddles import Saddles, saddle_points, sample

Floats = NDArray[np.float64]

_STEPS = ((1, 0), (-1, 0), (0, 1), (0, -1))
# How far a corner may lie from where its neighbours say, as a share of a square's side.
_MAX_DEVIATION = 0.3
# Between neighbouring corners light falls off gently, and a side runs straight but for the lens.
_MIN_CONTRAST_RATIO = 0.4
_MAX_EDGE_TURN = np.radians(18)


@dataclass(frozen=True, eq=False)
class CheckerGrid:
    """Corners of a chessboard on their lattice; which corner is (0, 0) means nothing yet.

    cells : (n, 2) int, column and row, from 0; columns and rows turn clockwise in the picture as x and y do.
    points : (n, 2) float64, pixels, OpenCV's convention.
    dark_first : true if the square before cell (0, 0) on both axes is a dark one.
    """

    cells: NDArray[np.int64]
    points: Floats
    dark_first: bool

    def __post_init__(self) -> None:
        object.__setattr__(self, "cells", frozen_array(self.cells, np.int64))
        object.__setattr__(self, "points", frozen_array(self.points))

    @property
    def size(self) -> tuple[int, int]:
        """Columns and rows."""
        columns, rows = self.cells.max(axis=0) + 1
        return int(columns), int(rows)

    def scaled(self, factor: float) -> CheckerGrid:
        """The grid in a picture that is `factor` times as large, pixel centres being at integers."""
        return CheckerGrid(self.cells, (self.points + 0.5) * factor - 0.5, self.dark_first)

    def turned(self) -> CheckerGrid:
        """The same grid counted from the next corner: a quarter turn."""
        columns, _ = self.size
        column, row = self.cells.T
        # The new first corner is the last column's first; its outer square's colour alternates along the row.
        dark = self.dark_first if columns % 2 == 0 else not self.dark_first
        return CheckerGrid(np.column_stack([row, columns - 1 - column]), self.points, dark)


def find_grid(grey: NDArray[np.uint8]) -> CheckerGrid | None:
    """The largest chessboard grid in a picture, at least 3x3 corners; None if there is none.

    grey : (h, w) uint8; squares should be 10 pixels or wider.
    """
    import cv2

    smooth = cv2.GaussianBlur(grey, (0, 0), 1.0).astype(np.float32)
    points = saddle_points(smooth)
    best: dict[tuple[int, int], int] = {}
    if len(points) < 9:
        return None
    corners = Saddles.at(smooth, points)
    from scipy.spatial import KDTree

    tree = KDTree(corners.points)
    tried = np.zeros(len(corners.points), bool)
    for seed in np.argsort(-corners.contrast):
        if tried[seed]:
            continue
        nodes = _grow(smooth, corners, tree, int(seed))
        tried[list(nodes.values())] = True
        if len(nodes) > len(best):
            best = nodes
    return _complete(smooth, corners, best)


def _opposite_phase(one: float, other: float) -> bool:
    """Whether two axes of bright squares are nearly at right angles, as at neighbouring corners."""
    return abs(np.cos(one - other)) < np.cos(np.radians(50))


def _is_edge(smooth: NDArray[np.float32], start: Floats, end: Floats, contrast: float) -> bool:
    """Whether one side of the line between two corners is bright and the other dark, all along."""
    step = end - start
    across = 0.2 * np.array([-step[1], step[0]])
    places = start + np.array([0.3, 0.5, 0.7])[:, None] * step
    difference = sample(smooth, places + across) - sample(smooth, places - across)
    return bool(
        (np.abs(difference) > 0.6 * contrast).all() and (np.sign(difference) == np.sign(difference[0])).all()
    )


def _grow(
    smooth: NDArray[np.float32], corners: Saddles, tree: object, seed: int
) -> dict[tuple[int, int], int]:
    """The lattice that grows from one corner by stepping to neighbours: cell to index of the corner."""
    nodes = {(0, 0): seed}
    used = {seed}
    origin = corners.points[seed]
    near = [int(k) for k in np.atleast_1d(tree.query(origin, k=min(13, len(corners.points)))[1])][1:]  # type: ignore[attr-defined]
    for axis, angle in enumerate(corners.edges[seed]):
        along = np.array([np.cos(angle), np.sin(angle)])
        for sign in (1, -1):
            for k in near:
                step = corners.points[k] - origin
                length = np.linalg.norm(step)
                if (
                    k not in used
                    and length > 4
                    and sign * (step @ along) > np.cos(np.radians(15)) * length
                    and _joined(smooth, corners, seed, k)
                ):
                    cell = (sign, 0) if axis == 0 else (0, sign)
                    nodes[cell] = k
                    used.add(k)
                    break
    queue = list(nodes)
    while queue:
        cell = queue.pop(0)
        for step_cell in _STEPS:
            target = (cell[0] + step_cell[0], cell[1] + step_cell[1])
            if target in nodes:
                continue
            step = _expected_step(nodes, corners.points, cell, step_cell)
            if step is None:
                continue
            predicted = corners.points[nodes[cell]] + step
            distance, k = tree.query(predicted)  # type: ignore[attr-defined]
            if (
                distance < _MAX_DEVIATION * np.linalg.norm(step)
                and k not in used
                and _joined(smooth, corners, nodes[cell], int(k))
            ):
                nodes[target] = int(k)
                used.add(int(k))
                queue.append(target)
    return nodes


def _joined(smooth: NDArray[np.float32], corners: Saddles, one: int, other: int) -> bool:
    """Whether two corners are the ends of a square's side."""
    weaker, stronger = sorted((corners.contrast[one], corners.contrast[other]))
    if weaker < _MIN_CONTRAST_RATIO * stronger:
        return False
    if not _opposite_phase(corners.bright[one], corners.bright[other]):
        return False
    step = corners.points[other] - corners.points[one]
    angle = np.arctan2(step[1], step[0])
    along = np.abs(np.cos(corners.edges[[one, other]] - angle)).max(axis=1)
    if (along < np.cos(_MAX_EDGE_TURN)).any():
        return False
    return _is_edge(smooth, corners.points[one], corners.points[other], weaker)


def _expected_step(
    nodes: dict[tuple[int, int], int], points: Floats, cell: tuple[int, int], step: tuple[int, int]
) -> Floats | None:
    """The step from a cell to its neighbour as the cells around do it; None where none of them shows it."""
    (i, j), (di, dj) = cell, step
    here = points[nodes[cell]]
    behind = nodes.get((i - di, j - dj))
    if behind is not None:
        further = nodes.get((i - 2 * di, j - 2 * dj))
        ahead = here - points[behind]
        if further is None:
            return np.asarray(ahead)
        # Under perspective steps shrink by a nearly constant factor.
        last = points[behind] - points[further]
        return np.asarray(ahead * np.linalg.norm(ahead) / max(float(np.linalg.norm(last)), 1e-9))
    for side in (1, -1):
        beside, target = (
            nodes.get((i + side * dj, j + side * di)),
            nodes.get((i + side * dj + di, j + side * di + dj)),
        )
        if beside is not None and target is not None:
            return np.asarray(points[target] - points[beside])
    return None


def _complete(
    smooth: NDArray[np.float32], corners: Saddles, nodes: dict[tuple[int, int], int]
) -> CheckerGrid | None:
    """The grid with weak corners filled in, outliers taken out, cells counted from 0, right-handed."""
    cells = np.array(list(nodes), int).reshape(-1, 2)
    points = corners.points[list(nodes.values())]
    bright = corners.bright[list(nodes.values())]
    keep = _consistent(cells, points)
    cells, points, bright = cells[keep], points[keep], bright[keep]
    if len(cells) < 9 or (np.ptp(cells, axis=0) < 2).any():
        return None
    cells = cells - cells.min(axis=0)
    table = {(int(i), int(j)): points[k] for k, (i, j) in enumerate(cells)}
    steps = [
        (table[i + 1, j] - table[i, j], table[i, j + 1] - table[i, j])
        for i, j in table
        if (i + 1, j) in table and (i, j + 1) in table
    ]
    if not steps:
        return None
    # The square before (0, 0) lies along minus both steps; it is dark if the bright axis is the other one.
    across, down = np.mean([a for a, _ in steps], axis=0), np.mean([d for _, d in steps], axis=0)
    votes = []
    for (i, j), angle in zip(cells, bright, strict=True):
        main = across / np.linalg.norm(across) + down / np.linalg.norm(down)
        is_bright = abs(np.cos(angle - np.arctan2(main[1], main[0]))) > np.sqrt(0.5)
        votes.append(is_bright == ((i + j) % 2 == 0))
    dark_first = bool(np.mean(votes) < 0.5)
    if across[0] * down[1] - across[1] * down[0] < 0:
        cells = cells[:, ::-1]
    return CheckerGrid(cells, points, dark_first)


def _consistent(cells: NDArray[np.int64], points: Floats) -> NDArray[np.bool_]:
    """Corners halfway between their neighbours, as far as they have any on both sides; the largest connected part."""
    table = {(int(i), int(j)): k for k, (i, j) in enumerate(cells)}
    keep = np.ones(len(cells), bool)
    for (i, j), k in table.items():
        for di, dj in ((1, 0), (0, 1)):
            before, after = table.get((i - di, j - dj)), table.get((i + di, j + dj))
            if before is not None and after is not None:
                middle = (points[before] + points[after]) / 2
                side = np.linalg.norm(points[after] - points[before]) / 2
                if np.linalg.norm(points[k] - middle) > _MAX_DEVIATION * side:
                    keep[k] = False
    remaining = {cell for cell, k in table.items() if keep[k]}
    best: set[tuple[int, int]] = set()
    while remaining:
        part, queue = set(), [remaining.pop()]
        while queue:
            cell = queue.pop()
            part.add(cell)
            for di, dj in _STEPS:
                neighbour = (cell[0] + di, cell[1] + dj)
                if neighbour in remaining:
                    remaining.discard(neighbour)
                    queue.append(neighbour)
        best = max(best, part, key=len)
    return np.array([(int(i), int(j)) in best for i, j in cells], bool)
