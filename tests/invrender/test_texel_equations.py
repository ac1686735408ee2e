"""Kd and Ks of single points of a texture: their equations, and paint narrower than pixels."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.testing import assert_allclose
from scipy.optimize import minimize, nnls
from scipy.sparse import csr_array

from invrender.brdf.lobes import GGX_FORM, PLASTICS
from invrender.estimate.models import bounds_of
from invrender.estimate.noise import NoiseModel
from invrender.estimate.textured.joint import solve_joint
from invrender.estimate.textured.search import _about, cost_at, numbers_at, search_point, textured_models
from invrender.estimate.textured.texel_equations import (
    PointValues,
    TexelEquations,
    Usual,
    common_ks,
    determined,
    solve_both,
    solve_kd,
)
from invrender.estimate.textured.texel_grid import Grid, SurfaceTiles
from invrender.estimate.textured.texel_observations import TexelObservations, TexelRows
from invrender.estimate.textured.texel_pixels import PixelsOfPoints, stacked, tiny_sums
from invrender.transport.column_basis import whole_range
from invrender.transport.columns import column_weights
from invrender.transport.diffuse_base import base_columns
from invrender.transport.transfer import LightElement
from synthetic.materials.facets import GGXSlopes
from synthetic.materials.plastic import Plastic
from synthetic.materials.smith import SmithMaterial


def sums_of(d: np.ndarray, s: np.ndarray, y: np.ndarray, weight: np.ndarray) -> TexelEquations:
    """The normal equations of arrays (photographs, points, 3)."""
    products = (d * d, d * s, s * s, d * y, s * y, y * y)
    return TexelEquations(
        *(np.sum(weight * product, axis=0) for product in products), np.full(d.shape[1], float(len(d)))
    )


def test_each_points_kd_and_ks_are_its_own_least_squares(rng: np.random.Generator) -> None:
    photos, points = 5, 40
    d, s, weight = (rng.uniform(0.2, 1, (photos, points, 3)) for _ in range(3))
    # Of a third of the points the best Kd or Ks would be negative.
    truth = rng.uniform(-0.5, 1, (2, points, 3))
    y = truth[0] * d + truth[1] * s + 0.01 * rng.standard_normal(d.shape)
    sums = sums_of(d, s, y, weight)
    found = solve_both(sums)
    for point in range(points):
        for c in range(3):
            root = np.sqrt(weight[:, point, c])
            matrix = np.stack([d[:, point, c], s[:, point, c]], axis=1) * root[:, None]
            best, norm = nnls(matrix, y[:, point, c] * root)
            assert_allclose([found.kd[point, c], found.ks[point, c]], best, atol=1e-9)
            assert_allclose(found.cost[point, c], norm**2, atol=1e-9)
            std = np.sqrt(np.diag(np.linalg.inv(matrix.T @ matrix)))
            assert_allclose([found.kd_std[point, c], found.ks_std[point, c]], std, rtol=1e-9)


def test_one_ks_for_all_points_is_that_of_the_whole_least_squares_problem(rng: np.random.Generator) -> None:
    photos, points = 4, 6
    d, s = (rng.uniform(0.2, 1, (photos, points, 3)) for _ in range(2))
    kd = rng.uniform(0.2, 1, (points, 3))
    y = kd * d + 0.3 * s + 0.01 * rng.standard_normal(d.shape)
    sums = sums_of(d, s, y, np.ones_like(y))
    ks, std = common_ks(sums)
    matrix = np.zeros((photos, points, points + 1))
    matrix[:, np.arange(points), np.arange(points)] = d[:, :, 0]
    matrix[:, :, -1] = s[:, :, 0]
    flat = matrix.reshape(-1, points + 1)
    best = np.linalg.lstsq(flat, y[:, :, 0].ravel(), rcond=None)[0]
    assert_allclose(ks[0], best[-1], rtol=1e-9)
    assert_allclose(std[0], np.sqrt(np.linalg.inv(flat.T @ flat)[-1, -1]), rtol=1e-9)
    assert_allclose(solve_kd(sums, ks).kd[:, 0], best[:-1], rtol=1e-9)


def test_one_photograph_does_not_tell_kd_from_ks() -> None:
    one = np.ones((1, 2, 3))
    found = solve_both(sums_of(one, 0.3 * one, one, one))
    assert np.isinf(found.kd_std).all()
    assert np.isinf(found.ks_std).all()


def test_paint_narrower_than_pixels_is_found_and_its_error_known(rng: np.random.Generator) -> None:
    # A strip of points, each pixel two points wide, wherever it lies; one in four has another paint.
    photos, pixels, points, level = 12, 60, 48, 0.005
    truth = np.where(np.arange(points) % 16 < 4, 0.9, 0.3)[:, None] * [1.0, 0.8, 0.6]
    gloss = np.full((points, 3), 0.2)
    views = []
    for _ in range(photos):
        start = rng.uniform(-1, points - 2, pixels)
        covered = np.clip(np.arange(points) + 1 - start[:, None], 0, 1) * np.clip(
            start[:, None] + 2 - np.arange(points), 0, 1
        )
        covered /= covered.sum(axis=1, keepdims=True)
        d, s = rng.uniform(0.2, 1, (2, pixels, 3))
        seen = d * (covered @ truth) + s * (covered @ gloss)
        y = seen + level * rng.standard_normal(seen.shape)
        one = np.ones_like(y)
        views.append(
            PixelsOfPoints(
                csr_array(covered.astype(np.float32)),
                *(a.astype(np.float32) for a in (d, s, d.max(axis=1), y, one, one / level**2)),
            )
        )
    pairs = np.column_stack([np.arange(points - 1), np.arange(1, points)])
    grid = Grid(np.arange(points) // 2, points // 2, pairs)
    usual = Usual(np.array([*truth.mean(axis=0), 0.2, 0.2, 0.2]), *[truth.mean(axis=0) + 0.2] * 2)
    found = solve_joint(*stacked(views), grid, solve_both, NoiseModel(level, 0.0), usual, 1.0, rng)
    expected = truth.reshape(-1, 2, 3).mean(axis=1)
    for off in ((found.kd - expected) / found.kd_std, (found.ks - 0.2) / found.ks_std):
        assert 0.5 < np.sqrt((off**2).mean()) < 1.3
    # The tiny systems alone blur the paint's edges.
    blurred = solve_both(tiny_sums(views, grid.count, grid.parents))
    assert np.abs(blurred.kd - expected).max() > 3 * np.abs(found.kd - expected).max()


@pytest.mark.parametrize("plastic", [True, False])
def test_paint_under_an_interface_tells_its_index(rng: np.random.Generator, plastic: bool) -> None:
    photos, points, mu, sigma = 6, 300, 1.5, 0.15
    form = PLASTICS[GGX_FORM]
    lobe = len(whole_range().weights(mu, sigma, form))
    kd = rng.uniform(0.1, 0.3, (points, 3))
    rows, printed = [], []
    for _ in range(photos):
        cos_i, cos_o = rng.uniform(0.2, 1, (2, points))
        across = np.sqrt(1 - np.stack([cos_i, cos_o]) ** 2)
        normals = np.broadcast_to([0.0, 0.0, 1.0], (points, 3))
        light, view = (
            np.column_stack([x, np.zeros(points), z]) for x, z in zip(across, (cos_i, cos_o), strict=True)
        )
        base = np.concatenate(
            [
                base_columns(form, LightElement("known", way[None], np.ones((1, 1))), n[None], v[None], None)
                for way, n, v in zip(light, normals, view, strict=True)
            ]
        )[..., 0]
        gloss = rng.uniform(0, 1, (points, lobe))
        seen = 0.05 * (gloss @ whole_range().weights(mu, sigma, form))[:, None]
        below = kd * cos_i[:, None]
        if plastic:
            # By a formula of its own.
            deep = Plastic(SmithMaterial(np.ones(3), np.zeros(3), mu, GGXSlopes(0.1, 0.1)))
            below = below * deep.lobe(light, view)
        seen = seen + below + 1e-3 * rng.standard_normal((points, 3))
        rest = (
            seen,
            np.full_like(seen, 0.1),
            np.ones(points),
            np.zeros(points, int),
        )
        for kind, first in ((rows, base), (printed, cos_i[:, None])):
            columns = np.concatenate([first, gloss], axis=1)[None].astype(np.float32)
            kind.append(TexelRows(np.arange(points), columns, *rest))
    costs = {}
    for kind, own in ((form, rows), (GGX_FORM, printed)):
        stack, model = (
            TexelObservations.of(own, points, NoiseModel(1e-3, 0.0), kind),
            textured_models(kind)[-2],
        )
        found = search_point(model, stack)
        costs[kind] = cost_at(model, stack, found)
        if (kind is form) == plastic:
            # Noise of 1% in some 5,000 numbers, and mu shows in what is let through as in the lobe.
            assert_allclose(found, np.log([sigma, mu - 1]), atol=0.03)
    assert (costs[form] < costs[GGX_FORM]) == plastic


def test_what_is_usual_is_not_moved_by_points_that_are_open(rng: np.random.Generator) -> None:
    kd, ks = rng.uniform(0.1, 0.2, (2, 100, 3))
    std = np.full((100, 3), 0.01)
    values = PointValues(kd, ks, std, std.copy(), np.zeros((100, 3)), np.full(100, 3.0))
    expected = Usual.of(values, values)
    assert_allclose(expected.values, np.concatenate([kd.mean(axis=0), ks.mean(axis=0)]))
    # A fifth hardly says anything, and says it of values that are far off.
    wild = 50.0 * np.ones((20, 3))
    more = PointValues.together(
        120,
        [
            (np.arange(100), values),
            (np.arange(100, 120), PointValues(wild, wild, wild, wild, np.zeros((20, 3)), np.full(20, 1.0))),
        ],
    )
    found = Usual.of(more, more)
    assert_allclose(found.values, expected.values)
    assert_allclose(found.scale, expected.scale, rtol=0.2)
    assert_allclose(found.settled, found.scale)
    assert determined(more, expected.scale).tolist() == [True] * 100 + [False] * 20


@pytest.mark.parametrize("rung", [0, 1, 2], ids=["without Fresnel", "common Ks", "Ks varies"])
def test_steps_of_the_search_are_those_of_its_cost(rng: np.random.Generator, rung: int) -> None:
    """With `made_up_for` in its matrix a step reaches the least cost."""
    model = textured_models(GGX_FORM)[rung]
    truth = np.log([0.15, 0.5])[: 1 + model.fresnel]
    weights = column_weights(*numbers_at(model, truth), GGX_FORM)  # type: ignore[arg-type]
    photos, points, basis = 6, 60, whole_range()
    kd, ks = rng.uniform(0.05, 0.3, (2, points, 3))
    rows = []
    for _ in range(photos):
        # A bell for a lobe, at every sigma that columns hold, times what stands for Fresnel's factor.
        bells = np.exp(-((rng.uniform(0, 0.3, points)[:, None] / basis.sigmas) ** 2)) / basis.sigmas**2
        fresnel = basis.functions(GGX_FORM)(rng.uniform(0.1, 1, points))
        gloss = 0.05 * (fresnel[:, :, None] * bells[:, None]).reshape(points, -1)
        columns = np.concatenate([rng.uniform(0.3, 1, (points, 1)), gloss], axis=1)[None].astype(np.float32)
        d, s = (columns[0] @ weights).T[:, :, None]
        seen = kd * d + (ks if model.ks_varies else 0.2) * s
        seen = seen + 1e-3 * rng.standard_normal(seen.shape)
        one = np.ones_like(seen)
        rows.append(TexelRows(np.arange(points), columns, seen, one, one[:, 0], np.zeros(points, int)))
    stack = TexelObservations.of(rows, points, NoiseModel(1e-3, 0.0), GGX_FORM)
    near = truth + [0.02, -0.03][: len(truth)]
    here = _about(model, stack, near)
    # The cost's own differences; of second order, over a hundredth of the way.
    for axis, pull in zip(1e-3 * np.eye(len(truth)), here.pull, strict=True):
        fall = cost_at(model, stack, near - axis) - cost_at(model, stack, near + axis)
        assert pull == pytest.approx(fall / 4e-3, rel=0.01)
    # A step of Gauss and Newton leads to where a search without slopes ends, but for what is curved.
    lower, upper = bounds_of(model)
    found = search_point(model, stack, near)
    corners = np.vstack([near, near + 0.02 * np.eye(len(near))])
    plain = minimize(
        lambda at: cost_at(model, stack, at),
        near,
        method="Nelder-Mead",
        bounds=list(zip(lower, upper, strict=True)),
        options={"initial_simplex": corners, "xatol": 1e-6, "fatol": 1e-6, "maxfev": 1000},
    ).x
    assert_allclose(near + here.step(0.0), plain, atol=0.2 * np.abs(near - plain).max())
    assert_allclose(found, plain, atol=1e-4)
    # In variances of the noise; columns of single precision tell costs apart to some hundredths.
    assert cost_at(model, stack, found) < cost_at(model, stack, plain) + 0.05
    # From all over: rough starts of a coarse grid lead there, too.
    assert_allclose(search_point(model, stack), plain, atol=1e-4)


def test_tiles_hold_each_point_once_and_about_equally_many(rng: np.random.Generator) -> None:
    positions = rng.normal(size=(5000, 3)) * [3, 1, 0.2]
    tiles = SurfaceTiles.cut(positions, 7)
    held = np.array([tiles.holds(tile, positions) for tile in range(len(tiles))])
    assert (held.sum(axis=0) == 1).all()
    assert held.sum(axis=1).tolist() == pytest.approx([5000 / 7] * 7, abs=3)
    # Wherever else a point lies, it is some tile's, too.
    elsewhere = rng.normal(size=(100, 3)) * 50
    assert (np.sum([tiles.holds(tile, elsewhere) for tile in range(7)], axis=0) == 1).all()
    wider = np.array([tiles.holds(tile, positions, 0.1) for tile in range(len(tiles))])
    near = np.array(
        [
            [np.abs(positions[held[tile]] - other).max(axis=1).min() < 0.1 for other in positions[:50]]
            for tile in range(7)
        ]
    )
    assert (wider[:, :50] | ~near).all()


def test_a_part_of_a_grid_keeps_its_neighbours_and_owners() -> None:
    parents = np.array([0, 0, 1, 1, 2, -1, 3])
    grid = Grid(parents, 5, np.column_stack([np.arange(6), np.arange(1, 7)]))
    part, given = grid.of_points(np.array([2, 3, 5, 6]), np.array([1, 4]))
    # The third and fourth points belong to the second of those given; the fifth of these has none of its own.
    assert given.tolist() == [1, 3, 4]
    assert (part.parents.tolist(), part.count) == ([0, 0, -1, 1], 3)
    assert part.pairs.tolist() == [[0, 1], [2, 3]]
    whole, every = grid.of_points(np.arange(7), np.arange(5))
    assert every.tolist() == [0, 1, 2, 3, 4]
    np.testing.assert_array_equal(whole.parents, parents)
    np.testing.assert_array_equal(whole.pairs, grid.pairs)
