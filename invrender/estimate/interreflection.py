"""Light that bounces between an object's parts: predicted from the fit, taken off its photographs, fitted again.

What bounces depends on the albedo and is part of what the albedo is read off, so fit and prediction take turns until
neither changes; a fit that explains less than that to the photographs as they are gives no information on what bounces,
and isn't followed. Then the photographs judge: with s times the bounced light taken off and all else fitted, the
residuals are r(s) = r(0) + s (r(1) - r(0)), and least squares give the s that they ask for: 1, if the prediction is
right. It stays taken off where photographs that were not fitted are then predicted better; by how much s misses 1, and
by how much it is uncertain, is how far the prediction isn't believed.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial
from typing import Protocol, TypeVar

import numpy as np
from numpy.typing import NDArray

from capture.lighting import Lighting
from invrender.brdf.microfacet import Microfacet
from invrender.estimate.clusters import tile_of
from invrender.estimate.evidence import climb_ladder
from invrender.estimate.explanation import Explanation, explain, refitted
from invrender.estimate.models import Estimate
from invrender.estimate.noise import Weights
from invrender.transport.columns import PhotoColumns
from invrender.transport.predict import predict_columns
from invrender.transport.radiosity import Bounced, ConcaveMesh, albedo
from invrender.transport.transfer import LightElement

Floats = NDArray[np.float64]
Ints = NDArray[np.int64]

# Of the radiance (RMS), what bounced light must be to matter: as good as our quadratures are.
MATTERS = 5e-4
# Rounds of fit and prediction at most; a change of the radiance (RMS), relative, that is the last.
ROUNDS, STILL = 20, 1e-5
# Of what lacks, the least and the most that is taken in a round.
_SHARES = 0.05, 1.0
# By what a share is divided that leaves more unexplained than photographs as they are do.
_BACK = 4.0
# The albedo at which its size is stated where none is known.
SUPPOSED = 0.5
_LABELS = {"Kd": "kd", "Ks": "ks", "mu": "mu", "sigma": "sigma"}
# Share of the samples whose part of bounced light is smaller than what is called the highest.
_HIGHEST = 0.99


@dataclass(frozen=True, eq=False)
class Interreflection:
    """What bounced light amounts to, and what was done about it.

    relative, highest : its RMS over that of the radiance, and its largest share of a sample's but for one percent of
    them. taken_off : whether the result is without it. asked, asked_std : how many times the prediction the photographs
    ask for. error_with, error_without : relative RMS on unseen photographs with it taken off, and not.
    without : the BRDF that the same model has where it isn't taken off. corrected : that where it is. albedo : (3,), in
    unknown light, of which it would be so much; None where the fit determines the albedo.
    """

    relative: float
    highest: float
    taken_off: bool
    asked: float
    asked_std: float
    error_with: float
    error_without: float
    without: Microfacet
    corrected: Microfacet
    albedo: Floats | None = None

    @property
    def doubt(self) -> float:
        """Standard deviation of what was taken off, or wasn't though it may be there, as a share of the prediction."""
        return float(np.hypot(self.asked - self.taken_off, self.asked_std))

    def moved(self, name: str) -> Floats:
        """By what share of itself taking it off changes a number of the BRDF, (3,) or (1,); NaN if there was none."""
        before, after = (
            np.atleast_1d(np.asarray(np.nan if getattr(brdf, name) is None else getattr(brdf, name), float))
            for brdf in (self.without, self.corrected)
        )
        if name in ("mu", "sigma") and not self.without.ks.any():
            before = np.full(1, np.nan)
        return np.asarray(after / np.where(before > 0, before, np.nan) - 1)

    def __str__(self) -> str:
        """The sentences that users read."""
        size = (
            f"Light that bounces between the object's parts should be {self.relative:.1%} of the radiance (RMS), up to"
            f" {self.highest:.0%} in its folds"
        )
        if self.albedo is not None:
            size += f", at an albedo of {', '.join(f'{each:.2f}' for each in self.albedo)}"
            size += ", the one that explains most" if self.taken_off else ""
        asked = f"{self.asked:.2f} ± {self.asked_std:.2f} times as much"
        errors = f"{self.error_with:.2%} with it taken off, {self.error_without:.2%} as they are"
        if not self.taken_off:
            return (
                f"{size}, but the photographs ask for {asked} (error on unseen photographs: {errors}), so none was"
                " taken off."
            )
        changes = [
            f"{label} {text}" for label, name in _LABELS.items() if (text := self._change(name)) is not None
        ]
        return (
            f"{size}. It was taken off: {', '.join(changes)}. The photographs ask for {asked}; error on unseen"
            f" photographs: {errors}."
        )

    def _change(self, name: str) -> str | None:
        """How much a number changed, in words; None if the model has none, or it is zero before and after."""
        moved = self.moved(name)
        if not np.isnan(moved).any():
            return f"{moved.mean():+.1%}"
        return "from nothing" if name == "ks" and self.corrected.ks.any() else None


@dataclass(frozen=True, eq=False)
class CorrectedExplanation:
    """An explanation with bounced light accounted for.

    doubts : (n, 3) each, what of it isn't certain. bounced : per lighting, what was taken off; nothing if it wasn't.
    """

    parts: ConcaveMesh
    known: Explanation
    found: Interreflection
    doubts: list[Floats]
    bounced: Mapping[str, Bounced]


def account_for_bounces(
    parts: ConcaveMesh,
    photos: Sequence[PhotoColumns],
    known: Explanation,
    lightings: Sequence[Lighting],
    elements: Mapping[str, Sequence[LightElement]],
    on_step: Callable[[], None] = lambda: None,
) -> CorrectedExplanation | None:
    """Take light that bounces off the photographs if it matters and they bear it out; None where it doesn't matter.

    photos : columns of RH01's form. known : their explanation without bounced light, whose scale must be absolute.
    `on_step` is called `explanation.EXPLANATION_STEPS` times at most.
    """
    first, photographed = known.candidates[known.chosen].estimate, [photo.radiance for photo in photos]

    def predict(estimate: Estimate) -> list[Floats]:
        bounced = _bounced(parts, estimate, elements)
        return [bounced[photo.lighting].radiance(photo.field, estimate.brdf) for photo in photos]

    once = predict(first)
    # Nothing was taken off as yet, so that no albedo is higher.
    if rms(once) < MATTERS * rms(photographed):
        return None
    agreed = settled(first, predict, partial(refitted, known), photographed)
    if agreed is not None and _judged(known.photos, known.weights, agreed[0], first, agreed[1]).taken_off:
        less, estimate = agreed
        corrected = [photo.less(radiance) for photo, radiance in zip(photos, less, strict=True)]
        better = explain(corrected, lightings, on_step)
        original = [photo.less(-radiance) for photo, radiance in zip(better.photos, less, strict=True)]
        without = refitted(better, [-radiance for radiance in less])
        found = _judged(original, better.weights, less, without, better.candidates[better.chosen].estimate)
        if found.taken_off:
            shares = _left(original, better.weights, less)
            candidates = tuple(
                replace(candidate, photo_errors=shares * candidate.photo_errors)
                for candidate in better.candidates
            )
            doubts = [found.doubt * radiance for radiance in less]
            taken = _bounced(parts, estimate, elements)
            return CorrectedExplanation(parts, replace(better, candidates=candidates), found, doubts, taken)
    left_in = replace(
        _judged(known.photos, known.weights, once, first, refitted(known, once)), taken_off=False
    )
    return CorrectedExplanation(parts, known, left_in, [left_in.doubt * radiance for radiance in once], {})


class Explained(Protocol):
    """A fit with its squared residuals."""

    @property
    def cost(self) -> float: ...


Fitted = TypeVar("Fitted", bound=Explained)


def settled(
    first: Fitted,
    predict: Callable[[Fitted], list[Floats]],
    refit: Callable[[list[Floats]], Fitted],
    photographed: Sequence[Floats],
) -> tuple[list[Floats], Fitted] | None:
    """Bounced light (n, 3) per photograph and the fit without it, which predicts as much.

    first : the fit to the photographs as they are. predict : what bounces by a fit. refit : the fit with that off.
    None where not even a small share of the prediction, taken off, lets the model explain the photographs better: what
    bounces would then be predicted from fits that diverge.
    """
    fit, less = first, [np.zeros_like(radiance) for radiance in photographed]
    lacking, share = None, np.ones(3)
    for _ in range(ROUNDS):
        predicted = predict(fit)
        before, lacking = lacking, np.concatenate(predicted) - np.concatenate(less)
        if before is not None:
            share = relaxed(share, before, lacking)
        tried = _taken(less, predicted, share)
        while (better := refit(tried)).cost > first.cost:
            share = share / _BACK
            if share.max() < _SHARES[0]:
                return None if fit is first else (less, fit)
            tried = _taken(less, predicted, share)
        less, fit = tried, better
        if rms([lacking]) < STILL * rms(photographed):
            break
    return less, fit


def _taken(less: Sequence[Floats], predicted: Sequence[Floats], share: Floats) -> list[Floats]:
    return [old + share * (new - old) for old, new in zip(less, predicted, strict=True)]


def relaxed(share: Floats, before: Floats, lacking: Floats) -> Floats:
    """Which share (3,) of what lacks to take next, by what the last share left of it [Irons and Tuck 1969].

    before, lacking : (n, 3), what lacked before a share (3,) of it was taken, and what does since. In deep folds of
    bright objects all of it is too much by far, and too much and too little would take turns for ever.
    """
    moved = lacking - before
    product, square = (before * moved).sum(axis=0), (moved**2).sum(axis=0)
    return np.clip(np.divide(-share * product, square, out=share.copy(), where=square > 0), *_SHARES)


def unknown_scale(
    parts: ConcaveMesh, known: Explanation, elements: Mapping[str, Sequence[LightElement]]
) -> list[str]:
    """A sentence on light that bounces where no light's strength is known and so no albedo; none if it can't matter."""
    estimate = known.candidates[known.chosen].estimate
    scale = SUPPOSED / float(albedo(estimate.brdf).mean())
    brdf = replace(estimate.brdf, kd=scale * estimate.brdf.kd, ks=scale * estimate.brdf.ks)
    bounced = _bounced(parts, replace(estimate, brdf=brdf), elements)
    less = [bounced[photo.lighting].radiance(photo.field, brdf) for photo in known.photos]
    relative = rms(less) / (scale * rms([photo.radiance for photo in known.photos]))
    if relative < MATTERS:
        return []
    return [
        "Light that bounces between the object's parts isn't taken off: no light of known strength fixes the albedo. At"
        f" an albedo of {SUPPOSED} it would be {relative:.1%} of the radiance (RMS), and Kd too high by about as much"
        " where it is even; the irradiance of one source would settle it."
    ]


def _bounced(
    parts: ConcaveMesh, estimate: Estimate, elements: Mapping[str, Sequence[LightElement]]
) -> dict[str, Bounced]:
    return {
        name: parts.bounced(elements[name], strengths, estimate.brdf)
        for name, strengths in estimate.strengths.items()
    }


def _judged(
    photos: Sequence[PhotoColumns],
    weights: Sequence[Weights],
    less: Sequence[Floats],
    without: Estimate,
    corrected: Estimate,
) -> Interreflection:
    """What photographs as they are say of bounced light (n, 3); estimates are of one model, fitted without and with."""
    taken = [photo.less(radiance) for photo, radiance in zip(photos, less, strict=True)]
    asked, asked_std = asked_for(
        [np.unique(tile_of(photo.field), return_inverse=True)[1] for photo in photos],
        [own.weight for own in weights],
        _residuals(photos, without),
        _residuals(taken, corrected),
    )
    (as_they_are,) = climb_ladder(photos, weights, models=[without.model])
    (better,) = climb_ladder(taken, weights, models=[corrected.model])
    error = float((better.photo_errors * _left(photos, weights, less)).mean())
    shown = [photo.radiance for photo in photos]
    return Interreflection(
        relative=rms(less) / rms(shown),
        highest=highest_share(less, shown),
        taken_off=error < as_they_are.error,
        asked=asked,
        asked_std=asked_std,
        error_with=error,
        error_without=as_they_are.error,
        without=without.brdf,
        corrected=corrected.brdf,
    )


def _left(photos: Sequence[PhotoColumns], weights: Sequence[Weights], less: Sequence[Floats]) -> Floats:
    return left_of([photo.radiance for photo in photos], [own.trust for own in weights], less)


def left_of(radiance: Sequence[Floats], trust: Sequence[Floats], less: Sequence[Floats]) -> Floats:
    """By what (photos,) errors relative to what is left of photographs (RMS) are relative to all of them.

    radiance, trust, less : (n, 3) of each photograph.
    """
    squares = [
        [(own * of**2).sum() for of in (shown - off, shown)]
        for shown, own, off in zip(radiance, trust, less, strict=True)
    ]
    left, whole = np.array(squares).T
    return np.asarray(np.sqrt(left / np.maximum(whole, 1e-300)))


def _residuals(photos: Sequence[PhotoColumns], estimate: Estimate) -> list[Floats]:
    return [
        photo.radiance - predict_columns(photo, estimate.brdf, estimate.strengths[photo.lighting])
        for photo in photos
    ]


def asked_for(
    tiles: Sequence[Ints],
    weights: Sequence[Floats],
    without: Sequence[Floats],
    taken_off: Sequence[Floats],
) -> tuple[float, float]:
    """How many times the bounced light the photographs ask for, and its standard deviation, from residuals (n, 3).

    Errors may be correlated within tiles (n,) of a photograph. They are those that are left at the answer: where
    nothing bounces, what taking it off would leave is no error of the photographs.
    """
    changes = [r0 - r1 for r0, r1 in zip(without, taken_off, strict=True)]
    slope = max(sum(_product(*each) for each in zip(weights, changes, changes, strict=True)), 1e-300)
    asked = sum(_product(*each) for each in zip(weights, changes, without, strict=True)) / slope
    scores = [
        np.bincount(tile, (weight * change * (r0 - asked * change)).sum(axis=1))
        for tile, weight, change, r0 in zip(tiles, weights, changes, without, strict=True)
    ]
    return asked, float(np.linalg.norm(np.concatenate(scores))) / slope


def highest_share(less: Sequence[Floats], radiance: Sequence[Floats]) -> float:
    """Bounced light's (n, 3) largest share of the radiance (n, 3) of a sample, but for one percent of them.

    At most 1: where photographs are darker than what should bounce, all of it.
    """
    shares = [
        np.minimum(off.mean(axis=1) / np.maximum(whole.mean(axis=1), 1e-300), 1)
        for off, whole in zip(less, radiance, strict=True)
    ]
    return float(np.quantile(np.concatenate(shares), _HIGHEST))


def _product(weight: Floats, one: Floats, other: Floats) -> float:
    return float((weight * one * other).sum())


def rms(values: Sequence[Floats]) -> float:
    """Root mean square of all arrays' numbers together."""
    return float(np.sqrt(np.mean(np.concatenate(values) ** 2)))
