"""Clusters of samples whose residuals are correlated: tiles of a photograph, patches of the surface."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray
from scipy.special import chdtri

from recon.sampling.highlights import small_highlights, tile_numbers
from recon.sampling.lightfield import LightField

Floats = NDArray[np.float64]

_TILES_ACROSS = 6
_PATCHES_PER_UNIT = 3
# Highlights that a model misses by both signs show in small tiles only.
_SAMPLES_PER_TILE, _MOST_ACROSS = 20, 24
# Of the brightest highlight, what is none any more.
_FAINT = 1e-6
# Median absolute value of unit normal noise, and its relative standard deviation from one sample.
_MEDIAN_OF_NORMAL, _MEDIAN_STD = 0.6745, 1.166


def tile_of(field: LightField, across: int = _TILES_ACROSS) -> NDArray[np.int64]:
    """A number (n,) for each sample's tile of its photograph: a sixth of the object's width square, or another part."""
    return tile_numbers(field.rows, field.columns, across)


def tiles_of(photos: Sequence[LightField]) -> NDArray[np.int64]:
    """A number for each sample's tile, the photographs' one after the other, no two of which share any."""
    numbers, first = [], 0
    for photo in photos:
        numbers.append(first + np.unique(tile_of(photo), return_inverse=True)[1])
        first = int(numbers[-1].max(initial=first - 1)) + 1
    return np.concatenate(numbers)


def patch_of(field: LightField, per_unit: float = _PATCHES_PER_UNIT) -> NDArray[np.int64]:
    """A number (n,) for each sample's patch of the surface, the same in all photographs: about 20 degrees wide.

    per_unit : patches along a unit of the normal's coordinates; 2 makes them about 30 degrees wide.
    """
    cell = np.round((field.sample_normals + 1) * per_unit).astype(int)
    return cell @ np.array([10000, 100, 1])


def sums_by(numbers: NDArray[np.int64], values: Floats) -> dict[int, Floats]:
    """Sums (k,) of values (n, k), n at least 1, over the samples of each number that occurs."""
    order = np.argsort(numbers, kind="stable")
    names, first = np.unique(numbers[order], return_index=True)
    return dict(zip(names.tolist(), np.add.reduceat(values[order], first, axis=0), strict=True))


def finest_tiles(fields: Sequence[LightField]) -> int:
    """Tiles across the object, six or more, as small as still have samples enough to separate noise from what isn't."""
    samples = np.mean([len(field) for field in fields])
    return int(np.clip(np.sqrt(samples / _SAMPLES_PER_TILE), _TILES_ACROSS, _MOST_ACROSS))


def outstanding(field: LightField) -> NDArray[np.bool_]:
    """Which samples (n,) belong to small highlights (`small_highlights`)."""
    return small_highlights(field.rows, field.columns, field.radiance)


def structured_rms(
    fields: Sequence[LightField], residuals: Sequence[Floats], across: int = _TILES_ACROSS
) -> float:
    """RMS of that part of the residuals which tiles of a photograph have in common: what isn't noise.

    residuals : (n, 3) per photograph. across : tiles to the object's width. From the tiles' mean squares less what
        independent samples of a tile's own scatter would give; 0 within two standard deviations of that.
    """
    common, by_chance, variance, count = 0.0, 0.0, 0.0, 0
    for field, residual in zip(fields, residuals, strict=True):
        index = np.unique(tile_of(field, across), return_inverse=True)[1]
        size = np.bincount(index)
        several = size > 1
        for values in residual.T:
            mean = np.bincount(index, values) / size
            scatter = np.bincount(index, (values - mean[index]) ** 2)[several] / (size[several] - 1)
            common += float((size * mean**2)[several].sum())
            by_chance += float(scatter.sum())
            variance += float(2 * (scatter**2).sum())
            count += int(size[several].sum())
    # All of it where it is no chance: less what chance could be, few samples would seem better because they determine
    # less.
    beyond = common - by_chance
    return float(np.sqrt(beyond / max(count, 1))) if beyond > 2 * np.sqrt(variance) else 0.0


def structured_share(
    fields: Sequence[LightField], residuals: Sequence[Floats], across: int = _TILES_ACROSS
) -> float:
    """`structured_rms` relative to the radiance (RMS over photographs)."""
    energy = np.sqrt(np.mean([np.mean(field.radiance**2) for field in fields]))
    return structured_rms(fields, residuals, across) / max(float(energy), 1e-300)


def beyond_chance(groups: int) -> float:
    """How many times the true variance one estimated from so many groups is by chance in one number of a hundred."""
    freedom = max(groups - 1, 1)
    return float(chdtri(freedom, 0.01) / freedom)


def lobe_misfit(
    specular: Floats, predicted: Floats, residual: Floats, trust: Floats, inverse_variance: Floats
) -> float:
    """What of highlights a model leaves that isn't noise, relative to them; 0 if noise leaves nothing.

    specular, predicted, residual : (n, 3) of all samples, radiance of the lobes alone and in all, and what is left of
        it. trust, inverse_variance : (n, 3), what each counts for, and that over the noise's variance; samples that
        count for nothing are left out. The median over what is mostly highlight, each sample counting with its lobe's
        radiance, so that a few outliers don't matter; 0 within two standard deviations of the median itself.
    """
    # Far out a lobe is nothing, though it may be all that there is.
    seen = np.maximum(0.5 * predicted, _FAINT * specular.max(initial=0))
    lobe = (specular > seen) & (inverse_variance > 0)
    weight = specular[lobe]
    if not len(weight):
        return 0.0
    std = np.sqrt(trust[lobe] / inverse_variance[lobe])
    left = _weighted_median(np.abs(residual[lobe]) / weight, weight)
    by_chance = _MEDIAN_OF_NORMAL * _weighted_median(std / weight, weight)
    several = weight.sum() ** 2 / (weight**2).sum()
    if left * (1 - 2 * _MEDIAN_STD / np.sqrt(several)) <= by_chance:
        return 0.0
    return float(np.sqrt(left**2 - by_chance**2) / _MEDIAN_OF_NORMAL)


def _weighted_median(values: Floats, weights: Floats) -> float:
    order = np.argsort(values)
    total = np.cumsum(weights[order])
    return float(values[order][np.searchsorted(total, total[-1] / 2)])
