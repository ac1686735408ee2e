"""Triangle meshes as surfaces: smooth to the eye, with the shadows of their triangles."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from capture.arrays import frozen_array
from recon.mesh.rays import RayTracer
from recon.mesh.trianglemesh import TriangleMesh, area_vectors, is_watertight, volume
from synthetic.shapes.surface import Points
from synthetic.shapes.tangents import tangents

Floats = NDArray[np.float64]
AnyFloats = NDArray[np.floating]

# Three directions of no particular kind, each seen to be inside or not; two of them decide.
_PROBES = np.array(
    [[0.3, 0.5, 0.8124038404635961], [-0.7, 0.6, -0.3872983346207417], [0.2, -0.9, -0.3872983346207417]]
)


@dataclass(frozen=True, eq=False)
class MeshSurface:
    """A closed mesh as a `Surface`.

    Normals are the vertices' own, interpolated and made unit again. Shadows are those of the flat triangles: a
    direction below the facet is occluded even where it is above the interpolated normal's horizon (as renderers
    have it), so the terminator follows the edges of the triangles, which a finer mesh makes small.
    Tangents follow u where the mesh has texture coordinates, otherwise they are horizontal, counterclockwise about +Z.
    Raises ValueError for a mesh that is open or inside out.
    """

    mesh: TriangleMesh
    centre: Floats = field(init=False)
    reach: float = field(init=False)
    _tracer: RayTracer = field(init=False, repr=False)
    _facets: Floats = field(init=False, repr=False)
    _along_u: Floats | None = field(init=False, repr=False)

    convex = False

    def __post_init__(self) -> None:
        if not is_watertight(self.mesh):
            raise ValueError("the mesh isn't closed, or its faces aren't oriented alike; repair it first")
        if not (enclosed := volume(self.mesh)) > 0:
            raise ValueError(
                f"the mesh is inside out (volume {enclosed:.3g} m^3); flip its faces and normals"
            )
        tracer = RayTracer(self.mesh.vertices, self.mesh.faces)
        areas = area_vectors(self.mesh.vertices, self.mesh.faces)
        # A triangle without area has no facet, and no ray meets it.
        lengths = np.maximum(np.linalg.norm(areas, axis=1, keepdims=True), np.finfo(float).tiny)
        reach = np.linalg.norm(self.mesh.vertices - tracer.centre, axis=1).max()
        object.__setattr__(self, "centre", tracer.centre)
        object.__setattr__(self, "reach", float(reach))
        object.__setattr__(self, "_tracer", tracer)
        object.__setattr__(self, "_facets", frozen_array(areas / lengths))
        object.__setattr__(
            self, "_along_u", None if self.mesh.uv is None else _along_u(self.mesh, self.mesh.uv)
        )

    def first_hits(
        self, origins: Floats, directions: AnyFloats, facets: Floats | None = None
    ) -> tuple[NDArray[np.bool_], Points]:
        found = self._tracer.first_hits(origins, directions, facets)
        hit = found.faces >= 0
        return hit, self._points(found.faces[hit], found.weights[hit])

    def met(self, origins: Floats, directions: AnyFloats) -> NDArray[np.bool_]:
        return np.asarray(self._tracer.first_hits(origins, directions).faces >= 0)

    def vertex_points(self) -> Points:
        """The vertices as points of the surface, (v), facing as they are shaded."""
        mesh = self.mesh
        uv = np.zeros((len(mesh.vertices), 2)) if mesh.uv is None else mesh.uv
        along = tangents(mesh.normals, self._along_u)
        return Points(mesh.vertices, mesh.normals, mesh.normals, along, uv)

    def occluded(
        self,
        positions: Floats,
        facets: AnyFloats,
        directions: AnyFloats,
        distances: Floats | None = None,
    ) -> NDArray[np.bool_]:
        return self._tracer.occluded(positions, facets, directions, distances)

    def contains(self, points: Floats) -> NDArray[np.bool_]:
        """Whether points (n, 3) lie inside: from there, the surface that is met first turns away."""
        votes = np.zeros(len(points), int)
        for probe in _PROBES:
            faces = self._tracer.first_hits(points, np.broadcast_to(probe, points.shape)).faces
            votes += (faces >= 0) & (self._facets[faces] @ probe > 0)
        return votes >= 2

    def _points(self, faces: NDArray[np.int32], weights: Floats) -> Points:
        corners = self._tracer.faces[faces]
        facets = self._facets[faces]
        normals = _mean(self.mesh.normals, corners, weights)
        lengths = np.linalg.norm(normals, axis=1, keepdims=True)
        # Corners may face opposite ways; between them only the facet says where the surface faces.
        normals = np.where(lengths > 1e-6, normals / np.maximum(lengths, 1e-6), facets)
        uv = np.zeros((len(faces), 2)) if self.mesh.uv is None else _mean(self.mesh.uv, corners, weights)
        along = None if self._along_u is None else _mean(self._along_u, corners, weights)
        return Points(
            positions=_mean(self.mesh.vertices, corners, weights),
            normals=normals,
            facets=facets,
            tangents=tangents(normals, along),
            uv=uv,
            corners=self.mesh.faces[faces],
            shares=weights,
        )


def _mean(values: Floats, corners: NDArray[np.integer], weights: Floats) -> Floats:
    """Means (n, c) of the values (v, c) of corners (n, 3), weighted (n, 3)."""
    return np.asarray(np.einsum("nk,nkc->nc", weights, values[corners]))


def _along_u(mesh: TriangleMesh, uv: Floats) -> Floats:
    """The direction in which u grows at each vertex (v, 3): that of its faces, each weighted by its area.

    From P = P0 + u P_u + v P_v on a face: P_u = (dv2 dP1 - dv1 dP2) / (du1 dv2 - du2 dv1).
    """
    (a, b, c), (s, t, r) = (np.moveaxis(values[mesh.faces], 1, 0) for values in (mesh.vertices, uv))
    one, other = t - s, r - s
    turned = one[:, 0] * other[:, 1] - other[:, 0] * one[:, 1]
    along = np.sign(turned)[:, None] * (other[:, 1:] * (b - a) - one[:, 1:] * (c - a))
    length = np.linalg.norm(along, axis=1)
    area = np.linalg.norm(np.cross(b - a, c - a), axis=1)
    along *= (area / np.where(length > 0, length, 1))[:, None]
    sums = np.zeros_like(mesh.vertices)
    for corner in mesh.faces.T:
        np.add.at(sums, corner, along)
    return frozen_array(sums)
