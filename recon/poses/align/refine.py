"""The place of a mesh at which its silhouettes lie on the masks' outlines: robust least squares in pixels.

Damped Gauss-Newton over turn, shift and, where it is free, scale, from far to near: outlines are first searched within
a share of the object's size, in the end within pixels. How much larger than the object masks are drawn, as a whole, is
fitted along, for that is no matter of place. Picks pull with the weight that their own scatter gives them.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from capture.arrays import frozen_array
from capture.gaussnewton import LocalProblem, damped_step, gauss_newton
from recon.mesh.rays import RayTracer
from recon.poses.align.outlines import Outline
from recon.poses.align.pixelrays import PixelRays
from recon.poses.align.silhouettes import Crossings, Lines, crossings, lines_across, no_lines, offset_jacobian
from recon.poses.similarity import Similarity, motion_jacobian

Floats = NDArray[np.float64]

# (share of the object's radius, pixels at least, points per photo) within which outlines are searched, in turn.
_COARSE = ((0.4, 8.0, 100), (0.12, 6.0, 200))
_FINE = (0.03, 4.0, 400)
# Points of all photos together.
_MOST_POINTS = 16_000
_MOST_STEPS = 25
# Gains that end the search, in variances of the noise: far from the end, and in the end (3% of a deviation).
_NEARLY, _SETTLED = 1e-2, 1e-3
# Independent points per sector of an outline, to weigh silhouettes against picks. Error bars ask the residuals.
_PER_SECTOR = 4
# Masks are drawn larger or smaller than the object by so many pixels, standard deviation, before anything is seen.
_GROWTH_STD = 1.0
# Residuals of silhouettes below which no mask is believed to be, pixels.
_LEAST_SIGMA = 0.05


@dataclass(frozen=True, eq=False)
class PickedRays:
    """Picks as rays with the points of the mesh that they show. points : (n, 3) mesh frame. sigma : pixels."""

    rays: PixelRays
    points: Floats
    sigma: float


@dataclass(frozen=True, eq=False)
class PlaceResiduals:
    """What is left over at a place of the mesh.

    offsets : (n,) pixels outwards, of the silhouette from the outline. found : (n,) bool. weights : (n,) 1 / pixels^2,
    by which the fit believed each. jacobian : (n, 8), of the residuals by motion (7) and growth. normals : (n, 2) of
    the outlines. picks : (k, 2) pixels. photo, sector : (n,) int. reach : (n,) pixels within which silhouettes were
    looked for. curvature : by what share of `weights` the robust loss is really curved: it flattens where residuals
    are large, which error bars must know.
    """

    offsets: Floats
    found: NDArray[np.bool_]
    weights: Floats
    jacobian: Floats
    normals: Floats
    picks: Floats
    photo: NDArray[np.int64]
    sector: NDArray[np.int64]
    reach: Floats
    curvature: float


@dataclass(frozen=True, eq=False)
class RefinedPlace:
    """A mesh in its place.

    growth : pixels by which the mesh's silhouettes are larger than the masks. pivot : (3,) world, about which motions
    turn. information : (8, 8), inverse covariance of motion and growth if residuals were independent between
    `_PER_SECTOR` parts of each sector; rows of what was held are zero. free : (8,) bool.
    """

    place: Similarity
    growth: float
    pivot: Floats
    information: Floats
    free: NDArray[np.bool_]
    left: PlaceResiduals

    def __post_init__(self) -> None:
        for name in ("pivot", "information"):
            object.__setattr__(self, name, frozen_array(getattr(self, name)))
        object.__setattr__(self, "free", frozen_array(self.free, np.bool_))


def refine(
    tracer: RayTracer,
    outlines: Sequence[Outline],
    start: Similarity,
    free_scale: bool,
    picks: PickedRays | None = None,
    thorough: bool = True,
) -> RefinedPlace:
    """Move a mesh from where it starts until its silhouettes lie on outlines, one of each photograph.

    tracer : of the mesh in its own frame. thorough : false stops before the finest search, for trying many starts.
    The result is the best that was reached; whether that is good enough, its residuals show (`verdicts`).
    """
    if not outlines:
        problem = _Problem(tracer, no_lines(), picks, free_scale, free_growth=False)
        return problem.result(problem.settled(start, 0.0, _SETTLED))
    place, growth = start, 0.0
    stages = [*_COARSE, _FINE] if thorough else list(_COARSE)
    for share, least, count in stages:
        count = max(min(count, _MOST_POINTS // max(len(outlines), 1)), 40)
        reaches = [max(share * outline.radius, least) for outline in outlines]
        lines = lines_across([outline.thinned(count) for outline in outlines], reaches)
        last = share == _FINE[0]
        problem = _Problem(tracer, lines, picks, free_scale, free_growth=last)
        at = problem.settled(place, growth, _SETTLED if last else _NEARLY)
        place, growth = at.place, at.growth
    return problem.result(at)


def residuals_at(tracer: RayTracer, outlines: Sequence[Outline], refined: RefinedPlace) -> PlaceResiduals:
    """What other photographs, that the place was not fitted to, say of it."""
    reaches = [max(_FINE[0] * outline.radius, _FINE[1]) for outline in outlines]
    lines = lines_across([outline.thinned(_FINE[2]) for outline in outlines], reaches)
    problem = _Problem(tracer, lines, None, bool(refined.free[6]), free_growth=True)
    return problem.objective(problem.placed(refined.place, refined.growth)).residuals


@dataclass(frozen=True, eq=False)
class _Placed:
    """The mesh at a place, and where its silhouettes cross the lines."""

    place: Similarity
    growth: float
    met: Crossings


@dataclass(frozen=True, eq=False)
class _Evaluated:
    """The objective at one place: `loss` (pixels) of the Cauchy loss, cost, normal equations, what it is made of."""

    loss: float
    cost: float
    information: Floats
    gradient: Floats
    pivot: Floats
    residuals: PlaceResiduals


class _Problem:
    """The objective over lines and picks."""

    def __init__(
        self,
        tracer: RayTracer,
        lines: Lines,
        picks: PickedRays | None,
        free_scale: bool,
        free_growth: bool,
    ) -> None:
        self._tracer, self._lines, self._picks = tracer, lines, picks
        self.free = np.array([True] * 6 + [free_scale, free_growth and len(lines) > 0])
        sectors = len(np.unique(lines.photo * 1000 + lines.sector)) if len(lines) else 1
        self._correlated = max(len(lines) / (sectors * _PER_SECTOR), 1.0)

    def settled(self, place: Similarity, growth: float, least: float) -> _Placed:
        """The best place near a given one; least : as of `gauss_newton`."""
        return gauss_newton(self.placed(place, growth), self._about, least, _MOST_STEPS)

    def _about(self, at: _Placed) -> LocalProblem[_Placed]:
        now, unit = self.objective(at), self._units(at.place)

        def step(damping: float) -> Floats:
            """Motion (7) and growth, (8,)."""
            step = damped_step(now.information * np.outer(unit, unit), -now.gradient * unit, damping)
            # Beyond half a radian and half its size the silhouette's first derivative says nothing.
            return unit * step * min(1.0, 0.5 / max(float(np.abs(step[:7]).max()), 1e-12))

        return LocalProblem(
            step,
            -now.gradient,
            lambda step: self.placed(at.place.moved(step[:7], now.pivot), at.growth + float(step[7])),
            lambda tried: now.cost - self.objective(tried, now.loss).cost,
        )

    def result(self, at: _Placed) -> RefinedPlace:
        now = self.objective(at)
        return RefinedPlace(at.place, at.growth, now.pivot, now.information, self.free, now.residuals)

    def placed(self, place: Similarity, growth: float) -> _Placed:
        return _Placed(place, growth, crossings(self._tracer, place, self._lines))

    def objective(self, at: _Placed, loss: float | None = None) -> _Evaluated:
        """loss : of an earlier place, to compare costs; None takes what the residuals' own scatter asks for."""
        lines, place, growth, met = self._lines, at.place, at.growth, at.met
        pivot = place.apply(self._tracer.centre[None])[0]
        residual = np.where(met.found, met.offsets - growth, lines.reach)
        jacobian = np.zeros((len(lines), 8))
        jacobian[:, :7] = offset_jacobian(lines, met, place, pivot)
        jacobian[:, 7] = np.where(met.found, -1.0, 0.0)
        scatter = 1.4826 * float(np.median(np.abs(residual))) if len(lines) else 0.0
        if loss is None:
            loss = max(2 * scatter, 0.3)
        sigma = max(loss / 2, _LEAST_SIGMA)
        per_point = 1 / (sigma**2 * self._correlated)
        weights = np.where(met.found, per_point / (1 + (residual / loss) ** 2), 0.0)
        square = (residual / loss) ** 2
        # Second derivative of the Cauchy loss over its weight [Huber 1981].
        curved = float((weights * (1 - square) / (1 + square)).sum())
        curvature = max(curved / max(float(weights.sum()), 1e-30), 0.2) if len(lines) else 1.0
        cost = per_point * loss**2 * float(np.log1p((residual / loss) ** 2).sum())
        weighted = jacobian * weights[:, None]
        information, gradient = weighted.T @ jacobian, weighted.T @ residual
        # The prior of the masks' growth.
        information[7, 7] += 1 / _GROWTH_STD**2
        gradient[7] += growth / _GROWTH_STD**2
        cost += (growth / _GROWTH_STD) ** 2
        off = np.zeros((0, 2))
        if self._picks is not None:
            off, of_points = self._picks.rays.offsets(place.apply(self._picks.points))
            motion = motion_jacobian(place.apply(self._picks.points), pivot)
            of_motion = np.einsum("nkc,ncp->nkp", of_points, motion)
            limit = 3 * self._picks.sigma
            far = (off**2).sum(axis=1) / limit**2
            believed = 1 / (1 + far) / self._picks.sigma**2
            information[:7, :7] += np.einsum("n,nkp,nkq->pq", believed, of_motion, of_motion)
            gradient[:7] += np.einsum("n,nkp,nk->p", believed, of_motion, off)
            cost += 9 * float(np.log1p(far).sum())
        held = ~self.free
        information[held], information[:, held], gradient[held] = 0, 0, 0
        left = PlaceResiduals(
            met.offsets,
            met.found,
            weights,
            jacobian,
            lines.normals,
            off,
            lines.photo,
            lines.sector,
            lines.reach,
            curvature,
        )
        return _Evaluated(loss, cost, information, gradient, pivot, left)

    def _units(self, place: Similarity) -> Floats:
        """What a motion (7) and growth (1) of 1 are worth: the mesh moves by about its own radius."""
        return np.array([1.0] * 3 + [place.scale * self._tracer.size / 2] * 3 + [1.0, 1.0])
