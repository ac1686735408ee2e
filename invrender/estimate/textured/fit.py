"""mu, sigma and the model of a textured object, from a subset of its points: each has a Kd, and a Ks, of its own.

Outside, a search over mu and sigma; inside, the tiny linear problems of all points [RH01, section 6.4]. Four questions
are the photographs': whether there is a specular part, whether it has a Fresnel factor, whether its Ks varies too, and
of which form it is. Forms are tried on a share of the points, as `solve.forms` does on a share of the samples.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from capture.parallel import parallel_map
from capture.progress import OnStep, unwatched
from invrender.brdf.form import LobeForm
from invrender.brdf.lobes import RH01_FORM
from invrender.brdf.microfacet import Microfacet
from invrender.estimate.evidence import Candidate, adequate, choose, relative_rms
from invrender.estimate.explanation import shows_more
from invrender.estimate.forms import beside
from invrender.estimate.models import Estimate, Model
from invrender.estimate.noise import NoiseModel, fit_noise, photo_weights
from invrender.estimate.search import OTHER_FORMS
from invrender.estimate.textured.influence import PointInfluence, RowInfluence, influence_of
from invrender.estimate.textured.search import (
    LADDER,
    SolvedPoints,
    TexturedModel,
    cost_at,
    numbers_at,
    search_point,
    solved,
    textured_models,
)
from invrender.estimate.textured.texel_equations import common_ks
from invrender.estimate.textured.texel_observations import TexelObservations, TexelRows

Floats = NDArray[np.float64]

# Noise that the first fit takes for granted, relative and of the RMS radiance: it only has to weigh dark and bright.
_FIRST_NOISE = NoiseModel(0.01, 0.01)
# Rows of a photograph left out count for the evidence if the others predict them to this many times their own noise.
_PREDICTED = 1.0
# Patches of the surface by which models are compared.
_PATCHES = 60
# Step of the slopes, in log sigma and log(mu - 1).
_STEP = 0.02
# Observations of points that forms are tried on: each point takes up some of its own for its Kd and Ks.
_TRIED = 6000


# How often `fit_textured` reports progress, at most: RH01's ladder, all forms' on a share, and that which they choose.
FIT_STEPS = (len(OTHER_FORMS) + 3) * len(LADDER)

# Columns of some of the points (size,) in several forms: of each form the rows of all photographs.
InForms = Callable[[Sequence[LobeForm], NDArray[np.bool_]], Mapping[LobeForm, Sequence[TexelRows]]]


@dataclass(frozen=True, eq=False)
class TexturedFit:
    """What a subset of the points says of the whole.

    candidates, chosen : the ladder; an estimate's Kd and Ks are means over the points. covariances, fragility : of the
    logarithms of sigma and mu - 1, as far as the chosen model has them, (k, k) by cause; as of
    `uncertainty.Uncertainty`. common_ks, common_ks_std : (3,), of all points where Ks doesn't vary. rows : what moves
    all these.
    """

    candidates: tuple[Candidate, ...]
    chosen: int
    noise: NoiseModel
    covariances: Mapping[str, Floats]
    fragility: Floats
    common_ks: Floats
    common_ks_std: Floats
    rows: RowInfluence

    @property
    def model(self) -> TexturedModel:
        model = self.candidates[self.chosen].estimate.model
        assert isinstance(model, TexturedModel)
        return model

    @property
    def brdf(self) -> Microfacet:
        return self.candidates[self.chosen].estimate.brdf


def fit_textured(
    photos: Sequence[TexelRows], points: int, in_forms: InForms, on_step: OnStep = unwatched
) -> TexturedFit:
    """Fit the ladder to what photographs say of some points.

    photos : rows in RH01's form. in_forms : asked for other forms only where a specular part shows; of forms that
    explain as well RH01's is preferred. `on_step` is called `FIT_STEPS` times at most.
    """
    climbed = _climb({RH01_FORM: photos}, points, on_step)
    own = climbed.ladders[RH01_FORM]
    candidates, chosen = own.candidates, choose(own.candidates)
    apart: Floats | None = None
    if candidates[chosen].estimate.model.specular or shows_more(candidates):
        tried = _climb(in_forms((RH01_FORM, *OTHER_FORMS), _share(photos, points)), points, on_step)
        others = _others(own, RH01_FORM, tried, len(climbed.stacks[RH01_FORM].points))
        chosen = choose((*candidates, *others))
        form = (*candidates, *others)[chosen].estimate.model.form
        if form is not RH01_FORM:
            whole = in_forms((form,), np.ones(points, bool))
            climbed = _climb(whole, points, on_step, tried.ladders[form].points[-1])
            mine = climbed.ladders[form]
            rest = _others(mine, form, tried, len(climbed.stacks[form].points))
            chosen = len(candidates) + choose(mine.candidates)
            own = _Ladder(
                (*own.models, *mine.models), (*own.points, *mine.points), (*candidates, *mine.candidates)
            )
            others = [candidate for candidate in rest if candidate.estimate.model.form is not RH01_FORM]
        candidates = (*own.candidates, *others)
        apart = _apart(candidates, chosen, tried)
    model, point = own.models[chosen], own.points[chosen]
    stack = climbed.stacks[model.form]
    ks = ks_std = np.zeros(3)
    if model.specular and not model.ks_varies:
        ks, ks_std = common_ks(stack.sums(numbers_at(model, point)))
    found = _uncertainty(model, stack, point)
    forms = np.zeros(len(point)) if apart is None else apart[: len(point)]
    covariances = {"noise": found.noise, "misfit": found.misfit, "forms": np.diag(forms**2)}
    return TexturedFit(
        candidates, chosen, climbed.noise, covariances, found.fragility, ks, ks_std, found.influence
    )


def richest_fit(
    photos: Mapping[LobeForm, Sequence[TexelRows]], points: int
) -> tuple[TexturedModel, Floats, TexelObservations]:
    """Of forms the richest model that predicts best, where the search finds it best, and the rows as it weighs them."""
    climbed = _climb(photos, points)
    form = min(photos, key=lambda form: climbed.ladders[form].candidates[-1].error)
    ladder = climbed.ladders[form]
    return ladder.models[-1], ladder.points[-1], climbed.stacks[form]


@dataclass(frozen=True, eq=False)
class _Ladder:
    """Models of one form, where the search found each best, and their evidence."""

    models: tuple[TexturedModel, ...]
    points: tuple[Floats, ...]
    candidates: tuple[Candidate, ...]


@dataclass(frozen=True, eq=False)
class _Climbed:
    """Ladders of several forms on the same rows, weighed alike, and what was left of them taken for noise."""

    ladders: Mapping[LobeForm, _Ladder]
    stacks: Mapping[LobeForm, TexelObservations]
    noise: NoiseModel


def _climb(
    photos: Mapping[LobeForm, Sequence[TexelRows]],
    points: int,
    on_step: OnStep = unwatched,
    near: Floats | None = None,
) -> _Climbed:
    """Ladders of forms, by the noise that the best of them leaves: what another misses is no noise.

    near : where to begin the search instead of everywhere.
    """
    shown = [rows.radiance for rows in next(iter(photos.values()))]
    count, scale = len(shown), float(np.sqrt(np.mean(np.concatenate(shown) ** 2)))
    noise = NoiseModel(_FIRST_NOISE.floor * scale, _FIRST_NOISE.relative)
    stacks = {form: TexelObservations.of(rows, points, noise, form) for form, rows in photos.items()}

    def started(form: LobeForm) -> tuple[Floats, float]:
        richest, stack = textured_models(form)[-1], stacks[form]
        start = search_point(richest, stack, near)
        return start, cost_at(richest, stack, start)

    found = dict(zip(stacks, parallel_map(started, stacks), strict=True))
    starts = {form: start for form, (start, _) in found.items()}
    best = min(found, key=lambda form: found[form][1])
    richest = textured_models(best)[-1]
    noise, weighed = _weighed(richest, stacks[best], count, starts[best])
    stacks = {
        form: replace(stack, weight=weighed.weight, trust=weighed.trust) for form, stack in stacks.items()
    }
    judged = _judged(richest, stacks[best], count, starts[best])

    def climbed(model: TexturedModel) -> tuple[Floats, Candidate]:
        place = search_point(model, stacks[model.form], starts[model.form])
        return place, _candidate(model, stacks[model.form], count, place, judged)

    rungs = {form: LADDER if form is RH01_FORM else textured_models(form) for form in stacks}
    work = parallel_map(climbed, [model for models in rungs.values() for model in models])
    ladders = {}
    for form, models in rungs.items():
        places, candidates = zip(*(next(work) for _ in models), strict=True)
        ladders[form] = _Ladder(models, places, candidates)
        for candidate in candidates:
            on_step(candidate.outcome)
    return _Climbed(ladders, stacks, noise)


def _share(photos: Sequence[TexelRows], points: int) -> NDArray[np.bool_]:
    """Which points (size,) to try forms on."""
    count = points * _TRIED / max(sum(len(rows.points) for rows in photos), 1)
    return np.asarray(np.random.default_rng(0).permutation(points) < count)


def _others(reference: _Ladder, form: LobeForm, tried: _Climbed, points: int) -> list[Candidate]:
    """Candidates of all forms but one, as they would be on all of so many points; the simple and the good first."""
    own = tried.ladders[form].candidates[-1]
    found = [
        replace(beside(reference.candidates[-1], candidate, own), parameters=_parameters(model, points))
        for other, ladder in tried.ladders.items()
        if other is not form
        for model, candidate in zip(ladder.models, ladder.candidates, strict=True)
        if model.specular
    ]
    return sorted(found, key=lambda candidate: (candidate.parameters, candidate.error))


def _apart(candidates: Sequence[Candidate], chosen: int, tried: _Climbed) -> Floats:
    """By how much other forms that explain as well put log sigma and log(mu - 1) elsewhere, (2,).

    On the points that forms were tried on, so that noise is in both alike.
    """
    model, apart = candidates[chosen].estimate.model, np.zeros(2)
    if not model.specular:
        return apart
    here = _point_like(model, tried.ladders[model.form])
    for candidate, fits in zip(candidates, adequate(candidates), strict=True):
        other = candidate.estimate.model
        if fits and other.specular and other.form is not model.form:
            there = _point_like(model, tried.ladders[other.form])
            both = min(len(here), len(there))
            apart[:both] = np.maximum(apart[:both], np.abs(here[:both] - there[:both]))
    return apart


def _point_like(model: Model, ladder: _Ladder) -> Floats:
    """Where the ladder's model with what this one has, as far as its form allows, is best."""
    wanted = (model.fresnel, getattr(model, "ks_varies", False))
    pairs = [pair for pair in zip(ladder.models, ladder.points, strict=True) if pair[0].specular]
    return min(pairs, key=lambda pair: (pair[0].ks_varies != wanted[1], pair[0].fresnel != wanted[0]))[1]


def _weighed(
    model: TexturedModel, stack: TexelObservations, photos: int, point: Floats
) -> tuple[NoiseModel, TexelObservations]:
    """The noise of a pixel, and the rows weighed by it, from what a fit leaves.

    Residuals are taken for larger by what each point's own numbers take up of them. Where the albedo changes within a
    pixel they lie farther off than noise explains, and count for less.
    """
    numbers = numbers_at(model, point)
    total = stack.sums(numbers)
    values = solved(model, total)
    at, share = stack.at, stack.share
    taken = np.sqrt(total.count / np.maximum(values.freedom, 1))[at, None]
    predicted = stack.predicted(values, numbers)
    residual = (stack.radiance - predicted) * taken / np.sqrt(share)
    free = values.freedom[at] > 0
    if not free.any():
        seen = int(np.bincount(at).max(initial=0))
        raise ValueError(
            f"no point of the surface is seen by enough photographs for Kd and Ks of its own: {seen} at most, and"
            " three or more are needed; add photographs whose views overlap, or leave texture out"
        )
    noise = fit_noise([predicted[free]], [residual[free]])
    weight, trust = np.empty_like(predicted), np.empty_like(predicted)
    for photo in range(photos):
        own = stack.photo == photo
        if own.any():
            found = photo_weights(noise, predicted[own], residual[own])
            weight[own], trust[own] = found.weight, found.trust
    return noise, replace(stack, weight=weight / share, trust=trust)


def _judged(model: TexturedModel, stack: TexelObservations, photos: int, point: Floats) -> NDArray[np.bool_]:
    """Which rows (r,) the richest model predicts well enough from the other photographs to be judged by."""
    d, s = stack.transfers(numbers_at(model, point))
    total = stack.equations(d, s)
    judged = np.zeros(len(d), bool)
    for photo in range(photos):
        own = np.flatnonzero(stack.photo == photo)
        rest = total - stack.equations(d, s, photo)
        dd, ds, ss = (part[stack.at[own]] for part in (rest.dd, rest.ds, rest.ss))
        determinant = dd * ss - ds**2
        apart = determinant > 1e-6 * dd * ss
        gain = d[own] ** 2 * ss - 2 * d[own] * s[own] * ds + s[own] ** 2 * dd
        variance = gain / np.where(apart, determinant, 1)
        judged[own] = (apart & (variance * stack.weight[own] < _PREDICTED)).all(axis=1)
    return judged


def _candidate(
    model: TexturedModel, stack: TexelObservations, photos: int, point: Floats, judged: NDArray[np.bool_]
) -> Candidate:
    """A candidate with its evidence: each photograph predicted from Kd and Ks that the others give.

    mu and sigma are those of all photographs: two numbers that one of them moves but little.
    """
    numbers = numbers_at(model, point)
    d, s = stack.transfers(numbers)
    total = stack.equations(d, s)
    values = solved(model, total)
    seen = total.count > 0
    brdf = Microfacet(values.kd[seen].mean(axis=0), values.ks[seen].mean(axis=0), *numbers, model.form)
    errors, energy = np.full(photos, np.nan), np.zeros(_PATCHES)
    for photo in range(photos):
        use = judged & (stack.photo == photo)
        if use.any():
            unseen = solved(model, total - stack.equations(d, s, photo))
            radiance, trust, at = stack.radiance[use], stack.trust[use], stack.at[use]
            residual = radiance - unseen.kd[at] * d[use] - unseen.ks[at] * s[use]
            errors[photo] = relative_rms(residual, radiance, trust)
            square = (trust * residual**2).sum(axis=1) / max(float((trust * radiance**2).sum()), 1e-300)
            # The points are in the order of the map's rows: patches are bands of it.
            energy += np.bincount(at * _PATCHES // stack.size, square, minlength=_PATCHES)
    if np.isnan(errors).all():
        raise ValueError(
            "no point of the object is seen by enough photographs to judge predictions of it; take more, from"
            " sides that overlap, or leave texture out"
        )
    # A photograph that shares no points with others has no say.
    errors = np.where(np.isnan(errors), np.nanmean(errors), errors)
    estimate = Estimate(model, brdf, {}, float(values.cost.sum()))
    return Candidate(estimate, errors, energy, _parameters(model, int(seen.sum())))


def _parameters(model: TexturedModel, points: int) -> int:
    """Count of the numbers of a model of so many points."""
    common = model.specular and not model.ks_varies
    return 3 * points * (1 + model.ks_varies) + 3 * common + model.specular + model.fresnel


@dataclass(frozen=True, eq=False)
class _Spread:
    """Covariances (k, k) of the search's coordinates, by noise and what misfit adds; fragility (k,), and influence."""

    noise: Floats
    misfit: Floats
    fragility: Floats
    influence: RowInfluence


def _uncertainty(model: TexturedModel, stack: TexelObservations, point: Floats) -> _Spread:
    """How sure the search's coordinates are, as `uncertainty.uncertainty_of` has it, and what moves them.

    All points' own numbers are solved for anew as the coordinates move: what is left of the residuals' slopes is what
    depends on these alone. Numbers at zero stay there: points that leave it would make most of differences. Clusters
    are tiles of photographs.
    """
    size = len(point)
    here = SolvedPoints.of(model, stack, point)
    points = PointInfluence.of(here)
    if not size:
        none = np.zeros((0, 0))
        return _Spread(none, none, np.zeros(0), influence_of(points, np.zeros((len(stack.at), 3, 0)), []))
    root = np.sqrt(stack.weight)
    sides = [(point - axis, point + axis) for axis in _STEP * np.eye(size)]
    ends = [(numbers_at(model, less), numbers_at(model, more)) for less, more in sides]
    _, *by_coordinate = stack.around(numbers_at(model, point), ends, np.full(size, 2 * _STEP))
    changes = [here.kd * base + here.ks * lobe for base, lobe in by_coordinate]
    jacobian = np.stack([points.left_of(change) * root for change in changes], axis=-1)  # (rows, 3, k)
    residual, freedom = here.residual * root, 3 * float(np.maximum(here.values.freedom, 0).sum())
    reduced = float((residual**2).sum()) / max(freedom, 1)
    # A prior: what the photographs don't touch would have an infinite variance, and drag the other with it.
    inverse = np.linalg.inv(np.einsum("rci,rcj->ij", jacobian, jacobian) / reduced + np.eye(size))

    def pull(off: Floats) -> Floats:
        scores = np.einsum("rci,rc->ri", jacobian, off) / reduced
        by_tile = np.stack([np.bincount(stack.tiles, column) for column in scores.T], axis=1)
        return np.sqrt(((by_tile @ inverse) ** 2).sum(axis=0))

    wider = np.maximum(pull(residual) / np.sqrt(np.diag(inverse)), 1)
    moved = jacobian * root[..., None] @ inverse / reduced
    misfit = inverse * (np.outer(wider, wider) - 1)
    return _Spread(inverse, misfit, pull(here.predicted * root), influence_of(points, moved, changes))
