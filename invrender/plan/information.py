"""Fisher information of photographs, and what it leaves uncertain: the bound of Cramer and Rao.

For independent Gaussian noise of variance v the information is the sum over samples of J'J / v, with J the derivatives
of radiance in the unknowns; no unbiased estimate has a smaller covariance than its inverse. Beside it goes, as in
`solve.uncertainty`, what a model that is off by all its radiance, independently in each tile of a photograph or patch
of the surface, would do to the unknowns.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import cho_factor, cho_solve

from invrender.estimate.clusters import patch_of, sums_by, tile_of
from invrender.plan.unknowns import Unknowns
from recon.sampling.lightfield import LightField

Floats = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class Tally:
    """The information of photographs under one lighting on its p unknowns, in units of the prior. Adds up over
    photographs.

    matrix : (p, p), Fisher's information, as in `theory.conditioning`, where unknowns are linear and have no scores.
    pull : (p, p), sum over tiles of the outer products of their scores under a model error.
    patches : patch of the surface -> (p,), the same scores summed over all that is seen of it.
    """

    matrix: Floats
    pull: Floats
    patches: Mapping[int, Floats]

    @classmethod
    def none(cls, size: int) -> Tally:
        """That of no photograph."""
        return cls(np.zeros((size, size)), np.zeros((size, size)), {})

    def __add__(self, other: Tally) -> Tally:
        patches = dict(self.patches)
        for patch, score in other.patches.items():
            patches[patch] = patches[patch] + score if patch in patches else score
        return Tally(self.matrix + other.matrix, self.pull + other.pull, patches)

    def times(self, count: float) -> Tally:
        """Of so many samples for each."""
        patches = {patch: count * score for patch, score in self.patches.items()}
        return Tally(count * self.matrix, count**2 * self.pull, patches)


def photograph_tally(
    unknowns: Unknowns, field: LightField, radiance: Floats, columns: Floats, weights: Floats
) -> Tally:
    """Tally of one photograph's samples.

    radiance : (n, 3). columns : (3, n, q), derivatives of it in `unknowns.places`. weights : (n, 3), inverse variances.
    """
    matrix = np.zeros((unknowns.size, unknowns.size))
    scores = np.zeros((len(field), unknowns.size))
    for channel, places in enumerate(unknowns.places):
        jacobian = columns[channel] * unknowns.scale[places]
        weighted = jacobian * weights[:, channel, None]
        matrix[np.ix_(places, places)] += jacobian.T @ weighted
        scores[:, places] += weighted * radiance[:, channel, None]
    tiles = sums_by(tile_of(field), scores) if len(field) else {}
    by_tile = np.array(list(tiles.values())).reshape(-1, unknowns.size)
    patches = sums_by(patch_of(field), scores) if len(field) else {}
    return Tally(matrix, by_tile.T @ by_tile, patches)


@dataclass(frozen=True, eq=False)
class Marginal:
    """The information of photographs under one lighting on the BRDF, b numbers, when the lighting's own are as they may
    be.

    information : its own. rows : (r, p - b), linear functions of the lighting's numbers that will be asked for.
    matrix, pull : (b, b); patches : -> (b,).
    """

    unknowns: Unknowns
    information: Tally
    rows: Floats

    @cached_property
    def response(self) -> Floats:
        """By how much the lighting's numbers give way to those of the BRDF, (p - b, b)."""
        return self._solved[:, : self.unknowns.shared]

    @cached_property
    def solved(self) -> Floats:
        """The rows times the covariance of the lighting's numbers for a BRDF that is known, (r, p - b)."""
        return np.asarray(self._solved[:, self.unknowns.shared :].T)

    @cached_property
    def matrix(self) -> Floats:
        b = self.unknowns.shared
        return np.asarray(self.information.matrix[:b, :b] - self.information.matrix[:b, b:] @ self.response)

    @cached_property
    def pull(self) -> Floats:
        return np.asarray(self._reduction @ self.information.pull @ self._reduction.T)

    @cached_property
    def cross_pull(self) -> Floats:
        """Of a score in the BRDF's numbers, and what it does to the rows while the BRDF is held, (b, r)."""
        b = self.unknowns.shared
        return np.asarray(self._reduction @ self.information.pull[:, b:] @ self.solved.T)

    @cached_property
    def own_pull(self) -> Floats:
        """Of what scores do to the rows while the BRDF is held, (r,)."""
        b = self.unknowns.shared
        return np.asarray(((self.solved @ self.information.pull[b:, b:]) * self.solved).sum(axis=1))

    @cached_property
    def patches(self) -> dict[int, Floats]:
        return {patch: self._reduction @ score for patch, score in self.information.patches.items()}

    @cached_property
    def own_patches(self) -> dict[int, Floats]:
        """Patch -> (r,), what its score does to the rows while the BRDF is held."""
        b = self.unknowns.shared
        return {patch: self.solved @ score[b:] for patch, score in self.information.patches.items()}

    @cached_property
    def _solved(self) -> Floats:
        b = self.unknowns.shared
        own = self.information.matrix[b:, b:] + self.unknowns.precision
        return np.asarray(
            cho_solve(cho_factor(own), np.hstack([self.information.matrix[b:, :b], self.rows.T]))
        )

    @cached_property
    def _reduction(self) -> Floats:
        """From scores in all numbers to those in the BRDF's, (b, p)."""
        return np.hstack([np.eye(self.unknowns.shared), -self.response.T])


@dataclass(frozen=True, eq=False)
class Spread:
    """Standard deviations (r,) of some numbers, and their fragility as in `solve.uncertainty.Uncertainty`."""

    std: Floats
    fragility: Floats


class Posterior:
    """What all photographs together leave uncertain. marginals : one per lighting; they share the BRDF's numbers."""

    def __init__(self, marginals: Sequence[Marginal]) -> None:
        self.marginals = tuple(marginals)
        shared = marginals[0].unknowns.shared
        precision = np.eye(shared) + np.sum([marginal.matrix for marginal in marginals], axis=0)
        self.covariance = np.linalg.inv((precision + precision.T) / 2)
        self._pull = np.sum([marginal.pull for marginal in marginals], axis=0)
        names = list(dict.fromkeys(patch for marginal in marginals for patch in marginal.patches))
        self._places = {patch: k for k, patch in enumerate(names)}
        self._patches = np.zeros((len(names), shared))
        for marginal in marginals:
            for patch, score in marginal.patches.items():
                self._patches[self._places[patch]] += score

    def of_brdf(self, rows: Floats) -> Spread:
        """Of linear functions (r, b) of the BRDF's numbers, in units of the prior."""
        response = rows @ self.covariance
        variance = (response * rows).sum(axis=1)
        pull = ((response @ self._pull) * response).sum(axis=1)
        patches = ((self._patches @ response.T) ** 2).sum(axis=0)
        return Spread(np.sqrt(variance), np.sqrt(np.maximum(pull, patches)))

    def of_lighting(self, index: int) -> Spread:
        """Of the rows of a marginal."""
        marginal = self.marginals[index]
        given = marginal.rows @ marginal.response
        # A score in the BRDF's numbers, reduced, moves the lighting's through the BRDF.
        through = -given @ self.covariance
        variance = (marginal.solved * marginal.rows).sum(axis=1) - (through * given).sum(axis=1)
        pull = ((through @ self._pull) * through).sum(axis=1)
        pull += 2 * (through * marginal.cross_pull.T).sum(axis=1) + marginal.own_pull
        moved = self._patches @ through.T
        for patch, own in marginal.own_patches.items():
            moved[self._places[patch]] += own
        patches = (moved**2).sum(axis=0)
        return Spread(np.sqrt(variance), np.sqrt(np.maximum(pull, patches)))

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
        return Posterior(marginals)
