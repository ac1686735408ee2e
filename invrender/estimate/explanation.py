"""Which model explains the photographs: form, Fresnel factor and colour of the specular part, each by evidence."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from capture.lighting import Lighting
from capture.progress import OnStep, unwatched
from invrender.brdf.brushed import Brushed
from invrender.brdf.form import Axis, LobeForm
from invrender.brdf.lobes import RH01_FORM, UNCORRELATED
from invrender.estimate.brushed import in_window, narrowed
from invrender.estimate.evidence import Candidate, choose, climb_ladder
from invrender.estimate.forms import FormTrial, beside, try_forms
from invrender.estimate.linear import recovers_light
from invrender.estimate.models import Estimate, Model
from invrender.estimate.noise import NoiseModel, Weights
from invrender.estimate.reference_scale import ReferenceGauge
from invrender.estimate.search import LADDER, OTHER_FORMS, fit, models_of, with_neutral
from invrender.estimate.statistics import total_statistics
from invrender.estimate.weighing import weigh
from invrender.transport.columns import Elements, PhotoColumns, columns_of
from invrender.transport.transfer import light_elements

Floats = NDArray[np.float64]

# Share of the cost that a specular part of the wrong form, which may predict worse than none, must take away for other
# forms to be tried.
_NOTABLE = 1.02
# Of the error on unseen photographs that is left without a specular part, what other forms may leave at most to be
# believed where RH01's finds none: whichever of several does best by chance does a little better.
_MUCH_BETTER = 0.8
# How often the window of a brushed form is moved at most.
_MOST_MOVES = 3


@dataclass(frozen=True, eq=False)
class Explanation:
    """The ladder of models and what it was climbed with.

    candidates, chosen : all models that were tried, the simple ones first, and the index of the chosen one. photos,
    weights, noise : columns of the chosen form, what their samples count for, and why. trials : each form's on a share
    of the samples; none where no specular part is needed. gauge : the scale by references, where no light fixes it.
    """

    candidates: tuple[Candidate, ...]
    chosen: int
    photos: tuple[PhotoColumns, ...]
    weights: tuple[Weights, ...]
    noise: NoiseModel
    trials: Mapping[LobeForm, FormTrial] = field(default_factory=dict)
    gauge: ReferenceGauge | None = None

    @property
    def best(self) -> Candidate:
        """The chosen candidate."""
        return self.candidates[self.chosen]


# How often `explain` reports progress, at most.
EXPLANATION_STEPS = len(with_neutral(LADDER)) + len(OTHER_FORMS)


def explain(
    photos: Sequence[PhotoColumns],
    lightings: Sequence[Lighting],
    on_step: OnStep = unwatched,
    axis: Axis | None = None,
) -> Explanation:
    """Climb the ladder with RH01's form; where a specular part is needed, see if another form suits it better.

    photos : columns of RH01's form. axis : that the surface would be brushed about, if it is; None where no tangents
    are known. Of forms that explain as well RH01's is preferred.
    """
    noise, weights = weigh(photos, LADDER[-1])
    candidates = climb_ladder(photos, weights, on_step, _models(LADDER, photos))
    chosen = choose(candidates)
    if not candidates[chosen].estimate.model.specular and not shows_more(candidates):
        return Explanation(candidates, chosen, tuple(photos), tuple(weights), noise)
    elements = {lighting.name: light_elements(lighting) for lighting in lightings}
    trials = try_forms(photos, weights, elements, candidates[-1].estimate, on_step, axis)
    others = _others(candidates[-1], RH01_FORM, trials)
    all_candidates = (*candidates, *others)
    if candidates[chosen].estimate.model.specular or (
        min(candidate.error for candidate in others) < _MUCH_BETTER * candidates[chosen].error
    ):
        chosen = choose(all_candidates)
    if all_candidates[chosen].estimate.model.form is RH01_FORM:
        return Explanation(all_candidates, chosen, tuple(photos), tuple(weights), noise, trials)
    form = _best_form(trials)
    best = trials[form].candidates[-1]
    return _in_form(*_narrowed(form, best, trials, elements), photos, elements)


def _best_form(trials: Mapping[LobeForm, FormTrial]) -> LobeForm:
    """The form, not RH01's, that suits the share best: beside RH01's large errors two others look alike."""
    candidates = [
        candidate for form, trial in trials.items() if form is not RH01_FORM for candidate in trial.candidates
    ]
    candidates.sort(key=_simplest_first)
    return candidates[choose(candidates)].estimate.model.form


def refitted(known: Explanation, less: Sequence[Floats]) -> Estimate:
    """The chosen model's estimate if the samples' radiances were lower by some (n, 3) per photograph."""
    estimate = known.best.estimate
    photos = [photo.less(radiance) for photo, radiance in zip(known.photos, less, strict=True)]
    statistics = total_statistics(photos, [w.weight for w in known.weights])
    return fit(estimate.model, statistics, estimate)


def shows_more(candidates: Sequence[Candidate]) -> bool:
    """Whether a specular part explains more than chance would, though not what it takes to predict photographs."""
    plain = next(candidate.estimate.cost for candidate in candidates if not candidate.estimate.model.specular)
    return plain > _NOTABLE * min(candidate.estimate.cost for candidate in candidates)


def _narrowed(
    form: LobeForm,
    candidate: Candidate,
    trials: Mapping[LobeForm, FormTrial],
    elements: Elements,
) -> tuple[LobeForm, Mapping[LobeForm, FormTrial]]:
    """A brushed form with a window about a candidate's widths, and the trials with that form; others as they are."""
    if not isinstance(form, Brushed):
        return form, trials
    about, before = narrowed(form, candidate.estimate.brdf), trials[form]
    columns = columns_of((about,), before.photos, elements)[about]
    again = FormTrial.of(about, columns, before.weights, before.patches)
    return about, {tried: trial for tried, trial in trials.items() if tried is not form} | {about: again}


def _in_form(
    form: LobeForm,
    trials: Mapping[LobeForm, FormTrial],
    photos: Sequence[PhotoColumns],
    elements: Elements,
    moves: int = _MOST_MOVES,
) -> Explanation:
    """The ladder with another form on all samples, and the noise that this one leaves.

    moves : how often the window of a brushed form may be moved to what all samples say.
    """
    columns = columns_of((form,), photos, elements)[form]
    noise, weights = weigh(columns, models_of(form)[-1])
    own = climb_ladder(columns, weights, models=_models(models_of(form), photos))
    if moves and isinstance(form, Brushed) and not in_window(form, own[-1].estimate.brdf):
        return _in_form(*_narrowed(form, own[-1], trials, elements), photos, elements, moves - 1)
    printed = climb_ladder(photos, weights, models=LADDER)
    rest = [
        candidate
        for candidate in _others(own[-1], form, trials)
        if candidate.estimate.model.form is not RH01_FORM
    ]
    chosen = len(printed) + choose(own)
    return Explanation((*printed, *own, *rest), chosen, tuple(columns), tuple(weights), noise, trials)


def _others(reference: Candidate, form: LobeForm, trials: Mapping[LobeForm, FormTrial]) -> list[Candidate]:
    """Candidates of all forms but one, beside that one's richest on all samples; the simple and the good first."""
    own = trials[form].judged(reference)
    found = [
        beside(reference, candidate, own)
        for other, trial in trials.items()
        if other is not form
        for candidate in trial.candidates
    ]
    return sorted(found, key=_simplest_first)


def _simplest_first(candidate: Candidate) -> tuple[int, bool, float]:
    """Order of candidates: few numbers first; of as many, facets that hide light and viewer together, then the best."""
    return candidate.parameters, candidate.estimate.model.form in UNCORRELATED.values(), candidate.error


def _models(models: Sequence[Model], photos: Sequence[PhotoColumns]) -> Sequence[Model]:
    """Whether Ks is the same in all channels can only be seen in light whose colour is known."""
    return models if recovers_light(photos) else with_neutral(models)
