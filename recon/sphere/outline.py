"""Outlines of masks at sub-pixel accuracy, and what else of a mask locating an object needs."""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from capture.arrays import frozen_array

Floats = NDArray[np.float64]
Coverage = NDArray[np.float32]

# Pixels on either side of a crossing that show where in them the edge lies; feathered masks are wider than one.
_SIDE = 3
# Coverage beyond which a pixel counts as wholly inside, or wholly outside if less than its complement.
_WHOLE = 0.9
# A binary mask doesn't show at what coverage it was cut: anywhere in the middle third of a pixel, uniform.
_CUT_PX = 1 / (6 * 3**0.5)
# Share of an outline's crossings without a grey level from which on a mask counts as binary; antialiased ones have 0.2.
_BINARY = 0.5


@dataclass(frozen=True, eq=False)
class Silhouette:
    """What locating an object needs of its image, a thirtieth of a mask's size.

    points : (n, 2) of its outline, pixels. hidden_px : standard deviation of errors that they share, so that no
    scatter shows them. packed : of a mask, bits of the pixels at least half covered, row by row; None without one.
    shape : (height, width) of the image. edge_px : standard deviation by which the outline lies too far out, or in,
    all around, and those of the set's other photographs with it.
    """

    points: Floats
    hidden_px: float
    packed: NDArray[np.uint8] | None
    shape: tuple[int, int]
    edge_px: float = 0.0

    def __post_init__(self) -> None:
        object.__setattr__(self, "points", frozen_array(self.points))

    @property
    def covered(self) -> NDArray[np.bool_] | None:
        """Pixels (h, w) at least half covered by the object, as a mask says."""
        if self.packed is None:
            return None
        bits = np.unpackbits(self.packed, count=self.shape[0] * self.shape[1])
        return bits.reshape(self.shape).view(np.bool_)


def mask_silhouette(coverage: Coverage) -> Silhouette:
    """The silhouette that a mask (h, w) in 0 to 1 of something about as round as a disk shows.

    The edge of a binary mask is known to where in a pixel it was cut; that of one with grey levels is exact.
    """
    height, width = coverage.shape
    inside = coverage >= 0.5
    points = outline_points(coverage)
    if len(points):
        # Each point is a mean over a pixel's width of a curve; its middle lies further out, by the width^2 / 24 R.
        outward = points - points.mean(axis=0)
        outward /= np.linalg.norm(outward, axis=1, keepdims=True)
        radius = np.sqrt(inside.sum() / np.pi)
        points = points + outward / (24 * radius * np.abs(outward).max(axis=1, keepdims=True) ** 2)
    edge = _CUT_PX if _is_binary(coverage) else 0.0
    return Silhouette(points, 0.0, np.packbits(inside), (height, width), edge)


def _is_binary(coverage: Coverage) -> bool:
    """Whether a mask (h, w) passes from wholly inside to wholly outside without a grey level, nearly everywhere."""
    sharp = crossings = 0
    for one, other in ((coverage[:, 1:], coverage[:, :-1]), (coverage[1:], coverage[:-1])):
        at = (one >= 0.5) != (other >= 0.5)
        pair = np.sort([one[at], other[at]], axis=0)
        sharp += int(((pair[0] <= 1 - _WHOLE) & (pair[1] >= _WHOLE)).sum())
        crossings += int(at.sum())
    return sharp > _BINARY * crossings


def outline_points(coverage: Coverage) -> Floats:
    """Points where an object's outline passes, (n, 2) as (x, y) in pixels, first pixel's centre (0.5, 0.5).

    coverage : (h, w) in 0 to 1. One point per column where the outline is flat and one per row where it is steep:
    the covered share of the pixels across it adds up to where it is, to 0.05 / (radius of curvature) pixels. In a
    binary mask it lies halfway between pixels, whose error is uniform and free of bias. An object that is cut off
    by the image's edge has no outline there.
    """
    rows, columns = (np.flatnonzero((coverage >= 0.5).any(axis=axis)) for axis in (1, 0))
    if not len(rows):
        return np.zeros((0, 2))
    # A photograph is much larger than its object.
    first = np.maximum([rows[0] - _SIDE - 1, columns[0] - _SIDE - 1], 0)
    part = coverage[first[0] : rows[-1] + _SIDE + 2, first[1] : columns[-1] + _SIDE + 2]
    smooth = cv2.GaussianBlur(np.ascontiguousarray(part), (0, 0), 1.0, borderType=cv2.BORDER_REPLICATE)
    steepness = np.abs(cv2.Sobel(smooth, cv2.CV_32F, 1, 0)) - np.abs(cv2.Sobel(smooth, cv2.CV_32F, 0, 1))
    across = _crossings(part, steepness)
    down = _crossings(part.T, -steepness.T)[:, ::-1]
    return np.concatenate([across, down]) + first[::-1]


def _crossings(coverage: Coverage, steepness: Coverage) -> Floats:
    """Points (n, 2) where rows of coverage (h, w) pass one half and the outline is steep: `steepness` >= 0."""
    inside = coverage >= 0.5
    row, column = np.nonzero(inside[:, 1:] != inside[:, :-1])
    wanted = steepness[row, column] + steepness[row, column + 1] >= 0
    # Where the image ends within reach the share is not known.
    wanted &= (column + 1 >= _SIDE) & (column + 1 + _SIDE <= coverage.shape[1])
    row, column = row[wanted], column[wanted]
    values = coverage[row[:, None], column[:, None] + np.arange(1 - _SIDE, 1 + _SIDE)].astype(float)
    sign = np.where(inside[row, column], 1.0, -1.0)
    values = np.where(sign[:, None] > 0, values, values[:, ::-1])  # the object's side first
    inner, outer = values[:, 0], values[:, -1]
    last, next_ = values[:, _SIDE - 1], values[:, _SIDE]
    between = (last - 0.5) / (last - next_) - 0.5
    share = (values.sum(axis=1) - 2 * _SIDE * outer) / np.where(inner > outer, inner - outer, 1.0) - _SIDE
    # Thin parts and wide feathers have no whole pixel within reach: interpolated between the two nearest.
    whole = (inner >= _WHOLE) & (outer <= 1 - _WHOLE)
    return np.column_stack([column + 1 + sign * np.where(whole, share, between), row + 0.5])


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
    return largest_filled(bright)


def largest_filled(bright: NDArray[np.uint8]) -> NDArray[np.float32]:
    """Coverage (h, w), 0 or 1, of the largest connected region of nonzero pixels (h, w), its holes filled."""
    contours, _ = cv2.findContours(bright, cv2.RETR_EXTERNAL, cv2.CHAIN_APPROX_NONE)
    filled = np.zeros_like(bright)
    if contours:
        cv2.drawContours(filled, [max(contours, key=cv2.contourArea)], -1, 1, thickness=cv2.FILLED)
    return filled.astype(np.float32)
