from __future__ import annotations

from itertools import pairwise

import numpy as np
import pytest
from numpy.testing import assert_allclose

from capture.arc.gantry import Arc, look_at
from capture.camera import Camera

CENTRE = np.array([0.1, -0.2, 0.3])
AXIS = np.array([0.2, -0.3, 2.0])
START = np.array([0.5, 1.0, 0.4])  # neither unit nor orthogonal to the axis


def camera_at(angle: float) -> Camera:
    return Camera("PINHOLE", [500.0, 500, 320, 240], 640, 480, Arc(CENTRE, AXIS, 0.8, START).pose(angle))


def test_every_camera_of_the_arc_sees_the_centre_at_its_principal_point():
    for angle in np.radians([-170, -30, 0, 45, 90, 200, 359]):
        camera = camera_at(angle)
        # Rounding, at a focal length of 500 px.
        assert_allclose(camera.project(CENTRE), [[320, 240]], atol=1e-9, equal_nan=False)
        assert_allclose(camera.depth(CENTRE), 0.8, atol=1e-12, equal_nan=False)


def test_the_arc_turns_counter_clockwise_about_its_axis_by_the_angle():
    unit = AXIS / np.linalg.norm(AXIS)
    arms = [camera_at(angle).centre - CENTRE for angle in np.radians([0, 25, 50])]
    assert_allclose([arm @ unit for arm in arms], 0, atol=1e-12)  # the arc's plane, to rounding
    # The first camera is where `start` points, but for what of it lies along the axis.
    first = START - unit * (unit @ START)
    assert_allclose(arms[0], 0.8 * first / np.linalg.norm(first), atol=1e-12)
    for before, after in pairwise(arms):
        turn = np.cross(before, after) / 0.8**2
        assert_allclose(turn, np.sin(np.radians(25)) * unit, atol=1e-12, equal_nan=False)


def test_the_axis_points_up_in_the_image_and_the_world_is_not_mirrored():
    camera = camera_at(np.radians(70))
    unit = AXIS / np.linalg.norm(AXIS)
    middle, above = camera.project([CENTRE, CENTRE + 0.01 * unit])
    # Up is along -y, to the tangent: 500 px / 0.8 m x 0.01 m.
    assert_allclose(above - middle, [0, -6.25], atol=1e-9, equal_nan=False)
    # Seen from a camera that looks along +Y with +Z up, +X is to the right.
    ahead = look_at([0, -2, 0], [0, 0, 0], [0, 0, 1])
    assert_allclose(ahead[:3, :3], [[1, 0, 0], [0, 0, -1], [0, 1, 0]], atol=1e-15)
    assert np.linalg.det(camera.world_to_camera) == pytest.approx(1, abs=1e-12)


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"axis": [0, 0, 0]}, "axis is the zero vector"),
        ({"start": [0, 0, -2e5]}, "start is along the axis"),
        ({"start": [0, 0, 0]}, "start is along the axis"),
    ],
)
def test_an_arc_without_a_plane_is_refused(changes, message):
    arc = {"centre": [0, 0, 0], "axis": [0, 0, 1], "radius": 1.0, "start": [1, 0, 0]}
    with pytest.raises(ValueError, match=message):
        Arc(**(arc | changes))


def test_the_arcs_start_may_be_short():
    short = Arc(CENTRE, AXIS, 0.8, 1e-12 * START).pose(0.3)
    assert_allclose(short, Arc(CENTRE, AXIS, 0.8, START).pose(0.3), atol=1e-12, equal_nan=False)


@pytest.mark.parametrize(
    ("position", "target", "up"),
    [
        ([1, 2, 3], [1, 2, 3], [0, 0, 1]),
        ([0, 0, 3], [0, 0, 1], [0, 0, 1]),
        ([0, 0, np.nan], [1, 0, 1], [0, 0, 1]),
    ],
)
def test_a_camera_that_cannot_look_says_from_where(position, target, up):
    with pytest.raises(ValueError, match=r"camera at \[.*\] cannot look at \[.*\] with up \[.*\]"):
        look_at(position, target, up)
