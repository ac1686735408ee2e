"""A first answer from nothing: trial BRDFs, the light that they imply, and sources at its sharp peaks."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
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

    weights, trust : (n, 3) per photograph, as in `noise.Weights`. scales : (3,) of each lighting by its number, that
    the prior goes by.
    """

    sights: Sequence[Sight]
    weights: Sequence[Floats]
    trust: Sequence[Floats]
    scales: Mapping[int, Floats]
    region: Region | None = None

    @property
    def problem(self) -> tuple[Sequence[Sight], Sequence[Floats], Mapping[int, Floats]]:
        """What the solvers take: sights, weights, and the lightings' scales."""
        return self.sights, self.weights, self.scales

    @property
    def numbers(self) -> int:
        return sum(weight.size for weight in self.weights)

    @property
    def lightings(self) -> list[int]:
        """Numbers of the lightings that photographs are under."""
        return sorted(self.scales)

    def only(self, lighting: int) -> Search:
        """The same with the photographs under one lighting only."""
        mine = [k for k, sight in enumerate(self.sights) if sight.lighting == lighting]
        sights, weights, trust = ([of[k] for k in mine] for of in (self.sights, self.weights, self.trust))
        return Search(sights, weights, trust, {lighting: self.scales[lighting]}, self.region)

    def fit(self, state: State, l_max: int, iterations: int = ITERATIONS) -> Fit:
        """The best fit near a state."""
        return refine(*self.problem, state, l_max, iterations)

    def at(self, state: State, l_max: int) -> Fit:
        """The best lightings at a state."""
        return solve_lighting(*self.problem, state, l_max)


def first_state(search: Search, l_max: int) -> State:
    """The likeliest of a few shares and roughnesses, with each lighting's source at a peak that they imply."""
    trials = []
    for sigma, share in product(_ROUGHNESSES, _SHARES):
        bare = State(np.full(3, share), _FIRST_MU, sigma, np.zeros((0, 3)))
        state, cost = bare, 0.0
        for lighting in search.lightings:
            own = search.only(lighting)
            fits = [own.at(bare, l_max)]
            peaks = light_peaks(fits[0].light[lighting], search.region)[:_TRIED]
            fits += [own.at(bare.with_source(peak, lighting), l_max) for peak in peaks]
            best = min(fits, key=lambda fit: fit.cost)
            cost += best.cost
            for direction in best.state.directions:
                state = state.with_source(direction, lighting)
        trials.append((cost, state))
    return min(trials, key=lambda trial: trial[0])[1]


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

    split : a fit that explains more with one of a lighting's as two, nearer to each other than the lobe is wide; None
    if no such does.
    """

    fit: Fit
    split: Fit | None


def find_sources(search: Search, start: State, l_max: int, peaks_at: int | None = None) -> Found:
    """Sources entered one at a time in each lighting, refined with all else and kept where photographs ask for them.

    l_max : of the light beside them. peaks_at : degree of the light whose peaks they are looked for at; l_max if None.
    """
    fit = _bright(search, _sensible(search, search.fit(start, l_max)))
    open_to = search.lightings
    while open_to:
        entered = fit.state
        for lighting in open_to:
            peak = _best_peak(search.only(lighting), fit, lighting, l_max if peaks_at is None else peaks_at)
            entered = entered if peak is None else entered.with_source(peak, lighting)
        if entered is fit.state:
            break
        better = _bright(search, _sensible(search, search.fit(entered, l_max, _FEW)))
        tried = [k for k in open_to if (entered.owners == k).sum() > (fit.state.owners == k).sum()]
        # An entry may have let an earlier one go dark, whose place it then takes.
        open_to = [k for k in tried if not _close(better.state, k) and worth_it(search, better, fit, k)]
        if len(open_to) < len(tried) and open_to:
            state = better.state
            for lighting in set(tried) - set(open_to):
                state = _with_sources_of(state, fit.state, lighting)
            better = search.fit(state, l_max, _FEW)
        fit = better if open_to else fit
    fit = _without_needless(search, fit, start)
    return Found(fit, _split(search, fit))


def _best_peak(search: Search, fit: Fit, lighting: int, degree: int) -> Floats | None:
    """The peak (3,) of one lighting that explains most as a source; None if there is none, or sources enough."""
    state = fit.state.under(lighting)
    if len(state.directions) >= _MOST_SOURCES:
        return None
    seen = fit if degree == fit.l_max else search.at(state, degree)
    apart = np.cos(state.sigma or _PEAK)
    peaks = [
        peak
        for peak in light_peaks(seen.slow(lighting), search.region)
        if (state.directions @ peak < apart).all()
    ]
    entered = (search.at(state.with_source(peak, lighting), fit.l_max) for peak in peaks)
    best = min(entered, key=lambda f: f.cost, default=None)
    return None if best is None else best.state.directions[-1]


def _close(state: State, lighting: int) -> bool:
    """Whether two sources of a lighting are nearer to each other than the lobe is wide."""
    ways = state.under(lighting).directions
    return len(ways) > 1 and (ways @ ways.T - 2 * np.eye(len(ways))).max() > np.cos(state.sigma or _PEAK)


def _with_sources_of(state: State, other: State, lighting: int) -> State:
    """A state with the sources that another has in one lighting."""
    result = state.without_source(np.flatnonzero(state.owners == lighting))
    for direction in other.under(lighting).directions:
        result = result.with_source(direction, lighting)
    return result


def _without_needless(search: Search, fit: Fit, start: State) -> Fit:
    """The fit without those sources that the start took on trust, each lighting's first, where they save too little."""
    trusted = [k for k in search.lightings if k in start.owners and k in fit.state.owners]
    if not trusted:
        return fit
    first = np.array([int(np.flatnonzero(fit.state.owners == k)[0]) for k in trusted])
    without = search.fit(fit.state.without_source(first), fit.l_max, _FEW)
    needless = []
    for lighting, index in zip(trusted, first, strict=True):
        # With the BRDF held, too: it may go far to make up for the others'.
        held = search.only(lighting).at(fit.state.without_source(index).under(lighting), fit.l_max)
        if not all(worth_it(search, fit, simpler, lighting) for simpler in (without, held)):
            needless.append(index)
    if len(needless) == len(trusted):
        return without
    return search.fit(fit.state.without_source(np.array(needless)), fit.l_max, _FEW) if needless else fit


def _split(search: Search, fit: Fit) -> Fit | None:
    """The best fit with a source as two, in each lighting in which that is worth it."""
    if fit.state.sigma is None:
        return None
    state = fit.state
    for lighting in search.lightings:
        second = _second(search, fit, lighting)
        state = state if second is None else state.with_source(second, lighting)
    return None if state is fit.state else search.fit(state, fit.l_max, _FEW)


def _second(search: Search, fit: Fit, lighting: int) -> Floats | None:
    """Where a lighting has a second source beside one of its own; None if nothing asks for one."""
    own, state, offset = search.only(lighting), fit.state.under(lighting), (fit.state.sigma or 0.0) / 2
    trials = []
    for direction in state.directions:
        for way in (*np.eye(2), *-np.eye(2)):
            trials.append(own.at(state.with_source(turn(direction, *(offset * way)), lighting), fit.l_max))
    if not trials:
        return None
    best = own.fit(min(trials, key=lambda f: f.cost).state, fit.l_max, _FEW)
    single = own.fit(state, fit.l_max, _FEW)
    near = (best.state.directions[:-1] @ best.state.directions[-1]).max() > np.cos(best.state.sigma or 0.0)
    return best.state.directions[-1] if near and worth_it(search, best, single, lighting) else None


def worth_it(search: Search, fit: Fit, simpler: Fit, lighting: int) -> bool:
    """Whether a source of a lighting saves what its parameters cost; all are bright, and lie where they should."""
    own = fit.state.owners == lighting
    numbers = search.only(lighting).numbers
    noise = max(fit.costs[lighting] / numbers, 1e-300)
    saves = simpler.costs[lighting] - fit.costs[lighting] > _PER_SOURCE * np.log(numbers) * noise
    inside = search.region is None or bool(search.region.holds(fit.state.directions[own]).all())
    return bool(saves and inside and (fit.irradiances[own].sum(axis=1) > 0).all())


def _bright(search: Search, fit: Fit) -> Fit:
    """The fit without sources that would have to take light away."""
    dark = np.flatnonzero(fit.irradiances.sum(axis=1) <= 0)
    return search.fit(fit.state.without_source(dark), fit.l_max) if len(dark) else fit


def _sensible(search: Search, fit: Fit) -> Fit:
    """The fit, without Fresnel factor where that runs to the end of its range and explains less than none does."""
    if fit.state.mu is None or fit.state.mu < MU_RANGE[1]:
        return fit
    return min(fit, search.fit(replace(fit.state, mu=None), fit.l_max), key=lambda f: f.cost)


def thinned(search: Search, l_max: int, most: int, per_lighting: int) -> Search:
    """The same with at most about `most` samples, or `per_lighting` of each if that is more, evenly taken."""
    total = sum(len(sight.field) for sight in search.sights)
    every = max(1, int(np.ceil(total / max(most, per_lighting * len(search.lightings)))))
    if every == 1 and all(sight.l_max == l_max for sight in search.sights):
        return search
    sights, weights, trusts = [], [], []
    for k, (sight, weight, trust) in enumerate(zip(search.sights, search.weights, search.trust, strict=True)):
        keep = np.arange(len(sight.field)) % every == k % every
        sights.append(Sight.of(sight.field.where(keep), l_max, sight.lighting))
        weights.append(weight[keep])
        trusts.append(trust[keep])
    return replace(search, sights=sights, weights=weights, trust=trusts)
