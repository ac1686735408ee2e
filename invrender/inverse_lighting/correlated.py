"""Residuals that are correlated, and by how much they widen what is said of lighting coefficients."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from invrender.brdf.microfacet import Microfacet
from invrender.estimate.clusters import tile_of
from invrender.transport.harmonic_rows import PhotoRows, mirrored_views
from recon.harmonics.basis import degree_of

Floats = NDArray[np.float64]

# Patches of mirrored directions, about 20 degrees wide, as cells of a cube.
_PATCHES_ACROSS = 7
_PATCHES = _PATCHES_ACROSS**3


def cluster_shifts(
    photos: Sequence[PhotoRows],
    weights: Sequence[Floats],
    residuals: Sequence[Floats],
    brdf: Microfacet,
    channel: int,
    covariance: Floats,
) -> list[Floats]:
    """By how much clusters of residuals pull the coefficients, (clusters, k): tiles, and patches of mirrored light.

    What poses, shape and stains leave is correlated within tiles of a photograph; what the light leaves that isn't in
    the model, in all photographs that show the same direction.
    """
    degree = degree_of(len(covariance))
    tiles, patches = [], np.zeros((_PATCHES, len(covariance)))
    for photo, weight, residual in zip(photos, weights, residuals, strict=True):
        pulls = photo.of_channel(brdf, channel, degree) * (weight * residual)[:, channel, None]
        tiles.append(_sums(np.unique(tile_of(photo.field), return_inverse=True)[1], pulls))
        cell = np.round((mirrored_views(photo.field) + 1) * (_PATCHES_ACROSS - 1) / 2).astype(int)
        patch = cell @ _PATCHES_ACROSS ** np.arange(3)
        named, index = np.unique(patch, return_inverse=True)
        patches[named] += _sums(index, pulls)
    return [np.concatenate(tiles) @ covariance, patches[patches.any(axis=1)] @ covariance]


def _sums(index: NDArray[np.int64], values: Floats) -> Floats:
    """Sums (clusters, k) of values (n, k) by the cluster of each, every one of which occurs."""
    order = np.argsort(index, kind="stable")
    starts = np.searchsorted(index[order], np.arange(index.max() + 1))
    return np.asarray(np.add.reduceat(values[order], starts, axis=0))


def shift_without(mean: Floats, covariance: Floats, first: int) -> Floats:
    """By how much a posterior's mean (k,) would move if the unknowns from `first` on were known to be 0, (k,)."""
    if not covariance[first:, first:].any():
        return np.zeros_like(mean)
    return np.asarray(covariance[:, first:] @ np.linalg.solve(covariance[first:, first:], mean[first:]))


def widening_of(covariance: Floats, clusters: Sequence[Floats], priors: Floats) -> Floats:
    """Factors (k,), >= 1, that raise deviations to those of clusters' pulls (clusters, k), up to the prior's (k,)."""
    std = np.sqrt(np.diagonal(covariance))
    by_clusters = np.sqrt(np.max([(pull**2).sum(axis=0) for pull in clusters], axis=0))
    # A prior of 0 leaves no room at all.
    return np.asarray(np.maximum(np.minimum(by_clusters, priors) / np.where(std > 0, std, np.inf), 1.0))
