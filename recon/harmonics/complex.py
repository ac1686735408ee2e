"""Complex spherical harmonics [R02, eq. 2.26 to 2.28], their tie to our real ones, and light as delta functions."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from recon.harmonics.basis import degree_of, evaluate_harmonics
from recon.harmonics.wigner import complex_from_real

Floats = NDArray[np.float64]
Complexes = NDArray[np.complex128]


def evaluate_complex(directions: ArrayLike, l_max: int) -> Complexes:
    """Y_lm at directions (n, 3), unit, as (n, (l_max + 1)^2), with the Condon-Shortley phase [R02, eq. 2.26].

    Raises ValueError as `evaluate_harmonics`.
    """
    # A function is the same in either basis, c Y = r y with c = M r, so that Y = conj(M) y for a unitary M.
    return _transformed(evaluate_harmonics(directions, l_max).T, lambda l: complex_from_real(l).conj()).T


def to_complex(coefficients: ArrayLike) -> Complexes:
    """Complex coefficients ((l_max + 1)^2, ...) of a function given by its real ones; NaN, undetermined, stays so."""
    return _transformed(np.asarray(coefficients), complex_from_real)


def to_real(coefficients: ArrayLike) -> Floats:
    """Real coefficients ((l_max + 1)^2, ...) of a real function given by its complex ones.

    The function is real if f_l-m = (-1)^m conj(f_lm); raises ValueError where it isn't, beyond rounding.
    """
    found = _transformed(np.asarray(coefficients), lambda l: complex_from_real(l).conj().T)
    largest = np.abs(found).max(initial=0)
    if np.abs(found.imag).max(initial=0) > 1e-9 * largest:
        raise ValueError(
            f"the coefficients are not those of a real function: f_l-m differs from (-1)^m conj(f_lm) by"
            f" {2 * np.abs(found.imag).max() / largest:.2g} of the largest"
        )
    return found.real


def project_sources(directions: ArrayLike, irradiances: ArrayLike, l_max: int) -> Floats:
    """Coefficients ((l_max + 1)^2, c) of directional sources (k, 3) of irradiance (k, c): delta functions."""
    irradiances = np.asarray(irradiances, float)
    return evaluate_harmonics(directions, l_max).T @ irradiances


def _transformed(coefficients: NDArray[Any], matrix_of_degree: Callable[[int], Complexes]) -> Complexes:
    """A matrix per degree applied along the first axis."""
    result = np.empty(coefficients.shape, complex)
    for l in range(degree_of(len(coefficients)) + 1):
        band = slice(l * l, (l + 1) ** 2)
        result[band] = np.tensordot(matrix_of_degree(l), coefficients[band], 1)
    return result
