"""Where a calibrated camera stood when it saw a board."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from capture.boards.board import Detection
from capture.camera import Camera
from capture.lens.distortion import LensModel
from capture.lens.lensfit import pose_jacobian, rms, solve_pose, view_of

Floats = NDArray[np.float64]

_MIN_CORNERS = 6


def board_pose(detection: Detection, camera: Camera) -> tuple[Floats, Floats, float]:
    """The camera's pose in the board's frame.

    camera : perspective; its own pose doesn't matter.
    Returns world_to_camera (4, 4), the world being the board's frame; the covariance (6, 6) of a small turn about the
    camera's axes (radians, applied after the pose) and of a shift along them (metres), from the corners' scatter; and
    the RMS in pixels. On a chessboard of even or of odd counts the pose may be half a turn off
    (`capture.boards.board`).
    ValueError where the pose is undetermined: too few corners, or part of a chessboard that could be any part.
    """
    if camera.is_orthographic:
        raise ValueError("the pose of a board needs a perspective camera, not an ORTHOGRAPHIC one")
    if not detection.located:
        raise ValueError(
            "only a part of the chessboard was seen, and it could be any part: show the whole board, or use a charuco"
            " board, whose markers show it"
        )
    if len(detection.cells) < _MIN_CORNERS:
        raise ValueError(
            f"{len(detection.cells)} corners are too few for a pose; {_MIN_CORNERS} are the least"
        )
    if detection.size != (camera.width, camera.height):
        raise ValueError(
            f"the photo has {detection.size[0]}x{detection.size[1]} pixels, its camera"
            f" {camera.width}x{camera.height}; give the camera that belongs to the photo"
        )
    lens = LensModel(camera.model, camera.model, ())
    view = view_of(detection)
    pose = solve_pose(view, lens, camera.params)
    predicted, of_pose, _ = pose_jacobian(view, lens, camera.params, pose)
    residual = view.points - predicted
    # Blur and light act on all corners alike: the chance that they average out is not taken beyond what a board shows.
    noise = float((residual**2).sum()) / max(2 * len(residual) - 6, 1)
    covariance = noise * np.linalg.inv(of_pose.T @ of_pose)
    return pose, np.asarray(covariance, float), rms(residual)
