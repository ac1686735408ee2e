"""Corners to a fraction of a pixel, in windows as large as the picture of the squares allows.

A corner is where the picture's gradients all point past it (Foerstner and Guelch 1987), summed over a window. A
window that reaches into the neighbouring squares' corners pulls the corner towards them; one that is too small keeps
the pixels' noise. So the window is a share of the clearance, the distance from the corner to its neighbours' edges.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.float64]

# Half a window's side over the clearance: the one that is used, and those that it is compared with. Where the
# compared ones reach sets the size of the bias that is reported. Beyond 0.4 the neighbours' corners come in.
WINDOW_SHARE = 0.25
OTHER_SHARES = (0.18, 0.34)
# The picture is smoothed by this share of the half window, or noise of the plain areas outweighs the edges in large
# windows: at a half window of 15 pixels and 2 % noise, smoothing took the error from 0.18 to 0.07 px.
_SMOOTHING = 0.1
_MIN_HALF_WINDOW = 2
_MARGIN_SHARE = 0.85
# OpenCV counts pixel centres at integers, we at halves: the one place where points cross over.
HALF_PIXEL = 0.5


def clearances(cells: NDArray[np.int64], points: Floats) -> Floats:
    """Distance of each corner from its neighbours' edges, (n,) pixels; NaN where there are none.

    cells : (n, 2) column and row. points : (n, 2) pixels.
    """
    table = {(int(i), int(j)): k for k, (i, j) in enumerate(cells)}
    found = np.full(len(cells), np.nan)
    for (i, j), k in table.items():
        for di in (-1, 1):
            for dj in (-1, 1):
                beside, below = table.get((i + di, j)), table.get((i, j + dj))
                if beside is None or below is None:
                    continue
                u, v = points[beside] - points[k], points[below] - points[k]
                area = abs(u[0] * v[1] - u[1] * v[0])
                height = area / max(float(np.linalg.norm(u)), float(np.linalg.norm(v)), 1e-9)
                found[k] = height if np.isnan(found[k]) else min(found[k], height)
    if np.isfinite(found).any():
        # A corner without neighbours on both axes takes what the nearest corner has.
        known = np.flatnonzero(np.isfinite(found))
        for lone in np.flatnonzero(np.isnan(found)):
            found[lone] = found[known[np.argmin(np.linalg.norm(points[known] - points[lone], axis=1))]]
    return found


def refined(grey: NDArray[np.uint8], points: Floats, half_windows: NDArray[np.integer]) -> Floats:
    """Corners (n, 2) moved to where the gradients say, in windows of (n,) half sides; OpenCV's pixel convention."""
    import cv2

    criteria = (cv2.TERM_CRITERIA_EPS | cv2.TERM_CRITERIA_MAX_ITER, 100, 1e-4)
    moved = np.array(points, float)
    smoothing = _SMOOTHING * float(np.median(half_windows)) if len(points) else 0.0
    picture = grey.astype(np.float32)
    if smoothing > 0.5:
        picture = np.asarray(cv2.GaussianBlur(picture, (0, 0), smoothing), np.float32)
    for half in sorted({int(each) for each in half_windows}):
        of_size = half_windows == half
        start = np.ascontiguousarray(points[of_size], np.float32).reshape(-1, 1, 2)
        moved[of_size] = cv2.cornerSubPix(picture, start.copy(), (half, half), (-1, -1), criteria).reshape(
            -1, 2
        )
    return moved


def measured(
    grey: NDArray[np.uint8], cells: NDArray[np.int64], points: Floats, margin: float = 1.0
) -> tuple[Floats, Floats, NDArray[np.bool_]]:
    """Corners measured with the chosen window and with the others, and which of them can be used.

    grey : (h, w) uint8, the photograph. cells, points : (n, 2), the corners found, OpenCV's pixel convention, good to a
    quarter of a square. margin : `Board.corner_margin`.
    Returns (n, 2) and (k, n, 2) pixels, the centre of the first pixel being (0.5, 0.5), and (n,) bool: false where a
    window leaves the picture or where windows disagree by more than themselves, as on a corner half covered.
    """
    clearance = clearances(cells, points)
    useful = np.isfinite(clearance)
    clearance = np.where(useful, clearance, 10.0)
    coarse = refined(grey, points, half_windows(clearance, WINDOW_SHARE, margin))
    clearance = np.where(useful, clearances(cells, coarse), 10.0)
    reach = half_windows(clearance, WINDOW_SHARE, margin)
    chosen = refined(grey, coarse, reach)
    smaller, larger = (half_windows(clearance, share, margin) for share in OTHER_SHARES)
    windows = (np.maximum(np.minimum(smaller, reach - 1), _MIN_HALF_WINDOW), np.maximum(larger, reach + 1))
    others = np.array([refined(grey, coarse, window) for window in windows])
    size = np.array([grey.shape[1], grey.shape[0]])
    inside = ((chosen > reach[:, None]) & (chosen < size - 1 - reach[:, None])).all(axis=1)
    spread = np.linalg.norm(others - chosen, axis=2).max(axis=0)
    agree = spread < np.maximum(0.1 * clearance, 0.7)
    return chosen + HALF_PIXEL, others + HALF_PIXEL, useful & inside & agree


def half_windows(clearance: Floats, share: float, margin: float) -> NDArray[np.int64]:
    """Half sides (n,) of the windows for a share of the clearance, in pixels; margin : `Board.corner_margin`."""
    # Squares with markers in them are plain only up to the margin.
    widest = min(share, _MARGIN_SHARE * margin * share / WINDOW_SHARE)
    return np.maximum(np.round(widest * clearance), _MIN_HALF_WINDOW).astype(np.int64)
