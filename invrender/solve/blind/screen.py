"""A first answer that nonsense among the samples doesn't spoil: dust, glare, a passing hand.

Least squares trusts all samples, so that few that are a hundred times as bright ruin a first fit, and with it the
search for sources. So at first a middling BRDF under light of a middling degree, which explains most of any photograph
to within a factor, is fitted over and over, each sample counting less the farther it strayed (Cauchy's weights). What
highlights it misses lose their peaks, but not their flanks, by which their sources are found; a fit that has these then
judges all samples anew.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from invrender.solve.blind.projection import Fit, predicted
from invrender.solve.blind.sight import rows_of
from invrender.solve.blind.sources import Found, Lamps, find_starts
from invrender.solve.blind.start import NOTHING, Search
from invrender.solve.noise import NoiseModel, fit_noise, photo_weights

Floats = NDArray[np.float64]

_MIDDLING = replace(NOTHING, kappa=np.full(3, 0.3), mu=1.5, sigma=0.15)
_ROUNDS = 8
# Share of a photograph's samples that are darker than what counts as its brightness: a lamp may leave most unlit.
_LEVEL = 0.8
# Residual, relative to the prediction, that a middling BRDF may leave; and the share of a photograph's brightness that
# darker predictions are taken for.
_USUAL, _DARKEST = 1.0, 0.5
# Share of a prediction within which a sample's own brightness tells its noise.
_NEAR = 0.5
# Share of samples four times as bright as they should be at first that calls for care; and, of those that have lost
# half of their say, a third of which is a change that calls for another judgement. How many of these there may be.
_FEW, _GROSS, _HALF, _MOST_JUDGEMENTS = 0.003, 0.01, 0.5, 3


def find_among_nonsense(
    search: Search, l_max: int, in_the_dark: bool, noise: NoiseModel
) -> tuple[Search, Found, Lamps | None]:
    """`sources.find_starts` with the samples that it was left with: the same, unless some stray; then these count for
    little, and the rest is weighed by an assumed noise."""
    screened = _screened(search, l_max or search.sights[0].l_max, noise)
    if _distrusted(screened, _GROSS) < _FEW:
        return search, *find_starts(search, l_max, in_the_dark)
    fit = find_starts(screened, l_max, in_the_dark)[0].fit
    search = judged(screened, fit, noise)
    for _ in range(_MOST_JUDGEMENTS):
        fit = search.fit(fit.state, fit.l_max)
        before, search = _distrusted(search, _HALF), judged(search, fit, noise)
        if abs(_distrusted(search, _HALF) - before) < _FEW / 3:
            break
    return search, *find_starts(search, l_max, in_the_dark)


def judged(search: Search, fit: Fit, noise: NoiseModel) -> Search:
    """Samples as a fit to some of them judges them, weighed by a noise that is not the fit's own."""
    predictions = [
        predicted(sight, fit, rows_of(sight, fit.state.under(sight.lighting), fit.l_max))
        for sight in search.sights
    ]
    residuals = [s.field.radiance - p for s, p in zip(search.sights, predictions, strict=True)]
    left = fit_noise(predictions, residuals)
    trust = [photo_weights(left, *pair).trust for pair in zip(predictions, residuals, strict=True)]
    return _weighing(search, trust, predictions, noise)


def _screened(search: Search, l_max: int, noise: NoiseModel) -> Search:
    levels = [np.quantile(np.abs(sight.field.radiance), _LEVEL) + 1e-300 for sight in search.sights]
    trust, predictions = list(search.trust), []
    for _ in range(_ROUNDS):
        even = [own / level**2 for own, level in zip(trust, levels, strict=True)]
        fit = replace(search, weights=even).at(_MIDDLING, l_max)
        predictions = [
            predicted(sight, fit, rows) for sight, rows in zip(search.sights, fit.rows, strict=True)
        ]
        trust = [
            _near(sight.field.radiance, prediction, level)
            for sight, prediction, level in zip(search.sights, predictions, levels, strict=True)
        ]
    return _weighing(search, trust, predictions, noise)


def _near(radiance: Floats, prediction: Floats, level: float) -> Floats:
    scale = _USUAL * np.maximum(np.abs(prediction), _DARKEST * level)
    return np.asarray(1 / (1 + ((radiance - prediction) / scale) ** 2) ** 2)


def _distrusted(search: Search, trust: float) -> float:
    return float((np.concatenate(list(search.trust)) < trust).mean())


def _weighing(
    search: Search, trust: Sequence[Floats], predictions: Sequence[Floats], noise: NoiseModel
) -> Search:
    weights = []
    for sight, own, prediction in zip(search.sights, trust, predictions, strict=True):
        # Far from the prediction a sample's own brightness tells nothing of its noise.
        low, high = np.sort([_NEAR * prediction, prediction / _NEAR], axis=0)
        level = np.clip(sight.field.radiance, low, high)
        weights.append(own * sight.field.weight[:, None] / noise.variance(level))
    return replace(search, weights=weights, trust=trust)
