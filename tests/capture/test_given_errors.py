"""How sure a set's poses, lenses and mesh are: what calibrations found, or what the manifest states instead."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from numpy.testing import assert_allclose

from capture.files.documents import file_hash
from capture.photoset import load_photoset

LENS = {"model": "PINHOLE", "params": [100.0, 100, 50, 50], "width": 100, "height": 100}
POSE = [[0.0, -1, 0, 0.1], [1, 0, 0, 0.2], [0, 0, 1, 3], [0, 0, 0, 1]]
OTHER = [[1.0, 0, 0, 0.1], [0, 1, 0, 0.2], [0, 0, 1, 2], [0, 0, 0, 1]]
OF_POSE = np.diag([1e-6, 2e-6, 3e-6, 1e-8, 2e-8, 3e-8])


def write(folder: Path, more: str = "", **camera: Any) -> Path:
    """Two photographs with registered poses, a calibrated camera, and a mesh that was aligned."""
    (folder / "photoset.toml").write_text(
        'format = 1\nname = "set"\ncamera = { file = "camera.json" }\n'
        '[object]\nshape = "mesh"\nmesh = "cat.ply"\n'
        '[[photo]]\nfile = "a.png"\n[[photo]]\nfile = "b.png"\n' + more
    )
    (folder / "cat.ply").write_text("a mesh")
    (folder / "camera.json").write_text(json.dumps(LENS | camera))
    photos = [
        {"file": name, "world_to_camera": pose, "covariance": OF_POSE.tolist()}
        for name, pose in (("a.png", POSE), ("b.png", OTHER))
    ]
    (folder / "poses.json").write_text(
        json.dumps({"photos": photos, "unregistered": [], "scale": {"metric": True}})
    )
    made_from = {
        name: file_hash(folder / file) for name, file in (("mesh", "cat.ply"), ("poses", "poses.json"))
    }
    alignment = {
        "mesh_to_world": POSE,
        "world_scale": 2.0,
        "made_from": made_from,
        "covariance": (1e-6 * np.eye(7)).tolist(),
    }
    (folder / "alignment.json").write_text(json.dumps(alignment))
    return folder


def test_calibrations_say_how_sure_they_are(tmp_path: Path) -> None:
    errors = load_photoset(write(tmp_path, covariance=np.diag([4.0, 4, 1, 1]).tolist())).errors
    assert [error.photos for error in errors.poses] == [("a.png",), ("b.png",)]
    # Positions are twice as large in the mesh's metres.
    assert_allclose(errors.poses[0].covariance, OF_POSE * np.outer([1, 1, 1, 2, 2, 2], [1, 1, 1, 2, 2, 2]))
    assert [error.photos for error in errors.lenses] == [("a.png", "b.png")]
    assert_allclose(np.diag(errors.lenses[0].covariance), [4, 4, 1, 1])
    assert errors.mesh_place is not None
    assert_allclose(errors.mesh_place, 1e-6 * np.eye(7))
    assert errors.named
    assert not errors.stated


def test_a_manifest_s_own_word_stands_before_them(tmp_path: Path) -> None:
    stated = "rotation_deg = 0.1\nposition = 1e-4\nfocal_length = 0.01\nheight = 2e-4\ndirection_deg = 1\n"
    photoset = load_photoset(write(tmp_path, f"[uncertainty]\n{stated}"))
    errors = photoset.errors
    cameras = {photo.label: photo.camera for photo in photoset.photos}
    centre = np.array([0.01, -0.02, 0.03])
    first = errors.poses_about(centre, cameras)[0]
    turn = np.radians(0.1)
    assert_allclose(np.diag(first.covariance)[:3], turn**2)
    # A turn about the object leaves it where the camera sees it: its place in the camera is off by the shift alone.
    pose = cameras["a.png"].world_to_camera
    x, y, z = pose[:3, :3] @ centre
    cross = np.array([[0, -z, y], [z, 0, -x], [-y, x, 0]])
    # The point p = R c + t moves by w x (R c) + s.
    moves = np.hstack([-cross, np.eye(3)])
    assert_allclose(moves @ first.covariance @ moves.T, 1e-8 * np.eye(3), atol=1e-20)
    assert_allclose(errors.lenses[0].covariance[:2, :2], 1.0)
    assert_allclose(errors.lenses[0].covariance[2:], 0.0)
    assert errors.height == 2e-4
    assert photoset.direction_std_deg == 1
    assert errors.stated


def test_what_cannot_be_is_said(tmp_path: Path) -> None:
    with pytest.raises(ValueError, match=r"camera.json: covariance is of 2 numbers, but params are 4"):
        load_photoset(write(tmp_path, covariance=np.eye(2).tolist()))
    with pytest.raises(ValueError, match=r"covariance must have as many rows as columns"):
        load_photoset(write(tmp_path, covariance=[[1.0, 0.0]]))
    with pytest.raises(ValueError, match=r"position.*greater than or equal to 0"):
        load_photoset(write(tmp_path, "[uncertainty]\nposition = -1\n"))
    with pytest.raises(ValueError, match=r"rotation_deg"):
        load_photoset(write(tmp_path, "[uncertainty]\nrotations_deg = 1\n"))
    folder = write(tmp_path, "[uncertainty]\nheight = 1e-4\n")
    manifest = folder / "photoset.toml"
    manifest.write_text(manifest.read_text().replace('shape = "mesh"\nmesh = "cat.ply"', 'shape = "sphere"'))
    with pytest.raises(ValueError, match=r"height is of a mesh's vertices"):
        load_photoset(folder)
