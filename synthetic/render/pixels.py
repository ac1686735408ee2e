"""Which pixels see a surface, and at which points of them it is looked at."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from capture.camera import Camera
from synthetic.shapes.surface import Points, Surface

Floats = NDArray[np.float64]
Ints = NDArray[np.int64]

# Points per side where part of a pixel is covered: 256 steps, as an 8-bit mask stores them.
_FINE = (np.arange(16) + 0.5) / 16


def pixel_coverage(surface: Surface, camera: Camera) -> Floats:
    """Share of each pixel's square that the surface covers, (h, w), 0 to 1, in steps of 1/256.

    Pixels of which the corners, the middles of the sides and the middle agree are taken for wholly covered, or free.
    """
    coverage = np.zeros((camera.height, camera.width))
    near = _near(surface, camera)
    if not len(near):
        return coverage
    (left, top), (right, bottom) = near.min(axis=0), near.max(axis=0) + 1
    # Neighbours share the points on their borders: four per pixel.
    y, x = np.mgrid[2 * top : 2 * bottom + 1, 2 * left : 2 * right + 1] / 2
    hits = _hits(surface, camera, np.column_stack([x.ravel(), y.ravel()])).reshape(x.shape)
    nine = [hits[i : i - 2 or None : 2, j : j - 2 or None : 2] for i in range(3) for j in range(3)]
    some, all_ = np.any(nine, axis=0), np.all(nine, axis=0)
    coverage[top:bottom, left:right] = all_
    rows, columns = np.nonzero(some & ~all_)
    rows, columns = rows + top, columns + left
    points = _subsamples(np.column_stack([columns, rows]), _FINE)
    coverage[rows, columns] = _hits(surface, camera, points).reshape(len(rows), len(_FINE) ** 2).mean(axis=1)
    return coverage


def looked_at(
    surface: Surface, camera: Camera, pixels: Ints, per_side: int
) -> tuple[Ints, Ints, Floats, Points, Floats]:
    """Gauss-Legendre points of pixels (n, 2), given as (column, row), that see the surface, m in all.

    Returns, for each, which pixel it is in (m,), which of the per_side^2 points of it (m,), its weight in the pixel's
    mean (m,), the surface's point (m) and the direction from there to the viewer (m, 3).
    """
    node, weight = np.polynomial.legendre.leggauss(per_side)
    weights = np.outer(weight, weight).ravel() / 4
    origins, directions = camera_rays(surface, camera, _subsamples(pixels, (node + 1) / 2))
    hit, points = surface.first_hits(origins, directions)
    pixel, place = np.divmod(np.flatnonzero(hit), per_side**2)
    return pixel, place, weights[place], points, -directions[hit]


def camera_rays(surface: Surface, camera: Camera, points: Floats) -> tuple[Floats, Floats]:
    """Rays (n, 3), (n, 3) through image points (n, 2); orthographic ones begin before the surface."""
    origins, directions = camera.rays(points)
    if camera.is_orthographic:
        ahead = (surface.centre - origins) @ directions[0] if len(directions) else np.zeros(0)
        origins = origins + (ahead - 2 * surface.reach)[:, None] * directions
    return origins, directions


def _near(surface: Surface, camera: Camera) -> Ints:
    """Pixels (n, 2), (column, row), that may see the sphere around the surface."""
    y, x = np.mgrid[: camera.height, : camera.width]
    pixels = np.column_stack([x.ravel(), y.ravel()])
    origins, directions = camera_rays(surface, camera, pixels + 0.5)
    towards = surface.centre - origins
    along = (towards * directions).sum(axis=1)
    beside = np.linalg.norm(towards - along[:, None] * directions, axis=1)
    # A pixel's half diagonal, where the surface is.
    margin = 1.0 if camera.is_orthographic else along
    near: Ints = pixels[beside < surface.reach + margin * (1.5 / camera.focal_px)]
    return near


def _hits(surface: Surface, camera: Camera, points: Floats) -> NDArray[np.bool_]:
    """Whether the surface is seen at image points (n, 2)."""
    return surface.met(*camera_rays(surface, camera, points))


def _subsamples(pixels: Ints, steps: Floats) -> Floats:
    """Image points (n * s^2, 2), pixel by pixel: the grid of s `steps` (0 to 1) in each pixel (column, row)."""
    offsets = np.stack(np.meshgrid(steps, steps), axis=-1).reshape(-1, 2)
    return (pixels[:, None, :] + offsets).reshape(-1, 2)
