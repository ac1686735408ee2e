"""Saddles of a picture: places that look like the meeting of two dark and two bright squares."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.float64]

# Angles around a corner at which the picture is looked at, and how far from it (pixels of the searched picture).
_RING = np.arange(32) * 2 * np.pi / 32
_RING_RADII = (3.0, 5.0)
_MAX_SADDLES = 2500


@dataclass(frozen=True, eq=False)
class Saddles:
    """Candidates for the corners of a chessboard.

    points : (n, 2). bright : (n,) angle of the bright squares' axis, radians mod pi. contrast : (n,) grey levels.
    edges : (n, 2) angles mod pi of the two lines through the corner.
    """

    points: Floats
    bright: Floats
    contrast: Floats
    edges: Floats

    @classmethod
    def at(cls, smooth: NDArray[np.float32], points: Floats) -> Saddles:
        """Those of `points` around which the picture turns dark and bright twice, alike on opposite sides."""
        ring = np.mean([sample(smooth, _ring(points, radius)) for radius in _RING_RADII], axis=0)
        ring = ring - ring.mean(axis=1, keepdims=True)
        half = len(_RING) // 2
        first, second = ring[:, :half], ring[:, half:]
        energy = (ring**2).sum(axis=1)
        alike = 2 * (first * second).sum(axis=1) / np.maximum(energy, 1e-9)
        folded = (first + second) / 2
        ends = np.concatenate([folded, folded[:, :1]], axis=1)
        crossings = np.signbit(ends[:, :-1]) != np.signbit(ends[:, 1:])
        contrast = np.sqrt(energy / len(_RING))
        good = (alike > 0.5) & (crossings.sum(axis=1) == 2) & (contrast > 2.0)
        folded, ends, crossings = folded[good], ends[good], crossings[good]
        where = np.nonzero(crossings)[1].reshape(-1, 2)
        rows = np.arange(len(where))[:, None]
        low, high = ends[rows, where], ends[rows, where + 1]
        edges = (where + low / (low - high)) * _RING[1]
        # From the first line to the second it is bright if the ring is positive between them.
        middle = edges.mean(axis=1)
        between = folded[np.arange(len(where)), (np.round(middle / _RING[1]).astype(int)) % half] > 0
        bright = np.where(between, middle, middle + np.pi / 2) % np.pi
        return cls(points[good], bright, contrast[good], edges)


def saddle_points(smooth: NDArray[np.float32]) -> Floats:
    """Local maxima of the saddle strength Ixy^2 - Ixx Iyy, in units of the local contrast; the strongest first."""
    import cv2

    xx = cv2.Sobel(smooth, cv2.CV_32F, 2, 0, ksize=5)
    yy = cv2.Sobel(smooth, cv2.CV_32F, 0, 2, ksize=5)
    xy = cv2.Sobel(smooth, cv2.CV_32F, 1, 1, ksize=5)
    strength = np.maximum(xy * xy - xx * yy, 0)
    mean = cv2.blur(smooth, (15, 15))
    variance = cv2.blur(smooth * smooth, (15, 15)) - mean * mean
    strength = np.sqrt(strength) / np.sqrt(np.maximum(variance, 0) + 9.0)
    peaks = (strength == cv2.dilate(strength, np.ones((5, 5), np.uint8))) & (strength > 0)
    border = 6
    peaks[:border] = peaks[-border:] = False
    peaks[:, :border] = peaks[:, -border:] = False
    rows, columns = np.nonzero(peaks)
    order = np.argsort(-strength[rows, columns])[:_MAX_SADDLES]
    points = np.column_stack([columns[order], rows[order]]).astype(np.float32)
    if not len(points):
        return np.empty((0, 2))
    return _refined(smooth, points)


def _refined(smooth: NDArray[np.float32], points: NDArray[np.floating]) -> Floats:
    """Corners moved onto the saddle nearby; those that would move by more than 2 pixels stay."""
    import cv2

    start = np.ascontiguousarray(points, np.float32).reshape(-1, 1, 2)
    criteria = (cv2.TERM_CRITERIA_EPS | cv2.TERM_CRITERIA_MAX_ITER, 20, 0.01)
    moved = cv2.cornerSubPix(smooth, start.copy(), (3, 3), (-1, -1), criteria)
    far = np.linalg.norm(moved - start, axis=2) > 2.0
    return np.asarray(np.where(far[..., None], start, moved), float).reshape(-1, 2)


def _ring(points: Floats, radius: float) -> Floats:
    return points[:, None] + radius * np.column_stack([np.cos(_RING), np.sin(_RING)])


def sample(smooth: NDArray[np.float32], places: Floats) -> Floats:
    """The picture at (..., 2) places, bilinear."""
    from scipy.ndimage import map_coordinates

    rows_and_columns = np.moveaxis(places[..., ::-1], -1, 0)
    return np.asarray(map_coordinates(smooth, rows_and_columns, order=1, mode="nearest"), float)
