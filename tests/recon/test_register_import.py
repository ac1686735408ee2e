"""Poses of COLMAP models and transforms.json: conventions turned, names matched, faults told."""

from __future__ import annotations

import json
import shutil
from collections.abc import Callable, Sequence
from pathlib import Path

import cv2
import numpy as np
import pycolmap
import pytest
from numpy.typing import NDArray

from capture.arc.gantry import look_at
from capture.camera import Camera
from capture.photoset import load_photoset
from recon.poses.register.importing import register_by_colmap, register_by_transforms
from recon.poses.register.names import match_names
from recon.sphere.sphere import Sphere

Floats = NDArray[np.float64]

CAMERA = Camera("PINHOLE", np.array([150.0, 152, 81, 59]), 160, 120, np.eye(4))
NAMES = tuple(f"cam{number}.png" for number in range(6))
# Round an object that doesn't lie at the origin, at heights that differ.
TARGET = np.array([0.3, -0.2, 0.1])
POSES = np.array(
    [
        look_at(
            TARGET + np.array([0.5 * np.cos(a), 0.5 * np.sin(a), 0.2 + 0.1 * np.cos(2 * a)]),
            TARGET,
            [0, 0, 1],
        )
        for a in np.linspace(0, 4.5, 6)
    ]
)
FLIP = np.diag([1.0, -1, -1, 1])


@pytest.fixture(scope="module")
def photoset_original(
    tmp_path_factory: pytest.TempPathFactory, draw: Callable[..., NDArray[np.float32]]
) -> Path:
    """A set of six photographs without poses, whose masks show two balls, told apart by their size."""
    folder = tmp_path_factory.mktemp("balls")
    big = Sphere(TARGET, 0.06, np.zeros((4, 4)))
    small = Sphere(TARGET + np.array([0.05, 0.03, 0.05]), 0.03, np.zeros((4, 4)))
    lines = ['format = 1\nname = "balls"\n[camera]\nmodel = "PINHOLE"']
    lines.append(f"params = {CAMERA.params.tolist()}\nwidth = {CAMERA.width}\nheight = {CAMERA.height}")
    for name, pose in zip(NAMES, POSES, strict=True):
        mask = np.maximum(draw(big, CAMERA.posed(pose), 2), draw(small, CAMERA.posed(pose), 2))
        cv2.imwrite(str(folder / f"mask-{name}"), np.round(255 * mask).astype(np.uint8))
        lines.append(f'[[photo]]\nfile = "{name}"\nmask = "mask-{name}"')
    (folder / "photoset.toml").write_text("\n".join(lines), encoding="utf-8")
    return folder


@pytest.fixture
def photoset(photoset_original: Path, tmp_path: Path) -> Path:
    """A copy that a test may change."""
    return Path(shutil.copytree(photoset_original, tmp_path, dirs_exist_ok=True))


def _transforms(path: Path, matrices: Sequence[Floats], names: Sequence[str] = NAMES, **keys: object) -> Path:
    frames = [
        {"file_path": name, "transform_matrix": matrix.tolist()}
        for name, matrix in zip(names, matrices, strict=True)
    ]
    path.write_text(json.dumps({**keys, "frames": frames}), encoding="utf-8")
    return path


def _opengl(pose: Floats) -> Floats:
    """NeRF's transform_matrix of a pose: its columns are the camera's right, up and backward, and its place."""
    rotation = pose[:3, :3]
    matrix = np.eye(4)
    matrix[:3, 0], matrix[:3, 1], matrix[:3, 2] = rotation[0], -rotation[1], -rotation[2]
    matrix[:3, 3] = -rotation.T @ pose[:3, 3]
    return matrix


def _model(
    names: Sequence[str] = NAMES, params: Sequence[float] | None = None, points: bool = True
) -> pycolmap.Reconstruction:
    """A COLMAP model of the set with points seen by all photographs, exactly."""
    rng = np.random.default_rng(0)
    model = pycolmap.Reconstruction()
    camera = pycolmap.Camera(model="PINHOLE", width=160, height=120, params=params or CAMERA.params.tolist())
    camera.camera_id = 7
    model.add_camera_with_trivial_rig(camera)
    cloud = TARGET + rng.normal(0, 0.03, (40, 3)) if points else np.zeros((0, 3))
    for number, (name, pose) in enumerate(zip(names, POSES, strict=True)):
        seen = CAMERA.posed(pose).project(cloud) + rng.normal(0, 0.1, (len(cloud), 2))
        image = pycolmap.Image(name=name, camera_id=7, keypoints=seen)
        image.image_id = 3 * number + 2
        model.add_image_with_trivial_frame(image, pycolmap.Rigid3d(pose[:3]))
    for index, point in enumerate(cloud):
        track = pycolmap.Track()
        for number in range(len(names)):
            track.add_element(3 * number + 2, index)
        model.add_point3D(point, track, np.array([200, 100, index], np.uint8))
    return model


def _written(model: pycolmap.Reconstruction, folder: Path, text: bool = False) -> Path:
    folder.mkdir()
    (model.write_text if text else model.write_binary)(folder)
    return folder


@pytest.mark.parametrize("ending", ["", ".jpg", ".png"])
def test_transforms_keep_their_world(photoset: Path, ending: str) -> None:
    names = [f"./images/cam{number}{ending}" for number in range(6)]
    path = _transforms(photoset / "transforms.json", [_opengl(pose) for pose in POSES], names, fl_x=150.0)
    found = register_by_transforms(load_photoset(photoset, find_poses=True), path)
    np.testing.assert_allclose(found.poses, POSES, atol=1e-12)
    assert found.names == NAMES
    assert (found.method, found.scale_from, found.covariance) == ("transforms", "free", None)
    assert not found.warnings


def test_what_nerfstudio_applied_is_undone(photoset: Path) -> None:
    # nerfstudio stores applied_transform @ pose, then its scale; 3x4, as it writes it.
    applied = np.array([[0.0, 1, 0, 0.2], [1, 0, 0, -0.1], [0, 0, -1, 0.3], [0, 0, 0, 1]])
    matrices = [applied @ _opengl(pose) for pose in POSES]
    for matrix in matrices:
        matrix[:3, 3] *= 0.25
    path = _transforms(
        photoset / "t.json", matrices, applied_transform=applied[:3].tolist(), applied_scale=0.25
    )
    found = register_by_transforms(load_photoset(photoset, find_poses=True), path)
    np.testing.assert_allclose(found.poses, POSES, atol=1e-12)


def test_transforms_with_opencv_axes_are_recognised(photoset: Path) -> None:
    path = _transforms(photoset / "t.json", [np.linalg.inv(pose) for pose in POSES])
    with pytest.raises(ValueError, match=r"poses look like a transform_matrix with OpenCV's axes"):
        register_by_transforms(load_photoset(photoset, find_poses=True), path)


def test_poses_that_were_not_inverted_are_recognised_by_the_masks(photoset: Path) -> None:
    matrices = [np.linalg.inv(_opengl(pose)) for pose in POSES]
    path = _transforms(photoset / "t.json", matrices)
    with pytest.raises(ValueError, match=r"poses look like world to camera with OpenGL's axes"):
        register_by_transforms(load_photoset(photoset, find_poses=True), path)


def test_poses_of_other_photos_do_not_fit_the_masks(photoset: Path) -> None:
    path = _transforms(photoset / "t.json", [_opengl(POSES[k]) for k in (3, 1, 5, 0, 2, 4)])
    # The two balls look much the same from all sides: that they fill 86% of the masks raises doubt, no more.
    (warning,) = register_by_transforms(load_photoset(photoset, find_poses=True), path).warnings
    assert (
        "doesn't project into its masks: a body that all photos show within their masks fills only 8"
        in warning
    )
    assert warning.endswith("check that the file belongs to this set, and the masks")


def test_poses_of_another_object_are_refused(photoset: Path) -> None:
    # Half of the photographs belong to a world that was moved.
    matrices = [_opengl(pose) for pose in POSES]
    for matrix in matrices[::2]:
        matrix[:3, 3] += [0, 0, 0.07]
    path = _transforms(photoset / "t.json", matrices)
    with pytest.raises(ValueError, match=r"doesn't project into its masks: .*belongs to this set"):
        register_by_transforms(load_photoset(photoset, find_poses=True), path)


def test_without_masks_cameras_must_look_at_what_they_surround(photoset: Path) -> None:
    manifest = photoset / "photoset.toml"
    lines = manifest.read_text(encoding="utf-8").splitlines()
    manifest.write_text("\n".join(line for line in lines if not line.startswith("mask")), encoding="utf-8")
    photos = load_photoset(photoset, find_poses=True)
    right = _transforms(photoset / "t.json", [_opengl(pose) for pose in POSES])
    np.testing.assert_allclose(register_by_transforms(photos, right).poses, POSES, atol=1e-12)
    wrong = _transforms(photoset / "t.json", [np.linalg.inv(pose) for pose in POSES])
    with pytest.raises(ValueError, match=r"cameras look away .* a transform_matrix with OpenCV's axes"):
        register_by_transforms(photos, wrong)


def test_a_colmap_model_of_inverted_poses_is_recognised(photoset: Path) -> None:
    model = pycolmap.Reconstruction()
    model.add_camera_with_trivial_rig(_model().cameras[7])
    for number, (name, pose) in enumerate(zip(NAMES, POSES, strict=True), start=1):
        image = pycolmap.Image(name=name, camera_id=7)
        image.image_id = number
        model.add_image_with_trivial_frame(image, pycolmap.Rigid3d(np.linalg.inv(pose)[:3]))
    with pytest.raises(ValueError, match=r"the poses look like camera_to_world \(OpenCV axes\): invert it"):
        register_by_colmap(load_photoset(photoset, find_poses=True), _written(model, photoset / "sparse"))


def test_another_camera_is_told(photoset: Path) -> None:
    matrices = [_opengl(pose) for pose in POSES]
    # NeRF's own way to say a focal length; 80 / tan(0.5) = 146.4 px instead of some 151.
    path = _transforms(photoset / "t.json", matrices, camera_angle_x=1.0, w=160, h=120)
    (warning,) = register_by_transforms(load_photoset(photoset, find_poses=True), path).warnings
    # Some 150 px at a corner 35 degrees off axis, where 3% of the focal length is 3 px; less towards the middle.
    assert "another camera than the manifest's (2." in warning
    assert 'model = "PINHOLE", params = [146.4' in warning
    # A picture of twice the size, with the same camera, is none.
    path = _transforms(photoset / "t.json", matrices, fl_x=300, fl_y=304, cx=162, cy=118, w=320, h=240)
    assert not register_by_transforms(load_photoset(photoset, find_poses=True), path).warnings


@pytest.mark.parametrize("text", [False, True])
def test_colmap_models_keep_their_world(photoset: Path, text: bool) -> None:
    folder = _written(_model(), photoset / "sparse", text)
    found = register_by_colmap(load_photoset(photoset, find_poses=True), folder)
    np.testing.assert_allclose(found.poses, POSES, atol=1e-9)  # text holds 17 digits
    assert found.names == NAMES
    assert len(found.points) == 40
    assert found.observations is not None
    assert found.rms_px is not None
    np.testing.assert_array_equal(found.observations, 40)
    np.testing.assert_allclose(found.rms_px, 0.141, rtol=0.35)  # 0.1 px along either axis, 80 numbers a photo
    assert found.covariance is not None


def test_colmap_models_without_points_or_with_other_cameras(photoset: Path) -> None:
    photos = load_photoset(photoset, find_poses=True)
    bare = register_by_colmap(photos, _written(_model(points=False), photoset / "bare"))
    np.testing.assert_allclose(bare.poses, POSES, atol=1e-12)
    assert bare.covariance is None
    other = register_by_colmap(photos, _written(_model(params=[155.0, 157, 80, 60]), photoset / "other"))
    assert "params = [155, 157, 80, 60]" in other.warnings[0]
    assert other.covariance is None  # its residuals would be those of another camera
    assert len(other.points) == 40


def test_missing_photos_and_typos_are_told(photoset: Path) -> None:
    names = ["cam0.png", "cam1.png", "cam2.png", "cam3.png", "cam4.png", "camm5.png"]
    folder = _written(_model(names), photoset / "sparse")
    found = register_by_colmap(load_photoset(photoset, find_poses=True), folder)
    assert found.names == NAMES[:5]
    assert found.unregistered == {"cam5.png": "not in sparse; is it 'camm5.png' there?"}
    assert "1 of 6 photos have no pose: cam5.png" in found.warnings[0]


def test_names_match_where_that_leaves_no_doubt() -> None:
    photos = ["left/a.exr", "left/b.exr", "right/a.exr"]
    assert match_names(photos, ["right/a.exr", "left/a.exr"], "m") == [1, None, 0]
    assert match_names(["A.PNG", "b.002"], ["x/b.002", "x/a"], "m") == [1, 0]
    with pytest.raises(
        ValueError, match=r"cannot decide which of a\.png is which .* left/a\.exr, right/a\.exr"
    ):
        match_names(photos, ["a.png", "b.png"], "m")
    with pytest.raises(
        ValueError, match=r"none of its 1 photos .* names 'z\.png', the manifest 'left/a\.exr'"
    ):
        match_names(photos, ["z.png"], "m")


@pytest.mark.parametrize(
    ("content", "says"),
    [
        ("{", "is not valid JSON"),
        ("[]", "lacks frames"),
        ('{"frames": []}', "lacks frames"),
        ('{"frames": [{"transform_matrix": []}]}', "frame 1: lacks file_path"),
        ('{"frames": [{"file_path": "cam0.png"}]}', r"frame 1 \(cam0.png\): transform_matrix"),
        ('{"frames": [{"file_path": "cam0.png", "transform_matrix": [[1, 2], [3]]}]}', "is not a matrix"),
        (
            '{"frames": [{"file_path": "cam0.png", "transform_matrix": [[2,0,0,0],[0,2,0,0],[0,0,2,0],[0,0,0,1]]}]}',
            "transform_matrix is not a rotation",
        ),
        (
            '{"frames": [{"file_path": "cam0.png", "transform_matrix": [[1,0,0,0],[0,1,0,0],[0,0,-1,0],[0,0,0,1]]}]}',
            "transform_matrix mirrors",
        ),
        ('{"applied_scale": 0, "frames": [1]}', "applied_scale is 0"),
    ],
)
def test_broken_transforms_are_named(content: str, says: str, photoset: Path) -> None:
    path = photoset / "transforms.json"
    path.write_text(content, encoding="utf-8")
    with pytest.raises(ValueError, match=says) as caught:
        register_by_transforms(load_photoset(photoset, find_poses=True), path)
    assert str(path) in str(caught.value)


def test_folders_that_hold_no_model_are_named(photoset: Path) -> None:
    photos = load_photoset(photoset, find_poses=True)
    (photoset / "sparse").mkdir()
    _written(_model(), photoset / "sparse" / "0")
    with pytest.raises(ValueError, match=r"sparse: holds no COLMAP model .*sparse/0 does"):
        register_by_colmap(photos, photoset / "sparse")
    cut = photoset / "sparse" / "0" / "images.bin"
    cut.write_bytes(cut.read_bytes()[:100])
    with pytest.raises(ValueError, match=r"sparse/0: is not a COLMAP model that can be read"):
        register_by_colmap(photos, photoset / "sparse" / "0")
