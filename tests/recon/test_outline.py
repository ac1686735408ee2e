from __future__ import annotations

import numpy as np
from numpy.testing import assert_allclose

from recon.outline import largest_blob, outline_points


def disc(width: int, height: int, x: float, y: float, radius: float, n: int) -> np.ndarray:
    """Coverage (height, width) of a disc, from n x n points in each pixel."""
    across = (np.arange(width * n) + 0.5) / n - x
    down = (np.arange(height * n) + 0.5) / n - y
    inside = across**2 + down[:, None] ** 2 < radius**2
    return inside.reshape(height, n, width, n).mean(axis=(1, 3), dtype=np.float32)


def test_a_straight_edge_is_found_where_it_is():
    # A half plane whose edge lies at x = 3.3: pixel 3 (from 3 to 4) is covered by 0.7.
    coverage = np.tile(np.array([0, 0, 0, 0.7, 1, 1], np.float32), (5, 1))
    points = outline_points(coverage)
    assert_allclose(points[:, 1], np.arange(5) + 0.5, atol=1e-15)
    # Linear between the centres 2.5 (coverage 0) and 3.5 (coverage 0.7).
    assert_allclose(points[:, 0], 2.5 + 0.5 / 0.7, atol=1e-6)
    # Its transpose is the same edge in y.
    assert_allclose(outline_points(coverage.T)[:, ::-1], points, atol=1e-15)
    # A binary mask's edge lies between the pixels, as does that of its complement.
    for mask in (coverage >= 0.5, coverage < 0.5):
        assert_allclose(outline_points(mask.astype(np.float32))[:, 0], 3.0, atol=1e-15)


def test_the_outline_of_a_disc_lies_on_the_circle():
    rng = np.random.default_rng(0)
    for _ in range(10):
        x, y, radius = 30 + rng.uniform(-1, 1), 20 + rng.uniform(-1, 1), rng.uniform(10, 15)
        for n, tolerance in ((1, 0.5), (8, 0.15)):
            points = outline_points(disc(60, 40, x, y, radius, n))
            distance = np.hypot(points[:, 0] - x, points[:, 1] - y) - radius
            # Binary: half a pixel to either side. Antialiased: interpolation is off by 0.086 at most where
            # the edge is straight and upright; slope, curvature and the 8 x 8 points add to it.
            assert np.abs(distance).max() <= tolerance
            # Free of bias: 100 points of standard deviation 0.29 (0.05) px; three standard errors.
            assert abs(distance.mean()) < (0.09 if n == 1 else 0.015)
            # All around, evenly: a circle crosses 8 r lines of the grid.
            assert abs(len(points) - 8 * radius) <= 8


def test_a_disc_that_the_image_cuts_off_has_no_outline_along_the_cut():
    points = outline_points(disc(40, 40, 35, 20, 12, 8))
    distance = np.hypot(points[:, 0] - 35, points[:, 1] - 20)
    assert np.abs(distance - 12).max() < 0.1
    assert points[:, 0].max() < 40


def test_nothing_and_everything_have_no_outline():
    for value in (0, 1):
        assert outline_points(np.full((5, 6), value, np.float32)).shape == (0, 2)


def test_the_largest_blob_is_the_object_with_its_holes_filled():
    large, small = disc(60, 40, 22, 20, 12, 1), disc(60, 40, 50, 20, 5, 1)
    hole = disc(60, 40, 24, 21, 3, 1)
    photograph = np.repeat((0.02 + 0.5 * large + 0.9 * small - 0.5 * hole)[..., None], 3, axis=2)
    assert (largest_blob(photograph.astype(np.float32)) == large).all()


def test_a_dark_photograph_has_no_blob():
    assert not largest_blob(np.zeros((5, 6, 3), np.float32)).any()
    assert not largest_blob(np.full((5, 6, 3), -1, np.float32)).any()
