"""How much of a function's energy lies below a degree, and the degree that an accuracy asks for [R02, section 5.5.1].

Energy is the integral of the square, which Parseval's theorem makes the sum of the squared coefficients. Power is that
sum within one degree. R02's order F is a degree here.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike, NDArray

from capture.lighting import check_latlong, latlong_solid_angles
from invrender.theory.convolution import normalisation, radial_coefficients
from recon.harmonics.basis import degree_of, finite

Floats = NDArray[np.float64]

# By how much a sum of squares may exceed the energy that it is part of: a coarse map's quadrature, and no more.
_EXCESS = 0.01


def power_per_degree(coefficients: ArrayLike) -> Floats:
    """Sum over m of L_lm^2, (l_max + 1, c), of real coefficients ((l_max + 1)^2, c) [R02, eq. 5.15].

    Raises ValueError for a wrong number of coefficients and for ones that aren't finite.
    """
    coefficients = finite(np.asarray(coefficients, float), "coefficients")
    l_max = degree_of(len(coefficients))
    return np.add.reduceat(coefficients**2, np.arange(l_max + 1) ** 2, axis=0)


def lighting_energy(radiance_map: ArrayLike) -> Floats:
    """Integral of L^2 over the sphere, (3,), of a lat-long map (H, 2H, 3) [R02, eq. 5.15]."""
    radiance_map = np.asarray(radiance_map, float)
    check_latlong(radiance_map, "radiance_map")
    return np.einsum("rcx,r->x", radiance_map**2, latlong_solid_angles(len(radiance_map))[:, 0])


def symmetric_power(transfer: ArrayLike) -> Floats:
    """rho_l^2 (l_max + 1,) of a radially symmetric transfer function given as Lambda_l rho_l [R02, eq. 5.17].

    The energy that it adds up to is 2 pi times the integral of rho^2 sin theta, as printed.
    """
    return radial_coefficients(finite(np.asarray(transfer, float), "transfer")) ** 2


def isotropic_power(rho: ArrayLike) -> Floats:
    """Sum over q of rho_lpq^2, (l_max + 1, p_max + 1), of an isotropic transfer function [R02, eq. 5.18].

    rho : real, (l_max + 1, p_max + 1, min(l_max, p_max) + 1), q >= 0, 0 where q > min(l, p); each q > 0 stands for -q
    as well. The energy that it adds up to is the integral of rho^2 over both directions: since rho depends on the
    azimuths' difference phi alone, 2 pi times the integral of rho^2 sin theta_i sin theta_o over theta_i, theta_o and
    phi. So the printed constant is right. Raises ValueError for other shapes, and for values where q > min(l, p).
    """
    rho = finite(np.asarray(rho, float), "rho")
    if rho.ndim != 3 or rho.shape[2] != min(rho.shape[:2]):
        raise ValueError(f"rho is {rho.shape}; it must be (l_max + 1, p_max + 1, min(l_max, p_max) + 1)")
    l, p, q = np.indices(rho.shape)
    if rho[q > np.minimum(l, p)].any():
        raise ValueError("rho isn't 0 where q > min(l, p); there are no harmonics there")
    squares = rho**2
    return np.asarray(2 * squares.sum(axis=2) - squares[..., 0])


def energy_fraction(power: ArrayLike, total: ArrayLike) -> Floats:
    """Share of the energy in degrees up to each, (l_max + 1, ...), of power (l_max + 1, ...) [R02, eq. 5.16 and 5.17].

    total : (...), the whole energy, degrees above l_max included. Raises ValueError for power that is negative, a total
    that isn't above 0, and one that is less than what it is made of.
    """
    power, total = finite(np.asarray(power, float), "power"), finite(np.asarray(total, float), "total")
    if (power < 0).any():
        raise ValueError(f"power is {power.min():.6g} in some degree; it must not be negative")
    if not (total > 0).all():
        raise ValueError(
            f"total is {total.min():.6g}; an energy must be above 0 for shares of it to be defined"
        )
    fraction = np.cumsum(power, axis=0) / total
    if (fraction[-1] > 1 + _EXCESS).any():
        raise ValueError(
            f"the degrees up to {len(power) - 1} hold {fraction[-1].max():.6g} of the total energy; they can't hold"
            " more than all: give the total of the same function"
        )
    return fraction


def isotropic_fraction(rho: ArrayLike, total: float) -> Floats:
    """Share of the energy up to each pair of degrees, (l_max + 1, p_max + 1), of rho_lpq [R02, eq. 5.18].

    total : as in `isotropic_power`. Raises ValueError as that and `energy_fraction` do.
    """
    return energy_fraction(np.cumsum(isotropic_power(rho), axis=1), total)


def degree_reaching(fraction: ArrayLike, epsilon: float) -> int:
    """The lowest degree F up to which all channels hold 1 - epsilon of their energy [R02, eq. 5.16 and 5.17].

    fraction : (l_max + 1, ...), of `energy_fraction`. Raises ValueError where l_max doesn't reach it.
    """
    fraction = finite(np.asarray(fraction, float), "fraction")
    reached = np.flatnonzero((fraction >= 1 - _checked(epsilon)).reshape(len(fraction), -1).all(axis=1))
    if not reached.size:
        raise _not_reached(float(fraction[-1].min()), f"degree {len(fraction) - 1}", epsilon)
    return int(reached[0])


def degrees_reaching(fraction: ArrayLike, epsilon: float) -> tuple[int, int]:
    """Degrees (F, P) that hold 1 - epsilon of an isotropic transfer function's energy [R02, eq. 5.18].

    fraction : (l_max + 1, p_max + 1), of `isotropic_fraction`. Of all such pairs the one with the fewest coefficients
    rho_lpq. Raises ValueError where none reaches it.
    """
    fraction = finite(np.asarray(fraction, float), "fraction")
    reached = fraction >= 1 - _checked(epsilon)
    if not reached.any():
        raise _not_reached(
            float(fraction[-1, -1]), f"degrees {tuple(n - 1 for n in fraction.shape)}", epsilon
        )
    l, p = np.indices(fraction.shape)
    coefficients = np.cumsum(np.cumsum(np.minimum(l, p) + 1, axis=0), axis=1)
    degree, exitant = np.unravel_index(np.argmin(np.where(reached, coefficients, np.inf)), fraction.shape)
    return int(degree), int(exitant)


def residual_bound(
    lighting_power: ArrayLike, transfer_power: ArrayLike, lighting_total: ArrayLike, transfer_total: float
) -> Floats:
    """The most that the light field can have of its energy above each degree F, (l_max + 1, c) [R02, eq. 5.19].

    lighting_power : (l_max + 1, c). transfer_power : (l_max + 1,), of `symmetric_power`, or of `isotropic_power` summed
    over p. lighting_total (c,), transfer_total : whole energies. As B_lm = Lambda_l rho_l L_lm, the light field's
    energy above F is at most

        Lambda_(F+1)^2 (eps_L L_tot) (eps_rho rho_tot).

    Printed is Lambda_(F+1) without the square, which is no bound for F < 5, where Lambda_(F+1) > 1. Raises ValueError
    as `energy_fraction`, and for other shapes.
    """
    lighting = finite(np.asarray(lighting_power, float), "lighting_power")
    transfer = finite(np.asarray(transfer_power, float), "transfer_power")
    if lighting.ndim != 2 or transfer.shape != lighting.shape[:1]:
        raise ValueError(
            f"lighting_power is {lighting.shape}, transfer_power {transfer.shape}; they must be (l_max + 1, c) and"
            " (l_max + 1,)"
        )
    squares = normalisation(len(lighting))[:, None] ** 2
    left_of_lighting = (1 - energy_fraction(lighting, lighting_total)).clip(0) * np.asarray(lighting_total)
    left_of_transfer = (1 - energy_fraction(transfer, transfer_total)).clip(0) * transfer_total
    residual = squares[1:] * left_of_lighting * left_of_transfer[:, None]
    held = np.cumsum(squares[:-1] * lighting * transfer[:, None], axis=0)
    # Nothing held and nothing left is no error.
    whole = held + residual
    return np.divide(residual, whole, out=np.zeros_like(whole), where=whole > 0)


def _checked(epsilon: float) -> float:
    if not 0 <= epsilon < 1:
        raise ValueError(f"epsilon is {epsilon}; the share of energy that may be missing must be in [0, 1)")
    return epsilon


def _not_reached(held: float, where: str, epsilon: float) -> ValueError:
    return ValueError(
        f"{where} holds {held:.6g} of the energy, not 1 - {epsilon:.6g}: take more degrees or allow more error"
    )
