"""How far the radiance of rows moves what a textured fit reports: sigma, mu, and Kd and Ks, means over the surface."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from invrender.estimate.textured.search import SolvedPoints
from invrender.estimate.textured.texel_equations import determined

Floats = NDArray[np.float64]
Singles = NDArray[np.float32]
Ints = NDArray[np.int64]


@dataclass(frozen=True, eq=False)
class RowInfluence:
    """What one unit of radiance in a row's channel adds to a fit's numbers, to first order.

    at, photo : (r,), of each row; a photograph's rows are in the order of their points. sure : (size,), which points
    the rows determine. kd, ks : (r, 3), of the row's point. shared : (r, 3, k), of log sigma and log(mu - 1), as far as
    there are. own : (r, 3, 2), of Kd and Ks of the row's point, in its channel, these fixed. common : (r, 3), of the Ks
    that all points share, 0 where it varies. follow : (size, 3), by how much each point's Kd follows that. slopes :
    (size, 6, k), of points' Kd and Ks by sigma and mu.
    """

    at: Ints
    photo: Ints
    sure: NDArray[np.bool_]
    kd: Singles
    ks: Singles
    shared: Singles
    own: Singles
    common: Singles
    follow: Singles
    slopes: Singles

    def of_means(self, weights: Floats) -> Floats:
        """On log sigma and log(mu - 1), mean Kd and mean Ks, (r, 3, k + 6); weights : (size,), of points in means.

        Points that these rows don't determine don't count: more pixels do, and would be moved less than they are.
        """
        counted = weights * self.sure
        share = (counted / max(float(counted.sum()), 1e-300))[:, None]
        own = self.own * share[self.at][..., None]
        own[..., 0] += self.common * (share * self.follow).sum(axis=0)
        own[..., 1] += self.common
        k = self.shared.shape[2]
        moved = np.zeros((len(self.at), 3, k + 6))
        moved[..., :k] = self.shared
        moved[..., k:] = self.shared @ (share[..., None] * self.slopes).sum(axis=0).T
        for channel in range(3):
            moved[:, channel, [k + channel, k + 3 + channel]] += own[:, channel]
        return moved


@dataclass(frozen=True, eq=False)
class PointInfluence:
    """What one unit of radiance in a row's channel adds to Kd and Ks of points, sigma and mu fixed.

    own : (r, 3, 2), common : (r, 3), follow : (size, 3), as of `RowInfluence`. Numbers that are zero stay so.
    """

    solved: SolvedPoints
    own: Floats
    common: Floats
    follow: Floats

    @classmethod
    def of(cls, here: SolvedPoints) -> PointInfluence:
        """Of a solution of all points."""
        stack, values, sums = here.stack, here.values, here.sums
        kd_free, ks_free = values.kd > 0, values.ks > 0
        none = np.zeros_like(sums.dd)
        by_dd, by_ds, by_ss = _over(kd_free, sums.dd), none, none
        common, follow = np.zeros_like(here.d), none
        at, d, s, weight = stack.at, here.d, here.s, stack.weight
        if here.model.ks_varies:
            determinant = sums.dd * sums.ss - sums.ds**2
            both = kd_free & ks_free & (determinant > 1e-6 * sums.dd * sums.ss)
            inverse = _over(both, determinant)
            by_dd = np.where(both, sums.ss * inverse, by_dd)
            by_ds = -sums.ds * inverse
            by_ss = np.where(both, sums.dd * inverse, _over(ks_free & ~kd_free, sums.ss))
        elif here.model.specular:
            # All points share Ks; their Kd follow it.
            follow = -sums.ds * by_dd
            total = (sums.ss + sums.ds * follow).sum(axis=0)
            common = weight * (s + follow[at] * d) * _over(ks_free[0], total)
        own = [weight * (by_dd[at] * d + by_ds[at] * s), weight * (by_ds[at] * d + by_ss[at] * s)]
        return cls(here, np.stack(own, axis=-1), common, follow)

    def moved(self, change: Floats) -> tuple[Floats, Floats]:
        """By how much Kd and Ks of points, (size, 3) each, move with a change (r, 3) of the rows."""
        added = self.solved.stack.added
        ks = (self.common * change).sum(axis=0)
        return added(self.own[..., 0] * change) + self.follow * ks, added(self.own[..., 1] * change) + ks

    def left_of(self, change: Floats) -> Floats:
        """What Kd and Ks of the points don't make up for of a change (r, 3) of the rows."""
        (kd, ks), solved = self.moved(change), self.solved
        return change - kd[solved.stack.at] * solved.d - ks[solved.stack.at] * solved.s


def influence_of(points: PointInfluence, shared: Floats, changes: Sequence[Floats]) -> RowInfluence:
    """Of a solution of all points.

    shared : as of `RowInfluence`. changes : for each coordinate of the search (r, 3), derivatives of the rows by it, Kd
    and Ks fixed.
    """
    solved = points.solved
    slopes = np.zeros((len(solved.values.kd), 6, len(changes)))
    for k, change in enumerate(changes):
        # What the lobe shows more, Kd and Ks make up for.
        slopes[..., k] = -np.concatenate(points.moved(change), axis=1)
    arrays = (solved.kd, solved.ks, shared, points.own, points.common, points.follow, slopes)
    kd, ks, *rest = (of.astype(np.float32) for of in arrays)
    return RowInfluence(solved.stack.at, solved.stack.photo, determined(solved.values), kd, ks, *rest)


def _over(free: NDArray[np.bool_], of: Floats) -> Floats:
    """1 / of, where that is free and above zero; else 0."""
    usable = free & (of > 0)
    return np.where(usable, 1 / np.where(usable, of, 1), 0.0)
