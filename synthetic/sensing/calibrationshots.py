"""Calibration photographs of a scene's own camera, with what each kind must yield.

Boards for the lens, a bracket for the response, repeats for the noise, an even wall for the vignetting: as
docs/calibration.md asks photographers to take them.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import gaussian_filter
from scipy.stats import norm

from capture.boards.board import Board
from capture.camera import Camera
from capture.sensor.flatfield import half_diagonal
from synthetic.sensing.boardphotos import board_poses, board_radiance
from synthetic.sensing.development import Development, WrittenShot, write_photograph
from synthetic.sensing.radiometryfiles import true_noise
from synthetic.sensing.sensor import signal_of, vignetting

Floats = NDArray[np.float64]
Progress = Callable[[Iterable[Any], str], Iterable[Any]]

FOLDERS = ("board", "response", "noise", "flatfield")
# Signal of the brightest paper of a board: well exposed, and unclipped where light falls unevenly.
_PAPER_SIGNAL = 0.75
_BRACKET_S = (1 / 256, 1 / 64, 1 / 16, 1 / 4)
# The darkest part shows at the longest of these times, the brightest is below white at the shortest.
_BRACKET_SIGNALS = (0.02, 0.9)
_REPEATS, _NOISE_S = 3, (1 / 64, 1 / 16)
# At the longer time.
_NOISE_SIGNALS = (0.02, 0.85)
# Standard deviation of the filter that makes scenes smooth, as a share of the picture's shorter side.
_GRAIN = 0.06
# Signal of the wall at its middle, and its gradient per half diagonal of the picture.
_WALL_SIGNAL, _WALL_GRADIENT = 0.5, 0.04
_ANY_TIME_S = 1 / 32


def write_calibration_shots(
    folder: Path,
    camera: Camera,
    development: Development,
    board: Board,
    rng: np.random.Generator,
    boards: int = 12,
    progress: Progress | None = None,
) -> dict[str, Any]:
    """Write calibration photographs into folder/board, /response, /noise and /flatfield; returns what they must yield.

    camera : perspective; its pose doesn't matter. Files are of the development's kind; its exposure time and bracket
    don't matter. RAW files are linear and get no response. boards : photographs of the board, at least 3.
    progress : called with the photographs of a kind and a description; iterates over what it returns.

    Returned, per kind, `photos` (paths relative to the folder) and `exposure_s`, with
    board : the board's text, and the camera's `model`, `params`, `width`, `height`;
    response : `exposure` at `values`, relative to white;
    noise : `read_std` and `shot` as in noise.json, electrons, and `altered_by`, what changes a photosite's noise later;
    flatfield : `focal_px` (null: none) and `centre` of the cos^4 law, and `corner`, its value in the first pixel.
    """
    if camera.is_orthographic:
        raise ValueError(
            "an orthographic camera has no lens to calibrate; give the scene a perspective camera"
        )
    if boards < 3:
        raise ValueError(f"boards is {boards}; calibration needs 3 photographs or more, 10 to 20 are good")
    sensor, size = development.sensor, (camera.height, camera.width)
    one = replace(development, bracket=(0.0,))
    track = progress or (lambda items, _: items)

    def shoot(kind: str, scenes: Sequence[tuple[Callable[[], Floats], float]]) -> dict[str, Any]:
        (folder / kind).mkdir(parents=True, exist_ok=True)
        shots: list[WrittenShot] = []
        for index in track(range(len(scenes)), f"Photographing for calibration: {kind}"):
            seen, time = scenes[index]
            shots += write_photograph(folder / kind / f"{index:02d}", seen(), time, one, rng)
        photos = [f"{kind}/{shot.file}" for shot in shots]
        return {"photos": photos, "exposure_s": [shot.exposure_s for shot in shots]}

    poses = board_poses(board, camera, boards, rng)
    truth = {
        "board": {
            **shoot("board", [(_board(camera.posed(pose), board, rng), _ANY_TIME_S) for pose in poses]),
            "board": board.spec,
            "model": camera.model,
            "params": camera.params.tolist(),
            "width": camera.width,
            "height": camera.height,
        }
    }
    if development.file != "dng":
        darkest, brightest = _BRACKET_SIGNALS[0] / _BRACKET_S[-1], _BRACKET_SIGNALS[1] / _BRACKET_S[0]
        scene = _smooth_scene(*size, darkest, brightest, rng)
        values = np.linspace(0, 1, 256)
        truth["response"] = {
            **shoot("response", [(lambda: scene, time) for time in _BRACKET_S]),
            "values": values.tolist(),
            "exposure": signal_of(values, sensor).tolist(),
        }
    smooth = _smooth_scene(*size, _NOISE_SIGNALS[0] / _NOISE_S[-1], _NOISE_SIGNALS[1] / _NOISE_S[-1], rng)
    read_std, shot_noise = true_noise(development)
    altered = [("demosaicing", development.demosaic), ("JPEG", development.file == "jpeg")]
    truth["noise"] = {
        **shoot("noise", [(lambda: smooth, time) for time in _NOISE_S for _ in range(_REPEATS)]),
        "read_std": read_std.tolist(),
        "shot": shot_noise.tolist(),
        "full_well_electrons": sensor.full_well.tolist(),
        "read_noise_electrons": sensor.read_noise.tolist(),
        "altered_by": [name for name, does in altered if does],
    }
    direction = rng.uniform(0, 2 * np.pi)
    # The camera is turned about its axis by a quarter between photographs: the wall's light turns in the picture.
    walls = [(_wall(*size, direction + quarter * np.pi / 2), _ANY_TIME_S) for quarter in range(4)]
    truth["flatfield"] = {
        **shoot("flatfield", walls),
        "focal_px": float(sensor.focal_px) if np.isfinite(sensor.focal_px) else None,
        "centre": list(sensor.centre or (camera.width / 2, camera.height / 2)),
        "corner": float(vignetting(sensor, camera.width, camera.height)[0, 0]),
    }
    return truth


def _board(camera: Camera, board: Board, rng: np.random.Generator) -> Callable[[], Floats]:
    def seen() -> Floats:
        grey = board_radiance(camera, board, rng)
        return np.repeat(grey[..., None] * (_PAPER_SIGNAL / _ANY_TIME_S), 3, axis=2)

    return seen


def _smooth_scene(height: int, width: int, low: float, high: float, rng: np.random.Generator) -> Floats:
    """Radiance (h, w, 3) from `low` to `high`, smooth and random, brightnesses evenly spread in their logarithms.

    Without edges, at which colour-halving JPEG would mix neighbours.
    """
    field = gaussian_filter(rng.normal(size=(height, width)), min(height, width) * _GRAIN, mode="reflect")
    spread = np.clip(norm.cdf(field / field.std()), 0, 1)
    # A little off grey, so that the channels' curves don't rest on the same codes.
    return np.asarray(np.exp(np.log(low) + np.log(high / low) * spread)[..., None] * [1.0, 0.9, 0.8])


def _wall(height: int, width: int, direction: float) -> Callable[[], Floats]:
    def seen() -> Floats:
        unit = half_diagonal(width, height)
        x = (np.arange(width) + 0.5 - width / 2) / unit
        y = (np.arange(height) + 0.5 - height / 2) / unit
        light = 1 + _WALL_GRADIENT * (np.cos(direction) * x[None, :] + np.sin(direction) * y[:, None])
        return np.repeat(light[..., None] * (_WALL_SIGNAL / _ANY_TIME_S), 3, axis=2)

    return seen
