"""Standard deviations of everything that is reported.

Two answers are formed for each parameter and the larger is kept: the one that independent pixel noise
implies (Gauss-Newton), and the sandwich that lets residuals be correlated within clusters of samples, as
they are where the model or the object falls short. Clusters are tiles of each photograph (light, pose),
patches of surface across all photographs (stains, dents). Dark and bright samples are held against each other besides
(a black level, a curve).
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.special import ndtri, stdtrit

from invrender.brdf.fresnel import MU_RANGE
from invrender.brdf.microfacet import SIGMA_RANGE
from invrender.brdf.richer import NUMBER_RANGE
from invrender.estimate.clusters import patch_of, sums_by, tiles_of
from invrender.estimate.jacobian import Parameters, jacobians, numerical_jacobian
from invrender.estimate.linear import symmetric_pinv
from invrender.estimate.models import Estimate
from invrender.transport.columns import PhotoColumns, together
from invrender.transport.predict import predict_columns
from recon.sampling.lightfield import pools

Floats = NDArray[np.float64]

# What our own quadratures over pixels and maps leave, relative to the radiance, structured as it may be; and a share of
# Kd + Ks, mu or sigma itself, better than which none is claimed to be known. Measured on the noise-free demonstration:
# 8e-4 of mu (the outline's doing), 2e-4 of sigma and Ks, 4e-5 of Kd.
NUMERICAL, FINEST = 5e-4, 5e-5
# Areas of the surface along a unit of the normal's coordinates: wider than stains, which lie across patches.
_AREAS_PER_UNIT = 2.0
# Levels of brightness, each with as many samples.
_LEVELS = 16
# A prior that is flat between the bounds of the search; without it a parameter that the photographs do
# not touch would have an infinite variance and drag others with it.
PRIOR_STD = {
    "mu": (MU_RANGE[1] - MU_RANGE[0]) / np.sqrt(12),
    "sigma": (SIGMA_RANGE[1] - SIGMA_RANGE[0]) / np.sqrt(12),
    **{name: float(np.ptp(ends)) / np.sqrt(12) for name, ends in NUMBER_RANGE.items()},
}


@dataclass(frozen=True, eq=False)
class Uncertainty:
    """How certain reported numbers are.

    covariance : (k, k). noise : (k,), the part of its diagonal that independent pixel noise implies.
    fragility : (k,), the standard deviation that each number would have if the model
        were off by its whole radiance, independently in each cluster; times a relative accuracy of the
        model, what that accuracy allows to know.
    response : (k, p), what a score, a sum of weighted derivatives times changes of radiance, moves.
    """

    covariance: Floats
    noise: Floats
    fragility: Floats
    response: Floats


def uncertainty_of(
    report: Callable[[Floats], Floats],
    parameters: Parameters,
    estimate: Estimate,
    photos: Sequence[PhotoColumns],
    weights: Sequence[Floats],
) -> Uncertainty:
    """Uncertainty of reported numbers, `report(vector)`, which must not depend on the gauge.

    weights : (n, 3) per photo, inverse variances times what samples stand for.
    """
    size = len(parameters.vector)
    information, noisy = np.zeros((2, size, size))
    chi2, count = 0.0, 0
    by_tile: list[Floats] = []
    by_patch: dict[int, Floats] = {}
    by_area: dict[int, Floats] = {}
    by_level: dict[int, Floats] = {}
    fields = [photo.field for photo in photos]
    levels = np.quantile(
        np.concatenate([field.radiance.mean(axis=1) for field in fields]),
        np.linspace(0, 1, _LEVELS + 1)[1:-1],
    )
    for pool in pools(fields, [photo.lighting for photo in photos]):
        photo, weight = together([photos[k] for k in pool]), np.concatenate([weights[k] for k in pool])
        predicted = predict_columns(photo, estimate.brdf, estimate.strengths[photo.lighting])
        residual = photo.radiance - predicted
        # Side by side, the scores of the residuals and those of a model that is off by all its radiance.
        scores, shares = np.zeros((len(photo.field), 2 * size)), photo.field.shares[:, None]
        known = np.zeros((len(photo.field), size))
        for channel, jacobian in enumerate(jacobians(photo, parameters, estimate)):
            weighted = jacobian * weight[:, channel, None]
            information += weighted.T @ jacobian
            # A sample that stands for several has the noise of one.
            noisy += weighted.T @ (shares * jacobian)
            known += weighted * jacobian
            scores[:, :size] += weighted * residual[:, channel, None]
            scores[:, size:] += weighted * predicted[:, channel, None]
        chi2 += float((weight * residual**2).sum())
        count += residual.size
        by_tile += list(sums_by(tiles_of([fields[k] for k in pool]), scores).values())
        for patch, score in sums_by(patch_of(photo.field), scores).items():
            by_patch[patch] = by_patch.get(patch, 0) + score
        for area, score in sums_by(patch_of(photo.field, _AREAS_PER_UNIT), scores).items():
            by_area[area] = by_area.get(area, 0) + score
        level_of = np.searchsorted(levels, predicted.mean(axis=1))
        for level, sums in sums_by(level_of, np.hstack([scores[:, :size], known])).items():
            by_level[level] = by_level.get(level, 0) + sums
    prior = np.zeros(size)
    for name, std in PRIOR_STD.items():
        if name in parameters.places:
            prior[parameters.places[name]] = 1 / std**2
    reduced = chi2 / max(count - size, 1)
    inverse = symmetric_pinv(information / reduced + np.diag(prior))
    derivative = numerical_jacobian(report, parameters.vector)
    moved = derivative @ inverse
    independent = moved @ (noisy / reduced + np.diag(prior)) @ moved.T
    ratio, fragility = np.ones(len(independent)), np.zeros(len(independent))
    for clusters in map(np.array, (by_tile, list(by_area.values()))):
        # So that intervals of 1.96 deviations hold 95% where clusters are few, as Student's do.
        few = (stdtrit(max(len(clusters) - 1, 1), 0.975) / ndtri(0.975)) ** 2
        pull = few * _pull(moved / reduced, clusters[:, :size])
        ratio = np.maximum(ratio, pull / np.maximum(np.diag(independent), 1e-300))
    for clusters in map(np.array, (by_tile, list(by_patch.values()))):
        fragility = np.maximum(fragility, np.sqrt(_pull(moved / reduced, clusters[:, size:])))
    root = np.sqrt(ratio)
    covariance = independent * np.outer(root, root)
    apart = derivative @ _halves_apart(by_level, parameters, reduced)
    return Uncertainty(covariance + np.outer(apart, apart), np.diag(independent), fragility, moved / reduced)


def _pull(moved: Floats, clusters: Floats) -> Floats:
    """Variances (k,) of numbers that scores of clusters (g, p) move, each by moved @ score, independently."""
    return np.asarray(len(clusters) / max(len(clusters) - 1, 1) * ((moved @ clusters.T) ** 2).sum(axis=1))


def _halves_apart(sums: Mapping[int, Floats], parameters: Parameters, reduced: float) -> Floats:
    """Half of what Kd of dark samples differs by from that of bright ones, in the parameters' layout; 0 within chance.

    What all photographs have in common, as a wrong black level or a curve, shows between the two only. sums :
    per level of brightness, (2 p,), of weighted residuals and of weighted squares of each parameter.
    """
    result = np.zeros(len(parameters.vector))
    if len(sums) < 2:
        return result
    kd = parameters.places["kd"]
    own, known = (half[:, kd] for half in np.hsplit(np.array([sums[level] for level in sorted(sums)]), 2))
    # Halves of what is known of each channel.
    share = np.cumsum(known, axis=0) / np.maximum(known.sum(axis=0), 1e-300)
    dark = share <= np.maximum(0.5, share[0])
    values, variances = [], []
    for half in (dark, ~dark):
        total = np.maximum((known * half).sum(axis=0), 1e-300)
        values.append((own * half).sum(axis=0) / total)
        variances.append(reduced / total)
    difference = values[0] - values[1]
    beyond = difference**2 > 9 * (variances[0] + variances[1])
    result[kd] = np.where(beyond & dark.any(axis=0) & (~dark).any(axis=0), difference / 2, 0)
    return result
