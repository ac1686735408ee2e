"""Rotations, their Euler angles, and what they make of real coefficients of functions on the sphere.

Euler angles are those of R02: R(alpha, beta, gamma) = Rz(beta) Ry(alpha) Rz(gamma), which puts the north pole at polar
angle alpha and azimuth beta.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import lru_cache

import cv2
import numpy as np
from numpy.typing import ArrayLike, NDArray

from recon.harmonics.basis import degree_of, finite
from recon.harmonics.wigner import complex_from_real, wigner_D

Floats = NDArray[np.float64]
Complexes = NDArray[np.complex128]
Ints = NDArray[np.int64]

_ORTHOGONAL = 1e-6
# Functions that are turned at a time, so that they stay in the processor's cache.
_BLOCK = 512


def euler_angles(rotation: ArrayLike) -> tuple[Floats, Floats, Floats]:
    """alpha (0 to pi), beta, gamma of rotations (..., 3, 3), R = Rz(beta) Ry(alpha) Rz(gamma); beta is 0 at the poles.

    Raises ValueError for a matrix that isn't a rotation.
    """
    rotation = np.asarray(rotation, float)
    check_rotation(rotation)
    alpha, beta, gamma = _euler_turns(rotation)
    return np.angle(alpha), np.angle(beta), np.angle(gamma)


def _euler_turns(rotation: Floats) -> tuple[Complexes, Complexes, Complexes]:
    """e^(i alpha), e^(i beta), e^(i gamma) of rotations (..., 3, 3)."""
    x, y, z = np.moveaxis(rotation[..., :, 2], -1, 0)
    beside = np.hypot(x, y)
    beta = np.where(beside > 0, x + 1j * y, 1) / np.where(beside > 0, beside, 1)
    # Near a pole beta is noise and only beta + gamma (at the other pole beta - gamma) is known: gamma makes up for it.
    (a, b), (c, d) = np.moveaxis(rotation[..., :2, :2], (-2, -1), (0, 1))
    north = z > 0
    known = np.where(north, a + d + 1j * (c - b), d - a - 1j * (b + c))
    known = known / np.abs(known)
    gamma = np.where(north, known * beta.conj(), beta * known.conj())
    alpha = (z + 1j * beside) / np.hypot(z, beside)
    return np.asarray(alpha), np.asarray(beta), np.asarray(gamma)


def check_rotation(rotation: Floats) -> None:
    """Raise ValueError for matrices (..., 3, 3) that aren't rotations."""
    error = np.abs(np.swapaxes(rotation, -1, -2) @ rotation - np.eye(3))
    # `not <=`: a matrix with NaN is no rotation either.
    if not error.max(initial=0) <= _ORTHOGONAL:
        raise ValueError(
            f"rotation isn't one: its columns are off by {float(error.max()):.2g} from being of length 1 and square to"
            " each other"
        )
    if (np.linalg.det(rotation) < 0).any():
        raise ValueError("rotation isn't one: its determinant is -1; it mirrors")


def rotated_harmonics(coefficients: ArrayLike, rotation: ArrayLike) -> NDArray[np.floating]:
    """Real coefficients (..., (l_max + 1)^2) of what rotations (..., 3, 3) make of functions on the sphere.

    What had its value in direction w has it in direction R w. Leading axes broadcast: one rotation for many functions,
    or one for each. Keeps the dtype.
    """
    coefficients = np.asarray(coefficients)
    if np.iscomplexobj(coefficients):
        raise ValueError(
            "coefficients are complex; those of real harmonics are real: `to_real` converts them"
        )
    if not np.issubdtype(coefficients.dtype, np.floating):
        coefficients = coefficients.astype(float)
    finite(coefficients, "coefficients")
    rotation = np.asarray(rotation, float)
    check_rotation(rotation)
    shape = np.broadcast_shapes(coefficients.shape[:-1], rotation.shape[:-2])
    size = coefficients.shape[-1]
    l_max = degree_of(size)
    functions = np.broadcast_to(coefficients, (*shape, size)).reshape(-1, size)
    rotations = np.broadcast_to(rotation, (*shape, 3, 3)).reshape(-1, 3, 3)
    cos_at, sin_at = _places(l_max)
    result = np.empty_like(functions, order="C")
    for start in range(0, len(functions), _BLOCK):
        here = slice(start, start + _BLOCK)
        columns = functions[here].T
        sines = columns[sin_at]
        # Of m = 0 there are none.
        sines[cos_at == sin_at] = 0
        rotated_orders(columns[cos_at][:, None], rotations[here], sines[:, None]).write(result[None, here])
    return result.reshape(*shape, size)


@dataclass(frozen=True, eq=False)
class Orders:
    """Real coefficients by the sign of their order.

    cosines, sines : (k, f, n) of orders m >= 0 and of -m, degree by degree, of n times f functions; k is
    (l_max + 1)(l_max + 2) / 2. Of m = 0 sines are zero.
    """

    cosines: NDArray[np.floating]
    sines: NDArray[np.floating]

    def write(self, rows: NDArray[np.floating]) -> None:
        """Write them as rows (f, n, (l_max + 1)^2) of coefficients in the usual order."""
        usual = np.concatenate([self.cosines, self.sines])[_usual_order(degree_of(rows.shape[-1]))]
        for f, own in enumerate(rows):
            # numpy takes ten times as long.
            cv2.transpose(usual[:, f], dst=own)

    def dot(self, coefficients: NDArray[np.floating]) -> NDArray[np.floating]:
        """Products (f, n, c) with coefficients ((l_max + 1)^2, c) in the usual order."""
        cos_at, sin_at = _places(degree_of(len(coefficients)))
        both = (self.cosines, coefficients[cos_at]), (self.sines, coefficients[sin_at])
        products = [orders.reshape(len(orders), -1).T @ weights for orders, weights in both]
        return np.asarray(sum(products)).reshape(*self.cosines.shape[1:], -1)


def rotated_orders(
    cosines: NDArray[np.floating], rotation: Floats, sines: NDArray[np.floating] | None = None
) -> Orders:
    """What rotations (n, 3, 3), which aren't checked, make of functions (k, f, n) as `Orders` has them.

    sines : None of functions that are even in azimuth. A turn about z mixes only m and -m; one about y is one about z
    between quarter turns, whose matrices are the same for all: so many rotations cost two matrix products. As fast as
    can be where some hundred functions are turned at a time, which fit in the processor's cache.
    """
    # Ry(alpha) = Rz(90) Rx(alpha) Rz(-90), and Rx(alpha) = Ry(90) Rz(alpha) Ry(-90).
    alpha, beta, gamma = _euler_turns(rotation)
    l_max = _l_max_of(len(cosines))
    there, back = _quarter_turns(l_max, cosines.dtype)
    orders = _about_z(cosines, sines, -1j * gamma, l_max)
    orders = _about_z(*_multiplied(there, *orders), alpha, l_max)
    return Orders(*_about_z(*_multiplied(back, *orders), 1j * beta, l_max))


def _about_z(
    cosines: NDArray[np.floating], sines: NDArray[np.floating] | None, turn: Complexes, l_max: int
) -> tuple[NDArray[np.floating], NDArray[np.floating]]:
    """Orders (k, f, n) of functions turned about z by angles given as e^(i angle) (n,)."""
    powers = np.empty((l_max + 1, len(turn)), complex)
    powers[0] = 1
    powers[1:2] = turn
    # Each multiplication doubles how many there are.
    done = 1
    while done < l_max:
        more = min(done, l_max - done)
        powers[done + 1 : done + more + 1] = powers[1 : more + 1] * powers[done]
        done += more
    m = _orders(l_max)
    cos, sin = (part.astype(cosines.dtype)[m][:, None] for part in (powers.real, powers.imag))
    if sines is None:
        return cosines * cos, cosines * sin
    turned = cosines * cos, sines * cos
    mixed = sines * sin
    np.subtract(turned[0], mixed, out=turned[0])
    np.multiply(cosines, sin, out=mixed)
    np.add(turned[1], mixed, out=turned[1])
    return turned


def _multiplied(
    matrices: Sequence[tuple[NDArray[np.floating], NDArray[np.floating]]],
    cosines: NDArray[np.floating],
    sines: NDArray[np.floating],
) -> tuple[NDArray[np.floating], NDArray[np.floating]]:
    """Degrees' matrices times orders (k, f, n)."""
    results = np.empty_like(cosines), np.empty_like(sines)
    for l, both in enumerate(matrices):
        own = slice(l * (l + 1) // 2, (l + 1) * (l + 2) // 2)
        for matrix, orders, result in zip(both, (cosines, sines), results, strict=True):
            np.matmul(matrix, orders[own].reshape(l + 1, -1), out=result[own].reshape(l + 1, -1))
    return results


def _l_max_of(k: int) -> int:
    """The highest of degrees with k orders m >= 0."""
    return round(((8 * k + 1) ** 0.5 - 3) / 2)


@lru_cache(maxsize=16)
def _orders(l_max: int) -> Ints:
    """m (k,) of the orders m >= 0 of each degree."""
    return np.concatenate([np.arange(l + 1) for l in range(l_max + 1)])


@lru_cache(maxsize=16)
def _places(l_max: int) -> tuple[Ints, Ints]:
    """Where among (l_max + 1)^2 coefficients in the usual order those of m >= 0 are, (k,), and those of -m."""
    m = _orders(l_max)
    zeroth = np.concatenate([np.full(l + 1, l * l + l) for l in range(l_max + 1)])
    return zeroth + m, zeroth - m


@lru_cache(maxsize=16)
def _usual_order(l_max: int) -> Ints:
    """Where among all cosines and then all sines the (l_max + 1)^2 coefficients in the usual order are."""
    cos_at, sin_at = _places(l_max)
    order = np.empty((l_max + 1) ** 2, np.int64)
    order[sin_at] = len(cos_at) + np.arange(len(cos_at))
    order[cos_at] = np.arange(len(cos_at))
    return order


@lru_cache(maxsize=8)
def _quarter_turns(
    l_max: int, dtype: np.dtype[np.floating]
) -> tuple[list[tuple[NDArray[np.floating], NDArray[np.floating]]], ...]:
    """Matrices of each degree that turn cosines, and those that turn sines, by -90 degrees about y; and by 90.

    Such a turn leaves the xz plane where it is, and so what is even in azimuth even.
    """
    there = []
    for l, matrix in enumerate(wigner_D(l_max, -np.pi / 2, 0.0)):
        to_complex = complex_from_real(l)
        # A function turned by R has in direction w what it had in R^-1 w. Y(R^-1 w) = D Y(w) with the matrix of R^-1,
        # so coefficients c of Y turn into D^T c. This is the turn by 90, whose inverse is its transpose.
        turn = (to_complex.conj().T @ matrix.T @ to_complex).real.T.astype(dtype)
        sines = np.zeros((l + 1, l + 1), dtype)
        sines[1:, 1:] = turn[:l, :l][::-1, ::-1]
        there.append((turn[l:, l:].copy(), sines))
    return there, [(cosines.T.copy(), sines.T.copy()) for cosines, sines in there]
