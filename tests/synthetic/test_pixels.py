"""Pixels: how much of each a surface covers, whatever the camera, and where they are looked at."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal
from numpy.typing import NDArray

from capture.arc.gantry import look_at
from capture.camera import Camera
from recon.mesh.trianglemesh import TriangleMesh, smooth_normals
from synthetic.render.pixels import looked_at, pixel_coverage
from synthetic.shapes.ball import Ball
from synthetic.shapes.meshsurface import MeshSurface
from synthetic.shapes.surface import Surface

Floats = NDArray[np.float64]

CENTRE, RADIUS = np.array([0.004, -0.003, 0.002]), 0.013
BALL = Ball(CENTRE, RADIUS)
POSE = look_at([0.3, 0.1, 0.2], [0, 0, 0], [0, 0, 1])
CAMERAS = {
    "pinhole": Camera("PINHOLE", np.array([600.0, 620, 31.3, 24.8]), 64, 50, POSE),
    "distorted": Camera("OPENCV", np.array([600.0, 600, 31.3, 24.8, -9.0, 12.0, 0.01, -0.02]), 64, 50, POSE),
    "orthographic": Camera("ORTHOGRAPHIC", np.array([1000.0, 31.3, 24.8]), 64, 50, POSE),
}
EACH = pytest.mark.parametrize("name", CAMERAS)


def sphere_mesh() -> MeshSurface:
    import trimesh

    body = trimesh.creation.icosphere(5, RADIUS)
    vertices, faces = np.array(body.vertices) + CENTRE, np.array(body.faces)
    return MeshSurface(TriangleMesh(vertices, faces, smooth_normals(vertices, faces)))


def outline(camera: Camera) -> Floats:
    """The ball's outline in the picture, as a fine polygon (n, 2)."""
    if camera.is_orthographic:
        away = -camera.world_to_camera[2, :3]
        middle, radius = CENTRE, RADIUS
    else:
        offset = camera.centre - CENTRE
        distance = np.linalg.norm(offset)
        away = offset / distance
        # Tangents from the camera touch a circle nearer to it than the centre.
        middle, radius = CENTRE + RADIUS**2 / distance * away, RADIUS * np.sqrt(1 - (RADIUS / distance) ** 2)
    first = np.cross(away, [0, 0, 1.0])
    first /= np.linalg.norm(first)
    phi = np.linspace(0, 2 * np.pi, 5000, endpoint=False)[:, None]
    circle = middle + radius * (np.cos(phi) * first + np.sin(phi) * np.cross(away, first))
    return np.asarray(camera.project(circle))


@EACH
def test_coverage_has_the_outlines_area_and_centroid(name: str) -> None:
    camera = CAMERAS[name]
    coverage = pixel_coverage(BALL, camera)
    x, y = outline(camera).T
    turned = x * np.roll(y, -1) - np.roll(x, -1) * y
    area = turned.sum() / 2
    centroid = [((v + np.roll(v, -1)) * turned).sum() / (6 * area) for v in (x, y)]
    # Each of some 300 rim pixels is counted in 256 points: errors of 1/12 of a 16th, independent.
    assert_allclose(coverage.sum(), abs(area), rtol=2e-4)
    row, column = np.mgrid[:50, :64] + 0.5
    found = [(coverage * at).sum() / coverage.sum() for at in (column, row)]
    assert_allclose(found, centroid, atol=2e-3)


def test_a_lens_that_distorts_bends_the_outline() -> None:
    # Else the test above would see no distortion at all.
    bent = pixel_coverage(BALL, CAMERAS["distorted"]).sum()
    straight = CAMERAS["distorted"].params.copy()
    straight[4:] = 0
    undistorted = Camera("OPENCV", straight, 64, 50, POSE)
    assert abs(bent / pixel_coverage(BALL, undistorted).sum() - 1) > 2e-3


@EACH
def test_a_fine_mesh_covers_what_the_ball_covers(name: str) -> None:
    ball, mesh = (pixel_coverage(surface, CAMERAS[name]) for surface in (BALL, sphere_mesh()))
    # Its 20480 triangles lie up to 3e-4 radii inside, 0.01 px: some points of rim pixels.
    assert np.abs(ball - mesh).max() <= 0.06
    assert_allclose(mesh.sum(), ball.sum(), rtol=1e-3)
    assert_array_equal(mesh == 1, mesh == mesh.max())


@EACH
@pytest.mark.parametrize("surface", [BALL, sphere_mesh()], ids=["ball", "mesh"])
def test_whole_pixels_are_looked_at_in_gauss_points(name: str, surface: Surface) -> None:
    camera = CAMERAS[name]
    coverage = pixel_coverage(surface, camera)
    rows, columns = np.nonzero(coverage > 0)
    pixels = np.column_stack([columns, rows])
    pixel, place, weight, points, views = looked_at(surface, camera, pixels, 3)
    total = np.bincount(pixel, weight, len(pixels))
    whole = coverage[rows, columns] == 1
    assert_allclose(total[whole], 1, rtol=1e-12)  # rounding
    assert (total[~whole] < 1).any()
    assert_allclose(np.linalg.norm(views, axis=1), 1, rtol=1e-12)  # rounding
    assert ((points.facets * views).sum(axis=1) > 0).all()
    if not camera.is_orthographic:
        offset = camera.centre - points.positions
        assert_allclose(views, offset / np.linalg.norm(offset, axis=1, keepdims=True), atol=1e-6)
    # Points lie where their sub-sample looks; undistorting and single precision of rays take 1e-4 px.
    node = (np.polynomial.legendre.leggauss(3)[0] + 1) / 2
    expected = pixels[pixel] + np.column_stack([node[place % 3], node[place // 3]])
    assert_allclose(camera.project(points.positions), expected, atol=1e-3)


def test_gauss_points_integrate_polynomials_over_a_pixel() -> None:
    # Exact to degree 2 n - 1 in each direction; midpoints are wrong by a quarter of the second moment.
    camera = CAMERAS["orthographic"]
    pixels = np.array([[31, 25]])
    for per_side in (2, 4, 8):
        _, _, weight, points, _ = looked_at(BALL, camera, pixels, per_side)
        x, y = (camera.project(points.positions) - pixels).T
        for power in (1, 2, 3):
            assert_allclose(weight @ x**power, 1 / (power + 1), atol=1e-9)  # rounding of metres to pixels
        assert_allclose(weight @ (x * x * y), 1 / 6, atol=1e-9)


def test_what_is_out_of_the_picture_covers_nothing_and_what_fills_it_all() -> None:
    aside = Camera("PINHOLE", np.array([600.0, 600, 500, 25]), 64, 50, POSE)
    assert not pixel_coverage(BALL, aside).any()
    none = looked_at(BALL, CAMERAS["pinhole"], np.zeros((0, 2), int), 2)
    assert all(len(part) == 0 for part in none)
    near = Camera("PINHOLE", np.array([6000.0, 6000, 32, 25]), 64, 50, POSE)
    assert (pixel_coverage(BALL, near) == 1).all()
