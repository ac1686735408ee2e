"""Which form the lobe has, by the ladder's evidence on part of the samples, before the ladder is climbed.

Weights that are taken from the residuals of a wrong form would hide that it is wrong, and sources that were found with
it may stand for its faults: so the form comes first.
"""

from __future__ import annotations

from dataclasses import dataclass

from invrender.model.lobes import FORMS, PLASTICS, PRINTED
from invrender.solve.blind.lampcount import brightest_each
from invrender.solve.blind.rungs import as_good, cross_validate
from invrender.solve.blind.sources import Found, examined, find_sources, off_borders
from invrender.solve.blind.start import Search
from invrender.solve.blind.state import State

# Every form that a lobe is tried as.
ALL_FORMS = (*FORMS.values(), *PLASTICS.values())
# From another's best answer, after which forms differ by far more than they still gain; in the dark, where they take no
# time, until they are there.
_ITERATIONS, _IN_THE_DARK = 2, 10


@dataclass(frozen=True, eq=False)
class Formed:
    """The best fit with its sources, and what lobes of the other forms came to."""

    found: Found
    others: tuple[State, ...]


def choose_form(search: Search, found: Found, l_max: int) -> Formed:
    """The form that predicts samples best; RH01's unless that is clearly worse.

    Clearly is by more than a standard error, as on the ladder.
    """
    whole, search = search, off_borders(search, found.fit.state)
    own = found.fit if search is whole else search.fit(found.fit.state, l_max)
    fits = {own.state.form: own}
    for form in ALL_FORMS:
        if form not in fits:
            fits[form] = search.fit(own.state.with_form(form), l_max, _ITERATIONS if l_max else _IN_THE_DARK)
    rungs = {form: cross_validate(form.name, search, fit) for form, fit in fits.items()}
    best = min(rungs, key=lambda form: rungs[form].deviance.mean())
    chosen = PRINTED if as_good(rungs[PRINTED], rungs[best]) else best
    others = tuple(fit.state for form, fit in fits.items() if form is not chosen)
    if chosen is not own.state.form and not l_max:
        # Lamps in the dark were counted whatever the form is: those that were found stay.
        found = examined(whole, whole.fit(fits[chosen].state, l_max))
    elif chosen is not own.state.form:
        found = examined(whole, find_sources(whole, brightest_each(fits[chosen]), l_max))
    return Formed(found, others)
