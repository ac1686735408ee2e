"""Harmonic coefficients of BRDFs [R02, eq. 2.38, 2.53, 2.56 and 5.22].

What is expanded is the transfer function rho^ = rho cos theta_i, zero unless light and viewer are above the surface.
BRDFs are functions of local directions towards the light and the viewer, z along the normal, and yield one value
each.

Integrals over the incident hemisphere are Gauss-Legendre in theta and equal steps in phi: the horizon is an end of
the rule, so that they converge exponentially for smooth BRDFs. Nodes are doubled until the coefficients stand still.
"""

from __future__ import annotations

from collections.abc import Callable
from functools import partial
from itertools import pairwise

import numpy as np
from numpy.typing import ArrayLike, NDArray

from invrender.theory.refinement import interval_rule, refined
from recon.harmonics.basis import check_degree, degree_of, finite
from recon.harmonics.complex import evaluate_complex
from recon.harmonics.latlong import theta_factors

Floats = NDArray[np.float64]
Complexes = NDArray[np.complex128]
# rho(incident (..., 3), exitant (..., 3)) -> (...), 1/sr, broadcasting.
BRDF = Callable[[Floats, Floats], Floats]

# Per panel of the incident angles.
_FIRST_NODES, _LAST_NODES = 8, 256
_VALUES_AT_A_TIME = 1 << 21
# Share of a highlight's peak that some node must meet.
_SEEN = 0.5


def outgoing_coefficients(brdf: BRDF, l_max: int, cos_exitant: ArrayLike, tolerance: float = 1e-9) -> Floats:
    """Real coefficients (k, (l_max + 1)^2) of rho^ over incident directions, for views at cosines (k,) in the xz plane.

    Of an isotropic BRDF those of order q < 0 vanish. tolerance : of each, relative to the largest. Raises ValueError
    for cosines that aren't in (0, 1], values that aren't finite, and BRDFs too narrow to be integrated.
    """
    check_degree(l_max)
    cos_exitant = np.asarray(cos_exitant, float)
    if not ((cos_exitant > 0) & (cos_exitant <= 1)).all():
        raise ValueError(f"cosines of exitant angles are {cos_exitant}; they must be in (0, 1]")
    rows = []
    for cos in np.atleast_1d(cos_exitant).tolist():
        integrals = partial(_incident_integrals, brdf, l_max, cos)
        what = f"the BRDF's coefficients over incident directions, at cos theta_o = {cos:.3g},"
        rows.append(refined(integrals, tolerance, what, _nodes_that_see(brdf, cos), _LAST_NODES))
    return np.stack(rows)


def fixed_exitant_coefficients(outgoing: ArrayLike) -> Floats:
    """rho^_lq(theta_o) of an isotropic BRDF, (l_max + 1, l_max + 1), l by q >= 0 [R02, eq. 2.56].

    rho^_l(-q) = (-1)^q rho^_lq: with one exitant angle there is no second harmonic whose sign would make up for it.
    outgoing : ((l_max + 1)^2,), those of one exitant angle of `outgoing_coefficients`.
    """
    outgoing = np.asarray(outgoing, float)
    l_max = degree_of(len(outgoing))
    result = np.zeros((l_max + 1, l_max + 1))
    for q in range(l_max + 1):
        l = np.arange(q, l_max + 1)
        # Y_lq = (-1)^q (y_lq + i y_l-q) / sqrt(2) in real harmonics.
        result[q:, q] = np.sqrt(2 * np.pi) * outgoing[l * l + l + q] * ((-1) ** q / np.sqrt(2) if q else 1)
    return result


def isotropic_coefficients(
    brdf: BRDF, l_max: int, p_max: int, reciprocal: bool = False, tolerance: float = 1e-9
) -> Floats:
    """rho^_lpq of an isotropic BRDF, (l_max + 1, p_max + 1, min(l_max, p_max) + 1) [R02, eq. 2.53, by 5.22].

    q >= 0 only: rho^_lp(-q) = rho^_lpq. Zero where q > min(l, p). reciprocal : expand rho~ = rho cos theta_i cos
    theta_o instead [eq. 2.58], which is symmetric in l and p where the BRDF obeys reciprocity. Raises ValueError for
    a BRDF whose integral over exitant directions grows without bound, as that of a lobe over cos theta_o.
    """
    check_degree(p_max, "p_max")
    q_max = min(l_max, p_max)

    def at(nodes: int) -> Floats:
        theta, weight = interval_rule(nodes, 0, np.pi / 2)
        cos = np.cos(theta)
        local = outgoing_coefficients(brdf, l_max, cos, tolerance / 10)
        weight = weight * np.sin(theta) * (cos if reciprocal else 1)
        factors = theta_factors(cos, p_max)
        rho = np.zeros((l_max + 1, p_max + 1, q_max + 1))
        for q in range(q_max + 1):
            l = np.arange(q, l_max + 1)
            # theta_factors hold sqrt(2) for q > 0, and so do the real coefficients.
            azimuth = 2 * np.pi if q == 0 else np.pi
            rho[q:, q:, q] = azimuth * (local[:, l * l + l + q].T * weight) @ factors[q, q:].T
        return rho

    return refined(at, tolerance, "the BRDF's coefficients over exitant angles", 16, 128)


def anisotropic_coefficients(
    brdf: BRDF, l_max: int, p_max: int, reciprocal: bool = False, tolerance: float = 1e-9
) -> Complexes:
    """rho^_ln,pq of any BRDF, ((l_max + 1)^2, (p_max + 1)^2) complex [R02, eq. 2.38]; see `isotropic_coefficients`."""
    check_degree(l_max)
    check_degree(p_max, "p_max")

    def at(nodes: int) -> Complexes:
        directions, weight = hemisphere_rule(nodes)
        incident = evaluate_complex(directions, l_max) * (weight * directions[:, 2])[:, None]
        exitant = evaluate_complex(directions, p_max).conj()
        exitant *= (weight * (directions[:, 2] if reciprocal else 1))[:, None]
        rho = np.zeros((incident.shape[1], exitant.shape[1]), complex)
        for part in np.array_split(np.arange(len(directions)), len(directions) ** 2 // _VALUES_AT_A_TIME + 1):
            rho += incident.T @ (_values(brdf, directions[:, None], directions[None, part]) @ exitant[part])
        return rho

    return refined(at, tolerance, "the BRDF's coefficients over pairs of directions", 12, 48)


def hemisphere_rule(nodes: int) -> tuple[Floats, Floats]:
    """Directions (2 nodes^2, 3) over the upper hemisphere, and their weights in steradian."""
    theta, weight = interval_rule(nodes, 0, np.pi / 2)
    directions = _directions(theta, np.pi / nodes * np.arange(2 * nodes))
    return directions.reshape(-1, 3), np.repeat(weight * np.sin(theta) * np.pi / nodes, 2 * nodes)


def _nodes_that_see(brdf: BRDF, cos_exitant: float) -> int:
    """The fewest nodes per panel with which the rule meets the highlight, if there is one in the mirror direction.

    A lobe that falls between all nodes of two rules would pass for none.
    """
    view = np.array([np.sqrt(1 - cos_exitant**2), 0.0, cos_exitant])
    peak = float(_values(brdf, view * [-1, -1, 1], view))
    nodes = _FIRST_NODES
    while nodes < _LAST_NODES // 2:
        theta, _ = _incident_angles(nodes, cos_exitant)
        phi, _ = _azimuths(nodes, cos_exitant)
        if _values(brdf, _directions(theta, phi), view).max() >= _SEEN * peak:
            break
        nodes *= 2
    return nodes


def _incident_integrals(brdf: BRDF, l_max: int, cos_exitant: float, nodes: int) -> Floats:
    """Coefficients of rho^ for one view: waves in phi first, then degrees in theta [R02, eq. 5.22]."""
    theta, weight = _incident_angles(nodes, cos_exitant)
    phi, step = _azimuths(nodes, cos_exitant)
    incident = _directions(theta, phi)
    view = np.array([np.sqrt(1 - cos_exitant**2), 0.0, cos_exitant])
    values = _values(brdf, incident, view) * (weight * np.sin(theta) * np.cos(theta))[:, None]
    azimuths = np.arange(l_max + 1)[:, None] * phi
    cosines, sines = values @ (np.cos(azimuths) * step).T, values @ (np.sin(azimuths) * step).T
    factors = theta_factors(np.cos(theta), l_max)
    result = np.zeros((l_max + 1) ** 2)
    for m in range(l_max + 1):
        l = np.arange(m, l_max + 1)
        # In this order: of m = 0 both lines write the same places, and it is the cosine's that counts.
        result[l * l + l - m] = factors[m, m:] @ sines[:, m]
        result[l * l + l + m] = factors[m, m:] @ cosines[:, m]
    return result


def _incident_angles(nodes: int, cos_exitant: float) -> tuple[Floats, Floats]:
    """theta_i and weights, panel by panel: towards grazing views a lobe is cos theta_o narrow at the horizon."""
    elevation, weight = _graded(nodes, cos_exitant, np.pi / 2)
    return np.pi / 2 - elevation, weight


def _azimuths(nodes: int, cos_exitant: float) -> tuple[Floats, Floats]:
    """phi_i and weights all around, graded towards the mirror direction: there too lobes narrow as cos theta_o."""
    offset, weight = _graded(nodes, cos_exitant, np.pi)
    return np.concatenate([np.pi - offset[::-1], np.pi + offset]), np.concatenate([weight[::-1], weight])


def _graded(nodes: int, finest: float, end: float) -> tuple[Floats, Floats]:
    """Gauss-Legendre between 0 and `end` on panels that double in width from the first one's."""
    doublings = max(int(np.ceil(np.log2(end / finest))), 0)
    edges = np.concatenate([[0.0], end * 0.5 ** np.arange(doublings, -1, -1)])
    panels = [interval_rule(nodes, low, high) for low, high in pairwise(edges)]
    return np.concatenate([x for x, _ in panels]), np.concatenate([w for _, w in panels])


def _directions(theta: NDArray[np.floating], phi: NDArray[np.floating]) -> Floats:
    """Unit vectors (len(theta), len(phi), 3)."""
    sin, cos = np.sin(theta)[:, None], np.cos(theta)[:, None]
    up = np.broadcast_to(cos, (len(theta), len(phi)))
    return np.stack([sin * np.cos(phi), sin * np.sin(phi), up], axis=-1)


def _values(brdf: BRDF, incident: Floats, exitant: Floats) -> Floats:
    values = np.asarray(brdf(incident, exitant), float)
    expected = np.broadcast_shapes(incident.shape[:-1], exitant.shape[:-1])
    if values.shape != expected:
        raise ValueError(f"the BRDF yields {values.shape} values for {expected} pairs of directions")
    return finite(values, "the BRDF")
