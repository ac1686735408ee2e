"""Similarities: turn, shift and scale that place a mesh or a structure in the world, never a mirror image.

pycolmap.Sim3d is none of these: it can be written to, accepts any scale, and knows no motions about a pivot.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from capture.arrays import frozen_array

Floats = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class Similarity:
    """world = scale * rotation @ own + translation, own being the frame of a mesh or of a structure.

    scale : > 0. rotation : (3, 3), determinant +1. translation : (3,).
    """

    scale: float
    rotation: Floats
    translation: Floats

    def __post_init__(self) -> None:
        if not (np.isfinite(self.scale) and self.scale > 0):
            raise ValueError(f"the scale of a similarity is {self.scale}; it must be > 0")
        object.__setattr__(self, "rotation", frozen_array(self.rotation))
        object.__setattr__(self, "translation", frozen_array(self.translation))

    def apply(self, points: Floats) -> Floats:
        """Points (n, 3) in the world."""
        return np.asarray(self.scale * points @ self.rotation.T + self.translation)

    def undo(self, points: Floats) -> Floats:
        """Points (n, 3) of the world in the own frame."""
        return np.asarray((points - self.translation) @ self.rotation / self.scale)

    def of_poses(self, poses: Floats) -> Floats:
        """Poses (n, 4, 4), own frame to camera, as world to camera."""
        placed = np.array(poses, float)
        placed[:, :3, :3] = poses[:, :3, :3] @ self.rotation.T
        placed[:, :3, 3] = self.scale * poses[:, :3, 3] - placed[:, :3, :3] @ self.translation
        return placed

    def moved(self, step: Floats, pivot: Floats) -> Similarity:
        """After a further turn (3, radians, about the world's axes), shift (3) and growth (log scale).

        step : (7,). pivot : (3,) world, the point that turn and growth keep.
        """
        turn, growth = Rotation.from_rotvec(step[:3]).as_matrix(), float(np.exp(step[6]))
        return Similarity(
            scale=self.scale * growth,
            rotation=turn @ self.rotation,
            translation=pivot + growth * turn @ (self.translation - pivot) + step[3:6],
        )

    def angle_to(self, other: Similarity) -> float:
        """Radians between the two orientations."""
        cos = (np.trace(self.rotation.T @ other.rotation) - 1) / 2
        return float(np.arccos(np.clip(cos, -1, 1)))


def motion_jacobian(points: Floats, pivot: Floats) -> Floats:
    """How world points (n, 3) follow the seven numbers of `Similarity.moved`, (n, 3, 7)."""
    arms = points - pivot
    shifts = np.broadcast_to(np.eye(3), (len(points), 3, 3))
    return np.concatenate([-cross_matrix(arms), shifts, arms[:, :, None]], axis=2)


def cross_matrix(vectors: Floats) -> Floats:
    """The matrices (..., 3, 3) that take the cross product with vectors (..., 3) from the left."""
    x, y, z = np.moveaxis(np.asarray(vectors, float), -1, 0)
    o = np.zeros_like(x)
    return np.stack([o, -z, y, z, o, -x, -y, x, o], axis=-1).reshape(*x.shape, 3, 3)


def rotations_all_over(count: int) -> Floats:
    """Rotations (count, 3, 3) spread evenly over all orientations.

    Super-Fibonacci spirals [Alexa 2022, "Super-Fibonacci spirals: fast, low-discrepancy sampling of SO(3)"].
    """
    s = np.arange(count) + 0.5
    # Roots that the paper found best: sqrt(2), and that of psi^4 = psi + 4.
    alpha = 2 * np.pi * s / np.sqrt(2)
    beta = 2 * np.pi * s / 1.533751168755204288118041
    r, R = np.sqrt(s / count), np.sqrt(1 - s / count)
    quaternions = np.column_stack([r * np.sin(alpha), r * np.cos(alpha), R * np.sin(beta), R * np.cos(beta)])
    return np.asarray(Rotation.from_quat(quaternions).as_matrix())
