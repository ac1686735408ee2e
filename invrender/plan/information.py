"""Fisher information of photographs, and what it leaves uncertain: the bound of Cramer and Rao.

For independent Gaussian noise of variance v the information is the sum over samples of J'J / v, with J the derivatives
of radiance in the unknowns; no unbiased estimate has a smaller covariance than its inverse. The sums are the joint
normal equations of a fit (`unknown_light.projection.Arrow`), from which each lighting is eliminated. Beside it goes, as
in `estimate.uncertainty`, what a model that is off by all its radiance, independently in each tile of a photograph or
patch of the surface, would do to the unknowns.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import cho_factor, cho_solve

from invrender.estimate.clusters import patch_of, sums_by, tile_of
from invrender.estimate.unknown_light.projection import Arrow, SharedEquations, arrow_of, reduced
from invrender.plan.shown import ShownSamples
from invrender.plan.unknowns import LightUnknowns, Unknowns
from recon.sampling.lightfield import LightField

Floats = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class Tally:
    """The information of photographs under one lighting, in units of the prior. Adds up over photographs.

    equations : of the lighting's p numbers per channel and of the t shared ones. pull : (s, s), s = 3 p + t, sum over
    tiles of the outer products of their scores under a model error, channel by channel and then the shared ones.
    patches : patch of the surface -> (s,), the same scores summed over all that is seen of it.
    """

    equations: Arrow
    pull: Floats
    patches: Mapping[int, Floats]

    @classmethod
    def none(cls, p: int, t: int) -> Tally:
        """That of no photograph."""
        shapes = (3, p, p), (3, p, t), (t, t), (3, p), (t,)
        return cls(Arrow(*map(np.zeros, shapes)), np.zeros((3 * p + t, 3 * p + t)), {})

    def __add__(self, other: Tally) -> Tally:
        patches = dict(self.patches)
        for patch, score in other.patches.items():
            patches[patch] = patches[patch] + score if patch in patches else score
        return Tally(self.equations + other.equations, self.pull + other.pull, patches)

    def times(self, count: float) -> Tally:
        """Of so many samples for each."""
        patches = {patch: count * score for patch, score in self.patches.items()}
        return Tally(self.equations.times(count), count**2 * self.pull, patches)


def in_prior_units(unknowns: Unknowns, light: int, seen: ShownSamples) -> tuple[Floats, Floats]:
    """The Jacobian of samples, (3, n, p) and (3, n, t) as `ShownSamples` has it, per unit of the prior."""
    return seen.lit * unknowns.lights[light].std[:, None], seen.shared * unknowns.std


def photograph_tally(
    unknowns: Unknowns, light: int, field: LightField, seen: ShownSamples, weights: Floats
) -> Tally:
    """Tally of one photograph's samples under one of the lights; weights : (n, 3), inverse variances."""
    lit, shared = in_prior_units(unknowns, light, seen)
    equations = arrow_of(lit, shared, weights, seen.radiance)
    if not len(field):
        return Tally.none(lit.shape[2], shared.shape[2])
    off = (weights * seen.radiance).T[:, :, None]
    scores = np.hstack([*(lit * off), (shared * off).sum(axis=0)])
    by_tile = np.array(list(sums_by(tile_of(field), scores).values()))
    return Tally(equations, by_tile.T @ by_tile, sums_by(patch_of(field), scores))


@dataclass(frozen=True, eq=False)
class Marginal:
    """What photographs under one lighting say of the shared numbers when the lighting's own are as they may be.

    rows : (r, s), linear functions of the lighting's numbers and the shared ones that will be asked for.
    """

    light: LightUnknowns
    information: Tally
    rows: Floats

    @cached_property
    def equations(self) -> Arrow:
        """With the prior of the lighting's numbers."""
        equations = self.information.equations
        return replace(equations, gram=equations.gram + self.light.precision)

    @cached_property
    def shared(self) -> SharedEquations:
        return reduced({0: self.equations})

    @cached_property
    def reduction(self) -> Floats:
        """From scores in all numbers to those in the shared ones, (t, s)."""
        leverage = self.shared.leverage[0]
        return np.hstack([*-leverage.transpose(0, 2, 1), np.eye(leverage.shape[2])])

    @cached_property
    def pull(self) -> Floats:
        return np.asarray(self.reduction @ self.information.pull @ self.reduction.T)

    @cached_property
    def patches(self) -> dict[int, Floats]:
        return {patch: self.reduction @ score for patch, score in self.information.patches.items()}

    @cached_property
    def solved(self) -> Floats:
        """The rows times the covariance of the lighting's numbers while the shared ones are held, (r, s)."""
        solved = np.zeros_like(self.rows)
        p = self.light.size
        for channel, gram in enumerate(self.equations.gram):
            own = slice(channel * p, (channel + 1) * p)
            solved[:, own] = cho_solve(cho_factor(gram), self.rows[:, own].T).T
        return solved


@dataclass(frozen=True, eq=False)
class Spread:
    """Standard deviations (r,) of some numbers, and their fragility as in `estimate.uncertainty.Uncertainty`.

    std : by noise. causes : variances (r,) by errors of calibration, each by its name.
    """

    std: Floats
    fragility: Floats
    causes: Mapping[str, Floats] = field(default_factory=dict)

    def of(self, place: slice) -> Spread:
        """Some of the numbers."""
        causes = {cause: variances[place] for cause, variances in self.causes.items()}
        return Spread(self.std[place], self.fragility[place], causes)

    def times(self, factor: Floats) -> Spread:
        """Of the numbers (r,) times factors above 0."""
        causes = {cause: factor**2 * variances for cause, variances in self.causes.items()}
        return Spread(factor * self.std, factor * self.fragility, causes)

    @property
    def together(self) -> Spread:
        """All numbers as one, (1,): the root of the summed squares."""
        std, fragility = (np.sqrt((each**2).sum(keepdims=True)) for each in (self.std, self.fragility))
        return Spread(std, fragility, {cause: own.sum(keepdims=True) for cause, own in self.causes.items()})


class Posterior:
    """What all photographs together leave uncertain. marginals : one per lighting; they share some numbers.

    scores : (t + l, q) by cause, of errors of calibration in the shared numbers, then in each lighting's, channel by
    channel, in units of the prior.
    """

    def __init__(self, marginals: Sequence[Marginal], scores: Mapping[str, Floats] | None = None) -> None:
        self.marginals, self.scores = tuple(marginals), dict(scores or {})
        precision = np.sum([marginal.shared.corner for marginal in marginals], axis=0)
        self.covariance = np.linalg.inv((precision + precision.T) / 2 + np.eye(len(precision)))
        self._pull = np.sum([marginal.pull for marginal in marginals], axis=0)
        names = list(dict.fromkeys(patch for marginal in marginals for patch in marginal.patches))
        self._places = {patch: k for k, patch in enumerate(names)}
        self._patches = np.zeros((len(names), len(precision)))
        for marginal in marginals:
            for patch, score in marginal.patches.items():
                self._patches[self._places[patch]] += score
        *starts, _ = np.cumsum([len(precision), *(3 * own.light.size for own in self.marginals)]).tolist()
        self._own = [slice(k, k + 3 * own.light.size) for k, own in zip(starts, self.marginals, strict=True)]
        self._scores = {cause: self._shared_score(columns) for cause, columns in self.scores.items()}

    def of_shared(self, rows: Floats) -> Spread:
        """Of linear functions (r, t) of the shared numbers, in units of the prior."""
        gain = rows @ self.covariance
        patches = ((self._patches @ gain.T) ** 2).sum(axis=0)
        spread = _spread(_along(gain, rows), _along(gain @ self._pull, gain), patches)
        return _with_causes(spread, {cause: gain @ columns for cause, columns in self._scores.items()})

    def _shared_score(self, columns: Floats) -> Floats:
        """Scores (t, q) in the shared numbers, where those of each lighting are as they may be."""
        shared = columns[: len(self.covariance)]
        for marginal, own in zip(self.marginals, self._own, strict=True):
            shared = shared + marginal.reduction[:, : own.stop - own.start] @ columns[own]
        return shared

    def of_lighting(self, index: int) -> Spread:
        """Of the rows of a marginal."""
        marginal = self.marginals[index]
        given = marginal.rows @ marginal.reduction.T
        gain = given @ self.covariance
        # A score under this lighting moves its numbers by themselves and through the shared ones; others only so.
        moved = marginal.solved + gain @ marginal.reduction
        pull = _along(gain @ (self._pull - marginal.pull), gain)
        pull += _along(moved @ marginal.information.pull, moved)
        patches = self._patches @ gain.T
        for patch, score in marginal.information.patches.items():
            patches[self._places[patch]] += marginal.solved @ score
        variance = _along(marginal.solved, marginal.rows) + _along(gain, given)
        spread = _spread(variance, pull, (patches**2).sum(axis=0))
        own = self._own[index]
        by_error = {
            cause: marginal.solved[:, : own.stop - own.start] @ columns[own] + gain @ self._scores[cause]
            for cause, columns in self.scores.items()
        }
        return _with_causes(spread, by_error)

    def with_information(self, index: int, added: Tally) -> Posterior:
        """With more photographs under the lighting of one marginal."""
        old = self.marginals[index]
        return self._with_marginal(index, replace(old, information=old.information + added))

    def asked(self, index: int, rows: Floats) -> Posterior:
        """The same, with other rows asked of one marginal."""
        return self._with_marginal(index, replace(self.marginals[index], rows=rows))

    def _with_marginal(self, index: int, marginal: Marginal) -> Posterior:
        marginals = list(self.marginals)
        marginals[index] = marginal
        return Posterior(marginals, self.scores)


def _along(left: Floats, right: Floats) -> Floats:
    """Products (r,) of rows (r, k) with each other's."""
    return np.asarray((left * right).sum(axis=1))


def _with_causes(spread: Spread, moved: Mapping[str, Floats]) -> Spread:
    """A spread with what errors of calibration move, (r, q) of one standard deviation each, by cause."""
    return replace(spread, causes={cause: _along(each, each) for cause, each in moved.items()})


def _spread(variance: Floats, pull: Floats, patches: Floats) -> Spread:
    return Spread(np.sqrt(variance), np.sqrt(np.maximum(pull, patches)))
