"""Photon transfer: read and shot noise from repeated photographs of a static scene.

Between photographs of one exposure only the noise changes, so that its variance can be read off each pixel and set
against the signal (Janesick, Photon Transfer, 2007; EMVA 1288 release 3.1, section 2). Pixels are taken in small
tiles: variance is affine in signal, so the means over any set of pixels lie on the same line, whatever the scene.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from capture.arrays import frozen_view
from capture.blocks import blocks
from capture.sensor.repeats import Repeats

Floats = NDArray[np.float64]

_TILE = 8
# A tile counts if its darkest and brightest parts are this many deviations of the noise away from clipping.
_CLEARANCE = 3.5
# Below this share of a code's step, noise is seen through the steps only and no formula brings it back.
_LEAST_DITHER = 0.2
_FEWEST_TILES = 40
# What rounding adds is known to this share: the means don't lie quite evenly within the steps.
_ROUNDING_DOUBT = 0.01


@dataclass(frozen=True, eq=False)
class Tiles:
    """Means over tiles of one channel: signal, temporal variance, quantisation variance; (n,) float64 each.

    variance_std : its standard deviation relative to the noise's variance. clearance : (n,) distance of the tile's
    darkest and brightest parts from clipping, in units of the signal.
    """

    signal: Floats
    variance: Floats
    quantisation: Floats
    variance_std: Floats
    clearance: Floats

    def __post_init__(self) -> None:
        for name in ("signal", "variance", "quantisation", "variance_std", "clearance"):
            object.__setattr__(self, name, frozen_view(getattr(self, name), np.float64))

    def __getitem__(self, chosen: NDArray[np.generic]) -> Tiles:
        return Tiles(
            self.signal[chosen],
            self.variance[chosen],
            self.quantisation[chosen],
            self.variance_std[chosen],
            self.clearance[chosen],
        )


@dataclass(frozen=True, eq=False)
class TransferFit:
    """variance = offset + slope * signal, quantisation taken out.

    covariance : (2, 2) of (offset, slope). tiles : those that were used. moved_share : of all tiles that might have
    been used, those that changed by more than noise.
    """

    offset: float
    slope: float
    covariance: Floats
    tiles: Tiles
    moved_share: float


def tiles_of(repeats: Repeats, channel: int) -> Tiles:
    """The tiles of a channel, 8 pixels square, saturated ones left out."""
    brightness = np.float32(repeats.brightness)
    mean = _cut(repeats.mean[..., channel]) * brightness
    variance = _cut(repeats.squares[..., channel]) * (brightness**2 / (repeats.count - 1))
    whole = ~_cut(repeats.saturated).any(axis=1)
    mean, variance = mean[whole], variance[whole]
    # A lone pixel that flickers (a cosmic ray, a hot pixel) must not speak for its tile: it is 63 to 1.
    typical = np.median(variance, axis=1, keepdims=True) + variance.mean(axis=1, keepdims=True) / 4
    calm = variance <= 60 * typical
    signal = mean.mean(axis=1, dtype=float)
    # Not less the tile's own noise: of the darkest tiles those would count whose noise came out high.
    noise = _alike(signal, variance.mean(axis=1, dtype=float))
    texture = np.sqrt(np.maximum(mean.var(axis=1, dtype=float) - noise / repeats.count, 0))
    above = signal - 2 * texture - repeats.floor[channel]
    below = repeats.ceiling[channel] - signal - 2 * texture
    counted = calm.sum(axis=1)
    return Tiles(
        signal=np.where(calm, mean, 0).sum(axis=1, dtype=float) / counted,
        variance=np.where(calm, variance, 0).sum(axis=1, dtype=float) / counted,
        quantisation=_cut(repeats.quantisation[..., channel])[whole].mean(axis=1, dtype=float),
        variance_std=np.sqrt(2 / (counted * (repeats.count - 1))),
        clearance=np.minimum(above, below),
    )


def _alike(signal: Floats, variance: Floats) -> Floats:
    """The median variance (n,) of the tiles next to each in signal."""
    from scipy.ndimage import median_filter

    order = np.argsort(signal)
    result = np.empty_like(variance)
    result[order] = median_filter(variance[order], size=min(51, max(len(order), 1)), mode="nearest")
    return result


def fit_transfer(tiles: Sequence[Tiles]) -> TransferFit:
    """The line through the tiles of one channel, from all exposures.

    Weights are those of chi-squared variances at the model's own value (weights by the measured variance would
    favour the tiles that came out low). ValueError if too few tiles are left, or if most of the scene moved.
    """
    joined = Tiles(
        *(np.concatenate([getattr(part, name) for part in tiles]) for name in Tiles.__dataclass_fields__)
    )
    start = _robust_line(joined)
    expected = seen_variance(np.maximum(start[0] + start[1] * joined.signal, 0), joined.quantisation)
    clear = joined.clearance > _CLEARANCE * np.sqrt(expected)
    if clear.sum() < _FEWEST_TILES:
        raise ValueError(
            f"only {int(clear.sum())} tiles of 8x8 pixels are neither saturated nor clipped to black;"
            f" at least {_FEWEST_TILES} are needed: change the exposure"
        )
    used, expected = joined[clear], expected[clear]
    steady = used.variance < expected * (1 + 5 * used.variance_std)
    moved = 1 - float(steady.mean())
    if moved > 0.5:
        raise ValueError(
            f"{moved:.0%} of the scene changes by more than noise between the photographs;"
            " fix the camera (tripod, remote release) and photograph a scene in which nothing moves"
        )
    used = used[steady]
    line, visible = start, np.ones(len(used.signal), bool)
    for _ in range(20):
        noise = np.maximum(line[0] + line[1] * used.signal, 1e-3 * used.quantisation + 1e-30)
        seen = seen_variance(noise, used.quantisation)
        visible = noise > 12 * used.quantisation * _LEAST_DITHER**2
        if visible.sum() < _FEWEST_TILES:
            break
        slope = _seen_slope(noise, used.quantisation)
        # Linearised about the last line, as in a generalised linear model.
        working = noise + (used.variance - seen) / slope
        weight = slope / (seen * used.variance_std)
        residual = np.abs(used.variance - seen) / (seen * used.variance_std)
        weight = np.where(visible, weight * np.minimum(1, np.sqrt(4 / np.maximum(residual, 1e-9))), 0)
        design = np.column_stack([np.ones_like(noise), used.signal]) * weight[:, None]
        update, *_ = np.linalg.lstsq(design, working * weight, rcond=None)
        if np.allclose(update, line, rtol=1e-9, atol=0):
            break
        line = update
    if visible.sum() < _FEWEST_TILES:
        return TransferFit(0.0, 0.0, np.full((2, 2), np.inf), used, moved)
    used = used[visible]
    return TransferFit(float(line[0]), float(line[1]), _covariance(line, used), used, moved)


def binned(fit: TransferFit, count: int = 30) -> tuple[Floats, Floats, Floats]:
    """Signal, variance without quantisation, and its standard deviation, averaged over bins of signal, for plots."""
    tiles = fit.tiles
    noise = np.maximum(fit.offset + fit.slope * tiles.signal, 1e-30)
    seen = seen_variance(noise, tiles.quantisation)
    working = noise + (tiles.variance - seen) / _seen_slope(noise, tiles.quantisation)
    std = seen * tiles.variance_std / _seen_slope(noise, tiles.quantisation)
    index = _bins(tiles.signal, count)
    size = np.bincount(index)
    kept = size > 0
    mean = np.bincount(index, tiles.signal)[kept] / size[kept]
    variance = np.bincount(index, working)[kept] / size[kept]
    return mean, variance, np.sqrt(np.bincount(index, std**2)[kept]) / size[kept]


def _covariance(line: Floats, tiles: Tiles) -> Floats:
    noise = np.maximum(line[0] + line[1] * tiles.signal, 1e-30)
    seen = seen_variance(noise, tiles.quantisation)
    slope = _seen_slope(noise, tiles.quantisation)
    weight = slope / (seen * tiles.variance_std)
    design = np.column_stack([np.ones_like(noise), tiles.signal]) * weight[:, None]
    deviation = (tiles.variance - seen) / (seen * tiles.variance_std)
    # Noise that is correlated within tiles scatters them more than counted; a line that isn't one, whole bins.
    index = _bins(tiles.signal, 30)
    size = np.bincount(index)
    bins = (np.bincount(index, deviation)[size > 0] ** 2) / size[size > 0]
    scale = max(1.0, float(np.mean(np.minimum(deviation**2, 25))))
    if len(bins) > 4:
        scale = max(scale, float(bins.sum() / (len(bins) - 2)))
    covariance = np.linalg.pinv(design.T @ design) * scale
    dark = tiles.signal <= np.quantile(tiles.signal, 0.1)
    covariance[0, 0] += (_ROUNDING_DOUBT * float(tiles.quantisation[dark].mean())) ** 2
    return np.asarray(covariance)


def _bins(signal: Floats, count: int) -> NDArray[np.intp]:
    """Bins even in the square root of the signal, in which the shot noise is even."""
    root = np.sqrt(np.maximum(signal, 0))
    edges = np.linspace(root.min(), root.max(), count + 1)[1:-1]
    return np.digitize(root, edges)


def _robust_line(tiles: Tiles) -> Floats:
    """A first line by least absolute deviations, through medians over bins: a moving minority doesn't matter."""
    index = _bins(tiles.signal, 24)
    rows = [index == number for number in np.unique(index)]
    rows = [row for row in rows if row.sum() >= 5] or [np.ones(len(index), bool)]
    signal = np.array([np.median(tiles.signal[row]) for row in rows])
    variance = np.array([np.median(np.maximum(tiles.variance - tiles.quantisation, 0)[row]) for row in rows])
    size = np.sqrt([row.sum() for row in rows])
    floor = max(float(np.median(variance)), 1e-30)
    line = np.array([np.median(variance), 0.0])
    for _ in range(50):
        model = np.maximum(line[0] + line[1] * signal, 0.05 * floor)
        relative = np.abs(variance - model) / model
        weight = np.sqrt(size / np.maximum(relative, 0.02)) / model
        design = np.column_stack([np.ones_like(signal), signal]) * weight[:, None]
        line, *_ = np.linalg.lstsq(design, variance * weight, rcond=None)
    return np.asarray(line)


def seen_variance(noise: Floats, quantisation: Floats) -> Floats:
    """Temporal variance after rounding to steps, for noise of the given variance; quantisation = step^2 / 12.

    Rounding adds step^2 / 12, but the part of it that stays the same from photograph to photograph isn't seen:
    averaged over the place of the mean within a step, sum over k of exp(-(2 pi k noise / step)^2) / (2 pi^2 k^2)
    (Widrow and Kollar, Quantization Noise, 2008: the Fourier series of the rounding error under Gaussian noise).
    """
    steps = 12 * np.maximum(quantisation, 1e-30)
    harmonic = np.arange(1, 9)[:, None]
    still = (np.exp(-((2 * np.pi * harmonic) ** 2) * noise / steps) / (2 * np.pi**2 * harmonic**2)).sum(
        axis=0
    )
    return np.asarray(noise + quantisation - still * steps)


def _seen_slope(noise: Floats, quantisation: Floats) -> Floats:
    """Derivative of `seen_variance` by the noise."""
    steps = 12 * np.maximum(quantisation, 1e-30)
    harmonic = np.arange(1, 9)[:, None]
    return np.asarray(1 + 2 * np.exp(-((2 * np.pi * harmonic) ** 2) * noise / steps).sum(axis=0))


def _cut(image: NDArray[Any]) -> NDArray[Any]:
    """(n, 64): the pixels of each whole tile."""
    return blocks(image, _TILE).swapaxes(1, 2).reshape(-1, _TILE * _TILE)
