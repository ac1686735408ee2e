"""Evidence: the simplest model whose error on photographs it has not seen is no worse than the best's."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import chain

import numpy as np
from numpy.typing import NDArray

from capture.progress import OnStep, unwatched
from capture.selection import as_good, plausibility, standard_error
from invrender.estimate.clusters import patch_of
from invrender.estimate.models import Estimate, Model
from invrender.estimate.noise import Weights
from invrender.estimate.search import LADDER, fit, fit_subsets
from invrender.estimate.statistics import (
    Statistics,
    Subsets,
    by_lighting,
    weighted_statistics,
    with_known_as_one,
)
from invrender.transport.columns import PhotoColumns, together
from invrender.transport.predict import predict_columns
from recon.sampling.lightfield import pools

Floats = NDArray[np.float64]
Ints = NDArray[np.int64]

# Up to this many photographs each is left out on its own; more are left out in this many groups.
MAX_FOLDS = 20
# Relative RMS on unseen photographs from which on no number is given; RH01 report 5 to 10% for real objects.
HOPELESS = 0.3
MISFIT_REMEDY = (
    "check the light's direction, distance and frame, the poses, the shape (a visual hull's normals are rough), masks,"
    " encoding and exposures, and if the model suits the object"
)
# Standard errors of a paired difference beyond which the simpler model is clearly worse.
CLEARLY_WORSE = 3.0
# Part of a picture's pixels that count as its highlights.
_BRIGHTEST = 0.02
# Part of a standard deviation that the last step of fits that leave photographs out may have: they start at the fit to
# all, and what such a step leaves is far less.
_NEAR_ENOUGH = 0.1
# A photograph with this many times the median error is taken for wrong, if there are enough to compare.
_OUT_OF_PROPORTION, _FEWEST_TO_COMPARE = 3.0, 4


def misfit_reason(error: float) -> str:
    """Why no number is given where the best model has this error."""
    return f"the best model leaves {error:.0%} of the radiance (RMS) unexplained, so that its numbers mean nothing"


@dataclass(frozen=True, eq=False)
class Candidate:
    """One model of the ladder with its evidence.

    estimate : fitted to all photographs. photo_errors : (photos,), relative RMS of each photograph as
        predicted by a fit that has not seen it (strengths of a lighting that no other photograph has
        are fitted to it, since nothing else determines them).
    patch_energy : (patches,), the same squared residuals, as shares of each photograph's energy, by patches
        of the surface.
    parameters : count of fitted numbers. folds : fits that each have not seen some of the photographs.
    """

    estimate: Estimate
    photo_errors: Floats
    patch_energy: Floats
    parameters: int
    folds: tuple[Estimate, ...] = ()

    @property
    def error(self) -> float:
        """Mean over photographs of the cross-validated relative RMS."""
        return float(self.photo_errors.mean())

    @property
    def outcome(self) -> str:
        """What its trial found, in a few words."""
        return f"{self.estimate.model.name}: {self.error:.2%}"

    @property
    def standard_error(self) -> float:
        """Standard error of that mean."""
        return standard_error(self.photo_errors)


def relative_rms(residual: Floats, radiance: Floats, trust: Floats | None = None) -> float:
    """Root mean square of the residual over that of the radiance, all channels together.

    trust : (n, 3) weight of each sample, 0 to 1; None counts all alike.
    """
    trust = np.ones_like(residual) if trust is None else trust
    return float(np.sqrt((trust * residual**2).sum() / max(float((trust * radiance**2).sum()), 1e-300)))


@dataclass(frozen=True)
class PictureError:
    """How far a predicted picture is off.

    rms : relative RMS over its pixels. brightest : the share of the squared error that lies in the brightest 2% of
    them.
    """

    rms: float
    brightest: float


def picture_error(observed: Floats, predicted: Floats) -> PictureError:
    """The error of predicted radiance (n, 3) against a photograph's."""
    square = ((observed - predicted) ** 2).sum(axis=1)
    if not len(square):
        return PictureError(0.0, 0.0)
    count = max(int(_BRIGHTEST * len(square)), 1)
    bright = np.argpartition(-(observed**2).sum(axis=1), count - 1)[:count]
    share = float(square[bright].sum() / max(float(square.sum()), 1e-300))
    return PictureError(relative_rms(observed - predicted, observed), share)


def climb_ladder(
    photos: Sequence[PhotoColumns],
    weights: Sequence[Weights],
    on_step: OnStep = unwatched,
    models: Sequence[Model] = LADDER,
    patches: NDArray[np.int64] | None = None,
    near: Estimate | None = None,
) -> tuple[Candidate, ...]:
    """Fit and cross-validate models, all of the columns' form or without a specular part.

    patches : of the surface, those of all photographs and maybe more; of these alone if None. near : of one of the
    models, an estimate that saves its search. `on_step` is called after each model.
    """
    known = patches_of(photos) if patches is None else patches
    parts = _parts(photos, weights, known)
    # Kept per fold and lighting, not per photograph: memory then doesn't grow with the set.
    left_out: list[tuple[Statistics, ...]] = [()] * min(len(photos), MAX_FOLDS)
    found = weighted_statistics((part.photo, part.weights.weight) for part in parts)
    for part, entry in zip(parts, found, strict=True):
        left_out[part.fold] = with_known_as_one(by_lighting([*left_out[part.fold], entry]))
    subsets = Subsets(by_lighting(chain.from_iterable(left_out)), tuple(left_out))
    candidates = []
    for model in models:
        start = near if near is not None and near.model == model else None
        candidates.append(_evaluate(model, start, len(photos), parts, subsets, len(known)))
        on_step(candidates[-1].outcome)
    return tuple(candidates)


def patches_of(photos: Sequence[PhotoColumns]) -> NDArray[np.int64]:
    """The patches of the surface that photographs show, ascending."""
    return np.unique(np.concatenate([patch_of(photo.field) for photo in photos]))


def choose(candidates: Sequence[Candidate]) -> int:
    """The index of the first adequate candidate; they come with the simplest first.

    The error of an adequate candidate lies within one standard error of the best one's. It also isn't clearly worse
    in a paired comparison, either by photographs (photographs of unequal quality then hide no difference) or by
    patches of the surface (a stain, the same in each photograph, is no evidence for a model). Outlying photographs
    don't count. docs/selection.md compares this with the rule under unknown light.
    """
    return int(np.argmax(adequate(candidates)))


def adequate(candidates: Sequence[Candidate]) -> NDArray[np.bool_]:
    """Which candidates (candidates,) the photographs don't speak against; the best one always among them."""
    best = min(candidates, key=lambda candidate: candidate.error)
    trusted = ~outlying(best.photo_errors)
    least = best.photo_errors[trusted]

    def fits(candidate: Candidate) -> bool:
        errors = candidate.photo_errors[trusted]
        return as_good(errors, least, paired=False) and (
            as_good(errors**2, least**2, CLEARLY_WORSE)
            or as_good(candidate.patch_energy, best.patch_energy, CLEARLY_WORSE)
        )

    return np.array([candidate is best or fits(candidate) for candidate in candidates])


def rivalry(candidates: Sequence[Candidate]) -> Floats:
    """By how much each candidate (candidates,) is to be believed beside the chosen one: 1 as much, 0 not at all.

    What `adequate` asks, with plausibilities in place of thresholds. A rival at a threshold would come in or not by the
    order of photographs, and error bars would jump.
    """
    best = min(candidates, key=lambda candidate: candidate.error)
    trusted = ~outlying(best.photo_errors)
    least = best.photo_errors[trusted]

    def weight(candidate: Candidate) -> float:
        errors = candidate.photo_errors[trusted]
        by_photo = plausibility(errors**2, least**2)
        by_patch = plausibility(candidate.patch_energy, best.patch_energy)
        return min(plausibility(errors, least, paired=False), max(by_photo, by_patch))

    return np.array([1.0 if candidate is best else weight(candidate) for candidate in candidates])


def of_rival(weight: float) -> float:
    """The part of a rival's difference that is the error bar's.

    With the weights 1 of the chosen model and w of a rival, a number is off by nothing or by all that they differ: RMS
    by sqrt(w / (1 + w)) of it.
    """
    return float(np.sqrt(weight / (1 + weight)))


def outlying(photo_errors: Floats) -> NDArray[np.bool_]:
    """Photographs (n,) whose error is out of all proportion to the others': wrong, rather than hard to explain."""
    if len(photo_errors) < _FEWEST_TO_COMPARE:
        return np.zeros(len(photo_errors), bool)
    return photo_errors > _OUT_OF_PROPORTION * np.median(photo_errors)


@dataclass(frozen=True, eq=False)
class _Part:
    """Photographs of one fold under one lighting, as one.

    fold : its number. photos : (k,), theirs. photo : their samples, one after the other. weights : of these. photo_of,
    patch_of : (n,), which of the photographs each sample is of, and which of the patches.
    """

    fold: int
    photos: Ints
    photo: PhotoColumns
    weights: Weights
    photo_of: Ints
    patch_of: Ints


def _parts(photos: Sequence[PhotoColumns], weights: Sequence[Weights], patches: Ints) -> list[_Part]:
    """All photographs by fold and lighting, many with few samples in one part."""
    folds = (np.arange(len(photos)) % MAX_FOLDS).tolist()
    kinds = [(photo.lighting, fold) for photo, fold in zip(photos, folds, strict=True)]
    parts = []
    for own in pools([photo.field for photo in photos], kinds):
        photo = together([photos[k] for k in own])
        trust, weight = (
            np.concatenate([getattr(weights[k], name) for k in own]) for name in ("trust", "weight")
        )
        trust = trust * photo.field.shares[:, None]
        photo_of = np.repeat(np.arange(len(own)), [len(photos[k].field) for k in own])
        patch = np.searchsorted(patches, patch_of(photo.field))
        parts.append(_Part(folds[own[0]], np.array(own), photo, Weights(trust, weight), photo_of, patch))
    return parts


def unseen_on(
    candidate: Candidate, photos: Sequence[PhotoColumns], weights: Sequence[Weights], patches: Ints
) -> Candidate:
    """A candidate with the errors of its fits on other samples, each on photographs that it hasn't seen.

    photos : the same photographs as the fits', columns of the candidate's form. patches : as of `climb_ladder`.
    """
    errors, energy = _unseen(candidate.folds, len(photos), _parts(photos, weights, patches), len(patches))
    return replace(candidate, photo_errors=errors, patch_energy=energy)


def _evaluate(
    model: Model, start: Estimate | None, photos: int, parts: Sequence[_Part], subsets: Subsets, patches: int
) -> Candidate:
    full = fit(model, subsets.everything, start)
    trained = tuple(fit_subsets(model, subsets, full, _NEAR_ENOUGH))
    errors, energy = _unseen(trained, photos, parts, patches)
    free = {(part.photo.lighting, name) for part in parts for name in part.photo.elements if name != "known"}
    return Candidate(full, errors, energy, model.parameters + 3 * len(free), trained)


def _unseen(
    trained: Sequence[Estimate], photos: int, parts: Sequence[_Part], patches: int
) -> tuple[Floats, Floats]:
    """Errors (photos,) and energies (patches,), as `Candidate` has them; trained : a fit for each fold."""
    errors, energy = np.empty(photos), np.zeros(patches)
    for part in parts:
        photo, trust, estimate = part.photo, part.weights.trust, trained[part.fold]
        strengths = estimate.strengths.get(photo.lighting)
        if strengths is None:
            strengths = fit_strengths(photo, part.weights.weight, estimate)
        residual = photo.radiance - predict_columns(photo, estimate.brdf, strengths)
        square = (trust * residual**2).sum(axis=1)
        own = len(part.photos)
        total = np.bincount(part.photo_of, (trust * photo.radiance**2).sum(axis=1), minlength=own)
        total = np.maximum(total, 1e-300)
        errors[part.photos] = np.sqrt(np.bincount(part.photo_of, square, minlength=own) / total)
        energy += np.bincount(part.patch_of, square / total[part.photo_of], minlength=patches)
    return errors, energy


def fit_strengths(photo: PhotoColumns, weight: Floats, estimate: Estimate) -> Floats:
    """Strengths (elements, 3) of a photograph's lighting that fit it best with the BRDF held fixed."""
    unit = np.eye(len(photo.elements))
    strengths = np.ones((len(photo.elements), 3))
    free = np.array([name != "known" for name in photo.elements])
    if not free.any():
        return strengths
    shading = np.stack([predict_columns(photo, estimate.brdf, np.repeat(row[:, None], 3, 1)) for row in unit])
    for c in range(3):
        root = np.sqrt(weight[:, c])
        target = (photo.radiance[:, c] - shading[~free, :, c].sum(axis=0)) * root
        strengths[free, c] = np.linalg.lstsq((shading[free, :, c] * root).T, target, rcond=None)[0]
    return strengths
