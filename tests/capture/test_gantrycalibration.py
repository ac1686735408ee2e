from __future__ import annotations

import json
from pathlib import Path

import cv2
import numpy as np
import pytest
from numpy.testing import assert_allclose
from scipy.spatial.transform import Rotation

from capture.arc.gantry import Arc
from capture.arc.gantrycalibration import calibrate_gantry
from capture.boards.board import parse_board
from capture.camera import Camera
from capture.photoset import load_photoset
from lightfactor.cli import app
from synthetic.sensing.boardphotos import board_photo

CAMERA = Camera("RADIAL", [760.0, 320, 240, -0.1, 0.02], 640, 480, np.eye(4))
# Looks down on the board from an arm, a little askew.
MOUNT = Rotation.from_euler("xyz", [38, 3, 2], degrees=True).as_matrix()
STEP_DEG = 25.0


def arc_over(spec: str) -> Arc:
    middle = parse_board(spec).corners.mean(axis=0)
    return Arc(middle + np.array([0, 0, 0.4]), [0.02, -0.03, 1], 0.5, [0.3, -1, 0], MOUNT)


@pytest.fixture(
    scope="module",
    params=["charuco:7x5:0.035:0.026", pytest.param("chessboard:8x6:0.028", marks=pytest.mark.slow)],
)
def gantry(request, tmp_path_factory) -> tuple[str, Arc, list[Path]]:
    """A board's spec, the arc, and photographs of the board by a camera on it, over half a turn and more."""
    spec = request.param
    folder = tmp_path_factory.mktemp("gantry é")
    arc = arc_over(spec)
    photos = []
    for index in range(9):
        posed = CAMERA.posed(arc.pose(np.radians(STEP_DEG * index)))
        picture = board_photo(posed, parse_board(spec), np.random.default_rng(index), samples=3)
        photos.append(folder / f"stop {index}.png")
        assert cv2.imwrite(str(photos[-1]), picture)
    return spec, arc, photos


def test_a_gantry_is_calibrated_from_photographs_of_a_board(gantry):
    spec, arc, photos = gantry
    found = calibrate_gantry(photos, spec, CAMERA)
    assert not found.left_out
    assert not found.warnings
    fit = found.fit
    # Corners to 0.1 px at 760 px: a tenth of a millimetre; three standard deviations, which must be useful ones.
    assert abs(fit.arc.radius - arc.radius) < 3 * fit.radius_std < 1e-3
    assert np.degrees(abs(fit.arc.step - np.radians(STEP_DEG))) < np.degrees(3 * fit.step_std) < 0.02
    for angle in np.radians([0, 60, 170]):
        # 0.02 degrees and 0.3 mm: three standard deviations of what these photographs tell.
        assert_allclose(fit.arc.pose(angle)[:3, :3], arc.pose(angle)[:3, :3], atol=4e-4, equal_nan=False)
        assert_allclose(fit.arc.position(angle), arc.position(angle), atol=5e-4, equal_nan=False)


def test_the_command_writes_what_a_photo_set_reads(gantry, tmp_path, capsys, monkeypatch):
    spec, arc, photos = gantry
    camera = {"model": "RADIAL", "params": CAMERA.params.tolist(), "width": 640, "height": 480}
    (tmp_path / "camera.json").write_text(json.dumps(camera))
    out = tmp_path / "gantry.json"
    monkeypatch.setattr("capture.terminal.leave_cleanly_when_stopped", lambda: None)
    blank = tmp_path / "blank.png"
    assert cv2.imwrite(str(blank), np.full((480, 640), 128, np.uint8))
    command = ["calibrate", "gantry", *map(str, [*photos, blank]), "--board", spec]
    angles = ",".join(str(30 + STEP_DEG * index) for index in range(10))
    command += ["--camera", str(tmp_path / "camera.json"), "--angles-deg", angles, "-o", str(out)]
    app(command, standalone_mode=False)
    printed = capsys.readouterr().out
    assert "Left out: blank.png" in printed
    assert (tmp_path / "gantry-figure.png").stat().st_size > 10_000
    assert json.loads(out.read_text())["photos"][2]["angle_deg"] == pytest.approx(80, abs=0.05)  # three std
    manifest = (
        f'format = 1\nname = "set"\ncamera = {{ file = "camera.json" }}\ngantry = {{ file = "{out}" }}\n'
    )
    (tmp_path / "photoset.toml").write_text(f'{manifest}[[photo]]\nfile = "a.png"\ngantry_angle_deg = 90\n')
    (photo,) = load_photoset(tmp_path).photos
    assert_allclose(photo.camera.centre, arc.position(np.radians(60)), atol=5e-4)


def test_a_photograph_that_does_not_fit_is_left_out_and_named(gantry, tmp_path):
    spec, arc, photos = gantry
    moved = arc.pose(np.radians(STEP_DEG * 3))
    moved[:3, 3] += moved[:3, :3] @ [0.01, 0.004, 0]
    picture = board_photo(CAMERA.posed(moved), parse_board(spec), np.random.default_rng(9), samples=3)
    nudged = tmp_path / "nudged.png"
    assert cv2.imwrite(str(nudged), picture)
    found = calibrate_gantry([*photos[:3], nudged, *photos[4:]], spec, CAMERA)
    assert len(found.left_out) == 1
    assert "nudged.png: doesn't fit the arc of the others" in found.left_out[0]
    assert abs(found.fit.arc.radius - arc.radius) < 3 * found.fit.radius_std < 1e-3


def test_another_camera_is_refused_or_told(gantry):
    spec, _, photos = gantry
    other = Camera("RADIAL", [380.0, 320, 240, -0.1, 0.02], 640, 480, np.eye(4))
    with pytest.raises(ValueError, match=r"px \(RMS\) from where this camera can see them from anywhere"):
        calibrate_gantry(photos[:5], spec, other)


def test_the_cameras_own_uncertainty_is_carried_along(gantry):
    spec, _, photos = gantry
    exact = calibrate_gantry(photos[:5], spec, CAMERA).fit
    covariance = np.diag([4.0, 0, 0, 0, 0])  # two pixels of focal length
    fit = calibrate_gantry(photos[:5], spec, CAMERA, camera_covariance=covariance).fit
    # To first order the distance goes with the focal length: 2 / 760 of it, less on the radius, by the arm's slope.
    moved = Camera("RADIAL", [762.0, 320, 240, -0.1, 0.02], 640, 480, np.eye(4))
    shift = abs(calibrate_gantry(photos[:5], spec, moved).fit.arc.radius - exact.arc.radius)
    assert fit.radius_std == pytest.approx(np.hypot(exact.radius_std, shift), rel=0.05)


def test_the_gantrys_own_angles_are_checked(gantry):
    spec, _, photos = gantry
    right = np.radians(STEP_DEG * np.arange(5))
    found = calibrate_gantry(photos[:5], spec, CAMERA, list(right))
    assert found.fit.arc.step is not None
    slipped = right + np.radians([0, 0, 0.6, 0, 0])
    assert "stop 2.png was taken at" in calibrate_gantry(photos[:5], spec, CAMERA, list(slipped)).warnings[0]
    with pytest.raises(
        ValueError, match=r"stop . ?.*\.png was taken at .* degrees, not at the .* that was given"
    ):
        calibrate_gantry(photos[:5], spec, CAMERA, list(right[[0, 2, 1, 3, 4]]))
    for bad in ([0, np.nan, 1, 2, 3], [1] * 5):
        with pytest.raises(ValueError, match="must be finite and differ"):
            calibrate_gantry(photos[:5], spec, CAMERA, bad)


def test_photographs_of_another_board_or_without_one_are_named(gantry, tmp_path):
    spec, _, photos = gantry
    with pytest.raises(ValueError, match="2 angles for 9 photos"):
        calibrate_gantry(photos, spec, CAMERA, [0, 0.1])
    with pytest.raises(ValueError, match=r"stop 0\.png: is given twice"):
        calibrate_gantry([*photos, photos[0]], spec, CAMERA)
    blank = tmp_path / "blank.png"
    assert cv2.imwrite(str(blank), np.full((480, 640), 128, np.uint8))
    with pytest.raises(
        ValueError, match=r"2 photos show the board, and an arc needs 3; left out: blank\.png"
    ):
        calibrate_gantry([blank, photos[0], photos[1]], spec, CAMERA)
    larger = Camera("RADIAL", [760.0, 320, 240, -0.1, 0.02], 800, 600, np.eye(4))
    with pytest.raises(
        ValueError, match=r"left out: stop 0\.png: the photo has 640x480 pixels, its camera 800x600"
    ):
        calibrate_gantry(photos, spec, larger)
