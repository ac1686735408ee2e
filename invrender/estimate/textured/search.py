"""Models of a textured object, and the search for mu and sigma: inside, the tiny linear problems of all points."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import partial

import numpy as np
from numpy.typing import NDArray

from capture.gaussnewton import LocalProblem, damped_step, gauss_newton
from invrender.brdf.form import LobeForm
from invrender.brdf.lobes import RH01_FORM
from invrender.estimate.models import Model, bounds_of
from invrender.estimate.search import models_of, starting_points
from invrender.estimate.textured.texel_equations import (
    PointValues,
    TexelEquations,
    common_ks,
    made_up_for,
    solve_both,
    solve_kd,
)
from invrender.estimate.textured.texel_observations import Numbers, TexelObservations

Floats = NDArray[np.float64]

# How near the search comes to mu - 1 and sigma, of their standard deviations, and how many steps it takes at most.
_NEAR, _STEPS = 0.003, 30
# Widths in log sigma and log(mu - 1) that slopes are taken over.
_WIDTH = 2e-3
# Places whose transfers are made in one pass over the columns: those of more would take as much memory as columns do.
_TOGETHER = 6


@dataclass(frozen=True)
class TexturedModel(Model):
    """A candidate: what varies over the surface besides Kd."""

    ks_varies: bool = False


def textured_models(form: LobeForm) -> tuple[TexturedModel, ...]:
    """The models with a specular part of this form, those with fewer parameters first; Ks varies in the last."""
    even = tuple(
        TexturedModel(f"{model.name}, Kd varies", True, model.fresnel, form) for model in models_of(form)
    )
    return *even, replace(even[-1], name=f"{form.name}, Kd and Ks vary", ks_varies=True)


LADDER = (TexturedModel("lambertian, Kd varies", specular=False, fresnel=False), *textured_models(RH01_FORM))


def solved(model: TexturedModel, sums: TexelEquations, ks: Floats | None = None) -> PointValues:
    """Kd and Ks of points under a model; ks : (3,), where it doesn't vary, as found by others."""
    if model.ks_varies:
        return solve_both(sums)
    if not model.specular:
        return solve_kd(sums, np.zeros(3))
    return solve_kd(sums, common_ks(sums)[0] if ks is None else ks)


def numbers_at(model: Model, point: Floats) -> Numbers:
    """mu and sigma at the search's coordinates, log sigma and log(mu - 1)."""
    sigma = float(np.exp(point[0])) if model.specular else None
    return (1 + float(np.exp(point[1])) if model.fresnel else None), sigma


def search_point(model: TexturedModel, stack: TexelObservations, near: Floats | None = None) -> Floats:
    """log sigma and log(mu - 1), as far as the model has them, at which the least is left; near : where to begin."""
    if not model.specular:
        return np.zeros(0)
    lower, upper = bounds_of(model)

    def descended(start: Floats) -> Floats:
        # What noise is shows only in what a fit leaves.
        least = _NEAR**2 * cost_at(model, stack, start) / stack.radiance.size
        return gauss_newton(start, partial(_about, model, stack), least, _STEPS)

    if near is not None:
        return descended(np.clip(near[: len(lower)], lower, upper))
    starts = starting_points(partial(costs_at, model, stack), lower, upper)
    return min((descended(start) for start in starts), key=partial(cost_at, model, stack))


@dataclass(frozen=True, eq=False)
class SolvedPoints:
    """All points' Kd and Ks at a place of the search, and what that leaves.

    d, s : (r, 3), transfers of the rows. kd, ks : (r, 3), of each row's point. predicted, residual : (r, 3).
    """

    model: TexturedModel
    stack: TexelObservations
    d: Floats
    s: Floats
    sums: TexelEquations
    values: PointValues

    @classmethod
    def of(cls, model: TexturedModel, stack: TexelObservations, point: Floats) -> SolvedPoints:
        return cls.by(model, stack, *stack.transfers(numbers_at(model, point)))

    @classmethod
    def by(cls, model: TexturedModel, stack: TexelObservations, d: Floats, s: Floats) -> SolvedPoints:
        """By the rows' transfers there."""
        sums = stack.equations(d, s)
        return cls(model, stack, d, s, sums, solved(model, sums))

    @property
    def kd(self) -> Floats:
        return self.values.kd[self.stack.at]

    @property
    def ks(self) -> Floats:
        return self.values.ks[self.stack.at]

    @property
    def predicted(self) -> Floats:
        return self.kd * self.d + self.ks * self.s

    @property
    def residual(self) -> Floats:
        return self.stack.radiance - self.predicted

    def shared_equations(self, changes: Sequence[Floats]) -> tuple[Floats, Floats]:
        """Normal equations (t, t) and (t,) of numbers that all points share, Kd and Ks giving way to them.

        changes : (r, 3) each, derivatives of the rows' radiance by these numbers.
        """
        residual, weighed = self.residual, [self.stack.weight * change for change in changes]
        pull = np.array([(change * residual).sum() for change in weighed])
        matrix = np.array([[(one * other).sum() for other in changes] for one in weighed])
        of_points = [part for change in weighed for part in (change * self.d, change * self.s)]
        sums = self.stack.added(np.concatenate(of_points, axis=1))
        by_d, by_s = np.split(sums.reshape(len(self.sums.dd), -1, 2, 3), 2, axis=2)
        matrix -= made_up_for(self.sums, self.values, self.model.ks_varies, by_d[:, :, 0], by_s[:, :, 0])
        return matrix, pull


def _about(model: TexturedModel, stack: TexelObservations, point: Floats) -> LocalProblem[Floats]:
    """The least-squares problem in the search's coordinates about a point, all points' numbers being solved for anew.

    Golub and Pereyra 1973, "The differentiation of pseudo-inverses and nonlinear least squares problems whose variables
    separate": what a step changes counts only as far as no Kd and Ks make up for it.
    """
    lower, upper = bounds_of(model)
    sides = [
        (np.clip(point - axis, lower, upper), np.clip(point + axis, lower, upper))
        for axis in _WIDTH / 2 * np.eye(len(point))
    ]
    widths = np.array([(more - less).sum() for less, more in sides])
    ends = [(numbers_at(model, less), numbers_at(model, more)) for less, more in sides]
    (d, s), *slopes = stack.around(numbers_at(model, point), ends, widths)
    here = SolvedPoints.by(model, stack, d, s)
    changes = [here.kd * base + here.ks * lobe for base, lobe in slopes]
    matrix, pull = here.shared_equations(changes)
    # A bound that holds a coordinate takes it out.
    held = ((point <= lower) & (pull < 0)) | ((point >= upper) & (pull > 0))
    pull = np.where(held, 0.0, pull)
    matrix[held] = matrix[:, held] = 0.0
    cost = float(here.values.cost.sum())
    return LocalProblem(
        partial(damped_step, matrix, pull),
        pull,
        lambda step: np.clip(point + step, lower, upper),
        lambda tried: cost - cost_at(model, stack, tried),
    )


def cost_at(model: TexturedModel, stack: TexelObservations, point: Floats) -> float:
    """What the points leave unexplained there, each with the Kd and Ks that suit it best."""
    return costs_at(model, stack, [point])[0]


def costs_at(model: TexturedModel, stack: TexelObservations, points: Sequence[Floats]) -> list[float]:
    """`cost_at` several places."""
    places = [numbers_at(model, point) for point in points]
    return [
        float(solved(model, stack.equations(d, s)).cost.sum())
        for start in range(0, len(places), _TOGETHER)
        for d, s in stack.transfers_at(places[start : start + _TOGETHER])
    ]
