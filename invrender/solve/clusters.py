"""Clusters of samples whose residuals hang together: tiles of a photograph, patches of the surface."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from recon.lightfield import LightField

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
