"""From prepared columns to a result: noise, evidence, uncertainty, identifiability."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from capture.lighting import Lighting
from capture.progress import OnStep, unwatched
from invrender.brdf.microfacet import Microfacet
from invrender.estimate.disagreement import disagreement, report_of, stated_numbers
from invrender.estimate.evidence import HOPELESS, MISFIT_REMEDY, Candidate, misfit_reason
from invrender.estimate.explanation import Explanation, explain, refitted
from invrender.estimate.identifiability import lighting_degree
from invrender.estimate.models import Estimate
from invrender.estimate.noise import NoiseModel, Weights
from invrender.estimate.quantities import FittedLighting, Quantity
from invrender.estimate.reported import Report
from invrender.transport.columns import PhotoColumns
from invrender.transport.half_vectors import is_rough

Floats = NDArray[np.float64]

# Causes that are read off what photographs leave, among it what errors of calibration do.
_SHOWN = ("misfit", "sphere_place")


@dataclass(frozen=True, eq=False)
class Solution:
    """The numbers that a solve found, their uncertainty, and the evidence for them.

    estimate : the chosen model's values, also those too uncertain to report: predictions use them.
    candidates, chosen : the ladder of models and the index of the chosen one.
    noise : what the residuals look like. weights : of each photograph's samples, as they entered the fit.
    structured : the part of the residuals that isn't noise, relative RMS.
    quantities : by name, "kd", "ks", "mu", "sigma", "exponent" (Phong's), "albedo", "kd_normalised", "ks_normalised";
        a name that the chosen model doesn't have is missing, and so is the albedo in a relative gauge.
    covariance, covariance_names : of the BRDF's numbers, in the order named.
    gauge : which scale the numbers are in, in words; `is_absolute` if the lighting fixes it.
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

    @property
    def brdf(self) -> Microfacet:
        """The BRDF of the estimate."""
        return self.estimate.brdf

    @property
    def model(self) -> Candidate:
        """The chosen candidate."""
        return self.candidates[self.chosen]

    @property
    def is_absolute(self) -> bool:
        """Whether Kd and Ks are in the lighting's own scale, not up to a factor per channel."""
        return "albedo" in self.quantities

    @property
    def misfits(self) -> bool:
        """Whether even the best model explains so little that no number is given."""
        return any(quantity.remedy == MISFIT_REMEDY for quantity in self.quantities.values())


def factorize(
    photos: Sequence[PhotoColumns],
    lightings: Sequence[Lighting],
    on_step: OnStep = unwatched,
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
    found = stated_numbers(known.best, photos, weights, known.gauge)
    report, values, fragility = found.report, found.values, found.fragility
    parts = {
        "noise": np.diag(found.noise),
        "misfit": found.covariance - np.diag(found.noise),
        "forms": np.diag(disagreement(found, known) ** 2),
    }
    if "sigma" in report.places:
        place = report.places["sigma"].start
        of_pixels = np.zeros(len(values))
        of_pixels[place] = _width_of_pixels(lightings, values[place]) ** 2
        parts["map_pixels"] = np.diag(of_pixels)

    def moved(others: Sequence[Estimate]) -> Floats:
        apart = [_reported(known, other) - values for other in others]
        return np.asarray(sum((np.outer(each, each) for each in apart), np.zeros_like(found.covariance)))

    for cause, own in (doubts or {}).items():
        parts[cause] = moved([refitted(known, doubt) for doubt in own])
    if known.gauge is not None:
        # Light at the reference may be off by as much as what the model leaves elsewhere.
        by_scale = np.hypot(known.gauge.scale.own_std, found.structured) * report.moved_by_scale(values)
        parts["reference"] = by_scale @ by_scale.T
    parts["faults"] = moved([replace(known.best.estimate, brdf=brdf) for brdf in instead])
    stated = {
        cause: found.response @ columns @ columns.T @ found.response.T
        for cause, columns in (scores or {}).items()
    }
    parts = {**unexplained(parts, stated), **stated}
    covariance = np.asarray(sum(parts.values()))
    std = np.sqrt(np.diag(covariance))
    fields, degree = [photo.field for photo in photos], lighting_degree(lightings)
    quantities = report.quantities(values, std, fragility, fields, degree)
    variances = {cause: np.diag(part) for cause, part in parts.items()}
    quantities = {name: report.with_shares(name, own, variances) for name, own in quantities.items()}
    brdf_size = report.places["strengths"].start
    estimate = known.best.estimate
    if known.gauge is not None:
        factor = report.factor(report.parameters.vector)
        brdf = replace(estimate.brdf, kd=estimate.brdf.kd * factor, ks=estimate.brdf.ks * factor)
        estimate = replace(
            estimate,
            brdf=brdf,
            strengths={name: own / factor for name, own in estimate.strengths.items()},
        )
    return Solution(
        estimate=estimate,
        candidates=known.candidates,
        chosen=known.chosen,
        noise=known.noise,
        weights=weights,
        structured=found.structured,
        quantities=unless_misfit(quantities, known.best.error),
        lightings=tuple(_fitted_lighting(lighting, report, values, std) for lighting in lightings),
        covariance=covariance[:brdf_size, :brdf_size],
        covariance_names=report.names,
        gauge=_gauge(report),
    )


def unexplained(parts: Mapping[str, Floats], stated: Mapping[str, Floats]) -> dict[str, Floats]:
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
    report = report_of(estimate, known.photos, known.gauge)
    return report(report.parameters.vector)


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
    if report.gauge is not None:
        return report.gauge.scale.in_words
    if report.is_absolute:
        return "absolute: the given lighting fixes the scale of Kd and Ks in each channel"
    which = "source irradiance" if any("/source" in name for name in report.strengths) else "ambient radiance"
    return f"relative: mean recovered {which} fixed to 1 per channel"
