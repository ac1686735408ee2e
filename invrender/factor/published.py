"""RH01's factorization of a photo set [section 6.3], in the terms of our results; its numbers have no error bars."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence

import numpy as np
from numpy.typing import NDArray

from capture.lighting import Lighting
from capture.photoset import Photo, PhotoSet
from capture.progress import Track
from invrender.brdf.fresnel import MU_RANGE
from invrender.brdf.microfacet import Microfacet
from invrender.estimate.clusters import structured_share
from invrender.estimate.evidence import Candidate, relative_rms
from invrender.estimate.models import Estimate, Model
from invrender.estimate.noise import fit_noise, photo_weights
from invrender.estimate.quantities import FittedLighting, HarmonicLight, Quantity
from invrender.estimate.rh01 import PublishedFactors, published_factors, published_factors_direct
from invrender.estimate.solution import Solution, unless_misfit
from invrender.estimate.unknown_light import Region
from invrender.estimate.unknown_light.solution import GAUGE
from invrender.observation.clock import Clock
from invrender.observation.geometry import SceneGeometry
from invrender.observation.samples import read_samples
from invrender.process.run import Run, factorization, pixel_by_pixel
from invrender.process.warnings import find_warnings
from invrender.transport.visibility import Shadows
from recon.harmonics.latlong import synthesise_latlong
from recon.sampling.lightfield import LightField

Floats = NDArray[np.float64]

_MAP_HEIGHT = 64
_NO_ERROR = "RH01's procedure says nothing of errors", "leave out --published for numbers with error bars"
# Where a search ended at the range's end, as far as it can resolve.
_AT_END = 0.01
_FOLDS = 5


def solve_as_published(
    photoset: PhotoSet,
    geometry: SceneGeometry,
    samples: int,
    clock: Clock,
    track: Track,
    region: Region | None,
    degree: int | None = None,
) -> Run:
    """Light and BRDF of an object by RH01's procedure; weights and noise are of its residuals, for reports only.

    degree : l* of the light's harmonics, recovered directly; None for dual lighting, which is of spheres.
    """

    def factors(photos: Sequence[LightField]) -> PublishedFactors:
        if degree is None:
            return published_factors(photos, region=region)
        return published_factors_direct(photos, region=region, shadows=geometry.shadows, degree=degree)

    fields, left_out = read_samples(photoset, geometry.found, {}, samples, clock, track)
    fitted = photoset.fitted
    with clock.on("invrender"):
        found = factors([fields[photo.label] for photo in fitted])
        predicted = {label: found.radiance(field, geometry.shadows) for label, field in fields.items()}
        residuals = {label: field.radiance - predicted[label] for label, field in fields.items()}
        unseen = _unseen([fields[photo.label] for photo in fitted], factors, geometry.shadows)
        solution = _solution(photoset, found, fields, predicted, unseen)
    warnings = (*left_out, *find_warnings(photoset, solution, geometry, {}))
    result = factorization(photoset, geometry, solution, fields, residuals, warnings)

    def radiance(_: Photo, field: LightField) -> Floats:
        return found.radiance(field, geometry.shadows)

    return Run(photoset, geometry, result, fields, residuals, radiance, pixel_by_pixel(radiance))


def _unseen(
    fields: Sequence[LightField],
    factors: Callable[[Sequence[LightField]], PublishedFactors],
    shadows: Shadows | None,
) -> Floats:
    """Relative RMS (photos,) of each photograph as predicted by a fit that has not seen it, a few at a time."""
    errors = np.empty(len(fields))
    folds = min(_FOLDS, len(fields))
    for fold in range(folds):
        rest = factors([field for k, field in enumerate(fields) if k % folds != fold])
        for k in range(fold, len(fields), folds):
            shown = rest.radiance(fields[k], shadows)
            errors[k] = relative_rms(fields[k].radiance - shown, fields[k].radiance)
    return errors


def _solution(
    photoset: PhotoSet,
    found: PublishedFactors,
    fields: Mapping[str, LightField],
    predicted: Mapping[str, Floats],
    unseen: Floats,
) -> Solution:
    labels = [photo.label for photo in photoset.fitted]
    seen, made = [fields[label] for label in labels], [predicted[label] for label in labels]
    left = [field.radiance - own for field, own in zip(seen, made, strict=True)]
    noise = fit_noise(made, left)
    weights = tuple(photo_weights(noise, *pair) for pair in zip(made, left, strict=True))
    brdf = Microfacet(1 - found.share, found.share, found.mu, found.sigma)
    model = Model("RH01, section 6.3", specular=True, fresnel=found.mu is not None)
    parameters = 3 + 9 * 3 + sum(value is not None for value in (found.mu, found.sigma))
    candidate = Candidate(Estimate(model, brdf, {}, 0.0), unseen, np.zeros(1), parameters)
    names = (*(f"{name}.{c}" for name in ("kd", "ks") for c in "rgb"), "mu", "sigma")
    return Solution(
        estimate=candidate.estimate,
        candidates=(candidate,),
        chosen=0,
        noise=noise,
        weights=weights,
        structured=structured_share(seen, left),
        quantities=unless_misfit(_quantities(found), candidate.error),
        lightings=(_lighting(found, photoset.photos[0].lighting),),
        covariance=np.full((len(names), len(names)), np.nan),
        covariance_names=names,
        gauge=GAUGE,
    )


def _quantities(found: PublishedFactors) -> dict[str, Quantity]:
    def without_std(values: Floats) -> Quantity:
        return Quantity(values, np.full(len(values), np.nan), "weak", *_NO_ERROR)

    quantities = {"kd": without_std(1 - found.share), "ks": without_std(found.share)}
    quantities |= {f"{name}_normalised": quantity for name, quantity in quantities.items()}
    if found.mu is not None:
        low, high = MU_RANGE
        inside = low + _AT_END < found.mu < high - _AT_END
        quantities["mu"] = without_std(np.array([found.mu])) if inside else _at_end(found.mu)
    if found.sigma is None:
        quantities["sigma"] = Quantity(
            None,
            None,
            "undetermined",
            "the recovered light has no peak from which sigma could be read (RH01, eq. 26)",
            "photograph under a small, bright source, and name its place by --source-region",
        )
    else:
        quantities["sigma"] = without_std(np.array([found.sigma]))
    return quantities


def _at_end(mu: float) -> Quantity:
    return Quantity(
        None,
        None,
        "undetermined",
        f"the fit runs to the end of the range of mu, {mu:.2f}: a metal has no Fresnel factor to speak of",
        "photographs with highlights at grazing angles",
    )


def _lighting(found: PublishedFactors, name: str) -> FittedLighting:
    slow, directions, irradiances = found.slow_and_source()
    radiance = np.maximum(synthesise_latlong(slow, _MAP_HEIGHT), 0).astype(np.float32)
    lighting = Lighting(name, radiance, directions, irradiances, recover_irradiance=True, origin="recovered")
    undetermined = np.full_like(slow, np.nan)
    degree = round(np.sqrt(len(slow))) - 1
    harmonics = HarmonicLight(slow, undetermined, np.full(degree + 1, np.nan), -1, *_NO_ERROR)
    return FittedLighting(lighting, np.full_like(irradiances, np.nan), None, None, harmonics)
