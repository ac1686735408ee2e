"""A gantry's arc as a source of camera poses and light positions."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
from numpy.typing import ArrayLike, NDArray

from capture.arrays import frozen_array

Floats = NDArray[np.float64]


def look_at(position: ArrayLike, target: ArrayLike, up: ArrayLike) -> Floats:
    """The 4x4 world_to_camera of a camera at `position` that looks at `target`, `up` upwards in its image.

    position, target : (3,) metres. up : (3,), need not be orthogonal to the line of sight but not along it.
    """
    eye, upwards = np.asarray(position, float), np.asarray(up, float)
    forward = np.asarray(target, float) - eye
    distance = np.linalg.norm(forward)
    right = np.cross(forward, upwards)
    # Not `<=`: a NaN must end here too.
    if not np.linalg.norm(right) > 1e-9 * distance * np.linalg.norm(upwards):
        raise ValueError(
            f"camera at {eye.tolist()} cannot look at {np.asarray(target).tolist()} with up"
            f" {upwards.tolist()}: it is there already, or looks along up"
        )
    forward /= distance
    right /= np.linalg.norm(right)
    rotation = np.stack([right, np.cross(forward, right), forward])
    pose = np.eye(4)
    pose[:3, :3] = rotation
    pose[:3, 3] = -rotation @ eye
    return pose


@dataclass(frozen=True, eq=False)
class Arc:
    """An arc that a camera or a light travels along.

    centre : (3,) metres. radius : metres, > 0.
    axis : (3,), any length; angles count counter-clockwise about it.
    start : (3,), any length, from the centre towards angle 0; made orthogonal to the axis.
    mount : (3, 3), the rotation from an inward-looking camera's frame, its image's up along the axis, to that of the
        camera as it is mounted; the identity for one that looks at the centre.
    step : angle in radians between neighbouring positions, where the arc has positions.
    """

    centre: Floats
    axis: Floats
    radius: float
    start: Floats
    mount: Floats = field(default_factory=lambda: np.eye(3))
    step: float | None = None

    def __post_init__(self) -> None:
        axis, start = np.asarray(self.axis, float), np.asarray(self.start, float)
        if np.linalg.norm(axis) == 0:
            raise ValueError("axis is the zero vector; give the direction that the arc turns about")
        axis = axis / np.linalg.norm(axis)
        across = start - axis * (start @ axis)
        if np.linalg.norm(across) <= 1e-9 * np.linalg.norm(start):
            raise ValueError("start is along the axis (or zero); give the direction to the arc's angle 0")
        if not self.radius > 0:
            raise ValueError(f"radius is {self.radius} m; it must be > 0")
        mount = np.asarray(self.mount, float)
        # As poses: 1e-3 admits rotations that were printed with four digits.
        if not np.allclose(mount @ mount.T, np.eye(3), atol=1e-3) or np.linalg.det(mount) < 0:
            raise ValueError("mount is not a rotation (its rows are not orthonormal, or it mirrors)")
        object.__setattr__(self, "centre", frozen_array(self.centre))
        object.__setattr__(self, "axis", frozen_array(axis))
        object.__setattr__(self, "start", frozen_array(across / np.linalg.norm(across)))
        object.__setattr__(self, "mount", frozen_array(mount))

    def position(self, angle: float) -> Floats:
        """The point (3,) at an angle in radians, metres."""
        outward = np.cos(angle) * self.start + np.sin(angle) * np.cross(self.axis, self.start)
        return np.asarray(self.centre + self.radius * outward)

    def pose(self, angle: float) -> Floats:
        """The 4x4 world_to_camera of the camera at an angle in radians."""
        pose = look_at(self.position(angle), self.centre, self.axis)
        pose[:3] = self.mount @ pose[:3]
        return pose
