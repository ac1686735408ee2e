"""Wigner's matrices: how spherical harmonics turn [R02, eq. 2.29 to 2.35].

Euler angles are those of R02: R(alpha, beta, gamma) = Rz(beta) Ry(alpha) Rz(gamma), which puts the north pole at polar
angle alpha and azimuth beta.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.special import gammaln

from recon.harmonics.basis import check_degree, finite

Floats = NDArray[np.float64]
Complexes = NDArray[np.complex128]


def wigner_d(l_max: int, alpha: ArrayLike) -> list[Floats]:
    """d^l(alpha) for l = 0 to l_max, (..., 2 l + 1, 2 l + 1) each, rows m and columns m' from -l to l.

    alpha : (...) radians. Y_lm(Ry(alpha) w) = sum over m' of d^l_mm'(alpha) Y_lm'(w) [R02, eq. 2.29 and 2.32], for
    complex harmonics. Up from l = max(|m|, |m'|), where d is a single product, by the three-term recurrence in l, which
    is stable in this direction [Kostelec and Rockmore 2008, eq. 11].
    """
    check_degree(l_max)
    alpha = finite(np.asarray(alpha, float), "alpha")
    cos = np.cos(alpha)[..., None, None]
    result: list[Floats] = []
    for l in range(l_max + 1):
        m = np.arange(-l, l + 1)
        here = np.zeros((*alpha.shape, 2 * l + 1, 2 * l + 1))
        if l > 0:
            # d^(l-1) and d^(l-2), padded with the zeros that stand for |m| > l.
            before = _padded(result[l - 1], 1)
            two_before = _padded(result[l - 2], 2) if l > 1 else np.zeros_like(here)
            inner = np.abs(m) < l
            a, b = m[inner][:, None].astype(float), m[inner][None, :].astype(float)
            k = l - 1
            up = np.sqrt((l**2 - a**2) * (l**2 - b**2)) / (l * (2 * k + 1))
            down = np.sqrt((k**2 - a**2) * (k**2 - b**2)).clip(0) / (max(k, 1) * (2 * k + 1))
            along = a * b / max(k * l, 1)
            part = np.ix_(inner, inner)
            here[..., part[0], part[1]] = (
                (cos - along) * before[..., part[0], part[1]] - down * two_before[..., part[0], part[1]]
            ) / up
        _fill_border(here, l, alpha)
        result.append(here)
    return result


def _padded(matrix: Floats, by: int) -> Floats:
    return np.pad(matrix, [(0, 0)] * (matrix.ndim - 2) + [(by, by)] * 2)


def _fill_border(matrix: Floats, l: int, alpha: Floats) -> None:
    """Rows and columns of d^l with |m| = l or |m'| = l: binomials of half the angle."""
    m = np.arange(-l, l + 1)
    root = np.exp(0.5 * (gammaln(2 * l + 1) - gammaln(l + m + 1) - gammaln(l - m + 1)))
    cos, sin = np.cos(alpha / 2)[..., None], np.sin(alpha / 2)[..., None]
    # 0.0 ** 0 is 1, as it should be.
    rising = root * cos ** (l + m) * sin ** (l - m)
    alternating = (-1.0) ** (l - m)
    matrix[..., -1, :] = alternating * rising
    matrix[..., :, -1] = rising
    matrix[..., 0, :] = rising[..., ::-1]
    matrix[..., :, 0] = ((-1.0) ** (l + m)) * rising[..., ::-1]


def wigner_D(l_max: int, alpha: ArrayLike, beta: ArrayLike, gamma: ArrayLike = 0.0) -> list[Complexes]:  # noqa: N802
    """D^l_mm' = d^l_mm'(alpha) e^(i m beta) e^(i m' gamma) for l = 0 to l_max, shapes as `wigner_d` [R02, eq. 2.31]."""
    beta, gamma = finite(np.asarray(beta, float), "beta"), finite(np.asarray(gamma, float), "gamma")
    result = []
    for l, matrix in enumerate(wigner_d(l_max, alpha)):
        m = np.arange(-l, l + 1)
        rows = np.exp(1j * beta[..., None] * m)[..., :, None]
        columns = np.exp(1j * gamma[..., None] * m)[..., None, :]
        result.append(np.asarray(rows * matrix * columns, complex))
    return result


def complex_from_real(l: int) -> Complexes:
    """The unitary matrix (2 l + 1, 2 l + 1) that takes a degree's real coefficients to those of complex harmonics.

    Of m > 0, Y_lm = (-1)^m (y_lm + i y_l-m) / sqrt(2) and Y_l-m = (y_lm - i y_l-m) / sqrt(2) in terms of our real y;
    Y are those of [R02, eq. 2.26 and 2.27], with the Condon-Shortley phase.
    """
    matrix = np.zeros((2 * l + 1, 2 * l + 1), complex)
    matrix[l, l] = 1
    for m in range(1, l + 1):
        sign = (-1) ** m
        matrix[l + m, l + m], matrix[l + m, l - m] = sign / np.sqrt(2), -1j * sign / np.sqrt(2)
        matrix[l - m, l + m], matrix[l - m, l - m] = 1 / np.sqrt(2), 1j / np.sqrt(2)
    return matrix
