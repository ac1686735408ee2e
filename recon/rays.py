"""Rays on a triangle mesh, by Embree: what they meet first, and whether they meet anything.

Embree works in single precision. The mesh is therefore moved to the origin and scaled to unit size before it is
handed over, rays begin near it, and where a ray meets the triangle that Embree names is computed again in double
precision. `embreex` checks nothing (arrays of the wrong shape are read beyond their end), so everything is checked
here. From version 4.4 on it releases the interpreter while it traces: threads can share one tracer.
"""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
from embreex.mesh_construction import TriangleMesh as EmbreeMesh
from embreex.rtcore_scene import EmbreeScene
from numpy.typing import ArrayLike, NDArray

from capture.arrays import frozen_array

Floats = NDArray[np.float64]
AnyFloats = NDArray[np.floating]
Ints = NDArray[np.int32]

# Rays leave a surface from so far above it, in sizes of the mesh: far more than single precision rounds (1e-7), so
# that no facet shadows itself, and less than anything whose shadow is worth having.
_OFFSET = 1e-4
# Weights of corners that are further outside 0 to 1 come from a triangle that the ray sees edge-on.
_OUTSIDE = 1e-2


@dataclass(frozen=True, eq=False)
class Hits:
    """What n rays meet first.

    faces : (n,) int32 index, -1 where a ray meets nothing. weights : (n, 3) of the face's corners, sum 1, zeros
    where it meets nothing. They leave 0 to 1 by as much as single precision misses the border of a face: 1e-7 of
    the mesh's size.
    """

    faces: Ints
    weights: Floats


@dataclass(frozen=True, eq=False)
class RayTracer:
    """A mesh that rays can be traced on, met from both sides of its faces; built anew where it is unpickled.

    vertices : (v, 3) metres. faces : (f, 3) indices of vertices.
    centre : (3,), and size, metres: the middle and the longest side of the box around the faces.
    """

    vertices: Floats
    faces: NDArray[np.integer]
    centre: Floats = field(init=False)
    size: float = field(init=False)
    _planes: Floats = field(init=False, repr=False)
    _scene: EmbreeScene = field(init=False, repr=False)

    def __post_init__(self) -> None:
        vertices, faces = _checked_mesh(self.vertices, self.faces)
        used = vertices[np.unique(faces)]
        low, high = used.min(axis=0), used.max(axis=0)
        size = float((high - low).max())
        if not size > 0:
            raise ValueError(f"all vertices of the mesh are at {low.tolist()}; its size must be > 0")
        object.__setattr__(self, "vertices", frozen_array(vertices))
        object.__setattr__(self, "faces", frozen_array(faces, np.int32))
        object.__setattr__(self, "centre", frozen_array((low + high) / 2))
        object.__setattr__(self, "size", size)
        object.__setattr__(self, "_planes", _planes((self.vertices[self.faces] - self.centre) / size))
        scene = EmbreeScene()
        EmbreeMesh(scene, self._unit(self.vertices).astype(np.float32), self.faces)
        # The first call builds the tree, which threads must not do at the same time.
        nothing = np.zeros((0, 3), np.float32)
        scene.run(nothing, nothing)
        object.__setattr__(self, "_scene", scene)

    def __reduce__(self) -> tuple[type[RayTracer], tuple[Floats, NDArray[np.integer]]]:
        return RayTracer, (self.vertices, self.faces)

    def first_hits(self, origins: AnyFloats, directions: AnyFloats, facets: AnyFloats | None = None) -> Hits:
        """What rays from origins (n, 3), metres, in unit directions (n, 3) meet first.

        facets : (n, 3) unit, outward, for origins on the mesh itself: the rays begin as in `occluded`.
        """
        starts = self._starts(origins, directions, facets)
        # A far origin, of which single precision would lose digits, moves along its ray to 1 size before the centre.
        starts -= np.minimum(_dot(starts, directions) + 1, 0)[:, None] * directions
        found = self._scene.run(
            starts.astype(np.float32), directions.astype(np.float32, copy=False), output=1
        )
        faces: Ints = found["primID"]
        hit = np.flatnonzero(faces >= 0)
        w, u, v = self._crossings(faces[hit], starts[hit], directions[hit])
        # Along a triangle's plane that is a division by next to nothing; Embree's own answer is sane.
        edge_on = np.flatnonzero(~((w > -_OUTSIDE) & (u > -_OUTSIDE) & (v > -_OUTSIDE)))
        u[edge_on], v[edge_on] = found["u"][hit[edge_on]], found["v"][hit[edge_on]]
        w[edge_on] = 1 - u[edge_on] - v[edge_on]
        weights = np.zeros((len(faces), 3))
        weights[hit] = np.column_stack([w, u, v])
        return Hits(faces, weights)

    def occluded(
        self,
        positions: AnyFloats,
        facets: AnyFloats,
        directions: AnyFloats,
        distances: AnyFloats | None = None,
    ) -> NDArray[np.bool_]:
        """Whether rays that leave points of the mesh meet it again, (n,).

        positions : (n, 3) metres. The rays begin 1e-4 of the mesh's size above them, along facets : (n, 3) unit,
        outward. directions : (n, 3) unit; those below the facet count as occluded without a ray.
        distances : (n,) metres, > 0, may be inf: what is further away doesn't count.
        """
        starts = self._starts(positions, directions, facets)
        below = np.einsum("nc,nc->n", directions, facets.astype(directions.dtype, copy=False)) <= 0
        if distances is None:
            # Embree lets a ray of negative length go at once.
            ends = np.where(below, np.float32(-1), np.float32(np.inf))
        else:
            if distances.shape != below.shape or not (distances > 0).all():
                raise ValueError(
                    f"distances of shape {distances.shape}, the least {np.min(distances, initial=np.inf)};"
                    f" they must be {below.shape} and > 0"
                )
            ends = np.where(below, -1, distances / self.size).astype(np.float32)
        ways = directions.astype(np.float32, copy=False)
        met = self._scene.run(starts.astype(np.float32), ways, ends, query="OCCLUDED") >= 0
        return np.asarray(below | met)

    def _starts(self, origins: AnyFloats, directions: AnyFloats, facets: AnyFloats | None) -> Floats:
        """Where rays begin, in sizes of the mesh from its centre, (n, 3)."""
        for name, vectors in (("origins", origins), ("directions", directions), ("facets", facets)):
            if vectors is not None:
                _check_vectors(name, vectors, len(origins))
        starts = self._unit(origins)
        if facets is not None:
            starts += _OFFSET * facets
        return starts

    def _unit(self, points: AnyFloats) -> Floats:
        return np.asarray((points - self.centre) / self.size)

    def _crossings(
        self, faces: Ints, origins: Floats, directions: AnyFloats
    ) -> tuple[Floats, Floats, Floats]:
        """Weights of the three corners, (n,) each, where lines cross the planes of faces (n,).

        Not finite where a line lies in the plane.
        """
        corner, normal, to_u, to_v = self._planes[faces].transpose(1, 0, 2)
        offset = corner - origins
        with np.errstate(divide="ignore", invalid="ignore", over="ignore"):
            distance = _dot(normal, offset) / _dot(normal, directions)
            within = distance[:, None] * directions - offset
            u, v = _dot(to_u, within), _dot(to_v, within)
            return 1 - u - v, u, v


def _checked_mesh(vertices: ArrayLike, faces: ArrayLike) -> tuple[Floats, NDArray[np.integer]]:
    vertices, faces = np.asarray(vertices, float), np.asarray(faces)
    if vertices.ndim != 2 or vertices.shape[1] != 3 or not np.isfinite(vertices).all():
        raise ValueError(f"vertices of shape {vertices.shape}; they must be (v, 3) and finite")
    if faces.ndim != 2 or faces.shape[1] != 3 or not len(faces) or faces.dtype.kind not in "iu":
        raise ValueError(
            f"faces are {faces.shape} {faces.dtype}; they must be (f, 3) integers, at least one face"
        )
    if faces.min() < 0 or faces.max() >= len(vertices):
        raise ValueError(
            f"faces name vertices {faces.min()} to {faces.max()}; there are 0 to {len(vertices) - 1}"
        )
    return vertices, faces


def _check_vectors(name: str, vectors: AnyFloats, count: int) -> None:
    if vectors.shape != (count, 3):
        raise ValueError(f"{name} are {vectors.shape}; they must be {(count, 3)}, one for each ray")
    # The sum finds what is not finite in a fraction of the time that asking each number takes.
    with np.errstate(invalid="ignore"):
        total = vectors.sum()
    if not np.isfinite(total):
        row = int(np.flatnonzero(~np.isfinite(vectors).all(axis=1))[0])
        raise ValueError(f"{name}[{row}] is {vectors[row]}; all must be finite")


def _planes(corners: Floats) -> Floats:
    """Of triangles (f, 3, 3): a corner, the normal, and the vectors that give u and v of a point, (f, 4, 3).

    With the edges b and c from that corner and n = b x c, a point p = u b + v c of the plane has
    u = p . (c x n) / n^2 and v = p . (n x b) / n^2.
    """
    corner = corners[:, 0]
    b, c = corners[:, 1] - corner, corners[:, 2] - corner
    normal = np.cross(b, c)
    # Triangles without area have no such vectors; no ray meets them.
    with np.errstate(divide="ignore", invalid="ignore", over="ignore"):
        scale = 1 / _dot(normal, normal)[:, None]
        return np.stack([corner, normal, np.cross(c, normal) * scale, np.cross(normal, b) * scale], axis=1)


def _dot(a: AnyFloats, b: AnyFloats) -> Floats:
    return np.asarray(np.einsum("nc,nc->n", a, b))
