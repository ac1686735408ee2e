"""Clusters of samples whose residuals hang together: tiles of a photograph, patches of the surface."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from recon.lightfield import LightField

Floats = NDArray[np.float64]

_TILES_ACROSS = 6
_PATCHES_PER_UNIT = 3


def tile_of(field: LightField) -> NDArray[np.int64]:
    """A number (n,) for each sample's tile of its photograph: a sixth of the object's width square."""
    rows, columns = field.rows, field.columns
    side = max(int(np.ptp(rows)), int(np.ptp(columns)), 1) / _TILES_ACROSS
    return ((rows - rows.min()) / side).astype(int) * 1000 + ((columns - columns.min()) / side).astype(int)


def patch_of(field: LightField) -> NDArray[np.int64]:
    """A number (n,) for each sample's patch of the surface, the same in all photographs: about 20 degrees wide."""
    cell = np.round((field.sample_normals + 1) * _PATCHES_PER_UNIT).astype(int)
    return cell @ np.array([10000, 100, 1])


def structured_rms(fields: Sequence[LightField], residuals: Sequence[Floats]) -> float:
    """RMS of that part of the residuals which tiles of a photograph have in common: what isn't noise.

    residuals : (n, 3) per photograph. From the tiles' mean squares less what independent samples would
        give by chance; 0 if that leaves nothing.
    """
    common, scatter, tiles, count = 0.0, 0.0, 0, 0
    for field, residual in zip(fields, residuals, strict=True):
        names, index = np.unique(tile_of(field), return_inverse=True)
        size = np.bincount(index)
        for values in residual.T:
            mean = np.bincount(index, values) / size
            common += float((size * mean**2).sum())
            scatter += float(((values - mean[index]) ** 2).sum())
            tiles += len(names)
            count += len(values)
    by_chance = tiles * scatter / max(count - tiles, 1)
    return float(np.sqrt(max(common - by_chance, 0.0) / max(count, 1)))
