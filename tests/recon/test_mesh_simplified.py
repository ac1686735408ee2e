"""Meshes of fewer faces: how near they stay, that nothing tears, and what they carry over."""

from __future__ import annotations

import numpy as np
from numpy.testing import assert_allclose

from recon.mesh.rays import RayTracer
from recon.mesh.simplified import Simplification, simplification, simplified
from recon.mesh.tessellated import tessellated
from recon.mesh.trianglemesh import TriangleMesh, is_watertight, smooth_normals

from .bodymeshes import ball_mesh

_ROWS = 64
_FEWER = 8


def _bumpy() -> TriangleMesh:
    """A textured body about the origin: a sphere whose radius is 1 + 0.1 sin 4x sin 4y."""
    ball = tessellated(np.zeros(3), 1.0, _ROWS)
    assert ball.uv is not None
    # At the poles some vertices have no face.
    used, faces = np.unique(ball.faces, return_inverse=True)
    faces = faces.reshape(-1, 3)
    x, y, _ = 4 * ball.vertices[used].T
    vertices = ball.vertices[used] * (1 + 0.1 * np.sin(x) * np.sin(y))[:, None]
    return TriangleMesh(vertices, faces, smooth_normals(vertices, faces), ball.uv[used])


def _few_of(mesh: TriangleMesh) -> Simplification:
    return simplification(mesh, len(mesh.faces) // _FEWER)


def _sag(mesh: TriangleMesh) -> float:
    """How deep a flat face of the median edge h lies below the bumps: h^2 / 8R, their 1 / R at most 2.6."""
    corners = mesh.vertices[mesh.faces]
    return 2.6 * float(np.median(np.linalg.norm(corners - np.roll(corners, 1, axis=1), axis=2))) ** 2 / 8


def _radii(mesh: TriangleMesh, directions: np.ndarray) -> np.ndarray:
    """How far the surface is from the origin in some directions."""
    hits = RayTracer(mesh.vertices, mesh.faces).first_hits(np.zeros_like(directions), directions)
    assert (hits.faces >= 0).all()
    points = np.einsum("nk,nkc->nc", hits.weights, mesh.vertices[mesh.faces[hits.faces]])
    return np.linalg.norm(points, axis=1)


def test_a_mesh_of_few_faces_is_itself() -> None:
    ball = ball_mesh((0, 0, 0), 1.0, 2)
    few = simplification(ball, len(ball.faces))
    assert few.mesh is ball
    assert simplified(ball, len(ball.faces)) is ball
    assert_allclose(few.carried(ball.vertices), ball.vertices)


def test_the_surface_stays_where_it_was() -> None:
    mesh = _bumpy()
    few = _few_of(mesh).mesh
    assert len(few.faces) <= len(mesh.faces) // _FEWER
    directions = np.random.default_rng(1).normal(size=(20_000, 3))
    directions /= np.linalg.norm(directions, axis=1, keepdims=True)
    # One ray from the origin meets each surface once, so that this is how far either lies from the other.
    apart = np.abs(_radii(few, directions) - _radii(mesh, directions))
    assert np.sqrt((apart**2).mean()) < _sag(few)
    # Edges of twice the length sink four times as deep.
    assert apart.max() < 4 * _sag(few)


def test_a_closed_surface_stays_closed_along_seams_too() -> None:
    mesh = _bumpy()
    few = _few_of(mesh).mesh
    assert is_watertight(mesh)
    assert is_watertight(few)
    # Either side of the seam, u = 0 and u = 1, keeps all its vertices.
    for u in (0, 1):
        seam, kept = (each.vertices[each.uv[:, 0] == u] for each in (mesh, few))
        assert len(seam) == len(kept)
        assert_allclose(np.sort(kept, axis=0), np.sort(seam, axis=0))


def test_texture_coordinates_and_normals_are_those_of_the_place() -> None:
    few = _few_of(tessellated(np.zeros(3), 1.0, _ROWS)).mesh
    assert few.uv is not None
    outward = few.vertices / np.linalg.norm(few.vertices, axis=1, keepdims=True)
    across = 2 * np.pi * few.uv[:, 0] - np.arctan2(outward[:, 1], outward[:, 0])
    along = np.pi * (1 - few.uv[:, 1]) - np.arccos(outward[:, 2].clip(-1, 1))
    sines = np.hypot(outward[:, 0], outward[:, 1])
    # Within a face of the original coordinates are linear, which on a sphere they are to the square of its edge.
    edge = np.pi / _ROWS
    assert np.abs(np.angle(np.exp(1j * across)) * sines).max() < edge**2
    assert np.abs(along).max() < edge**2
    # Normals are between those of the original's corners. Those of the new, long faces beside the seam are off by 0.4.
    assert np.linalg.norm(few.normals - outward, axis=1).max() < edge**2


def test_values_at_vertices_are_carried_over() -> None:
    mesh = _bumpy()
    few = _few_of(mesh)
    assert_allclose(few.weights.sum(axis=1), 1)
    assert (few.weights >= 0).all()
    # Those of positions are the nearest points of the original. Vertices lie above it as faces lie below.
    apart = np.linalg.norm(few.carried(mesh.vertices) - few.mesh.vertices, axis=1)
    assert apart.max() < 4 * _sag(few.mesh)


def test_vertices_that_each_face_has_for_itself_are_joined_where_they_agree() -> None:
    ball = ball_mesh((0, 0, 0), 1.0, 4)
    own = np.arange(ball.faces.size).reshape(-1, 3)
    split = TriangleMesh(ball.vertices[ball.faces.ravel()], own, ball.normals[ball.faces.ravel()])
    few = simplified(split, 1000)
    assert len(few.faces) <= 1000
    assert is_watertight(few)


def test_sharp_edges_that_leave_no_face_are_kept() -> None:
    ball = ball_mesh((0, 0, 0), 1.0, 3)
    corners = ball.vertices[ball.faces]
    facets = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    facets /= np.linalg.norm(facets, axis=1, keepdims=True)
    flat = TriangleMesh(
        corners.reshape(-1, 3), np.arange(ball.faces.size).reshape(-1, 3), facets.repeat(3, axis=0)
    )
    assert len(simplified(flat, 100).faces) == len(flat.faces)
    # Unless they needn't be.
    few = simplification(flat, 100, seams=False)
    assert len(few.mesh.faces) <= 100
    assert is_watertight(few.mesh)
    outward = few.mesh.vertices / np.linalg.norm(few.mesh.vertices, axis=1, keepdims=True)
    assert (few.mesh.normals * outward).sum(axis=1).min() > np.cos(np.radians(5))
    # What is carried over is the original's, corner by corner: there these are the nearest points, too.
    assert np.linalg.norm(few.carried(flat.vertices) - few.mesh.vertices, axis=1).max() < 4 * _sag(few.mesh)
