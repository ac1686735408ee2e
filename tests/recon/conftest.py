"""Truths for the tests of `recon`: masks drawn without the code that is to find the sphere in them."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest
from numpy.typing import NDArray

from capture.camera import Camera
from recon.sphere.sphere import Sphere

Mask = NDArray[np.float32]


def _draw(sphere: Sphere, camera: Camera, n: int = 6) -> Mask:
    """Coverage of each pixel by the sphere, (h, w), from n x n points within it."""
    steps = (np.arange(n) + 0.5) / n
    x = (np.arange(camera.width)[:, None] + steps).ravel()
    y = (np.arange(camera.height)[:, None] + steps).ravel()
    points = np.stack(np.meshgrid(x, y), axis=-1).reshape(-1, 2)
    origins, directions = camera.rays(points)
    # The ray's equation |o + t d - c| = r has a solution where this discriminant is positive.
    offset = origins - sphere.centre
    b = (offset * directions).sum(axis=1)
    discriminant = b**2 - (offset**2).sum(axis=1) + sphere.radius**2
    inside = discriminant.reshape(camera.height, n, camera.width, n) > 0
    return inside.mean(axis=(1, 3), dtype=np.float32)


@pytest.fixture(scope="session")
def draw() -> Callable[..., Mask]:
    """`draw(sphere, camera, n)`: an antialiased mask of a sphere; n = 1 gives a binary one."""
    return _draw


@pytest.fixture(scope="session")
def ball() -> Callable[..., Sphere]:
    """`ball(centre, radius)`: a sphere that is known exactly."""
    return lambda centre, radius: Sphere(np.asarray(centre, float), radius, np.zeros((4, 4)))
