"""Boards: their frame, their corners in photographs with known truth, and what is printed."""

from __future__ import annotations

from functools import cache

import cv2
import numpy as np
import pytest
from numpy.testing import assert_allclose

from capture.boards.board import Board, charuco_board, parse_board
from capture.boards.boardpose import board_pose
from capture.boards.boardprint import PAPERS, board_figure
from capture.boards.boardsearch import BoardView, MarkerReport, board_view, check_board, detect_board, missing
from capture.camera import Camera
from synthetic.sensing.boardphotos import board_photo, board_poses

CHESSBOARD = parse_board("chessboard:9x6:0.025")
CHARUCO = parse_board("charuco:8x6:0.030:0.022")
CAMERA = Camera("OPENCV", [800, 805, 330, 235, -0.25, 0.08, 0.001, -0.0005], 640, 480, np.eye(4))


@cache
def photo(board: Board, seed: int, shift=(0.0, 0.0), fill=0.6, legacy=False, camera=CAMERA):
    """A photograph and the camera posed in the board's frame; shift in widths of the picture at the board."""
    rng = np.random.default_rng(seed)
    (pose,) = board_poses(board, camera, 1, rng, fill=fill)
    pose[:2, 3] += np.array(shift) * pose[2, 3] * camera.width / camera.focal_px
    posed = camera.posed(pose)
    return board_photo(posed, board, rng, samples=3, legacy=legacy), posed


@pytest.mark.parametrize("text", ["chessboard:9x6:0.025", "charuco:7x5:0.03:0.022:DICT_4X4_50"])
def test_the_text_of_a_board_is_read_back(text):
    assert parse_board(text).spec == text


@pytest.mark.parametrize(
    ("text", "says"),
    [
        ("9x6", "no kind of board"),
        ("chessboard:9x6", "parts"),
        ("chessboard:9-6:0.025", "COLUMNSxROWS"),
        ("chessboard:9x6:25mm", "length in metres"),
        ("chessboard:9x6:-1", "must be > 0"),
        ("chessboard:9x6:nan", "must be > 0"),
        ("chessboard:2x6:0.1", "too small"),
        ("chessboard:9x6:25", "looks like millimetres: 0.025"),
        ("charuco:7x5:0.03:0.04", "between 0 and the square's"),
        ("charuco:7x5:0.03:0.02:DICT_9X9", "DICT_5X5_100"),
        ("charuco:70x50:0.03:0.02:DICT_4X4_50", "larger dictionary"),
    ],
)
def test_a_board_that_cannot_be_is_refused_and_told_how(text, says):
    with pytest.raises(ValueError, match=r"board '.*'") as caught:
        parse_board(text)
    assert says in str(caught.value)


def test_the_frame_is_opencvs_turned_about_x():
    # OpenCV: y down, z into the board, origin at the outer corner. Ours: y up, z out, origin at the first corner.
    theirs = np.asarray(charuco_board(CHARUCO).getChessboardCorners(), float)
    # Their sides are float32.
    assert_allclose(CHARUCO.corners, (theirs - theirs[0]) * [1, -1, -1], atol=1e-7, equal_nan=False)


@pytest.mark.parametrize(("board", "legacy"), [(CHESSBOARD, False), (CHARUCO, False), (CHARUCO, True)])
def test_corners_lie_where_the_camera_put_them(board, legacy):
    errors = []
    for seed in range(3):
        image, camera = photo(board, seed, legacy=legacy)
        detection = detect_board(image, board)
        assert detection is not None
        assert detection.located
        assert len(detection.cells) >= 0.5 * len(board.corners)
        errors.append(detection.points - camera.project(board.cell_points(detection.cells)))
    errors = np.concatenate(errors)
    # 1 % noise; markers leave small windows. A quarter pixel of wrong convention would show in the mean.
    assert np.sqrt((errors**2).sum(axis=1).mean()) < (0.12 if board is CHARUCO else 0.07)
    assert_allclose(errors.mean(axis=0), 0, atol=0.02, equal_nan=False)  # four standard errors


def test_six_megapixels_are_measured_at_full_size():
    params = CAMERA.params * np.array([4.5, 4.5, 4.5, 4.5, 1, 1, 1, 1])
    camera = Camera("OPENCV", params, 2880, 2160, np.eye(4))
    rng = np.random.default_rng(4)
    (pose,) = board_poses(CHESSBOARD, camera, 1, rng)
    image = board_photo(camera.posed(pose), CHESSBOARD, rng, blur=2, noise=0.01, samples=1)
    detection = detect_board(image, CHESSBOARD)
    assert detection is not None
    errors = detection.points - camera.posed(pose).project(CHESSBOARD.cell_points(detection.cells))
    # At the scale of the search alone it would be 0.05 px times 2.9.
    assert np.sqrt((errors**2).sum(axis=1).mean()) < 0.08


def test_a_chessboard_cut_off_gives_all_corners_in_the_picture():
    image, camera = photo(CHESSBOARD, 1, shift=(0.35, 0.0))
    detection = detect_board(image, CHESSBOARD)
    truth = camera.project(CHESSBOARD.corners)
    well_inside = ((truth > 14) & (truth < np.array([640, 480]) - 14)).all(axis=1)
    assert 20 < well_inside.sum() < 50
    assert detection is not None
    assert not detection.located
    assert abs(len(detection.cells) - well_inside.sum()) <= 2  # those within a window of the border
    nearest = np.linalg.norm(detection.points[:, None] - truth[None], axis=2)
    assert nearest.min(axis=1).max() < 0.3  # five standard deviations
    # A proper grid: its cells are the board's, turned by quarters and shifted.
    seen = np.column_stack([nearest.argmin(axis=1) % 9, nearest.argmin(axis=1) // 9])
    homogeneous = np.column_stack([detection.cells, np.ones(len(seen))])
    turn = np.linalg.lstsq(homogeneous, seen, rcond=None)[0]
    assert_allclose(homogeneous @ turn, seen, atol=1e-9, equal_nan=False)  # integers
    assert np.linalg.det(turn[:2]) == pytest.approx(1)


@pytest.mark.parametrize("quarters", [1, 2, 3])
def test_a_board_with_an_odd_side_is_counted_from_its_dark_corner_however_it_is_held(quarters):
    image, _ = photo(CHESSBOARD, 2)
    upright = detect_board(image, CHESSBOARD)
    held = detect_board(np.ascontiguousarray(np.rot90(image, quarters)), CHESSBOARD)
    assert upright is not None
    assert held is not None
    x, y = held.points.T
    # np.rot90 turns counter-clockwise.
    back = {
        1: np.column_stack([640 - y, x]),
        2: np.column_stack([640 - x, 480 - y]),
        3: np.column_stack([y, 480 - x]),
    }[quarters]
    mine = {tuple(cell): point for cell, point in zip(upright.cells, upright.points, strict=True)}
    difference = [
        mine[tuple(cell)] - point for cell, point in zip(held.cells, back, strict=True) if tuple(cell) in mine
    ]
    assert len(difference) >= 50
    assert np.abs(difference).max() < 0.05  # the same pixels, summed in another order


def test_sixteen_bits_and_floats_show_the_same_corners():
    image, _ = photo(CHESSBOARD, 3)
    linear = (image / 255.0) ** 2.2
    for pixels in (
        np.repeat(linear[..., None], 3, axis=2).astype(np.float32),
        (linear * 3000).astype(np.uint16),
    ):
        found, expected = detect_board(pixels, CHESSBOARD), detect_board(image, CHESSBOARD)
        assert found is not None
        assert expected is not None
        assert_allclose(
            found.points, expected.points, atol=0.15, equal_nan=False
        )  # another curve, the same edges


def test_no_board_is_no_detection():
    noise = np.random.default_rng(0).integers(0, 255, (480, 640), dtype=np.uint8)
    assert detect_board(noise, CHESSBOARD) is None
    assert detect_board(noise, CHARUCO) is None
    assert detect_board(np.zeros((48, 64), np.uint8), CHESSBOARD) is None


@pytest.mark.parametrize(
    ("said", "hint"),
    [("10x7", "not squares"), ("8x5", "9x6"), pytest.param("7x7", "9x6", marks=pytest.mark.slow)],
)
def test_a_wrong_size_is_told_with_what_was_seen(said, hint):
    board = parse_board(f"chessboard:{said}:0.025")
    views = [board_view(photo(CHESSBOARD, seed)[0], board, f"{seed}.png") for seed in range(3)]
    with pytest.raises(ValueError, match="9x6 inner corners were seen in 3 of 3 photos") as caught:
        check_board(views, board)
    assert hint in str(caught.value)


def test_cut_off_views_are_no_wrong_size():
    views = [
        board_view(photo(CHESSBOARD, seed, shift=(0.4, 0.1))[0], CHESSBOARD, f"{seed}.png")
        for seed in range(2)
    ]
    assert any(view.detection is not None and not view.detection.located for view in views)
    check_board(views, CHESSBOARD)


@pytest.mark.parametrize(
    ("said", "says"),
    [
        ("charuco:8x6:0.030:0.022:DICT_6X6_100", "of DICT_5X5_1000"),
        ("charuco:4x3:0.030:0.022", "this board's end at 5"),
    ],
)
def test_a_wrong_charuco_board_is_told_with_what_was_seen(said, says):
    board = parse_board(said)
    view = board_view(photo(CHARUCO, 0)[0], board, "0.png")
    assert view.detection is None
    with pytest.raises(ValueError, match="markers") as caught:
        check_board([view], board)
    assert says in str(caught.value)


@pytest.mark.parametrize(
    ("said", "shown", "says"),
    [
        ("charuco:6x8:0.030:0.022", CHARUCO, "are columns and rows swapped"),
        ("charuco:8x6:0.030:0.015", CHARUCO, "markers are 0.7"),
        ("charuco:8x6:0.030:0.022", CHESSBOARD, "say chessboard:9x6:SIDE"),
        ("chessboard:6x4:0.030", CHARUCO, "markers of DICT_5X5_1000 were seen"),
    ],
)
def test_a_board_of_another_make_is_told_with_what_was_seen(said, shown, says):
    board = parse_board(said)
    views = [board_view(photo(shown, seed)[0], board, f"{seed}.png") for seed in range(2)]
    with pytest.raises(ValueError, match=says):
        check_board(views, board)


def test_charuco_views_that_are_cut_off_contradict_nothing_however_many():
    good = [board_view(photo(CHARUCO, seed)[0], CHARUCO, f"{seed}.png") for seed in range(3)]
    own = BoardView("cut.png", (640, 480), None, markers=MarkerReport("DICT_5X5_100", (0, 4, 8)))
    check_board(good + [own] * 9, CHARUCO)
    assert "3 markers were seen, but fewer than 8" in missing(own, CHARUCO)
    image, _ = photo(CHARUCO, 1, shift=(0.76, 0.0))
    seen = board_view(image, CHARUCO, "cut.png")
    assert seen.detection is None
    assert seen.markers is not None
    assert not seen.markers.misplaced
    check_board([*good, *[seen] * 9], CHARUCO)


def test_a_charuco_board_half_covered_and_with_glare_gives_the_corners_that_are_plain_to_see():
    hidden, errors, count, plain = 0, [], 0, 0
    for seed in range(4):
        image, camera = photo(CHARUCO, 30 + seed, fill=0.9)
        truth = camera.project(CHARUCO.corners)
        covered = image.copy()
        finger = truth[3] + 0.15 * (truth[10] - truth[3])
        side = float(np.linalg.norm(truth[1] - truth[0]))
        cv2.circle(covered, (int(finger[0]), int(finger[1])), int(0.75 * side), 120, -1)
        rows, columns = np.mgrid[:480, :640] + 0.5
        spot = np.exp(-((columns - truth[24, 0]) ** 2 + (rows - truth[24, 1]) ** 2) / (2 * (0.5 * side) ** 2))
        covered = np.clip(covered + 200 * spot, 0, 255).astype(np.uint8)
        away = (np.linalg.norm(truth - finger, axis=1) > 1.1 * side) & (
            np.linalg.norm(truth - truth[24], axis=1) > 1.5 * side
        )
        detection = detect_board(covered, CHARUCO)
        assert detection is not None
        found = detection.cells[:, 1] * 7 + detection.cells[:, 0]
        errors.append(np.linalg.norm(detection.points - truth[found], axis=1))
        hidden += int((~away).sum())
        count, plain = count + int(away[found].sum()), plain + int(away.sum())
    assert hidden >= 12
    assert count >= 0.97 * plain  # with both markers asked for, 0.75
    assert np.concatenate(errors).max() < 0.8  # a wrong corner is off by pixels


@pytest.mark.parametrize("board", [CHESSBOARD, CHARUCO])
def test_a_pose_lies_within_its_covariance(board):
    surprises = []
    for seed in range(8):
        image, camera = photo(board, 20 + seed)
        detection = detect_board(image, board)
        assert detection is not None
        pose, covariance, rms = board_pose(detection, CAMERA)
        assert rms < 0.15
        difference = pose @ np.linalg.inv(camera.world_to_camera)
        turn = cv2.Rodrigues(difference[:3, :3])[0].ravel()
        shift = pose[:3, 3] - camera.world_to_camera[:3, 3]
        error = np.concatenate([turn, shift])
        surprises.append(error @ np.linalg.solve(covariance, error))
    # The mean of eight chi-square variables of six degrees: 6 +- 1.2.
    assert 2 < np.mean(surprises) < 11


def test_a_part_of_a_chessboard_has_no_pose():
    image, _ = photo(CHESSBOARD, 1, shift=(0.35, 0.0))
    detection = detect_board(image, CHESSBOARD)
    assert detection is not None
    with pytest.raises(ValueError, match="could be any part"):
        board_pose(detection, CAMERA)


@pytest.mark.parametrize(
    "text", ["charuco:7x5:0.030:0.022", "chessboard:9x6:0.025", "charuco:5x6:0.03:0.02:DICT_4X4_50"]
)
def test_a_printed_board_is_as_long_as_it_says(text):
    board, dpi = parse_board(text), 127  # 5 pixels per millimetre
    figure = board_figure(board, "a4")
    figure.set_dpi(dpi)
    from matplotlib.backends.backend_agg import FigureCanvasAgg

    canvas = FigureCanvasAgg(figure)
    canvas.draw()
    page = np.asarray(canvas.buffer_rgba())[..., :3]
    detection = detect_board(page, board)
    assert detection is not None
    assert len(detection.cells) == len(board.corners)
    shift = detection.points.mean(axis=0) - detection.cells.mean(axis=0) * 5000 * board.square
    # Pixels of the page are whole, so that an edge may be half of one off.
    assert_allclose(
        detection.points, detection.cells * 5000 * board.square + shift, atol=1.0, equal_nan=False
    )


def test_a_board_too_large_for_its_paper_is_told_what_would_fit():
    with pytest.raises(ValueError, match="doesn't fit") as caught:
        board_figure(parse_board("charuco:7x5:0.05:0.04"), "a4")
    words = str(caught.value).split("--square-mm ")[1].split()
    fitting = Board("charuco", 7, 5, float(words[0]) / 1000, float(words[2].rstrip(",")) / 1000)
    board_figure(fitting, "a4")
    assert "--paper a3" in str(caught.value)
    assert "a3" in PAPERS
