"""Triangle meshes of implicit surfaces."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import coo_array, csr_array
from scipy.sparse.csgraph import connected_components

from recon.mesh.trianglemesh import TriangleMesh, area_vectors, is_watertight
from synthetic.shapes.implicit import Implicit

Floats = NDArray[np.float64]

# Cells along the side of a block: the function is known everywhere in a block or at its centre alone.
_BLOCK = 4
# Points at a time: their intermediate arrays stay in the cache.
_POINTS_PER_CHUNK = 1 << 14
# A block is left out if the function at its centre says that the surface is farther than its corners, the
# function growing by at most this per metre.
_STEEPEST = 2.0
# The grid's values are kept this far from zero, in cells: a vertex nearer to a corner of its cell would make
# slivers with those on the corner's other edges.
_CLEARANCE = 0.05
# Rounds of moving each vertex to the middle of its neighbours.
_ROUNDS = 3
# Newton steps: one suffices to bring a vertex back after a round; four more leave it within rounding.
_FEW_STEPS, _MANY_STEPS = 1, 4


def mesh_implicit(shape: Implicit, reach: float, edge: float) -> TriangleMesh:
    """Mesh the surface where a function is zero; vertices and normals are exact.

    shape : metres; its gradient must be at most 2 long. reach : metres, a sphere about the origin that holds
        the surface. edge : metres, the grid's cell, about the length of the triangles' edges.

    Marching cubes finds the triangles [Lewiner et al. 2003, with topological guarantees]; their vertices are
    then spread evenly and taken onto the surface by Newton's method. Raises ValueError where the result isn't
    one closed piece, or is folded because the surface turns within a cell.
    """
    # Imported here: slow, and needed for meshing alone.
    from skimage.measure import marching_cubes

    if not 0 < edge < reach / 4:
        raise ValueError(f"edge is {edge} m; it must be > 0 and < {reach / 4:.3g} m, a quarter of the reach")
    grid, origin = _grid(shape, reach, edge)
    if not grid.min() < 0 < grid.max():
        raise ValueError(f"no surface lies within {reach} m of the origin, as a grid of {edge} m sees it")
    vertices, faces, _, _ = marching_cubes(grid, level=0.0, gradient_direction="descent")
    vertices = origin + edge * vertices.astype(np.float64)
    faces = faces.astype(np.int64)
    joined = _neighbours(faces, len(vertices))
    pieces = connected_components(joined, directed=False)[0]
    if pieces != 1:
        raise ValueError(f"the surface has {pieces} pieces at a resolution of {edge} m; it must be one")
    average = joined.multiply(1 / joined.sum(axis=1)[:, None]).tocsr()
    vertices, normals = _projected(shape, vertices, _FEW_STEPS)
    for _ in range(_ROUNDS):
        shift = average @ vertices - vertices
        # Along the surface only, so that projecting has little left to do.
        shift -= (shift * normals).sum(axis=1)[:, None] * normals
        vertices, normals = _projected(shape, vertices + shift, _FEW_STEPS)
    vertices, normals = _projected(shape, vertices, _MANY_STEPS)
    mesh = TriangleMesh(vertices, faces, normals)
    farthest = np.linalg.norm(vertices, axis=1).max()
    if farthest > reach * (1 + 1e-9):
        raise ValueError(f"the surface goes {farthest:.4g} m from the origin, beyond its reach of {reach} m")
    facets = area_vectors(vertices, faces)
    folded = (np.einsum("fi,fci->fc", facets, normals[faces]) <= 0).any(axis=1)
    if folded.any():
        x, y, z = vertices[faces[folded][0, 0]]
        raise ValueError(
            f"the surface turns too sharply for a resolution of {edge} m at {folded.sum()} of {len(faces)} faces,"
            f" one at ({x:.4f}, {y:.4f}, {z:.4f}) m; give a finer one"
        )
    if not is_watertight(mesh):
        raise ValueError(f"the mesh is not closed at a resolution of {edge} m; give a finer one")
    return mesh


def _grid(shape: Implicit, reach: float, edge: float) -> tuple[NDArray[np.float32], Floats]:
    """The function on a grid, and the place of its first point; far from the surface, only its sign."""
    count = int(reach / (edge * _BLOCK)) + 1
    side = np.arange(-count, count, dtype=np.float64)
    blocks = np.stack(np.meshgrid(side, side, side, indexing="ij"), axis=-1)
    middles = (blocks + 0.5) * (_BLOCK * edge)
    centres = _values(shape, middles.reshape(-1, 3)).reshape(blocks.shape[:3])
    # Half a block's diagonal, and a cell more: the cells between blocks belong to all of them.
    near = np.abs(centres) < _STEEPEST * np.sqrt(3) * (_BLOCK / 2 + 1) * edge
    if not near.any():
        return np.sign(centres).astype(np.float32), np.zeros(3)
    ends = np.argwhere(near).min(axis=0), np.argwhere(near).max(axis=0) + 1
    crop = tuple(slice(low, high) for low, high in zip(*ends, strict=True))
    blocks, centres, near = blocks[crop], centres[crop], near[crop]
    # Axes: blocks along x, y, z, then points within the block along x, y, z.
    values = np.empty((*near.shape, _BLOCK, _BLOCK, _BLOCK), dtype=np.float32)
    values[~near] = np.sign(centres[~near])[:, None, None, None]
    steps = np.stack(np.meshgrid(*[np.arange(_BLOCK)] * 3, indexing="ij"), axis=-1)
    points = (blocks[near][:, None, None, None] * _BLOCK + steps) * edge
    exact = _values(shape, points.reshape(-1, 3))
    clearance = _CLEARANCE * edge
    exact = np.where(np.abs(exact) < clearance, np.where(exact < 0, -clearance, clearance), exact)
    values[near] = exact.reshape(-1, _BLOCK, _BLOCK, _BLOCK)
    grid = values.transpose(0, 3, 1, 4, 2, 5).reshape([size * _BLOCK for size in near.shape])
    return grid, blocks[0, 0, 0] * _BLOCK * edge


def _values(shape: Implicit, points: Floats) -> Floats:
    starts = range(0, len(points), _POINTS_PER_CHUNK)
    return np.concatenate([shape(points[start : start + _POINTS_PER_CHUNK])[0] for start in starts])


def _projected(shape: Implicit, points: Floats, steps: int) -> tuple[Floats, Floats]:
    """Points taken onto the surface along the gradient, and the unit normals there."""
    points = points.copy()
    normals = np.empty_like(points)
    for start in range(0, len(points), _POINTS_PER_CHUNK):
        chunk = slice(start, start + _POINTS_PER_CHUNK)
        for _ in range(steps):
            value, gradient = shape(points[chunk])
            points[chunk] -= (value / (gradient**2).sum(axis=1))[:, None] * gradient
        gradient = shape(points[chunk])[1]
        normals[chunk] = gradient / np.linalg.norm(gradient, axis=1, keepdims=True)
    return points, normals


def _neighbours(faces: NDArray[np.int64], count: int) -> csr_array:
    """Which vertices an edge joins, (count, count) of 0 and 1."""
    start, end = faces.ravel(), np.roll(faces, -1, axis=1).ravel()
    # In a closed surface each edge is run through both ways.
    return coo_array((np.ones(len(start)), (start, end)), shape=(count, count)).tocsr()
