"""Outlines of masks at sub-pixel accuracy, and a first mask where none is given."""

from __future__ import annotations

import cv2
import numpy as np
from numpy.typing import NDArray


def outline_points(coverage: NDArray[np.float32]) -> NDArray[np.float64]:
    """Points where coverage crosses one half, (n, 2) as (x, y) in pixels, first pixel's centre (0.5, 0.5).

    coverage : (h, w) in 0 to 1. Between neighbouring pixel centres the crossing is interpolated; in a
    binary mask it falls halfway, whose error is uniform and free of bias. An object that is cut off by
    the image's edge has no outline there.
    """
    inside = coverage >= 0.5
    points = []
    for axis in (0, 1):
        first = np.delete(coverage, -1, axis)
        second = np.delete(coverage, 0, axis)
        crossing = np.delete(inside, -1, axis) != np.delete(inside, 0, axis)
        row, column = np.nonzero(crossing)
        fraction = (0.5 - first[crossing]) / (second[crossing] - first[crossing])
        shift = np.zeros((len(row), 2))
        shift[:, 1 - axis] = fraction
        points.append(np.column_stack([column, row]) + 0.5 + shift)
    return np.concatenate(points)


def largest_blob(radiance: NDArray[np.float32]) -> NDArray[np.float32]:
    """Coverage (h, w), 0 or 1, of the largest bright region of a photograph on a darker background.

    radiance : (h, w, 3). Otsu's threshold on the square root of the luminance; holes are filled.
    """
    luminance = np.sqrt(np.clip(radiance.mean(axis=2), 0, None))
    peak = luminance.max()
    if not peak > 0:
        return np.zeros(luminance.shape, np.float32)
    codes = np.round(luminance / peak * 255).astype(np.uint8)
    _, bright = cv2.threshold(codes, 0, 255, cv2.THRESH_BINARY + cv2.THRESH_OTSU)
    contours, _ = cv2.findContours(bright, cv2.RETR_EXTERNAL, cv2.CHAIN_APPROX_NONE)
    filled = np.zeros_like(bright)
    if contours:
        cv2.drawContours(filled, [max(contours, key=cv2.contourArea)], -1, 1, thickness=cv2.FILLED)
    return filled.astype(np.float32)
