"""Silhouettes against spheres, whose outlines are known in closed form, and their derivative against differences."""

from __future__ import annotations

import numpy as np
import pytest
import trimesh
from numpy.testing import assert_allclose
from scipy.spatial.transform import Rotation

from capture.arc.gantry import look_at
from capture.camera import ORTHOGRAPHIC, Camera
from recon.mesh.rays import RayTracer
from recon.poses.align import silhouettes
from recon.poses.align.outlines import outline_of
from recon.poses.align.pixelrays import pixel_rays
from recon.poses.align.silhouettes import crossings, lines_across, offset_jacobian, overlap
from recon.poses.similarity import Similarity, motion_jacobian, rotations_all_over

PIVOT = np.array([0.02, 0.0, -0.005])
CENTRE, RADIUS = np.array([0.01, -0.02, 0.015]), 0.05
LOOK = look_at(np.array([0.5, 0.3, 0.2]), np.zeros(3), np.array([0.0, 0, 1]))
CAMERAS = {
    "pinhole": Camera("PINHOLE", [600, 610, 160, 120], 320, 240, LOOK),
    "lens": Camera("OPENCV", [600, 610, 160, 120, -0.2, 0.1, 0.003, -0.002], 320, 240, LOOK),
    "orthographic": Camera(ORTHOGRAPHIC, [1000, 990, 160, 120], 320, 240, LOOK),
}


@pytest.fixture
def rng() -> np.random.Generator:
    return np.random.default_rng(4)


@pytest.fixture(scope="module")
def unit_ball() -> RayTracer:
    body = trimesh.creation.icosphere(6, 1.0)
    return RayTracer(np.asarray(body.vertices), np.asarray(body.faces))


def at(radius: float, centre: np.ndarray) -> Similarity:
    return Similarity(radius, Rotation.from_rotvec([0.3, 1, -0.5]).as_matrix(), centre)


@pytest.fixture(params=CAMERAS)
def camera(request) -> Camera:
    return CAMERAS[request.param]


def test_a_ball_lies_on_its_own_outline_and_a_larger_one_outside_by_what_it_must(
    camera, draw, ball, unit_ball
):
    outline = outline_of(camera, draw(ball(CENTRE, RADIUS), camera, 8))
    lines = lines_across([outline], [6.0])
    met = crossings(unit_ball, at(RADIUS, CENTRE), lines)
    assert met.found.all()
    # 8 x 8 points in a pixel and linear interpolation between pixels: 0.03 px.
    assert np.abs(met.offsets).max() < 0.1
    assert np.sqrt((met.offsets**2).mean()) < 0.03
    # The rays through the larger ball's rim are what touches it: compare with where they are seen.
    grown = crossings(unit_ball, at(1.02 * RADIUS, CENTRE), lines)
    seen = outline.points + grown.offsets[:, None] * outline.normals
    origins, directions = camera.rays(seen)
    gap = np.linalg.norm(np.cross(CENTRE - origins, directions), axis=1)
    # Facets of 0.02 radii lie 5e-5 of the radius within the sphere; bisection is to 0.02 px of 60.
    assert_allclose(gap, 1.02 * RADIUS, rtol=5e-4)
    assert overlap(unit_ball, at(RADIUS, CENTRE), outline) > 0.98


def traced(tracer: RayTracer, place: Similarity, camera: Camera, n: int = 4) -> np.ndarray:
    """Coverage of each pixel by a mesh, (h, w), from n x n rays."""
    steps = (np.arange(n) + 0.5) / n
    x, y = ((np.arange(size)[:, None] + steps).ravel() for size in (camera.width, camera.height))
    origins, directions = camera.rays(np.stack(np.meshgrid(x, y), axis=-1).reshape(-1, 2))
    body = RayTracer(place.apply(tracer.vertices), tracer.faces)
    starts = origins - directions if camera.is_orthographic else origins
    hit = body.first_hits(starts, directions).faces >= 0
    return hit.reshape(camera.height, n, camera.width, n).mean(axis=(1, 3), dtype=np.float32)


def test_offsets_follow_motion_as_differences_say(camera, unit_ball, monkeypatch):
    monkeypatch.setattr(silhouettes, "_EXACT", 1e-3)  # differences magnify what bisection leaves
    egg = RayTracer(unit_ball.vertices * [1.0, 0.6, 1.3], unit_ball.faces)
    place = at(RADIUS, CENTRE)
    lines = lines_across([outline_of(camera, traced(egg, place, camera))], [6.0])
    met = crossings(egg, place, lines)
    jacobian = offset_jacobian(lines, met, place, PIVOT)
    for index, step in enumerate([0.02] * 3 + [0.001] * 3 + [0.02]):
        change = np.zeros(7)
        change[index] = step
        moved = [crossings(egg, place.moved(sign * change, PIVOT), lines) for sign in (1, -1)]
        assert moved[0].found.all()
        assert moved[1].found.all()
        slope = (moved[0].offsets - moved[1].offsets) / (2 * step)
        # The last ray that touches enters the body up to a fortieth of its radius before the rim; facets add as much.
        scale = np.abs(jacobian[:, 3:6]).max() if 3 <= index < 6 else 60
        assert_allclose(slope, jacobian[:, index], atol=0.05 * scale)
        assert np.abs(slope).max() > 0.2 * scale


def test_pixel_offsets_and_motions_agree_with_projection(camera, rng):
    points = rng.uniform(-0.05, 0.05, (50, 3))
    rays = pixel_rays(camera, camera.project(points))
    nothing, jacobian = rays.offsets(points)
    assert_allclose(nothing, 0, atol=1e-4)  # the lens is undone to that
    step = 1e-6
    for axis in range(3):
        shift = np.eye(3)[axis] * step
        slope = (camera.project(points + shift) - camera.project(points - shift)) / (2 * step)
        # Rays are differentiated over a pixel, and known to 1e-5 of one, of 1000 pixels per metre.
        assert_allclose(jacobian[:, :, axis], slope, atol=0.1)
    place = Similarity(1.3, rotations_all_over(7)[3], [0.1, 0.2, 0.3])
    pivot = np.array([0.02, -0.3, 0.1])
    world, motion = place.apply(points), motion_jacobian(place.apply(points), pivot)
    for index in range(7):
        change = np.eye(7)[index] * step
        slope = (place.moved(change, pivot).apply(points) - place.moved(-change, pivot).apply(points)) / (
            2 * step
        )
        assert_allclose(motion[:, :, index], slope, atol=1e-8)
    assert_allclose(place.undo(world), points, atol=1e-14)


def test_where_the_image_ends_there_is_no_outline(draw, ball):
    camera = CAMERAS["pinhole"]
    aside = camera.world_to_camera.copy()
    aside[0, 3] += 0.14
    cut = camera.posed(aside)
    outline = outline_of(cut, draw(ball(CENTRE, RADIUS), cut, 4))
    assert not outline.whole
    assert outline.points[:, 0].max() <= 318
    assert outline_of(camera, draw(ball(CENTRE, RADIUS), camera, 4)).whole
    with pytest.raises(ValueError, match="too small, or fills the image"):
        outline_of(camera, np.ones((240, 320), np.float32))


def test_rotations_are_proper_and_leave_no_gap(rng):
    grid = rotations_all_over(600)
    assert_allclose(np.linalg.det(grid), 1, atol=1e-12)
    others = Rotation.random(500, random_state=rng).as_matrix()
    cos = (np.einsum("gij,hij->gh", grid, others).max(axis=0) - 1) / 2
    # 600 balls of 17 degrees fill all orientations; the farthest point of a good grid is at 1.7 times that.
    assert np.degrees(np.arccos(cos.min())) < 29
