"""Bundle adjustment against exact geometry; its covariance against what noise does."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from capture.arc.gantry import look_at
from capture.camera import Camera
from recon.poses.register.bundle import Bundle, adjust, spread
from recon.poses.register.frame import WorldFrame, frame_of_points, frame_of_poses, free_frame
from recon.poses.register.posecovariance import frame_changes, pose_covariance

Floats = NDArray[np.float64]

CENTRE = np.array([0.3, 0, 0.1])
LENSES = (
    Camera("OPENCV", np.array([900.0, 910, 330, 236, -0.1, 0.03, 1e-3, -5e-4]), 640, 480, np.eye(4)),
    Camera("PINHOLE", np.array([700.0, 700, 300, 250]), 600, 500, np.eye(4)),
)


@pytest.fixture(scope="module")
def exact() -> Bundle:
    """Seven photographs by two cameras of ninety points, each seen by three to seven of them."""
    rng = np.random.default_rng(5)
    directions = np.array([[np.cos(a), np.sin(a), 0.3 + 0.4 * np.sin(3 * a)] for a in np.linspace(0, 2.6, 7)])
    poses = np.array([look_at(0.5 * d + CENTRE, [0.3, 0.01, 0.1], [0, 0, 1]) for d in directions])
    points = rng.normal(0, 0.04, (90, 3)) + CENTRE
    lens = np.array([0, 1, 0, 0, 1, 0, 0])
    seen = rng.random((7, 90)) < 0.5
    seen[:3] |= seen.sum(axis=0) < 3
    photo, point = np.nonzero(seen)
    pixels = np.empty((len(photo), 2))
    for number, pose in enumerate(poses):
        own = photo == number
        pixels[own] = LENSES[lens[number]].posed(pose).project(points[point[own]])
    widths = rng.uniform(0.5, 2.0, len(photo))
    return Bundle(LENSES, lens, poses, points, photo, point, pixels, widths)


def _noisy(exact: Bundle, rng: np.random.Generator, sigma: float) -> Bundle:
    noise = sigma * exact.widths[:, None] * rng.normal(size=exact.pixels.shape)
    return replace(exact, pixels=exact.pixels + noise)


def _errors(found: Bundle, truth: Bundle) -> Floats:
    """Turns and shifts (c, 6) left between poses once the frames are brought together, as inner constraints do."""
    residuals = frame_of_poses(found.poses, truth.poses, found.distance).residuals
    assert residuals is not None
    return residuals


def test_what_no_picture_shows_changes_no_picture(exact: Bundle) -> None:
    # A turn, shift and growth of the world with its poses, to first order: residuals stay to second order.
    step = 1e-6 * np.array([0.3, -0.5, 0.7, 0.2, 0.4, -0.1, 0.9])
    change = (frame_changes(exact.poses) @ step).reshape(-1, 6)
    after = np.tile(np.eye(4), (7, 1, 1))
    after[:, :3, :3] = Rotation.from_rotvec(change[:, :3]).as_matrix()
    after[:, :3, 3] = change[:, 3:]
    points = exact.points + np.cross(step[:3], exact.points) + step[3:6] + step[6] * exact.points
    moved = replace(exact, poses=after @ exact.poses, points=points)
    assert np.abs(moved.residuals).max() < 1e-6  # pixels; each part alone moves pictures by 1e-4 or more


def test_exact_pictures_give_exact_poses_from_afar(exact: Bundle) -> None:
    rng = np.random.default_rng(1)
    after = np.tile(np.eye(4), (7, 1, 1))
    after[:, :3, :3] = Rotation.from_rotvec(0.03 * rng.normal(size=(7, 3))).as_matrix()
    after[:, :3, 3] = 0.01 * rng.normal(size=(7, 3))
    start = replace(exact, poses=after @ exact.poses, points=exact.points + 0.01 * rng.normal(size=(90, 3)))
    found = adjust(start)
    assert (
        np.abs(_errors(found, exact)).max() < 1e-6
    )  # radians and metres; it stops once the cost hardly falls
    assert not np.array_equal(found.poses, start.poses)


def test_gross_errors_hardly_count(exact: Bundle) -> None:
    rng = np.random.default_rng(2)
    noisy = _noisy(exact, rng, 0.1)
    clean = np.abs(_errors(adjust(noisy), exact)).max()
    wrong = rng.random(len(noisy.pixels)) < 0.06
    spoilt = replace(
        noisy, pixels=np.where(wrong[:, None], noisy.pixels + rng.normal(0, 30, (1, 2)), noisy.pixels)
    )
    # Six in a hundred that are 30 px off; least squares would be some hundred times as far off.
    assert np.abs(_errors(adjust(spoilt), exact)).max() < 3 * clean


def test_spread_is_the_noise(exact: Bundle) -> None:
    found = [spread(adjust(_noisy(exact, np.random.default_rng(seed), 0.2))) for seed in range(8)]
    # It only sets where the loss bends. Points of three views take up half of their residuals, and not evenly.
    np.testing.assert_allclose(np.mean(found), 0.2, rtol=0.25)


def test_covariance_is_what_noise_does(exact: Bundle) -> None:
    scores, means = [], []
    for seed in range(20):
        found = adjust(_noisy(exact, np.random.default_rng(seed), 0.2))
        std = np.sqrt(np.diag(pose_covariance(found))).reshape(-1, 6)
        scores.append(_errors(found, exact) / std)
        means.append(std)
    z = np.array(scores)
    # RMS over 20 draws of 35 free numbers; the sandwich's own scatter is some 10%.
    assert 0.85 < np.sqrt((z**2).mean()) < 1.2
    assert 0.85 < np.sqrt((z[..., :3] ** 2).mean()) < 1.2
    assert 0.85 < np.sqrt((z[..., 3:] ** 2).mean()) < 1.2
    assert np.abs(z).max() < 6


def test_given_poses_set_the_frame_in_spite_of_a_wrong_one(exact: Bundle) -> None:
    frame = WorldFrame(2.7, Rotation.from_rotvec([0.3, -2.0, 1.0]).as_matrix(), np.array([0.2, 1.0, -3.0]))
    given = frame.of_poses(exact.poses)
    found = frame_of_poses(exact.poses, given, 0.5)
    np.testing.assert_allclose(found.apply(exact.points), frame.apply(exact.points), atol=1e-7)
    given[2] = given[5]  # a photograph that was listed in the wrong place
    found = frame_of_poses(exact.poses, given, 0.5)
    np.testing.assert_allclose(found.apply(exact.points), frame.apply(exact.points), atol=2e-3)
    assert found.residuals is not None
    assert np.argmax(np.linalg.norm(found.residuals, axis=1)) == 2
    # A point keeps its picture when the world changes its frame.
    point = exact.points[:1]
    before = LENSES[0].posed(exact.poses[0]).project(point)
    after = LENSES[0].posed(frame.of_poses(exact.poses)[0]).project(frame.apply(point))
    np.testing.assert_allclose(after, before, atol=1e-9)


def test_poses_of_one_place_give_no_scale(exact: Bundle) -> None:
    turned = exact.poses.copy()
    turned[:, :3, 3] = -turned[:, :3, :3] @ np.array([0.1, 0.2, 0.3])
    with pytest.raises(ValueError, match="stand in one place"):
        frame_of_poses(turned, exact.poses, 0.5)


def test_frames_covariances_are_what_errors_do(exact: Bundle) -> None:
    of_poses, of_points = [], []
    world = WorldFrame(2.0, np.eye(3), np.zeros(3))
    targets = world.of_poses(exact.poses)
    for seed in range(80):
        rng = np.random.default_rng(seed)
        after = np.tile(np.eye(4), (7, 1, 1))
        after[:, :3, :3] = Rotation.from_rotvec(0.004 * rng.normal(size=(7, 3))).as_matrix()
        after[:, :3, 3] = 0.004 * rng.normal(size=(7, 3))
        frame = frame_of_poses(exact.poses, after @ targets, 0.5)
        assert frame.covariance is not None
        of_poses.append(np.log(frame.scale / 2.0) / np.sqrt(frame.covariance[6, 6]))
        known = world.apply(exact.points[:20])
        frame = frame_of_points(exact.points[:20] + 0.001 * rng.normal(size=(20, 3)), known)
        assert frame.covariance is not None
        of_points.append(np.log(frame.scale / 2.0) / np.sqrt(frame.covariance[6, 6]))
    # 80 draws tell an RMS to 8%; few poses are known less well than their scatter says.
    assert 0.75 < np.sqrt(np.mean(np.square(of_poses))) < 1.35
    assert 0.75 < np.sqrt(np.mean(np.square(of_points))) < 1.3


def test_known_points_never_mirror(exact: Bundle) -> None:
    flat = exact.points[:12] * [1, 1, 0]
    known = flat * [1, -1, 1]
    frame = frame_of_points(flat, known)
    assert np.linalg.det(frame.rotation) == pytest.approx(1)
    np.testing.assert_allclose(frame.apply(flat), known, atol=1e-12)  # a plane turned over is no mirror image


def test_a_free_frame_stands_upright_about_the_points(exact: Bundle) -> None:
    turned = WorldFrame(7.0, Rotation.from_rotvec([1.0, 2.0, -0.5]).as_matrix(), np.array([4.0, 5, 6]))
    frame = free_frame(turned.of_poses(exact.poses), turned.apply(exact.points))
    poses, points = (
        frame.of_poses(turned.of_poses(exact.poses)),
        frame.apply(turned.apply(exact.points)),
    )
    centres = np.array([np.linalg.inv(pose)[:3, 3] for pose in poses])
    np.testing.assert_allclose(np.median(points, axis=0), 0, atol=0.05)  # of the medians along other axes
    assert np.median(np.linalg.norm(centres, axis=1)) == pytest.approx(1, rel=0.05)
    assert centres[0, 1] == pytest.approx(0, abs=0.05)
    assert (poses[:, 1, 2] < 0).all()  # the cameras' own down is the world's down
