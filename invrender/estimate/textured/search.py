"""Models of a textured object, and the search for mu and sigma: inside, the tiny linear problems of all points."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from invrender.brdf.form import LobeForm
from invrender.brdf.lobes import RH01_FORM
from invrender.estimate.models import Model, bounds_of
from invrender.estimate.search import models_of, searched, simplex
from invrender.estimate.textured.texel_equations import (
    PointValues,
    TexelEquations,
    common_ks,
    solve_both,
    solve_kd,
)
from invrender.estimate.textured.texel_observations import Numbers, TexelObservations

Floats = NDArray[np.float64]

# How near the search comes to mu - 1 and sigma, relative.
_NEAR = 1e-5


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

    def cost(point: Floats) -> float:
        return cost_at(model, stack, point)

    start = searched(cost, lower, upper) if near is None else np.clip(near[: len(lower)], lower, upper)
    return simplex(cost, start, lower, upper, size=0.02, near=_NEAR)


def cost_at(model: TexturedModel, stack: TexelObservations, point: Floats) -> float:
    """What the points leave unexplained there, each with the Kd and Ks that suit it best."""
    return float(solved(model, stack.sums(numbers_at(model, point))).cost.sum())
