"""The noise of the photographs, read off the residuals of a first fit."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import nnls

Floats = NDArray[np.float64]

_BINS = 24
# Deviations up to which a residual passes for noise.
_TRUSTED = 4.0
# Share of a prediction that its lobe makes, from which on a sample lies in a highlight.
_HIGHLIGHT = 0.2


@dataclass(frozen=True)
class NoiseModel:
    """Standard deviation of what a model leaves unexplained.

    floor, relative : of the noise, sqrt(floor^2 + (relative radiance)^2). misfit : RMS over all samples of what is left
    in highlights beyond that, for the lobe not being of the model's form. lobe : the same relative to the lobe's own
    radiance, over highlights.
    """

    floor: float
    relative: float
    misfit: float = 0.0
    lobe: float = 0.0

    def variance(self, radiance: Floats) -> Floats:
        """Variance of noise and misfit at predicted radiance (any shape), in its square.

        A misfit counts everywhere alike: what suits a wrong form best is what least squares over all pixels finds.
        """
        return np.asarray(self.floor**2 + self.misfit**2 + (self.relative * radiance) ** 2)

    def tolerated(self, radiance: Floats, highlight: Floats | float) -> Floats:
        """The same where the lobe makes `highlight` of the radiance: residuals as large are no outliers."""
        return np.asarray(self.variance(radiance) + (self.lobe * highlight) ** 2)


def fit_noise(predictions: Sequence[Floats], residuals: Sequence[Floats]) -> NoiseModel:
    """Floor and relative part from residuals (n, 3) against predictions (n, 3) of all photographs.

    Residuals are pooled in bins of equal count along the prediction, so that each brightness has its say;
    within a bin the variance is robust (1.4826 median absolute value, squared): outliers don't pass for noise.
    """
    radiance = np.concatenate([p.ravel() for p in predictions])
    error = np.concatenate([r.ravel() for r in residuals])
    order = np.array_split(np.argsort(radiance), _BINS)
    centre = np.array([np.mean(radiance[part]) for part in order if len(part)])
    spread = np.array([(1.4826 * np.median(np.abs(error[part]))) ** 2 for part in order if len(part)])
    # Relative least squares: a bin's variance is known to a share of itself.
    weight = 1 / np.maximum(spread, 1e-6 * spread.max() + 1e-300)
    solution, _ = nnls(np.stack([weight, weight * centre**2], axis=1), weight * spread)
    # Never quite zero: noise-free renderings would otherwise weigh their darkest pixels without bound.
    scale = float(np.sqrt(np.mean(radiance**2)))
    floor = max(float(np.sqrt(solution[0])), 1e-4 * scale)
    return NoiseModel(floor, float(np.sqrt(solution[1])))


@dataclass(frozen=True, eq=False)
class Weights:
    """What each sample of a photograph counts for, (n, 3) each.

    trust : 1, less for samples that lie farther from the fit than noise explains (dust, glare, a passing hand).
    weight : trust over variance.
    """

    trust: Floats
    weight: Floats


def with_misfit(
    noise: NoiseModel,
    predictions: Sequence[Floats],
    highlights: Sequence[Floats],
    residuals: Sequence[Floats],
    shares: Sequence[Floats],
) -> NoiseModel:
    """The noise with what highlights leave beyond it; 0 where chance would leave as much.

    All (n, 3) per photograph, shares (n,). Medians over photographs: what a hand or dust leaves in one of them is no
    misfit of the form, which repeats in all.
    """
    found = []
    for prediction, highlight, residual, share in zip(
        predictions, highlights, residuals, shares, strict=True
    ):
        weight = share[:, None] * (highlight > _HIGHLIGHT * np.maximum(prediction, 0))
        variance = noise.variance(prediction)
        beyond = float((weight * (residual**2 - variance)).sum())
        chance = float(np.sqrt(2 * (weight**2 * variance**2).sum()))
        energy = float((weight * highlight**2).sum())
        shown = beyond > 2 * chance and energy > 0
        found.append((beyond / (3 * share.sum()), beyond / energy) if shown else (0.0, 0.0))
    misfit, lobe = np.sqrt(np.median(found, axis=0)).tolist()
    return replace(noise, misfit=misfit, lobe=lobe)


def photo_weights(
    noise: NoiseModel, prediction: Floats, residual: Floats, highlight: Floats | float = 0.0
) -> Weights:
    """Weights of a photograph's samples from their residuals (n, 3) under a fit.

    A photograph with a wrong pose, light or mask deviates by many times the noise in most of its samples: its
    variance is larger by as much. Single samples beyond four deviations lose trust with the square of
    theirs, so that their pull fades the farther off they are. highlight : (n, 3), what the lobe makes of the
    prediction; residuals as large as highlights commonly leave are misfit of the form, and stay.
    """
    deviation = np.sqrt(noise.variance(prediction))
    typical = max(1.4826 * float(np.median(np.abs(residual) / deviation)), 1.0)
    outliers = np.abs(residual) / (np.sqrt(noise.tolerated(prediction, highlight)) * typical)
    trust = np.minimum(1, (_TRUSTED / np.maximum(outliers, _TRUSTED)) ** 2)
    return Weights(trust, trust / (deviation * typical) ** 2)
