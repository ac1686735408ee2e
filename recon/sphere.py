"""A sphere's centre and radius from its silhouettes.

The rays through a sphere's outline touch it, so the distance from the centre to each such ray is the
radius. That one statement holds for every camera, perspective (where the outline is an ellipse) or
orthographic, and joins any number of views in one least-squares problem.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import least_squares

from capture.arrays import frozen_array
from capture.camera import Camera
from recon.outline import outline_points

Floats = NDArray[np.float64]

# Outline points per photo that enter the fit: beyond a few hundred the pixel grid's error is averaged out.
_POINTS_PER_PHOTO = 400


@dataclass(frozen=True, eq=False)
class Sphere:
    """A sphere in the world.

    centre : (3,) metres. radius : metres.
    covariance : (4, 4) of (centre, radius), metres^2, from the outlines' residuals; zero where given.
        From one viewpoint the distance (and with it the size) is free: it is a gauge that no distant
        light can reveal, and its variance counts as zero here.
    residual_px : per photo, robust RMS distance of the outline from the sphere's; empty where given.
    """

    centre: Floats
    radius: float
    covariance: Floats
    residual_px: tuple[float, ...] = ()

    def __post_init__(self) -> None:
        if not self.radius > 0:
            raise ValueError(f"sphere radius is {self.radius}; it must be > 0")
        object.__setattr__(self, "centre", frozen_array(self.centre))
        object.__setattr__(self, "covariance", frozen_array(self.covariance))

    def hits(self, origins: Floats, directions: Floats) -> tuple[NDArray[np.bool_], Floats]:
        """Where rays enter the sphere.

        origins, directions : (n, 3), directions unit. Returns a mask (n,) of rays whose line meets it and the
        outward normals (n, 3) where the line enters, zero elsewhere. The line counts on both sides of its
        origin, because an orthographic ray has no beginning: whether a sphere lies in front of a perspective
        camera is the caller's question.
        """
        offset = self.centre - origins
        along = (offset * directions).sum(axis=1)
        gap = offset - along[:, None] * directions
        inside = self.radius**2 - (gap**2).sum(axis=1)
        hit = inside > 0
        normals = np.zeros_like(directions)
        depth = np.sqrt(inside[hit])
        normals[hit] = (-gap[hit] - depth[:, None] * directions[hit]) / self.radius
        return hit, normals

    def pixel_radius(self, camera: Camera) -> float:
        """Radius of the outline in pixels (perspective: at the image centre)."""
        if camera.is_orthographic:
            return self.radius * camera.focal_px
        distance = float(np.linalg.norm(self.centre - camera.centre))
        return camera.focal_px * self.radius / np.sqrt(max(distance**2 - self.radius**2, 1e-30))


def fit_sphere(
    cameras: Sequence[Camera],
    coverages: Sequence[NDArray[np.float32]],
    centre: Sequence[float] | None = None,
    radius: float | None = None,
) -> Sphere:
    """Fit a sphere to its masks, one per camera; what is given is kept.

    coverages : (h, w) in 0 to 1 each. centre : (3,) metres or None. radius : metres or None.
    The loss is robust, so that a stand which the mask includes bends the result little.
    """
    outlines = [_thinned(outline_points(coverage)) for coverage in coverages]
    rays = [camera.rays(points) for camera, points in zip(cameras, outlines, strict=True)]
    if not all(np.isfinite(directions).all() for _, directions in rays):
        raise ValueError("the camera's distortion cannot be undone at the mask's outline; check its params")
    guess = _first_guess(cameras, coverages, radius)
    if centre is not None:
        guess[:3] = centre
    if radius is not None:
        guess[3] = radius
    free = np.array([centre is None] * 3 + [radius is None])
    origins = np.concatenate([o for o, _ in rays])
    directions = np.concatenate([d for _, d in rays])
    focal = _per_ray([camera.focal_px for camera in cameras], rays)
    parallel = _per_ray([camera.is_orthographic for camera in cameras], rays)

    def residuals(parameters: Floats) -> Floats:
        full = guess.copy()
        full[free] = parameters
        offset = full[:3] - origins
        along = (offset * directions).sum(axis=1)
        distance = np.linalg.norm(offset - along[:, None] * directions, axis=1)
        per_metre = focal / np.where(parallel, 1.0, np.maximum(np.abs(along), 1e-12))
        return (distance - full[3]) * per_metre

    covariance = np.zeros((4, 4))
    full = guess.copy()
    if free.any():
        size = np.maximum(np.abs(guess[free]), guess[3])
        # First a loss that finds its way from afar, then one that forgets what is far off.
        fit = least_squares(residuals, guess[free], loss="soft_l1", x_scale=size)
        fit = least_squares(residuals, fit.x, loss="cauchy", x_scale=size)
        full[free] = fit.x
        weight = 1 / (1 + fit.fun**2)
        variance = float((weight * fit.fun**2).sum() / weight.sum())
        block = np.linalg.pinv(fit.jac.T @ fit.jac, rcond=1e-9, hermitian=True) * variance
        covariance[np.ix_(free, free)] = block
    ends = np.cumsum([len(points) for points in outlines])[:-1]
    # As robust as the fit: 1.4826 median absolute residual is the RMS of Gaussian ones.
    per_photo = tuple(float(1.4826 * np.median(np.abs(r))) for r in np.split(residuals(full[free]), ends))
    return Sphere(full[:3], float(abs(full[3])), covariance, per_photo)


def _per_ray(values: Sequence[float], rays: Sequence[tuple[Floats, Floats]]) -> NDArray[Any]:
    """Each photo's value repeated for each of its rays."""
    return np.repeat(values, [len(origins) for origins, _ in rays])


def _thinned(points: Floats) -> Floats:
    if len(points) < 12:
        raise ValueError(
            "the mask's outline has fewer than 12 points; the object is too small or fills the image"
        )
    # Along the outline, not in the pixels' order: there every second point may be of one side only.
    offset = points - points.mean(axis=0)
    points = points[np.argsort(np.arctan2(offset[:, 1], offset[:, 0]))]
    return points[np.linspace(0, len(points) - 1, min(len(points), _POINTS_PER_PHOTO)).astype(int)]


def _first_guess(
    cameras: Sequence[Camera], coverages: Sequence[NDArray[np.float32]], radius: float | None
) -> Floats:
    """Centre and radius from the masks' centroids and areas: axes through the centroids, intersected."""
    axes, sizes = [], []
    for camera, coverage in zip(cameras, coverages, strict=True):
        row, column = np.nonzero(coverage >= 0.5)
        centroid = np.array([[column.mean() + 0.5, row.mean() + 0.5]])
        origin, direction = camera.rays(centroid)
        axes.append((origin[0], direction[0]))
        sizes.append(np.sqrt(len(row) / np.pi) / camera.focal_px)
    # Distance along the first axis that holds if the axes say nothing of it: all views from one place.
    if cameras[0].is_orthographic:
        depth = float(-axes[0][0] @ axes[0][1])
    else:
        depth = radius / sizes[0] if radius is not None else float(np.linalg.norm(cameras[0].centre)) or 1.0
    start = axes[0][0] + depth * axes[0][1]
    weak = 1e-6
    matrix = weak * np.eye(3)
    vector = weak * start
    for origin, direction in axes:
        across = np.eye(3) - np.outer(direction, direction)
        matrix += across
        vector += across @ origin
    centre = np.linalg.solve(matrix, vector)
    spans = [
        size if camera.is_orthographic else size * float(np.linalg.norm(centre - camera.centre))
        for camera, size in zip(cameras, sizes, strict=True)
    ]
    return np.append(centre, np.median(spans))
