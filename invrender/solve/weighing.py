"""The noise of the photographs and what each sample counts for, from a first fit."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from invrender.model.columns import PhotoColumns
from invrender.model.predict import predict_photos
from invrender.solve.models import Model
from invrender.solve.noise import NoiseModel, Weights, fit_noise, photo_weights
from invrender.solve.search import fit
from invrender.solve.statistics import total_statistics

_ROUNDS = 2


def weigh(
    photos: Sequence[PhotoColumns], model: Model, current: Sequence[Weights] | None = None
) -> tuple[NoiseModel, list[Weights]]:
    """The noise and each sample's weight, from the residuals of a model; current : to begin with, if not equal ones.

    The second round is for outliers: the first fit, which trusts them all, is dragged along by them.
    """
    if current is None:
        current = [Weights(np.ones_like(photo.radiance), np.ones_like(photo.radiance)) for photo in photos]
    fitted = None
    for _ in range(_ROUNDS):
        statistics = total_statistics(photos, [w.weight for w in current])
        fitted = fit(model, statistics, fitted)
        predictions = predict_photos(photos, fitted.brdf, fitted.strengths)
        residuals = [photo.radiance - p for photo, p in zip(photos, predictions, strict=True)]
        noise = fit_noise(predictions, residuals)
        current = [photo_weights(noise, *pair) for pair in zip(predictions, residuals, strict=True)]
    return noise, list(current)
