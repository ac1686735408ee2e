"""Similarities: turn, shift and scale that place a mesh in the world, never a mirror image; and how they err."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from capture.arrays import frozen_array

Floats = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class Similarity:
    """world = scale * rotation @ mesh + translation, the world being as large as the cameras' poses say.

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
        """Points (n, 3) of the mesh in the world."""
        return np.asarray(self.scale * points @ self.rotation.T + self.translation)

    def undo(self, points: Floats) -> Floats:
        """Points (n, 3) of the world in the mesh's frame."""
        return np.asarray((points - self.translation) @ self.rotation / self.scale)

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
    jacobian = np.zeros((len(points), 3, 7))
    x, y, z = arms.T
    # turn x arm, column by column.
    jacobian[:, 1, 0], jacobian[:, 2, 0] = -z, y
    jacobian[:, 0, 1], jacobian[:, 2, 1] = z, -x
    jacobian[:, 0, 2], jacobian[:, 1, 2] = -y, x
    jacobian[:, :, 3:6] = np.eye(3)
    jacobian[:, :, 6] = arms
    return jacobian


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
