"""Calibration photographs: what capture finds in them is what they were made with."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest
from numpy.testing import assert_allclose

from capture import Camera, calibrate_camera, parse_board, recover_flat_field, recover_noise, recover_response
from capture.camera import ORTHOGRAPHIC
from synthetic.sensing.boardphotos import board_poses
from synthetic.sensing.calibrationshots import FOLDERS, write_calibration_shots
from synthetic.sensing.development import Development
from synthetic.sensing.radiometryfiles import true_response
from synthetic.sensing.sensor import Sensor, vignetting

CAMERA = Camera("SIMPLE_RADIAL", [410.0, 203.0, 148.0, -0.12], 400, 300, np.eye(4))
SENSOR = Sensor(
    full_well=[15_000, 20_000, 30_000], read_noise=[8, 10, 12], focal_px=410.0, response="film", bits=8
)
BOARD = parse_board("charuco:7x5:0.030:0.0225")


@pytest.fixture(scope="module")
def shots(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, dict[str, Any]]:
    folder = tmp_path_factory.mktemp("shots")
    rng = np.random.default_rng(3)
    # The set's own bracket and exposure must not reach the calibration photographs.
    development = Development(SENSOR, "png", exposure_s=1e-3, bracket=(-2, 0))
    truth = write_calibration_shots(folder, CAMERA, development, BOARD, rng, boards=8)
    return folder, truth


def paths(shots: tuple[Path, dict[str, Any]], kind: str) -> list[Path]:
    folder, truth = shots
    return [folder / name for name in truth[kind]["photos"]]


def test_every_kind_lies_in_its_folder(shots):
    folder, truth = shots
    assert tuple(truth) == FOLDERS
    for kind in FOLDERS:
        assert sorted(folder.joinpath(kind).iterdir()) == paths(shots, kind)
        assert len(truth[kind]["exposure_s"]) == len(truth[kind]["photos"])
    assert truth["board"]["photos"] == [f"board/{index:02d}.png" for index in range(8)]


def test_boards_give_the_lens(shots):
    truth = shots[1]["board"]
    found = calibrate_camera(paths(shots, "board"), truth["board"])
    # The same lens may be found with a further coefficient, of 0.
    assert (truth["model"], found.model) in {("SIMPLE_RADIAL", "SIMPLE_RADIAL"), ("SIMPLE_RADIAL", "RADIAL")}
    assert (found.width, found.height) == (truth["width"], truth["height"])
    expected = np.zeros(len(found.params))
    expected[:4] = truth["params"]
    assert np.abs((found.params - expected) / found.std).max() < 3  # of five numbers once in seventy draws
    assert (found.std[:3] < 8.0).all()  # and not by being vague: 2% of the focal length, of 8 small pictures


@pytest.mark.slow
def test_bracket_gives_the_response(shots):
    truth = shots[1]["response"]
    found = recover_response(paths(shots, "response"), truth["exposure_s"])
    assert not found.warnings
    middle = 128  # where the scales of both curves are set to meet
    expected = np.log(np.array(truth["exposure"][1:]) / truth["exposure"][middle])
    for channel in range(3):
        curve, std = found.response.log_exposure[channel, 1:], found.response.log_std[channel, 1:]
        known = np.isfinite(curve)
        assert known.mean() > 0.9
        off = (curve - curve[middle - 1] - expected)[known]
        assert np.mean(np.abs(off) <= 1.96 * np.maximum(std[known], 1e-9)) > 0.9  # 95% intervals
        assert np.abs(off[10:]).max() < 0.03  # percent, from code 11 or so on


def test_repeats_give_the_noise(shots):
    truth = shots[1]["noise"]
    assert truth["altered_by"] == []
    found = recover_noise(paths(shots, "noise"), true_response(SENSOR))
    for name in ("read_std", "shot"):
        parts = getattr(found, name)
        off = [(part.value - true) / part.std for part, true in zip(parts, truth[name], strict=True)]
        assert np.abs(off).max() < 4  # six numbers, and the curve between the knots
    assert_allclose(found.model.shot, truth["shot"], rtol=0.05)  # of 360,000 pixels, three times each


def test_walls_give_the_vignetting(shots):
    truth = shots[1]["flatfield"]
    recovery = recover_flat_field(paths(shots, "flatfield"), true_response(SENSOR))
    assert recovery.fit.turned
    found = recovery.flat_field
    expected = vignetting(SENSOR, 400, 300)
    assert truth["corner"] == expected[0, 0] == pytest.approx(0.533, abs=0.001)  # (1 + (250 / 410)^2)^-2
    # The mean of four walls has 0.4% per pixel, its polynomial 0.03%, but less certain in the corners.
    assert_allclose(found.gain(400, 300), np.repeat(expected[..., None], 3, axis=2), rtol=0.003)


def test_raw_repeats_give_the_noise_of_photosites(tmp_path, rng):
    sensor = Sensor(full_well=10_000, read_noise=12, bits=14)
    camera = Camera("SIMPLE_PINHOLE", [200.0, 100.0, 75.0], 200, 150, np.eye(4))
    truth = write_calibration_shots(tmp_path, camera, Development(sensor, "dng"), BOARD, rng, boards=3)
    assert "response" not in truth
    assert truth["flatfield"]["focal_px"] is None
    found = recover_noise([tmp_path / name for name in truth["noise"]["photos"]])
    assert_allclose(found.model.shot, truth["noise"]["shot"], rtol=0.1)
    assert_allclose(found.model.read_std, truth["noise"]["read_std"], rtol=0.1)  # few and small pictures


def test_what_cannot_be_calibrated_is_refused(tmp_path, rng):
    flat = Camera(ORTHOGRAPHIC, [], 40, 30, np.eye(4))
    with pytest.raises(ValueError, match="an orthographic camera has no lens to calibrate"):
        write_calibration_shots(tmp_path, flat, Development(), BOARD, rng)
    with pytest.raises(ValueError, match="boards is 2; calibration needs 3"):
        write_calibration_shots(tmp_path, CAMERA, Development(), BOARD, rng, boards=2)
    with pytest.raises(ValueError, match=r"poses of the board charuco:7x5.* lower fill = 3"):
        board_poses(BOARD, CAMERA, 2, rng, fill=3)
