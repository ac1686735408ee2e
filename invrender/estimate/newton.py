"""Gauss-Newton steps over mu and sigma, all that is linear eliminated (variable projection), on the statistics alone.

The step in mu and sigma is that of the whole problem's normal equations, Kd, Ks and strengths among the unknowns, so
that what these can make up for doesn't count; they are then solved for exactly at the new place [Golub and Pereyra,
"The differentiation of pseudo-inverses and nonlinear least squares problems whose variables separate", 1973]. Fits
from several starts, or to several subsets of the photographs, go side by side.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from invrender.estimate.linear import (
    LinearPart,
    ReducedEquations,
    reduce_statistics,
    solve_linear,
    symmetric_pinv,
)
from invrender.estimate.models import Estimate, Model, combinations, estimates, weights_at
from invrender.estimate.statistics import Subsets

Floats = NDArray[np.float64]

_MOST_STEPS, _MOST_HALVINGS = 30, 8
# A step this small against the standard deviation of what noise leaves is the last.
SMALL = 1e-3
# A predicted decrease of the cost, in variances of the noise, that calls for no proof.
_TRUSTED = 1e-2
# Of the coordinates, for slopes of the specular weights; they err by its square.
_STEP = 1e-4
# No step goes farther than this in log sigma and log(mu - 1).
_FARTHEST = 0.5


@dataclass(frozen=True, eq=False)
class SearchPoint:
    """Where a search is, and where it would go from there.

    point : (n,), coordinates. estimate : the best there. step : (n,). decrease : of the cost, that the step should
    bring, in variances of the noise.
    """

    point: Floats
    estimate: Estimate
    step: Floats
    decrease: float


def gauss_newton(
    model: Model, subsets: Subsets, starts: Floats, lower: Floats, upper: Floats, small: float = SMALL
) -> list[Estimate]:
    """The estimate of least cost near each of the starts (f, n), one for each subset of the photographs, its
    coordinates within bounds, to a small part of their standard deviations."""
    # Not `capture.gaussnewton`: many searches step side by side here, each by its own share of its step.
    best = newton_steps(model, subsets, np.clip(starts, lower, upper), lower, upper)
    going = list(range(len(best)))
    for _ in range(_MOST_STEPS):
        before, waiting = list(best), going
        for halvings in range(_MOST_HALVINGS):
            moved = np.array([before[k].point + before[k].step / 2**halvings for k in waiting])
            tried = newton_steps(model, subsets.take(waiting), np.clip(moved, lower, upper), lower, upper)
            for k, there in zip(waiting, tried, strict=True):
                # The cost is a difference of large sums, too coarse to judge the last steps; they are trusted.
                if there.estimate.cost < before[k].estimate.cost or before[k].decrease < _TRUSTED:
                    best[k] = there
            waiting = [k for k in waiting if best[k] is before[k]]
            if not waiting:
                break
        going = [k for k in going if best[k] is not before[k] and before[k].decrease >= small**2]
        if not going:
            break
    return [place.estimate for place in best]


def newton_steps(
    model: Model, subsets: Subsets, points: Floats, lower: Floats, upper: Floats
) -> list[SearchPoint]:
    """What is best at coordinates (f, n), one place for each subset of the photographs, and the steps from there."""
    columns = np.concatenate([combinations(model, subsets, points), _slopes(model, points)], axis=2)
    reduced = reduce_statistics(subsets, columns)
    linear = solve_linear(reduced, model.specular, model.neutral)
    gradient, hessian = _normal_equations(model, linear, reduced)
    size = points.shape[1]
    free = np.diagonal(hessian, axis1=1, axis2=2) > 0
    # What is at its bound and pushes against it stays there.
    outward = ((points <= lower) & (gradient[:, :size] < 0)) | ((points >= upper) & (gradient[:, :size] > 0))
    free[:, :size] &= ~outward
    values = np.concatenate([linear.kd, linear.ks[:, :1] if model.neutral else linear.ks], axis=1)
    free[:, size : size + values.shape[1]] &= values > 0
    gradient = np.where(free, gradient, 0)
    held = ~free[:, :, None] * np.eye(free.shape[1])
    hessian = np.where(free[:, :, None] & free[:, None, :], hessian, held)
    step = (symmetric_pinv(hessian) @ gradient[:, :, None])[:, :, 0]
    count = np.sum([entry.count for entry in reduced], axis=0)
    variance = np.maximum(linear.cost, 0) / np.maximum(count, 1)
    decrease = (gradient * step).sum(axis=1) / np.maximum(variance, 1e-300)
    longest = np.abs(step[:, :size]).max(axis=1, keepdims=True)
    step = step[:, :size] * np.minimum(1, _FARTHEST / np.maximum(longest, 1e-300))
    found = estimates(model, subsets, points, linear)
    return [SearchPoint(*place) for place in zip(points, found, step, decrease.tolist(), strict=True)]


def _normal_equations(
    model: Model, linear: LinearPart, reduced: Sequence[ReducedEquations]
) -> tuple[Floats, Floats]:
    """Gradients (f, p) and Gauss-Newton matrices (f, p, p): coordinates, Kd, Ks, free strengths channel by channel.

    reduced : in the diffuse and the specular transfer, and their `_slopes`.
    """
    fits, _, _, combined = reduced[0].right.shape
    coordinate_count = len(model.coordinates)
    ks_at = coordinate_count + 3
    first = ks_at + (1 if model.neutral else 3)
    free = [(entry.lighting, name) for entry in reduced for name in entry.elements if name != "known"]
    place_of = {pair: first + 3 * k for k, pair in enumerate(free)}
    gradient = np.zeros((fits, first + 3 * len(free)))
    hessian = np.zeros((*gradient.shape, gradient.shape[1]))
    for entry in reduced:
        strengths = linear.strengths[entry.lighting]
        names = [(e, place_of[entry.lighting, n]) for e, n in enumerate(entry.elements) if n != "known"]
        size = len(entry.elements) * combined
        for c in range(3):
            shading = np.zeros((fits, combined))
            shading[:, 0], shading[:, 1] = linear.kd[:, c], linear.ks[:, c]
            # By how much each parameter moves coefficients, (f, parameters, elements, combinations).
            moved = np.zeros((fits, coordinate_count + 2 + len(names), len(entry.elements), combined))
            for k in range(coordinate_count):
                moved[:, k, :, 2 + k] = strengths[:, :, c] * linear.ks[:, c, None]
            for k, place in enumerate(model.of_base):
                moved[:, place, :, 2 + coordinate_count + k] = strengths[:, :, c] * linear.kd[:, c, None]
            moved[:, coordinate_count, :, 0] = moved[:, coordinate_count + 1, :, 1] = strengths[:, :, c]
            for k, (e, _) in enumerate(names):
                moved[:, coordinate_count + 2 + k, e] = shading
            index = np.array(
                [
                    *range(coordinate_count),
                    coordinate_count + c,
                    ks_at + (0 if model.neutral else c),
                    *(k + c for _, k in names),
                ]
            )
            rows = moved.reshape(fits, len(index), size)
            products = rows @ entry.gram[:, c].reshape(fits, size, size)
            fitted = (strengths[:, :, c, None] * shading[:, None]).reshape(fits, size, 1)
            gradient[:, index] += (rows @ entry.right[:, c].reshape(fits, size, 1) - products @ fitted)[
                ..., 0
            ]
            hessian[:, index[:, None], index] += products @ rows.transpose(0, 2, 1)
    return gradient, hessian


def _slopes(model: Model, points: Floats) -> Floats:
    """Derivatives (f, q, n) of the specular transfer's combination of columns in each coordinate.

    After them those of the diffuse transfer's, in the coordinates that move the base.
    """
    steps = _STEP * np.eye(points.shape[1])
    ends = points + np.stack([steps, -steps])[:, :, None]
    weights = weights_at(model, ends.reshape(-1, points.shape[1])).reshape(*ends.shape[:3], -1, 2)
    slopes = ((weights[0] - weights[1]) / (2 * _STEP)).transpose(1, 2, 0, 3)
    return np.concatenate([slopes[..., 1], slopes[:, :, list(model.of_base), 0]], axis=2)
