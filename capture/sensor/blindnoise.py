"""Noise read off a single photograph, for files whose sensor nobody has measured.

Where the scene is smooth, what a high-pass filter leaves is noise; its variance against the brightness there gives
read and shot noise (after Foi, Trimeche, Katkovnik and Egiazarian, "Practical Poissonian-Gaussian noise modeling
and fitting for single-image raw-data", 2008). Smooth places are chosen by what a low-pass filter sees: for white
noise that says nothing of the high-pass, so that choosing doesn't bias.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.float64]
Places = NDArray[np.intp]
# Linear values of pixels and the distance of neighbouring codes there, by their rows and columns.
Picked = Callable[[Places, Places], tuple[NDArray[np.floating], NDArray[np.floating]]]

_BLOCK = 8
# Blocks looked at: enough for a tenth on each number, and done in milliseconds whatever the size.
_MOST_BLOCKS = 3072
_FEWEST_BLOCKS = 24
# Share of the blocks of one brightness that count as smooth.
_SMOOTHEST = 0.1


def noise_line(shape: tuple[int, ...], picked: Picked) -> tuple[Floats, Floats]:
    """Variance in the dark (c,) and variance per unit signal (c,), both >= 0, of one photograph's noise.

    shape : (h, w, c), or (h, w) of a Bayer mosaic, whose photosites all count as of one kind: c = 1. picked : gives the
        values (n, size, size, c), or (n, size, size), of a few blocks of pixels, and the steps between codes there, in
        the same unit: the variance of rounding to them, step^2 / 12, is taken out, never more than there is.
    ValueError if too little of the photograph is neither saturated nor black.
    """
    mosaic = len(shape) == 2
    blocks, steps = picked(*_places(shape, 2 * _BLOCK if mosaic else _BLOCK))
    if mosaic:
        # The four cells of the filter's pattern apart: differences are between photosites of one colour.
        cells = [np.s_[:, row::2, column::2] for row, column in np.ndindex(2, 2)]
        blocks = np.concatenate([blocks[cell] for cell in cells])[..., None]
        steps = np.concatenate([steps[cell] for cell in cells])[..., None]
    rounding = (steps**2).mean(axis=(1, 2)) / 12
    lines = [_fit(np.ascontiguousarray(blocks[..., c]), rounding[:, c]) for c in range(blocks.shape[3])]
    offsets, slopes = zip(*lines, strict=True)
    return np.array(offsets), np.array(slopes)


def _places(shape: tuple[int, ...], size: int) -> tuple[Places, Places]:
    """Row and column indices (n, size, size) of blocks spread evenly, beginning at even pixels."""
    height, width = shape[:2]
    if height < size or width < size:
        raise ValueError(f"the photograph is {width}x{height}; noise is read off blocks of {size} pixels")
    down = min(height // size, max(int(np.sqrt(_MOST_BLOCKS * height / width)), 1))
    across = min(width // size, max(_MOST_BLOCKS // down, 1))
    tops = (np.linspace(0, height - size, down) // 2 * 2).astype(int)
    lefts = (np.linspace(0, width - size, across) // 2 * 2).astype(int)
    top, left = (corner.ravel()[:, None, None] for corner in np.meshgrid(tops, lefts, indexing="ij"))
    within = np.arange(size)
    return top + within[:, None], left + within


def _fit(blocks: NDArray[np.floating], quantisation: Floats) -> tuple[float, float]:
    """(read variance, shot) of one channel from its blocks (n, 8, 8)."""
    low, high = blocks.min(), blocks.max()
    # Where values are cut off there is less noise than light: leave out blocks that touch an end.
    clipped = (blocks >= high - 0.01 * (high - low)).any(axis=(1, 2)) | (
        (blocks <= max(low, 0)).mean(axis=(1, 2)) > 0.02
    )
    blocks, quantisation = blocks[~clipped], quantisation[~clipped]
    if len(blocks) < _FEWEST_BLOCKS:
        raise ValueError(
            f"only {len(blocks)} blocks of the photograph are neither saturated nor black; noise is read off at"
            f" least {_FEWEST_BLOCKS}: give a measured noise model"
        )
    level, roughness, variance = _moments(blocks)
    points = []
    order = np.argsort(level)
    for part in np.array_split(order, int(np.clip(len(order) // 100, 1, 24))):
        count = max(int(np.ceil(_SMOOTHEST * len(part))), min(8, len(part)))
        smooth = part[np.argsort(roughness[part])[:count]]
        points.append((level[smooth].mean(), np.median(variance[smooth]), quantisation[smooth].mean()))
    signal, seen, rounding = np.array(points).T
    return _lower_line(np.maximum(signal, 0), np.maximum(seen - rounding, 0), seen + rounding)


def _moments(blocks: NDArray[np.floating]) -> tuple[Floats, Floats, Floats]:
    """Mean, roughness by the low-pass, and noise variance by the high-pass of each block, (n,) each."""
    level = blocks.mean(axis=(1, 2), dtype=float)
    across = blocks[:, :, :-2] - 2 * blocks[:, :, 1:-1] + blocks[:, :, 2:]
    # Immerkaer (1996): blind to planes, its squares sum to 36 before the division.
    high = (across[:, :-2] - 2 * across[:, 1:-1] + across[:, 2:]) / 6
    # The median of chi-squared with the 12 degrees of freedom that the 36 overlapping masks amount to.
    variance = (high.astype(float) ** 2).mean(axis=(1, 2)) / (1 - 2 / (9 * 12)) ** 3
    small = blocks.reshape(len(blocks), _BLOCK // 2, 2, _BLOCK // 2, 2).mean(axis=(2, 4), dtype=float)
    return level, small.var(axis=(1, 2)), variance


def _lower_line(signal: Floats, variance: Floats, scale: Floats) -> tuple[float, float]:
    """(offset, slope) >= 0 of a line along the lower side of the points: texture only ever adds."""
    from scipy.optimize import nnls

    weight = 1 / np.maximum(scale, 1e-30)
    offset = slope = 0.0
    for _ in range(12):
        root = np.sqrt(weight)
        norm = max(float(signal.max()), 1e-30)
        solution, _ = nnls(np.column_stack([root, root * signal / norm]), root * variance)
        offset, slope = float(solution[0]), float(solution[1] / norm)
        model = np.maximum(offset + slope * signal, 0.02 * scale + 1e-30)
        relative = (variance - model) / model
        weight = 1 / model**2 / (1 + (np.maximum(relative, 0) / 0.3) ** 2)
    return offset, slope
