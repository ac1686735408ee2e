"""Faults are as large as asked, and touch nothing else."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal
from scipy.ndimage import label
from scipy.spatial.transform import Rotation

from capture.camera import Camera
from recon.mesh.trianglemesh import TriangleMesh, is_watertight, volume
from synthetic.faults import misaligned, perturbed_mesh, perturbed_pose, with_background, with_outliers
from synthetic.sensing.room import room_background

CENTRE = np.array([0.3, -0.2, 0.5])


def pose_towards(centre: np.ndarray, eye: np.ndarray) -> np.ndarray:
    ahead = (centre - eye) / np.linalg.norm(centre - eye)
    right = np.cross(ahead, [0, 0, 1])
    right /= np.linalg.norm(right)
    pose = np.eye(4)
    pose[:3, :3] = [right, np.cross(ahead, right), ahead]
    pose[:3, 3] = -pose[:3, :3] @ eye
    return pose


POSE = pose_towards(CENTRE, np.array([1.5, -1.0, 0.9]))


def unit_sphere(rows: int = 60) -> TriangleMesh:
    """A sphere of radius 1 about the origin, with a doubled seam, and triangles at its poles."""
    theta, phi = np.linspace(0, np.pi, rows + 1), np.linspace(0, 2 * np.pi, 2 * rows + 1)
    theta, phi = (grid.ravel() for grid in np.meshgrid(theta, phi, indexing="ij"))
    normals = np.column_stack([np.sin(theta) * np.cos(phi), np.sin(theta) * np.sin(phi), np.cos(theta)])
    normals = np.round(normals, 15) + 0.0  # one place on both sides of the seam
    normals /= np.linalg.norm(normals, axis=1, keepdims=True)
    corner = (np.arange(rows)[:, None] * (2 * rows + 1) + np.arange(2 * rows)).ravel()
    below = corner + 2 * rows + 1
    upper = np.column_stack([corner, below, below + 1])
    lower = np.column_stack([corner, below + 1, corner + 1])
    faces = np.concatenate([upper[: -2 * rows], lower[2 * rows :]])
    used, faces = np.unique(faces, return_inverse=True)
    uv = np.column_stack([phi / (2 * np.pi), 1 - theta / np.pi])
    return TriangleMesh(normals[used], faces.reshape(-1, 3), normals[used], uv[used])


def test_a_turned_camera_keeps_the_object_in_its_place(rng):
    turned = perturbed_pose(POSE, CENTRE, 2.0, 0.0, rng)
    place = np.append(CENTRE, 1)
    assert_allclose(turned @ place, POSE @ place, atol=1e-14)
    assert np.abs(turned - POSE).max() > 0.01
    assert_allclose(perturbed_pose(POSE, CENTRE, 0.0, 0.0, rng), POSE, atol=1e-15)


def test_poses_scatter_as_asked(rng):
    turns, shifts = [], []
    for _ in range(3000):
        moved = np.linalg.inv(POSE) @ perturbed_pose(POSE, CENTRE, 0.5, 0.003, rng)
        turns.append(Rotation.from_matrix(moved[:3, :3]).as_rotvec(degrees=True))
        shifts.append((moved @ np.append(CENTRE, 1))[:3] - CENTRE)
    # 3000 draws: 4 relative standard errors of a standard deviation are 5.2%.
    assert_allclose(np.std(turns, axis=0), 0.5, rtol=0.052)
    assert_allclose(np.std(shifts, axis=0), 0.003, rtol=0.052)
    assert_allclose(np.mean(turns, axis=0), 0, atol=4 * 0.5 / np.sqrt(3000))


def test_misalignment_is_just_as_large_as_asked(rng):
    start = np.eye(4)
    start[:3, :3] = 0.01 * Rotation.from_rotvec([0.3, 0.2, -0.5]).as_matrix()
    start[:3, 3] = [0.1, 0.2, 0.3]
    change = misaligned(start, CENTRE, 3.0, 0.02, 1.04, rng) @ np.linalg.inv(start)
    linear = change[:3, :3]
    assert np.cbrt(np.linalg.det(linear)) == pytest.approx(1.04, rel=1e-12)
    assert Rotation.from_matrix(linear / 1.04).magnitude() == pytest.approx(np.radians(3), rel=1e-9)
    shift = (change @ np.append(CENTRE, 1))[:3] - CENTRE
    assert np.linalg.norm(shift) == pytest.approx(0.02, rel=1e-9)


def test_mesh_noise_has_the_size_and_the_reach_that_are_asked(rng):
    mesh = unit_sphere(12)
    std, reach = 0.002, 0.3
    draws = np.array([(perturbed_mesh(mesh, std, reach, rng).vertices - mesh.vertices) for _ in range(300)])
    offset = np.einsum("dvi,vi->dv", draws, mesh.normals)
    assert_allclose(draws, offset[..., None] * mesh.normals, atol=1e-15)  # along the normals
    size = np.sqrt(np.mean(offset**2, axis=0))
    # 300 draws: 4 relative standard errors are 16%; 320 vertices share some hundred patches.
    assert_allclose(size, std, rtol=0.2)
    assert size.mean() == pytest.approx(std, rel=0.03)
    # Correlation with the north pole: exp(-distance^2 / (2 reach^2)), 300 draws good to 0.06 each.
    distance = np.linalg.norm(mesh.vertices - mesh.vertices[0], axis=1)
    found = offset[:, 0] @ offset / (300 * std**2)
    assert_allclose(found, np.exp(-((distance / reach) ** 2) / 2), atol=0.27)  # 4.5 of these
    for low, high in ((0.2, 0.4), (0.5, 0.7), (1.0, 1.9)):
        ring = (distance > low) & (distance < high)
        expected = np.exp(-((distance[ring] / reach) ** 2) / 2).mean()
        assert found[ring].mean() == pytest.approx(expected, abs=0.12)  # rings are means of few patches


def test_a_noisy_mesh_stays_closed_with_normals_of_its_own(rng):
    mesh = unit_sphere()
    noisy = perturbed_mesh(mesh, 0.01, 0.3, rng)
    assert is_watertight(noisy)
    assert volume(noisy) == pytest.approx(
        4 / 3 * np.pi, rel=0.03
    )  # of a displacement of 1%, part of it a bias
    # Slopes of a Gaussian process: std / reach in each of two directions.
    tilt = np.degrees(np.arccos(np.clip((noisy.normals * mesh.normals).sum(axis=1), -1, 1)))
    expected = np.degrees(np.sqrt(2) * 0.01 / 0.3)
    assert np.sqrt(np.mean(tilt**2)) == pytest.approx(expected, rel=0.25)  # some 50 patches
    assert_array_equal(noisy.uv, mesh.uv)


def test_a_background_shows_where_the_object_does_not(rng):
    coverage = rng.uniform(size=(4, 5))
    radiance = coverage[..., None] * np.array([0.5, 0.4, 0.3])
    photo = with_background(radiance, coverage, [1.0, 2.0, 3.0])
    expected = coverage[..., None] * [0.5, 0.4, 0.3] + (1 - coverage)[..., None] * [1.0, 2.0, 3.0]
    assert_allclose(photo, expected, rtol=1e-14)
    assert_allclose(with_background(radiance, coverage, photo - radiance).shape, (4, 5, 3))
    with pytest.raises(ValueError, match=r"the background is \(2,\)"):
        with_background(radiance, coverage, [1.0, 2.0])
    with pytest.raises(ValueError, match="with a minimum of -1"):
        with_background(radiance, coverage, [1.0, 2.0, -1.0])


def test_a_room_is_the_same_from_wherever_it_is_seen():
    params = [160.0, 80.0, 60.0]
    side = 4.0
    poses = [POSE, pose_towards(CENTRE, np.array([1.2, -1.3, 0.4]))]
    cameras = [Camera("SIMPLE_PINHOLE", params, 160, 120, pose) for pose in poses]
    views = [room_background(camera, CENTRE, side, 2.0, 5) for camera in cameras]
    # Where the middles of one view's pixels lie on the walls, by Newton's own route: march to the box, then reproject.
    grid = np.stack(np.meshgrid(np.arange(160) + 0.5, np.arange(120) + 0.5), axis=-1).reshape(-1, 2)
    origins, directions = cameras[0].rays(grid)
    low, high = CENTRE - side / 2 - origins, CENTRE + side / 2 - origins
    walls = origins + directions * np.maximum(low / directions, high / directions).min(axis=1)[:, None]
    assert_allclose(np.abs(walls - CENTRE).max(axis=1), side / 2, rtol=1e-12)
    places = np.floor(cameras[1].project(walls))
    seen = np.isfinite(places).all(axis=1) & (places >= 0).all(axis=1) & (places < [160, 120]).all(axis=1)
    column, row = places[seen].astype(int).T
    assert seen.mean() > 0.3
    same = np.isclose(views[0].reshape(-1, 3)[seen], views[1][row, column], rtol=1e-9).all(axis=1)
    assert same.mean() > 0.8  # all but pixels on edges
    assert views[0].std() > 0.1 * views[0].mean()
    assert views[0].max() <= 2 * 2.0
    assert not np.array_equal(room_background(cameras[0], CENTRE, side, 2.0, 6), views[0])
    with pytest.raises(
        ValueError, match=r"the camera stands 1\.2 m off the room's centre, but the walls are 1 m"
    ):
        room_background(cameras[0], CENTRE, 2.0, 2.0, 5)


@pytest.mark.parametrize("share", [0.01, 0.1])
def test_outliers_are_as_many_as_asked_and_nothing_else_changes(rng, share):
    y, x = np.mgrid[:200, :240]
    coverage = np.clip(80.5 - np.hypot(x - 120, y - 100), 0, 1)
    photo = coverage[..., None] * np.array([0.5, 0.4, 0.3])
    given = photo.copy()
    result, touched = with_outliers(photo, coverage, share, rng)
    assert_array_equal(photo, given)
    assert touched.sum() == round(share * (coverage > 0).sum())
    assert not touched[coverage == 0].any()
    assert_array_equal(result[~touched], photo[~touched])
    assert (result[touched] != photo[touched]).all()
    # Specks and lone pixels, dark and bright.
    numbers, count = label(touched, np.ones((3, 3)))
    sizes = np.bincount(numbers.ravel())[1:]
    assert (sizes == 1).sum() > 0.2 * touched.sum()
    assert sizes.max() >= 8
    assert count > 10
    ratio = np.median(result[touched], axis=1) / 0.4
    assert 0.2 < (ratio < 1).mean() < 0.8
    assert ratio.max() > 10
    assert ratio.min() < 0.1


def test_amounts_that_cannot_be_are_named(rng):
    for given, message in (
        ((-1.0, 0.0), r"rotation_deg is -1\.0; it must be degrees >= 0"),
        ((0.0, np.nan), "translation_m is nan; it must be metres >= 0"),
    ):
        with pytest.raises(ValueError, match=message):
            perturbed_pose(POSE, CENTRE, *given, rng)
        with pytest.raises(ValueError, match=message):
            misaligned(POSE, CENTRE, *given, 1.0, rng)
    with pytest.raises(ValueError, match=r"scale is 0\.0; it must be a factor > 0"):
        misaligned(POSE, CENTRE, 0.0, 0.0, 0.0, rng)
    with pytest.raises(ValueError, match="correlation_m is -1; it must be metres >= 0"):
        perturbed_mesh(unit_sphere(4), 0.1, -1, rng)
    with pytest.raises(ValueError, match=r"the share of outliers is 1\.5; it is a share"):
        with_outliers(np.ones((4, 4, 3)), np.ones((4, 4)), 1.5, rng)
    with pytest.raises(ValueError, match=r"the object's median radiance is 0\.0"):
        with_outliers(np.zeros((4, 4, 3)), np.ones((4, 4)), 0.5, rng)
