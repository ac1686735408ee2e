"""Poses and points of a COLMAP model: a folder with cameras, images and points3D, binary or text."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np

from capture.camera import PERSPECTIVE_MODELS, Camera
from recon.poses.register.features import quiet_colmap
from recon.poses.register.imported import ImportedPose

_NAMES = ("cameras", "images", "points3D")


def read_colmap(folder: Path) -> tuple[Any, list[int], list[ImportedPose]]:
    """A COLMAP model, its registered images' numbers, and their poses.

    ValueError where the folder holds no model, or one that can't be read.
    """
    import pycolmap

    if not any(_has_model(folder, ending) for ending in (".bin", ".txt")):
        inside = sorted(
            path.parent for path in folder.glob("**/cameras.*") if path.suffix in (".bin", ".txt")
        )
        hint = f"; {inside[0]} does" if inside else ""
        raise ValueError(
            f"{folder}: holds no COLMAP model (cameras, images and points3D, .bin or .txt){hint}"
            if folder.is_dir()
            else f"{folder}: is not a folder; give the folder of a COLMAP model (cameras, images, points3D)"
        )
    with quiet_colmap():
        try:
            model = pycolmap.Reconstruction(folder)
        # Whatever COLMAP stumbles over, a cut-off file among it.
        except (RuntimeError, ValueError, IndexError, MemoryError) as error:
            raise ValueError(f"{folder}: is not a COLMAP model that can be read ({error})") from error
    numbers = sorted(number for number, image in model.images.items() if image.has_pose)
    if not numbers:
        raise ValueError(f"{folder}: the COLMAP model has no registered images")
    poses = []
    for number in numbers:
        image = model.images[number]
        pose = np.eye(4)
        pose[:3] = image.cam_from_world().matrix()
        poses.append(ImportedPose(image.name, pose, _camera(image.camera)))
    return model, numbers, poses


def _has_model(folder: Path, ending: str) -> bool:
    return all((folder / f"{name}{ending}").is_file() for name in _NAMES)


def _camera(camera: Any) -> Camera | None:
    if camera.model_name not in PERSPECTIVE_MODELS:
        return None
    return Camera(camera.model_name, np.array(camera.params), camera.width, camera.height, np.eye(4))
