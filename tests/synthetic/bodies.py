"""Bodies with flat facets, for which light can be reckoned by hand."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from recon.mesh.trianglemesh import TriangleMesh, area_vectors
from synthetic.shapes.meshsurface import MeshSurface
from synthetic.shapes.surface import Points
from synthetic.shapes.tangents import tangents

Floats = NDArray[np.float64]


def flat(vertices: Floats, faces: NDArray[np.integer]) -> MeshSurface:
    """A mesh that is shaded by its facets: every triangle with corners of its own."""
    normals = area_vectors(vertices, faces)
    normals /= np.linalg.norm(normals, axis=1, keepdims=True)
    own = np.arange(3 * len(faces)).reshape(-1, 3)
    return MeshSurface(TriangleMesh(vertices[faces].reshape(-1, 3), own, np.repeat(normals, 3, axis=0)))


def prism(
    profile: list[tuple[float, float]], triangles: list[tuple[int, int, int]], length: float
) -> MeshSurface:
    """A profile in x and z, counterclockwise seen from -y and cut into triangles, drawn out along y."""
    count = len(profile)
    ends = [np.array([(x, y, z) for x, z in profile]) for y in (-length / 2, length / 2)]
    caps = np.array(triangles)
    a = np.arange(count)
    b = (a + 1) % count
    sides = np.concatenate([np.column_stack([a, a + count, b]), np.column_stack([b, a + count, b + count])])
    return flat(np.concatenate(ends), np.concatenate([caps, caps[:, ::-1] + count, sides]))


def corner(width: float, length: float) -> MeshSurface:
    """A floor (z = 0, x from 0 to `width`) and a wall (x = 0, z from 0 to `width`), 1 thick, along y."""
    w = width
    profile = [(-1.0, -1.0), (w, -1.0), (w, 0.0), (0.0, 0.0), (0.0, w), (-1.0, w)]
    return prism(profile, [(0, 1, 2), (0, 2, 3), (0, 3, 5), (3, 4, 5)], length)


def facet_points(positions: Floats, normal: tuple[float, float, float]) -> Points:
    """Points (n, 3) of a facet."""
    positions = np.asarray(positions, float)
    normals = np.tile(np.array(normal, float), (len(positions), 1))
    return Points(positions, normals, normals, tangents(normals), np.zeros((len(positions), 2)))
