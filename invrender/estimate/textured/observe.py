"""What a photograph says of points of a surface: its usable pixels, interpolated where it sees them."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from capture.camera import Camera
from invrender.estimate.textured.layout import SurfacePoints
from recon.mesh.bodies import Body
from recon.sampling.draw import MIN_COS_EXITANT
from recon.sampling.lightfield import LightField

Floats = NDArray[np.float64]
Ints = NDArray[np.int64]

# Of all points of a surface one photograph sees about this share, several times less those at grazing angles.
_SEEN_SHARE = 0.25
# A pixel's middle may lie this far, in pixels, off the plane that touches the surface at a point, to show its surface.
_OFF = 1.0


@dataclass(frozen=True, eq=False)
class PointObservations:
    """Points that a photograph sees, by its samples around them.

    points : (r,) numbers of the points, each once. samples : (r, 4) of the light field, around each. weights : (r, 4),
    with which these are interpolated: sum 1. A texture is taken for constant over these four pixels.
    """

    points: Ints
    samples: Ints
    weights: Floats

    def __len__(self) -> int:
        return len(self.points)

    @property
    def nearest(self) -> Ints:
        """The sample next to each point, (r,)."""
        return np.asarray(self.samples[np.arange(len(self)), self.weights.argmax(axis=1)])

    def at_points(self, values: NDArray[np.floating]) -> Floats:
        """Values (n, ...) of samples interpolated to the points, (r, ...)."""
        return np.asarray(np.einsum("rk,rk...->r...", self.weights, values[self.samples]))

    def variance_share(self) -> Floats:
        """Variance of an interpolated value over that of a sample, (r,), samples being independent."""
        return np.asarray((self.weights**2).sum(axis=1))

    def of_samples(self, count: int) -> NDArray[np.bool_]:
        """Which of the field's samples (count,) are used."""
        used = np.zeros(count, bool)
        used[self.samples] = True
        return used

    def where(self, keep: NDArray[np.bool_]) -> PointObservations:
        """Those of points that are marked (r,)."""
        return PointObservations(self.points[keep], self.samples[keep], self.weights[keep])

    def renumbered(self, used: NDArray[np.bool_]) -> PointObservations:
        """The same, of a field of which only the used samples are kept."""
        return PointObservations(self.points, (np.cumsum(used) - 1)[self.samples], self.weights)


def points_for(samples: int, photographs: int) -> int:
    """How many points of a surface so many photographs show in about so many samples."""
    return int(samples / (_SEEN_SHARE * photographs)) + 1


def squares_seen(camera: Camera, points: SurfacePoints) -> Ints:
    """Row and column (n, 2) of the upper left of the four pixels around each point that faces the camera.

    What may lie before a point isn't looked at.
    """
    return np.floor(_facing(camera, points)[1]).astype(int)[:, ::-1]


def _facing(camera: Camera, points: SurfacePoints) -> tuple[Ints, Floats, Floats]:
    """The numbers (n,) of points that face the camera, their places from the first pixel's centre, and all views."""
    views = camera.views(points.positions)
    facing = (points.normals * views).sum(axis=1) >= MIN_COS_EXITANT
    seen = np.flatnonzero(facing & ((points.facets * views).sum(axis=1) > 0))
    pixels = camera.project(points.positions[seen]) - 0.5
    edge = np.array([camera.width - 1, camera.height - 1])
    # What isn't finite lies behind the camera.
    within = np.isfinite(pixels).all(axis=1) & (pixels >= 0).all(axis=1) & (pixels < edge).all(axis=1)
    return seen[within], pixels[within], views


def observe(body: Body, camera: Camera, field: LightField, points: SurfacePoints) -> PointObservations:
    """The points that a photograph shows, and which of its samples around them show them.

    field : its usable pixels, at least those of `squares_seen`. A point counts if the camera sees it at an exitant
    angle of up to 81 degrees, and all four pixels around it are samples that show the surface there, not another part
    of the object before or behind it.
    """
    number = np.full((camera.height + 2, camera.width + 2), -1)
    number[field.rows, field.columns] = np.arange(len(field))
    seen, pixels, views = _facing(camera, points)
    column, row = np.floor(pixels).astype(int).T
    across, down = (pixels - np.floor(pixels)).T
    samples = np.stack([number[row + i, column + j] for i in (0, 1) for j in (0, 1)], axis=1)
    weights = np.stack(
        [a * b for a in (1 - down, down) for b in (1 - across, across)],
        axis=1,
    )
    whole = (samples >= 0).all(axis=1)
    seen, samples, weights = seen[whole], samples[whole], weights[whole]
    # Positions at the pixels' middles, each the mean over its rays.
    at = np.asarray(field.mean_over_rays(field.positions))
    per_metre = (
        np.full(len(seen), camera.focal_px)
        if camera.is_orthographic
        else camera.focal_px / camera.depth(points.positions[seen])
    )
    off = ((at[samples] - points.positions[seen, None]) * points.normals[seen, None]).sum(axis=2)
    near = (np.abs(off) * per_metre[:, None] < _OFF).all(axis=1)
    seen, samples, weights = seen[near], samples[near], weights[near]
    free = body.visible(points.positions[seen], points.facets[seen], views[seen])
    return PointObservations(seen[free], samples[free], weights[free])
