"""Two published ways to recover a response, and which of them predicts what it hasn't seen."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from capture import selection
from capture.bracket.bracketsample import BracketSample
from capture.bracket.debevec import LogExposureSpline, solve_debevec
from capture.bracket.mitsunaga import ORDERS, ExposurePolynomial
from capture.bracket.responsefit import ChannelFit, fit_curves, residuals

Floats = NDArray[np.float64]
# From the stiffest curve that is tried to the most flexible.
_SMOOTHING = 10.0 ** np.arange(5, 1.75, -0.5)
# One in so many patches of the picture is kept out of the fits that are compared.
_HELD_OUT = 5
_START_NOISE = 1 / 255
# What moved is looked for by curves of these smoothings, one after the other: off by so many standard deviations.
_ROUGH = (1e5, 3e3)
_MOVED = 5.0
# A prediction better by less than this share is no reason for a less smooth curve: exposures a constant ratio apart
# leave waves of that period in it all but free, and they grow where nothing holds them.
_NEGLIGIBLE = 0.002
# Each trial begins where the one before ended.
_TRIAL_ITERATIONS = 3


@dataclass(frozen=True, eq=False)
class MethodScore:
    """How one method did. residual : mean absolute error of codes predicted in the patches kept out, in 1/255."""

    name: str
    residual: float
    detail: str


@dataclass(frozen=True, eq=False)
class CandidateResponse:
    """A method's curves of the training patches. errors : (patches,), the residual's parts from patches kept out."""

    method: MethodScore
    channels: tuple[ChannelFit, ...]
    errors: Floats


def as_good(one: CandidateResponse, best: CandidateResponse) -> bool:
    """Whether the prediction is no worse than the best by more than two standard errors over patches, or by 1%."""
    return selection.as_good(one.errors, best.errors, 2.0, 0.01 * float(best.errors.mean()))


def candidates(sample: BracketSample, nominal: Floats) -> list[CandidateResponse]:
    """The methods' curves, best first, and only those that predict as well as the best count further on.

    nominal : (p,) log exposures as given. Fitted to four fifths of the patches, judged on the rest.
    """
    held = sample.patch % _HELD_OUT == 0
    if not held.any() or held.all():
        held = np.arange(len(sample.patch)) % _HELD_OUT == 0
    training, test = sample.part(~held), sample.part(held)
    spline = _best_spline(training, test, nominal)
    found = [spline, _best_polynomial(training, test, nominal, spline)]
    both = [one for one in found if one is not None]
    best = min(both, key=lambda one: one.method.residual)
    # Of those that predict as well the spline is taken: what its stiffness hides is in its deviations.
    return sorted(both, key=lambda one: not as_good(one, best))


def still_pixels(sample: BracketSample, nominal: Floats) -> NDArray[np.bool_]:
    """(n,), where no photograph shows something else than the others do: what moved says nothing of the response.

    Judged, in all channels together, by curves that are fitted robustly to all.
    """
    channels, log_times = tuple(_first_fit(sample, index, nominal) for index in range(3)), nominal
    for smoothing in _ROUGH:
        channels = tuple(replace(channel, smoothing=smoothing) for channel in channels)
        channels, log_times = fit_curves(sample, nominal, channels, _TRIAL_ITERATIONS)
    still = np.ones(len(sample.patch), bool)
    for channel, values, usable in zip(channels, sample.values, sample.usable, strict=True):
        left = residuals(channel, values, usable, log_times)
        expected = channel.noise_std(left.values) * np.sqrt(np.maximum(1 - left.leverage, 0.05))
        still &= (np.abs(left.error) < _MOVED * np.maximum(expected, sample.step)).all(axis=1)
    return still


def _start(sample: BracketSample, index: int) -> LogExposureSpline:
    values = sample.values[index][sample.usable[index]]
    low = max(sample.clip[index, 0], float(values.min()) - sample.step)
    high = min(sample.clip[index, 1], float(values.max()) + sample.step)
    return LogExposureSpline(low, high)


def _first_fit(sample: BracketSample, index: int, nominal: Floats) -> ChannelFit:
    curve = _start(sample, index)
    params = solve_debevec(curve, sample.values[index], sample.usable[index], nominal)
    return ChannelFit(curve, params, float(_SMOOTHING[0]), np.full(20, _START_NOISE))


def _best_spline(training: BracketSample, test: BracketSample, nominal: Floats) -> CandidateResponse:
    """Debevec and Malik's curve: the stiffest whose prediction is within a standard error of the best (or 0.2%),
    then half a decade softer, so that stiffness biases it by less than its standard deviation (Hall, Ann. Stat.
    1992)."""
    channels = tuple(_first_fit(training, index, nominal) for index in range(3))
    tried, scores = [], []
    for smoothing in _SMOOTHING:
        channels = tuple(replace(channel, smoothing=float(smoothing)) for channel in channels)
        channels, log_times = fit_curves(training, nominal, channels, _TRIAL_ITERATIONS)
        tried.append(channels)
        scores.append(_patch_errors(test, channels, log_times))
    negligible = _NEGLIGIBLE * min(float(errors.mean()) for errors in scores)
    stiffest = selection.simplest(scores, range(len(scores)), negligible)
    chosen = min(stiffest + 1, len(_SMOOTHING) - 1)
    detail = f"smoothing {_SMOOTHING[chosen]:.3g}"
    method = MethodScore("Debevec-Malik 1997", float(scores[chosen].sum()), detail)
    return CandidateResponse(method, tried[chosen], scores[chosen])


def _best_polynomial(
    training: BracketSample, test: BracketSample, nominal: Floats, spline: CandidateResponse
) -> CandidateResponse | None:
    """Mitsunaga and Nayar's polynomial of the order that predicts best; None if none increases throughout.

    The iteration begins at the polynomial nearest to the spline, with its noise."""
    best: CandidateResponse | None = None
    for order in ORDERS:
        channels = []
        for known in spline.channels:
            curve = ExposurePolynomial(known.curve.low, known.curve.high, order)
            at = np.linspace(curve.low, curve.high, 102)[1:-1]
            start = curve.fitted_to(at, known.curve.log_exposure(known.params, at), 1 / (0.05 + at))
            channels.append(replace(known, curve=curve, params=start, smoothing=0.0))
        if not all(channel.is_increasing() for channel in channels):
            continue
        fitted, log_times = fit_curves(training, nominal, channels, _TRIAL_ITERATIONS)
        errors = _patch_errors(test, fitted, log_times)
        residual = float(errors.sum())
        if best is None or residual < best.method.residual:
            method = MethodScore("Mitsunaga-Nayar 1999", residual, f"order {order}")
            best = CandidateResponse(method, fitted, errors)
    return best


def _patch_errors(sample: BracketSample, channels: Sequence[ChannelFit], log_times: Floats) -> Floats:
    """Parts (patches,) of the mean of |observed - predicted| codes, in 1/255: each patch's sum over all counts."""
    clusters = int(sample.patch.max()) + 1
    sums, count = np.zeros(clusters), 0
    for index, channel in enumerate(channels):
        error, seen = prediction_errors(sample, index, channel, log_times)
        sums += np.bincount(sample.patch, np.where(seen, error, 0).sum(axis=1), clusters)
        count += int(seen.sum())
    return sums / max(count, 1)


def prediction_errors(
    sample: BracketSample, index: int, channel: ChannelFit, log_times: Floats
) -> tuple[Floats, NDArray[np.bool_]]:
    """|observed - predicted| in 1/255, (n, p), each code predicted from the other photographs alone, and where.

    Judged are the same codes for every curve: those that are inside the clipping levels in two photographs or more.
    """
    values, usable = sample.values[index], sample.usable[index]
    margin = 8 * max(sample.step, _START_NOISE)
    low, high = channel.curve.low + margin, channel.curve.high - margin
    seen = usable & (values > low) & (values < high)
    seen &= seen.sum(axis=1, keepdims=True) > 1
    left = residuals(channel, values, usable, log_times)
    others = left.weight.sum(axis=1, keepdims=True) - left.weight
    # x without photograph j, to first order: what j pulled is taken back out.
    known = others > 0
    pull = left.weight * left.slope * left.error / np.where(known, others, 1)
    predicted = channel.values_at(left.x - pull + log_times)
    error = 255 * np.abs(values - np.where(known, predicted, left.values))
    return error, seen
