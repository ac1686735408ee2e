"""The ladder of models under unknown light: orders of the lighting, and what else may be left out or be needed."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from capture.progress import OnStep
from invrender.estimate.unknown_light.cross_validation import (
    BlindCandidate,
    cross_validate,
    left_out_whole,
    simplest,
)
from invrender.estimate.unknown_light.projection import BlindFit
from invrender.estimate.unknown_light.source_evidence import bright
from invrender.estimate.unknown_light.sources import SourceStarts, find_sources, sources_of_diffuse
from invrender.estimate.unknown_light.start import Search, forget_rows, of_degree, thinned
from invrender.estimate.unknown_light.state import FIRST_MU, BlindState

# One in so many samples on which models are looked at first, and their numbers at least; how many times as much as the
# first candidate leaves makes a model hopeless.
_GLANCE, _FEWEST, _HOPELESS = 4, 6000, 2.0
# Iterations by which a model that is any good has arrived, from the best of another.
_ENOUGH = 8


def climb(
    search: Search,
    thin: Search,
    lamps: SourceStarts | None,
    first: BlindCandidate,
    orders: Sequence[int],
    others: Sequence[BlindState],
    on_step: OnStep,
) -> list[BlindCandidate]:
    """The ladder: orders of the lighting; then, at the best of them, what else may be left out or be needed.

    Orders above the first candidate's are tried one after the other, as long as it takes the last. others : states with
    lobes of other forms, as good as their best.
    """
    candidates, fit = [first], first.fit
    prepared = {0: of_degree(search, 0), fit.l_max: search}
    glance = _Glance.of(search, fit)

    def add(state: BlindState, l_max: int, fitted: bool = False) -> None:
        degree = max(l_max, fit.l_max) if l_max else 0
        if glance is not None:
            looked, hopeless = glance.at(state, l_max, degree, fitted)
            if hopeless is not None:
                candidates.append(hopeless)
                on_step()
                return
            state = looked.state
        own = _of_degree(prepared, degree)
        for other in prepared.values():
            if other is not own:
                # Rows that are kept for the next step of a search take up more than all else.
                forget_rows(other)
        tried = own.at(state, l_max) if fitted else bright(own, own.fit(state, l_max, _ENOUGH))
        candidates.append(without_rows(cross_validate(model_name(tried), own, tried)))
        on_step(candidates[-1].outcome)

    for order in orders:
        if order < fit.l_max and (order or lamps is not None):
            add(fit.state, order)
    for order in orders:
        if order > fit.l_max and _takes_the_highest(candidates):
            state = candidates[simplest(candidates)].fit.state
            # Beside finer light lamps show that coarser light took up.
            finer = find_sources(of_degree(thin, order), state, order).state
            add(finer if len(finer.directions) > len(state.directions) else state, order)
    if lamps is not None:
        if fit.l_max:
            add(lamps.glossy.state.with_form(fit.state.form), 0)
        add(lamps.diffuse.state, 0)
    best = candidates[simplest(candidates)].fit
    if best.state.sigma is not None and best.state.form.has_fresnel:
        bare = best.state.mu is None
        add(replace(best.state, mu=FIRST_MU) if bare else best.state.without_fresnel(), best.l_max)
    for other in others:
        # Sources may have stood for what another form lacks.
        alike = len(best.state.directions) == len(other.directions)
        add(other if alike else other.with_sources_of(best.state), best.l_max, fitted=alike)
    if len(best.state.directions):
        weakest = int(best.irradiances.sum(axis=1).argmin())
        add(best.state.without_source(weakest), best.l_max)
    # What a purely diffuse body would need of light is another matter: its sources are looked for anew.
    diffuse, glossy = sources_of_diffuse(thin, fit.l_max, lamps), len(candidates)
    for order in sorted({min(2, orders[-1]), *(candidate.fit.l_max for candidate in candidates)} - {0}):
        if len(candidates) == glossy or _takes_the_highest(candidates[glossy:]):
            add(diffuse, order)
    return candidates


@dataclass(frozen=True, eq=False)
class _Glance:
    """A part of the samples, on which models are looked at before they are fitted to the others.

    few : by degree of the light that they are prepared for. least : RMS of what the first candidate leaves there, in
    deviations of the noise.
    """

    few: dict[int, Search]
    least: float

    @classmethod
    def of(cls, search: Search, fit: BlindFit) -> _Glance | None:
        """None where a part has too few samples, or where photographs are left out in parts."""
        few = thinned(search, fit.l_max, search.numbers // (3 * _GLANCE), 0)
        if few is search or few.numbers < _FEWEST or not left_out_whole(search.designs):
            return None
        return cls({fit.l_max: few}, _left(few, few.at(fit.state, fit.l_max)))

    def at(
        self, state: BlindState, l_max: int, degree: int, fitted: bool
    ) -> tuple[BlindFit, BlindCandidate | None]:
        """The fit of a model from a state; its evidence, too, where it leaves so much that it needs no more samples."""
        few = _of_degree(self.few, degree)
        found = few.at(state, l_max) if fitted else few.fit(state, l_max, _ENOUGH)
        hopeless = None
        if _left(few, found) > _HOPELESS * self.least:
            hopeless = without_rows(cross_validate(model_name(found), few, found))
        forget_rows(few)
        return found, hopeless


def _left(search: Search, fit: BlindFit) -> float:
    """RMS of what a fit to a search leaves, in deviations of the noise."""
    return float(np.sqrt(fit.cost / search.numbers))


def _of_degree(prepared: dict[int, Search], degree: int) -> Search:
    """The same samples for lighting of a degree, kept with those of other degrees."""
    if degree not in prepared:
        prepared[degree] = of_degree(next(iter(prepared.values())), degree)
    return prepared[degree]


def climb_again(
    search: Search, candidates: Sequence[BlindCandidate], on_step: OnStep
) -> list[BlindCandidate]:
    """Candidates of nearly the same samples, fitted to these and judged by them, from where they were."""
    dark, found = of_degree(search, 0), []
    for candidate in candidates:
        own = search if candidate.fit.l_max else dark
        forget_rows(dark if own is search else search)
        fit = bright(own, own.fit(candidate.fit.state, candidate.fit.l_max, _ENOUGH))
        found.append(without_rows(cross_validate(model_name(fit), own, fit)))
        on_step(found[-1].outcome)
    return found


def _takes_the_highest(candidates: Sequence[BlindCandidate]) -> bool:
    """Whether no light of a lower degree than the highest that was tried suffices."""
    return candidates[simplest(candidates)].fit.l_max == max(candidate.fit.l_max for candidate in candidates)


def neighbours(candidates: Sequence[BlindCandidate], chosen: int) -> list[int]:
    """The chosen candidate and, if there is one, that of the same model with the next richer lighting."""
    own = candidates[chosen].fit
    richer = [
        index
        for index, candidate in enumerate(candidates)
        if candidate.fit.l_max > own.l_max
        and candidate.fit.state.names == own.state.names
        and candidate.fit.state.form.family is own.state.form.family
    ]
    return [chosen, *sorted(richer, key=lambda index: candidates[index].fit.l_max)[:1]]


def confirm(search: Search, candidates: list[BlindCandidate], pair: Sequence[int]) -> int:
    """Fit some candidates to all samples, in place; the simplest of them that suffices, which alone keeps its rows."""
    for index in pair:
        fit = search.fit(candidates[index].fit.state, candidates[index].fit.l_max)
        candidates[index] = cross_validate(model_name(fit), search, fit)
    chosen = pair[simplest([candidates[index] for index in pair])]
    for index in pair:
        candidates[index] = candidates[index] if index == chosen else without_rows(candidates[index])
    return chosen


def without_rows(candidate: BlindCandidate) -> BlindCandidate:
    """The candidate without its fit's rows, which take up far more than all else together."""
    return replace(candidate, fit=replace(candidate.fit, rows=()))


def model_name(fit: BlindFit) -> str:
    """What a candidate is called: its lobe, its lighting's degree, its sources."""
    state = fit.state
    kind = "lambertian" if state.sigma is None else state.form.name
    bare = state.sigma is not None and state.mu is None and state.form.has_fresnel
    count, near = len(state.directions), len(state.near)
    sources = f"{count} source{'' if count == 1 else 's'}"
    if near:
        sources += " (near)" if near == count else f" ({near} of them near)"
    return f"{kind}{' without Fresnel' if bare else ''}, lighting of degree {fit.l_max}, {sources}"
