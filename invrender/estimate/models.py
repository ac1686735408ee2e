"""Models of the BRDF that are fitted, and what a fit of one yields."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from invrender.brdf.form import LobeForm
from invrender.brdf.fresnel import MU_RANGE
from invrender.brdf.lobes import RH01_FORM
from invrender.brdf.microfacet import SIGMA_RANGE, Microfacet
from invrender.brdf.richer import FIRST_NUMBER, NUMBER_RANGE, SHARES_BEYOND
from invrender.estimate.linear import LinearPart, reduce_statistics, solve_linear
from invrender.estimate.statistics import Statistics, Subsets
from invrender.transport.columns import column_weights

Floats = NDArray[np.float64]


@dataclass(frozen=True)
class Model:
    """A candidate model. form : of the specular part. neutral : whether one Ks serves all channels."""

    name: str
    specular: bool
    fresnel: bool
    form: LobeForm = RH01_FORM
    neutral: bool = False

    @property
    def parameters(self) -> int:
        """Count of its numbers."""
        return 3 + self.specular * (1 if self.neutral else 3) + len(self.coordinates)

    @property
    def coordinates(self) -> tuple[str, ...]:
        """The nonlinear numbers, as searches order them: "sigma", "mu", the form's own."""
        if not self.specular:
            return ()
        return ("sigma", *(["mu"] if self.fresnel else []), *self.form.numbers)

    @property
    def of_base(self) -> tuple[int, ...]:
        """Places of the coordinates that move the base below the lobe."""
        moving = {"mu"} if self.form.interface else {"coat"}
        return tuple(k for k, name in enumerate(self.coordinates) if name in moving)


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
    """The best estimate at given coordinates (log sigma, log(mu - 1), the form's own), as many as the model has."""
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
    values = _values(model, points)
    numbers = {name: values[name] for name in model.form.numbers}
    return column_weights(values.get("mu"), values["sigma"], model.form, numbers)


def estimates(model: Model, subsets: Subsets, points: Floats, linear: LinearPart) -> list[Estimate]:
    """The estimates, one for each subset of the photographs, that were found at coordinates (f, n)."""
    result = []
    for fit, point in enumerate(points):
        values = {name: float(value) for name, value in _values(model, point).items()}
        form = model.form.with_numbers({name: values[name] for name in model.form.numbers})
        brdf = Microfacet(linear.kd[fit], linear.ks[fit], values.get("mu"), values.get("sigma"), form)
        shown = subsets.lightings(fit)
        strengths = {
            name: linear.strengths[entry.lighting][fit]
            for entry in subsets.everything
            if entry.lighting in shown
            for name in entry.names
        }
        result.append(Estimate(model, brdf, strengths, float(linear.cost[fit])))
    return result


def coordinates(model: Model, brdf: Microfacet) -> Floats:
    """Where a specular model's search starts from a BRDF: at its numbers, and at usual ones where it lacks them."""
    assert brdf.sigma is not None
    values = {**FIRST_NUMBER, **brdf.form.numbers, "sigma": brdf.sigma, "mu": brdf.mu or _FIRST_MU}
    return np.array([_COORDINATE[name](values[name]) for name in model.coordinates])


def bounds_of(model: Model) -> tuple[Floats, Floats]:
    """Bounds of the search's coordinates."""
    ranges = {"sigma": SIGMA_RANGE, "mu": MU_RANGE, **NUMBER_RANGE, **model.form.ranges}
    bounds = [[_COORDINATE[name](end) for end in ranges[name]] for name in model.coordinates]
    lower, upper = np.array(bounds, float).reshape(-1, 2).T
    return lower, upper


def _values(model: Model, points: Floats) -> dict[str, Floats]:
    """The numbers at coordinates (..., n), by name."""
    return {name: _VALUE[name](points[..., k]) for k, name in enumerate(model.coordinates)}


# Coordinates of numbers, and numbers at coordinates: searches then move by shares of sigma, mu - 1 and the spread.
_COORDINATE: Mapping[str, Callable[[float], float]] = {
    "sigma": np.log,
    "mu": lambda mu: np.log(mu - 1),
    "coat": float,
    "haze": float,
    "spread": np.log,
    "stretch": np.log,
    **dict.fromkeys(SHARES_BEYOND, float),
}
_VALUE: Mapping[str, Callable[[Floats], Floats]] = {
    "sigma": np.exp,
    "mu": lambda x: 1 + np.exp(x),
    "coat": np.asarray,
    "haze": np.asarray,
    "spread": np.exp,
    "stretch": np.exp,
    **dict.fromkeys(SHARES_BEYOND, np.asarray),
}
_FIRST_MU = 1.5
