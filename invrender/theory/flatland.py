"""Reflection in flatland, where it is a Fourier convolution [R02, sections 2.2.2 and 2.3.1].

Angles are in radians. Light comes from theta_i and leaves towards theta_o, both counted from the normal alpha and
within +-pi/2 of it. Radiance B(alpha, theta_o) is the integral over theta_i of L(alpha + theta_i) times the transfer
function rho^(theta_i, theta_o) = rho cos theta_i, 0 below the surface [eq. 2.6]. In terms of
F_k(theta) = e^(ik theta) / sqrt(2 pi),

    L = sum L_l F_l(theta),  rho^ = sum rho_lp conj(F_l(theta_i)) F_p(theta_o),  B = sum B_lp F_l(alpha) F_p(theta_o)

[eq. 2.18 and 2.20]. Coefficients are complex, of frequencies -l_max to l_max in this order: l is at index l + l_max.
"""

from __future__ import annotations

from collections.abc import Callable
from functools import partial
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from invrender.theory.refinement import interval_rule, refined
from recon.harmonics.basis import check_degree, finite

Floats = NDArray[np.float64]
Complexes = NDArray[np.complex128]
# rho^(theta_i, theta_o), broadcasting.
Transfer = Callable[[Floats, Floats], Floats]

# The first rule's nodes are 0.012 rad apart, so that no lobe wider than that slips between them.
_FIRST_NODES, _LAST_NODES = 256, 1024
_WHAT = "the transfer function's coefficients"
# Relative to the largest: amplitudes at or below this are rounding, from which nothing is recovered.
_AMPLITUDE = 1e-10


def fourier_basis(angles: ArrayLike, l_max: int) -> Complexes:
    """F_l(theta) at angles (n,) in radians, (n, 2 l_max + 1) [R02, eq. 2.17].

    Raises ValueError for angles that aren't finite and l_max below 0.
    """
    check_degree(l_max)
    angles = finite(np.asarray(angles, float), "angles")
    return np.exp(1j * angles[:, None] * np.arange(-l_max, l_max + 1)) / np.sqrt(2 * np.pi)


def fourier_coefficients(samples: ArrayLike, l_max: int) -> Complexes:
    """Coefficients (2 l_max + 1, ...) of a function sampled at the n angles 2 pi k / n, (n, ...) [R02, eq. 2.17].

    Exact for functions of frequencies up to n - 1 - l_max; higher ones fold back. Raises ValueError for values that
    aren't finite and for fewer than 2 l_max + 1 of them.
    """
    check_degree(l_max)
    samples = finite(np.asarray(samples, float), "samples")
    count = len(samples)
    if count < 2 * l_max + 1:
        raise ValueError(
            f"{count} samples around the circle carry frequencies up to {(count - 1) // 2}, not l_max = {l_max}: take"
            f" {2 * l_max + 1} or more"
        )
    waves = np.fft.fft(samples, axis=0)
    return np.asarray(np.sqrt(2 * np.pi) / count * waves[np.arange(-l_max, l_max + 1)])


def synthesise(coefficients: ArrayLike, angles: ArrayLike) -> Floats:
    """Values (n, ...) at angles (n,) of real functions on the circle, from coefficients (2 l_max + 1, ...).

    Of B_l(theta_o) (2 l_max + 1, k), the radiance B(alpha, theta_o) (n, k). Raises ValueError for coefficients that
    aren't those of real functions: f_-l must be conj(f_l).
    """
    coefficients = finite(np.asarray(coefficients), "coefficients")
    basis = fourier_basis(angles, _l_max_of(coefficients))
    return _real(np.tensordot(basis, coefficients, 1))


def synthesise_light_field(reflected: ArrayLike, alpha: ArrayLike, theta_o: ArrayLike) -> Floats:
    """Radiance B(alpha, theta_o) (n, k) at normals (n,) and local exitant angles (k,), from B_lp [R02, eq. 2.20].

    reflected : (2 l_max + 1, 2 p_max + 1). Where the light field ends abruptly at the horizon of theta_o, its series in
    p rings; `synthesise` with B_l(theta_o) does not. Raises ValueError as `synthesise`.
    """
    reflected = _coefficients(reflected, "reflected", 2)
    rows = fourier_basis(alpha, _l_max_of(reflected))
    columns = fourier_basis(theta_o, _l_max_of(reflected.T))
    return _real(rows @ reflected @ columns.T)


def transfer_coefficients(transfer: Transfer, l_max: int, p_max: int, tolerance: float = 1e-10) -> Complexes:
    """rho_lp (2 l_max + 1, 2 p_max + 1) of a transfer function rho^(theta_i, theta_o) on +-pi/2 [R02, eq. 2.20].

    tolerance : relative to the largest. Gauss-Legendre on the half circle, whose ends are the horizon, with as many
    nodes as it takes; lobes below 0.01 rad can escape it. Raises ValueError for a function that isn't finite, or too
    narrow or kinked to be integrated.
    """
    check_degree(p_max, "p_max")

    def at(nodes: int) -> Complexes:
        theta, weight = interval_rule(nodes, -np.pi / 2, np.pi / 2)
        outgoing = weight[:, None] * fourier_basis(theta, p_max).conj()
        return _incident_integrals(transfer, l_max, theta, nodes) @ outgoing

    return refined(at, tolerance, _WHAT, _FIRST_NODES, _LAST_NODES)


def transfer_at(transfer: Transfer, l_max: int, theta_o: ArrayLike, tolerance: float = 1e-10) -> Complexes:
    """rho_l(theta_o) (2 l_max + 1, k) for fixed exitant angles (k,) within +-pi/2 [R02, eq. 2.25].

    Integrated as `transfer_coefficients`. Raises ValueError as it does, and for angles below the surface.
    """
    theta_o = finite(np.asarray(theta_o, float), "theta_o")
    below = np.abs(theta_o) > np.pi / 2
    if below.any():
        raise ValueError(
            f"theta_o is {theta_o[below][0]:.6g} rad; exitant angles must be within +-pi/2 of the normal"
        )
    integrals = partial(_incident_integrals, transfer, l_max, theta_o)
    return refined(integrals, tolerance, _WHAT, _FIRST_NODES, _LAST_NODES)


def reflect(lighting: ArrayLike, transfer: ArrayLike) -> Complexes:
    """The light field's coefficients, sqrt(2 pi) L_l rho_lp or sqrt(2 pi) L_l rho_l(theta_o) [R02, eq. 2.24 and 2.25].

    lighting : (2 l_max + 1,). transfer : (2 l_max + 1, k), of either form. Raises ValueError for differing counts and
    for coefficients that aren't finite.
    """
    lighting, transfer = _coefficients(lighting, "lighting", 1), _coefficients(transfer, "transfer", 2)
    _check_same_count(lighting, transfer, "lighting", "transfer")
    return np.asarray(np.sqrt(2 * np.pi) * lighting[:, None] * transfer)


def recover_lighting(reflected: ArrayLike, transfer: ArrayLike) -> Complexes:
    """Lighting L_l (2 l_max + 1,) from a light field and a transfer function (2 l_max + 1, k) [R02, eq. 2.24, 2.25].

    Every p, or every exitant angle, yields L_l as B_lp / (sqrt(2 pi) rho_lp); least squares combines them, so that each
    counts by its information. Raises ValueError for frequencies of which the transfer function passes nothing.
    """
    transfer, reflected = _coefficients(transfer, "transfer", 2), _coefficients(reflected, "reflected", 2)
    if transfer.shape != reflected.shape:
        raise ValueError(
            f"transfer is {transfer.shape}, reflected is {reflected.shape}; they must be of one shape"
        )
    power = np.sum(np.abs(transfer) ** 2, axis=1)
    _check_amplitude(np.sqrt(power), "the transfer function passes", "lighting")
    return np.asarray(np.sum(transfer.conj() * reflected, axis=1) / (np.sqrt(2 * np.pi) * power))


def recover_transfer(reflected: ArrayLike, lighting: ArrayLike) -> Complexes:
    """Transfer rho_lp or rho_l(theta_o) (2 l_max + 1, k) from a light field (2 l_max + 1, k) and L_l [eq. 2.24, 2.25].

    Raises ValueError for frequencies that the lighting doesn't hold.
    """
    lighting, reflected = _coefficients(lighting, "lighting", 1), _coefficients(reflected, "reflected", 2)
    _check_same_count(lighting, reflected, "lighting", "reflected")
    _check_amplitude(np.abs(lighting), "the lighting holds", "transfer function")
    return np.asarray(reflected / (np.sqrt(2 * np.pi) * lighting[:, None]))


def _incident_integrals(transfer: Transfer, l_max: int, theta_o: Floats, nodes: int) -> Complexes:
    """rho_l(theta_o) (2 l_max + 1, k): integrals of rho^ F_l over the incident half circle."""
    theta, weight = interval_rule(nodes, -np.pi / 2, np.pi / 2)
    values = np.asarray(transfer(theta[:, None], theta_o[None]), float)
    # A function that doesn't use one of its angles may leave out that axis.
    values = np.broadcast_to(finite(values, "the transfer function"), (nodes, len(theta_o)))
    return np.asarray(fourier_basis(theta, l_max).T @ (weight[:, None] * values))


def _l_max_of(coefficients: NDArray[Any]) -> int:
    if len(coefficients) % 2 == 0:
        raise ValueError(
            f"there are {len(coefficients)} coefficients; frequencies -l_max to l_max are 2 l_max + 1: 1, 3, 5, ..."
        )
    return len(coefficients) // 2


def _coefficients(values: ArrayLike, name: str, axes: int) -> NDArray[Any]:
    """Coefficients (2 l_max + 1,) or, of two axes, (2 l_max + 1, k), checked."""
    found = finite(np.asarray(values), name)
    if found.ndim != axes:
        raise ValueError(
            f"{name} is {found.shape}; it must be {('(2 l_max + 1,)', '(2 l_max + 1, k)')[axes - 1]}"
        )
    _l_max_of(found)
    return found


def _check_same_count(one: NDArray[Any], other: NDArray[Any], one_name: str, other_name: str) -> None:
    if len(one) != len(other):
        raise ValueError(
            f"{one_name} has {len(one)} frequencies, {other_name} {len(other)}; cut off the longer one"
        )


def _check_amplitude(amplitude: Floats, what: str, recovered: str) -> None:
    lost = np.flatnonzero(amplitude <= _AMPLITUDE * amplitude.max())
    if lost.size:
        frequencies = ", ".join(str(k - len(amplitude) // 2) for k in lost)
        raise ValueError(
            f"{what} nothing of frequency {frequencies}, so the {recovered} there is undetermined: recover fewer"
            " frequencies"
        )


def _real(values: Complexes) -> Floats:
    off = np.abs(values.imag).max(initial=0)
    # Rounding of long sums stays far below this.
    if off > 1e-9 * np.abs(values).max(initial=0):
        raise ValueError(
            f"the coefficients are not those of a real function: an imaginary part of {off:.2g} is left; f_-l must be"
            " conj(f_l)"
        )
    return values.real
