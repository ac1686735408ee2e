"""Half and difference angles of pairs of directions [Rusinkiewicz 1998], in which highlights lie along one axis.

theta_h is the angle between the half vector and the normal, (theta_d, phi_d) the light's direction about the half
vector, phi_d = 0 away from the normal. For isotropic surfaces phi_d and -phi_d are one; of reciprocal ones, where light
and viewer can be exchanged, so are phi_d and phi_d + pi.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.float64]


class HalfAngles(NamedTuple):
    """theta_h, theta_d 0 to pi/2, phi_d 0 to pi, radians, (...) each."""

    theta_h: Floats
    theta_d: Floats
    phi_d: Floats


def half_angles(normals: Floats, incident: Floats, exitant: Floats) -> HalfAngles:
    """Angles (...) of pairs of unit directions (..., 3) about unit normals (..., 3), in any common frame."""
    half = incident + exitant
    length = np.linalg.norm(half, axis=-1)
    half = half / np.maximum(length, 1e-300)[..., None]
    theta_d = np.arctan2(np.linalg.norm(incident - exitant, axis=-1), length)
    theta_h = np.arctan2(np.linalg.norm(np.cross(normals, half), axis=-1), (normals * half).sum(axis=-1))
    # Across the half vector: light and normal as they show along it.
    light = incident - (incident * half).sum(axis=-1, keepdims=True) * half
    upright = normals - (normals * half).sum(axis=-1, keepdims=True) * half
    across = np.linalg.norm(np.cross(light, upright), axis=-1)
    return HalfAngles(theta_h, theta_d, np.arctan2(across, -(light * upright).sum(axis=-1)))


def cosines(angles: HalfAngles) -> tuple[Floats, Floats]:
    """cos theta_i and cos theta_o (...); negative below the surface."""
    level = np.cos(angles.theta_h) * np.cos(angles.theta_d)
    tilt = np.sin(angles.theta_h) * np.sin(angles.theta_d) * np.cos(angles.phi_d)
    return level - tilt, level + tilt


def directions(angles: HalfAngles) -> tuple[Floats, Floats]:
    """Unit directions to the light and to the viewer (..., 3) at these angles (...), about a normal along z."""
    cos_h, sin_h = np.cos(angles.theta_h), np.sin(angles.theta_h)
    half = np.stack([sin_h, np.zeros_like(sin_h), cos_h], axis=-1)
    # Across the half vector: away from the normal, and to the side.
    down = np.stack([cos_h, np.zeros_like(cos_h), -sin_h], axis=-1)
    side = np.array([0.0, 1.0, 0.0])
    turned = np.cos(angles.phi_d)[..., None] * down + np.sin(angles.phi_d)[..., None] * side
    level, apart = np.cos(angles.theta_d)[..., None] * half, np.sin(angles.theta_d)[..., None] * turned
    return level + apart, level - apart
