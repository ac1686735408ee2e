"""Meshes of many faces made of fewer, for pictures that must come fast."""

from __future__ import annotations

from dataclasses import dataclass
from threading import Lock

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import csr_array

from recon.mesh.bodies import blended
from recon.mesh.trianglemesh import TriangleMesh, merged_faces, smooth_normals

Floats = NDArray[np.float64]
Ints = NDArray[np.int64]

# The library keeps the mesh that it works on in one place for all threads.
_ONE_AT_A_TIME = Lock()


@dataclass(frozen=True, eq=False)
class Simplification:
    """A mesh of fewer faces, and where its v vertices lie on the original.

    corners : (v, 3) vertices of the original's face that is nearest. weights : (v, 3) of these, sum 1.
    """

    mesh: TriangleMesh
    corners: Ints
    weights: Floats

    def carried(self, values: NDArray[np.floating]) -> Floats:
        """Values (v, k) at its vertices of those (n, k) at the original's."""
        return blended(values, self.corners, self.weights)


def simplified(mesh: TriangleMesh, most_faces: int, seams: bool = True) -> TriangleMesh:
    """A mesh with edges collapsed until it has so many faces at most; itself where it has no more.

    seams : whether seams of the texture and sharp edges, where vertices are doubled, stay as they are, as borders do;
    where these alone take more faces, so does it. Without them it has no texture coordinates, and smooth normals.
    """
    return simplification(mesh, most_faces, seams).mesh


def simplification(mesh: TriangleMesh, most_faces: int, seams: bool = True) -> Simplification:
    """As `simplified`, with what carries values at vertices over."""
    if len(mesh.faces) <= most_faces:
        corners = np.repeat(np.arange(len(mesh.vertices))[:, None], 3, axis=1)
        return Simplification(mesh, corners, np.broadcast_to([1.0, 0.0, 0.0], corners.shape))
    # Slow to import, and needed only for large meshes.
    from fast_simplification import simplify

    place = _joined(mesh) if seams else merged_faces(mesh.vertices, mesh.faces)
    points = np.zeros((int(place.max()) + 1, 3))
    points[place] = mesh.vertices[mesh.faces]
    whole = np.flatnonzero((place != np.roll(place, 1, axis=1)).all(axis=1))
    faces = place[whole]
    with _ONE_AT_A_TIME:
        vertices, _, collapses = simplify(
            points, faces, target_count=most_faces, return_collapses=True, preserve_border=True
        )
    survivor = _survivors(len(points), collapses)
    left = survivor[faces]
    left = left[(left != np.roll(left, 1, axis=1)).all(axis=1)]
    kept, new_faces = np.unique(left, return_inverse=True)
    # The library leaves out vertices without faces, and keeps the order of the others.
    number = np.full(len(points), -1)
    number[kept] = np.arange(len(kept))
    nearest, weights = _nearest(points, faces, vertices, number[survivor])
    corners = mesh.faces[whole[nearest]]
    # Smooth normals of the new faces would be off where long faces meet short ones, as beside seams.
    normals = blended(mesh.normals if seams else _smooth(mesh, mesh.faces[whole]), corners, weights)
    normals /= np.linalg.norm(normals, axis=1, keepdims=True)
    uv = blended(mesh.uv, corners, weights) if seams and mesh.uv is not None else None
    return Simplification(TriangleMesh(vertices, new_faces.reshape(-1, 3), normals, uv), corners, weights)


def _smooth(mesh: TriangleMesh, faces: Ints) -> Floats:
    """Smooth normals (n, 3) of a mesh's vertices, zero where it has none of some faces."""
    used, own = np.unique(faces, return_inverse=True)
    normals = np.zeros_like(mesh.vertices)
    normals[used] = smooth_normals(mesh.vertices[used], own.reshape(-1, 3))
    return normals


def _joined(mesh: TriangleMesh) -> Ints:
    """Faces (f, 3) by places of their corners among vertices that differ in anything they have."""
    columns = [mesh.vertices, mesh.normals] + ([] if mesh.uv is None else [mesh.uv])
    rows = np.hstack(columns)
    order = np.lexsort(rows.T)
    differs = np.ones(len(rows), bool)
    differs[1:] = (rows[order[1:]] != rows[order[:-1]]).any(axis=1)
    place = np.empty(len(rows), np.int64)
    place[order] = differs.cumsum() - 1
    return place[mesh.faces]


def _survivors(count: int, collapses: Ints) -> Ints:
    """Which vertex each of so many has become part of, itself if of none.

    collapses : (c, 2), each a vertex and another that becomes part of it.
    """
    into = np.arange(count)
    into[collapses[:, 1]] = collapses[:, 0]
    while not np.array_equal(further := into[into], into):
        into = further
    return into


def _nearest(points: Floats, faces: Ints, vertices: Floats, part_of: Ints) -> tuple[Ints, Floats]:
    """The face (v,) nearest to each new vertex, and the weights (v, 3) of its corners there.

    part_of : (n,) of which new vertex each of the points has become part; -1 of none. The search begins at the nearest
    of a new vertex's own points and goes from face to face, so that nothing comes from another sheet of the surface or
    of its texture, which may lie nearer.
    """
    own = np.flatnonzero(part_of >= 0)
    home = own[_least_of_each(part_of[own], _squared(points[own] - vertices[part_of[own]]))]
    count = len(faces)
    around = csr_array(
        (np.ones(3 * count, bool), (faces.ravel(), np.arange(count).repeat(3))), shape=(len(points), count)
    )
    nearest, weights = np.zeros(len(vertices), np.int64), np.zeros((len(vertices), 3))
    least, active = np.full(len(vertices), np.inf), np.arange(len(vertices))
    while len(active):
        asked = around[home[active]]
        row, asked_corners = np.arange(len(active)).repeat(np.diff(asked.indptr)), faces[asked.indices]
        at = vertices[active[row]]
        found = _weights(at, points[asked_corners])
        apart = _squared(blended(points, asked_corners, found) - at)
        best = _least_of_each(row, apart)
        nearer = apart[best] < least[active]
        best, active = best[nearer], active[nearer]
        least[active], nearest[active], weights[active] = apart[best], asked.indices[best], found[best]
        home[active] = faces[nearest[active], weights[active].argmax(axis=1)]
    return nearest, weights


def _squared(vectors: Floats) -> Floats:
    return np.asarray((vectors**2).sum(axis=1))


def _least_of_each(group: Ints, keys: Floats) -> Ints:
    """The row of each group, 0 to the last, that has the least key."""
    order = np.lexsort([keys, group])
    return order[np.flatnonzero(np.diff(group[order], prepend=-1))]


def _weights(at: Floats, corners: Floats) -> Floats:
    """Weights (n, 3) of the corners (n, 3, 3) of triangles at their points nearest to others (n, 3)."""
    a, b, c = corners[:, 0], corners[:, 1], corners[:, 2]
    inside = _inner_weights(at - a, b - a, c - a)
    above = np.asarray((inside >= 0).all(axis=1))
    found = np.where(above[:, None], inside, 0)
    # No side is nearer than the face itself.
    least = np.where(above, -1.0, np.inf)
    for k in range(3):
        start, side = corners[:, k], corners[:, k - 2] - corners[:, k]
        length = np.maximum(_squared(side), np.finfo(float).tiny)
        along = np.clip(((at - start) * side).sum(axis=1) / length, 0, 1)
        apart = _squared(start + along[:, None] * side - at)
        nearer = apart < least
        least[nearer] = apart[nearer]
        found[nearer] = 0
        found[nearer, k], found[nearer, k - 2] = 1 - along[nearer], along[nearer]
    return found


def _inner_weights(at: Floats, one: Floats, other: Floats) -> Floats:
    """Weights (n, 3) of a triangle's corners at a point's foot on its plane; sides and point as seen from the first."""
    aa, ab, bb = ((x * y).sum(axis=1) for x, y in ((one, one), (one, other), (other, other)))
    pa, pb = (at * one).sum(axis=1), (at * other).sum(axis=1)
    area = np.maximum(aa * bb - ab**2, np.finfo(float).tiny)
    v, w = (bb * pa - ab * pb) / area, (aa * pb - ab * pa) / area
    return np.stack([1 - v - w, v, w], axis=1)
