"""What factorization under wholly unknown lighting hands on, and the radiance that it predicts."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from invrender.factorization import Quantity
from invrender.model.formtable import form_radiance
from invrender.model.fresnel import normalised_fresnel
from invrender.model.lobes import PRINTED, Angles, LobeForm
from invrender.model.lobetable import Transfer, specular_radiance
from invrender.solve.blind.projection import Fit
from invrender.solve.blind.rungs import BlindRung
from invrender.solve.blind.state import State
from invrender.solve.noise import NoiseModel, Weights
from invrender.theory.harmonics import project_sources
from invrender.theory.lambertian import irradiance
from recon.lightfield import LightField

Floats = NDArray[np.float64]

GAUGE = (
    "no light is known, so the overall scale of light against reflectance is free in each channel: Kd + Ks = 1 in each,"
    " and the lighting is in units of the photographs over that"
)


@dataclass(frozen=True, eq=False)
class BlindSources:
    """Directional sources: directions (k, 3) unit, irradiances (k, 3) and their standard deviations.

    direction_std_deg : (k,) degrees, along the worse of two ways.
    """

    directions: Floats
    irradiances: Floats
    irradiance_std: Floats
    direction_std_deg: Floats


@dataclass(frozen=True, eq=False)
class BlindSolution:
    """BRDF and lighting of a homogeneous convex body, up to a scale per channel (`gauge`).

    model : name of the chosen rung. brdf_share : (3,) kappa = Ks / (Kd + Ks); whether the specular part is neutral is
    not seen where the light's colour is unknown. mu, sigma : None where the model lacks them; sigma in radians. form :
    of the lobe. coefficients, coefficients_std : ((l_max + 1)^2, 3), the lighting without its sources, at
    index l*l + l + m. sources : those found. determined_degree : the degree up to which the photographs, not the
    prior, determine the lighting; -1 if not even the mean. quantities : "kd_normalised", "ks_normalised", "mu",
    "sigma", and "lighting" where degrees of it aren't determined. degree_shares : (l_max + 1,), mean share of what is
    known of a coefficient that comes from the photographs. covariance, covariance_names : of the shares, mu, sigma and
    the sources' turns (radians). rungs, chosen : the ladder. noise, weights : as in `noise`, weights per photograph.
    transfer : of the lobe, that the fit went by.
    """

    model: str
    brdf_share: Floats
    mu: float | None
    sigma: float | None
    form: LobeForm
    coefficients: Floats
    coefficients_std: Floats
    sources: BlindSources
    determined_degree: int
    degree_shares: Floats
    quantities: Mapping[str, Quantity]
    covariance: Floats
    covariance_names: tuple[str, ...]
    rungs: tuple[BlindRung, ...]
    chosen: int
    noise: NoiseModel
    weights: tuple[Weights, ...]
    gauge: str
    warnings: tuple[str, ...]
    transfer: Transfer = "exact"

    @property
    def l_max(self) -> int:
        """Degree of the lighting."""
        return self.rungs[self.chosen].fit.l_max

    @property
    def normalised_coefficients(self) -> Floats:
        """The whole lighting's coefficients ((l_max + 1)^2, 3), sources included, over those of degree 0."""
        total = with_sources(self.rungs[self.chosen].fit)
        return np.asarray(total / total[0])


def with_sources(fit: Fit) -> Floats:
    """Coefficients ((l_max + 1)^2, 3) of all light, the sources' added to the slow light's."""
    size = (fit.l_max + 1) ** 2
    slow = fit.light[:size]
    if not len(fit.state.directions):
        return slow
    return np.asarray(slow + project_sources(fit.state.directions, fit.light[size:], fit.l_max))


def predict_blind(solution: BlindSolution, field: LightField) -> Floats:
    """Radiance (n, 3) of a photograph's samples under the recovered light, in the photographs' units."""
    fit = solution.rungs[solution.chosen].fit
    state, slow = fit.state, fit.light[: (fit.l_max + 1) ** 2]
    strengths = fit.light[len(slow) :]
    total = irradiance(field.normals, slow) + np.maximum(field.normals @ state.directions.T, 0) @ strengths
    total *= 1 - state.kappa
    if state.sigma is not None:
        lobe = _reflected(state, field, slow, solution.transfer)
        for direction, strength in zip(state.directions, strengths, strict=True):
            angles = Angles.between(field.normals, direction, field.views)
            lobe += state.form.reflected(angles, state.mu, state.sigma)[:, None] * strength
        total += state.kappa * lobe
    return np.asarray(field.mean_over_rays(total))


def _reflected(state: State, field: LightField, lighting: Floats, transfer: Transfer) -> Floats:
    """What each ray (m, 3) sees of harmonic light in the lobe, per unit of Ks."""
    if state.form is not PRINTED:
        return form_radiance(field, lighting, state.form, state.mu, state.roughness)
    cos = np.einsum("nk,nk->n", field.normals, field.views)
    return normalised_fresnel(state.mu, cos)[:, None] * specular_radiance(
        field, lighting, state.roughness, transfer
    )
