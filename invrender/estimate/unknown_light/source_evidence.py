"""What a source must save to be worth its numbers."""

from __future__ import annotations

from collections.abc import Collection

import numpy as np

from invrender.estimate.clusters import tiles_of
from invrender.estimate.unknown_light.projection import BlindFit, predicted
from invrender.estimate.unknown_light.start import Search

# Squared residuals in noise units, per parameter and log of the count of numbers, that a source must save [Schwarz
# 1978's criterion].
PER_SOURCE = 5


def source_penalty(search: Search, fit: BlindFit, lighting: int) -> float:
    """Squared residuals that a source of a lighting must save."""
    numbers = search.only(lighting).numbers
    noise = max(fit.costs[lighting] / numbers, 1e-300) * design_effect(search, fit, [lighting])
    return float(PER_SOURCE * np.log(numbers) * noise)


def design_effect(search: Search, fit: BlindFit, lightings: Collection[int]) -> float:
    """How many residuals count as one witness, at least 1: those that are correlated over tiles of a photograph."""
    residuals, together = 0.0, 0.0
    for design, weight, rows in zip(search.designs, search.weights, fit.rows, strict=True):
        if design.lighting in lightings:
            left = np.sqrt(weight) * (design.radiance - predicted(design, fit, rows))
            residuals += float((left**2).sum())
            together += float((np.bincount(tiles_of(design.photos), left.sum(axis=1)) ** 2).sum())
    return max(together / max(residuals, 1e-300), 1.0)


def bright(search: Search, fit: BlindFit) -> BlindFit:
    """The fit without sources that would have to take light away."""
    dark = np.flatnonzero(fit.irradiances.sum(axis=1) <= 0)
    return search.fit(fit.state.without_source(dark), fit.l_max) if len(dark) else fit
