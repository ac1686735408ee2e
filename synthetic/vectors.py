"""Vectors in the last axis of arrays: products, sums, and the local frames of surfaces."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

AnyFloats = NDArray[np.floating]


def local_frame(normals: AnyFloats, tangents: AnyFloats | None = None) -> AnyFloats:
    """Frames (..., 3, 3) whose rows are tangent, bitangent and normal; right-handed.

    tangents : (..., 3), made perpendicular to the normals (..., 3); any will do for isotropic materials.
    """
    if tangents is None:
        # The axis that is least along the normal.
        tangents = np.eye(3, dtype=normals.dtype)[np.abs(normals).argmin(axis=-1)]
    tangents = tangents - (tangents * normals).sum(axis=-1, keepdims=True) * normals
    tangents = tangents / np.linalg.norm(tangents, axis=-1, keepdims=True)
    return np.stack([tangents, np.cross(normals, tangents), normals], axis=-2)


def to_local(frames: AnyFloats, directions: AnyFloats) -> AnyFloats:
    """Directions (..., 3) in frames (..., 3, 3)."""
    return np.stack([dot(frames[..., axis, :], directions) for axis in range(3)], axis=-1)


def to_world(frames: AnyFloats, directions: AnyFloats) -> AnyFloats:
    """Local directions (..., 3) of frames (..., 3, 3) in the world."""
    parts = [directions[..., axis, None] * frames[..., axis, :] for axis in range(3)]
    return np.asarray(parts[0] + parts[1] + parts[2])


def dot(a: AnyFloats, b: AnyFloats) -> AnyFloats:
    """Scalar products (...,) of vectors (..., 3); several times faster than a sum over the last axis."""
    return a[..., 0] * b[..., 0] + a[..., 1] * b[..., 1] + a[..., 2] * b[..., 2]


def mirrored(directions: AnyFloats) -> AnyFloats:
    """Local directions (..., 3) reflected about the normal."""
    return directions * np.array([-1, -1, 1], directions.dtype)


def sums_by_row(row: NDArray[np.integer], values: AnyFloats, count: int) -> NDArray[np.float64]:
    """Sums (count, 3) of vectors (n, 3) that share a row (n,), 0 to below `count`."""
    return np.column_stack([np.bincount(row, component, count) for component in values.T])
