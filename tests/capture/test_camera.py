from __future__ import annotations

import cv2
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.testing import assert_allclose
from scipy.spatial.transform import Rotation

from capture.camera import MODELS, ORTHOGRAPHIC, Camera

WIDTH, HEIGHT = 640, 480
PARAMS = {
    "SIMPLE_PINHOLE": [500.0, 310, 250],
    "PINHOLE": [500.0, 510, 310, 250],
    "SIMPLE_RADIAL": [500.0, 310, 250, -0.2],
    "RADIAL": [500.0, 310, 250, -0.2, 0.05],
    "OPENCV": [500.0, 510, 310, 250, -0.2, 0.05, 1e-3, -2e-3],
    "FULL_OPENCV": [500.0, 510, 310, 250, -0.2, 0.05, 1e-3, -2e-3, 0.01, 0.02, -0.01, 0.003],
    "ORTHOGRAPHIC": [500.0, 510, 310, 250],
}


def pose(rotation_vector, translation) -> np.ndarray:
    matrix = np.eye(4)
    matrix[:3, :3] = Rotation.from_rotvec(rotation_vector).as_matrix()
    matrix[:3, 3] = translation
    return matrix


POSE = pose([0.3, -0.7, 1.1], [0.2, -0.1, 2.5])


def pixel_grid() -> np.ndarray:
    """Pixels all over the image, its four corners included."""
    y, x = np.mgrid[0 : HEIGHT + 1 : 40, 0 : WIDTH + 1 : 40]
    return np.column_stack([x.ravel(), y.ravel()]).astype(float)


def test_every_model_has_parameters_in_this_file():
    assert set(PARAMS) == set(MODELS)


@pytest.mark.parametrize("model", MODELS)
def test_unproject_then_project_is_the_identity(model):
    camera = Camera(model, PARAMS[model], WIDTH, HEIGHT, POSE)
    pixels = pixel_grid()
    origins, directions = camera.rays(pixels)
    assert_allclose(np.linalg.norm(directions, axis=1), 1, atol=1e-14, equal_nan=False)  # rounding
    for distance in (0.01, 3.0, 1e4):
        # COLMAP's undistortion stops when its step is below 1e-10 of the focal length or so.
        back = camera.project(origins + distance * directions)
        assert_allclose(back, pixels, atol=1e-6, rtol=0, equal_nan=False)
        depth = camera.depth(origins + distance * directions)
        assert (depth > 0).all()


coordinate = st.floats(-1, 1)
triple = st.tuples(coordinate, coordinate, coordinate)


@pytest.mark.parametrize("model", ["OPENCV", ORTHOGRAPHIC])
@settings(max_examples=50, deadline=None)
@given(rotation=triple.map(lambda v: 3 * np.array(v)), translation=triple.map(lambda v: 5 * np.array(v)))
def test_rigid_motion_of_world_and_camera_changes_no_pixel(model, rotation, translation):
    old_to_new = pose(rotation, translation)
    camera = Camera(model, PARAMS[model], WIDTH, HEIGHT, POSE)
    moved = camera.posed(POSE @ np.linalg.inv(old_to_new))
    points = np.stack(np.meshgrid(*[np.linspace(-0.5, 0.5, 4)] * 3), -1).reshape(-1, 3)
    assert (camera.depth(points) > 0).all()
    points_moved = points @ old_to_new[:3, :3].T + old_to_new[:3, 3]
    # Rounding of coordinates of size 10 at a focal length of 500 px.
    assert_allclose(moved.project(points_moved), camera.project(points), atol=1e-9, rtol=0, equal_nan=False)
    centre_moved = old_to_new[:3, :3] @ camera.centre + old_to_new[:3, 3]
    assert_allclose(moved.centre, centre_moved, atol=1e-12, equal_nan=False)


def test_first_pixels_centre_is_at_one_half_by_hand():
    # A principal point at the first pixel's centre, unit depth, f = 100 px: one pixel right is x = 0.01.
    camera = Camera("PINHOLE", [100.0, 100, 0.5, 0.5], 4, 3, np.eye(4))
    assert_allclose(camera.project([[0, 0, 1], [0.01, 0.02, 1]]), [[0.5, 0.5], [1.5, 2.5]], atol=1e-12)
    # An image 4x3 pixels big has its corners at (0, 0) and (4, 3): one pixel per metre about its middle.
    flat = Camera(ORTHOGRAPHIC, [], 4, 3, np.eye(4))
    assert_allclose(flat.project([[0, 0, 7], [-1.5, -1.0, 7]]), [[2, 1.5], [0.5, 0.5]], atol=1e-15)
    assert_allclose(flat.rays([[0.5, 0.5]])[0], [[-1.5, -1.0, 0]], atol=1e-15)


@pytest.mark.parametrize("model", ["OPENCV", "FULL_OPENCV"])
def test_opencv_agrees_after_half_a_pixels_shift(model):
    params = PARAMS[model]
    camera = Camera(model, params, WIDTH, HEIGHT, POSE)
    points = np.random.default_rng(0).uniform(-0.6, 0.6, (50, 3))
    # OpenCV counts from the first pixel's centre, so its principal point lies half a pixel before ours.
    matrix = np.array([[params[0], 0, params[2] - 0.5], [0, params[1], params[3] - 0.5], [0, 0, 1]])
    rotation, _ = cv2.Rodrigues(POSE[:3, :3])
    theirs, _ = cv2.projectPoints(points, rotation, POSE[:3, 3], matrix, np.array(params[4:]))
    # Rounding, times the focal length.
    assert_allclose(camera.project(points), theirs.reshape(-1, 2) + 0.5, atol=1e-9, rtol=0, equal_nan=False)


def test_points_behind_a_perspective_camera_have_no_pixel():
    camera = Camera("PINHOLE", PARAMS["PINHOLE"], WIDTH, HEIGHT, np.eye(4))
    pixels = camera.project([[0, 0, 1.0], [0, 0, -1.0], [0.1, 0, 0.0], [np.nan, 0, 1]])
    assert np.isfinite(pixels).all(axis=1).tolist() == [True, False, False, False]
    assert camera.project(np.zeros((0, 3))).shape == (0, 2)


def test_pixels_that_the_distortion_never_reaches_have_no_ray():
    # r (1 - 0.6 r^2) has its maximum at r = 0.745, where it is 0.497: 248 px from the centre.
    camera = Camera("SIMPLE_RADIAL", [500.0, 320, 240, -0.6], WIDTH, HEIGHT, np.eye(4))
    _, directions = camera.rays([[320.0 + 240, 240], [320.0 + 260, 240]])
    assert np.isfinite(directions).all(axis=1).tolist() == [True, False]


def test_focal_length_is_pixels_per_radian_at_the_centre():
    assert Camera("PINHOLE", [400.0, 441, 1, 1], 2, 2, np.eye(4)).focal_px == pytest.approx(420.5, rel=1e-12)
    assert Camera(ORTHOGRAPHIC, [4.0, 9, 1, 1], 2, 2, np.eye(4)).focal_px == pytest.approx(6, rel=1e-12)


def test_orthographic_takes_one_scale_or_two():
    one = Camera(ORTHOGRAPHIC, [5.0, 1, 2], 2, 2, np.eye(4))
    assert one.params.tolist() == [5, 5, 1, 2]


def test_printed_poses_are_made_rigid_and_arrays_are_read_only():
    printed = np.round(POSE, 4)
    camera = Camera("PINHOLE", PARAMS["PINHOLE"], WIDTH, HEIGHT, printed)
    rotation = camera.world_to_camera[:3, :3]
    assert_allclose(rotation @ rotation.T, np.eye(3), atol=1e-14, equal_nan=False)  # rounding
    assert_allclose(camera.world_to_camera, POSE, atol=1e-4, equal_nan=False)  # printed with four digits
    with pytest.raises(ValueError, match="read-only"):
        camera.params[0] = 1


MIRRORED = np.diag([1.0, 1, -1, 1])
SCALED = np.diag([2.0, 2, 2, 1])


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"model": "FISHEYE"}, "'FISHEYE' is not known; use one of SIMPLE_PINHOLE"),
        ({"width": 0}, "camera size is 0x480; width and height must be > 0"),
        ({"height": -1}, "camera size is 640x-1"),
        ({"params": [500.0, 510, 310]}, r"takes params \[fx, fy, cx, cy\]; got 3 numbers"),
        ({"params": [500.0, 510, np.nan, 0]}, "nan.* are not all finite"),
        ({"params": [-1432.1, 510, 310, 250]}, r"focal length fx is -1432.1 px; it must be > 0"),
        ({"params": [500.0, 0, 310, 250]}, r"focal length fy is 0.0 px; it must be > 0"),
        ({"params": [[500.0, 510], [310, 250]]}, r"shape \(2, 2\); they must be one list"),
        ({"model": ORTHOGRAPHIC, "params": [1.0, 2]}, r"\[scale_x, scale_y, cx, cy\]; got 2 numbers"),
        ({"model": ORTHOGRAPHIC, "params": [0.0, 1, 2]}, r"scale is \[0.0, 0.0\] px per metre"),
        ({"world_to_camera": np.eye(3)}, r"shape \(3, 3\); it must be 4x4"),
        ({"world_to_camera": np.full((4, 4), np.inf)}, "not finite"),
        ({"world_to_camera": POSE.T}, "it looks transposed"),
        ({"world_to_camera": POSE + np.eye(4)[[3, 1, 2, 0]]}, "last row of world_to_camera is"),
        ({"world_to_camera": SCALED}, "not a rotation"),
        ({"world_to_camera": MIRRORED}, "left-handed"),
    ],
)
def test_a_bad_camera_says_what_is_wrong(changes, message):
    given = {
        "model": "PINHOLE",
        "params": PARAMS["PINHOLE"],
        "width": WIDTH,
        "height": HEIGHT,
        "world_to_camera": POSE,
    }
    with pytest.raises(ValueError, match=message):
        Camera(**(given | changes))


@pytest.mark.parametrize("model", MODELS)
def test_a_binned_camera_sees_the_same_where_pixels_are_as_many_times_larger(model: str):
    camera = Camera(model, PARAMS[model], WIDTH, HEIGHT, POSE)
    # 91 x 68, three columns and four rows being cut off.
    binned = camera.binned(7)
    assert (binned.width, binned.height) == (91, 68)
    pixels = pixel_grid()
    for ours, theirs in zip(binned.rays(pixels / 7), camera.rays(pixels), strict=True):
        assert_allclose(ours, theirs, atol=1e-9)
