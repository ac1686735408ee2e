"""Newton's steps over mu and sigma, all that is linear eliminated (variable projection), on the statistics alone.

The step in mu and sigma is that of the whole problem's normal equations, Kd, Ks and strengths among the unknowns, so
that what these can make up for doesn't count; they are then solved for exactly at the new place [Golub and Pereyra,
"The differentiation of pseudo-inverses and nonlinear least squares problems whose variables separate", 1973].

Where a model leaves much, residuals times their second derivatives bend the cost several times as much as
Gauss-Newton's matrix has it. That part is learnt from how gradients change [Dennis, Gay and Welsch, "An adaptive
nonlinear least-squares algorithm", 1981]. Fits from several starts, or to several subsets of the photographs, go side
by side.
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

_MOST_STEPS, _MOST_TRIALS = 30, 5
# A step this small against the standard deviation of what noise leaves is the last.
SMALL = 1e-3
# A predicted decrease of the cost, in variances of the noise, that calls for no proof.
_TRUSTED = 1e-2
# Of the coordinates, for slopes of the specular weights; they err by its square.
_STEP = 1e-4
# No step goes farther than this in log sigma and log(mu - 1); after one that doesn't lower the cost, a part of it.
_FARTHEST, _SHORTER = 0.5, 0.3
# Of Gauss-Newton's curvature, the least that a step counts on in any direction.
_LEAST_CURVED = 0.2
# Of squared lengths, a product of two changes that tells nothing of curvature.
_TELLS_NOTHING = 1e-6
# Of the largest eigenvalue of Gauss-Newton's matrix, about, the least that isn't rounding.
_SINGULAR = 1e-9


@dataclass(frozen=True, eq=False)
class SearchPoint:
    """Where a search is, and how the cost changes about it.

    point : (n,), coordinates. estimate : the best there. gradient : (n,), of half the cost, downhill. matrix : (n, n),
    Gauss-Newton's. free : (n,), which coordinates may move: not those at a bound that push against it. variance : of
    the noise, in units of the cost.
    """

    point: Floats
    estimate: Estimate
    gradient: Floats
    matrix: Floats
    free: NDArray[np.bool_]
    variance: float

    def step(self, beside: Floats, farthest: float) -> tuple[Floats, float]:
        """The step (n,) to take, and the decrease of the cost that it should bring, in variances of the noise.

        beside : (n, n), what the cost's curvature has beside `matrix`.
        """
        found, free = np.zeros(len(self.point)), self.free
        if not free.any():
            return found, 0.0
        scale = np.sqrt(np.maximum(np.diag(self.matrix)[free], 1e-300))
        scales = scale[:, None] * scale
        values, vectors = np.linalg.eigh(self.matrix[np.ix_(free, free)] / scales)
        # In these coordinates Gauss-Newton's matrix is the identity.
        base = vectors / np.sqrt(np.maximum(values, _SINGULAR))
        curvature = (self.matrix + beside)[np.ix_(free, free)] / scales
        values, vectors = np.linalg.eigh(base.T @ curvature @ base)
        base = base @ vectors / scale[:, None]
        downhill = base.T @ self.gradient[free]
        found[free] = base @ (downhill / np.maximum(np.abs(values), _LEAST_CURVED))
        decrease = float(self.gradient @ found) / self.variance
        return found * min(1.0, farthest / max(float(np.abs(found).max()), 1e-300)), decrease


def gauss_newton(
    model: Model,
    subsets: Subsets,
    starts: Floats,
    lower: Floats,
    upper: Floats,
    small: float = SMALL,
    most_steps: int = _MOST_STEPS,
) -> list[Estimate]:
    """The estimate of least cost near each of the starts (f, n), one for each subset of the photographs, its
    coordinates within bounds, to a small part of their standard deviations or after so many steps."""
    # Not `capture.gaussnewton`: many searches step side by side here, each with its own curvature.
    best = newton_steps(model, subsets, np.clip(starts, lower, upper), lower, upper)
    going, beside = list(range(len(best))), [np.zeros_like(place.matrix) for place in best]
    for _ in range(most_steps):
        before, waiting, farthest = list(best), going, dict.fromkeys(going, _FARTHEST)
        hoped = {}
        for _ in range(_MOST_TRIALS):
            moved = []
            for k in waiting:
                step, hoped[k] = before[k].step(beside[k], farthest[k])
                moved.append(np.clip(before[k].point + step, lower, upper))
            tried = newton_steps(model, subsets.take(waiting), np.array(moved), lower, upper)
            for k, there in zip(waiting, tried, strict=True):
                # The cost is a difference of large sums, too coarse to judge the last steps; they are trusted.
                if there.estimate.cost < before[k].estimate.cost or hoped[k] < _TRUSTED:
                    best[k] = there
                beside[k] = beside[k] + _curvature_between(before[k], there, best[k].matrix + beside[k])
                farthest[k] = _SHORTER * float(np.abs(there.point - before[k].point).max())
            waiting = [k for k in waiting if best[k] is before[k]]
            if not waiting:
                break
        going = [k for k in going if best[k] is not before[k] and hoped[k] >= small**2]
        if not going:
            break
    return [place.estimate for place in best]


def _curvature_between(first: SearchPoint, second: SearchPoint, known: Floats) -> Floats:
    """What to add to known curvature (n, n) to have the gradient change as it does between two places.

    The symmetric matrix of rank one that does [Broyden 1967, "Quasi-Newton methods and their application to function
    minimisation"]; 0 where they tell nothing of it.
    """
    free = first.free & second.free
    moved = np.where(free, second.point - first.point, 0)
    missed = np.where(free, first.gradient - second.gradient - known @ moved, 0)
    product = float(missed @ moved)
    if abs(product) <= _TELLS_NOTHING * float(np.linalg.norm(missed) * np.linalg.norm(moved)):
        return np.zeros_like(known)
    return np.outer(missed, missed) / product


def newton_steps(
    model: Model, subsets: Subsets, points: Floats, lower: Floats, upper: Floats
) -> list[SearchPoint]:
    """What is best at coordinates (f, n), one place for each subset of the photographs, and which way is downhill."""
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
    # What is linear follows the coordinates.
    follows = hessian[:, :size, size:] @ symmetric_pinv(hessian[:, size:, size:])
    matrix = hessian[:, :size, :size] - follows @ hessian[:, size:, :size]
    gradient = gradient[:, :size] - (follows @ gradient[:, size:, None])[:, :, 0]
    count = np.sum([entry.count for entry in reduced], axis=0)
    variance = np.maximum(np.maximum(linear.cost, 0) / np.maximum(count, 1), 1e-300)
    found = estimates(model, subsets, points, linear)
    places = zip(points, found, gradient, matrix, free[:, :size], variance.tolist(), strict=True)
    return [SearchPoint(*place) for place in places]


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
