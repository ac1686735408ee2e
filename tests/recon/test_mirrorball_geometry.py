"""Directions that a mirror ball's pixels show, and their solid angles."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.typing import NDArray

from capture.camera import Camera
from recon.mirrorball.reflection import mirrored_directions, mirroring_points, solid_angles

from .test_mirrorball import BALL, CAMERAS, FAR, NEAR

Floats = NDArray[np.float64]


@CAMERAS
def test_directions_and_image_points_are_inverse(camera: Camera) -> None:
    rng = np.random.default_rng(1)
    directions = rng.normal(size=(4000, 3))
    directions /= np.linalg.norm(directions, axis=1, keepdims=True)
    visible, points = mirroring_points(BALL, camera, directions)
    hit, back = mirrored_directions(BALL, camera, points[visible])
    # Rounding, blown up where the ray only just meets the rim (there 1e-16 in the image is 1e-8 in angle).
    assert hit.mean() > 0.999
    assert np.abs(back[hit] - directions[visible][hit]).max() < 1e-6


def test_blind_cone_of_a_near_camera_is_where_the_tangent_rays_go() -> None:
    distance = np.linalg.norm(NEAR.centre - BALL.centre)
    half_angle = np.arcsin(BALL.radius / distance)
    behind = (BALL.centre - NEAR.centre) / distance
    sideways = np.cross(behind, [0, 0, 1.0])
    sideways /= np.linalg.norm(sideways)
    angles = half_angle + np.array([-1e-6, 1e-6])
    across = np.outer(np.cos(angles), behind) + np.outer(np.sin(angles), sideways)
    visible, _ = mirroring_points(BALL, NEAR, across)
    assert visible.tolist() == [False, True]


def test_light_from_the_camera_is_mirrored_by_the_near_pole() -> None:
    to_camera = NEAR.centre - BALL.centre
    visible, points = mirroring_points(BALL, NEAR, (to_camera / np.linalg.norm(to_camera))[None])
    assert visible.all()
    np.testing.assert_allclose(points[0], NEAR.project(BALL.centre[None])[0], atol=1e-6)  # rounding


def test_solid_angle_of_an_octant() -> None:
    x, y, z = np.eye(3)
    middle = (y + z) / np.sqrt(2)
    np.testing.assert_allclose(solid_angles(np.stack([x, y, middle, z])), np.pi / 2, rtol=1e-12)  # rounding


def pixel_solid_angles(camera: Camera) -> tuple[Floats, Floats]:
    """Directions (n, 3) and solid angles (n,) of the pixels whose corners all lie on the ball."""
    y, x = np.mgrid[: camera.height, : camera.width]
    corner = np.column_stack([x.ravel(), y.ravel()]).astype(float)
    square = np.array([(0, 0), (1, 0), (1, 1), (0, 1)], float)
    hits, traced = zip(*(mirrored_directions(BALL, camera, corner + s) for s in square), strict=True)
    whole = np.all(hits, axis=0)
    _, directions = mirrored_directions(BALL, camera, corner + 0.5)
    return directions[whole], solid_angles(np.stack(traced)[:, whole])


def test_solid_angle_of_an_orthographic_pixel_is_four_over_radius_squared() -> None:
    directions, areas = pixel_solid_angles(FAR)
    to_camera = -FAR.camera_to_world[:3, 2]
    inner = directions @ to_camera > np.cos(np.radians(120))
    expected = 4 / BALL.pixel_radius(FAR) ** 2
    # The two triangles are flat-edged: off by the pixel's width squared over the distance to the rim.
    np.testing.assert_allclose(areas[inner], expected, rtol=1e-3)


@CAMERAS
def test_solid_angles_add_up_to_the_cone_that_they_fill(camera: Camera) -> None:
    directions, areas = pixel_solid_angles(camera)
    to_camera = -camera.camera_to_world[:3, 2]
    if not camera.is_orthographic:
        to_camera = (camera.centre - BALL.centre) / np.linalg.norm(camera.centre - BALL.centre)
    # In perspective 120 degrees is well inside of the blind cone's edge at 156.
    half_angle = np.radians(120)
    total = areas[directions @ to_camera > np.cos(half_angle)].sum()
    # The cone's edge runs through about 700 pixels of 60,000, each in or out at random.
    assert total == pytest.approx(2 * np.pi * (1 - np.cos(half_angle)), rel=1e-3)


def test_the_orthographic_formula_would_be_wrong_from_nearby() -> None:
    _, areas = pixel_solid_angles(NEAR)
    closed_form = 4 / BALL.pixel_radius(NEAR) ** 2
    # Nearby, the middle of the ball is larger in the image than its rim: pixels differ by more than half.
    assert areas.max() / areas.min() > 1.5
    assert np.abs(areas / closed_form - 1).max() > 0.3
