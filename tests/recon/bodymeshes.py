"""Meshes whose images are known by hand."""

from __future__ import annotations

import numpy as np
import trimesh

from recon.mesh.trianglemesh import TriangleMesh, smooth_normals


def mesh_of(vertices: np.ndarray, faces: np.ndarray) -> TriangleMesh:
    return TriangleMesh(vertices, faces, smooth_normals(np.asarray(vertices, float), np.asarray(faces)))


def ball_mesh(centre: tuple[float, float, float], radius: float, subdivisions: int = 5) -> TriangleMesh:
    """An icosphere, whose normals are the sphere's own."""
    made = trimesh.creation.icosphere(subdivisions=subdivisions)
    return TriangleMesh(radius * made.vertices + np.array(centre), made.faces, made.vertices)


def plate(corner: tuple[float, float, float], u: tuple[float, ...], v: tuple[float, ...]) -> TriangleMesh:
    """A parallelogram of two triangles, whose outside is where u x v points."""
    a, u_, v_ = np.array(corner, float), np.array(u, float), np.array(v, float)
    return mesh_of(np.array([a, a + u_, a + u_ + v_, a + v_]), np.array([[0, 1, 2], [0, 2, 3]]))


def joined(*meshes: TriangleMesh) -> TriangleMesh:
    starts = np.cumsum([0, *(len(mesh.vertices) for mesh in meshes)])
    return TriangleMesh(
        np.concatenate([mesh.vertices for mesh in meshes]),
        np.concatenate([mesh.faces + start for mesh, start in zip(meshes, starts, strict=False)]),
        np.concatenate([mesh.normals for mesh in meshes]),
    )
