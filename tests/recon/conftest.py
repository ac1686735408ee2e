"""Truths for the tests of `recon`: masks drawn without the code that is to find the sphere in them."""

from __future__ import annotations

from collections.abc import Callable

import cv2
import numpy as np
import pytest
from numpy.typing import NDArray

from capture.camera import Camera
from recon.sphere.sphere import Sphere

Mask = NDArray[np.float32]


def _draw(sphere: Sphere, camera: Camera, n: int = 6) -> Mask:
    """Coverage of each pixel by the sphere, (h, w), from n x n points within it; by its middle far from the outline."""
    y, x = np.mgrid[: camera.height, : camera.width]
    corners = np.column_stack([x.ravel(), y.ravel()])
    cover = _meets(sphere, camera, corners + 0.5).reshape(x.shape).astype(np.float32)
    if n > 1:
        around = np.ones((3, 3), np.uint8)
        rim = np.flatnonzero(cv2.dilate(cover, around) != cv2.erode(cover, around))
        steps = (np.arange(n) + 0.5) / n
        within = np.stack(np.meshgrid(steps, steps), axis=-1).reshape(-1, 2)
        points = (corners[rim, None] + within).reshape(-1, 2)
        cover.ravel()[rim] = _meets(sphere, camera, points).reshape(len(rim), -1).mean(axis=1)
    return cover


def _meets(sphere: Sphere, camera: Camera, points: NDArray[np.float64]) -> NDArray[np.bool_]:
    """Whether the rays through points (n, 2) meet the sphere."""
    origins, directions = camera.rays(points)
    # The ray's equation |o + t d - c| = r has a solution where this discriminant is positive.
    offset = origins - sphere.centre
    b = (offset * directions).sum(axis=1)
    return np.asarray(b**2 - (offset**2).sum(axis=1) + sphere.radius**2 > 0)


@pytest.fixture(scope="session")
def draw() -> Callable[..., Mask]:
    """`draw(sphere, camera, n)`: an antialiased mask of a sphere; n = 1 gives a binary one."""
    return _draw


@pytest.fixture(scope="session")
def ball() -> Callable[..., Sphere]:
    """`ball(centre, radius)`: a sphere that is known exactly."""
    return lambda centre, radius: Sphere(np.asarray(centre, float), radius, np.zeros((4, 4)))
