"""Lat-long maps of what views of a mirror ball show, and their blending into one.

A view places a direction with an error of so many pixels (its outline, the lens' blur), which the reflection
stretches: in the middle of the ball a pixel turns the direction by 2 / r, at its rim without bound. Weights are the
inverse of that error's variance, and fade towards what isn't used, so that views join without a seam.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from capture.arrays import frozen_array
from capture.lighting import latlong_directions, latlong_solid_angles
from recon.mirrorball.reflection import mirroring_points
from recon.mirrorball.view import BallView

Floats = NDArray[np.float64]
Mask = NDArray[np.bool_]

# Most samples along each side of a map pixel; beyond, they would only average the sensor's noise.
_MAX_SUPERSAMPLING = 8
# Width of the fade, as a share of the ball's radius.
_FADE = 0.06
# Weight of saturated light relative to other: it counts only where nothing else is there.
_SATURATED = 1e-6


@dataclass(frozen=True, eq=False)
class ViewMap:
    """One view as a lat-long map.

    radiance : (H, 2H, 3) float32, without sources; zero where nothing was seen. covered, saturated : (H, 2H),
    shares of each map pixel that were seen, and that were seen saturated. weight : (H, 2H), 1 / rad^2; zero
    where nothing was seen.
    """

    radiance: NDArray[np.float32]
    covered: Floats
    saturated: Floats
    weight: Floats

    def __post_init__(self) -> None:
        object.__setattr__(self, "radiance", frozen_array(self.radiance, np.float32))
        for name in ("covered", "saturated", "weight"):
            object.__setattr__(self, name, frozen_array(getattr(self, name)))


def view_map(view: BallView, height: int, hidden: Sequence[tuple[Floats, float]] = ()) -> ViewMap:
    """What a view of a mirror ball shows, as a lat-long map of `height` rows.

    hidden : discs of directions, (axis (3,) unit, half-angle in radians), in which the view is not used.

    Samples lie on an equal-area grid within each map pixel, as dense as the ball's own pixels, so that a
    map pixel is the mean over the ball pixels that mirror it.
    """
    per_side = int(np.clip(np.ceil(np.pi / height * view.radius_px / 2), 3, _MAX_SUPERSAMPLING))
    offsets = (np.arange(per_side) + 0.5) / per_side
    edges = np.cos(np.arange(height + 1) * np.pi / height)
    z = edges[:-1, None] + np.diff(edges)[:, None] * offsets
    phi = (np.arange(2 * height)[:, None] + offsets) * np.pi / height
    usable, weights = _weights(view, hidden)
    image = np.dstack([view.without_sources, weights]).astype(np.float32)
    saturated = view.pixels.saturated & ~view.in_source
    radiance = np.zeros((height, 2 * height, 3))
    covered, clipped, weight = np.zeros((3, height, 2 * height))
    grid = (per_side, 2 * height, per_side)
    for row in range(height):
        directions = _directions(z[row][:, None, None], phi).reshape(-1, 3)
        visible, points = mirroring_points(view.sphere, view.camera, directions)
        points = np.where(visible[:, None], points - view.corner, -1.0)
        column, line = np.floor(points).astype(int).T
        inside = (column >= 0) & (line >= 0) & (column < usable.shape[1]) & (line < usable.shape[0])
        inside[inside] = usable[line[inside], column[inside]]
        # OpenCV puts the first pixel's centre at (0, 0), the camera at (0.5, 0.5).
        at = np.where(inside[:, None], points - 0.5, 0.0).astype(np.float32)
        values = cv2.remap(
            image, at[:, None, 0], at[:, None, 1], cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE
        )
        sums = (values.reshape(-1, 4) * inside[:, None]).reshape(*grid, 4).sum(axis=(0, 2))
        count = inside.reshape(grid).sum(axis=(0, 2))
        lost = inside.copy()
        lost[inside] = saturated[line[inside], column[inside]]
        radiance[row] = sums[:, :3] / np.maximum(count, 1)[:, None]
        weight[row] = sums[:, 3] / per_side**2
        covered[row] = count / per_side**2
        clipped[row] = lost.reshape(grid).sum(axis=(0, 2)) / per_side**2
    return ViewMap(radiance.astype(np.float32), covered, clipped, weight)


def blend(maps: Sequence[ViewMap]) -> ViewMap:
    """Views of one light as one map: their mean, weighted."""
    covered = np.max([each.covered for each in maps], axis=0)
    # Saturated in all that see it at all.
    saturated = np.min([np.where(each.covered > 0, each.saturated, np.inf) for each in maps], axis=0)
    weights = [each.weight * (1 - each.saturated / np.maximum(each.covered, 1e-12)) for each in maps]
    weights = [w + _SATURATED * each.weight for w, each in zip(weights, maps, strict=True)]
    total = np.sum(weights, axis=0)
    radiance = np.sum([w[..., None] * each.radiance for w, each in zip(weights, maps, strict=True)], axis=0)
    return ViewMap(
        radiance=radiance / np.where(total > 0, total, 1.0)[..., None],
        covered=covered,
        saturated=np.where(covered > 0, saturated, 0.0),
        weight=total,
    )


def filled(blended: ViewMap) -> tuple[NDArray[np.float32], Mask]:
    """The map (H, 2H, 3) with what was not seen filled in, and the mask (H, 2H) of what was seen.

    What wasn't seen takes the mean over the seen pixels that are nearest in direction.
    """
    seen = (blended.covered >= 0.5) & (blended.weight > 0)
    radiance = np.array(blended.radiance)
    if seen.any() and not seen.all():
        directions = latlong_directions(len(radiance))
        count = min(8, int(seen.sum()))
        _, nearest = cKDTree(directions[seen]).query(directions[~seen], k=count)
        radiance[~seen] = radiance[seen][nearest.reshape(-1, count)].mean(axis=1)
    return radiance, seen


def share(portion: Floats) -> float:
    """Share of the sphere of directions, of shares (H, 2H) of each pixel of a lat-long map."""
    return float((portion * latlong_solid_angles(len(portion))).sum() / (4 * np.pi))


def _weights(view: BallView, hidden: Sequence[tuple[Floats, float]]) -> tuple[Mask, Floats]:
    """The pixels (h, w) of a view that its map is made from, and their weights (h, w) in 1 / rad^2."""
    usable = view.in_map.copy()
    for axis, half_angle in hidden:
        usable &= view.pixels.directions @ axis < np.cos(half_angle)
    away = cv2.distanceTransform(usable.astype(np.uint8), cv2.DIST_L2, cv2.DIST_MASK_PRECISE)
    fade = np.minimum(away / max(2.0, _FADE * view.radius_px), 1.0)
    stretch = np.where(usable, view.pixels.stretch, np.inf)
    return usable, np.where(usable, fade / np.maximum(stretch, 1e-12) ** 2, 0.0)


def _directions(z: Floats, phi: Floats) -> Floats:
    """Unit directions (..., 3) of heights z above the equator and azimuths phi, broadcast."""
    z, phi = np.broadcast_arrays(z, phi)
    ring = np.sqrt(1 - z**2)
    return np.stack([ring * np.cos(phi), ring * np.sin(phi), z], axis=-1)
