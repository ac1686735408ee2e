"""Poses and alignment that were found stand in where the manifest has none, and only as long as they belong to it."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from numpy.testing import assert_allclose

from capture.files.documents import file_hash
from capture.photoset import load_photoset

HEAD = """
format = 1
name = "found"
camera = { model = "PINHOLE", params = [100.0, 100, 50, 50], width = 100, height = 100 }
"""
MESH = '[object]\nshape = "mesh"\nmesh = "cat.ply"\n'
TURNED = [[0.0, -1, 0, 0.1], [1, 0, 0, 0.2], [0, 0, 1, 3], [0, 0, 0, 1]]
STRAIGHT = np.eye(4).tolist()


def write(folder: Path, text: str, **files: Any) -> Path:
    (folder / "photoset.toml").write_text(HEAD + text)
    (folder / "cat.ply").write_text("a mesh")
    for name, document in files.items():
        (folder / f"{name}.json").write_text(json.dumps(document))
    return folder


def poses(*files: str, **unregistered: str) -> dict[str, Any]:
    return {
        "format": 1,
        "photos": [{"file": file, "world_to_camera": TURNED, "rms_px": 0.3} for file in files],
        "scale": {"metric": True, "from": "board", "relative_std": None},
        "unregistered": [{"file": f"{stem}.png", "reason": reason} for stem, reason in unregistered.items()],
    }


def alignment(folder: Path, scale: float = 1.0, **changed: str) -> dict[str, Any]:
    (folder / "cat.ply").write_text("a mesh")
    made_from = {"mesh": file_hash(folder / "cat.ply")} | changed
    return {"format": 1, "mesh_to_world": TURNED, "world_scale": scale, "made_from": made_from}


def test_photos_without_a_pose_take_the_registered_one(tmp_path):
    text = f'[[photo]]\nfile = "a.png"\n[[photo]]\nfile = "b.png"\nworld_to_camera = {STRAIGHT}\n'
    photoset = load_photoset(write(tmp_path, text, poses=poses("a.png", "b.png")))
    assert_allclose(photoset.photos[0].camera.world_to_camera, TURNED)
    assert_allclose(photoset.photos[1].camera.world_to_camera, STRAIGHT)
    assert [path.name for path in photoset.calibration_files] == ["poses.json"]
    # Named in the manifest, they stand before its own: they are refined ones, and were asked for.
    photoset = load_photoset(write(tmp_path, 'poses = "poses.json"\n' + text))
    assert_allclose(photoset.photos[1].camera.world_to_camera, TURNED)


def test_who_looks_for_poses_sees_only_the_manifests_own(tmp_path):
    text = f'[[photo]]\nfile = "a.png"\n[[photo]]\nfile = "b.png"\nworld_to_camera = {STRAIGHT}\n'
    photoset = load_photoset(write(tmp_path, text, poses=poses("a.png")), find_poses=True)
    assert [photo.posed for photo in photoset.photos] == [False, True]
    assert_allclose(photoset.photos[0].camera.world_to_camera, np.eye(4))
    assert not photoset.calibration_files


def test_a_photo_that_was_not_registered_is_named_with_the_reason(tmp_path):
    text = '[[photo]]\nfile = "a.png"\n[[photo]]\nfile = "b.png"\n'
    found = poses("a.png", b="no features in common with the others")
    with pytest.raises(ValueError, match=r'poses.json: has no pose for photo "b.png": no features in common'):
        load_photoset(write(tmp_path, text, poses=found))
    with pytest.raises(ValueError, match="it was not in the set when the poses were found"):
        load_photoset(write(tmp_path, text, poses=poses("a.png")))
    (tmp_path / "poses.json").unlink()
    with pytest.raises(ValueError, match=r'photo "a.png" has no pose; .*or let `lightfactor register'):
        load_photoset(tmp_path)


def test_poses_that_are_none_say_what_the_file_should_hold(tmp_path):
    text = '[[photo]]\nfile = "a.png"\n'
    with pytest.raises(ValueError, match=r"poses.json: lacks the key 'photos'; a poses.json"):
        load_photoset(write(tmp_path, text, poses={"format": 1}))
    mirrored = poses("a.png")
    mirrored["photos"][0]["world_to_camera"] = np.diag([1.0, 1, -1, 1]).tolist()
    with pytest.raises(ValueError, match="mirrors"):
        load_photoset(write(tmp_path, text, poses=mirrored))


def test_an_alignment_places_the_mesh_and_scales_the_world(tmp_path):
    text = MESH + f'align = "auto"\n[[photo]]\nfile = "a.png"\nworld_to_camera = {TURNED}\n'
    photoset = load_photoset(write(tmp_path, text, alignment=alignment(tmp_path, scale=2.0)))
    assert_allclose(photoset.mesh_to_world, TURNED)
    pose = photoset.photos[0].camera.world_to_camera
    assert_allclose(pose[:3, :3], np.array(TURNED)[:3, :3])
    assert_allclose(pose[:3, 3], [0.2, 0.4, 6])
    # Who looks for the alignment sees the world as it was.
    found = load_photoset(tmp_path, find_alignment=True)
    assert found.mesh_to_world is None
    assert_allclose(found.photos[0].camera.world_to_camera, TURNED)


def test_an_alignment_of_other_files_is_refused(tmp_path):
    text = MESH + '[[photo]]\nfile = "a.png"\n'
    registered = poses("a.png")
    folder = write(tmp_path, text, poses=registered, alignment=alignment(tmp_path))
    with pytest.raises(ValueError, match=r"alignment.json: was made with another poses.json; run"):
        load_photoset(folder)
    hashed = alignment(tmp_path, poses=file_hash(tmp_path / "poses.json"))
    assert_allclose(load_photoset(write(tmp_path, text, alignment=hashed)).mesh_to_world, TURNED)
    (tmp_path / "cat.ply").write_text("another mesh")
    with pytest.raises(ValueError, match=r"was made with another cat.ply; run `lightfactor align`"):
        load_photoset(tmp_path)


def test_a_mesh_lies_where_the_manifest_says(tmp_path):
    photo = f'[[photo]]\nfile = "a.png"\nworld_to_camera = {STRAIGHT}\n'
    assert_allclose(load_photoset(write(tmp_path, MESH + photo)).mesh_to_world, np.eye(4))
    given = MESH + f"mesh_to_world = {TURNED}\n" + photo
    assert_allclose(load_photoset(write(tmp_path, given)).mesh_to_world, TURNED)
    with pytest.raises(ValueError, match=r"align = 'auto', but the mesh has not been aligned yet: run"):
        load_photoset(write(tmp_path, MESH + 'align = "auto"\n' + photo))
    scaled = MESH + f"mesh_to_world = {np.diag([2.0, 2, 2, 1]).tolist()}\n" + photo
    with pytest.raises(ValueError, match=r"\[object\]: the 3x3 part of mesh_to_world is not a rotation"):
        load_photoset(write(tmp_path, scaled))
