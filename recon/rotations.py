"""How spherical harmonics turn: Wigner's matrices [R02, eq. 2.29 to 2.35] and rotation of real coefficients.

Euler angles are those of R02: R(alpha, beta, gamma) = Rz(beta) Ry(alpha) Rz(gamma), which puts the north pole at polar
angle alpha and azimuth beta.
"""

from __future__ import annotations

from functools import lru_cache

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.special import gammaln

from recon.harmonics import check_degree, degree_of, finite

Floats = NDArray[np.float64]
Complexes = NDArray[np.complex128]

_ORTHOGONAL = 1e-6
# Functions that are turned at a time.
_BLOCK = 512


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


def euler_angles(rotation: ArrayLike) -> tuple[Floats, Floats, Floats]:
    """alpha (0 to pi), beta, gamma of rotations (..., 3, 3), R = Rz(beta) Ry(alpha) Rz(gamma); beta is 0 at the poles.

    Raises ValueError for a matrix that isn't a rotation.
    """
    rotation = np.asarray(rotation, float)
    check_rotation(rotation)
    alpha = np.arctan2(np.hypot(rotation[..., 0, 2], rotation[..., 1, 2]), rotation[..., 2, 2])
    beta = np.arctan2(rotation[..., 1, 2], rotation[..., 0, 2])
    # Near a pole beta is noise and only beta + gamma (at the other pole beta - gamma) is known: gamma makes up for it.
    (a, b), (c, d) = np.moveaxis(rotation[..., :2, :2], (-2, -1), (0, 1))
    total, difference = np.arctan2(c - b, a + d), np.arctan2(-(b + c), d - a)
    gamma = np.where(rotation[..., 2, 2] > 0, total - beta, beta - difference)
    return alpha, beta, (gamma + np.pi) % (2 * np.pi) - np.pi


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
    or one for each. Keeps the dtype. A turn about z mixes only m and -m; one about y is one about z between two quarter
    turns about x, whose matrices are the same for all: so many rotations cost two matrix products.
    """
    coefficients = np.asarray(coefficients)
    if np.iscomplexobj(coefficients):
        raise ValueError(
            "coefficients are complex; those of real harmonics are real: `to_real` converts them"
        )
    if not np.issubdtype(coefficients.dtype, np.floating):
        coefficients = coefficients.astype(float)
    finite(coefficients, "coefficients")
    angles = euler_angles(rotation)
    shape = np.broadcast_shapes(coefficients.shape[:-1], angles[0].shape)
    functions = np.broadcast_to(coefficients, (*shape, coefficients.shape[-1]))
    if not shape:
        return _turned(functions[None], *(angle[None] for angle in angles))[0]
    # As many at a time as fit in the processor's cache. Functions of one rotation along leading axes share its phases.
    rows = [np.broadcast_to(angle, (*angle.shape[:-1], shape[-1])) for angle in angles]
    result = np.empty_like(functions, order="C")
    for start in range(0, shape[-1], _BLOCK):
        here = slice(start, start + _BLOCK)
        result[..., here, :] = _turned(functions[..., here, :], *(angle[..., here] for angle in rows))
    return result


def _turned(
    coefficients: NDArray[np.floating], alpha: Floats, beta: Floats, gamma: Floats
) -> NDArray[np.floating]:
    l_max = degree_of(coefficients.shape[-1])
    # Functions last: what happens to a coefficient happens to a row of them.
    functions = np.array(np.swapaxes(coefficients, -1, -2), order="C")
    first, between, last = (_phases(angle, l_max, functions.dtype) for angle in (gamma, alpha, beta))
    for l, quarter in enumerate(_quarter_turns(l_max)):
        band, own = slice(l * l, (l + 1) ** 2), slice(l_max - l, l_max + l + 1)
        turn = quarter.astype(functions.dtype)
        turned = turn @ _about_z(functions[..., band, :], first, own)
        turned = turn.T @ _about_z(turned, between, own)
        functions[..., band, :] = _about_z(turned, last, own)
    return np.swapaxes(functions, -1, -2)


def _phases(
    angle: Floats, l_max: int, dtype: np.dtype[np.floating]
) -> tuple[NDArray[np.floating], NDArray[np.floating]]:
    """cos(m angle) and sin(m angle), (..., 2 l_max + 1, n), of angles (..., n)."""
    once = np.exp(1j * angle)[..., None, :]
    # Powers of one number: trigonometric functions of each multiple would take as long as all that follows.
    ahead = np.cumprod(np.broadcast_to(once, (*once.shape[:-2], l_max, once.shape[-1])), axis=-2)
    turns = np.concatenate([ahead[..., ::-1, :].conj(), np.ones_like(once), ahead], axis=-2)
    return turns.real.astype(dtype), turns.imag.astype(dtype)


def _about_z(
    band: NDArray[np.floating], phases: tuple[NDArray[np.floating], NDArray[np.floating]], own: slice
) -> NDArray[np.floating]:
    """A degree's coefficients (..., 2 l + 1, n) of functions turned about z: cos(m (phi - angle)) for cos(m phi)."""
    cos, sin = phases
    # y_m is cos(m phi) and y_-m is sin(m phi), of m > 0.
    return np.asarray(band * cos[..., own, :] - band[..., ::-1, :] * sin[..., own, :])


@lru_cache(maxsize=4)
def _quarter_turns(l_max: int) -> tuple[Floats, ...]:
    """Matrices that turn real coefficients of each degree by 90 degrees about x, which takes y to z.

    The turn is Rz(-90) Ry(90) Rz(90), so in Wigner's terms alpha = 90 and gamma = -beta = 90 degrees. A function turned
    by R has in direction w the value that it had in R^-1 w, which is why the matrix is that of the inverse.
    """
    half = np.pi / 2
    turns = []
    for matrix in wigner_D(l_max, -half, -half, half):
        to_complex = complex_from_real(len(matrix) // 2)
        # Y(R^-1 w) = D Y(w), so coefficients c of Y turn into D^T c.
        turns.append((to_complex.conj().T @ matrix.T @ to_complex).real)
    return tuple(turns)


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
