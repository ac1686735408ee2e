"""Curves of log exposure and the exposures of a bracket, fitted together to codes that all carry noise.

Every photograph's code is measured with noise, so the scene's exposure of a pixel is unknown, and no photograph is
the truth that the others are compared with. Minimised over the curve F (exposure to code), the pixels' log
exposures x_i and the corrections delta_j of the photographs' log exposures t_j is

    sum over pixels i and photographs j of (z_ij - F(x_i + t_j + delta_j))^2 / sigma(F)^2  +  roughness of g = ln F^-1,

by Gauss-Newton. To first order the residual times g' is Debevec and Malik's g(z) - ln E - ln t (1997, eq. 3); the
difference is that curve and weights are taken at the predicted code, not at the noisy one. At the noisy one the
curve of a scene with more dark pixels than bright ones comes out biased by more than its standard deviation.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray

from capture.bracket.bracketsample import BracketSample

Floats = NDArray[np.float64]
# Nominal exposures are taken to be right to this, one standard deviation of the log: rounding alone (1/60 for 1/64)
# makes 0.03, and shutters have errors of their own.
EXPOSURE_STD = 0.04
_NOISE_BINS = 20
# Noise of a code is no larger than this share of the range: what looks so is a scene that moved, or a curve that is
# still far off; and it would leave no code that noise doesn't carry into clipping.
_MOST_NOISE = 1 / 24
_ITERATIONS = 6
# Residuals beyond this many standard deviations lose weight with their square.
_OUTLIER = 4.0


class NothingComparableError(Exception):
    """By the curves and exposures so far no sample of a channel is seen well in two photographs."""


class Curve(Protocol):
    """A family of curves g(z), the log exposure that gives value z between `low` and `high`."""

    low: float
    high: float
    roughness: Floats

    @property
    def size(self) -> int: ...
    def log_exposure(self, params: Floats, values: Floats) -> Floats: ...
    def slope(self, params: Floats, values: Floats) -> Floats: ...
    def jacobian(self, params: Floats, values: Floats) -> Any: ...


@dataclass(frozen=True, eq=False)
class ChannelFit:
    """One channel's curve and noise. noise : (bins,) standard deviation of a code at evenly spaced values."""

    curve: Curve
    params: Floats
    smoothing: float
    noise: Floats

    @cached_property
    def table(self) -> tuple[Floats, Floats, Floats]:
        """Values, g and dg/dz, densely and closer together at the ends: faster to interpolate than the curve."""
        share = 0.5 - 0.5 * np.cos(np.linspace(0, np.pi, 4001))
        values = self.curve.low + (self.curve.high - self.curve.low) * share
        return values, self.curve.log_exposure(self.params, values), self.curve.slope(self.params, values)

    def noise_std(self, values: Floats) -> Floats:
        """Standard deviation of a code's value, of the values' shape."""
        centres = np.linspace(self.curve.low, self.curve.high, len(self.noise))
        return np.interp(values, centres, self.noise)

    def values_at(self, log_exposure: Floats) -> Floats:
        """F: the value that a log exposure gives; `low` or `high` beyond the curve's ends."""
        values, g, _ = self.table
        return np.interp(log_exposure, g, values)

    def is_increasing(self) -> bool:
        """Whether the curve can be inverted; it may be flat in the last hundredth at both ends."""
        values, g, _ = self.table
        rises = np.diff(g)
        margin = 0.01 * (self.curve.high - self.curve.low)
        inside = (values[:-1] > self.curve.low + margin) & (values[1:] < self.curve.high - margin)
        return bool(np.isfinite(g).all() and (rises >= 0).all() and (rises[inside] > 0).all())


@dataclass(frozen=True, eq=False)
class BracketFit:
    """Curves of the three channels, and what the exposures of the photographs are believed to be.

    log_times : (p,) believed log exposures. influence : (clusters, parameters of all channels and corrections),
    by how much each patch of the picture moved every parameter. prior_covariance : covariance of the
    parameters that roughness and prior leave. corrections : (p, m) basis of the corrections' free directions.
    """

    channels: tuple[ChannelFit, ...]
    log_times: Floats
    influence: Floats
    prior_covariance: Floats
    independent_covariance: Floats
    corrections: Floats


def correction_basis(log_times: Floats) -> Floats:
    """Orthonormal directions (p, m) in which exposures may be corrected.

    Not all together (a common factor is a scale of the scene) and not in proportion to the nominal log exposures:
    raising them and the curve to one power changes no picture, so that the span is kept as nominal.
    """
    fixed = np.stack([np.ones_like(log_times), log_times - log_times.mean()], axis=1)
    left, sizes, _ = np.linalg.svd(fixed, full_matrices=True)
    return left[:, int((sizes > 1e-9 * sizes.max()).sum()) :]


def fit_bracket(sample: BracketSample, nominal: Floats, start: Sequence[ChannelFit]) -> BracketFit:
    """Curves and corrections, fitted from `start` on, and their covariance. nominal : (p,) log exposures as given."""
    channels, log_times = fit_curves(sample, nominal, start, _ITERATIONS)
    return _with_covariance(sample, channels, log_times, correction_basis(nominal))


def fit_curves(
    sample: BracketSample, nominal: Floats, start: Sequence[ChannelFit], iterations: int
) -> tuple[tuple[ChannelFit, ...], Floats]:
    """Curves and log exposures (p,), fitted from `start` on."""
    basis = correction_basis(nominal)
    channels, log_times = tuple(start), nominal.copy()
    # Not `capture.gaussnewton`: weights and noise are renewed with each step, so that costs can't be compared.
    for _ in range(iterations):
        left = _all_residuals(sample, channels, log_times)
        system = _system(sample, channels, left, basis)
        channels = tuple(
            replace(channel, noise=_noise(channel, one, sample.step))
            for channel, one in zip(channels, left, strict=True)
        )
        channels, log_times, moved = _step(system, channels, log_times, basis, nominal)
        if moved < 1e-3:
            break
    return channels, log_times


@dataclass(frozen=True, eq=False)
class CurveResiduals:
    """One channel's samples against its curve; arrays (n, p).

    values : as predicted. slope : dg/dz there. error : observed minus predicted value. weight : inverse variance
    of error x slope; 0 where nothing can be said. leverage : share of the pixel's own exposure that this
    observation determines.
    """

    values: Floats
    slope: Floats
    error: Floats
    weight: Floats
    leverage: Floats
    x: Floats


def residuals(
    channel: ChannelFit, values: Floats, usable: NDArray[np.bool_], log_times: Floats
) -> CurveResiduals:
    """Every pixel's log exposure from all photographs, and what remains. values : (n, p)."""
    curve = channel.curve
    inner = (np.nextafter(curve.low, np.inf), np.nextafter(curve.high, -np.inf))
    predicted = np.clip(values, *inner)
    robust = usable.astype(float)
    grid, table = channel.table[0], channel.table[1] + 1j * channel.table[2]
    for iteration in range(3):
        both = np.interp(predicted, grid, table)  # one search for two numbers
        g, slope = both.real, both.imag
        std = channel.noise_std(predicted)
        weight = robust * _taper(predicted, std, curve) / (slope * std) ** 2
        weight = np.where(np.isfinite(weight), weight, 0)
        total = weight.sum(axis=1, keepdims=True)
        seen = total > 0
        log_exposure = g + slope * (values - predicted) - log_times
        if iteration:
            x = np.where(
                seen, (weight * log_exposure).sum(axis=1, keepdims=True) / np.where(seen, total, 1), 0
            )
        else:
            # One photograph in which something else stood there doesn't pull a median.
            x = _weighted_median(log_exposure, weight)
        predicted = np.clip(np.where(seen, channel.values_at(x + log_times), values), *inner)
        leverage = weight / np.where(seen, total, 1)
        error = values - predicted
        if iteration:
            scaled = np.abs(error) / (std * np.sqrt(np.maximum(1 - leverage, 0.05)))
            robust = usable * np.minimum(1, _OUTLIER / np.maximum(scaled, 1e-9)) ** 2
    weight = np.where((weight > 0).sum(axis=1, keepdims=True) > 1, weight, 0)
    slope = np.where(weight > 0, slope, 0)
    return CurveResiduals(predicted, slope, np.where(weight > 0, error, 0), weight, leverage, x)


def _weighted_median(values: Floats, weight: Floats) -> Floats:
    """Medians over the photographs, (n, 1); values and weights (n, p). Half-way between the middle two if even."""
    order = np.argsort(values, axis=1)
    values, weight = np.take_along_axis(values, order, 1), np.take_along_axis(weight, order, 1)
    share = np.cumsum(weight, axis=1) / np.maximum(weight.sum(axis=1, keepdims=True), 1e-300)
    lower = np.argmax(share >= 0.5 - 1e-9, axis=1)[:, None]
    upper = np.argmax(share > 0.5 + 1e-9, axis=1)[:, None]
    return (np.take_along_axis(values, lower, 1) + np.take_along_axis(values, upper, 1)) / 2


def _taper(values: Floats, std: Floats, curve: Curve) -> Floats:
    """1 inside, falling to 0 where noise would carry a code into clipping, judged by the predicted value."""
    inside = np.minimum(values - curve.low, curve.high - values)
    return np.clip(inside / std - 3, 0, 1)


def _all_residuals(
    sample: BracketSample, channels: Sequence[ChannelFit], log_times: Floats
) -> list[CurveResiduals]:
    return [
        residuals(channel, values, usable, log_times)
        for channel, values, usable in zip(channels, sample.values, sample.usable, strict=True)
    ]


def _noise(channel: ChannelFit, left: CurveResiduals, step: float) -> Floats:
    """Noise of a code over the values, from the residuals and what of them the fit of x_i took up."""
    # Where another observation says something too; medians, since edges and what moved are no noise.
    used = (left.weight > 0) & (left.leverage < 0.9)
    if not used.any():
        return channel.noise
    size = 1.4826 * np.abs(left.error[used]) / np.sqrt(1 - left.leverage[used])
    place = (left.values[used] - channel.curve.low) / (channel.curve.high - channel.curve.low)
    bins = np.rint(place * (_NOISE_BINS - 1)).astype(int)
    few = 50.0
    overall = float(np.median(size))
    noise = np.full(_NOISE_BINS, overall)
    for one in np.unique(bins):
        here = size[bins == one]
        noise[one] = (len(here) * np.median(here) + few * overall) / (len(here) + few)
    most = _MOST_NOISE * (channel.curve.high - channel.curve.low)
    return np.clip(noise, min(step / np.sqrt(12), most), most)


@dataclass(frozen=True, eq=False)
class _System:
    """Normal equations, matrix @ step = right, and their contributions by patch, (clusters, parameters)."""

    matrix: Floats
    right: Floats
    scores: Floats


def _system(
    sample: BracketSample,
    channels: Sequence[ChannelFit],
    residuals_of: Sequence[CurveResiduals],
    basis: Floats,
) -> _System:
    from scipy.sparse import csr_array, hstack

    sizes = [channel.curve.size for channel in channels]
    offsets = np.concatenate([[0], np.cumsum(sizes)])
    total = offsets[-1] + basis.shape[1]
    clusters = int(sample.patch.max()) + 1
    matrix, scores = np.zeros((total, total)), np.zeros((clusters, total))
    n, p = sample.values.shape[1:]
    for index, channel in enumerate(channels):
        left = residuals_of[index]
        rows = np.flatnonzero(left.weight.ravel() > 0)
        if not rows.size:
            raise NothingComparableError
        pixel, photo = np.divmod(rows, p)
        weight = left.weight.ravel()[rows]
        jacobian = csr_array(channel.curve.jacobian(channel.params, left.values.ravel()[rows]))
        design = csr_array(hstack([jacobian, csr_array(-basis[photo])]))
        weighted = design.multiply(weight[:, None]).tocsr()
        gather = csr_array((np.ones(len(rows)), (pixel, np.arange(len(rows)))), shape=(n, len(rows)))
        means = (gather @ weighted).toarray()
        sums = gather @ weight
        block = (weighted.T @ design).toarray() - means.T @ (means / np.where(sums > 0, sums, 1)[:, None])
        error = (left.slope * left.error).ravel()[rows]
        columns = np.r_[offsets[index] : offsets[index + 1], offsets[-1] : total]
        matrix[np.ix_(columns, columns)] += block
        by_patch = csr_array(
            (weight * error, (sample.patch[pixel], np.arange(len(rows)))), shape=(clusters, len(rows))
        )
        scores[:, columns] -= (by_patch @ design).toarray()
    return _System(matrix, scores.sum(axis=0), scores)


def _gauge_rows(channels: Sequence[ChannelFit], total: int) -> Floats:
    """A stiff equation per channel that keeps g where it is at the middle: the scale is free."""
    rows, offset = np.zeros((len(channels), total)), 0
    for index, channel in enumerate(channels):
        middle = np.array([(channel.curve.low + channel.curve.high) / 2])
        size = channel.curve.size
        rows[index, offset : offset + size] = channel.curve.jacobian(channel.params, middle).toarray()[0]
        offset += size
    return rows


def _penalty(channels: Sequence[ChannelFit], total: int) -> Floats:
    """What is known without the samples: smooth curves, and exposures near the nominal ones."""
    penalty, offset = np.zeros((total, total)), 0
    for channel in channels:
        part = slice(offset, offset + channel.curve.size)
        penalty[part, part] = channel.smoothing * channel.curve.roughness
        offset += channel.curve.size
    rest = np.arange(offset, total)
    penalty[rest, rest] = 1 / EXPOSURE_STD**2
    return penalty


def _step(
    system: _System, channels: Sequence[ChannelFit], log_times: Floats, basis: Floats, nominal: Floats
) -> tuple[tuple[ChannelFit, ...], Floats, float]:
    total = len(system.right)
    sizes = [channel.curve.size for channel in channels]
    offsets = np.concatenate([[0], np.cumsum(sizes)])
    now = np.concatenate([*(channel.params for channel in channels), basis.T @ (log_times - nominal)])
    penalty, gauge = _penalty(channels, total), _gauge_rows(channels, total)
    matrix = system.matrix + penalty + _stiffness(system.matrix) * gauge.T @ gauge
    step = np.linalg.solve(matrix, system.right - penalty @ now)
    moved, updated = 0.0, []
    for index, channel in enumerate(channels):
        change = step[offsets[index] : offsets[index + 1]]
        fitted = replace(channel, params=channel.params + change)
        for _ in range(8):
            if fitted.is_increasing():
                break
            change = change / 2
            fitted = replace(channel, params=channel.params + change)
        moved = max(
            moved, float(np.abs(channel.curve.jacobian(channel.params, _probe(channel)) @ change).max())
        )
        updated.append(fitted if fitted.is_increasing() else channel)
    return tuple(updated), log_times + basis @ step[offsets[-1] :], moved


def _probe(channel: ChannelFit) -> Floats:
    low, high = channel.curve.low, channel.curve.high
    return np.linspace(low + 0.1 * (high - low), high - 0.1 * (high - low), 33)


def _stiffness(matrix: Floats) -> float:
    return 10 * float(np.diag(matrix).max()) + 1.0


def _with_covariance(
    sample: BracketSample, channels: tuple[ChannelFit, ...], log_times: Floats, basis: Floats
) -> BracketFit:
    system = _system(sample, channels, _all_residuals(sample, channels, log_times), basis)
    total = len(system.right)
    penalty, gauge = _penalty(channels, total), _gauge_rows(channels, total)
    inverse = np.linalg.inv(system.matrix + penalty + _stiffness(system.matrix) * gauge.T @ gauge)
    clusters = max(len(np.unique(sample.patch)), 2)
    centred = system.scores - system.scores.mean(axis=0)
    influence = centred @ inverse * np.sqrt(clusters / (clusters - 1))
    return BracketFit(
        channels=channels,
        log_times=log_times,
        influence=influence,
        prior_covariance=inverse @ penalty @ inverse,
        independent_covariance=inverse @ system.matrix @ inverse,
        corrections=basis,
    )
