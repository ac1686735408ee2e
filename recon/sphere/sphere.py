"""A sphere in the world: where rays meet it, and its outline in images."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from capture.arrays import frozen_array
from capture.camera import Camera

Floats = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class Sphere:
    """A sphere in the world.

    centre : (3,) metres. radius : metres.
    covariance : (4, 4) of (centre, radius), metres^2, from how the outlines disagree with it; zero where given.
        From one viewpoint the distance (and with it the size) is free: it is a gauge that no distant
        light can reveal, and its variance counts as zero here.
    residual_px : per photo with an outline, robust RMS distance of that from the sphere's.
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
        # Sums of products over an axis as short as this take three times as long.
        along = np.einsum("nc,nc->n", offset, directions)
        gap = offset - along[:, None] * directions
        inside = self.radius**2 - np.einsum("nc,nc->n", gap, gap)
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


def to_camera(sphere: Sphere, camera: Camera) -> tuple[Floats, float]:
    """The unit direction (3,) from the sphere to the camera, and the sphere's radius over their distance."""
    if camera.is_orthographic:
        return -camera.camera_to_world[:3, 2], 0.0
    offset = camera.centre - sphere.centre
    distance = float(np.linalg.norm(offset))
    return offset / distance, sphere.radius / distance


def sphere_outline(sphere: Sphere, camera: Camera, count: int) -> Floats:
    """Image points (count, 2) around a sphere's outline: the circle in which the camera's rays touch it."""
    axis, nearness = to_camera(sphere, camera)
    return camera.project(
        sphere.centre + sphere.radius * cone(axis, np.arccos(nearness), np.arange(count) * 2 * np.pi / count)
    )


def cone(axis: Floats, half_angle: float, turn: Floats) -> Floats:
    """Unit directions (n, 3) at an angle from an axis, at the angles `turn` (n,) around it."""
    first = np.cross(axis, np.eye(3)[np.argmin(np.abs(axis))])
    first /= np.linalg.norm(first)
    second = np.cross(axis, first)
    around = np.cos(turn)[:, None] * first + np.sin(turn)[:, None] * second
    return np.asarray(np.cos(half_angle) * axis + np.sin(half_angle) * around)
