"""The nested search of RH01 section 6.1: outside over the nonlinear parameters, linear solve inside.

Outside: mu and sigma, from a grid by Gauss-Newton steps (`newton`), which get by with fewer points than RH01's simplex;
it remains for costs that come without slopes. Inside: Kd, Ks and what is unknown of the light (`linear`).
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from dataclasses import replace
from itertools import product

import numpy as np
from numpy.typing import NDArray

from invrender.brdf.form import LobeForm
from invrender.brdf.lobes import BECKMANN, GGX_FORM, PHONG, PLASTICS, RH01_FORM
from invrender.brdf.richer import FIRST_NUMBER, SHARES_BEYOND
from invrender.estimate.models import Estimate, Model, bounds_of, coordinates, estimates, solved
from invrender.estimate.newton import SMALL, gauss_newton
from invrender.estimate.statistics import Statistics, Subsets, with_known_as_one

Floats = NDArray[np.float64]

# Part of a standard deviation to which rivals are fitted before the better one is.
_TELLING = 0.3
# Steps after which most of many starts are given up.
_FEW_STEPS = 3


# Forms beside RH01's own.
OTHER_FORMS = (BECKMANN, GGX_FORM, *PLASTICS.values(), PHONG)


def models_of(form: LobeForm) -> tuple[Model, ...]:
    """The models with a specular part of this form, those with fewer parameters first."""
    plain = Model(f"{form.name} without Fresnel", specular=True, fresnel=False, form=form)
    if not form.has_fresnel:
        return (replace(plain, name=form.name),)
    full = Model(form.name, specular=True, fresnel=True, form=form)
    # An interface has an index.
    return (full,) if form.interface else (plain, full)


LADDER = (Model("lambertian", specular=False, fresnel=False), *models_of(RH01_FORM))


def with_neutral(models: Sequence[Model]) -> tuple[Model, ...]:
    """The models, before each that has a specular part its neutral likeness."""
    return tuple(
        each
        for model in models
        for each in (
            (replace(model, name=f"neutral {model.name}", neutral=True), model)
            if model.specular
            else (model,)
        )
    )


def fit(
    model: Model, statistics: Sequence[Statistics], start: Estimate | None = None, small: float = SMALL
) -> Estimate:
    """Fit a model to the statistics of all lightings, made of columns of the model's form.

    start : an estimate nearby, saves the search. small : part of a standard deviation that the last step may have.
    """
    subsets = Subsets(with_known_as_one(statistics))
    if not model.specular or (start is not None and start.brdf.sigma is not None):
        return fit_subsets(model, subsets, start, small)[0]
    lower, upper = bounds_of(model)
    grid = _grid(model)
    costs = solved(model, subsets.take([0] * len(grid)), grid).cost
    starts = grid[_starts(model, grid, costs)]

    def ranked(starts: Floats, **steps: int) -> list[Estimate]:
        found = gauss_newton(model, subsets.take([0] * len(starts)), starts, lower, upper, _TELLING, **steps)
        return sorted(found, key=lambda estimate: estimate.cost)

    # Of many starts, the better third goes on after a few steps.
    while len(starts) > 2:
        better = ranked(starts, most_steps=_FEW_STEPS)[: max(len(starts) // 3, 2)]
        starts = np.array([coordinates(model, estimate.brdf) for estimate in better])
    return fit_subsets(model, subsets, ranked(starts)[0], small)[0]


def fit_subsets(
    model: Model, subsets: Subsets, start: Estimate | None, small: float = SMALL
) -> list[Estimate]:
    """Fits to subsets of the photographs, from an estimate near all of them, which a specular model needs."""
    count = len(subsets)
    if not model.specular:
        points = np.zeros((count, 0))
        return estimates(model, subsets, points, solved(model, subsets, points))
    assert start is not None
    lower, upper = bounds_of(model)
    point = coordinates(model, start.brdf)
    return gauss_newton(model, subsets, np.tile(point, (count, 1)), lower, upper, small)


def _grid(model: Model) -> Floats:
    """Coordinates (g, n) that a search starts at the best of."""
    lower, upper = bounds_of(model)
    sigma, mu = _axes(lower, upper)
    own = {name: [value] for name, value in FIRST_NUMBER.items()}
    # Between shares of lobes there are several minima.
    own |= {name: [0.2, 0.8] for name in SHARES_BEYOND}
    own |= {name: [float(np.log(low * high)) / 2] for name, (low, high) in model.form.ranges.items()}
    axes: dict[str, Iterable[float]] = {**own, "sigma": sigma, "mu": mu, "spread": np.log([2.5, 6.0])}
    return np.array(list(product(*[axes[name] for name in model.coordinates])))


def starting_points(
    costs: Callable[[Sequence[Floats]], Sequence[float]], lower: Floats, upper: Floats
) -> list[Floats]:
    """Where to search from: the best point of a coarse grid, and the best of those far from it.

    costs : of several points.
    """
    grid = _coarse_grid(lower, upper)
    return [grid[k] for k in _rivals(np.array(grid), np.array(costs(grid)))]


def _rivals(grid: Floats, costs: Floats) -> list[int]:
    """Places of the best point of a grid (g, n), and of the best of those far from it."""
    best, *others = np.argsort(costs, kind="stable").tolist()
    return [best, next((k for k in others if abs(grid[k, 0] - grid[best, 0]) > 0.5), others[0])]


def _starts(model: Model, grid: Floats, costs: Floats) -> list[int]:
    """Places in a grid (g, n) to search from: its rivals, and the best with each set of shares of lobes."""
    own = [k for k, name in enumerate(model.coordinates) if name in SHARES_BEYOND]
    chosen = _rivals(grid, costs)
    if own:
        order = np.argsort(costs, kind="stable")
        chosen += order[np.unique(grid[order][:, own], axis=0, return_index=True)[1]].tolist()
    return list(dict.fromkeys(chosen))


def _coarse_grid(lower: Floats, upper: Floats) -> list[Floats]:
    return [np.array(point) for point in product(*_axes(lower, upper)[: len(lower)])]


def _axes(lower: Floats, upper: Floats) -> tuple[Floats, Floats]:
    """Points over log sigma and over log(mu - 1)."""
    return np.linspace(lower[0] + 0.2, upper[0] - 0.2, 18), np.log(np.array([0.2, 0.4, 0.7, 1.2]))
