"""Lambertian reflection as convolution, against integrals of the clamped cosine."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.testing import assert_allclose
from scipy.integrate import quad
from scipy.special import eval_legendre, sph_harm_y

from invrender.theory.lambertian import irradiance
from recon.harmonics.basis import clamped_cosine_transfer


def test_transfer_is_the_integral_of_the_clamped_cosine():
    # Funk-Hecke: A_l = 2 pi times the integral of max(c, 0) P_l(c).
    expected = [2 * np.pi * quad(lambda c, d=d: c * eval_legendre(d, c), 0, 1)[0] for d in range(13)]
    assert_allclose(clamped_cosine_transfer(12), expected, atol=1e-13, equal_nan=False)


def test_transfer_is_as_printed():
    # [RH01, eq. 16] prints 3.14, 2.09, 0.79, 0, -0.13.
    expected = [np.pi, 2 * np.pi / 3, np.pi / 4, 0, -np.pi / 24]
    assert_allclose(clamped_cosine_transfer(4), expected, rtol=1e-15)
    assert_allclose(clamped_cosine_transfer(4), [3.14, 2.09, 0.79, 0, -0.13], atol=0.005)


@pytest.mark.parametrize("l_max", [0, 2, 10])
def test_uniform_light_of_unit_radiance_gives_irradiance_pi(l_max: int, rng):
    normals = rng.normal(size=(20, 3))
    normals /= np.linalg.norm(normals, axis=1, keepdims=True)
    coefficients = np.zeros(((l_max + 1) ** 2, 3))
    radiance = np.array([0.5, 1.0, 3.0])
    coefficients[0] = radiance * np.sqrt(4 * np.pi)
    assert_allclose(irradiance(normals, coefficients), np.tile(np.pi * radiance, (20, 1)), rtol=1e-13)


def test_irradiance_is_the_integral_over_the_hemisphere(rng):
    coefficients = rng.normal(size=(121, 2))
    scattered = rng.normal(size=(40, 3))
    normals = np.concatenate([scattered, np.eye(3), -np.eye(3)])
    normals /= np.linalg.norm(normals, axis=1, keepdims=True)

    def radiance(directions: np.ndarray) -> np.ndarray:
        theta, phi = (
            np.arccos(np.clip(directions[:, 2], -1, 1)),
            np.arctan2(directions[:, 1], directions[:, 0]),
        )
        total = np.zeros((len(directions), 2))
        for degree in range(11):
            for order in range(-degree, degree + 1):
                value = sph_harm_y(degree, abs(order), theta, phi) * (-1) ** order
                real = (value.imag if order < 0 else value.real) * (np.sqrt(2) if order else 1)
                total += real[:, None] * coefficients[degree * degree + degree + order]
        return total

    # Over cos(theta_i) a polynomial of degree 11, over azimuth waves up to 10: the rules are exact.
    node, weight = np.polynomial.legendre.leggauss(8)
    cos, weight = (node + 1) / 2, weight / 2
    phi = np.arange(24) * np.pi / 12
    ring = np.sqrt(1 - cos**2)[:, None]
    z = np.broadcast_to(cos[:, None], (8, 24))
    local = np.stack([ring * np.cos(phi), ring * np.sin(phi), z], axis=-1).reshape(-1, 3)
    weights = np.repeat(weight * cos, 24) * np.pi / 12
    expected = []
    for normal in normals:
        tangent = np.cross(normal, np.eye(3)[np.abs(normal).argmin()])
        tangent /= np.linalg.norm(tangent)
        frame = np.stack([tangent, np.cross(normal, tangent), normal])
        expected.append(weights @ radiance(local @ frame))
    assert_allclose(irradiance(normals, coefficients), expected, atol=1e-11, equal_nan=False)  # rounding


@pytest.mark.parametrize(
    ("coefficients", "message"),
    [
        (np.ones((5, 3)), "there are 5 coefficients"),
        (np.ones(4), r"are \(4,\); they must be \(\(l_max \+ 1\)\^2, channels\)"),
        (np.full((4, 3), np.nan), "lighting_coefficients: 12 of 12 values are not finite"),
    ],
)
def test_bad_coefficients_get_a_sentence(coefficients: np.ndarray, message: str):
    with pytest.raises(ValueError, match=message):
        irradiance([[0, 0, 1.0]], coefficients)


@pytest.mark.parametrize("l_max", [0, 1, 8, 24])
def test_many_normals_receive_what_few_do(l_max: int, rng):
    # Splines leave 5e-7 of random light. Poles, and the seam of the grid at azimuth 0, are among them.
    normals = rng.normal(size=(6000, 3))
    normals[:6], normals[6:60, 1] = np.concatenate([np.eye(3), -np.eye(3)]), 0
    normals /= np.linalg.norm(normals, axis=1, keepdims=True)
    coefficients = rng.normal(size=((l_max + 1) ** 2, 3))
    few = np.concatenate([irradiance(part, coefficients) for part in np.split(normals, 6)])
    assert_allclose(irradiance(normals, coefficients), few, atol=1e-6 * np.abs(few).max(), equal_nan=False)


def test_normals_that_are_not_unit_are_refused_however_many():
    for count in (10, 6000):
        with pytest.raises(ValueError, match=r"normals\[0\]"):
            irradiance(np.full((count, 3), 0.5), np.ones((4, 3)))
