"""Which form the lobe has, by the ladder's evidence on part of the samples, before the ladder is climbed.

Weights that are taken from the residuals of a wrong form would hide that it is wrong, and sources that were found with
it may stand for its faults: so the form comes first.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from invrender.model.lobes import FORMS, PLASTICS, PRINTED
from invrender.solve.blind.projection import Fit
from invrender.solve.blind.rungs import as_good, cross_validate
from invrender.solve.blind.sources import Found, examined, find_sources, off_borders
from invrender.solve.blind.start import Search
from invrender.solve.blind.state import State

# From RH01's best answer, after which forms differ by far more than they still gain.
_ITERATIONS = 2


@dataclass(frozen=True, eq=False)
class Formed:
    """The best fit with its sources, and what lobes of the other forms came to."""

    found: Found
    others: tuple[State, ...]


def choose_form(search: Search, found: Found, l_max: int) -> Formed:
    """The form that predicts samples best; RH01's, as which `found` was fitted, unless that is clearly worse.

    Clearly is by more than a standard error, as on the ladder.
    """
    whole, search = search, off_borders(search, found.fit.state)
    fits = [found.fit if search is whole else search.fit(found.fit.state, l_max)]
    for form in (*FORMS.values(), *PLASTICS.values()):
        if form is not PRINTED:
            fits.append(search.fit(found.fit.state.with_form(form), l_max, _ITERATIONS))
    rungs = [cross_validate(fit.state.form.name, search, fit) for fit in fits]
    best = min(range(len(rungs)), key=lambda index: rungs[index].deviance.mean())
    chosen = 0 if as_good(rungs[0], rungs[best]) else best
    others = tuple(fit.state for index, fit in enumerate(fits) if index != chosen)
    if chosen and not l_max:
        # Light of degree 0 has no peaks to look for lamps at: those that were found stay.
        found = examined(whole, whole.fit(fits[chosen].state, l_max))
    elif chosen:
        found = examined(whole, find_sources(whole, _brightest_source(fits[chosen]), l_max))
    return Formed(found, others)


def _brightest_source(fit: Fit) -> State:
    """The state with the brightest source alone in each lighting."""
    state, brightness = fit.state, fit.irradiances.sum(axis=1)
    first = {k: int(np.where(state.owners == k, brightness, -np.inf).argmax()) for k in state.owners.tolist()}
    rest = [k for k in range(len(brightness)) if k not in first.values()]
    return state.without_source(np.array(rest, int))
