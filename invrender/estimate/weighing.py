"""The noise of the photographs and what each sample counts for, from a first fit."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from invrender.brdf.microfacet import SIGMA_RANGE
from invrender.estimate.models import Estimate, Model
from invrender.estimate.noise import NoiseModel, Weights, fit_noise, photo_weights, with_misfit
from invrender.estimate.search import fit
from invrender.estimate.statistics import total_statistics
from invrender.transport.columns import PhotoColumns
from invrender.transport.predict import predict_photos

Floats = NDArray[np.float64]

_ROUNDS = 2
# How many times as wide as the lobe its flanks are looked for.
FLANKS = 3.0


def weigh(
    photos: Sequence[PhotoColumns], model: Model, current: Sequence[Weights] | None = None
) -> tuple[NoiseModel, list[Weights]]:
    """The noise and each sample's weight, from the residuals of a model; current : to begin with, if not equal ones.

    The second round is for outliers: the first fit, which trusts them all, is dragged along by them.
    """
    if current is None:
        ones = [np.ones_like(photo.radiance) for photo in photos]
        current = [
            counted(Weights(one, one), photo.field.shares) for one, photo in zip(ones, photos, strict=True)
        ]
    fitted = None
    for _ in range(_ROUNDS):
        statistics = total_statistics(photos, [w.weight for w in current])
        fitted = fit(model, statistics, fitted)
        predictions = predict_photos(photos, fitted.brdf, fitted.strengths)
        residuals = [photo.radiance - p for photo, p in zip(photos, predictions, strict=True)]
        highlights = lobe_reach(photos, fitted)
        noise = fit_noise(predictions, residuals)
        shares = [photo.field.shares for photo in photos]
        noise = with_misfit(noise, predictions, highlights, residuals, shares)
        current = [
            counted(photo_weights(noise, *of), share)
            for *of, share in zip(predictions, residuals, highlights, shares, strict=True)
        ]
    return noise, list(current)


def counted(weights: Weights, shares: Floats) -> Weights:
    """The weights of samples that count for shares (n,)."""
    return replace(weights, weight=weights.weight * shares[:, None])


def lobe_reach(photos: Sequence[PhotoColumns], estimate: Estimate) -> list[Floats]:
    """Radiance (n, 3) of the lobe in each photograph, or of one a few times as wide where that is more.

    A lobe that is too narrow leaves a highlight's flanks unexplained, which it doesn't reach itself.
    """
    brdf = replace(estimate.brdf, kd=np.zeros(3))
    if brdf.sigma is None:
        return [np.zeros_like(photo.radiance) for photo in photos]
    widest = brdf.form.ranges.get("sigma", SIGMA_RANGE)[1]
    wide = replace(brdf, sigma=min(FLANKS * brdf.sigma, widest))
    pairs = (predict_photos(photos, each, estimate.strengths) for each in (brdf, wide))
    return [np.maximum(*pair) for pair in zip(*pairs, strict=True)]
