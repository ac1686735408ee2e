"""The scene of RMB07's fig. 5: a nearly flat table with a matte, a glossy and a bumpy sphere, and a near soft lamp."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from invrender.gradients.surface import (
    CentredShading,
    CurvedSurface,
    GradientTerms,
    IncidentLight,
    gradient_terms,
)
from recon.harmonics.basis import sphere_directions

Floats = NDArray[np.float64]

# The table is a ball, too, of a large radius.
_CENTRES = np.array([[0.0, 0.0, -50.0], [-2.3, 0.0, 1.0], [0.0, 0.0, 1.0], [2.3, 0.0, 1.0]])
_RADII = np.array([50.0, 1.0, 1.0, 1.0])
PARTS = ("table", "matte sphere", "glossy sphere", "bumpy sphere")
_BUMPY, _BUMPS, _WAVES = 3, 0.035, 14.0
_CAMERA, _LOOKING_AT, _FIELD = np.array([0.0, -8.0, 4.5]), np.array([0.0, -1.0, 0.4]), 0.62
_LAMP, _LAMP_WIDTH = np.array([0.8, -1.4, 3.0]), 0.45
_AT_A_TIME = 200

_MATTE = CentredShading(lambda c: np.maximum(c, 0) / np.pi, np.ones_like, np.zeros_like, False)
_GLOSS = CentredShading(lambda c: 4 * np.exp(40 * (c - 1)), np.ones_like, np.zeros_like, True)
# What each part has of the matte and of the glossy lobe.
_SHADINGS = ((_MATTE, (0.5, 0.7, 0.5, 0.6)), (_GLOSS, (0.4, 0.0, 0.8, 0.3)))


@dataclass(frozen=True, eq=False)
class Tabletop:
    """What a camera sees. inside : (h, w). part : (n,), index in `PARTS`. points : in the picture's order."""

    inside: NDArray[np.bool_]
    part: NDArray[np.int64]
    points: CurvedSurface


def seen_by_camera(height: int) -> Tabletop:
    """The scene in a picture of so many rows, a ray through each pixel's middle."""
    forward = _LOOKING_AT - _CAMERA
    forward /= np.linalg.norm(forward)
    right = np.cross(forward, [0, 0, 1])
    right /= np.linalg.norm(right)
    down = np.cross(forward, right)
    width = 8 * height // 5
    y, x = (np.mgrid[:height, :width] + 0.5 - np.array([height, width])[:, None, None] / 2) * _FIELD / height
    rays = forward + x[..., None] * right + y[..., None] * down
    rays = (rays / np.linalg.norm(rays, axis=-1, keepdims=True)).reshape(-1, 3)
    along = rays @ (_CENTRES - _CAMERA).T
    square = along**2 - ((_CENTRES - _CAMERA) ** 2).sum(axis=1) + _RADII**2
    reach = np.where(square > 0, along - np.sqrt(np.maximum(square, 0)), np.inf)
    part, distance = reach.argmin(axis=1), reach.min(axis=1)
    inside = np.isfinite(distance) & (distance < 14)
    rays, part, distance = rays[inside], part[inside], distance[inside]
    positions = _CAMERA + distance[:, None] * rays
    outward = (positions - _CENTRES[part]) / _RADII[part, None]
    first = np.cross(outward, [0.3, 0.5, 0.2])
    first /= np.linalg.norm(first, axis=1, keepdims=True)
    tangents = np.stack([first, np.cross(outward, first)], axis=1)
    normals, steps = outward.copy(), tangents / _RADII[part, None, None]
    bumpy = part == _BUMPY
    normals[bumpy], steps[bumpy] = _bumped(outward[bumpy], steps[bumpy])
    points = CurvedSurface(positions, normals, tangents, steps, -rays, distance)
    return Tabletop(inside.reshape(height, width), part, points)


def shaded(scene: Tabletop, directions: int) -> GradientTerms:
    """Radiance and its gradient's terms of all points, by sums over so many directions."""
    grid = sphere_directions(directions)
    found = []
    for begin in range(0, len(scene.part), _AT_A_TIME):
        which = slice(begin, begin + _AT_A_TIME)
        points = CurvedSurface(*(values[which] for values in vars(scene.points).values()))
        light = _lamp(points.positions, grid)
        shares = [np.array(share)[scene.part[which]] for _, share in _SHADINGS]
        terms = [list(vars(gradient_terms(points, light, shading)).values()) for shading, _ in _SHADINGS]
        found.append(
            [(shares[0] * matte.T + shares[1] * gloss.T).T for matte, gloss in zip(*terms, strict=True)]
        )
    return GradientTerms(*(np.concatenate(parts) for parts in zip(*found, strict=True)))


def _lamp(positions: Floats, directions: Floats) -> IncidentLight:
    """A soft lamp of the same radiance at each distance; its edge is a Gaussian in angle, as wide as it is near."""
    towards = _LAMP - positions
    distance = np.linalg.norm(towards, axis=1)
    unit = towards / distance[:, None]
    sharpness = (distance / _LAMP_WIDTH) ** 2
    cosine = unit @ directions.T
    radiance = np.exp(sharpness[:, None] * (cosine - 1))
    # Over places: the lamp's direction turns, and it looks larger from near.
    across = directions - cosine[..., None] * unit[:, None]
    by_place = radiance[..., None] * (
        -sharpness[:, None, None] / distance[:, None, None] * across
        - 2 * (sharpness / distance)[:, None, None] * (cosine - 1)[..., None] * unit[:, None]
    )
    gradient = (sharpness[:, None] * radiance)[..., None] * unit[:, None]
    gradient = gradient - (gradient * directions).sum(axis=-1, keepdims=True) * directions
    solid_angles = np.full(len(directions), 4 * np.pi / len(directions))
    return IncidentLight(directions, solid_angles, radiance, by_place, gradient)


def _bumped(outward: Floats, steps: Floats) -> tuple[Floats, Floats]:
    """Normals (n, 3) of a bump map on a ball, and their derivatives (n, 2, 3); steps : of the ball's own normals."""
    rng = np.random.default_rng(1)
    waves = rng.normal(size=(12, 3))
    waves *= _WAVES / np.linalg.norm(waves, axis=1, keepdims=True)
    phases = outward @ waves.T + rng.uniform(0, 2 * np.pi, 12)
    slope, bend = np.cos(phases) @ waves, -np.einsum("nk,ki,kj->nij", np.sin(phases), waves, waves)
    along = (slope * outward).sum(axis=1)
    raised = outward + _BUMPS * (slope - along[:, None] * outward)
    changed = np.einsum("nij,ntj->nti", bend, steps)
    along_steps = (changed * outward[:, None]).sum(axis=-1) + (steps * slope[:, None]).sum(axis=-1)
    raised_steps = steps + _BUMPS * (
        changed - along_steps[..., None] * outward[:, None] - along[:, None, None] * steps
    )
    length = np.linalg.norm(raised, axis=1)[:, None]
    normals = raised / length
    kept = (raised_steps * normals[:, None]).sum(axis=-1, keepdims=True)
    return normals, (raised_steps - kept * normals[:, None]) / length[:, None]
