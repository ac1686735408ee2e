"""Kd and Ks of each point of a surface: many tiny linear problems at once [RH01, section 6.4].

For one point and channel the photographs say B = Kd d + Ks s, with known transfers d and s. The normal equations of all
points are added up photograph by photograph; what they take in memory doesn't depend on how many there are.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass, fields

import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.float64]
Ints = NDArray[np.int64]

# A value with a standard deviation above this share of what is usual on the surface isn't given.
_HOPELESS = 0.5


@dataclass(frozen=True, eq=False)
class TexelEquations:
    """Weighted normal equations of n points, (n, 3) each but for `count` (n,), the observations."""

    dd: Floats
    ds: Floats
    ss: Floats
    dy: Floats
    sy: Floats
    yy: Floats
    count: Floats

    @classmethod
    def of(cls, added: Floats, count: Floats) -> TexelEquations:
        """Equations from sums (n, 18) over each point's `products`, and how many observations these are of, (n,)."""
        dd, ds, ss, dy, sy, yy = np.split(added, 6, axis=1)
        return cls(dd, ds, ss, dy, sy, yy, count)

    @classmethod
    def zeros(cls, points: int) -> TexelEquations:
        dd, ds, ss, dy, sy, yy = np.zeros((6, points, 3))
        return cls(dd, ds, ss, dy, sy, yy, np.zeros(points))

    def __add__(self, other: TexelEquations) -> TexelEquations:
        return TexelEquations(*(getattr(self, f.name) + getattr(other, f.name) for f in fields(self)))

    def __sub__(self, other: TexelEquations) -> TexelEquations:
        return TexelEquations(*(getattr(self, f.name) - getattr(other, f.name) for f in fields(self)))


def products(
    d: NDArray[np.floating], s: NDArray[np.floating], y: NDArray[np.floating], weight: NDArray[np.floating]
) -> NDArray[np.floating]:
    """What observations, transfers and radiance (r, 3), add to the equations of their points: (r, 18)."""
    pairs = ((d, d), (d, s), (s, s), (d, y), (s, y), (y, y))
    return np.concatenate([weight * one * other for one, other in pairs], axis=1)


@dataclass(frozen=True, eq=False)
class PointValues:
    """Kd and Ks of n points with their standard deviations, (n, 3); infinite where undetermined.

    cost : (n, 3), weighted sum of squared residuals. freedom : (n,), observations less numbers fitted, per channel.
    """

    kd: Floats
    ks: Floats
    kd_std: Floats
    ks_std: Floats
    cost: Floats
    freedom: Floats

    def where(self, index: Ints) -> PointValues:
        """Those of some of the points, by their numbers (m,)."""
        return PointValues(*(getattr(self, f.name)[index] for f in fields(self)))

    @classmethod
    def together(cls, count: int, parts: Iterable[tuple[Ints, PointValues]]) -> PointValues:
        """Values of so many points from parts, each with the numbers of its points; those of no part are open."""
        zeros, infinite = np.zeros((3, count, 3)), np.full((2, count, 3), np.inf)
        whole = cls(zeros[0], zeros[1], infinite[0], infinite[1], zeros[2], np.full(count, -1.0))
        for index, part in parts:
            for f in fields(cls):
                getattr(whole, f.name)[index] = getattr(part, f.name)
        return whole


def determined(values: PointValues, scale: Floats | None = None) -> NDArray[np.bool_]:
    """Which points (n,) have seen as much as they have numbers, with standard deviations below half the scale of all.

    scale : (3,), by default the median of Kd + Ks over those that have a standard deviation.
    """
    found = _all_seen(values)
    if found.any():
        limit = _HOPELESS * (_scale(values) if scale is None else scale)
        found &= ((values.kd_std < limit) & (values.ks_std < limit)).all(axis=1)
    return np.asarray(found)


@dataclass(frozen=True, eq=False)
class Usual:
    """What is usual on a surface.

    values : (6,), Kd and Ks, means over what is determined; single points that aren't may be far off. scale, settled :
    (3,), as of `determined`, before outliers are known and after.
    """

    values: Floats
    scale: Floats
    settled: Floats

    @classmethod
    def of(cls, first: PointValues, settled: PointValues) -> Usual:
        """Of values of its points before outliers are known, and after."""
        sure, both = determined(first), np.concatenate([first.kd, first.ks], axis=1)
        mean = both[sure].mean(axis=0) if sure.any() else np.zeros(6)
        return cls(mean, _scale(first), _scale(settled))


def _scale(values: PointValues) -> Floats:
    found = _all_seen(values)
    return np.asarray(np.median((values.kd + values.ks)[found], axis=0)) if found.any() else np.zeros(3)


def _all_seen(values: PointValues) -> NDArray[np.bool_]:
    """Which points (n,) have seen as much as they have numbers, in all channels."""
    return np.asarray((values.freedom >= 0) & np.isfinite(values.kd_std + values.ks_std).all(axis=1))


def solve_both(sums: TexelEquations) -> PointValues:
    """Kd and Ks of each point, neither below zero."""
    determinant = sums.dd * sums.ss - sums.ds**2
    # Transfers that are the same up to a factor, to single precision, don't separate Kd from Ks.
    apart = determinant > 1e-6 * sums.dd * sums.ss
    safe = np.where(apart, determinant, 1.0)
    kd = np.where(apart, (sums.ss * sums.dy - sums.ds * sums.sy) / safe, 0.0)
    ks = np.where(apart, (sums.dd * sums.sy - sums.ds * sums.dy) / safe, 0.0)
    kd_std = np.sqrt(np.where(apart, sums.ss / safe, np.inf))
    ks_std = np.sqrt(np.where(apart, sums.dd / safe, np.inf))
    # Where one would be negative it is zero, and the other is the best without it.
    matte, dark = ks < 0, kd < 0
    kd = np.where(matte, _ratio(sums.dy, sums.dd), np.where(dark, 0.0, kd))
    ks = np.where(dark & ~matte, _ratio(sums.sy, sums.ss), np.where(matte, 0.0, ks))
    kd, ks = np.maximum(kd, 0), np.maximum(ks, 0)
    return PointValues(kd, ks, kd_std, ks_std, _cost(sums, kd, ks), sums.count - 2)


def solve_kd(sums: TexelEquations, ks: Floats) -> PointValues:
    """Kd of each point, not below zero, where Ks is that of the whole object, (3,)."""
    kd = np.maximum(_ratio(sums.dy - ks * sums.ds, sums.dd), 0)
    everywhere = np.broadcast_to(ks, kd.shape)
    std = np.sqrt(_ratio(np.ones_like(sums.dd), sums.dd, np.inf))
    return PointValues(kd, everywhere, std, np.zeros_like(kd), _cost(sums, kd, everywhere), sums.count - 1)


def common_ks(sums: TexelEquations) -> tuple[Floats, Floats]:
    """The Ks (3,) that all points share best, each having a Kd of its own, and its standard deviation."""
    gram = (sums.ss - _ratio(sums.ds**2, sums.dd)).sum(axis=0)
    right = (sums.sy - _ratio(sums.ds * sums.dy, sums.dd)).sum(axis=0)
    known = gram > 1e-9 * sums.ss.sum(axis=0)
    ks = np.where(known, right / np.where(known, gram, 1), 0.0)
    return np.maximum(ks, 0), np.sqrt(np.where(known, 1 / np.where(known, gram, 1), np.inf))


def made_up_for(
    sums: TexelEquations, values: PointValues, ks_varies: bool, by_d: Floats, by_s: Floats
) -> Floats:
    """How much (k, k) of the sums of products of k changes of the radiance Kd and Ks make up for, if solved for anew.

    values : the solution there; what is zero stays so. ks_varies : False where all points share Ks. by_d, by_s :
    (n, k, 3), each point's weighted sums of the changes times its transfers.
    """
    kd_free, ks_free = values.kd > 0, values.ks > 0
    by_d, dd = by_d * kd_free[:, None], sums.dd * kd_free
    by_kd = _ratio(by_d, dd[:, None])
    total = np.einsum("nac,nbc->ab", by_d, by_kd)
    # What Kd leaves of the changes, and of what Ks makes.
    ds = sums.ds * kd_free
    left, by_ks = sums.ss - _ratio(ds**2, dd), by_s - ds[:, None] * by_kd
    if not ks_varies:
        by_ks, left = by_ks.sum(axis=0, keepdims=True), left.sum(axis=0, keepdims=True)
        ks_free = ks_free[:1]
    # Transfers that are the same up to a factor, to single precision, don't separate Kd from Ks.
    left = np.where(ks_free & (left > 1e-6 * sums.ss[: len(left)]), left, 0.0)
    return total + np.einsum("nac,nbc->ab", by_ks, _ratio(by_ks, left[:, None]))


def _cost(sums: TexelEquations, kd: Floats, ks: Floats) -> Floats:
    square = kd**2 * sums.dd + 2 * kd * ks * sums.ds + ks**2 * sums.ss
    return np.maximum(sums.yy - 2 * (kd * sums.dy + ks * sums.sy) + square, 0)


def _ratio(numerator: Floats, denominator: Floats, otherwise: float = 0.0) -> Floats:
    positive = denominator > 0
    return np.where(positive, numerator / np.where(positive, denominator, 1), otherwise)
