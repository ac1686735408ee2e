"""RH01's factorization of a photo set [section 6.3], in the terms of our results; its numbers have no error bars."""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np
from numpy.typing import NDArray

from capture.lighting import Lighting
from capture.photo import Photo
from capture.photoset import PhotoSet
from capture.progress import Track
from capture.source_region import SourceRegion
from invrender.brdf.microfacet import Microfacet
from invrender.estimate.evidence import Candidate
from invrender.estimate.quantities import FittedLighting, HarmonicLight, Quantity
from invrender.estimate.rh01 import PublishedFactors, published_factors, published_factors_direct
from invrender.estimate.solution import unless_misfit
from invrender.estimate.unknown_light.solution import GAUGE
from invrender.observation.clock import Clock
from invrender.observation.geometry import SceneGeometry
from invrender.observation.samples import read_samples
from invrender.process.published import (
    NO_ERROR,
    found_mu,
    published_candidate,
    published_solution,
    unseen_errors,
    without_std,
)
from invrender.process.warnings import find_warnings
from invrender.result.run import Run, pixel_by_pixel
from invrender.result.scores import photo_scores
from recon.harmonics.latlong import synthesise_latlong
from recon.sampling.lightfield import LightField

Floats = NDArray[np.float64]

_MAP_HEIGHT = 64


def solve_as_published(
    photoset: PhotoSet,
    geometry: SceneGeometry,
    samples: int,
    clock: Clock,
    track: Track,
    region: SourceRegion | None,
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
        seen = [fields[photo.label] for photo in fitted]
        found = factors(seen)
        predicted = {label: found.radiance(field, geometry.shadows) for label, field in fields.items()}
        residuals = {label: field.radiance - predicted[label] for label, field in fields.items()}

        def predictor(photos: Sequence[LightField]) -> Callable[[LightField], Floats]:
            rest = factors(photos)
            return lambda field: rest.radiance(field, geometry.shadows)

        made = [predicted[photo.label] for photo in fitted]
        lighting = _lighting(found, photoset.photos[0].lighting)
        candidate = _candidate(found, unseen_errors(seen, predictor))
        # By the error that the procedure minimises: of highlights of the lamp, which it leaves out, a mirror's light is
        # a poor picture whatever the numbers are.
        quantities = unless_misfit(_quantities(found), found.rms)
        solution = published_solution(candidate, quantities, lighting, GAUGE, seen, made)
    warnings = (*left_out, *find_warnings(photoset, solution, geometry, {}, published=True))
    scores = photo_scores(photoset, solution, fields, residuals)

    def radiance(_: Photo, field: LightField) -> Floats:
        return found.radiance(field, geometry.shadows)

    pictured = pixel_by_pixel(radiance)
    return Run(photoset, geometry, solution, fields, residuals, scores, warnings, radiance, pictured)


def _candidate(found: PublishedFactors, unseen: Floats) -> Candidate:
    brdf = Microfacet(1 - found.share, found.share, found.mu, found.sigma)
    parameters = 3 + 9 * 3 + sum(value is not None for value in (found.mu, found.sigma))
    return published_candidate("RH01, section 6.3", brdf, parameters, unseen)


def _quantities(found: PublishedFactors) -> dict[str, Quantity]:
    quantities = {"kd": without_std(1 - found.share), "ks": without_std(found.share)}
    quantities |= {f"{name}_normalised": quantity for name, quantity in quantities.items()}
    if found.mu is not None:
        quantities["mu"] = found_mu(found.mu)
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


def _lighting(found: PublishedFactors, name: str) -> FittedLighting:
    slow, directions, irradiances = found.slow_and_source()
    radiance = np.maximum(synthesise_latlong(slow, _MAP_HEIGHT), 0).astype(np.float32)
    lighting = Lighting(name, radiance, directions, irradiances, recover_irradiance=True, origin="recovered")
    undetermined = np.full_like(slow, np.nan)
    degree = round(np.sqrt(len(slow))) - 1
    harmonics = HarmonicLight(slow, undetermined, np.full(degree + 1, np.nan), -1, *NO_ERROR)
    return FittedLighting(lighting, np.full_like(irradiances, np.nan), None, None, harmonics)
