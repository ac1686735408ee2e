"""Where a sphere is found if cameras are elsewhere than was thought: its outlines stay where photographs show them."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from capture.camera import Camera
from recon.displacement.rays import Motion, SeenBody
from recon.sphere.sphere import Sphere, sphere_outline

Floats = NDArray[np.float64]

# Points of an outline, and shares of the radius and of an error that differences are taken of.
_POINTS, _STEP = 48, 1e-4
# Shifts of a sphere that move outlines by less than this share of the most are gauges, as its distance is.
_GAUGE = 1e-3


def place_shift(
    sphere: Sphere,
    scenes: Sequence[SeenBody],
    moving: Sequence[bool],
    motion: Motion,
    free: NDArray[np.bool_],
) -> Floats:
    """By how much a sphere's centre and radius (4,), metres, follow an error of cameras, to first order.

    scenes : one for each outline that the sphere was found by. moving : whether the error is in its camera.
    free : (4,), what of centre and radius was found.
    """
    place, step = np.append(sphere.centre, sphere.radius), _STEP * sphere.radius
    normal, pull = np.zeros((4, 4)), np.zeros(4)
    for scene, moves in zip(scenes, moving, strict=True):
        before = sphere_outline(sphere, scene.camera, _POINTS)
        outward = before - before.mean(axis=0)
        outward /= np.linalg.norm(outward, axis=1, keepdims=True)

        def off(place: Floats, camera: Camera, outward: Floats = outward) -> Floats:
            there = Sphere(place[:3], float(place[3]), sphere.covariance)
            return np.asarray((sphere_outline(there, camera, _POINTS) * outward).sum(axis=1))

        slopes = np.stack(
            [
                off(place + step * unit, scene.camera) - off(place - step * unit, scene.camera)
                for unit in np.eye(4)
            ],
            axis=1,
        ) / (2 * step)
        slopes[:, ~free] = 0
        normal += slopes.T @ slopes
        if moves:
            ends = [off(place, motion(scene, way * _STEP).camera) for way in (1, -1)]
            pull += slopes.T @ (ends[0] - ends[1]) / (2 * _STEP)
    return np.asarray(-np.linalg.pinv(normal, rcond=_GAUGE**2, hermitian=True) @ pull)
