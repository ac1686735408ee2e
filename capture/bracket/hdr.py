"""Brackets to one radiance image: every photograph weighted by the inverse of its variance."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from capture.radiance import Image, RadianceImage

Floats = NDArray[np.float64]
# A photograph, its exposure divided out, and which of its numbers can be used, (h, w, 3).
Load = Callable[[int], tuple[RadianceImage, NDArray[np.bool_]]]
_SAMPLES = 40_000
_BINS = 32
_FEWEST = 30
_TELLING = 0.3
# Static pixels scatter beyond this once in a hundred thousand.
_UNLIKELY = 1e-5
_OUTLIER = 5.0
# Standard deviations above black at which a photograph shows a pixel.
_SHOWS = 3.0


@dataclass(frozen=True, eq=False)
class LevelNoise:
    """Variance of a linear signal against the signal, per channel.

    signal : (bins,) increasing, > 0. variance : (3, bins), > 0; linear in the logarithms between the bins.
    """

    signal: Floats
    variance: Floats

    def at(self, signal: NDArray[np.floating]) -> Image:
        """Variance of signals (..., 3), float32; below the first and above the last bin as there."""
        level = np.log(np.maximum(signal, self.signal[0]))
        grid = np.log(self.signal)
        channels = [np.interp(level[..., c], grid, np.log(self.variance[c])) for c in range(3)]
        return np.exp(np.stack(channels, axis=-1)).astype(np.float32)


@dataclass(frozen=True, eq=False)
class Merge:
    """A merged bracket.

    image : radiance and variance; saturated where in some channel all photographs are: the radiance there is the
        shortest exposure's, a lower bound. count : (h, w) uint16, photographs that contributed to every channel.
    longest : (h, w) float32, the longest exposure that contributed to any, 0 where none did.
    noise : what the weights come from. chi_square : (p,) mean squared difference of each photograph from the
        others, over its variance: 1 if noise is all; outliers count 25; NaN where nothing overlaps.
    deviating : (h, w) bool, where photographs differ by more than noise: what moved, or is misaligned.
    contradicted : (h, w) bool, saturated in a photograph but not in one with a longer exposure: no light does that,
        but borders of scans and moving lights do.
    factors : (p - 1,) how many times as bright each photograph is as the next shorter one, exposures divided out, in
        the median; shortest first. 1 if exposures and encoding are what they were taken for.
    """

    image: RadianceImage
    count: NDArray[np.uint16]
    longest: Image
    noise: LevelNoise
    chi_square: Floats
    deviating: NDArray[np.bool_]
    contradicted: NDArray[np.bool_]
    factors: Floats


def merge(load: Load, exposures: Sequence[float], stated: bool = False) -> Merge:
    """Merge a bracket of one scene into radiance.

    load : gives photograph j with its exposure divided out, as `capture.decode.decode` makes it, and where each
        channel is below saturation; each is loaded twice (three times for what it states), and no more than one is
        held. exposures : (p,) what was divided out.
    stated : weigh by the variances that the photographs state (a measured noise model); otherwise by the noise
        that the bracket shows where its photographs overlap, and by what they state only if they don't.

    The weight of a pixel is exposure^2 over the variance of the signal that a first, unweighted estimate predicts:
    a variance that follows the noisy pixel itself would give dark errors more weight than bright ones. Of exposures
    too short to show a pixel only the longest counts.
    """
    times = np.asarray(exposures, float)
    first = _first_pass(load, times)
    noise = (None if stated else _observed_noise(first, times)) or _stated_noise(load, first, times)
    radiance = first.radiance
    weight_sum, pull, square = (np.zeros_like(radiance) for _ in range(3))
    count = np.zeros(radiance.shape, np.uint16)
    longest = np.zeros(radiance.shape[:2], np.float32)
    for index, time in enumerate(times):
        image, valid = load(index)
        # What is saturated in a shorter exposure than one in which it isn't is no light of the scene's.
        valid = valid & ~(~valid & (first.most_valid > 1.001 * time)).any(axis=2, keepdims=True)
        signal = radiance * np.float32(time)
        variance = noise.at(signal)
        # Noise is clipped at black: exposures too short to show a pixel would make it too bright on average.
        valid = valid & ((signal > _SHOWS * np.sqrt(variance)) | (first.most_valid <= 1.001 * time))
        weight = valid * (np.float32(time**2) / variance)
        off = image.radiance - radiance
        weight_sum += weight
        pull += weight * off
        square += weight * off**2
        count += valid
        longest = np.maximum(longest, valid.any(axis=2) * np.float32(time))
    seen = weight_sum > 0
    safe = np.where(seen, weight_sum, 1)
    spread = square - pull**2 / safe
    deviating = _unlikely(spread, count)
    # Photographs that differ by more than noise leave that much more open.
    excess = np.where(deviating[..., None], np.maximum(spread / np.maximum(count - 1.0, 1), 1), 1)
    return Merge(
        image=RadianceImage(
            np.where(seen, radiance + pull / safe, radiance),
            np.where(seen, excess / safe, radiance**2).astype(np.float32),
            np.asarray(~seen.all(axis=2)),
        ),
        count=count.min(axis=2),
        longest=longest,
        noise=noise,
        chi_square=_scatter(first, times, noise),
        deviating=deviating,
        factors=_factors(first, times),
        contradicted=first.contradicted,
    )


def _scatter(first: _First, times: Floats, noise: LevelNoise) -> Floats:
    """(p,) mean squared difference of each photograph from the others' mean, over its variance, in the sample."""
    weight, off = _weighted(first, times, noise)
    others = weight.sum(axis=0) - weight
    # Against the mean of all, (1 - h) r; its variance is (1 - h) / w, h the share of the weight.
    share = others / np.maximum(others + weight, 1e-30)
    scaled = np.minimum(weight * off**2 / np.maximum(share, 1e-6), _OUTLIER**2)
    compared = (weight > 0) & (others > 0)
    counts = compared.sum(axis=(1, 2))
    return np.where(counts, (scaled * compared).sum(axis=(1, 2)) / np.maximum(counts, 1), np.nan)


def _factors(first: _First, times: Floats) -> Floats:
    order = np.argsort(times)
    factors = []
    for short, long in pairwise(order.tolist()):
        both = first.valid[short] & first.valid[long] & (first.signals[short] > 0) & (first.signals[long] > 0)
        one, other = first.signals[short][both], first.signals[long][both]
        # Bright ones: at their edge noise chooses, but few lie there.
        bright = other >= 0.5 * np.quantile(other, 0.99) if other.size else both[both]
        ratio = other[bright] / one[bright] * (times[short] / times[long])
        factors.append(float(np.median(ratio)) if ratio.size >= _FEWEST else 1.0)
    return np.array(factors)


def _weighted(first: _First, times: Floats, noise: LevelNoise) -> tuple[Floats, Floats]:
    """Weights (p, n, 3) of the sample by noise at what the mean predicts, and what each photograph is off it."""
    time = times[:, None, None]
    radiance = first.signals / time
    total = np.maximum((first.valid * time).sum(axis=0), 1e-30)
    mean = (first.valid * first.signals).sum(axis=0) / total
    for _ in range(2):
        weight = first.valid * time**2 / noise.at(mean * time)
        mean = (weight * radiance).sum(axis=0) / np.maximum(weight.sum(axis=0), 1e-30)
    return weight, radiance - mean


@dataclass(frozen=True, eq=False)
class _First:
    """What the first pass leaves.

    radiance : (h, w, 3), total signal over total exposure: the best estimate under shot noise, and its weights don't
    depend on the noise; the shortest exposure's, a lower bound, where all are saturated. exposure : (h, w, 3), the
    total. most_valid : (h, w, 3), the longest that isn't saturated. signals, valid : (p, n, 3), a sample of all
    photographs, exposure multiplied in again. stride : pixels between samples.
    """

    radiance: Image
    exposure: Image
    most_valid: Image
    contradicted: NDArray[np.bool_]
    signals: Image
    valid: NDArray[np.bool_]
    stride: int


def _first_pass(load: Load, times: Floats) -> _First:
    image, valid = load(0)
    shape = image.radiance.shape
    stride = max(1, -(-shape[0] * shape[1] // _SAMPLES))
    signal, exposure, most_valid = (np.zeros(shape, np.float32) for _ in range(3))
    least_saturated = np.full(shape, np.inf, np.float32)
    lower_bound, signals, valids = image.radiance, [], []
    for index, time in enumerate(times):
        if index:
            image, valid = load(index)
        factor = np.float32(time)
        signal += valid * image.radiance * factor
        exposure += valid * factor
        least_saturated = np.minimum(least_saturated, np.where(valid, np.float32(np.inf), factor))
        most_valid = np.maximum(most_valid, valid * factor)
        if time == times.min():
            lower_bound = image.radiance
        signals.append(image.radiance.reshape(-1, 3)[::stride] * factor)
        valids.append(valid.reshape(-1, 3)[::stride])
    return _First(
        radiance=np.where(exposure > 0, signal / np.where(exposure > 0, exposure, 1), lower_bound),
        exposure=exposure,
        most_valid=most_valid,
        contradicted=np.asarray((least_saturated < 0.999 * most_valid).any(axis=2)),
        signals=np.stack(signals),
        valid=np.stack(valids),
        stride=stride,
    )


def _observed_noise(first: _First, times: Floats) -> LevelNoise | None:
    """Variance against signal from what photographs of one pixel differ by; None if too few overlap."""
    valid = first.valid & (first.valid.sum(axis=0) > 1)
    if valid.sum() < 10 * _FEWEST:
        return None
    time = times[:, None, None]
    grid = _levels(first.signals[valid])
    # Shot noise to begin with: weights in proportion to the exposure.
    noise = LevelNoise(grid, np.repeat(grid[None], 3, axis=0) * 1e-3)
    for _ in range(4):
        weight, off = _weighted(first, times, noise)
        freedom = 1 - weight / np.maximum(weight.sum(axis=0), 1e-30)
        # Where one photograph all but decides the mean, its residual shows the others' noise, not of its own.
        telling = valid & (freedom > _TELLING)
        square = (off * time) ** 2 / np.maximum(freedom, _TELLING)
        noise = _binned(grid, first.signals - off * time, square, telling)
    return noise


def _stated_noise(load: Load, first: _First, times: Floats) -> LevelNoise:
    """Variance against signal as the photographs state it."""
    grid = _levels(first.signals)
    variances = [
        load(j)[0].variance.reshape(-1, 3)[:: first.stride] * time**2 for j, time in enumerate(times)
    ]
    # The median of what is stated, not of what scatters.
    square = np.stack(variances) * _MEDIAN_OF_SQUARE
    return _binned(grid, first.signals, square, first.valid)


# Median of the square of a standard normal number.
_MEDIAN_OF_SQUARE = 0.4549


def _levels(signals: NDArray[np.floating]) -> Floats:
    positive = signals[signals > 0]
    if not positive.size:
        return np.array([1e-6, 1.0])
    high = float(positive.max())
    return np.geomspace(max(float(np.quantile(positive, 0.001)), 1e-5 * high), high, _BINS)


def _binned(
    grid: Floats, predicted: NDArray[np.floating], square: NDArray[np.floating], telling: NDArray[np.bool_]
) -> LevelNoise:
    """Medians of squares by level: robust against what moved. Levels that are rarely seen take what lies between
    their neighbours; above the last one that is seen variance grows with the signal, as shot noise does."""
    place = np.interp(np.log(np.maximum(predicted, grid[0])), np.log(grid), np.arange(len(grid)))
    bins = np.rint(place).astype(int)
    variance = np.empty((3, len(grid)))
    for channel in range(3):
        here, values = bins[..., channel], square[..., channel]
        known = telling[..., channel]
        medians = np.full(len(grid), np.nan)
        for level in range(len(grid)):
            chosen = values[known & (here == level)]
            if len(chosen) >= _FEWEST:
                medians[level] = np.median(chosen) / _MEDIAN_OF_SQUARE
        good = np.isfinite(medians) & (medians > 0)
        if not good.any():
            pooled = values[known]
            medians[:] = max(float(pooled.mean()) if pooled.size else 0.0, 1e-12 * float(grid[-1]) ** 2)
            good[:] = True
        curve = np.exp(np.interp(np.arange(len(grid)), np.flatnonzero(good), np.log(medians[good])))
        # Near black noise is clipped and looks smaller than it is: there it counts as it is where signals show.
        ratio = grid**2 / curve
        hidden = np.flatnonzero(ratio[: int(np.argmax(ratio))] <= _SHOWS**2)
        if hidden.size:
            darkest = min(int(hidden[-1]) + 1, len(grid) - 1)
            curve[:darkest] = np.maximum(curve[:darkest], curve[darkest])
        variance[channel] = curve * np.maximum(grid / grid[good][-1], 1)
    return LevelNoise(grid, variance)


def _unlikely(spread: NDArray[np.floating], count: NDArray[np.uint16]) -> NDArray[np.bool_]:
    """Where the sum of squared residuals over their variances is larger than noise makes it, in any channel."""
    from scipy.special import chdtri

    freedom = np.arange(int(count.max()) + 1) - 1
    limit = np.where(freedom > 0, chdtri(np.maximum(freedom, 1), _UNLIKELY), np.inf)
    return np.asarray((spread > limit[count]).any(axis=2))
