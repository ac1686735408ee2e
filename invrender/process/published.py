"""RH01's estimation of a parametric BRDF from a photo set [section 6.1], in the terms of our results; no error bars."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from capture.photo import Photo
from capture.photoset import PhotoSet
from capture.progress import Track
from invrender.brdf.fresnel import MU_RANGE
from invrender.brdf.microfacet import Microfacet
from invrender.estimate.clusters import structured_share
from invrender.estimate.evidence import Candidate, relative_rms
from invrender.estimate.models import Estimate, Model
from invrender.estimate.noise import fit_noise, photo_weights
from invrender.estimate.quantities import FittedLighting, Quantity
from invrender.estimate.rh01 import published_brdf
from invrender.estimate.solution import Solution, unless_misfit
from invrender.observation.clock import Clock
from invrender.observation.geometry import SceneGeometry
from invrender.observation.samples import read_samples
from invrender.process.held_out_light import scored_lighting, used_lightings
from invrender.process.warnings import find_warnings
from invrender.result.run import Run
from invrender.result.scores import mean_rms, photo_scores
from invrender.transport.cached_shader import LOOKUPS_OFF, CachedShader
from invrender.transport.predict import predict
from invrender.transport.sphere_rays import SphereRays
from invrender.transport.transfer import light_elements
from recon.sampling.lightfield import LightField

Floats = NDArray[np.float64]

NO_ERROR = "RH01's procedure says nothing of errors", "leave out --published for numbers with error bars"
_ABSOLUTE = "absolute: the given lighting fixes the scale of Kd and Ks in each channel"
# Where a search ended at the range's end, as far as it can resolve.
_AT_END = 0.01
_FOLDS = 5


def solve_known_light_as_published(
    photoset: PhotoSet, geometry: SceneGeometry, samples: int, clock: Clock, track: Track
) -> Run:
    """The BRDF of an object under known light by RH01's simplex and linear solve.

    Pictures show the BRDF by our own transfer. Weights and noise are of the residuals, for reports only. Raises
    ValueError for fitted photographs under several lightings, and for light that isn't known.
    """
    with clock.on("recon"):
        lightings = used_lightings(photoset)
    fitted = photoset.fitted
    names = list(dict.fromkeys(photo.lighting for photo in fitted))
    if len(names) > 1:
        raise ValueError(
            f"{photoset.manifest}: fitted photographs are under {len(names)} lightings ({', '.join(map(repr, names))}),"
            " RH01's procedure takes one: hold the others out, or leave out --published"
        )
    for name, lighting in lightings.items():
        if lighting.recovers:
            raise ValueError(
                f'{photoset.manifest}: [[lighting]] "{name}": strengths are to be recovered, but RH01\'s procedure'
                " takes known light: give them, or leave out --published"
            )
    sources = {name: lighting.directions for name, lighting in lightings.items()}
    fields, left_out = read_samples(photoset, geometry.found, sources, samples, clock, track)
    elements = {name: light_elements(lighting) for name, lighting in lightings.items()}

    def brdf_of(photos: Sequence[LightField]) -> Microfacet:
        return published_brdf(photos, lightings[names[0]], shadows=geometry.shadows).brdf

    def predictor(photos: Sequence[LightField]) -> Callable[[LightField], Floats]:
        rest = brdf_of(photos)
        return lambda field: shown(rest, names[0], field)

    def shown(brdf: Microfacet, name: str, field: LightField) -> Floats:
        return predict(brdf, elements[name], np.ones((len(elements[name]), 3)), field, geometry.shadows)

    with clock.on("invrender"):
        seen = [fields[photo.label] for photo in fitted]
        brdf = brdf_of(seen)
        predicted = {
            photo.label: shown(brdf, photo.lighting, fields[photo.label]) for photo in photoset.photos
        }
        residuals = {label: field.radiance - predicted[label] for label, field in fields.items()}
        unseen = unseen_errors(seen, predictor)
        given = {
            name: scored_lighting(lighting, elements[name], np.ones((len(elements[name]), 3)))
            for name, lighting in lightings.items()
        }
        candidate = published_candidate("RH01, section 6.1", brdf, 6, unseen)
        made = [predicted[photo.label] for photo in fitted]
        error = relative_rms(
            np.concatenate([residuals[photo.label] for photo in fitted]),
            np.concatenate([field.radiance for field in seen]),
        )
        quantities = unless_misfit(_quantities(brdf), error)
        solution = published_solution(candidate, quantities, given[names[0]], _ABSOLUTE, seen, made)
    warnings = (*left_out, *find_warnings(photoset, solution, geometry, lightings, published=True))
    scores = photo_scores(photoset, solution, fields, residuals)
    others = [entry for name, entry in given.items() if name != names[0]]

    def radiance(photo: Photo, field: LightField) -> Floats:
        return shown(brdf, photo.lighting, field)

    many = CachedShader(
        brdf,
        elements,
        {photo.lighting: fields[photo.label] for photo in photoset.photos},
        {photo.lighting: SphereRays.of(geometry.body, photo.camera) for photo in photoset.photos},
        Counter(photo.lighting for photo in photoset.photos),
        geometry.shadows,
        LOOKUPS_OFF * (mean_rms(scores, held_out=False) or 0.0),
    )

    def pictured(photo: Photo, field: LightField, binning: int) -> Floats:
        strengths = np.ones((len(elements[photo.lighting]), 3))
        rays = SphereRays.of(geometry.body, photo.camera)
        return many.radiance(photo.lighting, strengths, field, rays)

    solution = replace(solution, lightings=(*solution.lightings, *others))
    return Run(photoset, geometry, solution, fields, residuals, scores, warnings, radiance, pictured)


def unseen_errors(
    fields: Sequence[LightField], fit: Callable[[Sequence[LightField]], Callable[[LightField], Floats]]
) -> Floats:
    """Relative RMS (photos,) of each photograph as predicted by a fit that has not seen it, a few at a time.

    fit : makes a predictor of radiance (n, 3) from photographs.
    """
    errors = np.empty(len(fields))
    folds = min(_FOLDS, len(fields))
    for fold in range(folds):
        predictor = fit([field for k, field in enumerate(fields) if k % folds != fold])
        for k in range(fold, len(fields), folds):
            errors[k] = relative_rms(fields[k].radiance - predictor(fields[k]), fields[k].radiance)
    return errors


def published_candidate(name: str, brdf: Microfacet, parameters: int, unseen: Floats) -> Candidate:
    """What a published procedure found as a candidate, with no other beside it.

    parameters : how many were fitted. unseen : `unseen_errors`.
    """
    model = Model(name, specular=True, fresnel=brdf.mu is not None)
    return Candidate(Estimate(model, brdf, {}, 0.0), unseen, np.zeros(1), parameters)


def published_solution(
    candidate: Candidate,
    quantities: dict[str, Quantity],
    lighting: FittedLighting,
    gauge: str,
    fields: Sequence[LightField],
    predicted: Sequence[Floats],
) -> Solution:
    """The numbers of a published procedure, from its one candidate; their covariance is unknown.

    fields, predicted : samples of the fitted photographs, and their radiance (n, 3) as predicted.
    """
    left = [field.radiance - made for field, made in zip(fields, predicted, strict=True)]
    noise = fit_noise(predicted, left)
    weights = tuple(photo_weights(noise, *pair) for pair in zip(predicted, left, strict=True))
    names = (*(f"{name}.{c}" for name in ("kd", "ks") for c in "rgb"), "mu", "sigma")
    return Solution(
        estimate=candidate.estimate,
        candidates=(candidate,),
        chosen=0,
        noise=noise,
        weights=weights,
        structured=structured_share(fields, left),
        quantities=quantities,
        lightings=(lighting,),
        covariance=np.full((len(names), len(names)), np.nan),
        covariance_names=names,
        gauge=gauge,
    )


def without_std(values: Floats) -> Quantity:
    """A number that a published procedure gives, which has no error bar."""
    return Quantity(values, np.full(len(values), np.nan), "weak", *NO_ERROR)


def found_mu(mu: float) -> Quantity:
    """mu as a simplex found it; undetermined where that ended at the end of its range."""
    low, high = MU_RANGE
    if low + _AT_END < mu < high - _AT_END:
        return without_std(np.array([mu]))
    return Quantity(
        None,
        None,
        "undetermined",
        f"the fit runs to the end of the range of mu, {mu:.2f}: a metal has no Fresnel factor to speak of",
        "photographs with highlights at grazing angles",
    )


def _quantities(brdf: Microfacet) -> dict[str, Quantity]:
    assert brdf.mu is not None
    assert brdf.sigma is not None
    both = brdf.kd + brdf.ks
    return {
        "kd": without_std(brdf.kd),
        "albedo": without_std(np.pi * brdf.kd),
        "ks": without_std(brdf.ks),
        "kd_normalised": without_std(brdf.kd / both),
        "ks_normalised": without_std(brdf.ks / both),
        "mu": found_mu(brdf.mu),
        "sigma": without_std(np.array([brdf.sigma])),
    }
