"""A first answer from nothing: trial BRDFs, the light that they imply, and sources at its sharp peaks."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import product

import numpy as np
from numpy.typing import NDArray

from invrender.model.fresnel import MU_RANGE
from invrender.solve.blind.projection import ITERATIONS, Fit, refine, solve_lighting
from invrender.solve.blind.sight import Sight
from invrender.solve.blind.state import State, turn
from recon.harmonics import degree_of, degrees, evaluate_harmonics, sphere_directions

Floats = NDArray[np.float64]

_ROUGHNESSES, _SHARES, _TRIED = (0.08, 0.15, 0.3), (0.1, 0.6), 2
_FIRST_MU = 1.5
_GRID = 20000
# Width, radians, of the peaks that are looked for, and how far apart they are.
_PEAK, _APART = 0.08, 0.35
_PEAKS = 4
# Squared residuals in noise units, per parameter and log of the count of numbers, that a source must save [Schwarz
# 1978's criterion].
_PER_SOURCE = 5
# Iterations until a source has shown its worth.
_FEW = 6
_MOST_SOURCES = 6


@dataclass(frozen=True, eq=False)
class Region:
    """Where on the sphere of directions sources are looked for: within `radius`, radians, of a unit direction."""

    direction: Floats
    radius: float

    def __post_init__(self) -> None:
        direction = np.asarray(self.direction, float)
        if direction.shape != (3,) or not np.isfinite(direction).all():
            raise ValueError(
                f"the source region's direction is {direction.tolist()}; it must be three finite numbers"
            )
        if abs(np.linalg.norm(direction) - 1) > 1e-4:
            raise ValueError(
                f"the source region's direction {direction.tolist()} has length {np.linalg.norm(direction):.3g},"
                " outside the sphere of directions; divide it by its length"
            )
        if not 0 < self.radius <= np.pi:
            raise ValueError(
                f"the source region's radius is {self.radius} rad, outside the sphere of directions; it must be"
                " above 0 and at most pi"
            )
        object.__setattr__(self, "direction", direction)

    def holds(self, directions: Floats) -> NDArray[np.bool_]:
        """Whether it holds directions (..., 3)."""
        return np.asarray(directions @ self.direction >= np.cos(self.radius))


@dataclass(frozen=True, eq=False)
class Search:
    """Photographs as searches take them.

    weights, trust : (n, 3) per photograph, as in `noise.Weights`. scale : (3,) of the light, that the prior goes by.
    """

    sights: Sequence[Sight]
    weights: Sequence[Floats]
    trust: Sequence[Floats]
    scale: Floats
    region: Region | None = None

    @property
    def problem(self) -> tuple[Sequence[Sight], Sequence[Floats], Floats]:
        """What the solvers take: sights, weights, and the light's scale."""
        return self.sights, self.weights, self.scale

    @property
    def numbers(self) -> int:
        return sum(weight.size for weight in self.weights)

    def fit(self, state: State, l_max: int, iterations: int = ITERATIONS) -> Fit:
        """The best fit near a state."""
        return refine(*self.problem, state, l_max, iterations)

    def at(self, state: State, l_max: int) -> Fit:
        """The best lighting at a state."""
        return solve_lighting(*self.problem, state, l_max)


def first_state(search: Search, l_max: int) -> State:
    """The likeliest of a few shares and roughnesses, with a source at a peak of the light that they imply."""
    trials = []
    for sigma, share in product(_ROUGHNESSES, _SHARES):
        bare = search.at(State(np.full(3, share), _FIRST_MU, sigma, np.zeros((0, 3))), l_max)
        peaks = light_peaks(bare.light, search.region)[:_TRIED]
        trials += [bare, *(search.at(bare.state.with_source(peak), l_max) for peak in peaks)]
    return min(trials, key=lambda fit: fit.cost).state


def light_peaks(light: Floats, region: Region | None) -> Floats:
    """Directions (k, 3) of the sharpest peaks of light ((l_max + 1)^2, 3), highest first."""
    l_max = degree_of(len(light))
    l = degrees(l_max)
    # Area lights have little power in the degrees that the Laplacian raises.
    sharpened = light.sum(axis=1) * l * (l + 1) * np.exp(-((_PEAK * l) ** 2))
    grid = sphere_directions(_GRID)
    if region is not None:
        grid = grid[region.holds(grid)]
    height = evaluate_harmonics(grid, l_max) @ sharpened
    peaks: list[Floats] = []
    while len(peaks) < _PEAKS and len(grid) and height.max() > 0:
        peaks.append(grid[height.argmax()])
        away = grid @ peaks[-1] < np.cos(_APART)
        grid, height = grid[away], height[away]
    return np.array(peaks).reshape(-1, 3)


@dataclass(frozen=True, eq=False)
class Found:
    """The best fit with as many sources as are worth their parameters.

    split : a fit that explains more with one of them as two, nearer to each other than the lobe is wide; None if no
    such does.
    """

    fit: Fit
    split: Fit | None


def find_sources(search: Search, start: State, l_max: int) -> Found:
    """Sources entered one at a time, each refined with all else and kept only where the photographs ask for it."""
    fit = _bright(search, _sensible(search, search.fit(start, l_max)))
    while len(fit.state.directions) < _MOST_SOURCES:
        known, apart = fit.state.directions, np.cos(fit.state.sigma or _PEAK)
        peaks = [
            p for p in light_peaks(fit.light[: (l_max + 1) ** 2], search.region) if (known @ p < apart).all()
        ]
        if not peaks:
            break
        entered = min((search.at(fit.state.with_source(peak), l_max) for peak in peaks), key=lambda f: f.cost)
        better = _bright(search, _sensible(search, search.fit(entered.state, l_max, _FEW)))
        ways = better.state.directions
        close = len(ways) > 1 and (ways @ ways.T - 2 * np.eye(len(ways))).max() > apart
        # Its entry may have let an earlier one go dark, whose place it then takes.
        if close or not worth_it(search, better, fit):
            break
        fit = better
    if len(start.directions) and len(fit.state.directions):
        # The first was taken on trust.
        without = search.fit(fit.state.without_source(0), l_max, _FEW)
        fit = fit if worth_it(search, fit, without) else without
    return Found(fit, _split(search, fit))


def _split(search: Search, fit: Fit) -> Fit | None:
    """The best fit with one source as two, if that is worth it."""
    if fit.state.sigma is None or not len(fit.state.directions):
        return None
    offset = fit.state.sigma / 2
    trials = []
    for direction in fit.state.directions:
        for way in (*np.eye(2), *-np.eye(2)):
            trials.append(search.at(fit.state.with_source(turn(direction, *(offset * way))), fit.l_max))
    best = min(trials, key=lambda f: f.cost)
    best = search.fit(best.state, fit.l_max, _FEW)
    near = (best.state.directions[:-1] @ best.state.directions[-1]).max() > np.cos(best.state.sigma or 0.0)
    return best if near and worth_it(search, best, fit) else None


def worth_it(search: Search, fit: Fit, simpler: Fit) -> bool:
    """Whether a source saves what its parameters cost, is bright, and lies where sources are looked for."""
    size = (fit.l_max + 1) ** 2
    noise = max(fit.cost / search.numbers, 1e-300)
    saves = simpler.cost - fit.cost > _PER_SOURCE * np.log(search.numbers) * noise
    inside = search.region is None or bool(search.region.holds(fit.state.directions).all())
    return bool(saves and inside and (fit.light[size:].sum(axis=1) > 0).all())


def _bright(search: Search, fit: Fit) -> Fit:
    """The fit without sources that would have to take light away."""
    dark = np.flatnonzero(fit.light[(fit.l_max + 1) ** 2 :].sum(axis=1) <= 0)
    return search.fit(fit.state.without_source(dark), fit.l_max) if len(dark) else fit


def _sensible(search: Search, fit: Fit) -> Fit:
    """The fit, without Fresnel factor where that runs to the end of its range and explains less than none does."""
    if fit.state.mu is None or fit.state.mu < MU_RANGE[1]:
        return fit
    return min(fit, search.fit(replace(fit.state, mu=None), fit.l_max), key=lambda f: f.cost)


def thinned(search: Search, l_max: int, most: int) -> Search:
    """The same with at most about `most` samples, evenly taken."""
    total = sum(len(sight.field) for sight in search.sights)
    every = max(1, int(np.ceil(total / most)))
    if every == 1 and all(sight.l_max == l_max for sight in search.sights):
        return search
    sights, weights, trusts = [], [], []
    for k, (sight, weight, trust) in enumerate(zip(search.sights, search.weights, search.trust, strict=True)):
        keep = np.arange(len(sight.field)) % every == k % every
        sights.append(Sight.of(sight.field.where(keep), l_max, sight.transfer))
        weights.append(weight[keep])
        trusts.append(trust[keep])
    return replace(search, sights=sights, weights=weights, trust=trusts)
