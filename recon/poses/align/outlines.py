"""Outlines of masks as the alignment needs them: points, outward normals, and which of them err together."""

from __future__ import annotations

from dataclasses import dataclass, replace

import cv2
import numpy as np
from numpy.typing import NDArray

from capture.arrays import frozen_array
from capture.camera import Camera
from recon.sphere.outline import outline_points

Floats = NDArray[np.float64]
Coverage = NDArray[np.float32]

# An object that the image's edge cuts off ends there in the mask, not in the world; pixels from the edge that count
# as such.
_BORDER = 2.0
# Pixels over which a mask is smoothed for the direction of its outline: binary masks are steps.
_SMOOTH_PX = 1.5
# Pieces of the outline, by direction from its middle, within which errors of a mask are taken to go together.
SECTORS = 12
# Pixels along either side of the grid on which mask and mesh are compared as areas.
_GRID = 60


@dataclass(frozen=True, eq=False)
class Outline:
    """The outline of the object in one photograph.

    points : (n, 2) pixels. normals : (n, 2) unit, out of the object. sectors : (n,) int, 0 to SECTORS - 1.
    radius : half the diagonal of the box around the points, pixels. whole : false if the image's edge cuts the
    object off. grid : (m, 2) pixels spread over the object and around it, inside : (m,) whether the mask covers them.
    """

    camera: Camera
    points: Floats
    normals: Floats
    sectors: NDArray[np.int64]
    radius: float
    whole: bool
    grid: Floats
    inside: NDArray[np.bool_]

    def __post_init__(self) -> None:
        object.__setattr__(self, "points", frozen_array(self.points))
        object.__setattr__(self, "normals", frozen_array(self.normals))
        object.__setattr__(self, "sectors", frozen_array(self.sectors, np.int64))
        object.__setattr__(self, "grid", frozen_array(self.grid))
        object.__setattr__(self, "inside", frozen_array(self.inside, np.bool_))

    def thinned(self, count: int) -> Outline:
        """At most so many of the points, the same ones each time."""
        if len(self.points) <= count:
            return self
        # In the order of pixels every second point would be of one side only.
        keep = np.sort(np.random.default_rng(0).permutation(len(self.points))[:count])
        return replace(self, points=self.points[keep], normals=self.normals[keep], sectors=self.sectors[keep])


def outline_of(camera: Camera, coverage: Coverage) -> Outline:
    """The outline of a mask.

    coverage : (h, w) in 0 to 1. ValueError if it has no outline to speak of inside the image.
    """
    points = outline_points(coverage)
    size = np.array([camera.width, camera.height])
    inner = ((points > _BORDER) & (points < size - _BORDER)).all(axis=1)
    rim = np.concatenate([coverage[0], coverage[-1], coverage[:, 0], coverage[:, -1]])
    points = points[inner]
    if len(points) < 24:
        raise ValueError(
            f"the mask's outline has {len(points)} points within the image, and 24 are the least: the object is too"
            " small, or fills the image"
        )
    radius = float(np.hypot(*np.ptp(points, axis=0)) / 2)
    smooth = cv2.GaussianBlur(
        coverage, (0, 0), max(_SMOOTH_PX, radius / 100), borderType=cv2.BORDER_REPLICATE
    )
    # OpenCV's first pixel is centred at (0, 0), and its loop over pixels takes no more than 32767 in a row.
    across, down = (points - 0.5).astype(np.float32).T.reshape(2, -1, 1)
    slopes = [
        _sampled(np.asarray(cv2.Sobel(smooth, cv2.CV_32F, *order, ksize=3), np.float32), across, down)
        for order in ((1, 0), (0, 1))
    ]
    normals = -np.column_stack(slopes).astype(np.float64)
    lengths = np.linalg.norm(normals, axis=1)
    # Specks that smoothing levels have no direction.
    clear = lengths > 1e-3 * lengths.max()
    points, normals = points[clear], normals[clear] / lengths[clear, None]
    offset = points - points.mean(axis=0)
    sectors = (
        np.floor((np.arctan2(offset[:, 1], offset[:, 0]) / (2 * np.pi) % 1) * SECTORS).astype(int) % SECTORS
    )
    grid = _grid(points, size)
    column, row = np.floor(grid).astype(int).T
    whole = not (rim >= 0.5).any()
    return Outline(camera, points, normals, sectors, radius, whole, grid, coverage[row, column] >= 0.5)


def _grid(points: Floats, size: NDArray[np.integer]) -> Floats:
    """Centres of pixels (m, 2) on a grid over the points and a quarter of their extent around them."""
    low, high = points.min(axis=0), points.max(axis=0)
    margin = (high - low) / 4
    axes = [
        np.unique(np.linspace(a, b, _GRID).round()) + 0.5
        for a, b in zip(np.maximum(low - margin, 0), np.minimum(high + margin, size - 1), strict=True)
    ]
    return np.stack(np.meshgrid(*axes), axis=-1).reshape(-1, 2)


def _sampled(image: Coverage, across: Coverage, down: Coverage) -> Coverage:
    """Values (n,) of an image between its pixels."""
    rows = range(0, len(across), 30_000)
    parts = [
        cv2.remap(image, across[row : row + 30_000], down[row : row + 30_000], cv2.INTER_LINEAR).ravel()
        for row in rows
    ]
    return np.concatenate(parts)
