from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal

from capture.arc.gantry import look_at
from capture.camera import ORTHOGRAPHIC, Camera
from capture.radiance import RadianceImage
from recon.mesh.bodies import SphereBody, body_coverage, body_pixels
from recon.sampling.draw import MIN_COS_EXITANT, NO_SOURCES, sample_body, samples_at
from recon.sampling.lightfield import LightField, joined
from recon.sphere.sphere import Sphere

WIDTH, HEIGHT = 64, 48
# World axes as in the picture, but y up and z towards the camera.
FLAT = Camera(ORTHOGRAPHIC, [1.0, 0, 0], WIDTH, HEIGHT, np.diag([1.0, -1, -1, 1]))
NEAR = Camera("PINHOLE", [60.0, 60, 32, 24], WIDTH, HEIGHT, look_at([0.3, -2, 0.4], [0.1, 0, 0], [0, 0, 1]))


def sample_sphere(
    sphere: Sphere,
    camera: Camera,
    image: RadianceImage,
    mask: np.ndarray | None = None,
    budget: int | None = None,
    rng: np.random.Generator | None = None,
) -> LightField:
    rng = rng or np.random.default_rng(6)
    return sample_body(SphereBody(sphere), camera, image, mask, NO_SOURCES, budget, rng)


def rng() -> np.random.Generator:
    return np.random.default_rng(6)


def picture(seed: int = 0) -> RadianceImage:
    noise = np.random.default_rng(seed).random((HEIGHT, WIDTH, 3))
    return RadianceImage(noise, noise**2, np.zeros((HEIGHT, WIDTH), bool))


@pytest.fixture
def flat_ball(ball):
    return ball([31.7, -23.8, 5.0], 20.0)


def test_normals_and_views_of_an_orthographic_picture(flat_ball):
    image = picture()
    samples = samples_at(
        SphereBody(flat_ball), FLAT, image, *body_pixels(SphereBody(flat_ball), FLAT), NO_SOURCES
    )
    # By hand: the normal's x and y are the pixel's offset from the centre, in radii; z the rest.
    # A ball of 20 px curves within every pixel, so each is seen along 2x2 or 4x4 Gauss points.
    gauss = 0.5 / np.sqrt(3) * np.array([-1, 1])
    nodes = {4: gauss, 16: np.append(gauss / 2 - 0.25, gauss / 2 + 0.25)}
    counts = np.bincount(samples.ray_sample)
    assert set(counts) == set(nodes)
    shift = np.concatenate([[(u, v) for v in nodes[count] for u in nodes[count]] for count in counts])
    column, row = (np.column_stack([samples.columns, samples.rows])[samples.ray_sample] + 0.5 + shift).T
    x, y = (column - 31.7) / 20, -(row - 23.8) / 20
    expected = np.column_stack([x, y, np.sqrt(1 - x**2 - y**2)])
    assert_allclose(samples.normals, expected, atol=1e-12, equal_nan=False)
    assert_allclose(samples.views, np.broadcast_to([0, 0, 1], expected.shape), atol=1e-15)
    cosines = np.bincount(samples.ray_sample, expected[:, 2]) / counts
    assert_allclose(samples.cos_exitant, cosines, atol=1e-12, equal_nan=False)
    assert_array_equal(samples.radiance, image.radiance[samples.rows, samples.columns])
    assert_array_equal(samples.variance, image.variance[samples.rows, samples.columns])


def test_rays_of_a_perspective_picture_meet_the_sphere_where_they_came_from(ball):
    sphere = ball([0.1, 0.05, -0.03], 0.6)
    samples = sample_sphere(sphere, NEAR, picture(), None, None, rng())
    points = sphere.centre + 0.6 * samples.normals
    pixels = NEAR.project(points)
    # A sample's rays lie within its pixel, and their mean is its centre: within a thousandth or so of a
    # pixel, for the projection is of the surface and the mean is of the rays.
    centres = np.column_stack([samples.columns, samples.rows]) + 0.5
    assert np.abs(pixels - centres[samples.ray_sample]).max() < 0.5
    assert_allclose(samples.mean_over_rays(pixels), centres, atol=1e-9, equal_nan=False)
    views = NEAR.centre - points
    views /= np.linalg.norm(views, axis=1, keepdims=True)
    assert_allclose(samples.views, views, atol=1e-12, equal_nan=False)
    assert (samples.cos_exitant > 0.9 * MIN_COS_EXITANT).all()


def test_a_sample_of_several_rays_is_exact_for_quadratic_functions(flat_ball):
    samples = sample_sphere(flat_ball, FLAT, picture(), None, None, rng())
    counts = np.bincount(samples.ray_sample)
    assert set(counts) == {4, 16}  # 1 / 20 px: every pixel turns by more than the limit
    # The pixel positions of the rays, from their normals; a quadratic function f of them.
    x, y = 31.7 + 20 * samples.normals[:, 0], 23.8 - 20 * samples.normals[:, 1]

    def f(x, y):
        return 3 + 2 * x - y + 0.5 * x**2 - 0.3 * x * y + 0.7 * y**2

    # Its exact mean over the unit square: the value at the middle, and 1/12 for each square.
    exact = f(samples.columns + 0.5, samples.rows + 0.5) + (0.5 + 0.7) / 12
    assert_allclose(samples.mean_over_rays(f(x, y)), exact, rtol=1e-11, equal_nan=False)
    # The mean of the normal across the pixel, against 20 x 20 points of it.
    steps = (np.arange(20) + 0.5) / 20
    worst = np.argmin(samples.cos_exitant)
    u = (samples.columns[worst] + steps[:, None] - 31.7) / 20
    v = -(samples.rows[worst] + steps - 23.8) / 20
    z = np.sqrt(1 - u**2 - v**2).mean()
    assert samples.sample_normals[worst, 2] == pytest.approx(z, rel=5e-3)  # z is not quadratic at grazing


def test_a_pixel_has_more_rays_the_more_the_surface_curves_in_it(ball):
    camera = Camera(ORTHOGRAPHIC, [1.0, 0, 0], 200, 200, np.diag([1.0, -1, -1, 1]))
    blank = np.ones((200, 200, 3))
    image = RadianceImage(blank, blank, np.zeros((200, 200), bool))
    samples = sample_sphere(ball([100.0, -100, 0], 90.0), camera, image, None, None, rng())
    counts = np.bincount(samples.ray_sample)
    turn = 1 / (90 * samples.cos_exitant)  # radians per pixel
    assert_array_equal(counts == 1, turn <= 0.02)
    assert set(counts) == {1, 4}  # 81 degrees on 90 px: 0.074, where 16 begin at 0.08
    assert samples.mean_over_rays(np.ones((len(samples.normals), 2, 3))).shape == (len(samples), 2, 3)


def test_means_are_over_each_samples_own_rays():
    field = LightField(
        rows=np.arange(3),
        columns=np.zeros(3, int),
        radiance=np.zeros((3, 3)),
        variance=np.ones((3, 3)),
        weight=np.ones(3),
        ray_sample=np.array([0, 1, 1, 1, 1, 2]),
        positions=np.zeros((6, 3)),
        normals=np.ones((6, 3)),
        views=np.ones((6, 3)),
        reflected_visible=np.ones(6, bool),
        sources_visible=np.ones((6, 0), bool),
    )
    values = np.array([5.0, 1, 2, 3, 6, 7])
    assert field.mean_over_rays(values).tolist() == [5, 3, 7]
    assert field.mean_over_rays(values.astype(np.float32)).dtype == np.float32
    assert_array_equal(field.mean_over_rays(values[:, None] * [1, 10]), [[5, 50], [3, 30], [7, 70]])


def test_pixels_of_a_sphere_lie_wholly_on_it(flat_ball):
    rows, columns = body_pixels(SphereBody(flat_ball), FLAT)
    # The farthest corner of a pixel from the centre.
    far = np.hypot(np.abs(columns + 0.5 - 31.7) + 0.5, np.abs(rows + 0.5 - 23.8) + 0.5)
    inside = np.zeros((HEIGHT, WIDTH), bool)
    inside[rows, columns] = True
    assert (far <= 20).all()
    y, x = np.mgrid[:HEIGHT, :WIDTH] + 0.5
    assert_array_equal(inside, np.hypot(np.abs(x - 31.7) + 0.5, np.abs(y - 23.8) + 0.5) < 20)
    assert_array_equal(body_coverage(SphereBody(flat_ball), FLAT), np.hypot(x - 31.7, y - 23.8) < 20)


def test_a_sphere_behind_or_around_the_camera_covers_nothing(ball):
    behind = NEAR.centre - 2 * NEAR.camera_to_world[:3, 2]
    assert not body_coverage(SphereBody(ball(behind, 0.5)), NEAR).any()
    assert not body_coverage(SphereBody(ball(NEAR.centre, 0.5)), NEAR).any()
    assert len(body_pixels(SphereBody(ball(behind, 0.5)), NEAR)[0]) == 0


# Small enough, and the pixels at the rim turn too much within themselves, before they are too grazing.
@pytest.mark.parametrize("radius", [20, 8])
def test_border_saturated_and_grazing_pixels_are_left_out(ball, radius):
    sphere = ball([31.7, -23.8, 5.0], radius)
    saturated = np.zeros((HEIGHT, WIDTH), bool)
    saturated[20:24, 30:33] = True
    blank = np.ones((HEIGHT, WIDTH, 3))
    image = RadianceImage(blank, blank, saturated)
    mask = np.ones((HEIGHT, WIDTH), np.float32)
    mask[:, 36] = 0.9  # partly covered: the mask's border
    samples = sample_sphere(sphere, FLAT, image, mask, None, rng())
    assert not saturated[samples.rows, samples.columns].any()
    assert not np.isin(samples.columns, [35, 36, 37]).any()
    # The others are all there: wholly on the sphere, and turned towards the camera.
    rows, columns = body_pixels(SphereBody(sphere), FLAT)
    distance = np.hypot(columns + 0.5 - 31.7, rows + 0.5 - 23.8) / radius
    cos = np.sqrt(1 - distance**2)
    # Within a pixel the normal may turn by a quarter of a radian: 1 / (radius cos).
    usable = (cos >= MIN_COS_EXITANT) & (cos >= 1 / (0.25 * radius))
    usable &= ~saturated[rows, columns] & ~np.isin(columns, [35, 36, 37])
    assert_array_equal(samples.rows, rows[usable])
    assert_array_equal(samples.columns, columns[usable])


def test_grazing_pixels_of_a_large_sphere_end_at_the_named_angle(ball):
    camera = Camera(ORTHOGRAPHIC, [1.0, 0, 0], 200, 200, np.diag([1.0, -1, -1, 1]))
    blank = np.ones((200, 200, 3))
    image = RadianceImage(blank, blank, np.zeros((200, 200), bool))
    samples = sample_sphere(ball([100.0, -100, 0], 95.0), camera, image, None, None, rng())
    distance = np.hypot(samples.columns + 0.5 - 100, samples.rows + 0.5 - 100) / 95
    # By the pixels' centres; one row of pixels is 0.011 of the radius.
    assert np.sqrt(1 - distance.max() ** 2) == pytest.approx(MIN_COS_EXITANT, abs=0.005)
    assert np.sqrt(1 - distance.max() ** 2) >= MIN_COS_EXITANT


def test_a_budget_draws_evenly_and_the_same_again(flat_ball):
    image = picture()
    whole = sample_sphere(flat_ball, FLAT, image, None, None, rng())
    some = sample_sphere(flat_ball, FLAT, image, None, 300, rng())
    again = sample_sphere(flat_ball, FLAT, image, None, 300, rng())
    assert len(some) == 300
    for name in ("rows", "columns", "radiance", "variance", "ray_sample", "normals", "views"):
        assert_array_equal(getattr(some, name), getattr(again, name))
    # No pixel twice, all of them usable, each with its own radiance.
    pixels = set(zip(some.rows, some.columns, strict=True))
    assert len(pixels) == 300
    assert pixels <= set(zip(whole.rows, whole.columns, strict=True))
    assert_array_equal(some.radiance, image.radiance[some.rows, some.columns])
    # Even: the mean position is the whole's, to four standard errors of 300 draws.
    for name in ("rows", "columns"):
        spread = getattr(whole, name).std() / np.sqrt(300)
        assert abs(getattr(some, name).mean() - getattr(whole, name).mean()) < 4 * spread
    # Another seed draws others; a budget that is not reached changes nothing.
    other = sample_sphere(flat_ball, FLAT, image, None, 300, np.random.default_rng(7))
    assert set(zip(other.rows, other.columns, strict=True)) != pixels
    assert_array_equal(sample_sphere(flat_ball, FLAT, image, None, 10**6, rng()).rows, whole.rows)


def test_nothing_usable_is_an_empty_field(flat_ball):
    blank = np.ones((HEIGHT, WIDTH, 3))
    burnt = RadianceImage(blank, blank, np.ones((HEIGHT, WIDTH), bool))
    samples = sample_sphere(flat_ball, FLAT, burnt, None, 10, rng())
    assert len(samples) == 0
    assert samples.cos_exitant.shape == (0,)
    assert samples.sample_normals.shape == (0, 3)


def test_lengths_must_agree():
    good = {
        "rows": np.zeros(2, int),
        "columns": np.zeros(2, int),
        "radiance": np.zeros((2, 3)),
        "variance": np.zeros((2, 3)),
        "weight": np.ones(2),
        "ray_sample": np.arange(2),
        "positions": np.zeros((2, 3)),
        "reflected_visible": np.ones(2, bool),
        "sources_visible": np.ones((2, 1), bool),
        "normals": np.zeros((2, 3)),
        "views": np.zeros((2, 3)),
    }
    field = LightField(**good)
    with pytest.raises(ValueError, match="read-only"):
        field.normals[0] = 1
    with pytest.raises(ValueError, match="radiance has 3 entries for 2 samples"):
        LightField(**(good | {"radiance": np.zeros((3, 3))}))
    with pytest.raises(ValueError, match="normals has 1 entries for 2 rays"):
        LightField(**(good | {"normals": np.zeros((1, 3))}))


def test_photographs_of_which_all_pixels_are_taken_join_those_that_were_drawn_from(flat_ball):
    whole = sample_sphere(flat_ball, FLAT, picture(), None, None, rng())
    drawn = replace(whole, stands_for=np.linspace(0.5, 1.5, len(whole)))
    for first, second in ((whole, drawn), (drawn, whole)):
        together = joined([first, second])
        assert_array_equal(together.shares, np.concatenate([first.shares, second.shares]))
        assert_array_equal(
            together.sample_normals, np.concatenate([first.sample_normals, second.sample_normals])
        )
    assert joined([whole, whole]).stands_for is None


def test_merged_rays_are_means_over_squares_that_turn_little(flat_ball):
    samples = sample_sphere(flat_ball, FLAT, picture(), None, None, rng())
    counts = np.bincount(samples.ray_sample)
    assert samples.merged(1e-6).ray_sample.tolist() == samples.ray_sample.tolist()
    one = samples.merged(10.0)
    assert len(one.ray_sample) == len(samples)
    assert_allclose(one.positions, samples.mean_over_rays(samples.positions))
    mean = samples.sample_normals
    assert_allclose(one.normals, mean / np.linalg.norm(mean, axis=1, keepdims=True))
    # 1/20 radians per pixel face on, and up to six times as much at the outline: 4 x 4 rays become 2 x 2, or stay.
    half = samples.merged(0.1)
    left = np.bincount(half.ray_sample)
    assert set(zip(counts.tolist(), left.tolist(), strict=True)) == {(4, 1), (16, 1), (16, 4), (16, 16)}
    finest = np.flatnonzero((counts == 16) & (left == 4))[0]
    rays, merged = samples.positions[samples.ray_sample == finest], half.positions[half.ray_sample == finest]
    # Rays come row by row.
    squares = rays.reshape(2, 2, 2, 2, 3).mean(axis=(1, 3)).reshape(4, 3)
    assert_allclose(merged, squares)
    assert_allclose(half.mean_over_rays(half.positions), samples.mean_over_rays(samples.positions))


def test_few_rays_are_one_of_each_row_and_column(flat_ball):
    body = SphereBody(flat_ball)
    smooth = samples_at(body, FLAT, picture(), *body_pixels(body, FLAT), NO_SOURCES)
    assert smooth.with_few_rays() is smooth
    samples = replace(smooth, faces=np.zeros(len(smooth.ray_sample), int))
    few = samples.with_few_rays()
    counts, left = np.bincount(samples.ray_sample), np.bincount(few.ray_sample)
    # Grids of two by two stay whole.
    assert_array_equal(left, np.where(counts == 16, 4, counts))
    for sample in np.flatnonzero(counts == 16)[:20]:
        all_, own = (each.positions[each.ray_sample == sample] for each in (samples, few))
        for axis in (0, 1):
            assert_allclose(np.sort(own[:, axis]), np.unique(all_[:, axis].round(9)), atol=1e-8)
    # Of what varies linearly over a pixel the mean is the same.
    places = [each.mean_over_rays(each.positions[:, :2]) for each in (samples, few)]
    assert_allclose(*places, atol=1e-12)
    assert np.array_equal(few.with_few_rays().ray_sample, few.ray_sample)
