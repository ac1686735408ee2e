"""Variable projection: the lighting solved linearly inside, BRDF and sources by damped Gauss-Newton outside.

With the lighting optimal, Kaufman's step for the nonlinear parameters is the Schur complement of the joint normal
equations, which are an arrow: a block of lighting per channel, bordered by what channels share. The same arrow yields
fits that leave samples out and the covariance.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import cho_factor, cho_solve

from capture.parallel import parallel_map
from invrender.solve.blind.sight import Rows, Sight, rows_of, slopes_of
from invrender.solve.blind.state import State

Floats = NDArray[np.float64]

ITERATIONS = 30
# In noise units, where a parameter that moves by its standard deviation costs 1.
_CONVERGED = 1e-2
_FIRST_DAMPING, _LEAST_DAMPING, _MOST_DAMPING = 1e-3, 1e-9, 1e8


@dataclass(frozen=True, eq=False)
class Fit:
    """The best state of a model, and its lighting.

    l_max : of the lighting. light : (k + j, 3), harmonic coefficients, then the sources' irradiances. cost : squared
    residuals over variances, with what the prior adds. gram : (3, k + j, k + j), of the lighting's equations, prior
    included. rows : per photograph.
    """

    state: State
    l_max: int
    light: Floats
    cost: float
    gram: Floats
    rows: tuple[Rows, ...]

    @property
    def parameters(self) -> int:
        """How many numbers were fitted."""
        return self.light.size + len(self.state.names)


def prior_precision(scale: Floats, l_max: int, sources: int) -> Floats:
    """Precision (3, k + j) of what is known of lighting beforehand: that it is nowhere negative.

    scale : (3,) coefficient of degree 0. The RMS over m of L_lm is then at most L_00, by the addition theorem; a
    source's irradiance, at most sqrt(4 pi) L_00.
    """
    size = (l_max + 1) ** 2
    std = np.concatenate([np.ones(size), np.full(sources, np.sqrt(4 * np.pi))])
    return np.asarray(1 / np.maximum(scale[:, None] * std, 1e-300) ** 2)


def light_scale(sights: Sequence[Sight]) -> Floats:
    """An upper estimate (3,) of the lighting's coefficient of degree 0, in the gauge Kd + Ks = 1.

    Uniform light L sends at least L to the camera (a mirror would; diffuse bodies send pi L).
    """
    brightest = np.max([np.abs(sight.field.radiance).mean(axis=0) for sight in sights], axis=0)
    return np.asarray(np.sqrt(4 * np.pi) * brightest)


def solve_lighting(
    sights: Sequence[Sight], weights: Sequence[Floats], scale: Floats, state: State, l_max: int
) -> Fit:
    """The best lighting at a state; weights : (n, 3) per photograph, inverse variances."""

    def equations(pair: tuple[Sight, Floats]) -> tuple[Rows, Floats, Floats, Floats]:
        sight, weight = pair
        rows = rows_of(sight, state, l_max)
        gram, right = [], []
        for c in range(3):
            root = np.sqrt(weight[:, c])
            whitened = rows.of_channel(state.kappa[c]) * root[:, None]
            gram.append(whitened.T @ whitened)
            right.append(whitened.T @ (root * sight.field.radiance[:, c]))
        return rows, np.array(gram), np.array(right), (weight * sight.field.radiance**2).sum(axis=0)

    rows, grams, rights, energies = zip(
        *parallel_map(equations, zip(sights, weights, strict=True)), strict=True
    )
    gram, right, energy = sum(grams), sum(rights), sum(energies)
    prior = prior_precision(scale, l_max, len(state.directions))
    gram = gram + np.einsum("cp,pq->cpq", prior, np.eye(prior.shape[1]))
    light = np.stack([cho_solve(cho_factor(gram[c]), right[c]) for c in range(3)], axis=-1)
    cost = float(energy.sum() - (right.T * light).sum())
    return Fit(state, l_max, light, cost, gram, rows)


@dataclass(frozen=True, eq=False)
class Arrow:
    """Joint normal equations: per channel of the lighting, its border, and the corner of shared parameters.

    gram : (3, p, p). border : (3, p, t), zero where a channel doesn't depend on a parameter. corner : (t, t).
    right : (3, p) and right_shared : (t,), the rows' products with residuals.
    """

    gram: Floats
    border: Floats
    corner: Floats
    right: Floats
    right_shared: Floats

    def __add__(self, other: Arrow) -> Arrow:
        return Arrow(
            self.gram + other.gram,
            self.border + other.border,
            self.corner + other.corner,
            self.right + other.right,
            self.right_shared + other.right_shared,
        )

    def __sub__(self, other: Arrow) -> Arrow:
        return Arrow(
            self.gram - other.gram,
            self.border - other.border,
            self.corner - other.corner,
            self.right - other.right,
            self.right_shared - other.right_shared,
        )

    def reduced(self) -> Reduced:
        """The shared parameters' equations, the lighting eliminated."""
        factors = [cho_factor(gram) for gram in self.gram]
        leverage = np.stack([cho_solve(f, b) for f, b in zip(factors, self.border, strict=True)])
        alone = np.stack([cho_solve(f, r) for f, r in zip(factors, self.right, strict=True)])
        corner = self.corner - np.einsum("cpt,cpu->tu", self.border, leverage)
        right = self.right_shared - np.einsum("cpt,cp->t", leverage, self.right)
        return Reduced(corner, right, leverage, alone)


@dataclass(frozen=True, eq=False)
class Reduced:
    """Equations of the shared parameters. leverage : (3, p, t), how the lighting gives way to them; alone : (3, p)."""

    corner: Floats
    right: Floats
    leverage: Floats
    alone: Floats

    def step(self, free: NDArray[np.bool_], damping: float = 0.0) -> Floats:
        """Step (t,) of the shared parameters that are free, damped as Levenberg and Marquardt do."""
        result = np.zeros(len(free))
        corner = self.corner[np.ix_(free, free)]
        diagonal = np.diag(corner)
        damped = corner + np.diag(damping * diagonal + 1e-12 * diagonal.max(initial=0) + 1e-300)
        result[free] = np.linalg.solve(damped, self.right[free])
        return result


def joint_rows(sight: Sight, fit: Fit, rows: Rows) -> tuple[Floats, Floats]:
    """Jacobian of a photograph at a fit: over the lighting (3, n, p), over the shared parameters (3, n, t)."""
    slopes = slopes_of(sight, fit.state, rows, fit.light)
    shared = np.zeros((3, len(sight.field), len(fit.state.names)))
    for c in range(3):
        shared[c][:, fit.state.own(c)] = slopes[:, c]
    return np.stack([rows.of_channel(kappa) for kappa in fit.state.kappa]), shared


def predicted(fit: Fit, rows: Rows) -> Floats:
    """Radiance (n, 3) of a photograph's rows."""
    return np.stack([rows.of_channel(fit.state.kappa[c]) @ fit.light[:, c] for c in range(3)], axis=-1)


def _border(sights: Sequence[Sight], weights: Sequence[Floats], fit: Fit) -> Reduced:
    """Kaufman's equations at a fit whose lighting is optimal."""

    def equations(item: tuple[Sight, Floats, Rows]) -> tuple[Floats, Floats, Floats]:
        sight, weight, rows = item
        residual = sight.field.radiance - predicted(fit, rows)
        lit, shared = joint_rows(sight, fit, rows)
        weighted = shared * weight.T[:, :, None]
        return (
            lit.transpose(0, 2, 1) @ weighted,
            np.einsum("cnt,cnu->tu", shared, weighted, optimize=True),
            np.einsum("cnt,nc->t", weighted, residual),
        )

    borders, corners, rights = zip(
        *parallel_map(equations, zip(sights, weights, fit.rows, strict=True)), strict=True
    )
    return Arrow(fit.gram, sum(borders), sum(corners), np.zeros(fit.light.T.shape), sum(rights)).reduced()


def refine(
    sights: Sequence[Sight],
    weights: Sequence[Floats],
    scale: Floats,
    state: State,
    l_max: int,
    iterations: int = ITERATIONS,
) -> Fit:
    """The best state near a given one, with its lighting."""
    fit = solve_lighting(sights, weights, scale, state, l_max)
    if not state.names:
        return fit
    damping = _FIRST_DAMPING
    for _ in range(iterations):
        equations = _border(sights, weights, fit)
        free = ~fit.state.stuck(equations.right)
        # What a full step promises to gain; less is within a fraction of the standard deviations.
        if equations.step(free) @ equations.right < _CONVERGED:
            return fit
        while True:
            moved = fit.state.moved(equations.step(free, damping))
            tried = solve_lighting(sights, weights, scale, moved, l_max)
            if tried.cost <= fit.cost or damping > _MOST_DAMPING:
                break
            damping *= 10
        gain = fit.cost - tried.cost
        if gain > 0:
            fit = tried
        if gain < _CONVERGED:
            return fit
        damping = max(damping / 10, _LEAST_DAMPING)
    return fit
