"""The nested search of RH01 section 6.1: simplex outside over the nonlinear parameters, linear solve inside.

Outside: mu and sigma. Inside: Kd and Ks per channel; where strengths of the lighting are unknown, Kd and Ks
multiply unknowns, so that the share Ks / (Kd + Ks) is searched on a line and all else solved linearly.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from itertools import product

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import minimize

from invrender.model.columns import specular_weights
from invrender.model.fresnel import MU_RANGE
from invrender.model.microfacet import SIGMA_RANGE, Microfacet
from invrender.solve.statistics import Statistics

Floats = NDArray[np.float64]

# Points of the line search over the share of Ks.
_SHARES = 17


@dataclass(frozen=True)
class Model:
    """A rung of the ladder of models."""

    name: str
    specular: bool
    fresnel: bool


LADDER = (
    Model("lambertian", specular=False, fresnel=False),
    Model("microfacet without Fresnel", specular=True, fresnel=False),
    Model("microfacet", specular=True, fresnel=True),
)


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


def recovers_light(statistics: Sequence[Statistics]) -> bool:
    """Whether any strength of the lighting is to be found."""
    return any(name != "known" for entry in statistics for name in entry.elements)


def fit(model: Model, statistics: Sequence[Statistics], start: Estimate | None = None) -> Estimate:
    """Fit a model to the statistics of all lightings; `start`, an estimate nearby, saves the coarse search."""
    if not model.specular:
        return _estimate(model, statistics, np.zeros(0))

    def cost(point: Floats) -> float:
        return _estimate(model, statistics, point).cost

    near = None
    if start is not None and start.brdf.sigma is not None:
        near = np.log([start.brdf.sigma, (start.brdf.mu or 1.5) - 1])
    return _estimate(model, statistics, best_point(model, cost, near))


def best_point(model: Model, cost: Callable[[Floats], float], near: Floats | None = None) -> Floats:
    """Where a cost of log sigma and, with a Fresnel factor, log(mu - 1) is least; `near` it, or anywhere."""
    lower, upper = (np.array(bound) for bound in zip(*_bounds(model), strict=True))
    if near is not None:
        return _simplex(cost, np.clip(near[: len(lower)], lower, upper), lower, upper, sizes=(0.02,))
    grid = sorted(_coarse_grid(lower, upper), key=cost)
    other = next((g for g in grid if abs(g[0] - grid[0][0]) > 0.5), grid[1])
    # Restarting once with a fresh simplex undoes the collapse that Nelder-Mead is known for.
    ends = [_simplex(cost, point, lower, upper, sizes=(0.1, 0.02)) for point in (grid[0], other)]
    return min(ends, key=cost)


def _bounds(model: Model) -> list[tuple[float, float]]:
    """Bounds of the search's coordinates: log sigma, and log(mu - 1) where the model has a Fresnel factor."""
    bounds = [(np.log(SIGMA_RANGE[0]), np.log(SIGMA_RANGE[1]))]
    if model.fresnel:
        bounds.append((np.log(MU_RANGE[0] - 1), np.log(MU_RANGE[1] - 1)))
    return bounds


def _coarse_grid(lower: Floats, upper: Floats) -> list[Floats]:
    axes = [np.linspace(lower[0] + 0.2, upper[0] - 0.2, 14), np.log(np.array([0.2, 0.4, 0.7, 1.2]))]
    return [np.array(point) for point in product(*axes[: len(lower)])]


def _simplex(
    cost: Callable[[Floats], float], start: Floats, lower: Floats, upper: Floats, sizes: Sequence[float]
) -> Floats:
    scale = cost(start) + 1e-300
    point = start
    for size in sizes:
        simplex = np.vstack([point, point + size * np.eye(len(point))])
        simplex = np.where(simplex > upper, simplex - 2 * size, simplex)
        point = minimize(
            lambda x: cost(x) / scale,
            point,
            method="Nelder-Mead",
            bounds=list(zip(lower, upper, strict=True)),
            options={"initial_simplex": simplex, "xatol": 1e-6, "fatol": 1e-10, "maxfev": 1000},
        ).x
    return np.asarray(point)


def _estimate(model: Model, statistics: Sequence[Statistics], point: Floats) -> Estimate:
    """The best estimate at given coordinates (log sigma, log(mu - 1))."""
    sigma = float(np.exp(point[0])) if model.specular else None
    mu = 1 + float(np.exp(point[1])) if model.fresnel else None
    weights = specular_weights(mu, sigma) if sigma is not None else None
    reduced = [reduce_statistics(entry, weights) for entry in statistics]
    solve = _solve_strengths if recovers_light(statistics) else _solve_brdf
    cost, kd, ks, strengths = solve(statistics, reduced, model.specular)
    return Estimate(model, Microfacet(kd, ks, mu, sigma), strengths, cost)


def reduce_statistics(entry: Statistics, weights: Floats | None) -> tuple[Floats, Floats]:
    """Normal equations in (diffuse, specular) transfers only: (3, e, 2, e, 2) and (3, e, 2).

    weights : of the specular columns, for given mu and sigma; None leaves the specular part zero.
    """
    gram, right = entry.gram, entry.right
    elements = gram.shape[1]
    small = np.zeros((3, elements, 2, elements, 2))
    small_right = np.zeros((3, elements, 2))
    small[:, :, 0, :, 0] = gram[:, :, 0, :, 0]
    small_right[:, :, 0] = right[:, :, 0]
    if weights is not None:
        half = gram[..., 1:] @ weights  # (3, e, q, e)
        small[:, :, 0, :, 1] = half[:, :, 0]
        small[:, :, 1, :, 0] = half[:, :, 0].transpose(0, 2, 1)
        small[:, :, 1, :, 1] = np.einsum("ceqf,q->cef", half[:, :, 1:], weights)
        small_right[:, :, 1] = right[:, :, 1:] @ weights
    return small, small_right


def _solve_brdf(
    statistics: Sequence[Statistics], reduced: Sequence[tuple[Floats, Floats]], specular: bool
) -> tuple[float, Floats, Floats, dict[str, Floats]]:
    """Known light: Kd and Ks >= 0 per channel."""
    gram = np.sum([small[:, 0, :, 0, :] for small, _ in reduced], axis=0)
    right = np.sum([small_right[:, 0] for _, small_right in reduced], axis=0)
    energy = sum(float(entry.energy.sum()) for entry in statistics)
    solution = np.zeros((3, 2))
    if specular:
        solution = _nonnegative_pair(gram, right)
    else:
        solution[:, 0] = np.maximum(right[:, 0] / np.maximum(gram[:, 0, 0], 1e-300), 0)
    fitted = 2 * (solution * right).sum() - np.einsum("ci,cij,cj->", solution, gram, solution)
    strengths = {entry.lighting: np.ones((1, 3)) for entry in statistics}
    return float(energy - fitted), solution[:, 0], solution[:, 1], strengths


def _nonnegative_pair(gram: Floats, right: Floats) -> Floats:
    """Least squares in two unknowns, both >= 0: gram (c, 2, 2), right (c, 2)."""
    ridge = 1e-13 * np.trace(gram, axis1=1, axis2=2)[:, None, None] * np.eye(2)
    solution = np.linalg.solve(gram + ridge + 1e-300 * np.eye(2), right[:, :, None])[:, :, 0]
    for c in np.flatnonzero((solution < 0).any(axis=1)):
        alone = np.maximum(right[c] / np.maximum(np.diag(gram[c]), 1e-300), 0)
        gain = alone * right[c]
        solution[c] = np.where(np.arange(2) == np.argmax(gain), alone, 0)
    return solution


def _solve_strengths(
    statistics: Sequence[Statistics], reduced: Sequence[tuple[Floats, Floats]], specular: bool
) -> tuple[float, Floats, Floats, dict[str, Floats]]:
    """Partly unknown light: the share of Ks on a line per channel; (Kd + Ks) and its products with strengths."""
    places, has_known = _places(statistics)
    size = len(places) + has_known
    indices = [
        np.array([places.get((entry.lighting, name), size - 1) for name in entry.elements])
        for entry in statistics
    ]

    def solve(shares: Floats) -> tuple[Floats, Floats]:
        """Explained energy (s, 3) and solutions (s, 3, size) at shares (s, 3)."""
        split = np.stack([1 - shares, shares], axis=-1)
        gram, right = np.zeros((len(shares), 3, size, size)), np.zeros((len(shares), 3, size))
        for index, (small, small_right) in zip(indices, reduced, strict=True):
            gram[:, :, index[:, None], index] += np.einsum("sci,ceifj,scj->scef", split, small, split)
            right[:, :, index] += np.einsum("sci,cei->sce", split, small_right)
        ridge = 1e-12 * np.trace(gram, axis1=2, axis2=3)[:, :, None, None] / size
        solution = np.linalg.solve(gram + (ridge + 1e-300) * np.eye(size), right[..., None])[..., 0]
        return (solution * right).sum(axis=-1), solution

    shares = _best_shares(lambda s: solve(s)[0]) if specular else np.zeros(3)
    explained, solutions = solve(shares[None])
    solution = solutions[0]
    if has_known:
        scale = solution[:, -1]
    else:
        sources = [k for (_, name), k in places.items() if name.startswith("source")] or list(places.values())
        scale = solution[:, sources].mean(axis=1)
    scale = np.where(np.abs(scale) > 1e-300, scale, 1e-300)
    strengths = {
        entry.lighting: (solution[:, index] / scale[:, None]).T
        for entry, index in zip(statistics, indices, strict=True)
    }
    energy = sum(float(entry.energy.sum()) for entry in statistics)
    return energy - float(explained.sum()), (1 - shares) * scale, shares * scale, strengths


def _places(statistics: Sequence[Statistics]) -> tuple[dict[tuple[str, str], int], bool]:
    """A place among the unknowns for each (lighting, element) to recover, and whether any light is known."""
    pairs = [(entry.lighting, name) for entry in statistics for name in entry.elements]
    return {pair: k for k, pair in enumerate(p for p in pairs if p[1] != "known")}, any(
        name == "known" for _, name in pairs
    )


def _best_shares(explained: Callable[[Floats], Floats]) -> Floats:
    """Shares (3,) in 0 to 1 that explain most, each channel on its own: a grid, refined, then a parabola."""
    low, high = np.zeros(3), np.ones(3)
    for _ in range(4):
        grid = np.linspace(low, high, _SHARES)
        values = explained(grid)
        top = np.clip(values.argmax(axis=0), 1, _SHARES - 2)
        step = (high - low) / (_SHARES - 1)
        centre = low + top * step
        low, high = np.maximum(centre - step, 0), np.minimum(centre + step, 1)
    channel = np.arange(3)
    before, at, after = (values[top + k, channel] for k in (-1, 0, 1))
    bend = before - 2 * at + after
    shift = np.where(bend < 0, (before - after) / np.where(bend < 0, 2 * bend, 1), 0)
    return np.clip(centre + np.clip(shift, -1, 1) * step, 0, 1)
