"""Whether residuals repeat on the board: one that is bent, or printed unevenly, misleads every view alike.

A calibration takes the board for flat and its squares for equal (Zhang 2000). Strobl and Hirzinger, "More accurate
pinhole camera calibration with imperfect planar target", ICCV Workshops 2011, free the board's points along with the
camera; here they are free to move as low polynomials do, to first order about the fit, which few views and parts of
boards bear.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from capture.lens.distortion import PARAM_NAMES
from capture.lens.lensfit import CornerView, LensFit, derivatives

Floats = NDArray[np.float64]

# Powers of x and y by which points move. Lower ones are a view's pose, the square's side and the pixels' aspect.
_POWERS = ((2, 0), (1, 1), (0, 2), (3, 0), (2, 1), (1, 2), (0, 3))
# Equations per unknown of the shape, below which nothing is determined.
_MIN_EVIDENCE = 5
# A shape found from half of the views that leaves more than this share of the other half's RMS is no finding.
_MAX_LEFT = 0.9


@dataclass(frozen=True, eq=False)
class BoardShape:
    """What a board that isn't flat would explain.

    left : RMS of the residuals with the board's shape free over that with a flat board, degrees of freedom counted.
    bend : the most by which the board would leave its plane, or a corner its place in it, metres.
    shift : (p,), how the lens's parameters would move.
    """

    left: float
    bend: float
    shift: Floats


def board_shape(views: Sequence[CornerView], located: Sequence[bool], fit: LensFit) -> BoardShape | None:
    """The shape of the board by the residuals of a fit, if they show one with certainty; otherwise None.

    located : whether a view's corners are known by their places on the board; others are taken as flat.
    The shape that either half of the views shows must explain the other half's residuals: each view's own errors, which
    are alike among its corners, would pass for a shape in a test that takes corners for independent.
    """
    own = [view.board_points[:, :2] for view, known in zip(views, located, strict=True) if known]
    if len(own) < 3:
        return None
    low, high = np.concatenate(own).min(axis=0), np.concatenate(own).max(axis=0)
    columns, rows = [], []
    for view, known, pose, residual in zip(views, located, fit.poses, fit.residuals, strict=True):
        of_pose, of_lens = derivatives(view, fit.lens, fit.params, pose)
        shapes = _shapes((2 * view.board_points[:, :2] - low - high) / (high - low).max())
        # A point that moves on the board moves in the picture as the board's shift, turned into the camera's frame.
        of_point = of_pose[:, 3:].reshape(-1, 2, 3) @ pose[:3, :3]
        of_shape = np.einsum("nac,nk->nakc", of_point, shapes * known).reshape(2 * len(shapes), -1)
        basis, _ = np.linalg.qr(of_pose)
        both = np.hstack([of_lens, of_shape])
        columns.append(both - basis @ (basis.T @ both))
        rows.append(residual.ravel())
    target = np.concatenate(rows)
    solved, rank = _solved(columns, rows)
    flat, shaped = float(target @ target), float(((target - np.concatenate(columns) @ solved) ** 2).sum())
    lens_count = len(fit.lens.fitted)
    free = len(target) - 6 * len(views) - lens_count
    added = rank - lens_count
    if added < 1 or free - added < _MIN_EVIDENCE * added or flat <= 0:
        return None
    if _left_in_other_half(columns, rows) > _MAX_LEFT:
        return None
    left = np.sqrt(shaped / (free - added) / (flat / free))
    moved = np.concatenate([_shapes((2 * each - low - high) / (high - low).max()) for each in own])
    bends = moved @ solved[lens_count:].reshape(len(_POWERS), 3)
    names = PARAM_NAMES[fit.lens.model]
    shift = np.zeros(len(names))
    shift[[names.index(name) for name in fit.lens.fitted]] = solved[:lens_count]
    return BoardShape(float(left), float(np.ptp(bends, axis=0).max()), shift)


def _solved(columns: Sequence[Floats], rows: Sequence[Floats]) -> tuple[Floats, int]:
    """The least squares solution over some views, of lens and shape, and the rank."""
    matrix = np.concatenate(list(columns))
    scale = np.maximum(np.linalg.norm(matrix, axis=0), 1e-300)
    solved, _, rank, _ = np.linalg.lstsq(matrix / scale, np.concatenate(list(rows)), rcond=1e-6)
    return np.asarray(solved / scale), int(rank)


def _left_in_other_half(columns: Sequence[Floats], rows: Sequence[Floats]) -> float:
    """RMS that remains of the residuals of every other view after the others' solution, over what it was."""
    remaining = 0.0
    for first in (0, 1):
        solved, _ = _solved(columns[first::2], rows[first::2])
        for matrix, target in zip(columns[1 - first :: 2], rows[1 - first :: 2], strict=True):
            remaining += float(((target - matrix @ solved) ** 2).sum())
    return float(np.sqrt(remaining / sum(float(target @ target) for target in rows)))


def _shapes(places: Floats) -> Floats:
    """The polynomials (n, k) at places (n, 2) within -1 and 1."""
    x, y = places.T
    return np.column_stack([x**i * y**j for i, j in _POWERS])
