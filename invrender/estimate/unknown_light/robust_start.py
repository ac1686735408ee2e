"""A robust start: a first fit that outliers among the samples don't spoil (dust, glare, a passing hand).

Least squares trusts all samples, so that few that are a hundred times as bright ruin a first fit, and with it the
search for sources. So at first a middling BRDF under light of a middling degree, which explains most of any photograph
to within a factor, is fitted over and over, each sample counting less the larger its residual (Cauchy's weights). What
highlights it misses lose their peaks, but not their flanks, by which their sources are found; fits that have these then
judge all samples anew, by what they leave of most of them.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from invrender.brdf.form import LobeForm
from invrender.brdf.lobes import RH01_FORM
from invrender.brdf.microfacet import SIGMA_RANGE
from invrender.estimate.noise import NoiseModel, Weights, fit_noise, photo_weights, with_misfit
from invrender.estimate.unknown_light.lighting_design import LightingDesign
from invrender.estimate.unknown_light.projection import BlindFit, predicted
from invrender.estimate.unknown_light.rows import rows_of, source_rows
from invrender.estimate.unknown_light.sources import SourceStarts, find_starts, likelier
from invrender.estimate.unknown_light.start import NOTHING, Search
from invrender.estimate.weighing import FLANKS

Floats = NDArray[np.float64]

_MIDDLING = replace(NOTHING, specular_share=np.full(3, 0.3), mu=1.5, sigma=0.15)
_ROUNDS = 8
# Share of a photograph's samples that are darker than what counts as its brightness: a lamp may leave most unlit.
_LEVEL = 0.8
# Residual, relative to the prediction, that a middling BRDF may leave; and the share of a photograph's brightness that
# darker predictions are taken for.
_USUAL, _DARKEST = 1.0, 0.5
# Share of a prediction within which a sample's own brightness gives its noise.
_NEAR = 0.5
# Of the brightest of a photograph's highlights, the least that shows what residuals are usual there; and how many times
# as large the largest are that pass for misfit.
_FAINT, _OUTLIERS = 0.1, 6.0
# Share of samples four times as bright as they should be at first that calls for care; and, of those that have lost
# half of their say, a third of which is a change that calls for another judgement. How many of these there may be.
_FEW, _GROSS, _HALF, _MOST_JUDGEMENTS = 0.003, 0.01, 0.5, 8


def robust_start(
    search: Search,
    l_max: int,
    in_the_dark: bool,
    noise: NoiseModel,
    form: LobeForm = RH01_FORM,
) -> tuple[Search, BlindFit, SourceStarts | None]:
    """`sources.find_starts` with the samples that it was left with: the same, unless there are outliers; these count
    for little, and the rest is weighed by an assumed noise."""
    first, trust = _middling(search, l_max or search.designs[0].l_max)
    if _distrusted(trust, _GROSS) < _FEW:
        return search, *find_starts(search, l_max, in_the_dark, form)
    search = _by_own_noise(search, first)
    fit = find_starts(search, l_max, in_the_dark, form)[0]
    for _ in range(_MOST_JUDGEMENTS):
        before, search = _distrusted(search.trust, _HALF), _by_own_noise(search, fit)
        if abs(_distrusted(search.trust, _HALF) - before) < _FEW / 3:
            break
        fit = search.fit(fit.state, fit.l_max)
    search = judged(search, fit, noise)
    found, lamps = find_starts(search, l_max, in_the_dark, form)
    return search, likelier(search, found, fit.state), lamps


def judged(search: Search, fit: BlindFit, noise: NoiseModel) -> Search:
    """Samples as a fit to some of them judges them, weighed by a noise that is not the fit's own."""
    brightness, found = _found_by(search, fit)
    weights, trust = [], []
    for design, prediction, own in zip(search.designs, brightness, found, strict=True):
        # Far from the prediction a sample's own brightness says nothing of its noise.
        low, high = np.sort([_NEAR * prediction, prediction / _NEAR], axis=0)
        level = np.clip(design.field.radiance, low, high)
        trust.append(own.trust)
        weights.append(
            own.trust * (design.field.weight * design.field.shares)[:, None] / noise.variance(level)
        )
    return replace(search, weights=weights, trust=trust)


def _by_own_noise(search: Search, fit: BlindFit) -> Search:
    """Samples as a fit judges them, weighed by what it leaves of most: so outliers don't outweigh all else."""
    found = _found_by(search, fit)[1]
    weights = [
        own.weight * (design.field.weight * design.field.shares)[:, None]
        for design, own in zip(search.designs, found, strict=True)
    ]
    return replace(search, weights=weights, trust=[own.trust for own in found])


def _found_by(search: Search, fit: BlindFit) -> tuple[list[Floats], list[Weights]]:
    """Radiance by which the noise of samples is judged under a fit, and the weights that its residuals give them."""
    predictions = [
        predicted(design, fit, rows_of(design, fit.state.under(design.lighting), fit.l_max))
        for design in search.designs
    ]
    residuals = [s.radiance - p for s, p in zip(search.designs, predictions, strict=True)]
    brightness = [s.brightness(p) for s, p in zip(search.designs, predictions, strict=True)]
    return brightness, noise_and_weights(search, fit, brightness, residuals)[1]


def noise_and_weights(
    search: Search, fit: BlindFit, predictions: Sequence[Floats], residuals: Sequence[Floats]
) -> tuple[NoiseModel, list[Weights]]:
    """The noise that a fit's residuals (n, 3) per design show, and what its samples count for by it.

    Where there are lamps only it holds the lobe's misfit: beside other light a first fit has yet to find its lobe.
    predictions : radiance (n, 3) per design by which noise is judged.
    """
    noise, highlights = fit_noise(predictions, residuals), [np.zeros_like(of) for of in residuals]
    if not fit.l_max:
        highlights = [highlight_of(design, fit) for design in search.designs]
        noise = misfit_noise(search, noise, predictions, highlights, residuals)
    return noise, weights_of(search, noise, predictions, residuals, highlights)


def highlight_of(design: LightingDesign, fit: BlindFit) -> Floats:
    """Radiance (n, 3) of the lobes of sources, or of ones a few times as wide where that is more (`lobe_reach`)."""
    state = fit.state.under(design.lighting)
    if state.sigma is None or not len(state.directions):
        return np.zeros_like(design.radiance)
    sent = fit.light[design.lighting][(fit.l_max + 1) ** 2 :]
    wide = replace(state, sigma=min(FLANKS * state.sigma, SIGMA_RANGE[1]))
    reach = [source_rows(design, each).lamps_specular @ sent for each in (state, wide)]
    return np.asarray(state.specular_share * np.maximum(*reach))


def misfit_noise(
    search: Search,
    noise: NoiseModel,
    predictions: Sequence[Floats],
    highlights: Sequence[Floats],
    residuals: Sequence[Floats],
) -> NoiseModel:
    """`noise.with_misfit` but for outliers of a highlight; all (n, 3) per design."""
    parts = []
    for design, *of in zip(search.designs, predictions, highlights, residuals, strict=True):
        for prediction, highlight, residual, share in zip(
            *map(design.split, (*of, design.field.shares)), strict=True
        ):
            parts.append((prediction, highlight, _usual(highlight, residual), share))
    return with_misfit(noise, *(list(of) for of in zip(*parts, strict=True)))


def _usual(highlight: Floats, residual: Floats) -> Floats:
    """Residuals (n, 3), cut to a few times what most of a photograph's are over its highlight."""
    lit = highlight > _FAINT * highlight.max(initial=0)
    if not lit.any():
        return residual
    most = _OUTLIERS * 1.4826 * float(np.median(np.abs(residual[lit]) / highlight[lit])) * highlight
    return np.asarray(np.clip(residual, -most, most))


def weights_of(
    search: Search,
    noise: NoiseModel,
    predictions: Sequence[Floats],
    residuals: Sequence[Floats],
    highlights: Sequence[Floats],
) -> list[Weights]:
    """`noise.photo_weights` of each design's samples, photograph by photograph."""
    weights = []
    for design, *parts in zip(search.designs, predictions, residuals, highlights, strict=True):
        own = [photo_weights(noise, *of) for of in zip(*map(design.split, parts), strict=True)]
        weights.append(
            Weights(np.concatenate([w.trust for w in own]), np.concatenate([w.weight for w in own]))
        )
    return weights


def _middling(search: Search, l_max: int) -> tuple[BlindFit, list[Floats]]:
    """A middling BRDF and the light that suits it, and how far its samples are near it."""
    levels = [_levels(design) for design in search.designs]
    trust, fits = list(search.trust), []
    for _ in range(_ROUNDS):
        even = [own / level**2 for own, level in zip(trust, levels, strict=True)]
        fits.append(replace(search, weights=even).at(_MIDDLING, l_max))
        trust = [
            _near(design.radiance, predicted(design, fits[-1], rows), level)
            for design, rows, level in zip(search.designs, fits[-1].rows, levels, strict=True)
        ]
    return fits[-1], trust


def _levels(design: LightingDesign) -> Floats:
    """Brightness (n, 1) of each sample's photograph."""
    levels = [np.quantile(np.abs(photo.radiance), _LEVEL) + 1e-300 for photo in design.photos]
    return np.repeat(levels, [len(photo) for photo in design.photos])[:, None]


def _near(radiance: Floats, prediction: Floats, level: Floats) -> Floats:
    scale = _USUAL * np.maximum(np.abs(prediction), _DARKEST * level)
    return np.asarray(1 / (1 + ((radiance - prediction) / scale) ** 2) ** 2)


def _distrusted(trusts: Sequence[Floats], trust: float) -> float:
    return float((np.concatenate(list(trusts)) < trust).mean())
