"""How far a reflection map can be off, without the reflected light itself [R02, section 5.5.1].

At an angle between view and axis the map leaves out D of the lobe, with power D_l^2 per degree about the centre. What
is missing is D turned against the light, and turns keep the power of each degree:

    mean square over all orientations        sum_l D_l^2 |L_l|^2 / (2 l + 1)        (Schur's orthogonality)
    at any orientation, at most              sum_l D_l |L_l|                        (Cauchy and Schwarz, per degree)

Degrees above the last one count by the energies of lobe and light that are left there: each sum is at most their
product, over 2 l + 3 in the first, and its root in the second. R02's eq. 5.19 bounds the energy over all views alone,
from the light field's own coefficients.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from invrender.prefilter.centred import CentredLobe
from invrender.prefilter.energy import lighting_energy, power_per_degree
from recon.harmonics.latlong import theta_factors

Floats = NDArray[np.float64]

# Of the quadrature of the lobe, finer than that of the map's own coefficients, whose error is then part of the bound.
_FINENESS = 1.5


@dataclass(frozen=True, eq=False)
class LightingEnergy:
    """power : |L_l|^2 (l_max + 1, 3). rest : (3,), the energy in all degrees above."""

    power: Floats
    rest: Floats

    @classmethod
    def of(cls, coefficients: ArrayLike, radiance_map: ArrayLike) -> LightingEnergy:
        """That of a lat-long map (H, 2H, 3), constant within each pixel, with its coefficients [R02, eq. 5.15]."""
        power = power_per_degree(coefficients)
        return cls(power, (lighting_energy(radiance_map) - power.sum(axis=0)).clip(0))


@dataclass(frozen=True, eq=False)
class ErrorBound:
    """What maps leave out of the reflected radiance, at angles between view and axis.

    cos_angles : (k,). weights : (k,), of the angles in a picture, sum 1. rms : (k, 3), the root mean square over all
    orientations of light and object; exact for a single lobe, of several the sum of theirs, which is more. largest :
    (k, 3), more than which it is nowhere. reflected : (k, 3), at least so much is reflected (RMS).
    """

    cos_angles: Floats
    weights: Floats
    rms: Floats
    largest: Floats
    reflected: Floats

    def __add__(self, other: ErrorBound) -> ErrorBound:
        """The bound of two sums of lobes together; both are at the same angles."""
        return ErrorBound(
            self.cos_angles,
            self.weights,
            self.rms + other.rms,
            self.largest + other.largest,
            # Neither is negative, and so their product isn't.
            np.hypot(self.reflected, other.reflected),
        )

    def up_to(self, degrees: float) -> ErrorBound:
        """The same of angles up to some degrees alone, of which one must be."""
        kept = self.cos_angles >= np.cos(np.radians(degrees))
        weights = self.weights[kept] / self.weights[kept].sum()
        return ErrorBound(
            self.cos_angles[kept], weights, self.rms[kept], self.largest[kept], self.reflected[kept]
        )

    @property
    def picture_rms(self) -> Floats:
        """(3,), RMS over pictures from all sides."""
        return self._over_picture(self.rms)

    @property
    def picture_largest(self) -> Floats:
        """(3,), more than which no picture's RMS is, from whatever side."""
        return self._over_picture(self.largest)

    @property
    def picture_reflected(self) -> Floats:
        """(3,), at least this is the RMS of the radiance over pictures from all sides."""
        return self._over_picture(self.reflected)

    def _over_picture(self, values: Floats) -> Floats:
        return np.sqrt(self.weights @ values**2)


def error_bound(
    lobe: CentredLobe, rho: Floats, light: LightingEnergy, cos_angles: ArrayLike, weights: ArrayLike
) -> ErrorBound:
    """The bound of a lobe's map, whose terms are rho (n, F + 1, P + 1, min + 1), at cosines (k,) of view to axis.

    light : up to a degree of F or more, which the lobe is looked at up to. Raises ValueError for a lower one.
    """
    cos_angles, weights = np.asarray(cos_angles, float), np.asarray(weights, float)
    l_max, kept = len(light.power) - 1, rho.shape[1] - 1
    if l_max < kept:
        raise ValueError(f"the light's power goes to degree {l_max}, the map to {kept}; give as much or more")
    cos_view = lobe.cos_views(cos_angles)
    whole, energies = lobe.at_views(cos_view, l_max, l_max, _FINENESS)
    p_max, q_max = rho.shape[2] - 1, rho.shape[3] - 1
    factors = theta_factors(cos_view, p_max)[: q_max + 1]
    shown = np.einsum("nlpq,qpk->nklq", rho, factors) * lobe.strength[:, None, None, None]
    left = whole.copy()
    left[:, :, : kept + 1, : q_max + 1] -= shown
    rest = (energies - (whole**2).sum(axis=(2, 3))).clip(0).T
    by_degree, reflected = ((part**2).sum(axis=3).transpose(1, 2, 0) for part in (left, whole))
    shares = light.power / (2 * np.arange(l_max + 1) + 1)[:, None]
    rest_square = rest * light.rest / (2 * l_max + 3)
    rms = np.sqrt((by_degree * shares).sum(axis=1) + rest_square)
    largest = np.sqrt(by_degree * light.power).sum(axis=1) + np.sqrt(rest * light.rest)
    factor = lobe.factor(cos_angles)[:, None]
    shown_rms = np.sqrt((reflected * shares).sum(axis=1))
    return ErrorBound(cos_angles, weights, rms * factor, largest * factor, shown_rms * factor)


def ball_angles(count: int) -> tuple[Floats, Floats]:
    """Cosines (count,) between normal and view over a ball seen from afar, and their weights: Gauss-Legendre.

    Mirrored views of its pixels cover the sphere evenly.
    """
    node, weight = np.polynomial.legendre.leggauss(count)
    return np.sqrt((1 + node) / 2), weight / 2


def sphere_angles(count: int) -> tuple[Floats, Floats]:
    """Cosines (count,) between axis and view where axes are spread evenly over the sphere, and their weights."""
    node, weight = np.polynomial.legendre.leggauss(count)
    return node, weight / 2
