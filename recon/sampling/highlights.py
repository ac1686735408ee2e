"""Small highlights among the pixels of a photograph, found by their brightness alone."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from capture.blocks import block_means

Floats = NDArray[np.float64]
Ints = NDArray[np.int64]

# Tiles across in which small highlights are looked for, and how many neighbours distinguish them from dust.
_ACROSS, _NEAREST = 8, 4
# Highlights of more pixels than this are looked for in larger ones, which show where they are as well.
LOOKED_AT = 100_000


def tile_numbers(rows: Ints, columns: Ints, across: int) -> Ints:
    """A number (n,) for the tile of each pixel (n,), so many of which go across all pixels."""
    side = max(int(np.ptp(rows)), int(np.ptp(columns)), 1) / across
    return ((rows - rows.min()) / side).astype(int) * 1000 + ((columns - columns.min()) / side).astype(int)


def small_highlights(rows: Ints, columns: Ints, radiance: Floats) -> NDArray[np.bool_]:
    """Which pixels (n,) are much brighter than most around them, as half of the nearest are.

    rows, columns : (n,). radiance : (n, 3). Brighter than the median of the tile by half, and by six standard
    deviations of what a tile's pixels scatter. Dust stands out alone.
    """
    if len(rows) <= _NEAREST:
        return np.zeros(len(rows), bool)
    brightness = np.asarray(radiance.sum(axis=1))
    index = np.unique(tile_numbers(rows, columns, _ACROSS), return_inverse=True)[1]
    level = _medians(brightness, index)[index]
    scatter = 1.4826 * _medians(np.abs(brightness - level), index)[index]
    bright = brightness - level > np.maximum(0.5 * np.abs(level), 6 * scatter)
    places = np.stack([rows, columns], axis=-1)
    _, near = cKDTree(places).query(places[bright], list(range(2, _NEAREST + 2)))
    bright[bright] = bright[near].mean(axis=1) >= 0.5
    return np.asarray(bright)


def highlights_of(radiance: NDArray[np.floating], good: NDArray[np.bool_]) -> NDArray[np.bool_]:
    """Which pixels (h, w) are of small highlights among the good ones (h, w); radiance : (h, w, 3).

    As `small_highlights`, of larger pixels where there are very many.
    """
    side = max(int(np.ceil(np.sqrt(good.sum() / LOOKED_AT))), 1)
    shares = block_means(good.astype(np.float32), side)
    rows, columns = np.nonzero(shares >= 0.5)
    result = np.zeros(good.shape, bool)
    if not len(rows):
        return result
    sums = block_means(np.where(good[..., None], radiance, 0).astype(np.float32), side)
    found = small_highlights(rows, columns, (sums / shares[..., None].clip(0.5))[rows, columns].astype(float))
    coarse = np.zeros(shares.shape, bool)
    coarse[rows[found], columns[found]] = True
    fine = coarse.repeat(side, axis=0).repeat(side, axis=1)
    result[: len(fine), : fine.shape[1]] = fine
    return result & good


def _medians(values: Floats, index: Ints) -> Floats:
    """Median of the values (n,) of each group; index : (n,), of groups 0, 1, ..."""
    order = np.lexsort((values, index))
    ends = np.cumsum(np.bincount(index))
    return np.asarray(values[order][ends - (np.bincount(index) + 1) // 2])
