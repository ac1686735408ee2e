"""Photographs of a static scene at one exposure: what stays, what changes, and where values are clipped."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.float64]

# Photographs whose brightness differs by more than this don't form a pair: EXIF rounds, and lamps are switched.
_SAME_BRIGHTNESS = 1.1


@dataclass(frozen=True, eq=False)
class RepeatedFrame:
    """One decoded photograph.

    signal : (h, w, 3) float32, linear, 1 at the file's white level. quantisation : (h, w, 3) float32, variance.
    saturated : (h, w) bool. floor : (3,) the signal of each channel below which it isn't known what codes stand for.
    """

    signal: NDArray[np.float32]
    quantisation: NDArray[np.float32]
    saturated: NDArray[np.bool_]
    floor: Floats = field(default_factory=lambda: np.full(3, -np.inf))


class Repeats:
    """What repeated photographs of one exposure have in common: running mean and variance of each pixel.

    Each photograph is brought to the brightness of the first, for lamps drift.
    """

    def __init__(self, frame: RepeatedFrame) -> None:
        self.count = 1
        self.mean = frame.signal.astype(np.float32)
        self.squares = np.zeros_like(self.mean)
        self.quantisation = frame.quantisation * _coarseness(frame) ** 2
        self.saturated = frame.saturated.copy()
        self.floor, self.ceiling = _clipping(frame)
        self._first = frame.signal
        self._inverse_gains = 1.0

    def gain_of(self, frame: RepeatedFrame) -> float:
        """Brightness of another photograph of this scene relative to the first, 0 if nothing can be compared."""
        return _relative_gain(self._first, frame.signal, ~(self.saturated | frame.saturated))

    @property
    def brightness(self) -> float:
        """Harmonic mean of the gains: shot noise belongs to this brightness, not to that of the first photograph.

        Divided by gain g, the variance shot * g * signal becomes shot * signal / g.
        """
        return self.count / self._inverse_gains

    def matches(self, gain: float) -> bool:
        """Whether a photograph of this gain may be a repetition."""
        return 1 / _SAME_BRIGHTNESS < gain < _SAME_BRIGHTNESS

    def add(self, frame: RepeatedFrame, gain: float) -> None:
        """Welford's update."""
        self.count += 1
        self._inverse_gains += 1 / gain
        step = frame.signal / np.float32(gain) - self.mean
        self.mean += step / self.count
        self.squares += step**2 * np.float32((self.count - 1) / self.count)
        self.saturated |= frame.saturated


def _relative_gain(
    first: NDArray[np.float32], other: NDArray[np.float32], usable: NDArray[np.bool_]
) -> float:
    """How much brighter a photograph is, by sums over what hasn't moved: a ratio of medians would stick to codes."""
    one, two = first[usable].ravel(), other[usable].ravel()
    bright = one > np.median(one) if one.size else np.zeros(0, bool)
    one, two = one[bright].astype(float), two[bright].astype(float)
    if not one.sum() > 0:
        return 0.0
    gain = float(np.median(two / one))
    for _ in range(4):
        deviation = np.abs(two - gain * one)
        still = deviation <= 4 * 1.4826 * np.median(deviation) + 1e-3 * one
        gain = float(two[still].sum() / one[still].sum())
    return gain


def _clipping(frame: RepeatedFrame) -> tuple[Floats, Floats]:
    """The signals (3,), (3,) at which each channel is clipped, infinite where it isn't.

    Values pile up there, or the lowest is exactly black: a file that holds no values below it cuts noise off, however
    few pixels reach it. RAW goes below black.
    """
    floor, ceiling = frame.floor.copy(), np.full(3, np.inf)
    for channel in range(3):
        values = frame.signal[..., channel]
        low, high = values.min(), values.max()
        if low == 0 or _piles_up(values, low, np.min(values, where=values > low, initial=np.inf)):
            floor[channel] = max(floor[channel], low)
        if _piles_up(values, high, np.max(values, where=values < high, initial=-np.inf)):
            ceiling[channel] = high
    return floor, ceiling


def _piles_up(values: NDArray[np.float32], end: np.floating, next_to_it: np.floating) -> bool:
    """Whether a histogram ends abruptly: one that runs out smoothly falls faster than by half where it counts 20."""
    at_end = np.count_nonzero(values == end)
    return bool(at_end > 20 and 2 * at_end > np.count_nonzero(values == next_to_it))


def _coarseness(frame: RepeatedFrame) -> float:
    """How many of its file's steps the photograph's codes are apart: 16 where 12 bits were put into 16."""
    signal, step = frame.signal[::2, ::2].ravel(), np.sqrt(12 * frame.quantisation[::2, ::2]).ravel()
    order = np.argsort(signal, kind="stable")
    gaps, steps = np.diff(signal[order]), (step[order][1:] + step[order][:-1]) / 2
    apart = (gaps > 0) & (steps > 0)
    if apart.sum() < 100:
        return 1.0
    ratio = float(np.percentile(gaps[apart] / steps[apart], 1))
    return ratio if ratio > 1.5 else 1.0
