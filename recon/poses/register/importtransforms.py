"""Poses of a transforms.json, as instant-ngp, nerfstudio, Blender scripts and NeRF's data sets have it.

There transform_matrix is camera to world with OpenGL's axes: x right, y up, z backward.
"""

from __future__ import annotations

import json
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from capture.camera import Camera, rigid_transform
from recon.poses.register.imported import ImportedPose

Floats = NDArray[np.float64]

_FLIP = np.diag([1.0, -1.0, -1.0, 1.0])
_WHAT = "a transforms.json holds frames, each with file_path and transform_matrix (4x4)"
_DISTORTION = ("k1", "k2", "p1", "p2")


def read_transforms(path: Path) -> list[ImportedPose]:
    """The poses of a transforms.json, with OpenCV's axes.

    What nerfstudio notes as applied_transform and applied_scale is undone, so that the world is the one in which the
    poses were found. ValueError names the frame that is wrong.
    """
    data = _read(path)
    undo = _undone(path, data)
    size = data.get("applied_scale", 1.0)
    if isinstance(size, bool) or not isinstance(size, int | float) or not 0 < size < np.inf:
        raise ValueError(f"{path}: applied_scale is {size!r}; it must be a number above 0")
    poses = []
    for number, frame in enumerate(data["frames"], start=1):
        where = f"{path}: frame {number}"
        if not isinstance(frame, dict) or not isinstance(frame.get("file_path"), str):
            raise ValueError(f"{where}: lacks file_path; {_WHAT}")
        where = f"{where} ({frame['file_path']})"
        camera_to_world = _matrix(frame.get("transform_matrix"), where)
        try:
            camera_to_world = rigid_transform(camera_to_world, "transform_matrix")
        except ValueError as error:
            raise ValueError(f"{where}: {error}") from error
        camera_to_world[:3, 3] /= size
        world_to_camera: Floats = np.asarray(np.linalg.inv(undo @ camera_to_world @ _FLIP), float)
        poses.append(ImportedPose(frame["file_path"], world_to_camera, _camera({**data, **frame}, where)))
    return poses


def transforms_conventions() -> Mapping[str, Callable[[Floats], Floats]]:
    """How poses of a transforms.json must be turned, as `read_transforms` read them, if it isn't as it should be.

    Each function takes and returns world_to_camera (4, 4). Its name says what transform_matrix looks like.
    """
    return {
        "a transform_matrix with OpenCV's axes (y down, z forward): flip its y and z columns": lambda pose: (
            _FLIP @ pose
        ),
        "world to camera with OpenCV's axes in transform_matrix: invert it, and flip its y and z columns": (
            lambda pose: np.asarray(np.linalg.inv(_FLIP @ pose), float)
        ),
        "world to camera with OpenGL's axes in transform_matrix: invert it": (
            lambda pose: np.asarray(_FLIP @ np.linalg.inv(_FLIP @ pose), float)
        ),
    }


def _read(path: Path) -> dict[str, Any]:
    try:
        data = json.loads(path.read_text(encoding="utf-8"))
    except OSError as error:
        raise ValueError(f"{path}: cannot be read ({error.strerror or error})") from error
    except (json.JSONDecodeError, UnicodeDecodeError) as error:
        raise ValueError(f"{path}: is not valid JSON: {error}; {_WHAT}") from error
    if not isinstance(data, dict) or not isinstance(data.get("frames"), list) or not data["frames"]:
        raise ValueError(f"{path}: lacks frames; {_WHAT}")
    return data


def _matrix(rows: Any, where: str) -> Floats:
    try:
        matrix = np.array(rows, float)
    except (TypeError, ValueError) as error:
        raise ValueError(f"{where}: transform_matrix is not a matrix of numbers; {_WHAT}") from error
    if matrix.shape == (3, 4):
        matrix = np.vstack([matrix, [0, 0, 0, 1]])
    if matrix.shape != (4, 4):
        raise ValueError(f"{where}: transform_matrix has shape {matrix.shape}; {_WHAT}")
    return matrix


def _undone(path: Path, data: Mapping[str, Any]) -> Floats:
    if "applied_transform" not in data:
        return np.eye(4)
    matrix = _matrix(data["applied_transform"], f"{path}: applied_transform")
    try:
        return np.asarray(np.linalg.inv(rigid_transform(matrix, "applied_transform")), float)
    except ValueError as error:
        raise ValueError(f"{path}: {error}") from error


def _camera(keys: Mapping[str, Any], where: str) -> Camera | None:
    """The camera that a frame was taken with, where enough is given."""
    try:
        width, height = int(keys.get("w", 0)), int(keys.get("h", 0))
        fx = float(keys["fl_x"]) if "fl_x" in keys else None
        if fx is None and "camera_angle_x" in keys and width:
            fx = width / (2 * np.tan(float(keys["camera_angle_x"]) / 2))
        if fx is None or not width or not height:
            return None
        fy = float(keys.get("fl_y", fx))
        centre = [float(keys.get("cx", width / 2)), float(keys.get("cy", height / 2))]
        bent = [float(keys.get(key, 0.0)) for key in _DISTORTION]
        # Fisheye lenses and higher terms are none of our models: then nothing is said of the camera.
        if "fisheye" in str(keys.get("camera_model", "")).lower() or keys.get("is_fisheye"):
            return None
        model, params = ("OPENCV", [fx, fy, *centre, *bent]) if any(bent) else ("PINHOLE", [fx, fy, *centre])
        return Camera(model, np.array(params), width, height, np.eye(4))
    except (TypeError, ValueError) as error:
        raise ValueError(f"{where}: its camera cannot be read: {error}") from error
