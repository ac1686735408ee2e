"""Small changes of a camera's pose about an object: what they do to the pose and to the picture."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from capture.camera import Camera
from recon.poses.similarity import cross_matrix

Floats = NDArray[np.float64]

# Of a change, in its unit, for slopes.
_STEP = 1e-3


@dataclass(frozen=True, eq=False)
class LoosePose:
    """A pose as it was given, and how far off it may be.

    camera : at that pose. centre : (3,) metres, of the object, in the world. units : (6,), of a change of the pose,
    radians and metres: standard deviations.
    """

    camera: Camera
    centre: Floats
    units: Floats

    @classmethod
    def of(cls, camera: Camera, centre: Floats, turn: float, shift: float) -> LoosePose:
        """Of a camera that may be off by turns about each axis (radians), and shifts in the picture (pixels)."""
        known = cls(camera, centre, np.ones(6))
        return replace(known, units=np.repeat([turn, shift / known.px_per_metre], 3))

    def at(self, change: Floats) -> Camera:
        """The camera after a change (6,) in units."""
        return changed(self.camera, self.centre, change * self.units)

    def motion(self, change: Floats, points: Floats) -> Floats:
        """How image points (n, 2) of world points (n, 3) move per unit of a change's components, (n, 2, 6), pixels."""
        return image_motion(self.camera, self.centre, change * self.units, self.units, points)

    @property
    def px_per_metre(self) -> float:
        """What a shift of the object across the view moves its middle in the picture."""
        camera = self.camera
        return camera.focal_px / (1.0 if camera.is_orthographic else float(camera.depth(self.centre)[0]))


def changed(camera: Camera, centre: Floats, change: Floats) -> Camera:
    """A camera whose object is turned and shifted before it.

    centre : (3,) metres, in the world, about which it turns. change : (6,), a turn (radians) and a shift (metres) along
    the camera's axes: a point c + x in its frame, c being the centre, becomes c + exp(w) x + s.
    """
    pose = camera.world_to_camera
    turn = Rotation.from_rotvec(change[:3]).as_matrix()
    about = pose[:3, :3] @ centre + pose[:3, 3]
    moved = np.eye(4)
    moved[:3, :3] = turn @ pose[:3, :3]
    moved[:3, 3] = turn @ (pose[:3, 3] - about) + about + change[3:]
    return camera.posed(moved)


def image_motion(camera: Camera, centre: Floats, change: Floats, units: Floats, points: Floats) -> Floats:
    """How image points (n, 2) of world points (n, 3) move per unit of each component of a change, (n, 2, 6), pixels.

    units : (6,) of the components, radians and metres.
    """
    columns = []
    for step in np.diag(_STEP * units):
        ends = [changed(camera, centre, change + sign * step).project(points) for sign in (-1, 1)]
        columns.append((ends[1] - ends[0]) / (2 * _STEP))
    return np.stack(columns, axis=-1)


def pose_covariance(camera: Camera, centre: Floats, covariance: Floats) -> Floats:
    """Covariance (6, 6) of a change at a pose as poses.json has it: of w and s in [exp(w) R | t + s]."""
    # With w about the centre, t moves by s + w x (t - c), and t - c = -R centre.
    change = np.eye(6)
    change[3:, :3] = cross_matrix(camera.world_to_camera[:3, :3] @ centre)
    return np.asarray(change @ covariance @ change.T)


def position_std(camera: Camera, covariance: Floats) -> float:
    """Standard deviation of a camera's place, metres, all axes together; covariance : (6, 6) as poses.json has it."""
    # The place is -R^T t: to the first order it moves by -R^T (s - w x t).
    moves = np.hstack([cross_matrix(camera.world_to_camera[:3, 3]), np.eye(3)])
    return float(np.sqrt(np.trace(moves @ covariance @ moves.T)))
