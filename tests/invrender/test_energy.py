"""Energies against integrals of squares, and the accuracy estimates against the errors that they are to bound."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from numpy.testing import assert_allclose
from scipy.special import sph_harm_y

from capture.lighting import latlong_directions, read_latlong
from invrender.prefilter.energy import (
    degree_reaching,
    degrees_reaching,
    energy_fraction,
    isotropic_fraction,
    isotropic_power,
    lighting_energy,
    power_per_degree,
    residual_bound,
    symmetric_power,
)
from invrender.theory.specialcases import phong_transfer
from recon.harmonics.basis import clamped_cosine_transfer
from recon.harmonics.latlong import project_latlong


def sphere_rule(count: int) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """theta, phi and weights that integrate products of degree below 2 count exactly."""
    node, weight = np.polynomial.legendre.leggauss(count)
    theta, phi = np.meshgrid(np.arccos(node), np.arange(2 * count) * np.pi / count, indexing="ij")
    return theta.ravel(), phi.ravel(), np.repeat(weight, 2 * count) * np.pi / count


def test_power_per_degree_is_the_energy_of_each_degrees_part(rng):
    coefficients = rng.normal(size=(36, 3))
    theta, phi, weights = sphere_rule(8)
    for l, power in enumerate(power_per_degree(coefficients)):
        part = np.zeros((len(theta), 3))
        for m in range(-l, l + 1):
            value = sph_harm_y(l, abs(m), theta, phi)
            real = (value.imag if m < 0 else value.real) * (np.sqrt(2) if m else 1)
            part += (-1) ** m * real[:, None] * coefficients[l * l + l + m]
        assert_allclose(power, weights @ part**2, rtol=1e-12)
    assert power_per_degree(coefficients).shape == (6, 3)


def test_energy_of_a_map_is_the_integral_of_its_square():
    # L = (1, z, 2 x): 4 pi, 4 pi / 3 and 4 times that; at pixel centres to second order.
    directions = latlong_directions(64)
    lobes = np.stack([np.ones((64, 128)), directions[..., 2], 2 * directions[..., 0]], axis=-1)
    raised = lobes + np.array([0, 1, 2])  # radiance is not negative: adds 4 pi and 16 pi
    assert_allclose(lighting_energy(raised), 4 * np.pi * np.array([1, 4 / 3, 16 / 3]), rtol=1e-3)
    assert_allclose(lighting_energy(np.full((5, 10, 3), 3.0)), [36 * np.pi] * 3, rtol=1e-14)


def test_the_clamped_cosine_has_more_than_99_percent_of_its_energy_in_9_coefficients():
    # rho_l^2 = A_l^2 (2l + 1) / 4 pi is pi/4, pi/3, 5 pi/64, 0, pi/256; the total is 2 pi/3: 127/128, then 511/512.
    power = symmetric_power(clamped_cosine_transfer(60))
    assert_allclose(power[:5], np.pi * np.array([1 / 4, 1 / 3, 5 / 64, 0, 1 / 256]), rtol=1e-14, atol=1e-16)
    fraction = energy_fraction(power, 2 * np.pi / 3)
    assert_allclose(fraction[:5], [3 / 8, 7 / 8, 127 / 128, 127 / 128, 511 / 512], rtol=1e-14)
    assert 1 - 1e-5 < fraction[-1] < 1
    assert [degree_reaching(fraction, epsilon) for epsilon in (0.5, 0.13, 0.12, 0.01, 0.005)] == [
        1,
        1,
        2,
        2,
        4,
    ]


def test_phongs_energy_is_the_integral_of_its_square():
    # 2 pi times the integral of ((s + 1) / 2 pi)^2 cos^2s sin, which is (s + 1)^2 / (2 pi (2 s + 1)).
    assert_allclose(symmetric_power(phong_transfer(32, 80)).sum(), 33**2 / (2 * np.pi * 65), rtol=1e-9)


def random_isotropic(rng: np.random.Generator, l_max: int, p_max: int) -> np.ndarray:
    rho = rng.normal(size=(l_max + 1, p_max + 1, min(l_max, p_max) + 1))
    l, p, q = np.indices(rho.shape)
    return np.where(q <= np.minimum(l, p), rho, 0.0)


def test_energy_of_an_isotropic_brdf_is_2_pi_times_the_integral_over_three_angles(rng):
    rho = random_isotropic(rng, 4, 3)
    node, weight = np.polynomial.legendre.leggauss(8)
    theta, phi = np.arccos(node), np.arange(12) * np.pi / 6
    value = np.zeros((8, 8, 12), complex)
    for l in range(5):
        for p in range(4):
            for q in range(-min(l, p), min(l, p) + 1):
                incident = sph_harm_y(l, q, theta, 0.0).conj()[:, None, None]
                exitant = sph_harm_y(p, q, theta[:, None], phi)[None]
                value += rho[l, p, abs(q)] * incident * exitant
    assert np.abs(value.imag).max() < 1e-12
    # [R02, eq. 5.18] as printed.
    energy = 2 * np.pi * np.einsum("iof,i,o->", value.real**2, weight, weight) * np.pi / 6
    assert_allclose(isotropic_power(rho).sum(), energy, rtol=1e-12)
    fraction = isotropic_fraction(rho, energy)
    assert_allclose(fraction[-1, -1], 1, rtol=1e-12)
    by_hand = sum(
        (1 if q == 0 else 2) * rho[l, p, q] ** 2 for l in range(3) for p in range(2) for q in range(2)
    )
    assert_allclose(fraction[2, 1], by_hand / energy, rtol=1e-12)


def test_of_the_pairs_of_degrees_that_suffice_the_smallest_is_taken():
    fraction = np.array([[0.1, 0.2, 0.92], [0.5, 0.6, 0.95], [0.8, 0.91, 0.97], [0.95, 0.96, 1.0]])
    # Coefficients up to (l, p): (0, 2) 3, (3, 0) 4, (2, 1) 8.
    assert degrees_reaching(fraction, 0.1) == (0, 2)
    assert degrees_reaching(fraction, 0.06) == (3, 0)
    assert degrees_reaching(fraction, 0.0) == (3, 2)
    # Up to (1, 2) there are 8, for q counts as well; up to (6, 0) there are 7.
    narrow = np.where(np.add.outer(np.arange(7), [0, 0, 5]) >= 6, 0.95, 0.5)
    assert degrees_reaching(narrow, 0.1) == (6, 0)
    with pytest.raises(ValueError, match=r"degrees \(2, 2\) holds 0.97 of the energy, not 1 - 0.01"):
        degrees_reaching(fraction[:3], 0.01)


def test_all_channels_have_to_reach_the_accuracy():
    fraction = np.array([[0.5, 0.2], [0.99, 0.8], [0.995, 0.99]])
    assert degree_reaching(fraction[:, 0], 0.01) == 1
    assert degree_reaching(fraction, 0.01) == 2
    with pytest.raises(ValueError, match=r"degree 2 holds 0.99 of the energy, not 1 - 0.001"):
        degree_reaching(fraction, 0.001)


def light_field_error(lighting: np.ndarray, transfer: np.ndarray) -> np.ndarray:
    """Share of the energy of B_lm = Lambda_l rho_l L_lm above each degree, from powers (l_max + 1, c), (l_max + 1,)."""
    power = (4 * np.pi / (2 * np.arange(len(transfer)) + 1) * transfer)[:, None] * lighting
    return 1 - np.cumsum(power, axis=0) / power.sum(axis=0)


@pytest.mark.parametrize("degree", [1, 3, 12])
def test_the_bound_is_attained_where_all_that_is_left_is_in_the_next_degree(degree: int):
    lighting, transfer = np.zeros((14, 1)), np.zeros(14)
    lighting[[0, degree]], transfer[[0, degree]] = [[1.0], [2.0]], [3.0, 4.0]
    bound = residual_bound(lighting, transfer, [3.0], 7.0)
    error = light_field_error(lighting, transfer)
    assert_allclose(bound[degree - 1], error[degree - 1], rtol=1e-12)
    assert (bound[:degree] >= error[:degree] - 1e-15).all()
    assert_allclose(bound[degree:], 0, atol=1e-15)
    # As printed, with Lambda in place of its square, it would miss that for degrees below 6.
    weight = 4 * np.pi / (2 * degree + 1)
    printed = np.sqrt(weight) * 8 / (4 * np.pi * 3 + np.sqrt(weight) * 8)
    assert (printed < error[degree - 1, 0]) == (degree < 6)


def test_the_bound_holds_for_any_light_and_transfer(rng):
    for _ in range(20):
        lighting, transfer = rng.exponential(size=(9, 3)) ** 2, rng.exponential(size=9) ** 2
        cut = rng.integers(3, 9)
        bound = residual_bound(lighting[:cut], transfer[:cut], lighting.sum(axis=0), transfer.sum())
        assert (bound >= light_field_error(lighting, transfer)[:cut] - 1e-12).all()


def test_estimates_for_grace_cathedral_and_phong_are_conservative(data_dir: Path):
    # [R02, fig. 5.5]: Phong with s = 32; the light field computed to degree 30.
    radiance = read_latlong(data_dir / "probes" / "Grace_Cathedral.hdr").astype(float)
    lighting = power_per_degree(project_latlong(radiance, 60))
    transfer = symmetric_power(phong_transfer(32, 60))
    lighting_total, transfer_total = lighting_energy(radiance), 33**2 / (2 * np.pi * 65)
    of_lighting = 1 - energy_fraction(lighting, lighting_total)
    of_transfer = 1 - energy_fraction(transfer, transfer_total)
    minimum = np.minimum(of_lighting, of_transfer[:, None])
    bound = residual_bound(lighting, transfer, lighting_total, transfer_total)
    # To degree 60, the light field's error is known to 1e-9.
    error = light_field_error(lighting, transfer)
    assert (minimum[:31] >= error[:31] - 1e-9).all()
    assert (bound[:31] >= error[:31] - 1e-9).all()
    # "The minimum is almost always equivalent simply to the BRDF error."
    assert (of_lighting[1:31] > of_transfer[1:31, None]).all()


@pytest.mark.parametrize(
    ("call", "message"),
    [
        (lambda: power_per_degree(np.ones((5, 3))), "5 coefficients"),
        (lambda: power_per_degree([[1.0], [np.nan], [0.0], [0.0]]), "coefficients: 1 of 4 values"),
        (lambda: lighting_energy(np.ones((4, 4, 3))), "twice as wide"),
        (lambda: lighting_energy(np.full((2, 4, 3), np.nan)), "24 values that are not finite"),
        (lambda: symmetric_power([1.0, np.inf]), "transfer: 1 of 2"),
        (lambda: isotropic_power(np.ones((3, 2, 3))), r"rho is \(3, 2, 3\)"),
        (lambda: isotropic_power(np.ones((3, 3, 3))), "isn't 0 where q"),
        (lambda: energy_fraction([1.0, -0.5], 2.0), "power is -0.5"),
        (lambda: energy_fraction([1.0, 0.5], 0.0), "total is 0"),
        (lambda: energy_fraction([1.0, 0.5], np.nan), "total: 1 of 1"),
        (lambda: energy_fraction([1.0, 0.5], 1.4), "degrees up to 1 hold 1.07143 of the total"),
        (lambda: degree_reaching([0.5, 1.0], 1.0), "epsilon is 1.0"),
        (lambda: degree_reaching([0.5, 1.0], np.nan), "epsilon is nan"),
        (lambda: degree_reaching([0.5, np.nan], 0.1), "fraction: 1 of 2"),
        (lambda: degrees_reaching(np.ones((2, 2)), -0.1), "epsilon is -0.1"),
        (
            lambda: residual_bound(np.ones((3, 1)), np.ones(2), [9.0], 9.0),
            r"is \(3, 1\), transfer_power \(2,\)",
        ),
        (lambda: residual_bound(np.ones(3), np.ones(3), 9.0, 9.0), r"lighting_power is \(3,\)"),
        (lambda: residual_bound(np.ones((3, 1)), np.ones(3), [9.0], 1.0), "hold 3 of the total"),
    ],
)
def test_bad_input_is_refused(call: Callable, message: str):
    with pytest.raises(ValueError, match=message):
        call()
