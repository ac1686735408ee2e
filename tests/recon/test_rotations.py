"""Wigner's matrices against what is printed and against quadrature; rotated coefficients against rotated functions."""

from __future__ import annotations

from math import factorial

import numpy as np
import pytest
from numpy.polynomial import Polynomial
from numpy.testing import assert_allclose
from scipy.spatial.transform import Rotation
from scipy.special import sph_harm_y

from recon.harmonics.basis import evaluate_harmonics, sphere_directions
from recon.harmonics.rotations import euler_angles, rotated_harmonics
from recon.harmonics.wigner import wigner_D, wigner_d


def harmonics_of_degree(l: int, directions: np.ndarray) -> np.ndarray:
    """scipy's complex Y_lm (2 l + 1, n)."""
    theta = np.arctan2(np.hypot(directions[:, 0], directions[:, 1]), directions[:, 2])
    phi = np.arctan2(directions[:, 1], directions[:, 0])
    return np.stack([sph_harm_y(l, m, theta, phi) for m in range(-l, l + 1)])


def sphere_rule(order: int) -> tuple[np.ndarray, np.ndarray]:
    z, weight = np.polynomial.legendre.leggauss(order)
    phi = np.arange(2 * order) * np.pi / order
    ring = np.sqrt(1 - z**2)[:, None]
    up = np.broadcast_to(z[:, None], (order, 2 * order))
    directions = np.stack([ring * np.cos(phi), ring * np.sin(phi), up], axis=-1).reshape(-1, 3)
    return directions, np.repeat(weight, 2 * order) * np.pi / order


def turn(alpha: float, beta: float, gamma: float) -> np.ndarray:
    """Rz(beta) Ry(alpha) Rz(gamma), by scipy."""
    return Rotation.from_euler("ZYZ", [beta, alpha, gamma]).as_matrix()


@pytest.mark.parametrize("alpha", [0.0, 0.3, 1.9, np.pi])
def test_the_first_three_representations_are_as_printed(alpha: float):
    # [R02, eq. 2.34]; rows and columns from -l to l.
    c, s = np.cos(alpha / 2), np.sin(alpha / 2)
    cos, sin = np.cos(alpha), np.sin(alpha)
    root = np.sqrt(1.5)
    first = [
        [c**2, sin / np.sqrt(2), s**2],
        [-sin / np.sqrt(2), cos, sin / np.sqrt(2)],
        [s**2, -sin / np.sqrt(2), c**2],
    ]
    second = [
        [c**4, 2 * c**3 * s, root / 2 * sin**2, 2 * c * s**3, s**4],
        [-2 * c**3 * s, c**2 * (2 * cos - 1), root * cos * sin, s**2 * (1 + 2 * cos), 2 * c * s**3],
        [root / 2 * sin**2, -root * cos * sin, (3 * cos**2 - 1) / 2, root * cos * sin, root / 2 * sin**2],
        [-2 * c * s**3, s**2 * (1 + 2 * cos), -root * cos * sin, c**2 * (2 * cos - 1), 2 * c**3 * s],
        [s**4, -2 * c * s**3, root / 2 * sin**2, -2 * c**3 * s, c**4],
    ]
    found = wigner_d(2, alpha)
    for matrix, printed in zip(found, ([[1.0]], first, second), strict=True):
        assert_allclose(matrix, printed, atol=1e-14)


def test_matrices_are_the_derivatives_of_the_analytic_formula():
    # [R02, eq. 2.33] as Inui et al. give it, for all orders of degrees up to 6.
    alpha = 1.1
    xi = np.sin(alpha / 2) ** 2
    for l, matrix in enumerate(wigner_d(6, alpha)):
        for m in range(-l, l + 1):
            for other in range(-l, l + 1):
                below = factorial(l - m) * factorial(l + other) * factorial(l - other)
                scale = (-1) ** (m - other) * np.sqrt(factorial(l + m) / below)
                polynomial = Polynomial([0, 1]) ** (l - other) * Polynomial([1, -1]) ** (l + other)
                value = polynomial.deriv(l - m)(xi) if l > m else polynomial(xi)
                powers = xi ** (-(m - other) / 2) * (1 - xi) ** (-(m + other) / 2)
                assert_allclose(matrix[m + l, other + l], scale * powers * value, atol=1e-12)


def test_matrices_are_the_overlap_of_turned_harmonics():
    # [R02, eq. 2.30], exact by a rule for polynomials of degree 2 l.
    angles = (0.7, 1.3, -2.1)
    directions, weight = sphere_rule(13)
    for l, matrix in enumerate(wigner_D(12, *angles)):
        here = harmonics_of_degree(l, directions)
        turned = harmonics_of_degree(l, directions @ turn(*angles).T)
        assert_allclose(matrix, (turned * weight) @ here.conj().T, atol=1e-13)


def test_the_middle_row_and_column_are_harmonics():
    # [R02, eq. 2.35].
    alpha, beta = 0.8, 2.4
    for l, matrix in enumerate(wigner_D(8, alpha, beta)):
        m = np.arange(-l, l + 1)
        scale = np.sqrt(4 * np.pi / (2 * l + 1))
        assert_allclose(matrix[:, l], scale * sph_harm_y(l, m, alpha, beta), atol=1e-14)
        assert_allclose(matrix[l], scale * np.conj(sph_harm_y(l, m, alpha, np.pi)), atol=1e-14)


def test_matrices_are_orthogonal_over_all_rotations():
    # [R02, eq. 2.41 and 2.50]: for n = n', with and without the integral over gamma.
    node, weight = np.polynomial.legendre.leggauss(6)
    matrices = wigner_d(5, np.arccos(node))
    for l, l_other in [(2, 2), (2, 4), (5, 5), (3, 5)]:
        n = min(l, l_other)
        for m in range(-n, n + 1):
            for k in range(-n, n + 1):
                product = matrices[l][:, m + l, k + l] * matrices[l_other][:, m + l_other, k + l_other]
                expected = 8 * np.pi**2 / (2 * l + 1) if l == l_other else 0.0
                assert_allclose(4 * np.pi**2 * weight @ product, expected, atol=1e-12)


def test_matrices_of_high_degree_are_orthonormal():
    for matrix in wigner_d(150, [0.01, 1.0, 3.1])[149:]:
        gram = matrix @ np.swapaxes(matrix, 1, 2)
        assert_allclose(gram, np.broadcast_to(np.eye(matrix.shape[1]), gram.shape), atol=1e-11)


def test_euler_angles_put_the_pole_at_alpha_and_beta():
    rotations = [
        turn(0.7, 1.3, -2.1),
        np.eye(3),
        np.diag([1.0, -1, -1]),
        *Rotation.random(20, random_state=3).as_matrix(),
    ]
    alpha, beta, gamma = euler_angles(rotations)
    for k, rotation in enumerate(rotations):
        assert_allclose(turn(alpha[k], beta[k], gamma[k]), rotation, atol=1e-14)
    assert_allclose((alpha[0], beta[0], gamma[0]), (0.7, 1.3, -2.1))


@pytest.mark.parametrize("l_max", [0, 1, 5, 40])
def test_a_turned_function_has_its_values_in_turned_directions(l_max: int):
    coefficients = np.random.default_rng(5).normal(size=(4, (l_max + 1) ** 2))
    rotations = np.stack([np.eye(3), np.diag([-1.0, 1, -1]), *Rotation.random(2, random_state=4).as_matrix()])
    directions = sphere_directions(60)
    turned = rotated_harmonics(coefficients, rotations)
    for own, rotation, found in zip(coefficients, rotations, turned, strict=True):
        expected = evaluate_harmonics(directions, l_max) @ own
        # Rounding through recurrences of degree l_max.
        assert_allclose(
            evaluate_harmonics(directions @ rotation.T, l_max) @ found,
            expected,
            atol=1e-14 * (l_max + 4) ** 2,
        )
        assert_allclose(rotated_harmonics(own, rotation), found, atol=1e-14 * (l_max + 1))
    assert rotated_harmonics(coefficients.astype(np.float32), rotations).dtype == np.float32


@pytest.mark.parametrize(
    ("call", "message"),
    [
        (lambda: rotated_harmonics(np.zeros(5), np.eye(3)), "there are 5 coefficients"),
        (
            lambda: rotated_harmonics(np.zeros(4), np.diag([1.0, 1, -1])),
            "rotation isn't one: its determinant is -1",
        ),
        (lambda: rotated_harmonics(np.zeros(4), 2 * np.eye(3)), "columns are off by 3"),
        (lambda: rotated_harmonics(np.zeros(4), np.full((3, 3), np.nan)), "rotation isn't one"),
        (lambda: wigner_d(-1, 0.0), "l_max is -1"),
        (lambda: wigner_d(1.5, 0.0), "l_max is 1.5; it must be an integer"),
        (lambda: wigner_D(1, 0.0, np.nan), "beta: 1 of 1 values are not finite"),
        (lambda: rotated_harmonics(1j * np.ones(4), np.eye(3)), "coefficients are complex"),
        (lambda: rotated_harmonics(np.full(4, np.nan), np.eye(3)), "coefficients: 4 of 4 values"),
    ],
)
def test_bad_input_gets_a_sentence(call, message: str):
    with pytest.raises(ValueError, match=message):
        call()
