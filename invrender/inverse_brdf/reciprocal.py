"""A basis of isotropic, reciprocal BRDFs, and what a surface that has one reflects [R02, eq. 2.58 and 2.59].

In real harmonics y and the frame whose x axis lies towards the viewer,

    rho cos theta_i cos theta_o = sum over l, p, q >= 0 of rho_lpq y_lq(wi) y_pq(wo)

so that under lighting of coefficients L_lm in that frame B cos theta_o = sum of rho_lpq L_lq y_pq(wo). Reciprocity,
rho_lpq = rho_plq, leaves those of l <= p as unknowns. They are those of `brdfcoefficients.isotropic_coefficients` with
`reciprocal=True`.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from invrender.theory.operator import view_frames
from invrender.theory.refinement import interval_rule
from recon.harmonics.basis import check_degree, degree_of, degrees, evaluate_harmonics
from recon.harmonics.latlong import theta_factors
from recon.harmonics.rotations import rotated_harmonics

Floats = NDArray[np.float64]
Ints = NDArray[np.int64]


class ReciprocalDegrees(NamedTuple):
    """Degrees l <= p and orders q <= l of the coefficients rho_lpq, (k,) each."""

    l: Ints
    p: Ints
    q: Ints


def unknowns(order: int) -> ReciprocalDegrees:
    """The coefficients up to a degree that reciprocity leaves free: 1, 4, 10, 20, 35, ..., 84 of order 6, 455 of 12."""
    check_degree(order, "order")
    l, p, q = np.indices((order + 1,) * 3).reshape(3, -1)
    free = (l <= p) & (q <= l)
    return ReciprocalDegrees(l[free], p[free], q[free])


def local_light(coefficients: Floats, normals: Floats, views: Floats) -> Floats:
    """Coefficients (n, (l_max + 1)^2, c) of lighting ((l_max + 1)^2, c), in frames whose x axis lies towards the views.

    normals, views : (n, 3) unit.
    """
    to_local = np.swapaxes(view_frames(normals, views), 1, 2)
    turned = rotated_harmonics(coefficients.T[:, None], to_local)
    return np.asarray(turned.transpose(1, 2, 0))


def source_light(incident: Floats, order: int) -> Floats:
    """`local_light` of a source of unit irradiance from local directions (n, 3), unit: ((order + 1)^2) each, c = 1."""
    return evaluate_harmonics(incident, order)[:, :, None]


def rows(local: Floats, cos_exitant: Floats) -> Floats:
    """Rows (n, k, c) that yield B cos theta_o from the coefficients (k,) of `unknowns`.

    local : (n, (order + 1)^2, c), of `local_light`. cos_exitant : (n,).
    """
    order = degree_of(local.shape[1])
    l, p, q = unknowns(order)
    exitant = theta_factors(cos_exitant, order)
    result = local[:, l * l + l + q] * exitant[q, p].T[:, :, None]
    # The other one of a pair.
    pairs = l != p
    l, p, q = l[pairs], p[pairs], q[pairs]
    result[:, pairs] += local[:, p * p + p + q] * exitant[q, l].T[:, :, None]
    return np.asarray(result)


def mean_power(lighting: Floats) -> Floats:
    """Mean square per degree, (c, l_max + 1), of a lighting's coefficients ((l_max + 1)^2, c).

    Lighting turned in all ways has local coefficients without correlation, of this variance.
    """
    l = degrees(degree_of(len(lighting)))
    return np.stack([np.bincount(l, channel**2) / np.bincount(l) for channel in lighting.T])


def below_horizon(power: Floats) -> Floats:
    """Gram matrix (c, k, k) of the rows over views from below the surface, the mean over all its orientations.

    Nothing is reflected there, which is as good as a measurement: without it the degrees of even and of odd p + q, each
    a basis of the hemisphere, could not be separated. power : (c, order + 1), of `mean_power`.
    """
    order = power.shape[1] - 1
    cos, weight = interval_rule(order + 1, -1.0, 0.0)
    factors = theta_factors(cos, order)
    # Mean over the lower hemisphere of y_pq y_p'q: q, p, p'.
    overlap = np.einsum("qaz,qbz,z->qab", factors, factors, weight)
    l, p, q = (values[:, None] for values in unknowns(order))
    same = q == q.T
    gram = np.zeros((len(power), len(l), len(l)))
    # Either one of a pair with either one of another; those of l = p are one.
    for one, other, counts in ((l, p, np.ones(l.shape, bool)), (p, l, l != p)):
        for its_one, its_other, its_counts in ((l, p, np.ones(l.shape, bool)), (p, l, l != p)):
            met = same & (one == its_one.T) & counts & its_counts.T
            gram += power[:, one] * np.where(met, overlap[q, other, its_other.T], 0)
    return gram


def energy_bounds(order: int) -> Floats:
    """The largest |rho_lpq| (k,) of any surface that reflects no more than it receives.

    The norms of sqrt(cos theta) y_lq and sqrt(cos theta) y_pq over the hemisphere, multiplied: reflection between
    functions weighted so has a norm of at most 1. That of rho_000, 1/4, is a white Lambertian surface's.
    """
    l, p, q = unknowns(order)
    norm = harmonic_norms(order)
    return np.asarray(norm[q, l] * norm[q, p])


def harmonic_norms(order: int) -> Floats:
    """Norms (order + 1, order + 1), q by l, of sqrt(cos theta) y_lq over the hemisphere."""
    cos, weight = interval_rule(order + 1, 0.0, 1.0)
    azimuth = np.where(np.arange(order + 1) > 0, np.pi, 2 * np.pi)
    return np.sqrt(azimuth[:, None] * (theta_factors(cos, order) ** 2 @ (weight * cos)))


@dataclass(frozen=True)
class IsotropicBasis:
    """The unknowns up to a degree of an isotropic BRDF, with what least squares ask of a basis."""

    order: int

    @property
    def degrees(self) -> tuple[Ints, Ints]:
        """l and p (k,)."""
        l, p, _ = unknowns(self.order)
        return l, p

    @property
    def bounds(self) -> Floats:
        """Of `energy_bounds`."""
        return energy_bounds(self.order)

    def rows(self, light: Floats, normals: Floats, views: Floats) -> Floats:
        """Rows (n, k, c) that yield B cos theta_o at unit normals towards unit views (n, 3), both in the world.

        light : coefficients ((order + 1)^2, c) of the lighting in the world.
        """
        return rows(local_light(light, normals, views), (normals * views).sum(axis=1))

    def below_horizon(self, lights: Sequence[Floats], weights: Sequence[float]) -> Floats:
        """`below_horizon` of photographs' lights, each with a weight."""
        powers = [weight * mean_power(light) for light, weight in zip(lights, weights, strict=True)]
        return below_horizon(np.sum(powers, axis=0))


def full_coefficients(values: Floats, order: int) -> Floats:
    """rho_lpq (order + 1, order + 1, order + 1), symmetric in l and p, of those in `unknowns` (k,)."""
    l, p, q = unknowns(order)
    full = np.zeros((order + 1,) * 3)
    full[l, p, q] = full[p, l, q] = values
    return full
