"""The noise model, from residuals whose noise is known."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.testing import assert_allclose

from invrender.estimate.noise import NoiseModel, fit_noise


def simulated(rng: np.random.Generator, noise: NoiseModel, outliers: float) -> tuple[list, list]:
    """Predictions and residuals of three photographs over two decades of radiance."""
    predictions = [0.01 * 100 ** rng.random((4000, 3)) for _ in range(3)]
    residuals = []
    for prediction in predictions:
        residual = np.sqrt(noise.variance(prediction)) * rng.standard_normal(prediction.shape)
        hit = rng.random(prediction.shape) < outliers
        residuals.append(np.where(hit, rng.uniform(-1, 1, prediction.shape), residual))
    return predictions, residuals


@pytest.mark.parametrize(
    ("outliers", "tolerance"),
    [
        # 36,000 residuals in 24 bins: a robust variance is known to 2.3 sqrt(2 / 1500) / 2 per bin, here shared
        # by several bins.
        (0.0, 0.04),
        # 5% outliers lift the median of |residual| by 6.6%.
        (0.05, 0.11),
    ],
)
def test_finds_floor_and_relative_part(outliers: float, tolerance: float, rng):
    truth = NoiseModel(floor=0.002, relative=0.02)
    found = fit_noise(*simulated(rng, truth, outliers))
    assert_allclose([found.floor, found.relative], [truth.floor, truth.relative], rtol=tolerance)


def test_finds_either_part_alone(rng):
    relative = fit_noise(*simulated(rng, NoiseModel(0.0, 0.03), 0.0))
    assert_allclose(relative.relative, 0.03, rtol=0.03)
    assert relative.floor < 1e-4  # a third of the relative noise at the darkest
    floor = fit_noise(*simulated(rng, NoiseModel(0.005, 0.0), 0.0))
    assert_allclose(floor.floor, 0.005, rtol=0.03)
    # The brightest bin's variance is known to 6%, which is what a relative part may add there.
    assert floor.relative < 0.25 * 0.005


def test_scales_with_the_unit_of_radiance(rng):
    predictions, residuals = simulated(rng, NoiseModel(0.002, 0.02), 0.0)
    one = fit_noise(predictions, residuals)
    other = fit_noise([1e4 * p for p in predictions], [1e4 * r for r in residuals])
    assert_allclose([other.floor, other.relative], [1e4 * one.floor, one.relative], rtol=1e-6)


def test_without_noise_nothing_weighs_without_bound(rng):
    predictions, _ = simulated(rng, NoiseModel(0.0, 0.0), 0.0)
    noise = fit_noise(predictions, [np.zeros_like(p) for p in predictions])
    scale = np.sqrt(np.mean(np.concatenate(predictions) ** 2))
    assert_allclose(noise.floor, 1e-4 * scale, rtol=1e-12)
    assert noise.relative == 0


def test_variance_adds_the_two_parts():
    # By hand: 3^2 + (0.04 * 100)^2 = 25.
    assert_allclose(NoiseModel(3.0, 0.04).variance(np.array([100.0, 0.0])), [25.0, 9.0], rtol=1e-15)
