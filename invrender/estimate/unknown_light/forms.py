"""Which form the lobe has, by the ladder's evidence on part of the samples, before the ladder is climbed.

Weights that are taken from the residuals of a wrong form would hide that it is wrong, and sources that were found with
it may stand for its faults: so the form comes first.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass

from invrender.brdf.form import LobeForm
from invrender.brdf.lobes import FORMS, GGX_FORM, PLASTICS, RH01_FORM, UNCORRELATED
from invrender.brdf.richer import extended
from invrender.brdf.smith import Smith
from invrender.estimate.unknown_light.cross_validation import (
    BlindCandidate,
    as_good,
    cross_validate,
    needed,
)
from invrender.estimate.unknown_light.projection import BlindFit
from invrender.estimate.unknown_light.source_count import brightest_each, is_endless
from invrender.estimate.unknown_light.sources import find_beside_light, off_borders
from invrender.estimate.unknown_light.start import Search
from invrender.estimate.unknown_light.state import BlindState

# Forms that a lobe is tried as; beside the best of facets what it extends to, if RH01's isn't as good.
FIRST_FORMS = (*FORMS.values(), *PLASTICS.values())
MOST_FORMS = len(FIRST_FORMS) + 1 + len(extended(GGX_FORM))
# From another's best answer, after which forms differ by far more than they still gain. In the dark, where an iteration
# takes no time, those go on whose cost is near the least; the others are out.
_ITERATIONS, _IN_THE_DARK, _FEW = 2, 4, 10
_NEAR = 3.0


@dataclass(frozen=True, eq=False)
class Formed:
    """The best fit with its sources, and what lobes of the other forms came to."""

    found: BlindFit
    others: tuple[BlindState, ...]


def choose_form(search: Search, found: BlindFit, l_max: int) -> Formed:
    """The form that predicts samples best; RH01's unless that is worse by a standard error, as on the ladder.

    One with numbers of its own is chosen only where all simpler ones are clearly worse: of several, one will be a
    little better by chance.
    """
    whole, search = search, off_borders(search, found.state)
    own = found if search is whole else search.fit(found.state, l_max)
    candidates: dict[LobeForm, BlindCandidate] = {}

    def trying(forms: Iterable[LobeForm], start: BlindFit) -> None:
        fits = {
            form: start
            if start is own and form is own.state.form.family
            else search.fit(start.state.with_form(form), l_max, _ITERATIONS)
            for form in forms
        }
        least = min(fit.cost for fit in fits.values())
        for form, fit in fits.items():
            near = l_max > 0 or fit.cost < _NEAR * least
            if near and not l_max and fit is not start:
                fit = search.fit(fit.state, l_max, _IN_THE_DARK)
            if form is RH01_FORM or (near and not is_endless(fit.state)):
                candidates[form] = cross_validate(form.name, search, fit)

    trying(FIRST_FORMS, own)
    if not as_good(candidates[RH01_FORM], min(candidates.values(), key=_deviance)) and any(
        isinstance(f, Smith) for f in candidates
    ):
        facets = min(
            (form for form in candidates if isinstance(form, Smith)),
            key=lambda form: _deviance(candidates[form]),
        )
        # Those that hold it must not be better for having gone on for longer.
        trying([facets], candidates[facets].fit)
        # Beside lamps alone there is no light that could take up what a coat or a haze explains.
        trying([UNCORRELATED[facets], *(() if l_max else extended(facets))], candidates[facets].fit)
    chosen = _simplest(candidates)
    others = tuple(candidate.fit.state for form, candidate in candidates.items() if form is not chosen)
    if chosen is not own.state.form.family and not l_max:
        # Lamps in the dark were counted whatever the form is: those that were found stay.
        found = whole.fit(candidates[chosen].fit.state, l_max, _FEW)
    elif chosen is not own.state.form.family:
        lit = brightest_each(candidates[chosen].fit)
        found = find_beside_light(whole, lambda *_: lit, l_max)
    return Formed(found, others)


def _simplest(candidates: Mapping[LobeForm, BlindCandidate]) -> LobeForm:
    """RH01's form if it is as good as the best, or this; light and viewer hidden apart if it is worse than that by a
    standard error; one with more numbers if it is clearly worse."""
    best = min(
        (form for form in FIRST_FORMS if form in candidates), key=lambda form: _deviance(candidates[form])
    )
    chosen = RH01_FORM if as_good(candidates[RH01_FORM], candidates[best]) else best
    for apart in set(candidates) & set(UNCORRELATED.values()):
        chosen = chosen if as_good(candidates[chosen], candidates[apart]) else apart
    taken = needed(candidates[chosen], (candidate for form, candidate in candidates.items() if form.numbers))
    return next(form for form, candidate in candidates.items() if candidate is taken)


def _deviance(candidate: BlindCandidate) -> float:
    return float(candidate.deviance.mean())
