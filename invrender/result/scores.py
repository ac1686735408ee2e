"""How well each photograph of a set is explained."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np
from numpy.typing import NDArray

from capture.photoset import PhotoSet
from invrender.estimate.evidence import relative_rms
from invrender.estimate.quantities import PhotoScore
from invrender.estimate.solution import Solution
from recon.sampling.lightfield import LightField


def photo_scores(
    photoset: PhotoSet,
    solution: Solution,
    fields: Mapping[str, LightField],
    residuals: Mapping[str, NDArray[np.float64]],
) -> tuple[PhotoScore, ...]:
    """The score of each photograph, in the set's order.

    fields, residuals : by label, samples and what the solution leaves of them, (n, 3).
    """
    scores = []
    unseen = iter(solution.model.photo_errors)
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


def mean_rms(scores: Sequence[PhotoScore], held_out: bool) -> float | None:
    """Mean over photographs of their relative RMS, or None where there are none of the kind."""
    errors = [score.rms for score in scores if score.held_out == held_out]
    return float(np.mean(errors)) if errors else None
