"""What the parts of a mesh send each other, as far as geometry determines it: which faces each vertex sees.

The irradiance of vertex v by faces f of radiance L_f, the same in all directions, is [Goral et al. 1984]

    E_v = sum over f of G_vf L_f,    G_vf = integral of max(n.w, 0) over the directions w in which v meets f first

so that the sum of G_vf over f is pi on a vertex that sees nothing but the mesh.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import csr_array, vstack

from capture.parallel import parallel_map
from recon.mesh.bodies import MeshBody
from recon.mesh.tangents import tangents

Floats = NDArray[np.float64]

_RAYS_AT_A_TIME = 1 << 18
# Rays in all, that a scan of a million vertices doesn't fill the memory: its vertices then have fewer each, as many as
# before on a piece of surface.
_MOST_RAYS, _FEWEST_EACH = 1 << 24, 32


def face_exchange(body: MeshBody, concave: NDArray[np.bool_], rays: int = 256) -> csr_array:
    """How faces light vertices, (v, f) float32, steradian; on all cores.

    concave : (v,) which vertices may see part of the mesh; rows of the others are empty and cost nothing. rays : per
    vertex, drawn as the cosine, evenly; the error of a row's sum falls as rays^-0.75. They begin as in
    `recon.mesh.transfer.transfer_vectors`, so that a convex body sends itself nothing. The back of a face sends
    nothing. The same mesh gives the same numbers. Raises ValueError for fewer than 1 ray.
    """
    if rays < 1:
        raise ValueError(f"rays is {rays}; there must be at least 1 per vertex")
    mesh = body.mesh
    shape = (len(mesh.vertices), len(mesh.faces))
    vertices = np.flatnonzero(concave)
    if not len(vertices):
        return csr_array(shape, dtype=np.float32)
    each = min(rays, max(_MOST_RAYS // len(vertices), _FEWEST_EACH))
    size = max(_RAYS_AT_A_TIME // each, 1)

    def seen(first: int) -> csr_array:
        chosen = vertices[first : first + size]
        directions = _cosine_directions(mesh.normals[chosen], each, np.random.default_rng(first))
        row = np.repeat(np.arange(len(chosen)), each)
        origins, facets = mesh.vertices[chosen][row], mesh.normals[chosen][row]
        met = body.tracer.first_hits(origins, directions, facets).faces
        front = (met >= 0) & ((body.facets[met] * directions).sum(axis=1) < 0)
        entries = np.full(int(front.sum()), np.pi / each, np.float32)
        return csr_array((entries, (row[front], met[front])), shape=(len(chosen), shape[1]))

    some = vstack(list(parallel_map(seen, range(0, len(vertices), size)))).tocoo()
    return csr_array((some.data, (vertices[some.row], some.col)), shape=shape)


def _cosine_directions(normals: Floats, count: int, rng: np.random.Generator) -> Floats:
    """Unit vectors (n * count, 3) about normals (n, 3), as dense as the cosine: a spiral on the disk below, turned."""
    radius = np.sqrt((np.arange(count) + rng.random((len(normals), 1))) / count)
    azimuth = np.pi * (1 + np.sqrt(5)) * np.arange(count) + 2 * np.pi * rng.random((len(normals), 1))
    across, up = np.moveaxis(tangents(normals), -2, 0)
    parts = (radius * np.cos(azimuth), radius * np.sin(azimuth), np.sqrt(1 - radius**2))
    directions = sum(
        part[:, :, None] * axis[:, None] for part, axis in zip(parts, (across, up, normals), strict=True)
    )
    return np.asarray(directions).reshape(-1, 3)
