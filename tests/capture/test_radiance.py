"""Radiance with its variance, made smaller."""

from __future__ import annotations

import numpy as np
from numpy.testing import assert_allclose, assert_array_equal

from capture.radiance import RadianceImage


def test_binned_pixels_are_means_and_their_noise_is_that_of_means():
    rng = np.random.default_rng(0)
    variance = np.linspace(1, 9, 3 * 302 * 401, dtype=np.float32).reshape(302, 401, 3)
    noise = (np.sqrt(variance) * rng.standard_normal(variance.shape)).astype(np.float32)
    saturated = np.zeros((302, 401), bool)
    saturated[[4, 11, 300], [7, 399, 8]] = True
    binned = RadianceImage(noise + 5, variance, saturated).binned(4)
    # Two rows and a column fill no pixel: the saturated pixel among them is gone.
    assert binned.radiance.shape == (75, 100, 3)
    assert_array_equal(np.argwhere(binned.saturated), [[1, 1], [2, 99]])
    assert_allclose(binned.radiance[1, 1], 5 + noise[4:8, 4:8].mean(axis=(0, 1)), rtol=1e-5)
    rows, columns = rng.integers(0, 75, 40), rng.integers(0, 100, 40)
    few = binned.variance_at(rows, columns)
    assert_allclose(few, binned.variance[rows, columns], rtol=1e-5)
    # Of 22,500 draws: four standard errors of their variance are 4%.
    assert_allclose(((binned.radiance - 5) ** 2 / binned.variance).mean(), 1, rtol=0.04)
