"""Estimates of orders and costs against integrals and sums that are done, and against the published numbers."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.polynomial.legendre import leggauss, legvander
from numpy.testing import assert_allclose

from invrender.prefilter.complexity import (
    angular_cost,
    crossover,
    frequency_cost,
    measured_crossover,
    microfacet_order,
    phong_order,
    phong_width,
)

# [R02, table 5.4].
EXPONENTS = [8, 16, 32, 64, 128, 256, 512]
RATIOS = [830.6, 333.6, 137.1, 52.6, 21.9, 7.7, 3.3]


def order_by_quadrature(lobe, end: float, epsilon: float, l_max: int = 100) -> int:
    """The least degree up to which Legendre coefficients of a lobe of theta < end hold 1 - epsilon of its energy."""
    node, weight = leggauss(300)
    z = (1 + np.cos(end)) / 2 + (1 - np.cos(end)) / 2 * node
    weight, values = weight * (1 - np.cos(end)) / 2, lobe(np.arccos(z))
    degrees = np.arange(l_max + 1)
    power = (legvander(z, l_max).T @ (weight * values)) ** 2 * (2 * degrees + 1) / 2
    return int(np.argmax(np.cumsum(power) >= (1 - epsilon) * (weight @ values**2)))


@pytest.mark.parametrize("epsilon", [0.01, 0.03, 0.1])
def test_orders_of_phongs_lobe_are_within_one_of_those_by_quadrature(epsilon: float):
    for s in EXPONENTS:
        exact = order_by_quadrature(lambda theta, s=s: np.cos(theta) ** s, np.pi / 2, epsilon)
        assert abs(np.ceil(phong_order(s, epsilon)) - exact) <= 1, (s, exact)


@pytest.mark.parametrize("epsilon", [0.01, 0.03])
def test_orders_of_microfacets_seen_from_the_normal_are_within_one_of_those_by_quadrature(epsilon: float):
    for sigma in (0.05, 0.1, 0.2, 0.3):
        exact = order_by_quadrature(
            lambda theta, sigma=sigma: np.exp(-((theta / 2 / sigma) ** 2)), np.pi / 2, epsilon
        )
        assert abs(np.ceil(microfacet_order(sigma, epsilon)) - exact) <= 1, (sigma, exact)


def test_orders_over_all_views_are_up_to_twice_as_high():
    """[R02, table 5.5]."""
    published = {0.1: 24, 0.2: 12, 0.3: 7, 0.4: 5, 0.5: 5}
    for sigma, order in published.items():
        assert 1 <= order / microfacet_order(sigma, 0.03) < 2


@pytest.mark.parametrize("s", [8, 64, 512])
def test_the_width_of_phongs_lobe_is_that_of_the_cap_that_holds_it(s: int):
    for epsilon in (0.01, 0.05):
        width = float(phong_width(s, epsilon))
        # A cap of the sphere's share W goes down to cos theta = 1 - 2 W.
        cos = np.linspace(0, 1, 200_001)
        values = cos**s
        outside = np.trapezoid(values[cos <= 1 - 2 * width], cos[cos <= 1 - 2 * width])
        assert outside / np.trapezoid(values, cos) == pytest.approx(epsilon, rel=0.01)
        assert width == pytest.approx(-np.log(epsilon) / (2 * s), rel=4 / s)


def test_costs_are_equal_at_the_crossover():
    assert crossover(100) == pytest.approx(464, abs=0.5)  # [R02, section 5.6.4]
    for size in (32, 128):
        s = crossover(size)
        assert_allclose(angular_cost(s, size), frequency_cost(s, size))
        assert angular_cost(2 * s, size) < frequency_cost(2 * s, size)
        assert angular_cost(s / 2, size) > frequency_cost(s / 2, size)


def test_the_papers_times_cross_beyond_the_prediction():
    """[R02, section 5.6.4]: "the practical value of s* is actually even higher than predicted"."""
    found = measured_crossover(EXPONENTS, RATIOS)
    assert crossover(128) < found < 2000
    # Between measured ones; of a pure power law exactly.
    assert measured_crossover([1, 10, 100], [100, 10, 0.1]) == pytest.approx(10**1.5)
    assert measured_crossover([10, 40], [64, 8]) == pytest.approx(160)


def test_times_follow_the_costs_within_the_papers_range():
    """Ratios of table 5.4 fall as s^-1.3, where s^-1.5 is predicted."""
    slope = np.polyfit(np.log(EXPONENTS), np.log(RATIOS), 1)[0]
    predicted = np.polyfit(
        np.log(EXPONENTS), np.log(angular_cost(EXPONENTS, 128) / frequency_cost(EXPONENTS, 128)), 1
    )[0]
    assert predicted == pytest.approx(-1.5)
    assert slope == pytest.approx(-1.33, abs=0.05)


@pytest.mark.parametrize(
    ("call", "message"),
    [
        (lambda: phong_order(0.0, 0.1), "exponent is 0.0; it must be finite and above 0"),
        (lambda: phong_order(8.0, 1.0), "epsilon is 1.0"),
        (lambda: microfacet_order(np.inf, 0.1), "sigma is inf"),
        (lambda: measured_crossover([8, 16], [2, 3]), "that fall with the exponent"),
        (lambda: measured_crossover([8], [2]), "two or more"),
    ],
)
def test_what_no_lobe_has_is_refused(call, message: str):
    with pytest.raises(ValueError, match=message):
        call()
