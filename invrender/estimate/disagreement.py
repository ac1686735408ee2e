"""What a candidate states of each number, with its own doubts, and by how much others put the number elsewhere."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import cache

import numpy as np
from numpy.typing import NDArray

from invrender.brdf.form import WIDEST_HAZE
from invrender.brdf.microfacet import SIGMA_RANGE
from invrender.brdf.richer import core_width
from invrender.estimate.clusters import beyond_chance, structured_rms
from invrender.estimate.evidence import Candidate, of_rival, outlying, rivalry
from invrender.estimate.explanation import Explanation
from invrender.estimate.jacobian import pack
from invrender.estimate.models import Estimate, Model
from invrender.estimate.noise import Weights
from invrender.estimate.reference_scale import ReferenceGauge
from invrender.estimate.reported import Report
from invrender.estimate.uncertainty import FINEST, NUMERICAL, uncertainty_of
from invrender.transport.columns import PhotoColumns, sample_count
from invrender.transport.predict import predict_photos, transfers

Floats = NDArray[np.float64]

# Weight of a rival below which it isn't measured: it would move a number by a thirtieth of what they differ.
_NO_RIVAL = 1e-3
# Part of the widest lobe that a search allows from which on it ends there.
_AT_THE_END = 0.99


def report_of(
    estimate: Estimate, photos: Sequence[PhotoColumns], gauge: ReferenceGauge | None = None
) -> Report:
    """The reported numbers of an estimate that has a strength of each of the photographs' lightings."""
    known = any("known" in photo.elements for photo in photos)
    return Report(pack(estimate, {photo.lighting: photo.elements for photo in photos}), known, gauge)


@dataclass(frozen=True, eq=False)
class StatedNumbers:
    """A candidate's reported numbers with their covariance; the rest as in `uncertainty.Uncertainty`."""

    report: Report
    values: Floats
    covariance: Floats
    noise: Floats
    fragility: Floats
    response: Floats
    structured: float

    def values_of(self, name: str) -> Floats:
        """The numbers of a block."""
        return self.values[self.report.places[name]]


def stated_numbers(
    candidate: Candidate,
    photos: Sequence[PhotoColumns],
    weights: Sequence[Weights],
    gauge: ReferenceGauge | None = None,
) -> StatedNumbers:
    """A candidate's reported numbers, uncertain by what photographs, noise and our own quadratures leave."""
    report = report_of(candidate.estimate, photos, gauge)
    parameters = report.parameters
    structured = _structured(photos, weights, candidate)
    found = uncertainty_of(report, parameters, candidate.estimate, photos, [w.weight for w in weights])
    values = report(parameters.vector)
    # What our own quadratures leave, propagated.
    own = np.hypot(NUMERICAL * found.fragility, FINEST * report.scale(values))
    # What a wrong model, light or pose does differs between photographs, and shows when some are left out.
    apart = _between_photographs(candidate, report, photos)
    variance = np.diag(found.covariance)
    own = np.hypot(
        own, np.sqrt(np.where(apart > beyond_chance(len(candidate.folds)) * variance, apart - variance, 0))
    )
    if candidate.estimate.model.neutral:
        # One number has one error bar.
        own[report.places["ks"]] = own[report.places["ks"]].max()
    covariance = found.covariance + np.diag(own**2)
    return StatedNumbers(report, values, covariance, found.noise, found.fragility, found.response, structured)


def _between_photographs(candidate: Candidate, report: Report, photos: Sequence[PhotoColumns]) -> Floats:
    """Variances of reported numbers by the jackknife over photographs [Efron 1982, eq. 3.8]; 0 where folds say nothing.

    A fold that lacks a lighting altogether has no strength of it, and says nothing.
    """
    free = {p.lighting: p.elements for p in photos if any(element != "known" for element in p.elements)}
    whole = [fold for fold in candidate.folds if free.keys() <= fold.strengths.keys()]
    if len(whole) < 2:
        return np.zeros(len(report(report.parameters.vector)))
    values = np.array([report(pack(fold, free).vector) for fold in whole])
    return np.asarray((len(whole) - 1) / len(whole) * ((values - values.mean(axis=0)) ** 2).sum(axis=0))


def disagreement(chosen: StatedNumbers, known: Explanation) -> Floats:
    """By how much other models put each number elsewhere, beyond their own doubts of it, as far as they are rivals.

    What a model says that the photographs don't speak against belongs into the error bar. So does what other forms say
    of numbers that no form explains without misfit (`_moved_by_misfit`).
    """

    @cache
    def on_share(model: Model) -> StatedNumbers:
        trial = known.trials[model.form]
        return stated_numbers(trial.candidate_like(model), trial.photos, trial.weights, known.gauge)

    return np.maximum(_from_rivals(chosen, known, on_share), _moved_by_misfit(chosen, known, on_share))


def _moved_by_misfit(
    chosen: StatedNumbers, known: Explanation, on_share: Callable[[Model], StatedNumbers]
) -> Floats:
    """By how much what the chosen form misses may move each number, as forms that miss something else show.

    What a form misses is taken to move a number in proportion to its size, whatever another form misses. The chosen
    form's part of a squared difference is then its share of both squared misfits. The RMS over forms is taken, and
    those that miss much count little.
    """
    model = known.best.estimate.model
    moved, total = np.zeros(len(chosen.values)), 0.0
    if not model.specular or model.form not in known.trials:
        return moved
    here = on_share(model)
    # Of few samples, chance may hide what all show.
    missed = max(chosen.structured, here.structured)
    if not missed:
        return moved
    for form, trial in known.trials.items():
        if form is model.form:
            continue
        there = on_share(trial.candidate_like(model).estimate.model)
        share = missed**2 / (missed**2 + there.structured**2)
        total += share**2
        for name, place in _common_places(chosen, here, there).items():
            difference = here.values_of(name) - _in_terms_of(here, there, name)
            by_noise = there.noise[there.report.places[name]]
            moved[place] += share**3 * np.maximum(difference**2 - by_noise, 0)
    return np.sqrt(moved / max(total, 1e-300))


def _common_places(chosen: StatedNumbers, *others: StatedNumbers) -> dict[str, slice]:
    """Places among the chosen model's numbers of the blocks that others have, too."""
    return {
        name: place
        for name, place in chosen.report.places.items()
        if all(name in other.report.places for other in others)
    }


def _from_rivals(
    chosen: StatedNumbers, known: Explanation, on_share: Callable[[Model], StatedNumbers]
) -> Floats:
    """What rivals differ by. Where no lobe is needed, one that looks like the base counts as part of it."""
    model = known.best.estimate.model
    apart = np.zeros(len(chosen.values))
    rivals = list(zip(known.candidates, rivalry(known.candidates), strict=True))[known.chosen + 1 :]
    for candidate, weight in rivals:
        other = candidate.estimate.model
        if weight < _NO_RIVAL or not other.specular:
            continue
        here, doubt, share = chosen, 1.0, (known.photos, known.weights)
        if other.form is model.form:
            there = stated_numbers(candidate, *share, known.gauge)
        else:
            # Both on the share of samples that the other form was tried on, so that noise is in both alike.
            here, there = on_share(model), on_share(other)
            share = known.trials[other.form].photos, known.trials[other.form].weights
            doubt = float(np.sqrt(sample_count(share[0]) / sample_count(known.photos)))
        std = doubt * np.sqrt(np.diag(there.covariance))
        for name, mine in _common_places(chosen, here, there).items():
            ours, theirs = here.values_of(name), _in_terms_of(here, there, name)
            if name == "kd" and not model.specular and _looks_like_base(candidate.estimate):
                ours = chosen.values_of(name)
                theirs = theirs + there.values_of("ks") * _as_base(candidate.estimate, *share)
            difference = np.abs(ours - theirs) - 2 * std[there.report.places[name]]
            apart[mine] = np.maximum(apart[mine], of_rival(weight) * difference)
    if (known.best.estimate.brdf.sigma or 0.0) > _AT_THE_END * SIGMA_RANGE[1]:
        _add_wide_lobe(apart, chosen, known)
    return apart


def _add_wide_lobe(apart: Floats, chosen: StatedNumbers, known: Explanation) -> None:
    """The doubt that a lobe as wide as a search allows is the base's, and none of Ks a lobe's."""
    ks = chosen.values_of("ks")
    of_base = {
        "kd": ks * _as_base(known.best.estimate, known.photos, known.weights),
        "ks": ks,
        "kd_normalised": chosen.values_of("ks_normalised"),
        "ks_normalised": chosen.values_of("ks_normalised"),
    }
    for name, difference in of_base.items():
        place = chosen.report.places[name]
        apart[place] = np.maximum(apart[place], of_rival(1.0) * difference)


def _looks_like_base(estimate: Estimate) -> bool:
    return estimate.brdf.sigma is not None and estimate.brdf.sigma > WIDEST_HAZE


def _as_base(estimate: Estimate, photos: Sequence[PhotoColumns], weights: Sequence[Weights]) -> Floats:
    """By how much Kd (3,) would grow per unit of Ks if the base took the lobe's place: its share by least squares."""
    both, base = np.zeros((2, 3))
    for photo, own in zip(photos, weights, strict=True):
        strengths = estimate.strengths[photo.lighting]
        diffuse, specular = (
            np.einsum("cne,ec->nc", np.broadcast_to(part, (3, *part.shape[1:])), strengths)
            for part in transfers(photo, estimate.brdf)
        )
        both += (own.weight * diffuse * specular).sum(axis=0)
        base += (own.weight * diffuse**2).sum(axis=0)
    return np.asarray(both / base)


def _in_terms_of(here: StatedNumbers, there: StatedNumbers, name: str) -> Floats:
    """A block of another form's numbers as this form would have them."""
    values = there.values_of(name)
    return values * _as_width(there, here) if name == "sigma" else values


def _as_width(there: StatedNumbers, here: StatedNumbers) -> float:
    """What sigma of one form is multiplied by to compare with another's: forms are compared by their cores."""
    theirs, ours = (found.report.parameters.brdf(found.report.parameters.vector) for found in (there, here))
    if theirs.sigma is None or ours.sigma is None:
        return 1.0
    lobe = ours.form.lobe
    return core_width(theirs.form, theirs.sigma, lobe) / core_width(ours.form, ours.sigma, lobe)


def _structured(photos: Sequence[PhotoColumns], weights: Sequence[Weights], candidate: Candidate) -> float:
    """That part of the residuals which isn't noise, relative to the radiance (RMS both).

    Photographs that stand out as wrong are left aside: they count for next to nothing in the fit as well.
    """
    fields, residuals, energy = [], [], []
    predictions = predict_photos(photos, candidate.estimate.brdf, candidate.estimate.strengths)
    wrong = outlying(candidate.photo_errors)
    for photo, own, predicted, skipped in zip(photos, weights, predictions, wrong, strict=True):
        if not skipped:
            fields.append(photo.field)
            residuals.append(np.sqrt(own.trust) * (photo.radiance - predicted))
            energy.append(np.mean(photo.radiance**2))
    return structured_rms(fields, residuals) / float(np.sqrt(np.mean(energy)))
