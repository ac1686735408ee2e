"""Witnesses that share no formula with the theory: scipy's harmonics, and rules that integrate over spheres."""

from __future__ import annotations

import numpy as np
from scipy.special import sph_legendre_p_all

Floats = np.ndarray


def angles(directions: Floats) -> tuple[Floats, Floats]:
    """Polar angle and azimuth (n,) of directions (n, 3)."""
    theta = np.arctan2(np.hypot(directions[:, 0], directions[:, 1]), directions[:, 2])
    return theta, np.arctan2(directions[:, 1], directions[:, 0])


def _legendre(theta: Floats, l_max: int) -> tuple[Floats, Floats]:
    """Orders (c,) of all harmonics, and their factors in theta (n, c), which hold the Condon-Shortley phase."""
    degrees, orders = np.transpose([(l, m) for l in range(l_max + 1) for m in range(-l, l + 1)])
    # Those of all degrees at once are ten times as fast as one by one. Negative orders are at the end, as indices are.
    return orders, sph_legendre_p_all(l_max, l_max, theta)[0][degrees, orders].T


def scipy_complex(directions: Floats, l_max: int) -> Floats:
    """Complex orthonormal harmonics (n, (l_max + 1)^2), with the Condon-Shortley phase."""
    theta, phi = angles(directions)
    orders, factors = _legendre(theta, l_max)
    return factors * np.exp(1j * np.arange(-l_max, l_max + 1) * phi[:, None])[:, orders + l_max]


def scipy_harmonics(directions: Floats, l_max: int) -> Floats:
    """Real orthonormal harmonics without that phase, by the same factors."""
    theta, phi = angles(directions)
    orders, factors = _legendre(theta, l_max)
    turns = np.arange(l_max + 1) * phi[:, None]
    waves = np.where(orders < 0, np.sin(turns)[:, abs(orders)], np.cos(turns)[:, abs(orders)])
    # Of order -m the factor has the sign (-1)^m beside that of m, and the phase is taken off that of m.
    signs = np.where(orders < 0, 1, (-1.0) ** orders) * np.where(orders == 0, 1, np.sqrt(2))
    return signs * factors * waves


def sphere_grid(order: int) -> tuple[Floats, Floats]:
    """Directions and weights that integrate polynomials of degree below 2 * order exactly."""
    node, weight = np.polynomial.legendre.leggauss(order)
    return _product(node, weight, 2 * order)


def hemisphere_grid(order: int, azimuths: int) -> tuple[Floats, Floats]:
    """Directions and weights over z > 0: Gauss-Legendre in cos(theta), equal steps in azimuth."""
    node, weight = np.polynomial.legendre.leggauss(order)
    return _product((node + 1) / 2, weight / 2, azimuths)


def _product(z: Floats, weight: Floats, azimuths: int) -> tuple[Floats, Floats]:
    phi = np.arange(azimuths) * 2 * np.pi / azimuths
    ring = np.sqrt(1 - z**2)[:, None]
    up = np.broadcast_to(z[:, None], (len(z), azimuths))
    directions = np.stack([ring * np.cos(phi), ring * np.sin(phi), up], axis=-1)
    return directions.reshape(-1, 3), np.repeat(weight, azimuths) * 2 * np.pi / azimuths


def reflected(rho, light, rotations: Floats, exitant: Floats, rule: tuple[Floats, Floats]) -> Floats:
    """The reflection integral (n,) at frames (n, 3, 3) towards local directions (n, 3), summed up [R02, eq. 2.11].

    rho : BRDF of local directions. light : radiance (k,) from directions (k, 3) of the world. rule : of the
    hemisphere.
    """
    incident, weight = rule
    result = []
    for rotation, towards in zip(rotations, exitant, strict=True):
        radiance = light(incident @ rotation.T)
        result.append(np.sum(rho(incident, towards) * incident[:, 2] * weight * radiance))
    return np.array(result)


def reflected_everywhere(
    rho, light, rotations: Floats, exitant: Floats, rule: tuple[Floats, Floats]
) -> Floats:
    """The same (s, n) at each of the frames (s, 3, 3) towards each of the local directions (n, 3)."""
    incident, weight = rule
    transfer = np.stack([rho(incident, towards) for towards in exitant]) * incident[:, 2] * weight
    return np.stack([transfer @ light(incident @ rotation.T) for rotation in rotations])
