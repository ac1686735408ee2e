"""Where the world of registered photographs lies, and how large it is: given poses, known points, or a guess."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import least_squares
from scipy.spatial.transform import Rotation

from recon.poses.register.posecovariance import frame_changes
from recon.poses.similarity import Similarity, motion_jacobian

Floats = NDArray[np.float64]

# Image-up directions that agree less than this share determine no vertical: the cameras were turned over.
_AGREEING = 0.5


@dataclass(frozen=True, eq=False)
class WorldFrame(Similarity):
    """The similarity from the frame that a structure was found in to the world.

    covariance : (7, 7) of a further turn (radians), shift and log scale of the world about its origin; None where the
        world is free, so that nothing is there to be wrong.
    residuals : (n, k), what the fit leaves of each pose or point that fixed it; see the function that made it.
    """

    covariance: Floats | None = None
    residuals: Floats | None = None

    def of_covariance(self, covariance: Floats, placed: Floats) -> Floats:
        """Covariance (6c, 6c) of poses, as `recon.poses.register.posecovariance.pose_covariance` has it, in the world.

        placed : (c, 4, 4), the poses in the world. What the frame itself may be off by is added.
        """
        unit = np.tile(np.repeat([1.0, self.scale], 3), len(placed))
        scaled = covariance * np.outer(unit, unit)
        if self.covariance is None:
            return scaled
        changes = frame_changes(placed)
        return np.asarray(scaled + changes @ self.covariance @ changes.T)


def frame_of_poses(poses: Floats, given: Floats, distance: float) -> WorldFrame:
    """The frame in which poses (c, 4, 4) come nearest to given ones, c at least 2, from different places.

    distance : of the cameras from the object, in the poses' own unit: a shift over it counts as much as a turn in
    radians. The fit bears some poses that are wrong. Frame.residuals : (c, 6), turn in radians and shift in the world's
    unit about the camera's axes, given minus found.
    ValueError where the cameras stand in one place.
    """
    centres = -np.einsum("nji,nj->ni", poses[:, :3, :3], poses[:, :3, 3])
    targets = -np.einsum("nji,nj->ni", given[:, :3, :3], given[:, :3, 3])
    apart = np.linalg.norm(centres - centres.mean(axis=0), axis=1).max()
    if not apart > 1e-3 * distance or not np.ptp(targets, axis=0).max() > 0:
        raise ValueError("the given poses stand in one place, from which no scale follows; give others too")
    turns = Rotation.from_matrix(given[:, :3, :3].transpose(0, 2, 1) @ poses[:, :3, :3])
    # The rotation that most agree with, and the middle one of the scales that pairs of cameras give.
    angles = np.array([(turns * turn.inv()).magnitude() for turn in turns])
    rotation = turns[int(np.argmin(np.median(angles, axis=1)))].as_matrix()
    first, second = np.triu_indices(len(poses), 1)
    own = np.linalg.norm(centres[first] - centres[second], axis=1)
    far = own > 0.1 * own.max()
    scale = float(np.median(np.linalg.norm(targets[first] - targets[second], axis=1)[far] / own[far]))
    unit = np.repeat([1.0, distance * scale], 3)
    start = Similarity(scale, rotation, np.median(targets - scale * centres @ rotation.T, axis=0))

    def moved(step: Floats) -> Similarity:
        return start.moved(np.append(unit, 1.0) * step, targets.mean(axis=0))

    def residuals(step: Floats) -> Floats:
        return (_differences(moved(step).of_poses(poses), given) / unit).ravel()

    size = 1.4826 * float(np.median(np.abs(residuals(np.zeros(7))))) + 1e-9
    fit = least_squares(residuals, np.zeros(7), loss="soft_l1", f_scale=2 * size)
    frame = moved(fit.x)
    left = _differences(frame.of_poses(poses), given)
    return WorldFrame(**vars(frame), covariance=_scatter(frame, poses, left, unit), residuals=left)


def frame_of_points(points: Floats, known: Floats) -> WorldFrame:
    """The frame in which points (n, 3) come nearest to known ones, least squares; never mirrored.

    Umeyama 1991, "Least-squares estimation of transformation parameters between two point patterns".
    Frame.residuals : (n, 3), known minus found, in the world's unit. n at least 4, not on a line.
    """
    a, b = points - points.mean(axis=0), known - known.mean(axis=0)
    u, values, vt = np.linalg.svd(b.T @ a)
    sign = np.array([1.0, 1.0, np.sign(np.linalg.det(u @ vt))])
    rotation = (u * sign) @ vt
    scale = float((values * sign).sum() / (a**2).sum())
    frame = Similarity(scale, rotation, known.mean(axis=0) - scale * rotation @ points.mean(axis=0))
    found = frame.apply(points)
    left = known - found
    design = motion_jacobian(found, np.zeros(3)).reshape(-1, 7)
    variance = float((left**2).sum()) / max(left.size - 7, 1)
    return WorldFrame(
        **vars(frame), covariance=np.asarray(variance * np.linalg.inv(design.T @ design)), residuals=left
    )


def free_frame(poses: Floats, points: Floats) -> WorldFrame:
    """A frame where nothing gives one: the points' middle is the origin, the cameras' median distance from it 1.

    +Z is up in the pictures; where these don't agree, across the plane of the cameras. +X points to the first camera.
    """
    centres = -np.einsum("nji,nj->ni", poses[:, :3, :3], poses[:, :3, 3])
    middle = np.median(points, axis=0)
    ups = -poses[:, 1, :3]
    up = ups.mean(axis=0)
    if np.linalg.norm(up) < _AGREEING:
        across = np.linalg.svd(centres - centres.mean(axis=0))[2][2]
        # Of the two ends that on whose side the cameras stand, as one looks down at objects.
        up = across if (centres.mean(axis=0) - middle) @ across >= 0 else -across
    up = up / np.linalg.norm(up)
    away = centres[0] - middle
    forward = away - up * (up @ away)
    if np.linalg.norm(forward) < 1e-6 * np.linalg.norm(away):
        forward = np.cross(up, np.eye(3)[np.argmin(np.abs(up))])
    forward = forward / np.linalg.norm(forward)
    rotation = np.stack([forward, np.cross(up, forward), up])
    scale = 1 / float(np.median(np.linalg.norm(centres - middle, axis=1)))
    return WorldFrame(scale, rotation, -scale * rotation @ middle)


def _differences(poses: Floats, given: Floats) -> Floats:
    """Turns (radians) and shifts about and along the cameras' axes, (c, 6), from poses to given ones."""
    between = given @ np.linalg.inv(poses)
    turns = Rotation.from_matrix(between[:, :3, :3]).as_rotvec()
    return np.concatenate([turns, between[:, :3, 3]], axis=1)


def _scatter(frame: Similarity, poses: Floats, left: Floats, unit: Floats) -> Floats:
    """Covariance (7, 7) of a frame fitted to poses, of which those that are far off hardly count."""
    shares = np.linalg.norm(left / unit, axis=1)
    size = 1.4826 * float(np.median(shares)) + 1e-12
    weights = 1 / (1 + (shares / size) ** 2)
    design = (frame_changes(frame.of_poses(poses)) / np.tile(unit, len(poses))[:, None]).reshape(-1, 6, 7)
    # Poses that have nothing to do with each other may leave no scale at all.
    inverse = np.linalg.pinv(np.einsum("nij,nik,n->jk", design, design, weights), hermitian=True)
    # Six residuals a pose, of which the fit took seven out of all.
    variance = float((weights * shares**2).sum() / weights.sum()) / 6
    return np.asarray(inverse * variance * 6 * len(poses) / (6 * len(poses) - 7))
