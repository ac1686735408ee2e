"""Fits of a cause together with BRDF and light, and how well they predict samples that they haven't seen."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from invrender.brdf.microfacet import Microfacet
from invrender.diagnostics.cause import Cause, CauseFit
from invrender.diagnostics.linearised import (
    KD,
    KS,
    MU,
    SIGMA,
    CauseState,
    LightColumns,
    Linearised,
    linear_part,
    linearised,
    predicted,
)
from invrender.diagnostics.remainder import FOLDS, Remainders

Floats = NDArray[np.float64]

_ITERATIONS, _HALVINGS, _ENOUGH = 8, 3, 2e-3
_SIGMAS, _INDICES = (0.004, 1.2), (1.01, 6.0)
# Added to the normal equations: of each number, and of a cause's, as a share of the one that shows most.
_RIDGE, _WEAK = 1e-9, 1e-3


def glance(scene: Remainders, cause: Cause, light: LightColumns) -> CauseFit:
    """A cause, with BRDF and light, to the first order about the BRDF that is there."""
    return _judged(scene, cause, CauseState(scene.brdf, np.zeros(cause.count)), light)


def fit_cause(
    scene: Remainders, cause: Cause, light: LightColumns, few: tuple[Remainders, LightColumns]
) -> CauseFit:
    """The best fit of a cause, with BRDF and light, by Gauss-Newton steps from the BRDF that is there and from others.

    Under maps of light, which take long, only from the one that is there. few : some of the photographs and samples, on
    which numbers are sought that all photographs share.
    """
    shared = all(np.array_equal(own, cause.touches[0]) for own in cause.touches)
    where = few if shared else (scene, light)
    starts = () if any(photo.mapped for photo in scene.photos) else cause.starts
    found = [_searched(where[0], cause, brdf, where[1]) for brdf in (scene.brdf, *starts)]
    best, _ = min(found, key=lambda entry: entry[1])
    return _judged(scene, cause, best, light)


def _searched(
    scene: Remainders, cause: Cause, brdf: Microfacet, light: LightColumns
) -> tuple[CauseState, float]:
    """Where a search from a BRDF ends, and the weighted squares that are left there."""
    state = CauseState(brdf, np.zeros(cause.count))
    cost, linear = _cost(scene, cause, state, light)
    # Not `capture.gaussnewton`: a trial solves all photographs anew, and halvings cost less than rising damping.
    for _ in range(_ITERATIONS):
        parts = [linearised(scene, cause, state, k, light, part) for k, part in enumerate(linear)]
        step = _solve(*_normal(scene, parts, light.first_free + cause.count), cause)
        for halving in range(_HALVINGS):
            tried = _moved(state, step / 2**halving, cause)
            after, parts = _cost(scene, cause, tried, light)
            if after < cost:
                break
        else:
            return state, cost
        gain, state, cost, linear = 1 - after / cost, tried, after, parts
        if gain < _ENOUGH:
            break
    return state, cost


def _cost(
    scene: Remainders, cause: Cause, state: CauseState, light: LightColumns
) -> tuple[float, list[Linearised]]:
    """Weighted squares that are left when all is solved for that radiance is linear in, and these `linear_part`s."""
    parts = [linear_part(scene, cause, state, k, light) for k in range(len(scene.photos))]
    step = _solve(*_normal(scene, parts, light.first_free + cause.count), cause)
    squares = 0.0
    for photo, part in zip(scene.photos, parts, strict=True):
        squares += float((photo.weight * (part.residual - part.columns @ step[part.places]) ** 2).sum())
    return squares, parts


def _judged(scene: Remainders, cause: Cause, state: CauseState, light: LightColumns) -> CauseFit:
    """The fit about a state: parts of the samples are left out in turn, and predicted by the rest."""
    linear = [linear_part(scene, cause, state, k, light) for k in range(len(scene.photos))]
    parts = [linearised(scene, cause, state, k, light, part) for k, part in enumerate(linear)]
    first = light.first_free
    of_folds = [_normal(scene, parts, first + cause.count, fold) for fold in range(FOLDS)]
    gram, right = (np.sum([own[which] for own in of_folds], axis=0) for which in (0, 1))
    trained = [_solve(gram - own[0], right - own[1], cause) for own in of_folds]
    full = _solve(gram, right, cause)
    none = CauseState(state.brdf, np.zeros(cause.count))
    energy, pattern, left = [], [], []
    for k, (photo, part) in enumerate(zip(scene.photos, parts, strict=True)):
        unseen = np.empty_like(part.residual)
        for fold, step in enumerate(trained):
            mine = scene.fold[k] == fold
            unseen[mine] = part.residual[mine] - part.columns[mine] @ step[part.places]
        energy.append(float((photo.weight * unseen**2).sum()))
        left.append(part.residual - part.columns @ full[part.places])
        own = part.places >= first
        change = part.columns[..., own] @ full[part.places[own]]
        if cause.columns is None:
            change = change + predicted(scene, cause, state, k) - predicted(scene, cause, none, k)
        pattern.append(change)
    return CauseFit(
        cause,
        state.numbers + full[first:],
        state.brdf,
        np.array(energy),
        tuple(pattern),
        tuple(left),
        _moved(state, full, cause).brdf,
    )


def _normal(
    scene: Remainders, parts: Sequence[Linearised], size: int, fold: int | None = None
) -> tuple[Floats, Floats]:
    """Normal equations (size, size), (size,) of the samples of one part, or of all."""
    gram, right = np.zeros((size, size)), np.zeros(size)
    for photo, part, folds in zip(scene.photos, parts, scene.fold, strict=True):
        mine = slice(None) if fold is None else folds == fold
        root = np.sqrt(photo.weight[mine])
        columns = (part.columns[mine] * root[..., None]).reshape(-1, len(part.places))
        gram[np.ix_(part.places, part.places)] += columns.T @ columns
        right[part.places] += columns.T @ (part.residual[mine] * root).ravel()
    return gram, right


def _solve(gram: Floats, right: Floats, cause: Cause) -> Floats:
    """The solution of normal equations; 0 for numbers that nothing depends on."""
    diagonal = np.diag(gram).copy()
    known = diagonal > 0
    own = np.arange(len(right) - cause.count, len(right))
    if cause.size is not None and cause.columns is not None:
        diagonal[own] += 1 / cause.size**2
    elif cause.size is not None:
        # What hardly shows, such as a shift along the view, must not grow to mend what the others leave.
        for group in cause.touches:
            mine = own[group]
            diagonal[mine] = gram[mine, mine] + _WEAK * gram[mine, mine].max(initial=0)
    scale = np.where(known, np.sqrt(np.maximum(diagonal, 1e-300)), 1)
    scaled = gram / np.outer(scale, scale)
    scaled[np.diag_indices_from(scaled)] = np.where(known, diagonal / scale**2 + _RIDGE, 1)
    return np.asarray(np.where(known, np.linalg.solve(scaled, right / scale) / scale, 0))


def _moved(state: CauseState, step: Floats, cause: Cause) -> CauseState:
    brdf, numbers = state.brdf, state.numbers + step[len(step) - cause.count :]
    if cause.size is not None:
        numbers = np.clip(numbers, -4 * cause.size, 4 * cause.size)
    sigma, mu = brdf.sigma, brdf.mu
    if sigma is not None:
        sigma = float(np.clip(sigma * np.exp(np.clip(step[SIGMA], -1, 1)), *_SIGMAS))
    if mu is not None:
        mu = float(np.clip(1 + (mu - 1) * np.exp(np.clip(step[MU], -1, 1)), *_INDICES))
    return CauseState(
        replace(brdf, kd=brdf.kd + step[KD], ks=brdf.ks + step[KS], sigma=sigma, mu=mu), numbers
    )
