"""Harmonic coefficients of a BRDF from photographs under known light, by a linear solve [RH01, section 6.1].

Weighted least squares on B cos theta_o, each sample counting alike: samples are spread evenly over normals, so over
views as well, and with darkness below the horizon the sum stands for the integral over all surface frames and views
in which harmonics are orthogonal. So light and BRDF of degrees beyond those solved for touch the others little: that
they are missing shows in the residuals, and as ringing. A fit of two degrees more measures by how much, and
is part of every standard deviation.

What is known beforehand of a coefficient is the bound that conservation of energy puts on it.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from invrender.brdf.form import Axis
from invrender.inverse_brdf.brushed_harmonics import BrushedBasis
from invrender.inverse_brdf.covariance import larger_covariance
from invrender.inverse_brdf.leastsquares import Basis, harmonic_equations, scatter_of, solve
from invrender.inverse_brdf.reciprocal import IsotropicBasis, rows, source_light
from invrender.theory.conditioning import Information, inverse_brdf
from recon.harmonics.basis import check_degree, check_unit, finite, to_degree
from recon.sampling.lightfield import LightField

Floats = NDArray[np.float64]
Bools = NDArray[np.bool_]

# A coefficient is determined if its standard deviation is below this share of its bound: the bound then moves it by at
# most so much of its standard deviation.
_DETERMINED = 0.3
# Degrees more, of both parities, that measure what is left out.
FURTHER = 2
_RAYS_AT_A_TIME = 4096


@dataclass(frozen=True, eq=False)
class HarmonicBRDF:
    """Coefficients up to a degree per channel: rho_lpq of `reciprocal.unknowns`, or rho_lnpq of a brushed surface.

    basis : whose unknowns they are.
    coefficients : (k, 3). Of what isn't determined they are the best guess within the bounds, about 0.
    covariance : (3, k, k), the larger of what independent and what tile-wise residuals imply, plus truncation.
    truncation : (k, 3), by how much a fit of two degrees more puts a coefficient elsewhere.
    determined : (k, 3). reasons : (k,), why a coefficient isn't, in words; empty where it is in all channels.
    noise : (3,), RMS of what the fit leaves of B cos theta_o. residual : relative RMS of radiance, all channels.
    gains : (order + 1, 3), how the lighting passes a degree on [R02, eq. 2.64]; the largest over all photographs.
    singular_values : (3, k), of the actual samples in units of noise and bounds. rank : (3,), how many they determine.
    """

    basis: Basis
    coefficients: Floats
    covariance: Floats
    truncation: Floats
    determined: Bools
    reasons: tuple[str, ...]
    noise: Floats
    residual: float
    gains: Floats
    singular_values: Floats
    rank: Floats

    @property
    def order(self) -> int:
        """The highest degree."""
        return self.basis.order

    @property
    def std(self) -> Floats:
        """Standard deviations (k, 3)."""
        return np.sqrt(np.diagonal(self.covariance, axis1=1, axis2=2)).T

    def reciprocal_values(self, incident: Floats, cos_exitant: Floats) -> Floats:
        """rho cos theta_i cos theta_o, (n, 3), for incident directions (n, 3) in frames whose x axis is the view's.

        Of an isotropic BRDF, as is its standard deviation.
        """
        found = rows(source_light(incident, self.order), cos_exitant)[..., 0]
        return np.asarray(found @ self.coefficients)

    def reciprocal_std(self, incident: Floats, cos_exitant: Floats) -> Floats:
        """Standard deviations (n, 3) of `reciprocal_values`."""
        found = rows(source_light(incident, self.order), cos_exitant)[..., 0]
        return np.sqrt(np.einsum("nk,ckj,nj->nc", found, self.covariance, found).clip(0))

    def radiance(self, lighting: Floats, normals: Floats, views: Floats) -> Floats:
        """Radiance (n, 3) under lighting of coefficients ((l_max + 1)^2, 3), of which degrees up to the order count.

        normals, views : (n, 3) unit; views above the surface.
        """
        check_unit(normals, "normals")
        check_unit(views, "views")
        light = to_degree(lighting, self.order)
        result = np.zeros((len(normals), 3))
        if not len(normals):
            return result
        for part in np.array_split(np.arange(len(normals)), len(normals) // _RAYS_AT_A_TIME + 1):
            cos = (normals[part] * views[part]).sum(axis=1)
            found = self.basis.rows(light, normals[part], views[part])
            result[part] = np.einsum("nkc,kc->nc", found, self.coefficients) / cos[:, None]
        return result


def estimate_harmonic(
    fields: Sequence[LightField], lights: Sequence[Floats], order: int, axis: Axis | None = None
) -> HarmonicBRDF:
    """The BRDF's coefficients up to a degree from samples of photographs, and the light on each.

    axis : of a brushed sphere, about which its tangents go; None for an isotropic BRDF. lights : per photograph, real
    coefficients ((l_max + 1)^2, 3) of its lighting in the world; degrees up to order + 2 count, those that are missing
    are dark. Raises ValueError for an order below 0, light or radiance that isn't finite, and fewer samples than
    unknowns.
    """
    check_degree(order, "order")
    basis, further = (
        IsotropicBasis(degree) if axis is None else BrushedBasis(degree, axis)
        for degree in (order, order + FURTHER)
    )
    count = sum(len(field) for field in fields)
    if count <= len(further.bounds):
        raise ValueError(
            f"there are {count} samples for the {len(basis.bounds)} coefficients of order {order}, or"
            f" {len(further.bounds)} with the two degrees more that measure what is left out; take a lower order, more"
            " photographs or more samples"
        )
    lights = [finite(to_degree(light, order + FURTHER), "lighting") for light in lights]
    whole = harmonic_equations(fields, lights, further)
    richer = solve(whole)
    kept = np.max(further.degrees, axis=0) <= order
    equations = whole.of(kept)
    found = solve(equations)

    lights = [to_degree(light, order) for light in lights]
    scatter, residual = scatter_of(fields, lights, basis, found.solution)
    shrinking = np.diag(equations.bounds**-2)
    statistical = larger_covariance(
        [
            found.inverse
            @ (equations.freedom * entry / found.noise2[:, None, None] ** 2 + shrinking)
            @ found.inverse
            for entry in scatter
        ]
    )
    # What is left out pulls in a direction that the next degrees show, and by about as much in others.
    shift = richer.solution[:, kept] - found.solution
    everywhere = np.mean(shift**2, axis=1)[:, None, None] * np.eye(shift.shape[1])
    covariance = statistical + shift[:, :, None] * shift[:, None, :] + everywhere

    std = np.sqrt(np.diagonal(covariance, axis1=1, axis2=2)).T
    determined = std < _DETERMINED * equations.bounds[:, None]
    gains = np.max([[inverse_brdf(channel).gains for channel in light.T] for light in lights], axis=0).T
    determinations = [
        Information(matrix / noise2).against(equations.bounds)
        for matrix, noise2 in zip(equations.matrix, found.noise2, strict=True)
    ]
    return HarmonicBRDF(
        basis=basis,
        coefficients=found.solution.T,
        covariance=covariance,
        truncation=shift.T,
        determined=determined,
        reasons=_reasons(determined, gains, np.sqrt(found.noise2 / count), basis),
        noise=np.sqrt(found.noise2),
        residual=residual,
        gains=gains,
        singular_values=np.stack([entry.singular_values for entry in determinations]),
        rank=np.array([entry.effective_rank for entry in determinations]),
    )


def _reasons(determined: Bools, gains: Floats, noise: Floats, basis: Basis) -> tuple[str, ...]:
    """Why coefficients aren't determined. noise : (3,), that of the mean of all samples."""
    l, p = basis.degrees
    bounds = basis.bounds
    largest = np.array([bounds[(l == degree) | (p == degree)].max() for degree in range(basis.order + 1)])
    # Were the samples everywhere, a coefficient of that degree of light would be known as well as this.
    with np.errstate(divide="ignore"):
        reachable = 4 * np.pi * noise / gains
    lit = np.all(reachable < _DETERMINED * largest[:, None], axis=1)
    reasons = []
    for index in range(len(l)):
        if np.all(determined[index]):
            reasons.append("")
        elif not lit[l[index]] and not lit[p[index]]:
            dark = sorted({int(l[index]), int(p[index])})
            named = f"degree {dark[0]}" if len(dark) == 1 else f"degrees {dark[0]} and {dark[1]}"
            reasons.append(f"the light has nothing of {named} that stands out of the noise")
        else:
            reasons.append("these normals and views don't separate it from other coefficients")
    return tuple(reasons)
