"""Camera calibration: truths that it must return, intervals that must hold them, and fits that must be refused."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from numpy.testing import assert_allclose
from scipy.spatial.transform import Rotation

from capture.boards.board import Detection, parse_board
from capture.boards.boardsearch import BoardView, detect_board, odd_sizes
from capture.camera import Camera
from capture.lens.distortion import LADDER, PARAM_NAMES, folds_at, picture_grid
from capture.lens.intrinsics import calibrate_camera, calibrate_detections
from capture.lens.intrinsicserror import statistical_covariance
from capture.lens.lensfit import LensFit, fit_lens, lens_information, pose_jacobian, pose_matrix, view_of
from synthetic.sensing.boardphotos import board_photo, board_poses

BOARD = parse_board("chessboard:9x6:0.025")
CELLS = np.column_stack([np.tile(np.arange(9), 6), np.repeat(np.arange(6), 9)])
SIZE = (640, 480)
OPENCV = LADDER[4]
CAMERA = Camera("OPENCV", [800, 805, 330, 235, -0.25, 0.08, 0.001, -0.0005], *SIZE, np.eye(4))


def detection(camera: Camera, pose, rng, noise=0.05, smooth=0.0) -> Detection:
    """Corners by COLMAP's projection, with noise of each corner and an error that is smooth over the board."""
    points = camera.posed(pose).project(BOARD.corners)
    x, y = ((points - points.mean(axis=0)) / np.ptp(points, axis=0).max() * 2).T
    shapes = np.column_stack([np.ones_like(x), x, y, x * y, x**2, y**2, x**3, y**3])
    points = points + shapes @ rng.normal(0, max(smooth, 1e-12), (shapes.shape[1], 2))

    def measured():
        return points + rng.normal(0, max(noise, 1e-12), points.shape)

    return Detection(CELLS, BOARD.corners, measured(), np.array([measured(), measured()]), SIZE)


def detections(seed, count=10, camera=CAMERA, poses=None, **errors) -> dict[str, Detection]:
    rng = np.random.default_rng(seed)
    poses = board_poses(BOARD, camera, count, rng) if poses is None else poses
    return {f"{k}.png": detection(camera, pose, rng, **errors) for k, pose in enumerate(poses)}


def tilted(tilts_deg, rng) -> list[np.ndarray]:
    """Boards in the middle, each with its own tilt about two axes, turned in their planes and moved about."""
    poses = []
    while len(poses) < len(tilts_deg):
        turn = Rotation.from_euler("xy", tilts_deg[len(poses)], degrees=True)
        pose = np.eye(4)
        pose[:3, :3] = (turn * Rotation.from_euler("z", rng.uniform(-180, 180), degrees=True)).as_matrix()
        pose[:3, :3] = pose[:3, :3] @ np.diag([1.0, -1, -1])
        pose[:3, 3] = rng.uniform([-0.1, -0.08, 0.35], [0.1, 0.08, 0.6])
        pose[:3, 3] -= pose[:3, :3] @ BOARD.corners.mean(axis=0)
        points = CAMERA.posed(pose).project(BOARD.corners)
        if ((points > 8) & (points < np.array(SIZE) - 8)).all():
            poses.append(pose)
    return poses


def test_boards_without_noise_return_the_camera():
    calibration = calibrate_detections(detections(0, 8, noise=0.0), BOARD)
    assert calibration.model == "OPENCV"
    # OpenCV takes points in float32: 3e-5 px, and a few times that in the parameters.
    assert_allclose(calibration.params[:4], CAMERA.params[:4], atol=2e-3, equal_nan=False)
    assert_allclose(calibration.params[4:], CAMERA.params[4:], atol=2e-5, equal_nan=False)
    assert calibration.rms < 1e-4
    assert not calibration.warnings


@pytest.mark.parametrize(
    ("coefficients", "expected"),
    [
        ([0, 0, 0, 0], ("SIMPLE_PINHOLE", "PINHOLE")),
        ([-0.25, 0, 0, 0], ("SIMPLE_RADIAL", "RADIAL")),
        ([-0.3, 0.15, 0.004, -0.004], ("OPENCV",)),
    ],
)
def test_the_ladder_stops_where_the_lens_does(coefficients, expected):
    camera = Camera("OPENCV", [800, 800, 330, 235, *coefficients], *SIZE, np.eye(4))
    calibration = calibrate_detections(detections(1, 8, camera), BOARD)
    assert calibration.model in expected
    assert_allclose(calibration.camera.focal_px, 800, atol=4 * calibration.std[0], equal_nan=False)


@pytest.mark.parametrize("smooth", [0.0, 0.05])
def test_intervals_hold_the_truth_as_often_as_they_say(smooth):
    hits = []
    for seed in range(24):
        found = detections(100 + seed, 10, noise=0.1 if smooth == 0 else 0.05, smooth=smooth)
        views = [view_of(each) for each in found.values()]
        fit = fit_lens(views, SIZE, OPENCV)
        std = np.sqrt(np.diag(statistical_covariance(views, fit)))
        hits.append(np.abs(fit.params - CAMERA.params) < 1.96 * std)
    # 24 draws of eight correlated parameters: the mean share is known to 2.5 %.
    assert 0.9 <= np.mean(hits) <= 0.995
    assert np.mean(hits, axis=0).min() > 0.77  # four standard errors below 95 %


def test_the_jackknife_agrees_with_leaving_views_out():
    views = [view_of(each) for each in detections(3, 12, smooth=0.1).values()]
    fit = fit_lens(views, SIZE, OPENCV)
    shifts = lens_information(views, fit).jackknife_shifts
    for k in (0, 5):
        others = fit_lens([view for j, view in enumerate(views) if j != k], SIZE, OPENCV, fit)
        # The shift is to first order, and a view is a twelfth of the evidence.
        off = np.abs(others.params - fit.params - shifts[k]) / np.abs(shifts).max(axis=0)
        assert off.max() < 0.05


def test_derivatives_by_the_pose_are_differences():
    view = view_of(next(iter(detections(4, 1).values())))
    (pose,) = board_poses(BOARD, CAMERA, 1, np.random.default_rng(4))
    _, of_pose, _ = pose_jacobian(view, OPENCV, CAMERA.params, pose)
    for k in range(6):
        step = np.zeros(6)
        step[k] = 1e-6
        ends = []
        for sign in (1, -1):
            moved = pose_matrix(sign * step[:3], np.zeros(3)) @ pose
            moved[:3, 3] = pose[:3, 3] + sign * step[3:]
            ends.append(CAMERA.posed(moved).project(BOARD.corners).ravel())
        slope = (ends[0] - ends[1]) / 2e-6
        assert_allclose(of_pose[:, k], slope, atol=1e-3, rtol=1e-5, equal_nan=False)  # rounding over the step


def test_errors_on_views_left_out_are_what_noise_leaves():
    calibration = calibrate_detections(detections(5, 12, noise=0.1), BOARD)
    # Two coordinates of 0.1 px; half a board's pose adds 6 of 54 coordinates' worth, the lens a little.
    expected = 0.1 * np.sqrt(2 * (1 + 6 / 54))
    assert calibration.held_out_rms == pytest.approx(expected, rel=0.06)
    assert calibration.rms < calibration.held_out_rms


def test_a_view_that_does_not_fit_is_named_and_left_out():
    found = detections(6, 8)
    bent = found["7.png"]
    x = bent.cells[:, 0] - 4
    found["7.png"] = replace(bent, points=bent.points + np.column_stack([0 * x, 0.15 * x**2]))
    calibration = calibrate_detections(found, BOARD)
    (dropped,) = (view for view in calibration.views if view.dropped is not None)
    assert dropped.name == "7.png"
    assert "outlier" in dropped.dropped
    assert dropped.rms > 0.5
    assert any("7.png" in warning for warning in calibration.warnings)
    assert_allclose(calibration.params[0], 800, atol=4 * calibration.std[0], equal_nan=False)


def test_a_corner_that_does_not_fit_is_left_out_alone():
    found = detections(7, 6)
    points = found["3.png"].points.copy()
    points[20] += [4.0, -3.0]
    found["3.png"] = replace(found["3.png"], points=points)
    calibration = calibrate_detections(found, BOARD)
    assert {view.name: view.corners_dropped for view in calibration.views if view.corners_dropped} == {
        "3.png": 1
    }
    assert len(calibration.used) == 6


def test_what_other_corner_windows_do_is_in_the_covariance():
    found = detections(8, 10)
    centre = np.array([330.0, 235.0])
    # Another window that sees everything 0.5 % larger about the centre would give a focal length as much longer.
    found = {
        name: replace(each, other_points=np.array([centre + 1.005 * (each.points - centre)] * 2))
        for name, each in found.items()
    }
    calibration = calibrate_detections(found, BOARD)
    assert_allclose(calibration.window_shifts[:, 0], 4.0, rtol=0.15, equal_nan=False)
    assert calibration.std[0] > 3.4
    assert np.sqrt(calibration.statistical_covariance[0, 0]) < 1.0


@pytest.mark.parametrize(
    "tilt",
    [(0, 0), pytest.param((30, 0), marks=pytest.mark.slow), pytest.param((15, -20), marks=pytest.mark.slow)],
)
def test_one_tilt_leaves_the_focal_length_undetermined(tilt):
    rng = np.random.default_rng(9)
    jitter = rng.normal(0, 0.7, (7, 2))
    poses = tilted(np.array(tilt) + jitter, rng)
    with pytest.raises(ValueError, match=r"focal length is undetermined.*tilt the board by 30 degrees"):
        calibrate_detections(detections(9, poses=poses), BOARD)


def test_a_little_tilt_widens_the_interval_and_says_so():
    rng = np.random.default_rng(10)
    poses = tilted(rng.uniform(-8, 8, (8, 2)), rng)
    calibration = calibrate_detections(detections(10, poses=poses), BOARD)
    assert calibration.std[0] > 1.0
    assert abs(calibration.params[0] - 800) < 3 * calibration.std[0]
    assert any("tilt by only" in warning for warning in calibration.warnings)


def test_a_fit_that_misses_its_corners_is_no_calibration():
    found = detections(11, 5, smooth=3.0)
    with pytest.raises(ValueError, match="the calibration failed"):
        calibrate_detections(found, BOARD)
    mixed = {**detections(12, 3, Camera("PINHOLE", [800, 800, 320, 240], *SIZE, np.eye(4)))}
    other = detections(13, 3, Camera("PINHOLE", [1600, 1600, 320, 240], *SIZE, np.eye(4)))
    mixed |= {f"zoomed {name}": each for name, each in other.items()}
    with pytest.raises(ValueError, match="the calibration failed"):
        calibrate_detections(mixed, BOARD)


def test_a_lens_model_folds_where_its_radius_turns_back():
    lens = LADDER[2]
    # r (1 + k r^2) grows up to r = 1 / sqrt(-3 k), where it reaches 2/3 of that.
    k, focal = -0.4, 500.0
    reach = focal * 2 / 3 / np.sqrt(-3 * k)
    camera = lens.camera(np.array([focal, 320, 240, k]), SIZE)
    points = picture_grid(SIZE)
    radius = np.linalg.norm(points - [320, 240], axis=1)
    folded = folds_at(camera, points)
    assert folded[radius > reach + 2].all()
    assert not folded[radius < 0.97 * reach].any()


@pytest.mark.parametrize("lens", LADDER, ids=lambda lens: lens.name)
def test_parameters_go_to_opencv_and_back(lens):
    params = np.arange(1.0, len(PARAM_NAMES[lens.model]) + 1)
    matrix, coefficients = lens.opencv(params)
    assert matrix[0, 2] == params[PARAM_NAMES[lens.model].index("cx")] - 0.5
    assert_allclose(lens.params(matrix, coefficients), params, atol=1e-12, equal_nan=False)  # rounding


def bent(seed, sag, count=10) -> dict[str, Detection]:
    """Views of a board whose middle stands out of its plane by `sag` metres, as a sphere's cap does."""
    rng = np.random.default_rng(seed)
    off = BOARD.corners - BOARD.corners.mean(axis=0)
    reach = np.linalg.norm(off[:, :2], axis=1).max()
    radius = (reach**2 + sag**2) / (2 * sag) if sag else np.inf
    lift = np.sqrt(radius**2 - (off**2).sum(axis=1)) - (radius - sag) if sag else 0 * off[:, 0]
    points = BOARD.corners + np.column_stack([0 * lift, 0 * lift, lift])
    found = {}
    for k, pose in enumerate(board_poses(BOARD, CAMERA, count, rng)):
        seen = CAMERA.posed(pose).project(points)
        noisy = seen + rng.normal(0, 0.05, (3, *seen.shape))
        found[f"{k}.png"] = Detection(CELLS, BOARD.corners, noisy[0], noisy[1:], SIZE)
    return found


def test_a_bent_board_is_named_and_its_harm_is_in_the_intervals():
    for seed in range(2):
        calibration = calibrate_detections(bent(30 + seed, 0.002), BOARD)
        assert any("bent or badly printed" in warning for warning in calibration.warnings)
        fx = list(calibration.param_names).index("fx" if "fx" in calibration.param_names else "f")
        error = abs(calibration.params[fx] - 800)
        # Of first order about a fit that is astray; the jackknife over views can't know that all of them are misled.
        assert error < 2 * np.sqrt((calibration.covariance - calibration.statistical_covariance)[fx, fx])
        assert error > 2 * np.sqrt(calibration.statistical_covariance[fx, fx])  # or it would be no harm
    assert not any("bent" in warning for warning in calibrate_detections(bent(30, 0.0), BOARD).warnings)


def test_residuals_that_are_no_noise_are_noted():
    # The same smooth error in the picture of each view: no board's shape.
    found = {}
    for name, each in detections(40, 8, noise=0.02, smooth=0.6).items():
        others = each.points + np.random.default_rng(1).normal(0, 0.03, each.other_points.shape)
        found[name] = replace(each, other_points=others)
    calibration = calibrate_detections(found, BOARD)
    assert any("this is no noise" in warning for warning in calibration.warnings)


def test_a_principal_point_allows_for_a_decentred_lens():
    camera = Camera("OPENCV", [800, 800, 330, 235, -0.2, 0, 2e-4, 2e-4], *SIZE, np.eye(4))
    calibration = calibrate_detections(detections(203, 8, camera, noise=0.06), BOARD)
    (richer,) = (candidate.fit for candidate in calibration.ladder if candidate.lens is OPENCV)
    assert calibration.model == "SIMPLE_RADIAL"
    assert richer is not None
    rest = calibration.covariance - calibration.statistical_covariance
    rest = rest - calibration.window_shifts.T @ calibration.window_shifts / len(calibration.window_shifts)
    for name in ("cx", "cy"):
        shift = richer.params[PARAM_NAMES["OPENCV"].index(name)]
        shift -= calibration.params[calibration.param_names.index(name)]
        k = calibration.param_names.index(name)
        assert rest[k, k] > 0.999 * shift**2  # the rest of it is rounding
        assert abs(shift) > 0.05  # or nothing was shown


def test_a_view_as_good_as_usual_ones_is_kept_among_better_ones():
    found = detections(41, 7, noise=0.02)
    rng = np.random.default_rng(2)
    blurred = found["4.png"]
    found["4.png"] = replace(blurred, points=blurred.points + rng.normal(0, 0.08, blurred.points.shape))
    assert len(calibrate_detections(found, BOARD).used) == 7


def test_too_few_photos_and_photos_without_a_usual_size_are_refused(tmp_path):
    with pytest.raises(ValueError, match="is a folder; give the photos in it"):
        calibrate_camera([tmp_path], BOARD)
    with pytest.raises(ValueError, match="1 photo is too few"):
        calibrate_camera(["a.png"], BOARD)
    with pytest.raises(ValueError, match="2 photos are too few"):
        calibrate_camera(["a.png", "b.png"], "chessboard:9x6:0.025")
    with pytest.raises(ValueError, match=r"a\.png: is given twice"):
        calibrate_camera(["a.png", "b.png", "a.png"], BOARD)
    views = [BoardView(f"{k}.png", (640, 480) if k < 2 else (480, 640), None) for k in range(4)]
    with pytest.raises(ValueError, match=r"more than half of the 4: 2 of 640x480, 2 of 480x640 .*portrait"):
        odd_sizes(views)
    assert odd_sizes(views[:3]).keys() == {"2.png"}
    assert not odd_sizes(views[:2])
    with pytest.raises(ValueError, match="2 views are too few"):
        calibrate_detections(dict(list(detections(14, 3).items())[:2]), BOARD)


def test_opencvs_photographs(data_dir):
    calibration = calibrate_camera(sorted((data_dir / "chessboard").glob("*.jpg")), "chessboard:9x6:1")
    values = dict(zip(calibration.param_names, calibration.params, strict=True))
    # The reference: windows of 5x5 reach 0.195 px, fx 532.8, fy 532.9, cx 342.5, cy 233.9 with centres at integers.
    assert calibration.rms <= 0.20
    assert values["fx"] == pytest.approx(532.8, abs=1.5)
    assert values["fy"] == pytest.approx(532.9, abs=1.5)
    assert values["cx"] == pytest.approx(343.0, abs=1.5)
    assert values["cy"] == pytest.approx(234.4, abs=1.5)
    assert calibration.rms < calibration.held_out_rms < 0.22
    assert len(calibration.used) == 13
    # Windows that stay clear of the neighbouring squares agree far better than the tutorial's, 3 px apart.
    assert np.abs(calibration.window_shifts[:, 0]).max() < 1.0


def test_photographs_with_known_truth_some_of_them_cut_off():
    rng = np.random.default_rng(15)
    found = {}
    for k, pose in enumerate(board_poses(BOARD, CAMERA, 8, rng)):
        if k % 3 == 0:
            pose[0, 3] += 0.3 * pose[2, 3] * SIZE[0] / CAMERA.focal_px * np.sign(pose[0, 3])
        seen = detect_board(board_photo(CAMERA.posed(pose), BOARD, rng, samples=2), BOARD)
        if seen is not None:
            found[f"{k}.png"] = seen
    assert len(found) >= 6
    assert any(not each.located for each in found.values())
    calibration = calibrate_detections(found, BOARD)
    truth = dict(zip(PARAM_NAMES["OPENCV"], CAMERA.params, strict=True)) | {"f": 802.5}
    for name, value, std in zip(calibration.param_names, calibration.params, calibration.std, strict=True):
        if name in ("f", "fx", "fy", "cx", "cy"):
            assert abs(value - truth[name]) < 3 * std
            assert std < 4


def test_a_fit_keeps_what_it_was_given():
    views = [view_of(each) for each in detections(16, 4, noise=0.2).values()]
    fit = fit_lens(views, SIZE, LADDER[0])
    assert isinstance(fit, LensFit)
    predicted = [
        fit.camera.posed(pose).project(view.board_points) for pose, view in zip(fit.poses, views, strict=True)
    ]
    for view, here, residual in zip(views, predicted, fit.residuals, strict=True):
        # COLMAP and OpenCV project the same point, half a pixel apart in convention.
        assert_allclose(view.points - here, residual, atol=1e-6, equal_nan=False)
