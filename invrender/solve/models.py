"""Models of the BRDF that are fitted, and what a fit of one yields."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from invrender.model.columns import column_weights
from invrender.model.lobes import PRINTED, LobeForm
from invrender.model.microfacet import Microfacet
from invrender.solve.linear import LinearPart, reduce_statistics, solve_linear
from invrender.solve.statistics import Statistics, Subsets

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
    subsets = Subsets(tuple(statistics))
    points = np.asarray(point, float)[None]
    return estimates(model, subsets, points, solved(model, subsets, points))[0]


def solved(model: Model, subsets: Subsets, points: Floats) -> LinearPart:
    """What is best at coordinates (f, n), one place for each subset of the photographs."""
    reduced = reduce_statistics(subsets, combinations(model, subsets, points))
    return solve_linear(reduced, model.specular, model.neutral)


def combinations(model: Model, subsets: Subsets, points: Floats) -> Floats:
    """Combinations (f, q, 2) of the columns: the diffuse and the specular transfer at coordinates (f, n)."""
    if model.specular:
        return weights_at(model, points)
    result = np.zeros((len(points), subsets.everything[0].gram.shape[2], 2))
    result[:, 0, 0] = 1
    return result


def weights_at(model: Model, points: Floats) -> Floats:
    """`combinations` of a model that has a specular part."""
    mu = 1 + np.exp(points[:, 1]) if model.fresnel else None
    return column_weights(mu, np.exp(points[:, 0]), model.form)


def estimates(model: Model, subsets: Subsets, points: Floats, linear: LinearPart) -> list[Estimate]:
    """The estimates, one for each subset of the photographs, that were found at coordinates (f, n)."""
    result = []
    for fit, point in enumerate(points):
        sigma = float(np.exp(point[0])) if model.specular else None
        mu = 1 + float(np.exp(point[1])) if model.fresnel else None
        brdf = Microfacet(linear.kd[fit], linear.ks[fit], mu, sigma, model.form)
        shown = subsets.lightings(fit)
        strengths = {name: values[fit] for name, values in linear.strengths.items() if name in shown}
        result.append(Estimate(model, brdf, strengths, float(linear.cost[fit])))
    return result


def coordinates(estimate: Estimate) -> Floats:
    """Where an estimate of a specular model lies: (log sigma,) or (log sigma, log(mu - 1))."""
    brdf = estimate.brdf
    assert brdf.sigma is not None
    return np.log([brdf.sigma] if brdf.mu is None else [brdf.sigma, brdf.mu - 1])
