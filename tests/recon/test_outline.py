from __future__ import annotations

import numpy as np
from numpy.testing import assert_allclose

from recon.sphere.outline import largest_blob, mask_silhouette, outline_points


def disc(width: int, height: int, x: float, y: float, radius: float, n: int) -> np.ndarray:
    """Coverage (height, width) of a disc, from n x n points in each pixel."""
    across = (np.arange(width * n) + 0.5) / n - x
    down = (np.arange(height * n) + 0.5) / n - y
    inside = across**2 + down[:, None] ** 2 < radius**2
    return inside.reshape(height, n, width, n).mean(axis=(1, 3), dtype=np.float32)


def test_a_straight_edge_is_found_where_it_is():
    # A half plane whose edge lies at x = 4.3: pixel 4 (from 4 to 5) is covered by 0.7.
    coverage = np.tile(np.array([0, 0, 0, 0, 0.7, 1, 1, 1], np.float32), (5, 1))
    points = outline_points(coverage)
    assert_allclose(points, np.column_stack([np.full(5, 4.3), np.arange(5) + 0.5]), atol=1e-6)  # float32
    # Its transpose is the same edge in y, its complement the same edge.
    assert_allclose(outline_points(coverage.T)[:, ::-1], points, atol=1e-15)
    assert_allclose(outline_points(1 - coverage), points, atol=1e-6)
    # A binary mask's edge lies between the pixels.
    assert_allclose(outline_points((coverage >= 0.5).astype(np.float32))[:, 0], 4.0, atol=1e-15)
    # A feathered one's where it passes one half, far from any pixel that is wholly inside or outside.
    ramp = np.tile((np.arange(20, dtype=np.float32) + 0.5 - 9.3) / 14 + 0.5, (5, 1))
    assert_allclose(outline_points(ramp)[:, 0], 9.3, atol=1e-5)


def test_slanted_edges_are_exact_at_every_angle():
    # The covered share of a pixel by a half plane, by 400 x 400 points: 1e-3 or so.
    for angle in np.radians([0, 10, 30, 44, 46, 75, 90, 130, 200, 290]):
        normal = np.array([np.cos(angle), np.sin(angle)])
        steps = (np.arange(12 * 60) + 0.5) / 60
        inside = steps * normal[0] + steps[:, None] * normal[1] < normal @ [6.2, 5.9]
        points = outline_points(inside.reshape(12, 60, 12, 60).mean(axis=(1, 3), dtype=np.float32))
        assert len(points) >= 6  # but for those near the image's edge
        assert np.abs((points - [6.2, 5.9]) @ normal).max() < 0.01  # 60 x 60 points per pixel


def test_the_outline_of_a_disc_lies_on_the_circle():
    rng = np.random.default_rng(0)
    for _ in range(10):
        x, y, radius = 30 + rng.uniform(-1, 1), 20 + rng.uniform(-1, 1), rng.uniform(10, 15)
        for n, tolerance in ((1, 0.5), (8, 0.06)):
            points = outline_points(disc(60, 40, x, y, radius, n))
            distance = np.hypot(points[:, 0] - x, points[:, 1] - y) - radius
            # Binary: half a pixel to either side. Antialiased: 8 x 8 points are half a pixel of an eighth of the size.
            assert np.abs(distance).max() <= tolerance
            # Free of bias: 70 points of standard deviation 0.27 (0.02) px; three standard errors, and the means over
            # pixels' widths, 0.05 / radius.
            assert abs(distance.mean()) < (0.1 if n == 1 else 0.01)
            # All around, one per row or column: a circle's side to 45 degrees.
            assert abs(len(points) - 4 * np.sqrt(2) * radius) <= 8


def test_a_silhouettes_points_are_free_of_their_pixels_width():
    # 0.05 / 12 px too small, were it not mended.
    x, y, radius = 30.2, 20.4, 12.3
    silhouette = mask_silhouette(disc(60, 40, x, y, radius, 64))
    distance = np.hypot(*(silhouette.points - [x, y]).T) - radius
    assert abs(distance.mean()) < 0.0005  # the error of 64 x 64 points
    assert (silhouette.covered == (disc(60, 40, x, y, radius, 64) >= 0.5)).all()


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
