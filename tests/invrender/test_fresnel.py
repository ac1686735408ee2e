"""Fresnel reflection: landmarks of the exact formula, and how well the short sum stands in for it."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.testing import assert_allclose

from invrender.brdf.fresnel import MU_RANGE, FresnelBasis, fresnel_reflectance, normalised_fresnel
from recon.sampling.draw import MIN_COS_EXITANT

INDICES = 1 + np.geomspace(MU_RANGE[0] - 1, MU_RANGE[1] - 1, 77)  # not the basis's own 200


@pytest.mark.parametrize("mu", [1.1, 1.5, 2.4, 4.0])
def test_normal_incidence_grazing_and_brewster(mu: float):
    brewster = np.cos(np.arctan(mu))
    cos = np.array([1.0, 0.0, brewster])
    # At Brewster's angle what is polarised parallel isn't reflected, and refracted and reflected rays are at
    # right angles: perpendicular, (mu^2 - 1) / (mu^2 + 1) in amplitude; half of the light is.
    expected = [((mu - 1) / (mu + 1)) ** 2, 1.0, ((mu**2 - 1) / (mu**2 + 1)) ** 2 / 2]
    assert_allclose(fresnel_reflectance(mu, cos), expected, rtol=1e-12)


@pytest.mark.parametrize("mu", [1.1, 1.5, 2.4, 4.0])
def test_agrees_with_the_formulae_in_sines_and_tangents(mu: float):
    theta = np.radians(np.linspace(1, 89, 89))
    inside = np.arcsin(np.sin(theta) / mu)
    # Fresnel's own form, the law of sines for s and of tangents for p.
    s = np.sin(theta - inside) / np.sin(theta + inside)
    p = np.tan(theta - inside) / np.tan(theta + inside)
    assert_allclose(fresnel_reflectance(mu, np.cos(theta)), (s**2 + p**2) / 2, rtol=1e-11, atol=1e-15)


def test_normalised_to_one_at_normal_exitance_and_flat_for_metals():
    cos = np.linspace(0.0, 1.0, 11)
    assert_allclose([normalised_fresnel(mu, 1.0) for mu in INDICES], np.ones(77), rtol=1e-12)
    assert_allclose(normalised_fresnel(1.5, 0.0), ((1.5 + 1) / (1.5 - 1)) ** 2, rtol=1e-12)
    assert_allclose(normalised_fresnel(None, cos), np.ones(11), rtol=0)


def test_the_short_sum_agrees_with_the_exact_factor():
    basis = FresnelBasis()
    # Denser than the table and off its nodes.
    cos = np.linspace(MIN_COS_EXITANT, 1.0, 3001)
    functions = basis.functions(cos)
    assert functions.shape == (3001, basis.rank)
    indices = [*INDICES, None]
    worst = np.array(
        [np.abs(functions @ basis.coefficients(mu) / normalised_fresnel(mu, cos) - 1).max() for mu in indices]
    )
    assert worst.shape == (78,)
    assert worst.max() < 3.5e-3  # documented: 0.3%, at the corner of the range, mu = 1.1 seen at 81 degrees
    assert worst[INDICES.searchsorted(1.2) :].max() < 5e-4  # "and far less within"; without Fresnel, too
