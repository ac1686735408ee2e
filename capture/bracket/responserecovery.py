"""The response of a camera from a bracket: two published methods, the one that predicts better, and its certainty."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from capture.bracket.bracketcheck import check_exposures
from capture.bracket.bracketsample import BracketSample, sample_bracket
from capture.bracket.response import Response, response_channels
from capture.bracket.responsechoice import MethodScore, as_good, candidates, prediction_errors, still_pixels
from capture.bracket.responsefit import (
    EXPOSURE_STD,
    BracketFit,
    ChannelFit,
    NothingComparableError,
    fit_bracket,
    residuals,
)
from capture.exposure import bracket_exposures
from capture.parallel import one_blas_thread
from capture.srgb import srgb_to_linear

Floats = NDArray[np.float64]
# A log exposure less certain than this says too little to be applied.
_MAX_STD = 0.3
# A knot is determined if samples lie within this share of the range, on both sides of it.
_MAX_GAP = 0.02
# What moves in more than half of the picture may as well be what doesn't.
_LEAST_STILL = 0.5
_MUCH_MOVED = 0.25


@dataclass(frozen=True, eq=False)
class Recovery:
    """A response and what is believed with it.

    methods : the chosen one first. stops : (p,) believed log2 exposures about their mean, stops_std : (p,) their
    standard deviations; nominal_stops : (p,) as given. exponent_std : standard deviation of the common power of
    curve and exposures, which no bracket determines and the given span fixes; the response's log_std and the
    exposures' covariance hold it. moved : share of the sampled picture that was left out because photographs differ
    there by more than noise. noise : (3, bins) standard deviation of a code (share of the
    top code) at evenly spaced values. residual : (3, p) mean absolute error of predicted codes, in 1/255, by photo.
    """

    response: Response
    methods: tuple[MethodScore, ...]
    stops: Floats
    stops_std: Floats
    nominal_stops: Floats
    stops_covariance: Floats
    exponent_std: float
    moved: float
    noise: Floats
    residual: Floats
    warnings: tuple[str, ...]

    def certainty(self, channel: int) -> str:
        """How certain a channel's curve is, in words."""
        std = self.response.log_std[channel]
        std = std[np.isfinite(std)]
        return f"exposure certain to {np.median(std):.2%} in the median, {std.max():.1%} at worst"


def recover_from_sample(
    sample: BracketSample, exposures: Sequence[float], names: Sequence[str], knots: int
) -> Recovery:
    """Recover the response from a sampled bracket with known exposures.

    exposures : (p,) relative, > 0, in the order of the sample's photographs. names : to be named in messages.
    knots : number of values, 256 or more, at which the curves are given.
    ValueError if the exposures are all equal, contradict the pictures, or if nothing is well exposed twice.
    """
    nominal = np.log(np.asarray(exposures, float))
    check_exposures(sample, nominal, names)
    with one_blas_thread():
        try:
            still = still_pixels(sample, nominal)
            _check_still(still, names)
            sample = sample.part(still)
            found = candidates(sample, nominal)
            rivals = [one for one in found if as_good(one, found[0])]
            fits = [fit_bracket(sample, nominal, one.channels) for one in rivals]
        except NothingComparableError as error:
            raise ValueError(
                f"{names[0]} and the others: no response makes two of the photographs show one exposure; check the"
                " exposures that are given, and that the photographs show one static scene"
            ) from error
    methods = tuple(one.method for one in found)
    return _recovery(sample, fits, knots, methods, nominal, names, 1 - float(still.mean()))


def _check_still(still: NDArray[np.bool_], names: Sequence[str]) -> None:
    if still.mean() < _LEAST_STILL:
        raise ValueError(
            f"{names[0]} and the others: over {1 - still.mean():.0%} of the picture, photographs differ by more than"
            " their exposures and noise; check the exposures that are given, and photograph a static scene from a"
            " tripod, with fixed focus, aperture and white balance"
        )


def _response(
    sample: BracketSample, fits: Sequence[BracketFit], exponent_std: float, knots: int, names: Sequence[str]
) -> Response:
    """Curves and standard deviations at the knots, the scale fixed at the middle. fits : the chosen one first, then
    any that predicts as well: where it lies is part of what isn't known. exponent_std : that of the common power."""
    values = np.linspace(0, 1, knots)
    log_exposure, log_std = np.full((3, knots), np.nan), np.full((3, knots), np.nan)
    offset = 0
    for index, channel in enumerate(fits[0].channels):
        place = slice(offset, offset + channel.curve.size)
        offset += channel.curve.size
        seen = _seen(sample, fits[0], index, values)
        at = np.flatnonzero(seen & (values > channel.curve.low) & (values < channel.curve.high))
        if at.size:
            middle = int(np.argmin(np.abs(values[at] - 128 / 255)))
            g = channel.curve.log_exposure(channel.params, values[at])
            rows = channel.curve.jacobian(channel.params, values[at]).toarray()
            # The free scale: neither the middle nor the mean of the curve counts as known without error.
            std = np.maximum(
                _std(rows - rows[middle], fits[0], place), _std(rows - rows.mean(axis=0), fits[0], place)
            )
            systematic = [_curvature_bias(channel, values[at], sample.hidden_noise)]
            for other in fits[1:]:
                rival = other.channels[index]
                off = rival.curve.log_exposure(rival.params, values[at]) - g
                # As good a place is half-way.
                systematic.append((off - np.median(off)) / 2)
            std = np.sqrt(std**2 + np.sum(np.square(systematic), axis=0))
            sure = std < _MAX_STD
            gauge = np.log(srgb_to_linear(np.array(values[at[middle]]))) - g[middle]
            log_exposure[index, at[sure]] = (g + gauge)[sure]
            log_std[index, at[sure]] = np.hypot(std, exponent_std * (g - g[middle]))[sure]
        if np.isfinite(log_exposure[index]).sum() < 2:
            raise ValueError(
                f"{names[0]} and the others: the {('red', 'green', 'blue')[index]} channel of the bracket determines"
                " no response; photograph a scene with more brightnesses, or with exposures closer to each other"
            )
    return Response(log_exposure, log_std, sample.clip)


def _curvature_bias(channel: ChannelFit, values: Floats, hidden_noise: float) -> Floats:
    """How far noise ahead of a curved response shifts the mean log exposure of a code: g'' sigma^2 / 2."""
    grid, _, slope = channel.table
    noise = np.maximum(channel.noise_std(values), hidden_noise)
    return np.interp(values, grid, np.gradient(slope, grid)) * noise**2 / 2


def _exponent_std(log_times: Floats, nominal: Floats) -> float:
    """Standard deviation of the common power, which the span of the given exposures fixes, (p,) logarithms each.

    Errors of the given exposures, independent with a standard deviation s, move the slope of a straight line through
    them by s / ||nominal - mean||. s is `EXPOSURE_STD`, or what the exposures scatter about that line if larger.
    """
    freedom = len(nominal) - 2
    scatter = np.sqrt(((log_times - nominal) ** 2).sum() / freedom) if freedom > 0 else 0.0
    return max(EXPOSURE_STD, float(scatter)) / float(np.linalg.norm(nominal - nominal.mean()))


def _std(rows: Floats, fit: BracketFit, place: slice) -> Floats:
    """Standard deviations of linear combinations of one channel's parameters, (m,) for rows (m, size)."""
    clustered = ((rows @ fit.influence[:, place].T) ** 2).sum(axis=1)
    independent = ((rows @ fit.independent_covariance[place, place]) * rows).sum(axis=1)
    prior = ((rows @ fit.prior_covariance[place, place]) * rows).sum(axis=1)
    return np.sqrt(np.maximum(clustered, independent) + prior)


def _seen(sample: BracketSample, fit: BracketFit, index: int, values: Floats) -> NDArray[np.bool_]:
    """Where samples lie close on both sides of a value, by their predicted codes."""
    left = residuals(fit.channels[index], sample.values[index], sample.usable[index], fit.log_times)
    # Only what carries weight: near clipping it tapers off.
    full = left.weight * (left.slope * fit.channels[index].noise_std(left.values)) ** 2
    places = np.sort(left.values[full > 0.5])
    few = 5
    if len(places) <= 2 * few:
        return np.zeros(len(values), bool)
    above = np.searchsorted(places, values)
    inside = (above >= few) & (above <= len(places) - few)
    nearest_below = places[np.clip(above - 1, 0, len(places) - 1)]
    nearest_above = places[np.clip(above, 0, len(places) - 1)]
    return inside & (nearest_above - nearest_below < _MAX_GAP * (places[-1] - places[0]))


def _recovery(
    sample: BracketSample,
    fits: Sequence[BracketFit],
    knots: int,
    methods: tuple[MethodScore, ...],
    nominal: Floats,
    names: Sequence[str],
    moved: float,
) -> Recovery:
    fit = fits[0]
    exponent_std = _exponent_std(fit.log_times, nominal)
    free = fit.influence.shape[1] - fit.corrections.shape[1]
    place = slice(free, None)
    covariance = np.zeros((len(nominal), len(nominal)))
    if fit.corrections.shape[1]:
        clustered = fit.influence[:, place].T @ fit.influence[:, place]
        independent = fit.independent_covariance[place, place]
        larger = clustered if np.trace(clustered) > np.trace(independent) else independent
        covariance = fit.corrections @ (larger + fit.prior_covariance[place, place]) @ fit.corrections.T
    residual = np.array(
        [_photo_errors(sample, index, channel, fit.log_times) for index, channel in enumerate(fit.channels)]
    )
    stops = (fit.log_times - fit.log_times.mean()) / np.log(2)
    nominal_stops = (nominal - nominal.mean()) / np.log(2)
    # A common power changes no differences from what is given: these warn, whatever the power.
    warnings = _exposure_warnings(stops, nominal_stops, np.sqrt(np.diag(covariance)) / np.log(2), names)
    if moved > _MUCH_MOVED:
        warnings.append(
            f"{moved:.0%} of the picture was left out, because photographs differ there by more than noise; what is"
            " left may be biased: photograph a static scene from a tripod"
        )
    stops_covariance = covariance / np.log(2) ** 2 + exponent_std**2 * np.outer(nominal_stops, nominal_stops)
    return Recovery(
        response=_response(sample, fits, exponent_std, knots, names),
        methods=methods,
        stops=stops,
        stops_std=np.sqrt(np.diag(stops_covariance)),
        nominal_stops=nominal_stops,
        stops_covariance=stops_covariance,
        exponent_std=exponent_std,
        moved=moved,
        noise=np.array([channel.noise for channel in fit.channels]),
        residual=residual,
        warnings=tuple(warnings),
    )


def _photo_errors(sample: BracketSample, index: int, channel: ChannelFit, log_times: Floats) -> Floats:
    error, seen = prediction_errors(sample, index, channel, log_times)
    counts = seen.sum(axis=0)
    return np.where(counts, np.where(seen, error, 0).sum(axis=0) / np.maximum(counts, 1), np.nan)


def _exposure_warnings(stops: Floats, nominal: Floats, std: Floats, names: Sequence[str]) -> list[str]:
    """A sentence for each photograph whose exposure is not what it is said to be."""
    warnings = []
    for name, believed, given, uncertainty in zip(names, stops, nominal, std, strict=True):
        off = believed - given
        if abs(off) > 1.96 * uncertainty and abs(2**off - 1) > 0.05:
            warnings.append(
                f"{name}: its exposure looks {2**off - 1:+.0%} off from what is given, relative to the others;"
                " the curve allows for it, but radiance is divided by the exposure that is given: check its time"
            )
    return warnings


@dataclass(frozen=True, eq=False)
class Step:
    """The ratio of two photographs' exposures that follow each other: as given, and as believed with its std."""

    first: int
    second: int
    given: float
    believed: float
    std: float


def believed_steps(recovery: Recovery) -> list[Step]:
    """Ratios between photographs that follow each other in exposure, shortest first."""
    order = np.argsort(recovery.nominal_stops, kind="stable")
    steps = []
    for first, second in zip(order[:-1].tolist(), order[1:].tolist(), strict=True):
        believed = float(2 ** (recovery.stops[second] - recovery.stops[first]))
        difference = np.zeros(len(order))
        difference[[first, second]] = -1, 1
        std = np.sqrt(difference @ recovery.stops_covariance @ difference)
        given = float(2 ** (recovery.nominal_stops[second] - recovery.nominal_stops[first]))
        steps.append(Step(first, second, given, believed, float(believed * np.log(2) * std)))
    return steps


def recover_response(paths: Sequence[Path], exposures: Sequence[float] | None = None) -> Recovery:
    """Recover the response from the photographs of a bracket; 256 knots for 8 bits, 1024 for 16.

    exposures : relative ones, such as seconds, one per photograph; None to read them from EXIF.
    ValueError names what is wrong: with the files, the exposures, or what they show.
    """
    exposures = bracket_exposures(paths, exposures)
    sample = sample_bracket(paths, np.random.default_rng(0))
    knots = 256 if sample.step > 1 / 256 else 1024
    return recover_from_sample(sample, exposures, [str(path) for path in paths], knots)


def recovery_document(recovery: Recovery, paths: Sequence[Path]) -> dict[str, object]:
    """response.json without its inputs and software."""
    photos = [
        {
            "photo": path.name,
            "given_stops": float(given),
            "believed_stops": float(believed),
            "std_stops": float(std),
            "residual_255": [None if np.isnan(one) else float(one) for one in residual],
        }
        for path, given, believed, std, residual in zip(
            paths,
            recovery.nominal_stops,
            recovery.stops,
            recovery.stops_std,
            recovery.residual.T,
            strict=True,
        )
    ]
    return {
        "format": 1,
        "gauge": "the scale of each channel is free: the determined value nearest to 128/255 has sRGB's exposure there;"
        " exposures are believed up to a common factor and a common power, and keep the span that was given;"
        " exponent_std is the power's standard deviation, part of log_std and of the exposures' std",
        "unit": "natural logarithm of the exposure; value k / (n - 1) at index k of n",
        "undetermined": "null: values that no well exposed sample showed twice, or whose log exposure is uncertain"
        f" by more than {_MAX_STD} whatever the power; photograph a scene with more brightnesses, or add exposures",
        "channels": response_channels(recovery.response),
        "methods": [
            {"name": one.name, "detail": one.detail, "residual_255": one.residual, "chosen": place == 0}
            for place, one in enumerate(recovery.methods)
        ],
        "photos": photos,
        "ratios": [
            {
                "from": paths[step.first].name,
                "to": paths[step.second].name,
                "given": step.given,
                "believed": step.believed,
                "std": step.std,
            }
            for step in believed_steps(recovery)
        ],
        "exponent_std": recovery.exponent_std,
        "moved": recovery.moved,
        "noise_255": (255 * recovery.noise).tolist(),
        "warnings": list(recovery.warnings),
    }
