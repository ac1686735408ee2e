"""Reflection as convolution: products of coefficients, and the light field that they stand for [R02, sec. 2.3].

In the complex harmonics of R02. Surface orientations are (alpha, beta), polar angle and azimuth of the normal; a
local frame is Rz(beta) Ry(alpha) applied to the world's axes, and exitant angles (theta_o, phi_o) are in it.
Coefficients of the lighting L_lm lie at l * l + l + m along their first axis; those of the BRDF are laid out as in
`brdfcoefficients`; those of the light field B_lmpq as ((l_max + 1)^2, (p_max + 1)^2), lm by pq.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from recon.harmonics.basis import check_degree, check_unit, degree_of, degrees, finite, orders
from recon.harmonics.complex import evaluate_complex
from recon.harmonics.rotations import check_rotation, euler_angles
from recon.harmonics.wigner import wigner_D

Floats = NDArray[np.float64]
Complexes = NDArray[np.complex128]


def normalisation(l_max: int) -> Floats:
    """Lambda_l = sqrt(4 pi / (2 l + 1)), (l_max + 1,) [R02, eq. 2.51]."""
    check_degree(l_max)
    return np.sqrt(4 * np.pi / (2 * np.arange(l_max + 1) + 1))


def filtered(lighting: ArrayLike, transfer: ArrayLike) -> NDArray[np.generic]:
    """B_lm = Lambda_l rho_l L_lm, shape of the lighting's coefficients, complex or real [R02, eq. 2.62; RH01, eq. 15].

    For BRDFs that are a function of the angle to one central direction, of which the light field is then a function
    too. transfer : (l_max + 1,), Lambda_l rho_l.
    """
    lighting = finite(np.asarray(lighting), "lighting")
    transfer = finite(np.asarray(transfer, float), "transfer")
    l_max = degree_of(len(lighting))
    if transfer.shape != (l_max + 1,):
        raise ValueError(f"transfer is {transfer.shape}; lighting of degree {l_max} needs ({l_max + 1},)")
    return lighting * transfer[degrees(l_max)].reshape(-1, *[1] * (lighting.ndim - 1))


def radial_coefficients(transfer: ArrayLike) -> Floats:
    """rho_l of a function of the angle to a central direction from Lambda_l rho_l, (l_max + 1,) [R02, eq. 2.60]."""
    transfer = finite(np.asarray(transfer, float), "transfer")
    return transfer / normalisation(len(transfer) - 1)


def isotropic_light_field(lighting: ArrayLike, rho: ArrayLike) -> Complexes:
    """B_lmpq = Lambda_l L_lm rho_lpq, ((l_max + 1)^2, (p_max + 1)^2) [R02, eq. 2.55; RH01, eq. 10].

    lighting : complex, ((l_max + 1)^2,). rho : (l_max + 1, p_max + 1, min + 1), q >= 0. With rho~, of rho cos theta_i
    cos theta_o, these are the coefficients of B~ = B cos theta_o [R02, eq. 2.58 and 2.59].
    """
    lighting, rho = np.asarray(lighting, complex), np.asarray(rho, float)
    l_max = _common_degree(lighting, rho, rho.shape[0] - 1)
    p_max = rho.shape[1] - 1
    if rho.shape[2] != min(l_max, p_max) + 1:
        raise ValueError(
            f"rho is {rho.shape}; of degrees {l_max} and {p_max} it has {min(l_max, p_max) + 1} orders"
        )
    p, q = degrees(p_max), np.abs(orders(p_max))
    widened = np.zeros((l_max + 1, p_max + 1, p_max + 1))
    widened[..., : rho.shape[2]] = rho
    products = normalisation(l_max)[:, None] * widened[:, p, q]
    return np.asarray(lighting[:, None] * products[degrees(l_max)], complex)


def anisotropic_light_field(lighting: ArrayLike, rho: ArrayLike) -> Complexes:
    """B_lmnpq = sqrt(8 pi^2 / (2 l + 1)) L_lm rho_ln,pq, ((l_max + 1)^2, 2 l_max + 1, k) [R02, eq. 2.43].

    lighting : complex, ((l_max + 1)^2,). rho : complex, ((l_max + 1)^2, k), k = (p_max + 1)^2; or of k fixed exitant
    directions, which need no expansion [R02, eq. 2.44]. The middle index is n + l_max, the order that belongs to the
    turn gamma of the tangent frame.
    """
    lighting, rho = np.asarray(lighting, complex), np.asarray(rho, complex)
    l_max = _common_degree(lighting, rho, degree_of(rho.shape[0]))
    l = degrees(l_max)
    by_order = np.zeros((l_max + 1, 2 * l_max + 1, rho.shape[1]), complex)
    by_order[l, orders(l_max) + l_max] = rho
    scale = np.sqrt(2 * np.pi) * normalisation(l_max)[l]
    return np.asarray((scale * lighting)[:, None, None] * by_order[l])


def fixed_exitant(lighting: ArrayLike, rho: ArrayLike) -> Complexes:
    """B_lmq(theta_o) = Lambda_l L_lm rho_lq(theta_o), ((l_max + 1)^2, 2 l_max + 1), of one theta_o [R02, eq. 2.57].

    rho : (l_max + 1, l_max + 1), l by q >= 0, of `fixed_exitant_coefficients`. The last index is q + l_max.
    """
    lighting, rho = np.asarray(lighting, complex), np.asarray(rho, float)
    l_max = _common_degree(lighting, rho, rho.shape[0] - 1)
    if rho.shape != (l_max + 1, l_max + 1):
        raise ValueError(
            f"rho is {rho.shape}; of degree {l_max} it must be {(l_max + 1, l_max + 1)}, l by q >= 0"
        )
    q = np.arange(-l_max, l_max + 1)
    by_order = rho[:, np.abs(q)] * np.where(q < 0, (-1.0) ** q, 1)
    return np.asarray((normalisation(l_max)[degrees(l_max)] * lighting)[:, None] * by_order[degrees(l_max)])


def isotropic_radiance(coefficients: ArrayLike, rotations: ArrayLike, exitant: ArrayLike) -> Floats:
    """B at surface frames (n, 3, 3) in local exitant directions (n, 3), unit, of B_lmpq [R02, eq. 2.54].

    Frames are rotations from local axes, z along the normal, to the world's: any azimuth of them will do, since
    turning an isotropic surface about its normal turns the local directions alike.
    """
    coefficients = finite(np.asarray(coefficients, complex), "coefficients")
    l_max, p_max = degree_of(coefficients.shape[0]), degree_of(coefficients.shape[1])
    exitant = np.asarray(exitant, float)
    alpha, beta, gamma = euler_angles(rotations)
    matrices = wigner_D(l_max, alpha, beta, gamma)
    basis = evaluate_complex(exitant, p_max)
    q = orders(p_max)
    result = np.zeros(len(exitant), complex)
    for l, matrix in enumerate(matrices):
        used = np.abs(q) <= l
        # C_lmpq = D^l_mq Y_pq / Lambda_l, in which D and Y share q.
        at_sample = np.einsum("mk,nk->nmk", coefficients[l * l : (l + 1) ** 2, used], basis[:, used])
        result += np.einsum("nmk,nmk->n", at_sample, matrix[:, :, q[used] + l]) / normalisation(l)[l]
    return _real(result)


def anisotropic_radiance(coefficients: ArrayLike, rotations: ArrayLike, exitant: ArrayLike) -> Floats:
    """B at tangent frames (n, 3, 3) in local exitant directions (n, 3), unit, of B_lmnpq [R02, eq. 2.42].

    Frames are rotations from local axes, x along the tangent and z along the normal, to the world's.
    """
    coefficients = finite(np.asarray(coefficients, complex), "coefficients")
    l_max, p_max = degree_of(coefficients.shape[0]), degree_of(coefficients.shape[2])
    matrices = wigner_D(l_max, *euler_angles(rotations))
    basis = evaluate_complex(np.asarray(exitant, float), p_max)
    result = np.zeros(len(basis), complex)
    for l, matrix in enumerate(matrices):
        own = coefficients[l * l : (l + 1) ** 2, l_max - l : l_max + l + 1]
        scale = np.sqrt((2 * l + 1) / (8 * np.pi**2))
        result += scale * np.einsum("smn,smn->s", np.einsum("mnk,sk->smn", own, basis), matrix)
    return _real(result)


def local_directions(rotations: ArrayLike, directions: ArrayLike) -> Floats:
    """Directions (n, 3), unit, of the world in the local axes of frames (n, 3, 3): R^-1 w [R02, eq. 2.10]."""
    directions, rotations = np.asarray(directions, float), np.asarray(rotations, float)
    check_unit(directions)
    check_rotation(rotations)
    return np.einsum("nkj,nk->nj", rotations, directions)


def _real(radiance: Complexes) -> Floats:
    largest = np.abs(radiance).max(initial=0)
    # Rounding of long sums stays far below this.
    if np.abs(radiance.imag).max(initial=0) > 1e-8 * largest:
        raise ValueError(
            "the coefficients are not those of a real light field: an imaginary part of"
            f" {np.abs(radiance.imag).max() / largest:.2g} of the largest radiance is left"
        )
    return radiance.real


def _common_degree(lighting: Complexes, rho: NDArray[Any], expected: int) -> int:
    finite(rho, "rho")
    l_max = degree_of(len(finite(lighting, "lighting")))
    if l_max != expected:
        raise ValueError(
            f"the lighting is of degree {l_max} and the BRDF of {expected}; both must be the same"
        )
    return l_max
