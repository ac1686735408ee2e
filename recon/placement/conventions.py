"""Conventions of poses that are often mistaken for world_to_camera with OpenCV's axes, and of axes for each other."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from itertools import permutations, product

import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.float64]

# Turns OpenCV's camera axes (y down, z forward) into OpenGL's (y up, z backward), and back.
_FLIP = np.diag([1.0, -1.0, -1.0, 1.0])


def other_conventions() -> Mapping[str, Callable[[Floats], Floats]]:
    """Functions that turn a pose, written in another convention, into world_to_camera with OpenCV's axes.

    Each takes and returns (4, 4) float64. Its name says what the pose looks like and how to mend it, as the end of
    "the poses look like ...".
    """
    return {
        "camera_to_world (OpenCV axes): invert it": np.linalg.inv,
        "world_to_camera with OpenGL axes (y up, z backward): multiply by diag(1, -1, -1, 1) from the left": (
            lambda pose: _FLIP @ pose
        ),
        "camera_to_world with OpenGL or Blender axes: flip its y and z columns, then invert it": (
            lambda pose: np.asarray(np.linalg.inv(pose @ _FLIP))
        ),
    }


def signed_axes() -> list[Floats]:
    """The 48 matrices (3, 3) that take axes to axes, either way along: 24 turns and 24 mirrored ones."""
    return [
        np.diag(signs) @ np.eye(3)[list(order)]
        for order in permutations(range(3))
        for signs in product((1.0, -1.0), repeat=3)
    ]
