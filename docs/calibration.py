"""A camera calibrated from Python, start to finish: lens, response, noise, vignetting, and a photograph undone by all.

    python docs/calibration.py [FOLDER]

The photographs are made here, by a synthetic camera, so that the truth can be printed beside each number; with your
own, delete `photograph_everything` and name your files. Takes about twenty seconds.
"""

from __future__ import annotations

import sys
import tempfile
from pathlib import Path

import cv2
import numpy as np

from capture import (
    Camera,
    calibrate_camera,
    parse_board,
    recover_flat_field,
    recover_noise,
    recover_response,
)
from capture.decode import decode
from synthetic.sensing.boardphotos import board_photo, board_poses
from synthetic.sensing.sensor import RESPONSES, Sensor, expose, vignetting

BOARD = "charuco:7x5:0.030:0.0225"
TIMES = [1 / 250, 1 / 60, 1 / 15, 1 / 4]
LENS = Camera("RADIAL", [640.0, 322.0, 239.0, -0.12, 0.03], 640, 480, np.eye(4))
SENSOR = Sensor(
    full_well=np.full(3, 20_000.0), read_noise=np.full(3, 5.0), focal_px=640.0, response="film", bits=8
)


def main(folder: Path) -> None:
    """Photograph, calibrate, and print estimate and truth."""
    scene = photograph_everything(folder)

    # The lens: ten photographs of a board. The model is chosen by what it predicts of photographs left out.
    lens = calibrate_camera(sorted(folder.glob("board*.png")), BOARD)
    print(f"{lens.model}, RMS {lens.rms:.3f} px, on photographs left out {lens.held_out_rms:.3f} px")
    print(f"focal length {lens.camera.focal_px:.2f} +- {lens.std[0]:.2f} px, in truth {LENS.focal_px:.2f}")

    # The response: one scene at several exposure times, given by hand because these files hold no EXIF.
    bracket = sorted(folder.glob("bracket*.png"))
    response = recover_response(bracket, TIMES).response
    print(
        f"response determined for values from {response.determined(1)[0]:.3f} to {response.determined(1)[1]:.3f}"
    )

    # Noise: the same scene twice, through the curve just found, whose scale is free: relative noise tells more.
    noise = recover_noise(sorted(folder.glob("pair*.png")), response)
    grey = response.table(255)[:, 128]
    relative = np.sqrt(noise.model.variance(grey)) / grey
    electrons = 20_000.0 * inverse(SENSOR.response, 128 / 255)
    print(f"noise of middle grey {relative[1]:.2%}, in truth {np.sqrt(electrons + 5.0**2) / electrons:.2%}")

    # Vignetting: a white wall, the camera turned in between.
    flat_field = recover_flat_field(sorted(folder.glob("wall*.png")), response).flat_field
    corner, truth = flat_field.gain(640, 480)[0, 0, 1], vignetting(SENSOR, 640, 480)[0, 0]
    print(f"light in the picture's corner {corner:.3f}, in truth {truth:.3f}")

    # A photograph with everything undone: linear radiance, its variance, and where it is saturated.
    photo = decode(bracket[2], response, TIMES[2], noise=noise.model, flat_field=flat_field)
    fair = ~photo.saturated
    radiance, std = photo.radiance[fair, 1], np.sqrt(photo.variance[fair, 1])
    truth = scene[fair, 1] * np.sum(radiance) / np.sum(scene[fair, 1])
    print(f"errors over stated standard deviations, {fair.mean():.0%} of the picture:", end=" ")
    print(f"{np.sqrt(np.mean(((radiance - truth) / std) ** 2)):.2f} (RMS; 1 if they are honest)")


def inverse(response: str, value: float) -> float:
    """The signal that a sensor's curve turns into a value."""
    signal = np.linspace(0, 1, 10_001)
    return float(np.interp(value, RESPONSES[response](signal), signal))


def photograph_everything(folder: Path) -> np.ndarray:
    """Ten boards, a bracket, a pair and four walls as PNG files in a folder; returns the scene's radiance (h, w, 3)."""
    rng = np.random.default_rng(1)
    board = parse_board(BOARD)
    for index, pose in enumerate(board_poses(board, LENS, 10, rng)):
        save(folder / f"board{index}.png", board_photo(LENS.posed(pose), board, rng, samples=3))
    y, x = np.mgrid[:480, :640]
    steps = np.floor(x / 40) + 16 * np.floor(y / 120)
    scene = np.repeat((0.02 * 1.12**steps)[..., None], 3, axis=2) * [1.0, 0.9, 0.8]
    for index, time in enumerate(TIMES):
        save(folder / f"bracket{index}.png", expose(scene, time, SENSOR, rng))
    for index in range(2):
        save(folder / f"pair{index}.png", expose(scene, TIMES[2], SENSOR, rng))
    light = 0.5 * (1 + 0.02 * (x / 640 - 0.5))[..., None] * np.ones(3)
    for index in range(4):
        wall = light[:, ::-1] if index % 2 else light
        save(folder / f"wall{index}.png", expose(wall, 1.0, SENSOR, rng))
    return scene


def save(path: Path, picture: np.ndarray) -> None:
    """A PNG of grey levels or of RGB, whatever letters its folder's name has."""
    channels = picture if picture.ndim == 2 else picture[..., ::-1]
    path.write_bytes(cv2.imencode(".png", channels)[1].tobytes())


if __name__ == "__main__":
    if len(sys.argv) > 1:
        Path(sys.argv[1]).mkdir(parents=True, exist_ok=True)
        main(Path(sys.argv[1]))
    else:
        with tempfile.TemporaryDirectory() as temporary:
            main(Path(temporary))
