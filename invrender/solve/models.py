"""Models of the BRDF that are fitted, and what a fit of one yields."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from invrender.model.columns import specular_weights
from invrender.model.lobes import PRINTED, LobeForm
from invrender.model.microfacet import Microfacet
from invrender.solve.linear import solve_linear
from invrender.solve.statistics import Statistics

Floats = NDArray[np.float64]


@dataclass(frozen=True)
class Model:
    """A rung of the ladder of models. form : of the specular part. neutral : whether its Ks is one for all channels."""

    name: str
    specular: bool
    fresnel: bool
    form: LobeForm = PRINTED
    neutral: bool = False

    @property
    def parameters(self) -> int:
        """Count of its numbers."""
        return 3 + self.specular * (1 if self.neutral else 3) + self.specular + self.fresnel


@dataclass(frozen=True, eq=False)
class Estimate:
    """The best parameters of one model.

    brdf : Kd and Ks; mu and sigma are None where the model lacks them.
    strengths : per lighting (elements, 3); 1 for what is known. With no known light at all the gauge is
        a mean strength of 1 per channel, over all sources (over all elements where there is no source).
    cost : weighted sum of squared residuals.
    """

    model: Model
    brdf: Microfacet
    strengths: Mapping[str, Floats]
    cost: float


def estimate_at(model: Model, statistics: Sequence[Statistics], point: Floats) -> Estimate:
    """The best estimate at given coordinates (log sigma, log(mu - 1)), as many as the model has."""
    sigma = float(np.exp(point[0])) if model.specular else None
    mu = 1 + float(np.exp(point[1])) if model.fresnel else None
    weights = None if sigma is None else specular_weights(mu, sigma, model.form)
    found = solve_linear(statistics, weights, model.neutral)
    brdf = Microfacet(found.kd, found.ks, mu, sigma, model.form)
    return Estimate(model, brdf, found.strengths, found.cost)


def coordinates(estimate: Estimate) -> Floats:
    """Where an estimate of a specular model lies: (log sigma,) or (log sigma, log(mu - 1))."""
    brdf = estimate.brdf
    assert brdf.sigma is not None
    return np.log([brdf.sigma] if brdf.mu is None else [brdf.sigma, brdf.mu - 1])
