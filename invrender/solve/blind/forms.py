"""Which form the lobe has, by the ladder's evidence on part of the samples, before the ladder is climbed.

Weights that are taken from the residuals of a wrong form would hide that it is wrong, and sources that were found with
it may stand for its faults: so the form comes first.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass

from invrender.model.lobes import FORMS, GGX_FORM, PLASTICS, PRINTED, LobeForm, Smith
from invrender.solve.blind.lampcount import brightest_each
from invrender.solve.blind.rungs import BlindRung, as_good, cross_validate
from invrender.solve.blind.sources import Found, examined, find_sources, off_borders
from invrender.solve.blind.start import Search
from invrender.solve.blind.state import State
from invrender.solve.forms import kin

# Forms that a lobe is tried as; beside the best of facets its kin, if RH01's isn't as good.
FIRST_FORMS = (*FORMS.values(), *PLASTICS.values())
MOST_FORMS = len(FIRST_FORMS) + len(kin(GGX_FORM))
# From another's best answer, after which forms differ by far more than they still gain; in the dark, where they take no
# time, until they are there.
_ITERATIONS, _IN_THE_DARK, _FEW = 2, 6, 10


@dataclass(frozen=True, eq=False)
class Formed:
    """The best fit with its sources, and what lobes of the other forms came to."""

    found: Found
    others: tuple[State, ...]


def choose_form(search: Search, found: Found, l_max: int) -> Formed:
    """The simplest form that predicts samples as well as the best does; of several RH01's, or the best of them.

    As well is within a standard error, as on the ladder.
    """
    whole, search = search, off_borders(search, found.fit.state)
    own = found.fit if search is whole else search.fit(found.fit.state, l_max)
    rungs: dict[LobeForm, BlindRung] = {}

    def trying(forms: Iterable[LobeForm]) -> None:
        for form in forms:
            fit = own
            if form is not own.state.form.family:
                iterations = _ITERATIONS if l_max else _IN_THE_DARK
                fit = search.fit(own.state.with_form(form), l_max, iterations)
            rungs[form] = cross_validate(form.name, search, fit)

    trying(FIRST_FORMS)
    if not as_good(rungs[PRINTED], min(rungs.values(), key=_deviance)):
        facets = min(
            (form for form in rungs if isinstance(form, Smith)), key=lambda form: _deviance(rungs[form])
        )
        trying(kin(facets))
    best = min(rungs.values(), key=_deviance)
    good = [form for form, rung in rungs.items() if as_good(rung, best)]
    chosen = min(good, key=lambda form: (rungs[form].parameters, form is not PRINTED, _deviance(rungs[form])))
    others = tuple(rung.fit.state for form, rung in rungs.items() if form is not chosen)
    if chosen is not own.state.form.family and not l_max:
        # Lamps in the dark were counted whatever the form is: those that were found stay.
        found = Found(whole.fit(rungs[chosen].fit.state, l_max, _FEW), None)
    elif chosen is not own.state.form.family:
        found = examined(whole, find_sources(whole, brightest_each(rungs[chosen].fit), l_max))
    return Formed(found, others)


def _deviance(rung: BlindRung) -> float:
    return float(rung.deviance.mean())
