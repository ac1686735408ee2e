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
from invrender.transport.columns import PhotoColumns, sample_count
from invrender.transport.predict import predict_photos
from recon.sampling.budget import by_information

Floats = NDArray[np.float64]

_ROUNDS = 2
# How many times as wide as the lobe its flanks are looked for.
FLANKS = 3.0
# Photographs with fewer samples are not worth their part; of many photographs each has fewer, down to the second.
_FEWEST, _LEAST = 20, 4


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


def some_samples(
    photos: Sequence[PhotoColumns], weights: Sequence[Weights], telling: Sequence[Floats], count: int
) -> tuple[list[PhotoColumns], list[Weights]]:
    """About so many samples of all photographs, half drawn evenly and half by what they tell, and their weights.

    telling : (n,) >= 0 of each photograph, in any unit.
    """
    part, weighed = [], []
    total = sample_count(photos)
    fewest = min(_FEWEST, max(2 * count // len(photos), _LEAST))
    for photo, own, tells in zip(photos, weights, telling, strict=True):
        size = len(photo.field)
        budget = min(size, max(int(count * size / total), fewest))
        # The same at any number of photographs, so that results don't hang on their order.
        rng = np.random.default_rng(0)
        even = np.full(size, budget / size)
        taken, stand_for = by_information(even, photo.field.shares * tells, budget, rng)
        some = photo.where(np.isin(np.arange(size), taken))
        part.append(replace(some, field=replace(some.field, stands_for=stand_for * some.field.shares)))
        weighed.append(Weights(own.trust[taken], own.weight[taken] * stand_for[:, None]))
    return part, weighed


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
