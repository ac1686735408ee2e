"""Scans as they come: dirt, holes, twisted faces, other units."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
import trimesh
from numpy.testing import assert_allclose

from capture.photoset import load_photoset
from recon.mesh.shape import largest_piece, opening_warnings, placed, read_object_mesh, without_loose_pieces
from recon.mesh.trianglemesh import TriangleMesh, is_watertight

from .bodymeshes import ball_mesh, joined, mesh_of

MANIFEST = """
format = 1
name = "scan"
camera = { model = "PINHOLE", params = [100.0, 100, 50, 50], width = 100, height = 100 }
object = { shape = "mesh", mesh = "scan.ply", unit = "mm" }
[[photo]]
file = "a.png"
world_to_camera = [[1.0, 0, 0, 0], [0, 1, 0, 0], [0, 0, 1, 1], [0, 0, 0, 1]]
"""


def scan_set(folder: Path, mesh: trimesh.Trimesh) -> Path:
    (folder / "photoset.toml").write_text(MANIFEST)
    mesh.export(folder / "scan.ply")
    return folder


def crumbs(count: int, size: float, seed: int = 0) -> TriangleMesh:
    """Loose triangles about the origin."""
    rng = np.random.default_rng(seed)
    corners = rng.normal(size=(count, 1, 3)) + size * rng.normal(size=(count, 3, 3))
    return mesh_of(corners.reshape(-1, 3), np.arange(3 * count).reshape(-1, 3))


def test_a_scan_in_millimetres_is_read_in_metres(tmp_path):
    photoset = load_photoset(scan_set(tmp_path, trimesh.creation.icosphere(radius=20.0)))
    read = read_object_mesh(photoset)
    assert_allclose(np.linalg.norm(read.mesh.vertices, axis=1), 0.02, rtol=1e-6)  # PLY holds single precision
    assert not read.warnings
    assert_allclose(photoset.mesh_to_world, np.eye(4))


def test_dirt_is_left_out_and_said():
    ball = ball_mesh((0, 0, 0), 1.0, 3)
    kept, warnings = without_loose_pieces(joined(ball, crumbs(100_000, 1e-5)))
    assert len(kept.faces) == len(ball.faces)
    assert is_watertight(kept)
    assert warnings[0].startswith("100000 loose pieces, ")
    # A second part of its own size is no dirt.
    pair = joined(ball, ball_mesh((3, 0, 0), 0.5, 3))
    kept, (warning,) = without_loose_pieces(pair)
    assert kept is pair
    assert warning.startswith("the mesh has 2 separate pieces; all but the largest hold 20.0% of its area")
    assert len(largest_piece(pair).faces) == len(ball.faces)


def test_a_mesh_in_crumbs_is_refused():
    with pytest.raises(ValueError, match=r"loose pieces, and 20000 small ones hold \d+% of its area; merge"):
        without_loose_pieces(joined(ball_mesh((0, 0, 0), 1.0, 3), crumbs(20_000, 0.01)))


def test_openings_are_counted_and_measured():
    ball = ball_mesh((0, 0, 0), 1.0, 3)
    assert opening_warnings(ball) == []
    far = np.linalg.norm(ball.vertices[ball.faces].mean(axis=1) - [0, 0, 1], axis=1)
    gone = np.zeros(len(ball.faces), bool)
    gone[[far.argmin(), far.argmax()]] = True  # a triangle at either pole
    triangles = ball.vertices[ball.faces[gone]]
    around = np.linalg.norm(triangles - np.roll(triangles, 1, axis=1), axis=2).sum()
    (warning,) = opening_warnings(mesh_of(ball.vertices, ball.faces[~gone]))
    assert warning.startswith(f"the mesh has 2 openings, {around:.3g} m around")


def test_faces_that_disagree_are_refused():
    ball = ball_mesh((0, 0, 0), 1.0, 3)
    faces = ball.faces.copy()
    faces[::10] = faces[::10, ::-1]
    with pytest.raises(ValueError, match=r"\d+% of the mesh's edges join faces that disagree"):
        opening_warnings(TriangleMesh(ball.vertices, faces, ball.normals))


def test_what_is_wrong_with_the_file_names_it(tmp_path):
    with pytest.raises(ValueError, match=r"scan\.ply: .*no faces"):
        read_object_mesh(load_photoset(scan_set(tmp_path, trimesh.Trimesh(np.eye(3)))))
    inside_out = trimesh.creation.icosphere()
    inside_out.invert()
    with pytest.raises(ValueError, match=r"scan\.ply: the mesh is inside out"):
        read_object_mesh(load_photoset(scan_set(tmp_path, inside_out)))
    broken = trimesh.Trimesh(np.array([[0, 0, 0], [1, 0, np.nan], [0, 1, 0]]), [[0, 1, 2]], process=False)
    with pytest.raises(ValueError, match=r"scan\.ply: vertices\[1\] is .*nan"):
        read_object_mesh(load_photoset(scan_set(tmp_path, broken)))


def test_vertices_that_no_face_uses_and_faces_without_area_do_no_harm(tmp_path):
    ball = trimesh.creation.icosphere(radius=20.0)
    vertices = np.vstack([[9.0, 9, 9], ball.vertices, [7.0, 7, 7]])
    faces = np.vstack([ball.faces + 1, [[0, 0, 1], [1, len(vertices) - 1, 1]]])
    read = read_object_mesh(
        load_photoset(scan_set(tmp_path, trimesh.Trimesh(vertices, faces, process=False)))
    ).mesh
    assert len(read.vertices) == len(ball.vertices)
    assert is_watertight(read)


def test_a_mesh_is_put_where_it_belongs():
    ball = ball_mesh((0.5, 0, 0), 0.1, 2)
    turn = np.array([[0, -1.0, 0, 1], [1, 0, 0, 2], [0, 0, 1, 3], [0, 0, 0, 1]])
    moved = placed(ball, turn)
    assert_allclose(moved.vertices.mean(axis=0), [1, 2.5, 3], atol=1e-12)
    assert_allclose((moved.vertices - [1, 2.5, 3]) / 0.1, moved.normals, atol=1e-12)
