"""Reflection in flatland as a Fourier product, against integrals of the reflection equation itself."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest
from numpy.testing import assert_allclose
from scipy.integrate import dblquad, quad

from invrender.theory.flatland import (
    fourier_basis,
    fourier_coefficients,
    recover_lighting,
    recover_transfer,
    reflect,
    synthesise,
    synthesise_light_field,
    transfer_at,
    transfer_coefficients,
)

HALF = np.pi / 2


def lambertian(theta_i: np.ndarray, theta_o: np.ndarray) -> np.ndarray:
    """rho^ of rho = 1."""
    return np.cos(theta_i) + 0 * theta_o


def glossy(theta_i: np.ndarray, theta_o: np.ndarray) -> np.ndarray:
    """A Gaussian lobe about the mirror direction, and a little that follows the view, so that nothing is symmetric."""
    lobe = np.exp(-(((theta_i + theta_o) / 2 / 0.3) ** 2))
    return (lobe + 0.2 * np.cos(theta_o) + 0.1 * np.sin(theta_o + 2 * theta_i)) * np.cos(theta_i)


class Light:
    """Light of frequencies up to l_max, from sines and cosines."""

    def __init__(self, rng: np.random.Generator, l_max: int) -> None:
        self.cosines, self.sines = rng.normal(size=(2, l_max + 1))

    def __call__(self, theta: np.ndarray | float) -> np.ndarray:
        waves = np.arange(len(self.cosines)) * np.asarray(theta)[..., None]
        return np.cos(waves) @ self.cosines + np.sin(waves) @ self.sines

    def coefficients(self, l_max: int) -> np.ndarray:
        return fourier_coefficients(self(2 * np.pi * np.arange(64) / 64), l_max)


def integrated_radiance(
    light: Light, transfer: Callable, alpha: np.ndarray, theta_o: np.ndarray
) -> np.ndarray:
    """[R02, eq. 2.6], adaptively, one normal and one view at a time."""

    def radiance(a: float, o: float) -> float:
        def integrand(i: float) -> float:
            return float(light(a + i) * transfer(np.array(i), np.array(o)))

        return quad(integrand, -HALF, HALF, epsabs=1e-12, epsrel=1e-12)[0]

    return np.array([[radiance(a, o) for o in theta_o] for a in alpha])


def test_coefficients_of_a_sampled_function_are_the_integrals_of_the_definition(rng):
    light = Light(rng, 5)
    found = fourier_coefficients(light(2 * np.pi * np.arange(13) / 13), 6)
    for l in range(-6, 7):
        real = quad(lambda t, l=l: float(light(t)) * np.cos(l * t), -np.pi, np.pi)[0]
        imaginary = quad(lambda t, l=l: -float(light(t)) * np.sin(l * t), -np.pi, np.pi)[0]
        assert abs(found[l + 6] - (real + 1j * imaginary) / np.sqrt(2 * np.pi)) < 1e-10  # of quad
    angles = rng.uniform(-10, 10, 20)
    assert_allclose(synthesise(found, angles), light(angles), atol=1e-12, equal_nan=False)


def test_the_basis_is_orthonormal_on_the_circle():
    basis = fourier_basis(2 * np.pi * np.arange(32) / 32, 7)
    assert_allclose(basis.conj().T @ basis * 2 * np.pi / 32, np.eye(15), atol=1e-14)


def test_coefficients_of_flatlands_lambertian_are_those_by_hand():
    # Integrals over the half circle: of cos(t) e^ilt, 2 cos(l pi / 2) / (1 - l^2), or pi / 2 for l = +-1; of e^-ipt,
    # 2 sin(p pi / 2) / p.
    l = np.arange(-6, 7)
    even = np.where(np.abs(l) == 1, 0, 2 * np.cos(l * HALF) / np.where(np.abs(l) == 1, 1, 1.0 - l * l))
    incident = np.where(np.abs(l) == 1, HALF, even) / np.sqrt(2 * np.pi)
    p = np.arange(-4, 5)
    exitant = np.where(p == 0, np.pi, 2 * np.sin(p * HALF) / np.where(p == 0, 1, p)) / np.sqrt(2 * np.pi)
    found = transfer_coefficients(lambertian, 6, 4)
    assert_allclose(found, np.outer(incident, exitant), atol=1e-14, equal_nan=False)  # rounding
    at_views = transfer_at(lambertian, 6, [-1.5, 0.0, 1.0])
    assert_allclose(at_views, np.repeat(incident[:, None], 3, axis=1), atol=1e-14, equal_nan=False)


def test_coefficients_are_the_integrals_of_the_expansion():
    found = transfer_coefficients(glossy, 3, 2)
    for l, p in [(0, 0), (3, -2), (-1, 2), (2, 1)]:

        def part(o: float, i: float, wave: Callable, l: int = l, p: int = p) -> float:
            # rho^ is expanded in conj(F_l) F_p, so that what it is integrated against is F_l conj(F_p).
            return float(glossy(np.array(i), np.array(o)) * wave(l * i - p * o)) / (2 * np.pi)

        real, imaginary = (
            dblquad(part, -HALF, HALF, -HALF, HALF, args=(wave,))[0] for wave in (np.cos, np.sin)
        )
        assert abs(found[l + 3, p + 2] - (real + 1j * imaginary)) < 1e-8  # of dblquad


@pytest.mark.parametrize("transfer", [lambertian, glossy])
def test_the_product_at_fixed_views_is_the_reflection_integral(transfer: Callable, rng):
    light = Light(rng, 6)
    alpha, theta_o = rng.uniform(-np.pi, np.pi, 7), np.array([-HALF, -1.2, 0.0, 0.4, 1.5])
    reflected = reflect(light.coefficients(6), transfer_at(transfer, 6, theta_o))
    expected = integrated_radiance(light, transfer, alpha, theta_o)
    assert np.abs(expected).max() > 0.1
    assert_allclose(synthesise(reflected, alpha), expected, atol=1e-10, equal_nan=False)  # of quad


def test_a_narrow_lobe_on_a_broad_one_is_not_overlooked():
    # Far from the horizon the lobe's integral against e^ilt is sqrt(pi) width e^(-il theta_o - (l width / 2)^2).
    # At 0, between the middle nodes of a rule, it is easiest to overlook.
    width, theta_o, l = 0.015, np.array([0.0]), np.arange(-3, 4)
    found = transfer_at(lambda i, o: np.cos(i) + np.exp(-(((i + o) / width) ** 2)), 3, theta_o)
    lobe = np.sqrt(np.pi) * width * np.exp(-1j * np.outer(l, theta_o) - (l[:, None] * width / 2) ** 2)
    broad = transfer_at(lambertian, 3, theta_o)
    assert_allclose(found - broad, lobe / np.sqrt(2 * np.pi), atol=1e-12, equal_nan=False)


def test_the_product_in_both_angles_holds_the_light_fields_coefficients(rng):
    light = Light(rng, 4)
    reflected = reflect(light.coefficients(4), transfer_coefficients(glossy, 4, 3))
    # B_lp of the integrated light field: the trapezoid rule, exact in alpha; Chebyshev's second in theta_o.
    alpha = 2 * np.pi * np.arange(10) / 10
    k = np.arange(1, 40)
    theta_o = HALF * np.cos(k * np.pi / 40)
    odd = np.arange(1, 40, 2)
    weights = 4 * np.sin(k * np.pi / 40) / 40 * (np.sin(np.outer(k, odd) * np.pi / 40) / odd).sum(axis=1)
    field = integrated_radiance(light, glossy, alpha, theta_o)
    l, p = np.arange(-4, 5), np.arange(-3, 4)
    over_alpha = np.exp(-1j * np.outer(l, alpha)) * 2 * np.pi / 10
    over_theta_o = np.exp(-1j * np.outer(theta_o, p)) * (weights * HALF)[:, None]
    expected = over_alpha @ field @ over_theta_o / (2 * np.pi)
    assert_allclose(reflected, expected, atol=1e-10, equal_nan=False)  # of quad


def test_the_light_field_is_synthesised_in_both_angles(rng):
    light = Light(rng, 3)
    # Zero at the horizon of theta_o with its slope, so that the series in p falls off as 1 / p^3.
    smooth = lambda i, o: np.cos(i) * np.cos(o) ** 2 * (2 + np.sin(i - o))  # noqa: E731
    alpha, theta_o = rng.uniform(-np.pi, np.pi, 4), np.array([-1.4, -0.3, 0.0, 0.9])
    reflected = reflect(light.coefficients(3), transfer_coefficients(smooth, 3, 60))
    expected = integrated_radiance(light, smooth, alpha, theta_o)
    # What the series leaves out: a few times 1 / 60^2.
    found = synthesise_light_field(reflected, alpha, theta_o)
    assert_allclose(found, expected, atol=1e-3 * np.abs(expected).max(), equal_nan=False)


def test_lighting_and_transfer_are_recovered_from_the_light_field(rng):
    lighting = Light(rng, 5).coefficients(5)
    for transfer in (transfer_coefficients(glossy, 5, 4), transfer_at(glossy, 5, [-0.5, 0.0, 0.8])):
        reflected = reflect(lighting, transfer)
        assert_allclose(recover_lighting(reflected, transfer), lighting, rtol=1e-9, equal_nan=False)
        assert_allclose(recover_transfer(reflected, lighting), transfer, rtol=1e-9, atol=1e-12)


def test_views_that_tell_most_count_most(rng):
    transfer = np.tile([1.0, 1e-6], (3, 1)) + 0j
    lighting = np.array([1 - 1j, 2, 1 + 1j])
    noisy = reflect(lighting, transfer) + 1e-4 * rng.normal(size=(3, 2))
    # The second column is all noise: a plain mean of the quotients would be off by about 20.
    assert_allclose(recover_lighting(noisy, transfer), lighting, atol=3e-4)


def test_what_a_matte_surface_does_not_pass_on_is_refused(rng):
    transfer = transfer_coefficients(lambertian, 4, 2)
    reflected = reflect(Light(rng, 4).coefficients(4), transfer)
    with pytest.raises(ValueError, match="passes nothing of frequency -3, 3, so the lighting"):
        recover_lighting(reflected, transfer)
    # Without the odd frequencies it is well posed.
    recover_lighting(reflected[2:-2], transfer[2:-2])


def test_what_the_lighting_lacks_of_a_transfer_function_is_refused():
    lighting = fourier_coefficients(3 + np.cos(2 * np.pi * np.arange(16) / 16), 2)
    with pytest.raises(ValueError, match="lighting holds nothing of frequency -2, 2, so the transfer"):
        recover_transfer(np.ones((5, 2)), lighting)


@pytest.mark.parametrize(
    ("call", "message"),
    [
        (lambda: fourier_basis([0.0], -1), "l_max is -1"),
        (lambda: fourier_basis([0.0, np.nan], 1), "angles: 1 of 2 values"),
        (lambda: fourier_coefficients(np.ones(6), 3), "6 samples .* up to 2, not l_max = 3"),
        (lambda: fourier_coefficients([1, np.inf, 1], 1), "samples: 1 of 3 values"),
        (lambda: synthesise(np.ones(4), [0.0]), "4 coefficients"),
        (lambda: synthesise([1, 0, 1j], [0.3]), "not those of a real function"),
        (lambda: synthesise_light_field(np.ones((3, 4)), [0.0], [0.0]), "4 coefficients"),
        (lambda: reflect(np.ones(3), np.ones((5, 1))), "lighting has 3 frequencies, transfer 5"),
        (lambda: reflect([1, np.nan, 1], np.ones((3, 1))), "lighting: 1 of 3"),
        (lambda: reflect(np.ones(3), np.ones(3)), r"transfer is \(3,\)"),
        (lambda: recover_transfer(np.ones((3, 1)), np.ones((3, 1))), r"lighting is \(3, 1\)"),
        (lambda: recover_lighting(np.ones((3, 1)), np.ones((3, 2))), "one shape"),
        (lambda: recover_lighting(np.ones((3, 1)), np.zeros((3, 1))), "frequency -1, 0, 1"),
        (lambda: transfer_at(lambertian, 3, [0.1, 1.6]), "theta_o is 1.6 rad"),
        (lambda: transfer_coefficients(lambertian, 3, -2), "p_max is -2"),
        (lambda: transfer_coefficients(lambda i, o: i / 0 * o, 3, 2), "the transfer function: "),
        (lambda: transfer_coefficients(lambda i, o: np.abs(i + o), 3, 2), "kinked"),
    ],
)
@pytest.mark.filterwarnings("ignore:divide by zero", "ignore:invalid value")
def test_bad_input_is_refused(call: Callable, message: str):
    with pytest.raises(ValueError, match=message):
        call()
