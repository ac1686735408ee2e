"""Variable projection: the lighting solved linearly inside, BRDF and sources by damped Gauss-Newton outside.

With the lighting optimal, Kaufman's step for the nonlinear parameters is the Schur complement of the joint normal
equations, which are an arrow: a block per channel of each lighting, bordered by what channels and lightings share.
Schur complements add up, so that each lighting keeps an arrow of its own. The same arrows yield fits that leave samples
out and the covariance.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import partial

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import cho_factor, cho_solve

from capture.gaussnewton import LocalProblem, gauss_newton
from capture.parallel import parallel_map
from invrender.estimate.unknown_light.lighting_design import LightingDesign
from invrender.estimate.unknown_light.rows import LightingRows, rows_of, slopes_of
from invrender.estimate.unknown_light.state import BlindState

Floats = NDArray[np.float64]

ITERATIONS = 30
# Of squared residuals, in units of the noise that they show: so small a gain ends a search (a mesh's shadows may spoil
# what any step gains), and so small a difference is beneath what single precision resolves.
_CONVERGED, _TOLD_APART = 1e-2, 1.0


@dataclass(frozen=True, eq=False)
class BlindFit:
    """The best state of a model, and its lightings, each by its number.

    l_max : of the lightings. light : (k + j, 3) each, harmonic coefficients, then the irradiances of its sources.
    costs : squared residuals over variances, with what the prior adds. grams : (3, k + j, k + j) each, of the
    lighting's equations, prior included. rows : per design.
    """

    state: BlindState
    l_max: int
    light: Mapping[int, Floats]
    costs: Mapping[int, float]
    grams: Mapping[int, Floats]
    rows: tuple[LightingRows, ...]

    @property
    def cost(self) -> float:
        """Squared residuals over variances of all photographs, with what the priors add."""
        return sum(self.costs.values())

    @property
    def parameters(self) -> int:
        """How many numbers were fitted."""
        return sum(light.size for light in self.light.values()) + len(self.state.names)

    def slow(self, lighting: int) -> Floats:
        """Coefficients ((l_max + 1)^2, 3) of a lighting without its sources."""
        return self.light[lighting][: (self.l_max + 1) ** 2]

    @property
    def irradiances(self) -> Floats:
        """Irradiances (k, 3) of all sources, in the state's order."""
        found = np.zeros((len(self.state.directions), 3))
        for lighting, light in self.light.items():
            found[self.state.owners == lighting] = light[(self.l_max + 1) ** 2 :]
        return found


def prior_precision(scale: Floats, l_max: int, sources: int) -> Floats:
    """Precision (3, k + j) of what is known of lighting beforehand: that it is nowhere negative.

    scale : (3,) coefficient of degree 0. The RMS over m of L_lm is then at most L_00, by the addition theorem; a
    source's irradiance, at most sqrt(4 pi) L_00.
    """
    size = (l_max + 1) ** 2
    std = np.concatenate([np.ones(size), np.full(sources, np.sqrt(4 * np.pi))])
    return np.asarray(1 / np.maximum(scale[:, None] * std, 1e-300) ** 2)


def light_scale(designs: Sequence[LightingDesign]) -> dict[int, Floats]:
    """An upper estimate (3,) of each lighting's coefficient of degree 0, in the gauge Kd + Ks = 1.

    Uniform light L sends at least L to the camera (a mirror would; diffuse bodies send pi L).
    """
    means: dict[int, list[Floats]] = {}
    for design in designs:
        means.setdefault(design.lighting, []).extend(
            np.abs(photo.radiance).mean(axis=0) for photo in design.photos
        )
    return {lighting: np.sqrt(4 * np.pi) * np.max(of, axis=0) for lighting, of in means.items()}


def solve_lighting(
    designs: Sequence[LightingDesign],
    weights: Sequence[Floats],
    scales: Mapping[int, Floats],
    state: BlindState,
    l_max: int,
) -> BlindFit:
    """The best lightings at a state; weights : (n, 3) per design, inverse variances."""

    def equations(pair: tuple[LightingDesign, Floats]) -> tuple[LightingRows, Floats, Floats, float]:
        design, weight = pair
        rows = rows_of(design, state.under(design.lighting), l_max)
        gram, right = [], []
        for c in range(3):
            root = np.sqrt(weight[:, c])
            whitened = rows.of_channel(state.specular_share[c], root)
            gram.append(whitened.T @ whitened)
            right.append(whitened.T @ (root * design.radiance[:, c]))
        return rows, np.array(gram), np.array(right), float((weight * design.radiance**2).sum())

    rows, grams, rights, energies = zip(
        *parallel_map(equations, zip(designs, weights, strict=True)), strict=True
    )
    lights, costs, full = {}, {}, {}
    for lighting in dict.fromkeys(design.lighting for design in designs):
        mine = [k for k, design in enumerate(designs) if design.lighting == lighting]
        gram, right = sum(grams[k] for k in mine), sum(rights[k] for k in mine)
        prior = prior_precision(scales[lighting], l_max, int((state.owners == lighting).sum()))
        full[lighting] = gram = gram + np.einsum("cp,pq->cpq", prior, np.eye(prior.shape[1]))
        lights[lighting] = np.stack([cho_solve(cho_factor(gram[c]), right[c]) for c in range(3)], axis=-1)
        costs[lighting] = float(sum(energies[k] for k in mine) - (right.T * lights[lighting]).sum())
    return BlindFit(state, l_max, lights, costs, full, rows)


@dataclass(frozen=True, eq=False)
class Arrow:
    """Joint normal equations of a lighting: per channel, its border, and the corner of shared parameters.

    gram : (3, p, p). border : (3, p, t), zero where a channel doesn't depend on a parameter. corner : (t, t).
    right : (3, p) and right_shared : (t,), the rows' products with residuals.
    """

    gram: Floats
    border: Floats
    corner: Floats
    right: Floats
    right_shared: Floats

    def __add__(self, other: Arrow) -> Arrow:
        return Arrow(*map(np.add, vars(self).values(), vars(other).values()))

    def __sub__(self, other: Arrow) -> Arrow:
        return Arrow(*map(np.subtract, vars(self).values(), vars(other).values()))

    def times(self, count: float) -> Arrow:
        """Of so many samples for each."""
        return Arrow(*(count * part for part in vars(self).values()))


def arrow_of(lit: Floats, shared: Floats, weight: Floats, residual: Floats) -> Arrow:
    """Equations of samples: Jacobian over their lighting (3, n, p) and over the shared parameters (3, n, t).

    weight, residual : (n, 3), inverse variances and what is left.
    """
    root = np.sqrt(weight.T)[:, :, None]
    lit, shared, left = lit * root, shared * root, residual.T[:, :, None] * root
    return Arrow(
        lit.transpose(0, 2, 1) @ lit,
        lit.transpose(0, 2, 1) @ shared,
        (shared.transpose(0, 2, 1) @ shared).sum(axis=0),
        (lit.transpose(0, 2, 1) @ left)[:, :, 0],
        (shared.transpose(0, 2, 1) @ left).sum(axis=(0, 2)),
    )


def reduced(arrows: Mapping[int, Arrow]) -> SharedEquations:
    """The shared parameters' equations, all lightings eliminated."""
    corners, rights, leverage, alone = [], [], {}, {}
    for lighting, arrow in arrows.items():
        factors = [cho_factor(gram) for gram in arrow.gram]
        leverage[lighting] = np.stack([cho_solve(f, b) for f, b in zip(factors, arrow.border, strict=True)])
        alone[lighting] = np.stack([cho_solve(f, r) for f, r in zip(factors, arrow.right, strict=True)])
        corners.append(arrow.corner - np.einsum("cpt,cpu->tu", arrow.border, leverage[lighting]))
        rights.append(arrow.right_shared - np.einsum("cpt,cp->t", leverage[lighting], arrow.right))
    return SharedEquations(sum(corners), sum(rights), leverage, alone)


@dataclass(frozen=True, eq=False)
class SharedEquations:
    """Equations of the shared parameters.

    leverage : (3, p, t) of each lighting, how it gives way to them. alone : (3, p) of each, its step without them.
    """

    corner: Floats
    right: Floats
    leverage: Mapping[int, Floats]
    alone: Mapping[int, Floats]

    def step(self, free: NDArray[np.bool_], damping: float = 0.0) -> Floats:
        """Step (t,) of the shared parameters that are free, damped as Levenberg and Marquardt do."""
        result = np.zeros(len(free))
        corner = self.corner[np.ix_(free, free)]
        diagonal = np.diag(corner)
        damped = corner + np.diag(damping * diagonal + 1e-12 * diagonal.max(initial=0) + 1e-300)
        result[free] = np.linalg.solve(damped, self.right[free])
        return result


def shared_rows(design: LightingDesign, fit: BlindFit, rows: LightingRows) -> Floats:
    """Jacobian (3, n, t) of a design's samples at a fit over the shared parameters."""
    state = fit.state
    slopes = slopes_of(design, state.under(design.lighting), rows, fit.light[design.lighting])
    shared = np.zeros((3, len(design.field), len(state.names)))
    for c in range(3):
        shared[c][:, state.own(c, design.lighting)] = slopes[:, c]
    return shared


def predicted(design: LightingDesign, fit: BlindFit, rows: LightingRows) -> Floats:
    """Radiance (n, 3) of a design's rows."""
    return rows.radiance(fit.state.specular_share, fit.light[design.lighting])


def shared_equations(
    designs: Sequence[LightingDesign], weights: Sequence[Floats], fit: BlindFit
) -> SharedEquations:
    """Kaufman's equations at a fit whose lightings are optimal."""
    return reduced(arrows_at(designs, weights, fit, shared_rows))


def arrows_at(
    designs: Sequence[LightingDesign],
    weights: Sequence[Floats],
    fit: BlindFit,
    jacobian: Callable[[LightingDesign, BlindFit, LightingRows], Floats],
) -> dict[int, Arrow]:
    """Joint equations of each lighting at a fit whose lightings are optimal; jacobian : as `shared_rows`."""

    def equations(item: tuple[LightingDesign, Floats, LightingRows]) -> tuple[Floats, Floats, Floats]:
        design, weight, rows = item
        residual = design.radiance - predicted(design, fit, rows)
        shared = jacobian(design, fit, rows)
        weighted = shared * weight.T[:, :, None]
        return (
            rows.sums(fit.state.specular_share, weighted),
            np.einsum("cnt,cnu->tu", shared, weighted, optimize=True),
            np.einsum("cnt,nc->t", weighted, residual),
        )

    parts = list(parallel_map(equations, zip(designs, weights, fit.rows, strict=True)))
    arrows = {}
    for lighting, gram in fit.grams.items():
        mine = [part for design, part in zip(designs, parts, strict=True) if design.lighting == lighting]
        borders, corners, rights = zip(*mine, strict=True)
        none = np.zeros(fit.light[lighting].T.shape)
        arrows[lighting] = Arrow(gram, sum(borders), sum(corners), none, sum(rights))
    return arrows


def refine(
    designs: Sequence[LightingDesign],
    weights: Sequence[Floats],
    scales: Mapping[int, Floats],
    state: BlindState,
    l_max: int,
    iterations: int = ITERATIONS,
) -> BlindFit:
    """The best state near a given one, with its lightings."""
    fit = solve_lighting(designs, weights, scales, state, l_max)
    if not state.names:
        return fit

    def about(at: BlindFit) -> LocalProblem[BlindFit]:
        equations = shared_equations(designs, weights, at)
        free = ~at.state.stuck(equations.right)
        noise = max(at.cost / sum(weight.size for weight in weights), 1)
        return LocalProblem(
            partial(equations.step, free),
            equations.right / noise,
            lambda step: solve_lighting(designs, weights, scales, at.state.moved(step), l_max),
            lambda tried: (at.cost - tried.cost) / noise,
        )

    return gauss_newton(fit, about, _CONVERGED, iterations, told_apart=_TOLD_APART)
