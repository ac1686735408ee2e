"""Gauss-Newton steps over mu and sigma, all that is linear eliminated (variable projection), on the statistics alone.

The step in mu and sigma is that of the whole problem's normal equations, Kd, Ks and strengths among the unknowns, so
that what these can make up for doesn't count; they are then solved for exactly at the new place [Golub and Pereyra,
"The differentiation of pseudo-inverses and nonlinear least squares problems whose variables separate", 1973].
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from invrender.model.columns import specular_weights
from invrender.solve.linear import symmetric_pinv
from invrender.solve.models import Estimate, coordinates, estimate_at
from invrender.solve.statistics import Statistics

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


def gauss_newton(
    start: Estimate, statistics: Sequence[Statistics], lower: Floats, upper: Floats, small: float = SMALL
) -> Estimate:
    """The estimate of least cost near `start`, its coordinates within bounds, to a small part of their
    standard deviations."""
    best = start
    for _ in range(_MOST_STEPS):
        point = coordinates(best)
        step, decrease = newton_step(best, statistics, lower, upper)
        variance = best.cost / max(sum(entry.count for entry in statistics), 1)
        for halvings in range(_MOST_HALVINGS):
            moved = np.clip(point + step / 2**halvings, lower, upper)
            tried = estimate_at(best.model, statistics, moved)
            # Of the last steps the cost, a difference of large sums, can't tell; they are trusted.
            if tried.cost < best.cost or decrease < _TRUSTED * variance:
                break
        else:
            return best
        best = tried
        if decrease < small**2 * variance:
            return best
    return best


def newton_step(
    estimate: Estimate, statistics: Sequence[Statistics], lower: Floats, upper: Floats
) -> tuple[Floats, float]:
    """The step in the coordinates, and by how much it should lower the cost."""
    gradient, hessian = _normal_equations(estimate, statistics)
    point = coordinates(estimate)
    free = np.diag(hessian) > 0
    size = len(point)
    # What is at its bound and pushes against it stays there.
    free[:size] &= ~(((point <= lower) & (gradient[:size] < 0)) | ((point >= upper) & (gradient[:size] > 0)))
    linear = _linear_values(estimate)
    free[size : size + len(linear)] &= linear > 0
    chosen = np.flatnonzero(free)
    step = np.zeros(len(gradient))
    step[chosen] = symmetric_pinv(hessian[np.ix_(chosen, chosen)]) @ gradient[chosen]
    longest = float(np.abs(step[:size]).max())
    return step[:size] * min(1.0, _FARTHEST / max(longest, 1e-300)), float(gradient[chosen] @ step[chosen])


def _linear_values(estimate: Estimate) -> Floats:
    ks = estimate.brdf.ks[:1] if estimate.model.neutral else estimate.brdf.ks
    return np.concatenate([estimate.brdf.kd, ks])


def _normal_equations(estimate: Estimate, statistics: Sequence[Statistics]) -> tuple[Floats, Floats]:
    """Gradient (p,) and Gauss-Newton matrix (p, p): coordinates, Kd, Ks, free strengths channel by channel."""
    brdf = estimate.brdf
    weights, slopes = _weights_and_slopes(estimate)
    coordinate_count = len(slopes)
    ks_at = coordinate_count + 3
    first = ks_at + (1 if estimate.model.neutral else 3)
    free = [(entry.lighting, name) for entry in statistics for name in entry.elements if name != "known"]
    place = {pair: first + 3 * k for k, pair in enumerate(free)}
    gradient = np.zeros(first + 3 * len(free))
    hessian = np.zeros((len(gradient), len(gradient)))
    for entry in statistics:
        strengths = estimate.strengths[entry.lighting]
        names = [(e, place[entry.lighting, n]) for e, n in enumerate(entry.elements) if n != "known"]
        for c in range(3):
            shading = np.concatenate([[brdf.kd[c]], brdf.ks[c] * weights])
            unit_kd, unit_ks = np.zeros(len(shading)), np.zeros(len(shading))
            unit_kd[0], unit_ks[1:] = 1, weights
            # Coefficients (elements, q) that each parameter moves, flattened.
            rows = [np.outer(strengths[:, c], brdf.ks[c] * np.append(0, slope)) for slope in slopes]
            rows += [np.outer(strengths[:, c], unit) for unit in (unit_kd, unit_ks)]
            rows += [np.outer(np.arange(len(strengths)) == e, shading) for e, _ in names]
            moved = np.array([row.ravel() for row in rows])
            index = [
                *range(coordinate_count),
                coordinate_count + c,
                ks_at + (0 if estimate.model.neutral else c),
            ]
            index += [k + c for _, k in names]
            size = moved.shape[1]
            products = moved @ entry.gram[c].reshape(size, size)
            fitted = np.outer(strengths[:, c], shading).ravel()
            gradient[index] += moved @ entry.right[c].ravel() - products @ fitted
            hessian[np.ix_(index, index)] += products @ moved.T
    return gradient, hessian


def _weights_and_slopes(estimate: Estimate) -> tuple[Floats, list[Floats]]:
    """The specular weights and their derivatives in each coordinate."""
    point, form = coordinates(estimate), estimate.model.form

    def at(point: Floats) -> Floats:
        mu = 1 + float(np.exp(point[1])) if len(point) > 1 else None
        return specular_weights(mu, float(np.exp(point[0])), form)

    steps = _STEP * np.eye(len(point))
    return at(point), [(at(point + step) - at(point - step)) / (2 * _STEP) for step in steps]
