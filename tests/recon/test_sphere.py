from __future__ import annotations

import numpy as np
import pytest
from numpy.testing import assert_allclose

from capture.arc.gantry import look_at
from capture.camera import ORTHOGRAPHIC, Camera
from capture.decode import read_mask
from recon.sphere import Sphere, fit_sphere

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
    found = fit_sphere(cameras, [draw(truth, camera) for camera in cameras])
    px_per_metre = 400 / 1.3
    # An outline of 250 points per view, each good to 0.05 px.
    assert_allclose(found.centre, truth.centre, atol=0.02 / px_per_metre, equal_nan=False)
    assert found.radius == pytest.approx(0.1, rel=2e-4)
    # 1.4826 median |r| overstates the RMS of errors that fill an interval evenly, by up to 1.28.
    assert np.max(found.residual_px) < 0.08


def test_one_view_gives_direction_and_angular_size(draw, ball):
    # Near, far off the axis, and wide: the outline is an ellipse whose centre is not the sphere's.
    camera = perspective([1.3, 0, 0.2], [0, 0.35, -0.15], params=(160.0, 160, 80, 60))
    truth = ball([0.0, 0.0, 0.0], 0.4)
    mask = draw(truth, camera)
    found = fit_sphere([camera], [mask])
    distance, found_distance = (np.linalg.norm(sphere.centre - camera.centre) for sphere in (truth, found))
    assert found.radius / found_distance == pytest.approx(0.4 / distance, rel=1e-3)
    # The centre's image; the outline's mean is off by more than a pixel.
    assert_allclose(camera.project(found.centre), camera.project(truth.centre), atol=0.02, equal_nan=False)
    outline_centre = np.argwhere(mask >= 0.5).mean(axis=0)[::-1] + 0.5
    assert np.abs(outline_centre - camera.project(truth.centre)[0]).max() > 1
    # With the radius known, the distance follows; a ratio good to 1e-3 leaves it good to 1e-3.
    known = fit_sphere([camera], [mask], radius=0.4)
    assert known.radius == 0.4
    assert_allclose(known.centre, truth.centre, atol=1e-3 * distance, equal_nan=False)
    # With the centre known, the radius.
    assert fit_sphere([camera], [mask], centre=[0, 0, 0]).radius == pytest.approx(0.4, rel=1e-3)


def test_the_free_scale_of_one_view_carries_no_variance(draw, ball):
    camera = perspective([1.3, 0, 0.2])
    found = fit_sphere([camera], [draw(ball([0.0, 0.02, 0.0], 0.15), camera)])
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
    found = fit_sphere([camera], [draw(truth, camera)])
    assert_allclose(camera.project(found.centre), camera.project(truth.centre), atol=0.02, equal_nan=False)
    assert found.radius == pytest.approx(0.2, rel=2e-4)
    # Two orthographic views know the depth, too.
    other = camera.posed(look_at([-1, 1, 0.5], [0, 0, 0], [0, 0, 1]))
    both = fit_sphere([camera, other], [draw(truth, camera), draw(truth, other)])
    assert_allclose(both.centre, truth.centre, atol=0.02 / 200, equal_nan=False)


def test_a_sphere_that_the_image_cuts_off_is_whole_all_the_same(draw, ball):
    camera = Camera(ORTHOGRAPHIC, [1.0, 0, 0], 160, 120, np.eye(4))
    truth = ball([140.3, 60.2, 0], 40.0)  # a quarter of it lies outside
    found = fit_sphere([camera], [draw(truth, camera)])
    assert_allclose(found.centre[:2], truth.centre[:2], atol=0.04, equal_nan=False)
    assert found.radius == pytest.approx(40, rel=5e-4)


def test_a_stand_in_the_mask_bends_the_result_little(draw, ball):
    camera = Camera(ORTHOGRAPHIC, [1.0, 0, 0], 160, 120, np.eye(4))
    truth = ball([80.3, 50.2, 0], 35.0)
    mask = draw(truth, camera)
    mask[80:, 74:87] = 1  # a post of a third of the radius, down to the image's edge
    found = fit_sphere([camera], [mask])
    # A plain least-squares fit moves the centre by 6 px and the radius by 3.
    assert_allclose(found.centre[:2], truth.centre[:2], atol=0.1, equal_nan=False)
    assert found.radius == pytest.approx(35, abs=0.05)
    assert (np.sqrt(np.diag(found.covariance))[[0, 1, 3]] < 0.1).all()


@pytest.mark.parametrize(("n", "radius"), [(1, 20), (4, 20), (1, 99.75)])
def test_covariance_is_the_scatter(draw, ball, n, radius):
    """Over random positions within a pixel; 99.75 px is an outline of twice the points that enter the fit."""
    rng = np.random.default_rng(2)
    size = int(2 * radius + 12)
    camera = Camera(ORTHOGRAPHIC, [1.0, 0, 0], size, size, np.eye(4))
    errors, stated = [], []
    for _ in range(80):
        truth = ball([*(size / 2 + rng.uniform(-0.5, 0.5, 2)), 0], radius + rng.uniform(-0.2, 0.2))
        found = fit_sphere([camera], [draw(truth, camera, n)])
        errors.append([*(found.centre - truth.centre)[:2], found.radius - truth.radius])
        stated.append(np.sqrt(np.diag(found.covariance))[[0, 1, 3]])
    ratio = np.sqrt(np.mean(np.square(errors), axis=0)) / np.mean(stated, axis=0)
    # 80 draws know a standard deviation to 8%; the pixel grid's errors are not quite independent.
    assert (ratio > 1 / 1.5).all()
    assert (ratio < 1.5).all()


def test_scale_of_the_scene_does_not_matter(draw, ball):
    cameras = around(3)
    truth = ball([0.02, -0.01, 0.03], 0.1)
    masks = [draw(truth, camera, 2) for camera in cameras]
    found = fit_sphere(cameras, masks)
    for factor in (1e-3, 1e3):
        scaled = []
        for camera in cameras:
            pose = camera.world_to_camera.copy()
            pose[:3, 3] *= factor
            scaled.append(camera.posed(pose))
        other = fit_sphere(scaled, masks)
        # Where the optimiser stops: its tolerance of 1e-8 of the cost.
        assert_allclose(other.centre / factor, found.centre, atol=1e-6, equal_nan=False)
        assert_allclose(
            other.covariance / factor**2, found.covariance, rtol=1e-2, atol=1e-12, equal_nan=False
        )


def test_the_grey_ball_of_the_psm_photographs(data_dir):
    camera = Camera(ORTHOGRAPHIC, [1.0, 0, 0], 512, 340, PSM_POSE)
    mask = read_mask(data_dir / "psm" / "gray" / "gray.mask.png", (340, 512))
    found = fit_sphere([camera], [mask])
    # Measured in the mask: it spans 217 columns and rows or so about this centre.
    assert_allclose(camera.project(found.centre), [[245.0, 145.0]], atol=0.3, equal_nan=False)
    assert found.radius == pytest.approx(108.25, abs=0.3)
    assert found.residual_px[0] < 0.6


# Faults.


def test_an_outline_too_short_to_fit_is_refused():
    camera = Camera(ORTHOGRAPHIC, [], 20, 20, np.eye(4))
    mask = np.zeros((20, 20), np.float32)
    mask[9:11, 9:11] = 1
    for bad in (mask, np.ones((20, 20), np.float32)):
        with pytest.raises(ValueError, match="outline has fewer than 12 points"):
            fit_sphere([camera], [bad])


def test_a_distortion_that_cannot_be_undone_is_refused(draw, ball):
    drawn = perspective([1.3, 0, 0])
    mask = draw(ball([0, 0, 0], 0.17), drawn)
    # With k1 = -30, no ray comes out further than 28 px from the centre.
    lens = perspective([1.3, 0, 0], model="SIMPLE_RADIAL", params=(400.0, 80, 60, -30.0))
    with pytest.raises(ValueError, match="distortion cannot be undone at the mask's outline"):
        fit_sphere([lens], [mask])


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
