from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from numpy.testing import assert_allclose
from scipy.spatial.transform import Rotation

from capture.arc.gantry import look_at
from capture.camera import ORTHOGRAPHIC, Camera
from capture.decode import read_mask
from recon.sphere.fit import fit_sphere
from recon.sphere.outline import Silhouette, mask_silhouette
from recon.sphere.sphere import Sphere


def fit(cameras, masks, **given) -> Sphere:
    return fit_sphere(cameras, [mask_silhouette(mask) for mask in masks], **given)


PSM_POSE = np.diag([1.0, -1, -1, 1])


def perspective(position, target=(0, 0, 0), model="PINHOLE", params=(400.0, 400, 80, 60)) -> Camera:
    return Camera(model, np.array(params), 160, 120, look_at(position, target, [0, 0, 1]))


def around(count: int) -> list[Camera]:
    """Cameras 1.3 from the origin at several heights; the sphere is off their axes, so an ellipse."""
    angles = np.linspace(0, 5, count)
    return [
        perspective([1.3 * np.cos(a), 1.3 * np.sin(a), 0.6 * np.sin(3 * a)], [0.05, -0.03, 0.04])
        for a in angles
    ]


# Finding it.


@pytest.mark.parametrize("model", ["PINHOLE", "OPENCV"])
def test_several_views_give_centre_and_radius(draw, ball, model):
    truth = ball([0.02, -0.01, 0.03], 0.1)
    params = [400.0, 400, 80, 60] + ([-0.3, 0.1, 2e-3, -1e-3] if model == "OPENCV" else [])
    cameras = [Camera(model, params, 160, 120, camera.world_to_camera) for camera in around(4)]
    masks = [draw(truth, camera) for camera in cameras]
    found = fit(cameras, masks)
    px_per_metre = 400 / 1.3
    # 6 x 6 points per pixel: outlines of 170 points, each good to 0.015 px; four standard deviations.
    assert_allclose(found.centre, truth.centre, atol=0.005 / px_per_metre, equal_nan=False)
    assert found.radius == pytest.approx(0.1, rel=1e-4)
    assert np.max(found.residual_px) < 0.03
    # Binary masks of the same: each point to 0.27 px.
    coarse = fit(cameras, [(mask >= 0.5).astype(np.float32) for mask in masks])
    assert_allclose(coarse.centre, truth.centre, atol=0.1 / px_per_metre, equal_nan=False)
    assert coarse.radius == pytest.approx(0.1, rel=2e-3)


def test_one_view_gives_direction_and_angular_size(draw, ball):
    # Near, far off the axis, and wide: the outline is an ellipse whose centre is not the sphere's.
    camera = perspective([1.3, 0, 0.2], [0, 0.35, -0.15], params=(160.0, 160, 80, 60))
    truth = ball([0.0, 0.0, 0.0], 0.4)
    mask = draw(truth, camera)
    found = fit([camera], [mask])
    distance, found_distance = (np.linalg.norm(sphere.centre - camera.centre) for sphere in (truth, found))
    assert found.radius / found_distance == pytest.approx(0.4 / distance, rel=1e-3)
    # The centre's image; the outline's mean is off by more than a pixel.
    assert_allclose(camera.project(found.centre), camera.project(truth.centre), atol=0.02, equal_nan=False)
    outline_centre = np.argwhere(mask >= 0.5).mean(axis=0)[::-1] + 0.5
    assert np.abs(outline_centre - camera.project(truth.centre)[0]).max() > 1
    # With the radius known, the distance follows; a ratio good to 1e-3 leaves it good to 1e-3.
    known = fit([camera], [mask], radius=0.4)
    assert known.radius == 0.4
    assert_allclose(known.centre, truth.centre, atol=1e-3 * distance, equal_nan=False)
    # With the centre known, the radius.
    assert fit([camera], [mask], centre=[0, 0, 0]).radius == pytest.approx(0.4, rel=1e-3)


def test_the_free_scale_of_one_view_carries_no_variance(draw, ball):
    camera = perspective([1.3, 0, 0.2])
    found = fit([camera], [draw(ball([0.0, 0.02, 0.0], 0.15), camera)])
    # Distance and radius together: the direction in which nothing changes in the picture.
    gauge = np.append(found.centre - camera.centre, found.radius)
    gauge /= np.linalg.norm(gauge)
    across = np.sqrt(np.trace(found.covariance))
    assert across > 0
    # The Jacobian is by finite differences, 1e-8 or so; what is left of the gauge is far below the rest.
    assert np.sqrt(abs(gauge @ found.covariance @ gauge)) < 1e-3 * across


def test_orthographic_view(draw, ball):
    camera = Camera(ORTHOGRAPHIC, [200.0, 80, 60], 160, 120, look_at([1, 2, 0.5], [0, 0, 0], [0, 0, 1]))
    truth = ball([0.02, -0.01, 0.03], 0.2)
    found = fit([camera], [draw(truth, camera)])
    assert_allclose(camera.project(found.centre), camera.project(truth.centre), atol=0.02, equal_nan=False)
    assert found.radius == pytest.approx(0.2, rel=2e-4)
    # Two orthographic views know the depth, too.
    other = camera.posed(look_at([-1, 1, 0.5], [0, 0, 0], [0, 0, 1]))
    both = fit([camera, other], [draw(truth, camera), draw(truth, other)])
    assert_allclose(both.centre, truth.centre, atol=0.02 / 200, equal_nan=False)


def test_a_sphere_that_the_image_cuts_off_is_whole_all_the_same(draw, ball):
    camera = Camera(ORTHOGRAPHIC, [1.0, 0, 0], 160, 120, np.eye(4))
    truth = ball([140.3, 60.2, 0], 40.0)  # a quarter of it lies outside
    found = fit([camera], [draw(truth, camera)])
    assert_allclose(found.centre[:2], truth.centre[:2], atol=0.04, equal_nan=False)
    assert found.radius == pytest.approx(40, rel=5e-4)


def test_a_stand_in_the_mask_bends_the_result_little(draw, ball):
    camera = Camera(ORTHOGRAPHIC, [1.0, 0, 0], 160, 120, np.eye(4))
    truth = ball([80.3, 50.2, 0], 35.0)
    mask = draw(truth, camera)
    mask[80:, 74:87] = 1  # a post of a third of the radius, down to the image's edge
    found = fit([camera], [mask])
    # A plain least-squares fit moves the centre by 6 px and the radius by 3.
    assert_allclose(found.centre[:2], truth.centre[:2], atol=0.1, equal_nan=False)
    assert found.radius == pytest.approx(35, abs=0.05)
    assert (np.sqrt(np.diag(found.covariance))[[0, 1, 3]] < 0.1).all()


def test_a_stand_in_every_view_is_no_part_of_the_sphere(draw, ball):
    truth = ball([0.02, -0.01, 0.03], 0.1)
    cameras = around(3)
    for n, tolerance in (
        (6, 0.01),
        (1, 0.2),
    ):  # antialiased and binary masks; the post leaves 60% of the outline
        masks = []
        for camera in cameras:
            mask = draw(truth, camera, n)
            column, row = camera.project(truth.centre)[0].astype(int)
            mask[row:, column - 6 : column + 7] = 1
            masks.append(mask)
        found = fit(cameras, masks)
        px_per_metre = 400 / 1.3
        assert_allclose(found.centre, truth.centre, atol=tolerance / px_per_metre, equal_nan=False)
        assert found.radius == pytest.approx(0.1, abs=tolerance / px_per_metre)


# What it says of its own errors.


def disc(size: int, x: float, y: float, radius: float, n: int) -> np.ndarray:
    """Coverage (size, size) of a disc, from n x n points in each pixel."""
    across, down = ((np.arange(size * n) + 0.5) / n - centre for centre in (x, y))
    inside = across**2 + down[:, None] ** 2 < radius**2
    return inside.reshape(size, n, size, n).mean(axis=(1, 3), dtype=np.float32)


def scatter_of(trial, count: int) -> tuple[np.ndarray, np.ndarray]:
    """RMS of errors in standard deviations, and the share of them within 1.96; trial gives both (k,)."""
    errors, stated = (np.array(each) for each in zip(*(trial() for _ in range(count)), strict=True))
    ratio = errors / stated
    return np.sqrt(np.mean(ratio**2, axis=0)), np.mean(np.abs(ratio) < 1.96)


FURTHER = [pytest.param(kind, marks=pytest.mark.slow) for kind in ("antialiased", "stand")]


@pytest.mark.parametrize("kind", ["binary", "noisy", "binary with a stand", *FURTHER])
def test_the_covariance_of_one_view_is_its_scatter(kind):
    """Over random positions within a pixel."""
    rng = np.random.default_rng(2)
    camera = Camera(ORTHOGRAPHIC, [1.0, 0, 0], 84, 84, np.eye(4))

    def trial():
        truth = np.array([42, 42, 32]) + rng.uniform(-0.5, 0.5, 3)
        mask = disc(84, *truth, 1 if "binary" in kind else 8)
        if kind == "noisy":
            mask = np.clip(mask + rng.normal(0, 0.05, mask.shape), 0, 1).astype(np.float32)
        if "stand" in kind:
            mask[42:, 36:48] = 1
        # Cut at one half, as is known here: the bar of masks that may be cut elsewhere is another test's.
        found = fit_sphere([camera], [replace(mask_silhouette(mask), edge_px=0.0)])
        error = np.append(found.centre[:2], found.radius) - truth
        return error, np.sqrt(np.diag(found.covariance))[[0, 1, 3]]

    ratio, covered = scatter_of(trial, 40)
    # 40 draws know a standard deviation to 11%; each is stated from 20 arcs, to 16%.
    assert (ratio > 0.75).all()
    assert (ratio < 1.3).all()
    assert covered > 0.9


def test_the_radius_is_as_uncertain_as_where_binary_masks_were_cut():
    """Anywhere in the middle third of a pixel, all masks of a set alike; the centre doesn't suffer."""
    rng = np.random.default_rng(4)
    camera = Camera(ORTHOGRAPHIC, [1.0, 0, 0], 84, 84, np.eye(4))

    def trial():
        truth = np.array([42, 42, 32]) + rng.uniform(-0.5, 0.5, 3)
        level = rng.uniform(1 / 3, 2 / 3)
        found = fit([camera], [(disc(84, *truth, 8) > level).astype(np.float32)])
        error = np.append(found.centre[:2], found.radius) - truth
        return error, np.sqrt(np.diag(found.covariance))[[0, 1, 3]]

    ratio, covered = scatter_of(trial, 40)
    assert (ratio > 0.75).all()
    assert (ratio < 1.3).all()
    assert covered > 0.9


@pytest.mark.parametrize(
    ("count", "degrees"), [(3, 0.0), (3, 0.1), pytest.param(8, 0.1, marks=pytest.mark.slow)]
)
def test_the_covariance_of_several_views_knows_wrong_poses(draw, ball, count, degrees):
    """Errors of the poses shift whole outlines, 0.7 px each way, of which the outlines themselves show nothing."""
    rng = np.random.default_rng(3)

    def trial():
        place = np.array([0.02, -0.01, 0.03]) + rng.uniform(-0.002, 0.002, 3)
        truth = ball(place, rng.uniform(0.09, 0.11))
        cameras = around(count)
        masks = [draw(truth, camera, 2) for camera in cameras]
        turns = [Rotation.from_rotvec(rng.normal(0, np.radians(degrees), 3)).as_matrix() for _ in cameras]
        poses = [camera.world_to_camera.copy() for camera in cameras]
        for pose, turn in zip(poses, turns, strict=True):
            pose[:3] = turn @ pose[:3]
        found = fit([camera.posed(pose) for camera, pose in zip(cameras, poses, strict=True)], masks)
        error = np.append(found.centre - truth.centre, found.radius - truth.radius)
        return error, np.sqrt(np.diag(found.covariance))

    ratio, covered = scatter_of(trial, 25)
    # 25 draws know a standard deviation to 14%. Where three photos tell how wrong poses are it is stated wide; the
    # radius, which turns hardly change, as well.
    assert (ratio < 1.4).all()
    assert degrees or (ratio > 0.7).all()
    assert ratio[:3].min() > 0.3
    assert covered > 0.9


def test_hidden_errors_are_added_whatever_the_outlines_say(draw, ball):
    camera = Camera(ORTHOGRAPHIC, [2.0, 0, 0], 84, 84, np.eye(4))
    outline = mask_silhouette(draw(ball([20.1, 21.2, 0], 15), camera))
    without = fit_sphere([camera], [outline]).covariance
    hidden = Silhouette(outline.points, 0.4, outline.packed, outline.shape)
    # 0.4 px are 0.2 m, along x, along y and in radius; none in depth, which an orthographic camera doesn't tell.
    added = fit_sphere([camera], [hidden]).covariance - without
    assert_allclose(added, 0.04 * np.diag([1, 1, 0, 1]), atol=1e-3, equal_nan=False)
    # Shifts of two views are their own; what grows one outline grows the other. From further away all looks the same.
    away = camera.posed(camera.world_to_camera + 0.1 * np.eye(4, k=1) * np.eye(4)[:, [2]])
    cameras = [camera, away]
    both = fit_sphere(cameras, [hidden] * 2).covariance - fit_sphere(cameras, [outline] * 2).covariance
    assert_allclose(both, 0.04 * np.diag([0.5, 0.5, 0, 1]), atol=1e-3, equal_nan=False)


def test_a_mask_that_photographs_share_is_one_measurement():
    rng = np.random.default_rng(5)
    camera = Camera(ORTHOGRAPHIC, [1.0, 0, 0], 84, 84, np.eye(4))
    # Drawn by an unsteady hand.
    cover = disc(84, 42.1, 41.7, 30.3, 12)
    one, other, *rest = (
        mask_silhouette((cover + rng.normal(0, 0.3, cover.shape) > 0.5).astype(np.float32)) for _ in range(10)
    )
    alone, pair = fit_sphere([camera], [one]), fit_sphere([camera] * 2, [one, other])
    many = fit_sphere([camera] * 50, [one] * 50)
    assert_allclose(many.centre, alone.centre, rtol=1e-12, equal_nan=False)
    assert_allclose(many.covariance, alone.covariance, rtol=1e-9, equal_nan=False)
    assert many.residual_px == alone.residual_px * 50
    # Among fifty copies another counts as much as they all.
    mixed = fit_sphere([camera] * 51, [*[one] * 20, other, *[one] * 30])
    assert_allclose(mixed.centre, pair.centre, rtol=1e-9, equal_nan=False)
    assert_allclose(mixed.covariance, pair.covariance, rtol=1e-6, atol=1e-12, equal_nan=False)
    assert mixed.residual_px[20] == pair.residual_px[1]
    # Different masks of a fixed camera average out, but for where all of them were cut.
    ten = fit_sphere([camera] * 10, [one, other, *rest])
    assert np.trace(ten.covariance[:2, :2]) < 0.3 * np.trace(alone.covariance[:2, :2])
    assert ten.covariance[3, 3] > one.edge_px**2
    # Copies from several sides locate it too, but they err alike: the radius is no better known than from one.
    poses = [np.eye(4) for _ in range(4)]
    for pose, angle in zip(poses, np.arange(4) * np.pi / 4, strict=True):
        pose[:3, :3] = Rotation.from_euler("y", angle).as_matrix()
        pose[0, 3] = alone.centre[0]
    around_it = [camera.posed(pose) for pose in poses]
    sides = fit_sphere(around_it, [one] * 4)
    assert np.sqrt(sides.covariance[3, 3]) > 0.9 * np.sqrt(alone.covariance[3, 3])


def test_scale_of_the_scene_does_not_matter(draw, ball):
    cameras = around(3)
    truth = ball([0.02, -0.01, 0.03], 0.1)
    masks = [draw(truth, camera, 2) for camera in cameras]
    found = fit(cameras, masks)
    for factor in (1e-3, 1e3):
        scaled = []
        for camera in cameras:
            pose = camera.world_to_camera.copy()
            pose[:3, 3] *= factor
            scaled.append(camera.posed(pose))
        other = fit(scaled, masks)
        # Where the optimiser stops: its tolerance of 1e-8 of the cost.
        assert_allclose(other.centre / factor, found.centre, atol=1e-6, equal_nan=False)
        assert_allclose(
            other.covariance / factor**2, found.covariance, rtol=1e-2, atol=1e-12, equal_nan=False
        )


def test_the_grey_ball_of_the_psm_photographs(data_dir):
    camera = Camera(ORTHOGRAPHIC, [1.0, 0, 0], 512, 340, PSM_POSE)
    mask = read_mask(data_dir / "psm" / "gray" / "gray.mask.png", (340, 512))
    found = fit([camera], [mask])
    # Measured in the mask: it spans 217 columns and rows or so about this centre.
    assert_allclose(camera.project(found.centre), [[245.0, 145.0]], atol=0.3, equal_nan=False)
    assert found.radius == pytest.approx(108.25, abs=0.3)
    assert found.residual_px[0] < 0.6


def test_the_glossy_ball_has_the_radius_of_its_normals_within_a_bar_below_a_tenth(data_dir):
    """One mask for 48 photographs, cut by someone: 48 times its noise told 0.0016 px where it was 0.145 px off."""
    camera = Camera(ORTHOGRAPHIC, [1.0, 0, 0], 160, 160, PSM_POSE)
    mask = mask_silhouette(read_mask(data_dir / "glossball" / "mask.png", (160, 160)))
    found = fit_sphere([camera] * 48, [mask] * 48)
    normals = np.load(data_dir / "glossball" / "normals.npz")["normals"].astype(float)
    row, column = np.nonzero(normals[..., 2] > 0.3)
    # n = (p - c) / r, row by row of x and y.
    ones = np.ones(len(row))
    design = np.block(
        [
            [normals[row, column, 0][:, None], ones[:, None], 0 * ones[:, None]],
            [normals[row, column, 1][:, None], 0 * ones[:, None], ones[:, None]],
        ]
    )
    truth = np.linalg.lstsq(design, np.append(column + 0.5, -(row + 0.5)), rcond=None)[0]
    error = np.append(found.radius, found.centre[:2]) - truth
    std = np.sqrt(np.diag(found.covariance))[[3, 0, 1]]
    assert std.max() < 0.1
    assert np.abs(error / std).max() < 1.96


# Faults.


def test_an_outline_too_short_to_fit_is_refused():
    camera = Camera(ORTHOGRAPHIC, [], 20, 20, np.eye(4))
    mask = np.zeros((20, 20), np.float32)
    mask[9:11, 9:11] = 1
    for bad in (mask, np.ones((20, 20), np.float32)):
        with pytest.raises(ValueError, match="outline has fewer than 12 points"):
            fit([camera], [bad])


def test_a_distortion_that_cannot_be_undone_is_refused(draw, ball):
    drawn = perspective([1.3, 0, 0])
    mask = draw(ball([0, 0, 0], 0.17), drawn)
    # With k1 = -30, no ray comes out further than 28 px from the centre.
    lens = perspective([1.3, 0, 0], model="SIMPLE_RADIAL", params=(400.0, 80, 60, -30.0))
    with pytest.raises(ValueError, match="distortion cannot be undone at the mask's outline"):
        fit([lens], [mask])


@pytest.mark.parametrize("radius", [0.0, -1.0, np.nan])
def test_a_sphere_without_size_is_refused(radius):
    with pytest.raises(ValueError, match=f"radius is {radius}; it must be > 0"):
        Sphere(np.zeros(3), radius, np.zeros((4, 4)))


# Rays that meet it.


def test_hits_agree_with_the_quadratic_formula(ball):
    rng = np.random.default_rng(3)
    sphere = ball([0.3, -0.2, 0.5], 0.7)
    origins = rng.normal(0, 3, (2000, 3))
    aims = sphere.centre + rng.normal(0, 0.6, (2000, 3))
    directions = aims - origins
    directions /= np.linalg.norm(directions, axis=1, keepdims=True)
    hit, normals = sphere.hits(origins, directions)
    # |o + t d - c|^2 = r^2 as a t^2 + b t + c = 0, its smaller root the point of entry.
    for origin, direction, met, normal in zip(origins, directions, hit, normals, strict=True):
        offset = origin - sphere.centre
        roots = np.roots([1, 2 * direction @ offset, offset @ offset - 0.7**2])
        assert met == np.isreal(roots).all()
        expected = (origin + roots.real.min() * direction - sphere.centre) / 0.7 if met else np.zeros(3)
        assert_allclose(normal, expected, atol=1e-6, equal_nan=False)  # np.roots near a double root
    assert 200 < hit.sum() < 1900
    assert_allclose(np.linalg.norm(normals[hit], axis=1), 1, atol=1e-12, equal_nan=False)
    assert ((normals[hit] * directions[hit]).sum(axis=1) < 0).all()  # they face the viewer


def test_a_ray_through_the_centre_meets_its_nearest_point(ball):
    sphere = ball([1.0, 2, 3], 0.5)
    hit, normals = sphere.hits(np.array([[1.0, 2, -7]]), np.array([[0.0, 0, 1]]))
    assert hit.tolist() == [True]
    assert_allclose(normals, [[0, 0, -1]], atol=1e-15)


def test_pixel_radius_is_half_the_outlines_width(draw, ball):
    camera = perspective([1.3, 0, 0])
    sphere = ball([0, 0, 0], 0.17)
    # On the axis the outline is a circle; counting its pixels gives its area.
    assert sphere.pixel_radius(camera) == pytest.approx(np.sqrt(draw(sphere, camera).sum() / np.pi), rel=1e-3)
    flat = Camera(ORTHOGRAPHIC, [200.0, 80, 60], 160, 120, np.eye(4))
    assert sphere.pixel_radius(flat) == pytest.approx(34, rel=1e-12)
