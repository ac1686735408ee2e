"""Diffuse transfer under visibility: how each spherical harmonic of distant light lights each vertex of a mesh.

Per vertex with normal n, in the axes in which the mesh is given [Sloan, Kautz and Snyder 2002: shadowed diffuse
transfer, here without albedo]:

    t_lm = integral over the sphere of V(w) Y_lm(w) max(n.w, 0) dw

so that light with coefficients L_lm gives the irradiance sum t_lm L_lm. Without shadows t_lm = A_l Y_lm(n), known
exactly; rays are spent on what is taken from that, the integral over the occluded directions.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from capture.arrays import frozen_array
from capture.parallel import one_blas_thread, parallel_map
from recon.harmonics.basis import clamped_cosine_transfer, evaluate_harmonics, sphere_directions
from recon.harmonics.rotations import rotated_harmonics
from recon.mesh.rays import RayTracer
from recon.mesh.trianglemesh import TriangleMesh

Floats = NDArray[np.float64]
Singles = NDArray[np.float32]

# Vertices times directions that are looked at together, to bound memory; and into how many groups, each with
# directions of its own, the vertices of a small mesh are divided nevertheless.
_RAYS_AT_A_TIME, _LEAST_GROUPS = 1 << 18, 16


@dataclass(frozen=True, eq=False)
class TransferVectors:
    """Transfer of distant light to the irradiance of v vertices.

    coefficients : (v, (l_max + 1)^2) float32, steradian; that of degree l and order m is in column l * l + l + m.
    std : (v,) float32, standard deviation of a vertex's coefficients, root mean square over them: of the shadows'
        borders, which a limited number of rays meets. 0 where nothing was occluded: those are exact.
    """

    coefficients: Singles
    std: Singles

    def __post_init__(self) -> None:
        object.__setattr__(self, "coefficients", frozen_array(self.coefficients, np.float32))
        object.__setattr__(self, "std", frozen_array(self.std, np.float32))
        shape = self.coefficients.shape
        if len(shape) != 2 or (self.l_max + 1) ** 2 != shape[1] or self.std.shape != shape[:1]:
            raise ValueError(
                f"coefficients are {shape} and std {self.std.shape}; they must be (v, (l_max + 1)^2) and (v,)"
            )

    @property
    def l_max(self) -> int:
        return round(np.sqrt(self.coefficients.shape[1])) - 1

    def rotated(self, rotation: Floats) -> TransferVectors:
        """The transfer of the mesh turned by a rotation (3, 3), such as that of `mesh_to_world`."""
        return TransferVectors(rotated_harmonics(self.coefficients, rotation), self.std)


def transfer_vectors(mesh: TriangleMesh, l_max: int, rays: int = 256) -> TransferVectors:
    """Transfer vectors of a mesh's vertices, on all cores.

    rays : per vertex, over its hemisphere; the error falls as rays^-0.75. Rays leave 1e-4 of the mesh's size above
    the vertex, along its smooth normal, and may pass below an adjoining facet where that doesn't stand in their way:
    a convex body never shadows itself. What a ray meets occludes from its back too. The same mesh gives the same
    numbers. Raises ValueError for l_max below 0 or fewer than 2 rays.

    Vertices that share directions share their harmonics, and the projection is one matrix product: 2 * rays
    directions over the whole sphere, those below the horizon costing nothing. They are an even set turned twice at
    random, which gives two independent estimates; the result is their mean, its error half their difference. Every
    group of vertices has turns of its own, so that errors of neighbours don't add up to a pattern.
    """
    if l_max < 0:
        raise ValueError(f"l_max is {l_max}; it must be >= 0")
    if rays < 2:
        raise ValueError(f"rays is {rays}; there must be at least 2 per vertex")
    tracer = RayTracer(mesh.vertices, mesh.faces)
    count = len(mesh.vertices)
    coefficients = np.empty((count, (l_max + 1) ** 2), np.float32)
    std = np.empty(count, np.float32)
    per_degree = np.repeat(clamped_cosine_transfer(l_max), 2 * np.arange(l_max + 1) + 1)
    even = sphere_directions(rays)
    groups = max(-(-count * rays // _RAYS_AT_A_TIME), _LEAST_GROUPS)

    def transfer(group: int) -> None:
        # Every so many vertices: neighbours in space are mostly neighbours in the list.
        positions, normals = mesh.vertices[group::groups], mesh.normals[group::groups]
        turns = Rotation.random(2, np.random.default_rng(group)).as_matrix()
        one, other = (_shadow(tracer, positions, normals, even @ turn.T, l_max) for turn in turns)
        coefficients[group::groups] = per_degree * evaluate_harmonics(normals, l_max) - (one + other) / 2
        std[group::groups] = np.sqrt(np.mean(((one - other) / 2) ** 2, axis=1))

    with one_blas_thread():
        for _ in parallel_map(transfer, range(groups)):
            pass
    return TransferVectors(coefficients, std)


def _shadow(tracer: RayTracer, positions: Floats, normals: Floats, directions: Floats, l_max: int) -> Singles:
    """The integral of Y_lm max(n.w, 0) over the occluded directions, from an even set of them (k, 3)."""
    blocked = tracer.occluded_sky(positions, normals, directions)
    weights = normals.astype(np.float32) @ directions.T.astype(np.float32)
    np.maximum(weights, 0, out=weights)
    weights *= blocked
    harmonics = evaluate_harmonics(directions, l_max) * (4 * np.pi / len(directions))
    return np.asarray(weights @ harmonics.astype(np.float32))
