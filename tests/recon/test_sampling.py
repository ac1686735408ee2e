"""Which pixels are sampled: spread over normals, trusted by how clear they are, with the visibility of their lights."""

from __future__ import annotations

import numpy as np
from numpy.testing import assert_allclose, assert_array_equal

from capture.arc.gantry import look_at
from capture.camera import Camera
from capture.radiance import RadianceImage
from recon.mesh.bodies import MeshBody, SphereBody
from recon.sampling.budget import draw, spread
from recon.sampling.draw import NO_SOURCES, sample_body

from .bodymeshes import ball_mesh, joined, plate

CAMERA = Camera("PINHOLE", [300.0, 300, 80, 60], 160, 120, look_at([0.9, -2, 0.7], [0, 0, 0], [0, 0, 1]))
ABOVE = Camera("PINHOLE", [200.0, 200, 80, 60], 160, 120, look_at([0, 0, 1], [0, 0, 0], [0, 1, 0]))


def rng(seed: int = 3) -> np.random.Generator:
    return np.random.default_rng(seed)


def picture(saturated: np.ndarray | None = None) -> RadianceImage:
    noise = rng(1).random((120, 160, 3)).astype(np.float32)
    return RadianceImage(noise, noise**2, np.zeros((120, 160), bool) if saturated is None else saturated)


def test_a_budget_is_spread_over_the_normals():
    # Nine in ten normals point one way, the rest all over the sphere.
    flat = np.tile([0.0, 0, 1], (9000, 1))
    around = rng().normal(size=(1000, 3))
    normals = np.concatenate([flat, around / np.linalg.norm(around, axis=1, keepdims=True)])
    chosen = spread(normals, 600, rng())
    assert_array_equal(chosen, np.unique(chosen))
    assert len(chosen) == 600
    # 512 cells for 600: the flat part's own cell gets one or two, or a few once small cells are used up.
    assert (chosen < 9000).sum() < 10
    # What there is to have is had, each once; and the same again.
    assert_array_equal(spread(normals, 10_000, rng()), np.arange(10_000))
    assert_array_equal(spread(normals, 600, rng()), chosen)


def test_a_spread_draws_from_all_of_a_cell():
    normals = np.tile([0.0, 0.6, 0.8], (1000, 1))
    counts = sum(np.bincount(spread(normals, 100, rng(seed)), minlength=1000) for seed in range(200))
    # Each is drawn in a tenth of 200 draws: 20, with a standard deviation of 4.2.
    assert 20 - 5 * 4.2 < counts.min() <= counts.max() < 20 + 5 * 4.2


def test_samples_of_a_mesh_are_those_of_the_sphere_it_stands_for(ball):
    sources = np.array([[0.0, -1, 0], [0, 1.0, 0]])
    exact = sample_body(SphereBody(ball([0, 0, 0], 0.3)), CAMERA, picture(), None, sources, None, rng())
    mesh = MeshBody(ball_mesh((0, 0, 0), 0.3, 6))
    found = sample_body(mesh, CAMERA, picture(), None, sources, None, rng())
    # One piece of surface a pixel further on: the mesh has the sphere's pixels, but for a ring at the rim.
    one, other = (set(zip(field.rows, field.columns, strict=True)) for field in (exact, found))
    assert other <= one
    assert len(other) > 0.93 * len(one)
    both = exact.where(np.array([pixel in other for pixel in zip(exact.rows, exact.columns, strict=True)]))
    assert_array_equal(both.radiance, found.radiance)
    assert_array_equal(both.variance, found.variance)
    assert_allclose(found.sample_normals, both.sample_normals, atol=2e-3, equal_nan=False)  # 4 rays or 1
    assert_allclose(found.cos_exitant, both.cos_exitant, atol=2e-3, equal_nan=False)
    # A convex body hides no mirrored ray from itself, and a source only below its horizon.
    assert found.reflected_visible.all()
    assert both.reflected_visible.all()
    cos = found.normals @ sources.T
    away = np.abs(cos) > 0.02  # facets turn by that much from the smooth surface
    assert_array_equal(found.sources_visible[away], cos[away] > 0)


def test_faces_and_weights_give_back_the_positions():
    body = MeshBody(ball_mesh((0, 0, 0), 0.3, 3))
    found = sample_body(body, CAMERA, picture(), None, NO_SOURCES, 500, rng())
    assert len(found) == 500
    assert found.faces is not None
    corners = body.mesh.vertices[body.mesh.faces[found.faces]]
    positions = np.einsum("nk,nkc->nc", found.corner_weights, corners)
    assert_allclose(positions, found.positions, atol=1e-12, equal_nan=False)
    pixels = CAMERA.project(found.positions)
    assert_allclose(
        found.mean_over_rays(pixels),
        np.column_stack([found.columns, found.rows]) + 0.5,
        atol=1e-6,
        equal_nan=False,
    )


def test_weight_falls_towards_grazing_and_beside_what_is_unclear():
    saturated = np.zeros((120, 160), bool)
    saturated[60, 80] = True
    mask = np.ones((120, 160), np.float32)
    mask[:, 100:] = 0
    floor = MeshBody(plate((-0.5, -0.5, 0.0), (1, 0, 0), (0, 1, 0)))
    found = sample_body(floor, ABOVE, picture(saturated), mask, NO_SOURCES, None, rng())
    assert not ((found.rows == 60) & (found.columns == 80)).any()
    assert found.columns.max() == 98  # 99 has the mask's border beside it
    near_clipped = np.maximum(np.abs(found.rows - 60), np.abs(found.columns - 80)) <= 3
    unclear = near_clipped | (found.columns >= 97)
    assert_array_equal(found.weight, np.where(unclear, 0.5, 1.0))
    # On a sphere, the weight is what the exitant angle makes it: 0 at a cosine of 0.15, 1 from 0.3 on.
    ball = MeshBody(ball_mesh((0, 0, 0), 0.3, 6))
    found = sample_body(ball, CAMERA, picture(), None, NO_SOURCES, None, rng())
    full = np.clip((found.cos_exitant - 0.15) / 0.15, 0, 1)
    off = np.minimum(np.abs(found.weight - full), np.abs(found.weight - full / 2))
    assert off.max() < 0.05  # the cosine at the pixel's centre against its mean
    assert (found.weight < 0.5).sum() > 20


def test_visibility_is_told_where_the_object_hides_its_light_from_itself():
    # A floor and a wall of 0.1 m along x = 0; the source comes over the wall at 45 degrees.
    body = MeshBody(
        joined(
            plate((-0.4, -0.2, 0.0), (0.8, 0, 0), (0, 0.4, 0)),
            plate((0.0, -0.2, 0.0), (0, 0.4, 0), (0, 0, 0.1)),
        )
    )
    source = np.array([[-(0.5**0.5), 0, 0.5**0.5]])
    found = sample_body(body, ABOVE, picture(), None, source, None, rng())
    x = found.positions[:, 0]
    on_floor = found.positions[:, 2] < 1e-6
    assert on_floor.all()  # the wall is seen edge-on
    assert_array_equal(found.sources_visible[:, 0], ~((x > 0) & (x < 0.1)))
    # The mirrored ray of a point at x > 0 leaves to the right, away from the wall; from the left it leaves leftwards.
    assert found.reflected_visible.all()
    low = Camera("PINHOLE", [200.0, 200, 80, 60], 160, 120, look_at([1, 0, 0.5], [0.1, 0, 0], [0, 0, 1]))
    seen = sample_body(body, low, picture(), None, source, None, rng())
    x, z = seen.positions[:, 0], seen.positions[:, 2]
    floor = (z < 1e-6) & (x > 0.004) & (np.abs(seen.positions[:, 1]) < 0.15)
    # It climbs towards the wall as steeply as the view comes in: where it passes over its top, it is free.
    height_at_wall = x * seen.views[:, 2] / seen.views[:, 0]
    assert floor.sum() > 100
    assert_array_equal(seen.reflected_visible[floor], height_at_wall[floor] > 0.1)


def test_sums_over_drawn_samples_are_unbiased_whatever_they_tell() -> None:
    normals = rng().standard_normal((5000, 3))
    normals /= np.linalg.norm(normals, axis=1, keepdims=True)
    # A highlight, which a hundredth of the samples shows.
    telling = np.exp(-((np.arccos(np.clip(normals[:, 2], -1, 1)) / 0.2) ** 2))
    value = 1 + 50 * telling
    generator = np.random.default_rng(0)
    found, counts = [], []
    for _ in range(300):
        taken, shares = draw(normals, telling, 500, generator, np.ones(len(normals)))
        assert len(np.unique(taken)) == len(taken)
        found.append((shares * value[taken]).mean())
        counts.append(len(taken))
    even = [value[spread(normals, 500, generator)].mean() for _ in range(300)]
    # Of 300 draws the mean is known to a seventeenth of one's scatter; normalised shares are off by a share of 1/500.
    scatter = np.std(found) + np.std(even)
    assert abs(np.mean(found) - np.mean(even)) < 4 * scatter / np.sqrt(300)
    # What is drawn by what it tells is known the better for it: several times in variance.
    assert np.std(found) < 0.6 * np.std(even)
    assert np.abs(np.array(counts) - 500).max() < 25
