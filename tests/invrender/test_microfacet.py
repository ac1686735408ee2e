"""The lobe, and its interpolation in sigma."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.testing import assert_allclose
from scipy.integrate import quad

from invrender.brdf.microfacet import SIGMA_RANGE, sigma_nodes, sigma_weights
from invrender.theory.specialcases import lobe


@pytest.mark.parametrize("sigma", [0.02, 0.1, 0.3, 0.7])
def test_the_lobe_has_unit_volume_over_the_plane(sigma: float):
    # As RH01 has it: a Gaussian in theta_h that is normalised over the tangent plane, not the hemisphere.
    volume, _ = quad(lambda theta: 2 * np.pi * theta * lobe(theta, sigma), 0, 12 * sigma)
    assert_allclose(volume, 1, rtol=1e-9)


def test_width_and_peak_by_hand():
    # exp(-1) at theta_h = sigma; 1 / (pi 0.0144) = 22.1049 on the axis, six digits carried.
    assert_allclose(lobe(np.array([0.0, 0.12]), 0.12), [22.1049, 22.1049 * np.exp(-1)], rtol=1e-5)


def test_interpolated_lobe_agrees_with_the_lobe_at_every_sigma():
    theta = np.concatenate([[0.0], np.geomspace(1e-3, np.pi, 1500)])
    at_nodes = lobe(theta[:, None], sigma_nodes())
    sigmas = np.geomspace(*SIGMA_RANGE, 307)
    interpolated = at_nodes @ np.stack([sigma_weights(sigma) for sigma in sigmas], axis=1)
    exact = lobe(theta[:, None], sigmas)
    errors = np.abs(interpolated - exact) * np.pi * sigmas**2
    assert errors.shape == (1501, 307)
    assert errors.max() < 1e-4  # of the peak, as documented


def test_interpolation_is_exact_at_its_nodes():
    nodes = sigma_nodes()
    # Weights hold ratios of squared nodes, up to 2e4, of which doubles keep sixteen digits.
    assert_allclose([sigma_weights(node) for node in nodes], np.eye(len(nodes)), atol=1e-10, equal_nan=False)
