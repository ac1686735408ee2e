"""Directional sources, found: entered at peaks of the light, kept only where the photographs ask for them."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from invrender.brdf.form import LobeForm
from invrender.brdf.fresnel import MU_RANGE
from invrender.brdf.lobes import RH01_FORM
from invrender.estimate.unknown_light.near_lamps import with_near_lamps
from invrender.estimate.unknown_light.projection import BlindFit
from invrender.estimate.unknown_light.source_count import fewest_sources
from invrender.estimate.unknown_light.source_evidence import bright, source_penalty
from invrender.estimate.unknown_light.start import (
    NOTHING,
    PEAK_WIDTH,
    Search,
    first_state,
    light_peaks,
    of_degree,
)
from invrender.estimate.unknown_light.state import BlindState, turn

Floats = NDArray[np.float64]

# Iterations until a source has shown its worth.
_FEW = 6
_MOST_SOURCES = 6
# Light of a high degree takes up lamps that are near, which look like several distant ones. As long as so many
# deviations are left (RMS), lamps are looked for beside light of lower degrees, too.
_LEAVES_MUCH, _LOWER = 2.0, (4, 2)
# Lamps alone that leave squared residuals so many times as large are no explanation worth a thought.
_NOT_DARK = 30


def find_sources(search: Search, start: BlindState, l_max: int, peaks_at: int | None = None) -> BlindFit:
    """Sources entered one at a time in each lighting, refined with all else and kept where photographs ask for them.

    l_max : of the light beside them. peaks_at : degree of the light whose peaks they are looked for at; l_max if None.
    """
    fit = with_near_lamps(search, bright(search, _sensible(search, search.fit(start, l_max))), start)
    open_to = search.lightings
    while open_to:
        entered = fit.state
        for lighting in open_to:
            peak = _best_peak(search.only(lighting), fit, lighting, l_max if peaks_at is None else peaks_at)
            entered = entered if peak is None else entered.with_source(peak, lighting)
        if entered is fit.state:
            break
        better = bright(search, _sensible(search, search.fit(entered, l_max, _FEW)))
        tried = [k for k in open_to if (entered.owners == k).sum() > (fit.state.owners == k).sum()]
        # An entry may have let an earlier one go dark, whose place it then takes.
        open_to = [k for k in tried if not _close(better.state, k) and _worth_it(search, better, fit, k)]
        if len(open_to) < len(tried) and open_to:
            state = better.state
            for lighting in set(tried) - set(open_to):
                state = state.with_sources_of(fit.state, lighting)
            better = search.fit(state, l_max, _FEW)
        fit = better if open_to else fit
    # A Fresnel factor may put out a lamp that stood in for it, which would discredit its lighting's others.
    fit = with_near_lamps(search, bright(search, _fresnel_again(search, fit, start.mu)))
    return _without_needless(search, fit, start)


def _best_peak(search: Search, fit: BlindFit, lighting: int, degree: int) -> Floats | None:
    """The peak (3,) of one lighting that explains most as a source; None if there is none, or sources enough."""
    state = fit.state.under(lighting)
    if len(state.directions) >= _MOST_SOURCES:
        return None
    seen = fit if degree == fit.l_max else search.at(state, degree)
    apart = np.cos(state.sigma or PEAK_WIDTH)
    peaks = [
        peak
        for peak in light_peaks(seen.slow(lighting), search.regions.get(lighting))
        if (state.directions @ peak < apart).all()
    ]
    entered = (search.at(state.with_source(peak, lighting), fit.l_max) for peak in peaks)
    # Less light from one side than from all others looks like a lamp on the other, too.
    lamps = (f for f in entered if f.irradiances[-1].sum() > 0)
    best = min(lamps, key=lambda f: f.cost, default=None)
    return None if best is None else best.state.directions[-1]


def _close(state: BlindState, lighting: int) -> bool:
    """Whether two sources of a lighting are nearer to each other than the lobe is wide."""
    ways = state.under(lighting).directions
    return len(ways) > 1 and (ways @ ways.T - 2 * np.eye(len(ways))).max() > np.cos(state.sigma or PEAK_WIDTH)


def _without_needless(search: Search, fit: BlindFit, start: BlindState) -> BlindFit:
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
        if not all(_worth_it(search, fit, simpler, lighting) for simpler in (without, held)):
            needless.append(index)
    if len(needless) == len(trusted):
        return without
    return search.fit(fit.state.without_source(np.array(needless)), fit.l_max, _FEW) if needless else fit


def with_seconds(search: Search, fit: BlindFit) -> BlindFit | None:
    """The best fit to some samples with a source as two, nearer to each other than the lobe is wide.

    fit : of the same or more samples. None where no lighting's samples ask for it; nor in the dark, where nothing
    separates two such sources.
    """
    if fit.state.sigma is None or not fit.l_max:
        return None
    search = of_degree(search, fit.l_max)
    fit = search.fit(fit.state, fit.l_max)
    search, state = off_borders(search, fit.state), fit.state
    for lighting in search.lightings:
        second = _second(search, fit, lighting)
        state = state if second is None else state.with_source(second, lighting)
    return None if state is fit.state else search.fit(state, fit.l_max, _FEW)


def off_borders(search: Search, state: BlindState) -> Search:
    """The same without what lies at the borders of shadows that a mesh casts; the search itself where none are cast.

    Pixels there are neither lit nor dark; taken for whole ones they look like a second source, or another form of lobe.
    """
    if all(design.shadows is None for design in search.designs):
        return search
    clear = [design.off_borders(state.under(design.lighting).sources)[:, None] for design in search.designs]
    weights = [weight * counts for weight, counts in zip(search.weights, clear, strict=True)]
    return replace(search, weights=weights)


def _second(search: Search, fit: BlindFit, lighting: int) -> Floats | None:
    """Where a lighting has a second source beside one of its own; None if nothing asks for one."""
    own, state, offset = search.only(lighting), fit.state.under(lighting), (fit.state.sigma or 0.0) / 2
    trials = []
    for direction in state.directions:
        ways = np.array([turn(direction, *(offset * way)) for way in (*np.eye(2), *-np.eye(2))])
        for way in ways[search.may_hold(lighting, ways)]:
            trials.append(own.at(state.with_source(way, lighting), fit.l_max))
    if not trials:
        return None
    best = own.fit(min(trials, key=lambda f: f.cost).state, fit.l_max, _FEW)
    if len(best.state.directions) <= len(state.directions):
        return None
    single = own.fit(state, fit.l_max, _FEW)
    near = (best.state.directions[:-1] @ best.state.directions[-1]).max() > np.cos(best.state.sigma or 0.0)
    return best.state.directions[-1] if near and _worth_it(own, best, single, lighting) else None


def _worth_it(search: Search, fit: BlindFit, simpler: BlindFit, lighting: int) -> bool:
    """Whether a source of a lighting saves what its parameters cost; all are bright."""
    own = fit.state.owners == lighting
    saves = simpler.costs[lighting] - fit.costs[lighting] > source_penalty(search, fit, lighting)
    return bool(saves and (fit.irradiances[own].sum(axis=1) > 0).all())


def likelier(search: Search, first: BlindFit, state: BlindState) -> BlindFit:
    """A fit, or the best near another state if that explains more for its sources' price."""
    second = search.fit(state, first.l_max)
    best = min(first, second, key=lambda fit: fit.cost)
    prices = {lighting: source_penalty(search, best, lighting) for lighting in search.lightings}
    return min(first, second, key=lambda fit: fit.cost + sum(prices[k] for k in fit.state.owners.tolist()))


def _sensible(search: Search, fit: BlindFit) -> BlindFit:
    """The fit, without Fresnel factor where that runs to the end of its range and explains less than none does."""
    if fit.state.mu is None or fit.state.mu < MU_RANGE[1]:
        return fit
    return min(fit, search.fit(fit.state.without_fresnel(), fit.l_max), key=lambda f: f.cost)


def _fresnel_again(search: Search, fit: BlindFit, mu: float | None) -> BlindFit:
    """The fit with a Fresnel factor from mu on, if it had to go before all sources were found and explains more now."""
    if mu is None or fit.state.mu is not None:
        return fit
    return min(fit, _sensible(search, search.fit(replace(fit.state, mu=mu), fit.l_max)), key=lambda f: f.cost)


@dataclass(frozen=True, eq=False)
class SourceStarts:
    """Fits with nothing but lamps in the dark, and the same faint light from all sides: of degree 0."""

    glossy: BlindFit
    diffuse: BlindFit


def find_starts(
    search: Search, l_max: int, in_the_dark: bool, form: LobeForm = RH01_FORM
) -> tuple[BlindFit, SourceStarts | None]:
    """Sources beside light of degree l_max, as a body with a lobe shows them, and lamps in the dark if that may be it.

    Lamps alone are fitted to the search as prepared for degree 0: lobes take time with the degree that they are for.
    in_the_dark : whether lamps are looked for; they always are at degree 0. form : of the lobe, that lamps
    alone are counted with.
    """
    dark = of_degree(search, 0)
    if not l_max:
        alone = fewest_sources(dark, _diffuse_lamps(search), form)
        return alone, SourceStarts(alone, dark.fit(alone.state.without_lobe(), 0))
    found = find_beside_light(search, first_state, l_max)
    if not in_the_dark:
        return found, None
    diffuse = _diffuse_lamps(search)
    if _leaves_much(search, found):
        found = likelier(search, found, fewest_sources(dark, diffuse, form).state)
    lamps = _lamps_alone(dark, diffuse, found)
    return (found if lamps is None else likelier(search, found, lamps.glossy.state)), lamps


def find_beside_light(search: Search, start: Callable[[Search, int], BlindState], l_max: int) -> BlindFit:
    """`find_sources` beside light of degree l_max, and of lower ones as long as much is left; start : of each."""
    found = find_sources(search, start(search, l_max), l_max)
    for degree in _LOWER:
        if degree < l_max and _leaves_much(search, found):
            lower = of_degree(search, degree)
            found = likelier(search, found, find_sources(lower, start(lower, degree), degree).state)
    return found


def _leaves_much(search: Search, fit: BlindFit) -> bool:
    return fit.cost > _LEAVES_MUCH**2 * search.numbers


def _lamps_alone(dark: Search, diffuse: BlindFit, beside: BlindFit) -> SourceStarts | None:
    """Lamps in a dark room, those that were found beside light among them; None if they are no explanation.

    dark : prepared for light of degree 0. diffuse : lamps as a diffuse body shows them. beside : the fit with light
    that lamps alone are measured against.
    """
    # Light of many degrees passes for a lamp or two; a lamp that only a lobe shows isn't found without one.
    starts = (first_state(dark, 0, diffuse.state), beside.state)
    glossy = min((dark.fit(start, 0, _FEW) for start in starts), key=lambda fit: fit.cost)
    glossy = with_near_lamps(dark, glossy)
    return SourceStarts(dark.fit(glossy.state, 0), diffuse) if glossy.cost < _NOT_DARK * beside.cost else None


def _diffuse_lamps(search: Search) -> BlindFit:
    """Lamps in the dark as a diffuse body shows them, looked for at the peaks of light of the search's degree."""
    return find_sources(search, NOTHING, 0, peaks_at=search.designs[0].l_max)


def sources_of_diffuse(search: Search, l_max: int, lamps: SourceStarts | None) -> BlindState:
    """Sources beside light of degree l_max, as a diffuse body shows them; those of lamps where they are likelier."""
    if lamps is not None and not l_max:
        return lamps.diffuse.state
    found = find_sources(search, NOTHING, l_max)
    return (found if lamps is None else likelier(search, found, lamps.diffuse.state)).state
