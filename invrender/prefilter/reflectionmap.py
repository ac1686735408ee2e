"""Spherical harmonic reflection maps: all views of all normals under one light, as a few maps [R02, section 5.4].

A lobe is nearly symmetric about the mirrored view R, and so what it reflects is nearly a function of R = (alpha, beta)
alone. What is left of the view V, in the frame Rz(beta) Ry(alpha) whose z axis is R, where it stands at theta_o' (twice
its angle to the normal) and phi_o', is a short series:

    B(R, V) = sum_pq B_pq(alpha, beta) Y_pq(theta_o', phi_o')                                           [R02, eq. 5.10]
    B_pq(alpha, beta) = sum_l rho_lpq L'_lq,   L'_lq = sum_m L_lm D^l_mq(alpha, beta)                    [R02, eq. 5.9]

in real harmonics here; L' is the light as that frame sees it. Orders of 2 or 3 hold 97% of a microfacet lobe's energy;
the rest is slow to come, since at grazing views V is opposite to R, which leaves the normal open: there the lobe isn't
continuous. `invrender.transport.reflected` has functions of the view that do better.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import lru_cache
from itertools import pairwise

import numpy as np
from numpy.typing import ArrayLike, NDArray

from invrender.brdf.form import Lobe
from invrender.prefilter.energy import degrees_reaching, isotropic_fraction
from invrender.theory.refinement import interval_rule
from recon.harmonics.basis import check_degree, degree_of, degrees, evaluate_harmonics, finite, orders
from recon.harmonics.latlong import project_latlong, theta_factors
from recon.harmonics.wigner import wigner_d

Floats = NDArray[np.float64]
Singles = NDArray[np.float32]

# Edges of panels of Gauss-Legendre in theta_i' and phi, radians: seen at a grazing angle a lobe is a streak in the
# plane of the view, so that both are finest towards it. The horizon of a lobe about the normal is an edge.
_POLAR = (0, 0.02, 0.06, 0.15, 0.3, 0.5, 0.8, 1.2, np.pi / 2, 2.0, 2.4, 2.8, np.pi)
_AZIMUTH = (0, 0.03, 0.12, 0.45, np.pi / 2, np.pi - 0.45, np.pi - 0.12, np.pi - 0.03, np.pi)
# Rows of the grid whose rotation matrices are made at a time.
_ROWS = 16


@dataclass(frozen=True, eq=False)
class ReflectionMap:
    """B_pq(alpha, beta), ((p_max + 1)^2, c, H, 2H) single precision, at the pixel centres of a lat-long grid of R."""

    maps: Singles

    def seen_from(self, exitant: ArrayLike, out: Singles | None = None) -> Singles:
        """Plain reflection maps (n, c, H, 2H) of views in local directions (n, 3), unit [R02, eq. 5.10].

        out : an array to write to. Raises ValueError for directions that aren't unit.
        """
        basis = evaluate_harmonics(exitant, degree_of(len(self.maps))).astype(np.float32)
        out = np.empty((len(basis), *self.maps.shape[1:]), np.float32) if out is None else out
        np.matmul(basis, self.maps.reshape(len(self.maps), -1), out=out.reshape(len(basis), -1))
        return out


def reflection_map(radiance_map: ArrayLike, rho: ArrayLike, height: int) -> ReflectionMap:
    """The reflection map, on `height` rows, of a lobe's rho_lpq under a lat-long map (h, 2h, c) [R02, section 5.6.2].

    rho : (F + 1, P + 1, min(F, P) + 1), of `lobe_coefficients`. Raises ValueError as `project_latlong`, and for a rho
    of another shape.
    """
    terms, q = isotropic_terms(rho)
    return ReflectionMap(reflected_terms(project_latlong(radiance_map, len(terms) - 1), terms, q, height))


def isotropic_terms(rho: ArrayLike) -> tuple[Floats, NDArray[np.int64]]:
    """rho_lpq of each harmonic of the view, (F + 1, (P + 1)^2), and the harmonics' orders q, < 0 for sines.

    rho : (F + 1, P + 1, min(F, P) + 1), q >= 0. Raises ValueError for another shape.
    """
    rho = np.asarray(rho, float)
    if rho.ndim != 3 or rho.shape[2] != min(rho.shape[:2]):
        raise ValueError(f"rho is {rho.shape}; it must be (l_max + 1, p_max + 1, min(l_max, p_max) + 1)")
    p_max = rho.shape[1] - 1
    p, q = degrees(p_max), orders(p_max)
    terms = np.zeros((len(rho), len(p)))
    kept = np.abs(q) < rho.shape[2]
    terms[:, kept] = rho[:, p[kept], np.abs(q[kept])]
    return terms, q


def reflected_terms(lighting: ArrayLike, rho: ArrayLike, term_orders: ArrayLike, height: int) -> Singles:
    """B_k(alpha, beta) = sum_l rho_lk L'_lq, (K, c, height, 2 height) single precision [R02, eq. 5.9, 5.23 and 5.24].

    lighting : real coefficients ((l_max + 1)^2, c). rho : (l_max + 1, K). term_orders : (K,), q of each term's
    harmonics in the frame of R, < 0 for sines. The degrees are summed up in alpha first, then the orders m in beta.
    Raises ValueError for values that aren't finite and for shapes that don't go together.
    """
    lighting, rho = finite(np.asarray(lighting, float), "lighting"), finite(np.asarray(rho, float), "rho")
    q, l_max = np.asarray(term_orders, int), degree_of(len(lighting))
    if rho.shape != (l_max + 1, len(q)):
        raise ValueError(
            f"rho is {rho.shape}; {len(q)} terms under light of degree {l_max} need {(l_max + 1, len(q))}"
        )
    cosines, sines = _by_order(lighting)
    channels, q_max = lighting.shape[1], min(l_max, int(np.abs(q).max(initial=0)))
    turns = _turns(l_max, q_max, height)
    waves = np.zeros((len(q), channels, height, 2, l_max + 1), np.float32)
    for order in range(-q_max, q_max + 1):
        own = np.flatnonzero(q == order)
        # What goes with cos(m beta) and with sin(m beta).
        pair = np.stack([cosines, sines] if order >= 0 else [sines, -cosines], axis=-1)
        products = (pair[:, :, None] * rho[None, :, own, None, None]).astype(np.float32)  # B_lmpq [eq. 5.7]
        summed = turns[abs(order), int(order < 0)] @ products.reshape(*products.shape[:2], -1)
        shape = l_max + 1, height, len(own), channels, 2
        waves[own] = summed.reshape(shape).transpose(2, 3, 1, 4, 0)
    m_beta = np.outer(np.arange(l_max + 1), (np.arange(2 * height) + 0.5) * np.pi / height)
    phases = np.concatenate([np.cos(m_beta), np.sin(m_beta)]).astype(np.float32)
    return np.asarray(waves.reshape(-1, len(phases)) @ phases).reshape(len(q), channels, height, 2 * height)


def lobe_orders(lobe: Lobe, epsilon: float, l_max: int, p_max: int) -> tuple[int, int]:
    """F and P that hold 1 - epsilon of a lobe's energy, as few coefficients as do [R02, section 5.5.1].

    Orders are degrees here. Raises ValueError where l_max and p_max don't reach that.
    """
    return degrees_reaching(isotropic_fraction(*lobe_coefficients(lobe, l_max, p_max)), epsilon)


def lobe_coefficients(lobe: Lobe, l_max: int, p_max: int, fineness: float = 1.0) -> tuple[Floats, float]:
    """rho_lpq of a lobe about the mirrored view, (l_max + 1, p_max + 1, min + 1), and its energy [R02, eq. 5.18, 5.22].

    Real, q >= 0; 0 where q > min(l, p). Both directions go over whole spheres: the lobe must be bounded for all views
    above the surface. fineness : of the quadrature, as in `mirrored_coefficients`. Raises ValueError as that does.
    """

    def at_views(cos_exitant: Floats, q_max: int) -> tuple[Floats, Floats]:
        # About the mirrored view the view stands at twice its angle to the normal.
        return mirrored_coefficients(lobe, l_max, q_max, np.sqrt((1 + cos_exitant) / 2), fineness)

    return _expanded_in_views(at_views, l_max, p_max, fineness)


def axial_lobe_coefficients(
    lobe: Lobe, l_max: int, p_max: int, fineness: float = 1.0
) -> tuple[Floats, float]:
    """The same of a lobe about an axis of its own, the normal or a tangent [R02, section 5.3.1].

    lobe : of unit axes, in the place of normals, and directions; bounded for views all around the axis.
    """

    def at_views(cos_exitant: Floats, q_max: int) -> tuple[Floats, Floats]:
        return axial_coefficients(lobe, l_max, q_max, cos_exitant, fineness)

    return _expanded_in_views(at_views, l_max, p_max, fineness)


def mirrored_coefficients(
    lobe: Lobe, l_max: int, q_max: int, cos_exitant: ArrayLike, fineness: float = 1.0
) -> tuple[Floats, Floats]:
    """Coefficients (k, l_max + 1, q_max + 1) of a lobe over directions about the mirrored view, and energies (k,).

    cos_exitant : (k,), of views that are in the local xz plane; so sines, q < 0, vanish. Energies are integrals of the
    square. fineness : of the quadrature; 1 keeps rho_lpq of microfacet lobes of sigma 0.1 to 0.5 to 3e-4 of the
    largest, 0.25 to 3e-3. Raises ValueError for cosines that aren't in (0, 1] and for values that aren't finite.
    """
    cos_exitant = np.asarray(cos_exitant, float)
    if not ((cos_exitant > 0) & (cos_exitant <= 1)).all():
        raise ValueError(f"cosines of exitant angles are {cos_exitant}; they must be in (0, 1]")
    exitant = np.arccos(cos_exitant)
    return _coefficients_at(lobe, l_max, q_max, _in_plane(exitant), _in_plane(2 * exitant), fineness)


def axial_coefficients(
    lobe: Lobe, l_max: int, q_max: int, cos_exitant: ArrayLike, fineness: float = 1.0
) -> tuple[Floats, Floats]:
    """The same about the lobe's own axis, for views (k,) at any angle to that.

    Raises ValueError for cosines that aren't in [-1, 1] and for values that aren't finite.
    """
    cos_exitant = np.asarray(cos_exitant, float)
    if not (np.abs(cos_exitant) <= 1).all():
        raise ValueError(f"cosines of exitant angles are {cos_exitant}; they must be in [-1, 1]")
    exitant = np.arccos(cos_exitant)
    return _coefficients_at(lobe, l_max, q_max, _in_plane(0 * exitant), _in_plane(exitant), fineness)


def _coefficients_at(
    lobe: Lobe, l_max: int, q_max: int, axes: Floats, views: Floats, fineness: float
) -> tuple[Floats, Floats]:
    """Coefficients over directions about +Z, and energies, of a lobe with axes and views (k, 3) in the xz plane."""
    check_degree(l_max)
    nodes = int(np.ceil(fineness * (10 + l_max / 16)))
    theta, weight = _composite(_POLAR, nodes)
    phi, step = _composite(_AZIMUTH, nodes)
    weight = weight * np.sin(theta)
    sin, cos = np.sin(theta)[:, None], np.cos(theta)[:, None]
    flat = np.broadcast_to(cos, (len(theta), len(phi)))
    incident = np.stack([sin * np.cos(phi), sin * np.sin(phi), flat], axis=-1)
    # Both sides of the plane count on one.
    waves = np.cos(phi[:, None] * np.arange(q_max + 1)) * (2 * step)[:, None]
    factors = theta_factors(np.cos(theta), l_max)[: q_max + 1] * weight
    result, energies = np.zeros((len(axes), l_max + 1, q_max + 1)), np.zeros(len(axes))
    for j, (axis, view) in enumerate(zip(axes, views, strict=True)):
        values = finite(np.asarray(lobe(axis, incident, view), float), "the lobe")
        result[j, :, : len(factors)] = np.einsum("qli,iq->lq", factors, (values @ waves)[:, : len(factors)])
        energies[j] = weight @ values**2 @ (2 * step)
    return result, energies


def _expanded_in_views(
    at_views: Callable[[Floats, int], tuple[Floats, Floats]], l_max: int, p_max: int, fineness: float
) -> tuple[Floats, float]:
    """rho_lpq and the energy of a lobe. at_views : its coefficients and energies at cosines of the view, to q_max."""
    check_degree(p_max, "p_max")
    q_max = min(l_max, p_max)
    view, weight = interval_rule(2 * p_max + int(np.ceil(24 * fineness)), 0, np.pi)
    weight = weight * np.sin(view)
    incident, squares = at_views(np.cos(view), q_max)
    factors = theta_factors(np.cos(view), p_max)[: q_max + 1]
    rho = np.einsum("jlq,qpj->lpq", incident, factors * weight)
    # Integrals over phi_o': of 1, or of the square that goes with sqrt(2) in both factors.
    rho *= np.where(np.arange(q_max + 1) == 0, 2 * np.pi, np.pi)
    return rho, float(2 * np.pi * weight @ squares)


def _in_plane(angles: Floats) -> Floats:
    """Unit vectors (k, 3) of the xz plane at angles (k,) to +Z, radians."""
    return np.stack([np.sin(angles), np.zeros_like(angles), np.cos(angles)], axis=-1)


def _composite(edges: tuple[float, ...], nodes: int) -> tuple[Floats, Floats]:
    """Gauss-Legendre on each panel between edges."""
    panels = [interval_rule(nodes, low, high) for low, high in pairwise(edges)]
    return np.concatenate([x for x, _ in panels]), np.concatenate([w for _, w in panels])


def _by_order(lighting: Floats) -> tuple[Floats, Floats]:
    """Coefficients of cosines and of sines, (l_max + 1, l_max + 1, c) each, m >= 0 by l, 0 where l < m."""
    l, m = np.tril_indices(degree_of(len(lighting)) + 1)
    cosines, sines = np.zeros((2, l[-1] + 1, l[-1] + 1, lighting.shape[1]))
    cosines[m, l] = lighting[l * l + l + m]
    sines[m, l] = lighting[l * l + l - m] * (m > 0)[:, None]
    return cosines, sines


@lru_cache(maxsize=4)
def _turns(l_max: int, q_max: int, height: int) -> Singles:
    """What a turn about y makes of real harmonics, (q_max + 1, 2, m, height, l), cosines then sines.

    With r_lm the light's real coefficients, L'_lq at (alpha, beta) is the sum over m >= 0 of cosines (r_lm cos m beta +
    r_l-m sin m beta), and L'_l-q that of sines (r_l-m cos m beta - r_lm sin m beta): eq. 5.9's D^l_mq, of m and -m at
    once.
    """
    alpha = (np.arange(height) + 0.5) * np.pi / height
    result = np.zeros((q_max + 1, 2, l_max + 1, height, l_max + 1), np.float32)
    for start in range(0, height, _ROWS):
        rows = slice(start, start + _ROWS)
        for l, matrix in enumerate(wigner_d(l_max, alpha[rows])):
            m, q = np.arange(l + 1)[:, None], np.arange(min(l, q_max) + 1)
            factor = (-1.0) ** (m + q) * np.sqrt(0.5) ** ((m == 0) + 1.0 * (q == 0))
            ahead = matrix[:, l:, l : l + len(q)]
            behind = (-1.0) ** m * matrix[:, l::-1, l : l + len(q)]
            for side, mixed in enumerate((ahead + behind, ahead - behind)):
                result[: len(q), side, : l + 1, rows, l] = (factor * mixed).transpose(2, 1, 0)
    return result
