"""Clusters of samples whose residuals hang together: tiles of a photograph, patches of the surface."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from recon.lightfield import LightField

Floats = NDArray[np.float64]

_TILES_ACROSS = 6
_PATCHES_PER_UNIT = 3
# Highlights that a model misses by both signs show in small tiles only.
_SAMPLES_PER_TILE, _MOST_ACROSS = 20, 24


def tile_of(field: LightField, across: int = _TILES_ACROSS) -> NDArray[np.int64]:
    """A number (n,) for each sample's tile of its photograph: a sixth of the object's width square, or another part."""
    rows, columns = field.rows, field.columns
    side = max(int(np.ptp(rows)), int(np.ptp(columns)), 1) / across
    return ((rows - rows.min()) / side).astype(int) * 1000 + ((columns - columns.min()) / side).astype(int)


def patch_of(field: LightField) -> NDArray[np.int64]:
    """A number (n,) for each sample's patch of the surface, the same in all photographs: about 20 degrees wide."""
    cell = np.round((field.sample_normals + 1) * _PATCHES_PER_UNIT).astype(int)
    return cell @ np.array([10000, 100, 1])


def finest_tiles(fields: Sequence[LightField]) -> int:
    """Tiles across the object, six or more, as small as still have samples enough to tell noise from what isn't."""
    samples = np.mean([len(field) for field in fields])
    return int(np.clip(np.sqrt(samples / _SAMPLES_PER_TILE), _TILES_ACROSS, _MOST_ACROSS))


def structured_rms(
    fields: Sequence[LightField], residuals: Sequence[Floats], across: int = _TILES_ACROSS
) -> float:
    """RMS of that part of the residuals which tiles of a photograph have in common: what isn't noise.

    residuals : (n, 3) per photograph. across : tiles to the object's width. From the tiles' mean squares less what
        independent samples of a tile's own scatter would give, two standard deviations of it included; 0 if that
        leaves nothing.
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
    beyond = common - by_chance - 2 * np.sqrt(variance)
    return float(np.sqrt(max(beyond, 0.0) / max(count, 1)))
