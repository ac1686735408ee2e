"""What solving a photo set yields: the result, and what predictions and reports need beside it."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from capture.photoset import Photo, PhotoSet
from invrender.estimate.evidence import relative_rms
from invrender.estimate.quantities import FittedLighting, PhotoScore
from invrender.estimate.solution import Solution
from invrender.observation.geometry import SceneGeometry
from invrender.result.factorization import Factorization
from recon.sampling.lightfield import LightField

Floats = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class Solved:
    """A result with its samples.

    fields : samples of each photograph, by label. residuals : (n, 3) each, photograph less prediction. radiance : of
    samples (n, 3) in a photograph, as predicted. transfers : what Kd = 1 and Ks = 1 would show there, (n, 3) each.
    shaded : what rays of given Kd and Ks, (m, 3) each, would show, (n, 3), for many; both None where Kd doesn't vary.
    pictured : `radiance` of many samples, off by less than shows; None where that itself is quick.
    """

    result: Factorization
    fields: Mapping[str, LightField]
    residuals: Mapping[str, Floats]
    radiance: Callable[[Photo, LightField], Floats]
    transfers: Callable[[Photo, LightField], tuple[Floats, Floats]] | None = None
    shaded: Callable[[Photo, LightField, Floats, Floats], Floats] | None = None
    pictured: Callable[[Photo, LightField], Floats] | None = None


def factorization(
    photoset: PhotoSet,
    geometry: SceneGeometry,
    solution: Solution,
    fields: Mapping[str, LightField],
    residuals: Mapping[str, Floats],
    warnings: Sequence[str],
    scored: Sequence[FittedLighting] = (),
) -> Factorization:
    """The result of a set from the solution of its fitted photographs; scored : lightings of held-out ones only."""
    return Factorization(
        name=photoset.name,
        gauge=solution.gauge,
        object=geometry.description,
        brdf=solution.estimate.brdf,
        quantities=solution.quantities,
        lightings=(*solution.lightings, *scored),
        candidates=solution.candidates,
        chosen=solution.chosen,
        photos=_scores(photoset, solution, fields, residuals),
        noise_floor=solution.noise.floor,
        noise_relative=solution.noise.relative,
        structured=solution.structured,
        covariance=solution.covariance,
        covariance_names=solution.covariance_names,
        warnings=tuple(warnings),
    )


def _scores(
    photoset: PhotoSet,
    solution: Solution,
    fields: Mapping[str, LightField],
    residuals: Mapping[str, Floats],
) -> tuple[PhotoScore, ...]:
    """How well each photograph of a set is explained."""
    scores = []
    unseen = iter(solution.candidates[solution.chosen].photo_errors)
    weights = iter(solution.weights)
    for photo in photoset.photos:
        field, residual = fields[photo.label], residuals[photo.label]
        trust = field.shares[:, None] * (1.0 if photo.held_out else next(weights).trust)
        scores.append(
            PhotoScore(
                label=photo.label,
                lighting=photo.lighting,
                held_out=photo.held_out,
                samples=len(field),
                rms=relative_rms(residual, field.radiance, trust),
                cross_validated=None if photo.held_out else float(next(unseen)),
            )
        )
    return tuple(scores)
