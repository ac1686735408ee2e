"""A gantry arc as a source of camera poses."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike, NDArray

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


def arc_pose(angle_rad: float, centre: ArrayLike, axis: ArrayLike, radius: float, start: ArrayLike) -> Floats:
    """The 4x4 world_to_camera of an inward-looking camera on an arc, its image's up along the arc's axis.

    angle_rad : position on the arc, counter-clockwise about `axis`, 0 at `start`.
    centre : (3,) metres. axis, start : (3,), any length; start is made orthogonal to the axis.
    radius : metres.
    """
    middle, turn, first = np.asarray(centre, float), np.asarray(axis, float), np.asarray(start, float)
    if np.linalg.norm(turn) == 0:
        raise ValueError("gantry axis is the zero vector; give the direction that the arc turns about")
    turn = turn / np.linalg.norm(turn)
    across = first - turn * (first @ turn)
    if np.linalg.norm(across) <= 1e-9 * np.linalg.norm(first):
        raise ValueError(
            "gantry start is along the axis (or zero); give the direction to the camera at angle 0"
        )
    across /= np.linalg.norm(across)
    outward = np.cos(angle_rad) * across + np.sin(angle_rad) * np.cross(turn, across)
    return look_at(middle + radius * outward, middle, turn)
