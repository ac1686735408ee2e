"""From prepared columns to a result: noise, evidence, uncertainty, identifiability."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cache

import numpy as np
from numpy.typing import NDArray

from capture.lighting import Lighting
from invrender.brdf.microfacet import Microfacet
from invrender.brdf.richer import core_width
from invrender.estimate.clusters import beyond_chance, structured_rms
from invrender.estimate.evidence import (
    HOPELESS,
    MISFIT_REMEDY,
    Candidate,
    misfit_reason,
    of_rival,
    outlying,
    rivalry,
)
from invrender.estimate.explanation import Explanation, explain, refitted
from invrender.estimate.identifiability import lighting_degree
from invrender.estimate.jacobian import pack
from invrender.estimate.models import Estimate, Model
from invrender.estimate.noise import NoiseModel, Weights
from invrender.estimate.quantities import FittedLighting, Quantity
from invrender.estimate.reported import Report
from invrender.estimate.uncertainty import FINEST, NUMERICAL, uncertainty_of
from invrender.transport.columns import PhotoColumns, sample_count
from invrender.transport.half_vectors import is_rough
from invrender.transport.predict import predict_photos

Floats = NDArray[np.float64]

# Causes that are read off what photographs leave, among it what errors of calibration do.
_SHOWN = ("misfit", "sphere_place")
# Weight of a rival below which it isn't measured: it would move a number by a thirtieth of what they differ.
_NO_RIVAL = 1e-3


@dataclass(frozen=True, eq=False)
class Solution:
    """What the solve adds to what is known of a set; see `Factorization` for the fields.

    weights : of each photograph's samples, as they entered the fit. photos : columns of the chosen form; none where
    the light was unknown.
    """

    estimate: Estimate
    candidates: tuple[Candidate, ...]
    chosen: int
    noise: NoiseModel
    weights: tuple[Weights, ...]
    structured: float
    quantities: Mapping[str, Quantity]
    lightings: tuple[FittedLighting, ...]
    covariance: Floats
    covariance_names: tuple[str, ...]
    gauge: str
    photos: tuple[PhotoColumns, ...] = ()


def factorize(
    photos: Sequence[PhotoColumns],
    lightings: Sequence[Lighting],
    on_step: Callable[[], None] = lambda: None,
) -> Solution:
    """Solve for the BRDF and for what of the lighting is to be recovered.

    photos : columns of RH01's form. A first fit with equal weights shows the noise; the next weigh each sample by its
    inverse variance. `on_step` is called `explanation.EXPLANATION_STEPS` times at most.
    """
    return solution_of(explain(photos, lightings, on_step), lightings)


def solution_of(
    known: Explanation,
    lightings: Sequence[Lighting],
    doubts: Mapping[str, Sequence[Sequence[Floats]]] | None = None,
    instead: Sequence[Microfacet] = (),
    scores: Mapping[str, Floats] | None = None,
) -> Solution:
    """What an explanation amounts to: numbers with their uncertainty, and which of them are determined.

    doubts : by cause, one for each thing in doubt, (n, 3) per photograph, the radiance by which its samples are all off
    together if that is off by one standard deviation. instead : the BRDF as each fault that was found puts it.
    scores : (p, q) by cause, as `calibration.calibration_scores` has them.
    """
    weights, photos = known.weights, known.photos
    measured = _measure(known.best, photos, weights)
    report, values, fragility = measured.report, measured.values, measured.fragility
    parts = {
        "noise": np.diag(measured.noise),
        "misfit": measured.covariance - np.diag(measured.noise),
        "forms": np.diag(_disagreement(measured, known) ** 2),
    }
    if "sigma" in report.places:
        place = report.places["sigma"].start
        of_pixels = np.zeros(len(values))
        of_pixels[place] = _width_of_pixels(lightings, values[place]) ** 2
        parts["map_pixels"] = np.diag(of_pixels)

    def moved(others: Sequence[Estimate]) -> Floats:
        apart = [_reported(known, other) - values for other in others]
        return np.asarray(sum((np.outer(each, each) for each in apart), np.zeros_like(measured.covariance)))

    for cause, own in (doubts or {}).items():
        parts[cause] = moved([refitted(known, doubt) for doubt in own])
    parts["faults"] = moved([replace(known.best.estimate, brdf=brdf) for brdf in instead])
    stated = {
        cause: measured.response @ columns @ columns.T @ measured.response.T
        for cause, columns in (scores or {}).items()
    }
    parts = {**_unexplained(parts, stated), **stated}
    covariance = np.asarray(sum(parts.values()))
    std = np.sqrt(np.diag(covariance))
    fields, degree = [photo.field for photo in photos], lighting_degree(lightings)
    quantities = report.quantities(values, std, fragility, fields, degree)
    variances = {cause: np.diag(part) for cause, part in parts.items()}
    quantities = {name: report.with_shares(name, own, variances) for name, own in quantities.items()}
    brdf_size = report.places["strengths"].start
    return Solution(
        estimate=known.best.estimate,
        candidates=known.candidates,
        chosen=known.chosen,
        noise=known.noise,
        weights=weights,
        structured=measured.structured,
        quantities=unless_misfit(quantities, known.best.error),
        lightings=tuple(_fitted_lighting(lighting, report, values, std) for lighting in lightings),
        covariance=covariance[:brdf_size, :brdf_size],
        covariance_names=report.names,
        gauge=_gauge(report),
        photos=photos,
    )


def _unexplained(parts: Mapping[str, Floats], stated: Mapping[str, Floats]) -> dict[str, Floats]:
    """Covariances by cause, of which stated errors of calibration explain some: what they do isn't counted twice.

    Poses that are off leave residuals that repeat and outlines that disagree. Of what these imply only the excess over
    stated errors counts beside them.
    """
    shown = {cause: part for cause, part in parts.items() if cause in _SHOWN}
    before = np.diag(sum(shown.values()))
    explained = np.diag(sum(stated.values(), np.zeros((len(before), len(before)))))
    root = np.sqrt(np.maximum(before - explained, 0) / np.maximum(before, 1e-300))
    return {**parts, **{cause: part * np.outer(root, root) for cause, part in shown.items()}}


def _reported(known: Explanation, estimate: Estimate) -> Floats:
    """The reported numbers of another estimate of the chosen model."""
    parameters = pack(estimate, {photo.lighting: photo.elements for photo in known.photos})
    return Report(parameters, _has_known(known.photos))(parameters.vector)


def _has_known(photos: Sequence[PhotoColumns]) -> bool:
    return any("known" in photo.elements for photo in photos)


@dataclass(frozen=True, eq=False)
class _Measured:
    """A candidate's reported numbers with their covariance; the rest as in `uncertainty.Uncertainty`."""

    report: Report
    values: Floats
    covariance: Floats
    noise: Floats
    fragility: Floats
    response: Floats
    structured: float


def _measure(candidate: Candidate, photos: Sequence[PhotoColumns], weights: Sequence[Weights]) -> _Measured:
    elements = {photo.lighting: photo.elements for photo in photos}
    parameters = pack(candidate.estimate, elements)
    report = Report(parameters, _has_known(photos))
    structured = _structured(photos, weights, candidate)
    found = uncertainty_of(report, parameters, candidate.estimate, photos, [w.weight for w in weights])
    values = report(parameters.vector)
    # What our own quadratures leave, propagated.
    own = np.hypot(NUMERICAL * found.fragility, FINEST * report.scale(values))
    # What a wrong model, light or pose does differs between photographs, and shows when some are left out.
    apart = _between_photographs(candidate, report, elements)
    variance = np.diag(found.covariance)
    own = np.hypot(
        own, np.sqrt(np.where(apart > beyond_chance(len(candidate.folds)) * variance, apart - variance, 0))
    )
    if candidate.estimate.model.neutral:
        # One number has one error bar.
        own[report.places["ks"]] = own[report.places["ks"]].max()
    covariance = found.covariance + np.diag(own**2)
    return _Measured(report, values, covariance, found.noise, found.fragility, found.response, structured)


def _between_photographs(
    candidate: Candidate, report: Report, elements: Mapping[str, Sequence[str]]
) -> Floats:
    """Variances of reported numbers by the jackknife over photographs [Efron 1982, eq. 3.8]; 0 where folds say nothing.

    A fold that lacks a lighting altogether has no strength of it, and says nothing.
    """
    free = {name: own for name, own in elements.items() if any(element != "known" for element in own)}
    whole = [fold for fold in candidate.folds if free.keys() <= fold.strengths.keys()]
    if len(whole) < 2:
        return np.zeros(len(report(report.parameters.vector)))
    values = np.array([report(pack(fold, free).vector) for fold in whole])
    return np.asarray((len(whole) - 1) / len(whole) * ((values - values.mean(axis=0)) ** 2).sum(axis=0))


def _disagreement(chosen: _Measured, known: Explanation) -> Floats:
    """By how much other models put each number elsewhere, beyond their own doubts of it, as far as they are rivals.

    What a model says that the photographs don't speak against belongs into the error bar.
    """
    model = known.best.estimate.model
    apart = np.zeros(len(chosen.values))

    @cache
    def on_share(model: Model) -> _Measured:
        trial = known.trials[model.form]
        return _measure(trial.candidate_like(model), trial.photos, trial.weights)

    rivals = list(zip(known.candidates, rivalry(known.candidates), strict=True))[known.chosen + 1 :]
    for candidate, weight in rivals:
        other = candidate.estimate.model
        if weight < _NO_RIVAL or not other.specular:
            continue
        here, doubt = chosen, 1.0
        if other.form is model.form:
            there = _measure(candidate, known.photos, known.weights)
        else:
            # Both on the share of samples that the other form was tried on, so that noise is in both alike.
            here, there = on_share(model), on_share(other)
            share = known.trials[model.form].photos
            doubt = float(np.sqrt(sample_count(share) / sample_count(known.photos)))
        std = doubt * np.sqrt(np.diag(there.covariance))
        for name in chosen.report.places.keys() & there.report.places.keys() & here.report.places.keys():
            theirs = there.report.places[name]
            alike = _as_width(there, here) if name == "sigma" else 1.0
            ours, values = here.values[here.report.places[name]], there.values[theirs]
            difference = np.abs(ours - values * alike) - 2 * std[theirs]
            mine = chosen.report.places[name]
            apart[mine] = np.maximum(apart[mine], of_rival(weight) * difference)
    return apart


def _as_width(there: _Measured, here: _Measured) -> float:
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


def _width_of_pixels(lightings: Sequence[Lighting], sigma: float) -> float:
    """By how much sigma may be off because a map doesn't say where in a pixel its light lies.

    Light spread over a pixel p widens the lobe as facets would: sigma^2 grows by p^2 / 24, since a half vector turns by
    half as much, and the variance of a lobe is sigma^2 / 2 each way. By as much again between pixels, where a map is
    interpolated. 0 where a source has a direction, or maps are smooth.
    """
    pixels = []
    for lighting in lightings:
        if len(lighting.directions):
            pixels.append(0.0)
        elif lighting.radiance_map is not None and is_rough(lighting.radiance_map):
            pixels.append(np.pi / len(lighting.radiance_map))
    return float(min(pixels, default=0.0) ** 2 / (24 * sigma))


def unless_misfit(quantities: dict[str, Quantity], error: float) -> dict[str, Quantity]:
    """The quantities, or none of them where the model explains so little that they mean nothing."""
    if error < HOPELESS:
        return quantities
    reason = misfit_reason(error)
    return {name: Quantity(None, None, "undetermined", reason, MISFIT_REMEDY) for name in quantities}


def _fitted_lighting(lighting: Lighting, report: Report, values: Floats, std: Floats) -> FittedLighting:
    irradiances = lighting.irradiances.copy()
    irradiance_std = np.zeros_like(irradiances)
    if lighting.recover_irradiance:
        for k in range(len(irradiances)):
            name = f"{lighting.name}/source {k + 1}"
            irradiances[k] = np.maximum(report.strength(values, name), 0)
            irradiance_std[k] = report.strength(std, name)
    ambient = ambient_std = None
    if lighting.recover_ambient:
        name = f"{lighting.name}/ambient"
        ambient, ambient_std = report.strength(values, name), report.strength(std, name)
    return FittedLighting(replace(lighting, irradiances=irradiances), irradiance_std, ambient, ambient_std)


def _gauge(report: Report) -> str:
    if report.is_absolute:
        return "absolute: the given lighting fixes the scale of Kd and Ks in each channel"
    which = "source irradiance" if any("/source" in name for name in report.strengths) else "ambient radiance"
    return f"relative: mean recovered {which} fixed to 1 per channel"
