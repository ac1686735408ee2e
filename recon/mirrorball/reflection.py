"""The geometry of a ball that mirrors distant light: image points to directions, and back."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from capture.camera import Camera
from recon.sphere.sphere import Sphere, to_camera

Floats = NDArray[np.float64]
Mask = NDArray[np.bool_]

# Newton's steps for a point on the ball. The function is smooth and its slope at least 2: five are usual.
_STEPS = 20


def mirrored_directions(sphere: Sphere, camera: Camera, points: Floats) -> tuple[Mask, Floats]:
    """The directions that a ball mirrors into image points.

    points : (n, 2) pixels. Returns a mask (n,) of the points on the ball and unit directions (n, 3) in the
    world, towards the light, zero elsewhere.
    """
    origins, rays = camera.rays(points)
    hit, normals = sphere.hits(origins, rays)
    reflected = rays - 2 * np.einsum("nc,nc->n", rays, normals)[:, None] * normals
    return hit, np.where(hit[:, None], reflected, 0.0)


def mirroring_points(sphere: Sphere, camera: Camera, directions: Floats) -> tuple[Mask, Floats]:
    """Where in the image a ball mirrors given directions: the inverse of `mirrored_directions`.

    directions : (n, 3) unit, world, towards the light. Returns a mask (n,) of those that are mirrored at all
    (not: behind the ball) and image points (n, 2), meaningless elsewhere; they may lie outside the image.

    Light, view and normal lie in one plane with the ball's centre, so the problem is one of angles there,
    from the axis to the camera: a normal at psi, seen under -beta(psi), mirrors light at 2 psi + beta(psi).
    Orthographic: beta is zero, and the normal is the half vector.
    """
    axis, nearness = to_camera(sphere, camera)
    along = directions @ axis
    across = directions - along[:, None] * axis
    sine = np.linalg.norm(across, axis=1)
    light = np.arctan2(sine, along)
    horizon = np.arccos(nearness)
    visible = light < horizon + np.pi / 2
    psi = np.minimum(light / 2, horizon)
    if nearness > 0:
        for _ in range(_STEPS):
            depth, height = 1 - nearness * np.cos(psi), nearness * np.sin(psi)
            slope = 2 + nearness * (np.cos(psi) - nearness) / (depth**2 + height**2)
            psi = np.clip(psi - (2 * psi + np.arctan2(height, depth) - light) / slope, 0, horizon)
    sideways = across / np.maximum(sine, 1e-300)[:, None]
    normals = np.cos(psi)[:, None] * axis + np.sin(psi)[:, None] * sideways
    return visible, camera.project(sphere.centre + sphere.radius * normals)


def solid_angles(corners: Floats) -> Floats:
    """Solid angles in steradians of spherical quadrilaterals, as two triangles each.

    corners : (4, ..., 3) unit, in order around. A. van Oosterom and J. Strackee, "The solid angle of a plane
    triangle", IEEE Trans. Biomed. Eng. 30 (1983): the tangent of half of it.
    """
    a, b, c, d = corners
    total = np.zeros(a.shape[:-1])
    for x, y, z in ((a, b, c), (a, c, d)):
        volume = np.abs((x * np.cross(y, z)).sum(axis=-1))
        cosines = (x * y).sum(axis=-1) + (y * z).sum(axis=-1) + (z * x).sum(axis=-1)
        total += 2 * np.arctan2(volume, 1 + cosines)
    return total
