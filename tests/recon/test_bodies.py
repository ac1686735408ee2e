"""A sphere and a mesh answer the same questions alike; edges, back faces and shadows are where geometry puts them."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal

from capture.arc.gantry import look_at
from capture.camera import ORTHOGRAPHIC, Camera
from recon.mesh.bodies import MeshBody, SphereBody, body_coverage, body_pixels, body_window

from .bodymeshes import ball_mesh, joined, mesh_of, plate

# From straight above, one metre up: x to the right, y up in the image; 100 px per metre at the floor.
ABOVE = Camera("PINHOLE", [100.0, 100, 40, 30], 80, 60, look_at([0, 0, 1], [0, 0, 0], [0, 1, 0]))
SIDE = Camera("PINHOLE", [300.0, 300, 80, 60], 160, 120, look_at([0.9, -2, 0.7], [0.1, 0, 0], [0, 0, 1]))
FLAT = Camera(ORTHOGRAPHIC, [60.0, 80, 60], 160, 120, look_at([0.9, -2, 0.7], [0.1, 0, 0], [0, 0, 1]))


@pytest.mark.parametrize("camera", [SIDE, FLAT])
def test_a_fine_mesh_of_a_sphere_is_the_sphere(ball, camera):
    exact = SphereBody(ball([0.1, 0.05, -0.03], 0.4))
    mesh = MeshBody(ball_mesh((0.1, 0.05, -0.03), 0.4, 6))
    rows, columns = body_pixels(exact, camera)
    centres = np.column_stack([columns, rows]) + 0.5
    one, other = exact.hits(camera, centres), mesh.hits(camera, centres)
    inner = -(one.normals * camera.rays(centres)[1]).sum(axis=1) > 0.3
    assert inner.sum() > 1000
    assert other.hit[inner].all()
    # Edges of 1/60 rad: a chord is off by an eighth of its square, 4e-5 of the radius, more by 1/cos at an angle.
    assert_allclose(other.positions[inner], one.positions[inner], atol=1e-4, equal_nan=False)
    assert_allclose(other.normals[inner], one.normals[inner], atol=3e-4, equal_nan=False)
    corners = mesh.mesh.vertices[mesh.mesh.faces[other.faces[inner]]]
    blended = np.einsum("nk,nkc->nc", other.weights[inner], corners)
    assert_allclose(blended, other.positions[inner], atol=1e-12, equal_nan=False)
    # How the normal turns within a pixel: by hand for the sphere, by differences for the mesh.
    mine, theirs = (body.pixel_geometry(camera, rows[inner], columns[inner]) for body in (exact, mesh))
    assert_allclose(theirs.cos, mine.cos, atol=3e-4, equal_nan=False)
    # By differences over two pixels, within which the turn grows near the rim.
    well = theirs.whole & (mine.cos > 0.5)
    assert well.sum() > 800
    assert_allclose(theirs.turn[well], mine.turn[well], rtol=0.2, equal_nan=False)
    seen = body_coverage(exact, camera), body_coverage(mesh, camera)
    assert (seen[0] != seen[1]).sum() <= 5  # pixels whose centre the rim passes through


def test_coverage_by_strides_is_every_so_many_pixels(ball):
    body = SphereBody(ball([0.1, 0.05, -0.03], 0.4))
    assert_array_equal(body_coverage(body, SIDE, 3), body_coverage(body, SIDE)[::3, ::3])


def test_a_depth_edge_is_kept_away_from():
    # A floor, and a shelf 0.2 m above its left half: its edge at x = 0 is seen at column 40.
    body = MeshBody(
        joined(
            plate((-0.3, -0.2, 0.0), (0.6, 0, 0), (0, 0.4, 0)),
            plate((-0.2, -0.2, 0.2), (0.2, 0, 0), (0, 0.4, 0)),
        )
    )
    columns = np.arange(30, 50)
    found = body.pixel_geometry(ABOVE, np.full(20, 30), columns)
    distance = np.abs(columns + 0.5 - 40)
    assert_array_equal(found.whole, distance > 1)
    assert_array_equal(found.clear, distance > 3)
    assert_allclose(found.normals, np.tile([0, 0, 1.0], (20, 1)), atol=1e-12, equal_nan=False)
    assert not found.turn.any()


def test_a_crease_turns_the_normal():
    # A roof whose ridge is seen at column 40, sides falling off by 30 degrees, normals not shared.
    fall = np.tan(np.radians(30)) * 0.3
    body = MeshBody(
        joined(
            plate((-0.3, -0.2, -fall), (0.3, 0, fall), (0, 0.4, 0)),
            plate((0, -0.2, 0), (0.3, 0, -fall), (0, 0.4, 0)),
        )
    )
    found = body.pixel_geometry(ABOVE, np.full(20, 30), np.arange(30, 50))
    # Corners one pixel to either side of the centre: a turn of 60 degrees, over two pixels.
    at_ridge = np.abs(np.arange(30, 50) + 0.5 - 40) < 1
    assert_allclose(found.turn, np.where(at_ridge, np.radians(30), 0), atol=1e-9, equal_nan=False)


def test_the_back_of_a_face_is_no_surface():
    down = MeshBody(plate((-0.3, -0.2, 0), (0, 0.4, 0), (0.6, 0, 0)))
    assert not body_coverage(down, ABOVE).any()
    up = MeshBody(plate((-0.3, -0.2, 0), (0.6, 0, 0), (0, 0.4, 0)))
    y, x = np.mgrid[:60, :80] + 0.5
    assert_array_equal(body_coverage(up, ABOVE), (np.abs(x - 40) < 30) & (np.abs(y - 30) < 20))


def test_shadows_and_mirrored_rays_end_where_the_wall_does():
    # A floor, and a wall of 0.1 m at x = 0 that faces +x.
    floor = plate((-0.3, -0.2, 0.0), (0.6, 0, 0), (0, 0.4, 0))
    wall = plate((0.0, -0.2, 0.0), (0, 0.4, 0), (0, 0, 0.1))
    body = MeshBody(joined(floor, wall))
    x = np.linspace(0.004, 0.295, 59)
    points = np.column_stack([x, np.zeros(59), np.zeros(59)])
    up = np.broadcast_to([0, 0, 1.0], points.shape)
    # A source 45 degrees above the horizon beyond the wall: its shadow is as long as the wall is high.
    slanted = np.broadcast_to([-(0.5**0.5), 0, 0.5**0.5], points.shape)
    assert_array_equal(body.visible(points, up, slanted), x > 0.1)
    assert not body.visible(points, up, -up).any()


def test_windows_hold_the_body_and_little_else(ball):
    exact, mesh = SphereBody(ball([0.1, 0.05, -0.03], 0.2)), MeshBody(ball_mesh((0.1, 0.05, -0.03), 0.2))
    for body in (exact, mesh):
        top, left, bottom, right = body_window(body, SIDE)
        y, x = np.nonzero(body_coverage(body, SIDE))
        assert 0 <= y.min() - top < 10
        assert 0 <= bottom - y.max() < 10
        assert 0 <= x.min() - left < 10
        assert 0 <= right - x.max() < 10
    behind = SIDE.centre - 2 * SIDE.camera_to_world[:3, 2]
    for body in (SphereBody(ball(behind, 0.5)), MeshBody(ball_mesh(tuple(behind), 0.5, 2))):
        assert body_window(body, SIDE) == (0, 0, 0, 0)
        assert not body_coverage(body, SIDE).any()


def test_pixels_that_the_distortion_does_not_reach_show_nothing():
    # Beyond some radius this lens bends rays back: its corners belong to no direction.
    camera = Camera("SIMPLE_RADIAL", [50.0, 40, 30, -0.4], 80, 60, look_at([0, 0, 1], [0, 0, 0], [0, 1, 0]))
    corner = np.array([[0.5, 0.5]])
    assert np.isnan(camera.rays(corner)[1]).any()
    wide = MeshBody(mesh_of([[-9, -9, 0], [9, -9, 0], [0, 18, 0]], [[0, 1, 2]]))
    assert not wide.hits(camera, corner).hit.any()
    assert wide.hits(camera, np.array([[40.0, 30]])).hit.all()
