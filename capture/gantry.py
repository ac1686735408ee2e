"""A gantry arc as a source of camera poses."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike, NDArray


def look_at(position: ArrayLike, target: ArrayLike, up: ArrayLike) -> NDArray[np.float64]:
    """The 4x4 world_to_camera of a camera at `position` that looks at `target`, `up` pointing up in the image.

    position, target : (3,) metres. up : (3,), need not be orthogonal to the line of sight but not along it.
    """
    position, target, up = (np.asarray(v, float) for v in (position, target, up))
    forward = target - position
    distance = np.linalg.norm(forward)
    right = np.cross(forward, up)
    if distance == 0 or np.linalg.norm(right) < 1e-9 * distance * np.linalg.norm(up):
        raise ValueError(f"camera at {position.tolist()} cannot look at {target.tolist()} with up {up.tolist()}")
    forward /= distance
    right /= np.linalg.norm(right)
    rotation = np.stack([right, np.cross(forward, right), forward])
    pose = np.eye(4)
    pose[:3, :3] = rotation
    pose[:3, 3] = -rotation @ position
    return pose


def arc_pose(
    angle_rad: float, centre: ArrayLike, axis: ArrayLike, radius: float, start: ArrayLike
) -> NDArray[np.float64]:
    """The 4x4 world_to_camera of an inward-looking camera on an arc, its image's up along the arc's axis.

    angle_rad : position on the arc, counter-clockwise about `axis`, 0 at `start`.
    centre : (3,) metres. axis, start : (3,), any length; start is made orthogonal to the axis. radius : metres.
    """
    centre, axis, start = (np.asarray(v, float) for v in (centre, axis, start))
    if np.linalg.norm(axis) == 0:
        raise ValueError("gantry axis is the zero vector; give the direction that the arc turns about")
    axis = axis / np.linalg.norm(axis)
    start = start - axis * (start @ axis)
    if np.linalg.norm(start) < 1e-9:
        raise ValueError("gantry start is along the axis (or zero); give the direction to the camera at angle 0")
    start /= np.linalg.norm(start)
    outward = np.cos(angle_rad) * start + np.sin(angle_rad) * np.cross(axis, start)
    return look_at(centre + radius * outward, centre, axis)
