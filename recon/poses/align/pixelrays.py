"""Distances in pixels between points of the world and points of photographs, for every kind of camera."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from capture.arrays import frozen_array
from capture.camera import Camera

Floats = NDArray[np.float64]

# Pixels over which rays are differentiated: lenses are smooth, and rounding is 1e-13.
_STEP = 0.5


@dataclass(frozen=True, eq=False)
class PixelRays:
    """Rays through n image points, and what a pixel is there.

    origins, directions : (n, 3) world, unit directions.
    across : (n, 2, 3), pixels to the right and down per unit of a point's distance from the ray at depth 1 (at any
        depth where parallel). parallel : (n,) bool, rays of orthographic cameras, which have no beginning.
    """

    origins: Floats
    directions: Floats
    across: Floats
    parallel: NDArray[np.bool_]

    def __post_init__(self) -> None:
        for name in ("origins", "directions", "across"):
            object.__setattr__(self, name, frozen_array(getattr(self, name)))
        object.__setattr__(self, "parallel", frozen_array(self.parallel, np.bool_))

    def __len__(self) -> int:
        return len(self.origins)

    def depths(self, points: Floats) -> Floats:
        """How far along each ray the point (n, 3) that belongs to it lies, (n,); negative behind a camera."""
        return np.einsum("nc,nc->n", points - self.origins, self.directions)

    def offsets(self, points: Floats) -> tuple[Floats, Floats]:
        """Pixels (n, 2) from each image point to where its world point (n, 3) is seen, and their Jacobian (n, 2, 3).

        Exact where they agree; the lens is taken as straight over the distance. Points behind a perspective camera
        count as seen in front of it.
        """
        per_depth = 1 / np.where(self.parallel, 1, self.depths(points))
        # No ratio of a point in the camera's own plane.
        per_depth = np.clip(per_depth, -1e12, 1e12)
        pixels = np.einsum("nkc,nc->nk", self.across, points - self.origins) * per_depth[:, None]
        turned = np.where(self.parallel, 0, per_depth)[:, None, None] * self.directions[:, None, :]
        return pixels, self.across * per_depth[:, None, None] - pixels[:, :, None] * turned

    def of(self, chosen: NDArray[np.integer] | NDArray[np.bool_]) -> PixelRays:
        """Some of the rays."""
        return PixelRays(
            self.origins[chosen], self.directions[chosen], self.across[chosen], self.parallel[chosen]
        )


def pixel_rays(camera: Camera, pixels: Floats) -> PixelRays:
    """Rays through image points (n, 2) of a camera, pixels; ValueError where its distortion reaches no such point."""
    origins, directions = camera.rays(pixels)
    slopes = []
    for axis in (0, 1):
        step = np.zeros(2)
        step[axis] = _STEP
        (o1, d1), (o0, d0) = camera.rays(pixels + step), camera.rays(pixels - step)
        slopes.append(((o1 - o0) if camera.is_orthographic else (d1 - d0)) / (2 * _STEP))
    right, down = slopes
    if not all(np.isfinite(part).all() for part in (directions, right, down)):
        raise ValueError(
            "the camera's distortion cannot be undone at a mask's outline or a pick; check its params"
        )
    # Rows of the pseudo-inverse of (right, down): pixels per unit.
    rr, rd, dd = (
        np.einsum("nc,nc->n", a, b)[:, None] for a, b in ((right, right), (right, down), (down, down))
    )
    area = rr * dd - rd**2
    across = np.stack([(dd * right - rd * down) / area, (rr * down - rd * right) / area], axis=1)
    return PixelRays(origins, directions, across, np.full(len(origins), camera.is_orthographic))


def from_one_place(centres: Floats) -> bool:
    """Whether cameras' centres (n, 3) are one and the same, but for rounding."""
    return bool(np.ptp(centres, axis=0).max() <= 1e-6 * np.abs(centres).max())


def joined(rays: Sequence[PixelRays]) -> PixelRays:
    """Rays of several photographs in one, in their order."""
    origins, directions, across = (
        np.concatenate([getattr(part, name) for part in rays]) for name in ("origins", "directions", "across")
    )
    return PixelRays(origins, directions, across, np.concatenate([part.parallel for part in rays]))
