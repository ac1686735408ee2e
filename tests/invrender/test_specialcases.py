"""Coefficients of special cases, against the integrals that define them and against what the papers claim of them."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest
from numpy.testing import assert_allclose
from scipy.integrate import quad
from scipy.special import eval_legendre, gammaln, sph_harm_y

from invrender.theory.specialcases import (
    microfacet_gaussian,
    microfacet_gaussian_reach,
    microfacet_transfer,
    mirror_coefficients,
    phong_gaussian,
    phong_transfer,
    pole_source_coefficients,
)
from recon.harmonics.basis import clamped_cosine_transfer


def test_a_mirror_turns_light_by_half_about_the_normal(rng):
    rho = mirror_coefficients(4)
    theta, phi = rng.uniform(0, np.pi / 2, 6), rng.uniform(0, 2 * np.pi, 6)
    for l in range(5):
        for m in range(-l, l + 1):
            # The integral of Y_lm against rho^ = sum rho_lpq conj(Y_lq(incident)) Y_pq(exitant) leaves q = m.
            seen = sum(rho[l, p, abs(m)] * sph_harm_y(p, m, theta, phi) for p in range(abs(m), 5))
            assert_allclose(seen, sph_harm_y(l, m, theta, phi + np.pi), atol=1e-14, equal_nan=False)
    l, p, q = np.indices(rho.shape)
    assert rho.shape == (5, 5, 5)
    assert not rho[q > np.minimum(l, p)].any()


def test_a_source_at_the_pole_has_the_harmonics_values_there():
    expected = [sph_harm_y(l, m, 0.0, 0.0).real for l in range(12) for m in range(-l, l + 1)]
    assert_allclose(pole_source_coefficients(11), expected, rtol=1e-13, atol=1e-15, equal_nan=False)


@pytest.mark.parametrize("shininess", [0.3, 1.0, 2.7, 8.0, 8.5])
def test_phong_is_its_integral_where_degrees_exceed_the_shininess(shininess: float):
    # (s + 1) times the integral of u^s P_l(u), the power being a weight of the rule.
    expected = [
        (shininess + 1)
        * quad(lambda u, l=l: eval_legendre(l, u), 0, 1, weight="alg", wvar=(shininess, 0), limit=200)[0]
        for l in range(26)
    ]
    assert_allclose(phong_transfer(shininess, 25), expected, atol=1e-12, equal_nan=False)  # of quad


@pytest.mark.parametrize("shininess", [32.0, 100.5, 512.0, 1e4])
def test_phong_is_its_integral_for_sharp_lobes(shininess: float):
    end = min(np.pi / 2, 9 / np.sqrt(shininess))  # beyond, cos^s < e^-40
    node, weight = np.polynomial.legendre.leggauss(400)
    theta = (node + 1) * end / 2
    values = (shininess + 1) * np.cos(theta) ** shininess * np.sin(theta) * weight * end / 2
    expected = eval_legendre(np.arange(201)[:, None], np.cos(theta)) @ values
    # Rounding of cos theta, l^2 times; cos^s to the horizon for the smallest s.
    assert_allclose(phong_transfer(shininess, 200), expected, atol=2e-12, equal_nan=False)


def test_phong_of_shininess_1_is_the_clamped_cosine():
    assert_allclose(phong_transfer(1, 40), clamped_cosine_transfer(40) / np.pi, rtol=1e-12, atol=1e-16)


def test_an_integer_shininess_ends_the_degrees_of_its_parity():
    transfer = phong_transfer(8, 40)
    assert not transfer[10::2].any()
    # The odd ones go on, alternating: (s - l + 2) is negative from l = 11 on.
    assert (np.sign(transfer[11::2]) == np.resize([-1, 1], 15)).all()
    assert (np.sign(phong_transfer(8.5, 17)[10:]) == [1, -1, -1, 1, 1, -1, -1, 1]).all()


def test_phong_falls_off_at_the_root_of_the_shininess():
    # [RH01, fig. 5]: exp(-1/2) = 0.607 at l = sqrt(s), exp(-2) = 0.135 at twice that, the better the larger s.
    for shininess, off in [(8, 0.06), (32, 0.05), (128, 0.03), (512, 0.015)]:
        root = np.sqrt(shininess)
        exact = np.interp([root, 2 * root], np.arange(100), phong_transfer(shininess, 99))
        assert_allclose(exact, np.exp([-0.5, -2.0]), atol=off)
        assert_allclose(phong_gaussian(shininess, 99)[[0, 6]], [1, np.exp(-18 / shininess)], rtol=1e-14)


def test_eq_19_is_off_by_l_over_2s_and_the_appendixs_next_term_is_not_what_it_lacks():
    for shininess in (32.0, 512.0, 1e4):
        l = np.arange(1, int(np.sqrt(shininess)) + 1)
        exact = np.log(phong_transfer(shininess, l[-1])[1:])
        assert_allclose(exact, -l * (l + 1) / (2 * shininess + 3), atol=0.13 * l[-1] ** 4 / shininess**3)
        off = exact + l**2 / (2 * shininess)
        assert_allclose(off, -l / (2 * shininess), atol=1.2 / shininess)
        # Printed: log = -l^2 (1/2s - 1/2s^2); its own gamma functions have 1/2s + 1/2s^2.
        printed = -(l**2) * (1 / (2 * shininess) - 1 / (2 * shininess**2))
        assert (np.abs(exact - printed) > np.abs(off)).all()
        half = shininess / 2
        gammas = 2 * gammaln(half) - gammaln(half - l / 2) - gammaln(half + l / 2)
        second = (gammas + l**2 / (2 * shininess)) * 2 * shininess**2 / l**2
        assert_allclose(second[-1], -1, atol=0.2)
    # So its largest error is l / 2s exp(-l^2 / 2s) at l = sqrt(s): 0.303 / sqrt(s).
    errors = np.abs(phong_gaussian(1e4, 400) - phong_transfer(1e4, 400))
    assert_allclose(errors.max() * 100, np.exp(-0.5) / 2, rtol=0.02)
    assert 95 <= errors.argmax() <= 105


SIGMAS = [0.02, 0.05, 0.1, 0.2, 0.3, 0.4, 0.5, 0.6, 0.7]


@pytest.mark.parametrize("sigma", SIGMAS)
def test_microfacet_is_its_integral(sigma: float):
    # [RH01, eq. 27], adaptively.
    def expected(l: int) -> float:
        def integrand(theta: float) -> float:
            density = np.exp(-((theta / 2 / sigma) ** 2)) / (4 * np.pi * sigma**2)
            return 2 * np.pi * density * eval_legendre(l, np.cos(theta)) * np.sin(theta)

        end = min(np.pi / 2, 14 * sigma)
        return quad(integrand, 0, end, limit=400, epsabs=1e-12, points=[end / 6, end / 3])[0]

    transfer = microfacet_transfer(sigma, 200)
    for l in (0, 1, 2, 7, 30, 101, 200):
        assert abs(transfer[l] - expected(l)) < 1e-11  # of quad, and rounding of cos theta, l^2 times


def test_a_smooth_surface_is_a_mirror():
    assert_allclose(microfacet_transfer(1e-5, 50), np.ones(51), atol=51 * 50 * 1e-10 + 1e-9)


def test_eq_20_is_off_by_sigma_squared_l_at_low_degrees():
    for sigma in (0.02, 0.05, 0.1):
        l = np.arange(int(0.2 / sigma) + 1)
        off = microfacet_gaussian(sigma, l[-1]) - microfacet_transfer(sigma, l[-1])
        assert_allclose(off, sigma**2 * (l + 2 / 3), rtol=0.07)
        # Far from the appendix's O((sigma l)^4).
        assert off[-1] > 2 * (sigma * l[-1]) ** 4


@pytest.mark.parametrize("sigma", SIGMAS)
def test_the_measured_errors_of_eq_20_are_as_stated(sigma: float):
    l = np.arange(int(8 / sigma))
    exact, gaussian = microfacet_transfer(sigma, l[-1]), microfacet_gaussian(sigma, l[-1])
    off = np.abs(gaussian - exact)
    if sigma <= 0.5:
        assert 0.43 < off.max() / sigma < 0.465
        assert 0.35 <= sigma * off.argmax() < 0.75
    else:
        assert_allclose([off[0], off.max()], {0.6: 0.295, 0.7: 0.393}[sigma], atol=0.001)
    if sigma <= 0.3:
        assert np.abs(exact - np.exp(-(sigma**2) * (l * (l + 1) + 2 / 3))).max() < 0.13 * sigma**2
    if sigma <= 0.2:
        at = round(2 / sigma)
        assert_allclose(exact[at] / gaussian[at], np.exp(-(sigma**2) * at), rtol=0.05)
    tail = np.abs(exact[l > 3 / sigma]).max()
    assert tail < {0.4: 0.002, 0.5: 0.006, 0.6: 0.014, 0.7: 0.0171}.get(sigma, 2e-4)


def test_the_reach_of_eq_20_is_the_last_degree_before_the_first_that_is_off():
    # By hand from the leading error sigma^2 (l + 2/3): 0.0025 (l + 2/3) <= 0.01 up to l = 3.33.
    assert microfacet_gaussian_reach(0.05, 0.01, 100) == 3
    assert microfacet_gaussian_reach(0.05, 0.01, 2) == 2
    # 0.46 sigma is never reached with sigma = 0.1 and 0.05, nor 0.02 with 0.045; sigma = 0.2 is off at once.
    assert microfacet_gaussian_reach(0.1, 0.05, 100) == 100
    assert microfacet_gaussian_reach(0.045, 0.02, 200) == 200
    assert [microfacet_gaussian_reach(sigma, 0.02, 200) for sigma in (0.05, 0.1, 0.2)] == [9, 1, -1]


@pytest.mark.parametrize(
    "transfer", [phong_transfer, phong_gaussian, microfacet_transfer, microfacet_gaussian]
)
def test_degree_0_alone_is_the_beginning_of_more(transfer: Callable):
    assert_allclose(transfer(0.4, 0), transfer(0.4, 5)[:1], rtol=1e-14)


@pytest.mark.parametrize("value", [0, -1.5, np.nan, np.inf])
def test_widths_that_are_none_are_refused(value: float):
    for transfer, name in [
        (phong_transfer, "shininess"),
        (phong_gaussian, "shininess"),
        (microfacet_transfer, "sigma"),
        (microfacet_gaussian, "sigma"),
        (lambda tolerance, l_max: microfacet_gaussian_reach(0.1, tolerance, l_max), "tolerance"),
    ]:
        with pytest.raises(ValueError, match=f"{name} is {value}; it must be a finite number above 0"):
            transfer(value, 3)


def test_degrees_below_0_are_refused():
    for transfer in (phong_transfer, phong_gaussian, microfacet_transfer, microfacet_gaussian):
        with pytest.raises(ValueError, match="l_max is -1"):
            transfer(0.5, -1)
    for coefficients in (mirror_coefficients, pole_source_coefficients):
        with pytest.raises(ValueError, match="l_max is -1"):
            coefficients(-1)
