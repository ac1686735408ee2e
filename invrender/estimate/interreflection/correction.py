"""Bounced light and fit in agreement, and the photographs' judgement on it: the same for all kinds of sets.

What bounces depends on the albedo and is part of what the albedo is read off, so fit and prediction take turns until
neither changes; a fit that explains less than that to the photographs as they are gives no information on what bounces,
and isn't followed. The candidates are then fitted to the photographs without it. Then the photographs judge
(`statement`): it stays taken off where photographs that were not fitted are then predicted better; by how much they ask
for more or less of it, and by how much that is uncertain, is how far the prediction isn't believed.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any, Generic, Protocol, TypeVar

import numpy as np
from numpy.typing import NDArray

from invrender.brdf.microfacet import Microfacet
from invrender.estimate.interreflection.statement import Interreflection, rms
from invrender.transport.radiosity import Bounced, ConcaveMesh
from invrender.transport.transfer import LightElement
from recon.sampling.lightfield import LightField

Floats = NDArray[np.float64]

# Of the radiance (RMS), what bounced light must be to matter: as good as our quadratures are.
MATTERS = 5e-4
# Rounds of fit and prediction at most; a change of the radiance (RMS), relative, that is the last.
_ROUNDS, _STILL = 20, 1e-5
# Of what lacks, the least and the most that is taken in a round.
_SHARES = 0.05, 1.0
# By what a share is divided that leaves more unexplained than photographs as they are do.
_BACK = 4.0
# Of what the model leaves unexplained, the share (RMS) that what is taken off must change by for another solution.
_STEADY = 0.1

Fitted = TypeVar("Fitted")
Light = TypeVar("Light")
Solution = TypeVar("Solution")


@dataclass(frozen=True, eq=False)
class Sent:
    """What an object's parts send each other and towards the camera.

    bounced : by the lighting's name. brdf : which reflects it. albedo : (3,), of the parts, where the BRDF is known up
    to a scale; None for the BRDF's own.
    """

    parts: ConcaveMesh
    bounced: Mapping[str, Bounced]
    brdf: Microfacet
    albedo: Floats | None = None

    def radiance(self, lighting: str, field: LightField) -> Floats:
        """Radiance (n, 3) of samples by it."""
        return self.bounced[lighting].radiance(field, self.brdf)

    def under(self, lighting: str, elements: Sequence[LightElement], strengths: Floats) -> Sent:
        """The same with what bounces under another lighting; strengths : (elements, 3)."""
        bounced = self.parts.bounced(elements, strengths, self.brdf, self.albedo)
        return replace(self, bounced={**self.bounced, lighting: bounced})


class BounceEvidence(Protocol[Light]):
    """Photographs as they are, with a solution's model: what a kind of set gives to the correction.

    shown : radiance (n, 3) of samples. radiance : what of it bounces. agreed : what bounces by the fit without it; None
    where the photographs give no reason to take any off. judged : what they say of it.
    """

    @property
    def shown(self) -> Sequence[Floats]: ...
    def radiance(self, light: Light) -> Sequence[Floats]: ...
    def agreed(self) -> Light | None: ...
    def judged(self, light: Light) -> Interreflection: ...


Evidence = TypeVar("Evidence", bound=BounceEvidence[Any])


@dataclass(frozen=True, eq=False)
class Correction(Generic[Solution, Light, Evidence]):
    """The solution that stands, and the bounced light that `found` is of, as its model judges it."""

    solution: Solution
    light: Light
    evidence: Evidence
    found: Interreflection

    @property
    def taken(self) -> Light | None:
        """What was taken off the photographs, if it was."""
        return self.light if self.found.taken_off else None

    @property
    def doubts(self) -> list[Floats]:
        """By one standard deviation of what isn't certain of bounced light, its radiance (n, 3)."""
        return [self.found.doubt * radiance for radiance in self.evidence.radiance(self.light)]


def corrected(
    solution: Solution,
    photographs: Evidence,
    once: Light,
    solved: Callable[[Light, Solution | None], tuple[Solution, Evidence]],
    times: int = 1,
) -> Correction[Solution, Light, Evidence] | None:
    """Take light that bounces off photographs if it matters and they bear it out; None where it can't matter.

    solution, once : of photographs as they are, and what bounces by it. solved : the solution of photographs without
    some bounced light, and its evidence; beside the last such solution. It is asked at most so many times.
    """
    if rms(photographs.radiance(once)) < MATTERS * rms(photographs.shown):
        return None
    last: Correction[Solution, Light, Evidence] | None = None
    for _ in range(times):
        evidence = photographs if last is None else last.evidence
        light: Light | None = evidence.agreed()
        if light is None:
            break
        if last is not None:
            change = zip(evidence.radiance(light), evidence.radiance(last.light), strict=True)
            unexplained = last.found.error_with * rms(evidence.shown)
            if rms([new - old for new, old in change]) < _STEADY * unexplained:
                break
        better, evidence = solved(light, None if last is None else last.solution)
        last = Correction(better, light, evidence, evidence.judged(light))
        if not last.found.taken_off:
            break
    if last is not None and last.found.taken_off:
        return last
    left_in = replace(photographs.judged(once), taken_off=False)
    return Correction(solution, once, photographs, left_in)


def settled(
    first: Fitted,
    predict: Callable[[Fitted], list[Floats]],
    refit: Callable[[list[Floats]], Fitted],
    whole: Sequence[Floats],
    explains_less: Callable[[Fitted], bool] = lambda fit: False,
) -> Fitted | None:
    """The fit without bounced light (n, 3) that predicts as much of it as was taken off.

    first : the fit to the photographs as they are. predict : what bounces by a fit. refit : the fit with that off.
    whole : the same (n, 3) of all light, beside which changes are small or not. explains_less : which fits say nothing
    of what bounces. None where even a small share of the prediction, taken off, leaves such a fit: what bounces would
    then be predicted from fits that diverge.
    """
    fit, less = first, [np.zeros_like(values) for values in whole]
    lacking, share = None, np.ones(3)
    for _ in range(_ROUNDS):
        predicted = predict(fit)
        before, lacking = lacking, np.concatenate(predicted) - np.concatenate(less)
        if before is not None:
            share = relaxed(share, before, lacking)
        tried = _taken(less, predicted, share)
        while explains_less(better := refit(tried)):
            share = share / _BACK
            if share.max() < _SHARES[0]:
                return None if fit is first else fit
            tried = _taken(less, predicted, share)
        less, fit = tried, better
        if rms([lacking]) < _STILL * rms(whole):
            break
    return fit


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
