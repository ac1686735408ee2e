"""Which of the pixels that were looked at a budget of samples takes, and what each sample stands for."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from recon.sampling.candidates import Candidates

Floats = NDArray[np.float64]
Ints = NDArray[np.int64]

# Part of the budget that is drawn by the information in pixels, and rounds in which probabilities that reach 1 are set
# aside.
_TELLING, _ROUNDS = 0.4, 8
# Of a budget, what of small highlights is taken beside it at most.
_HIGHLIGHTS = 0.2
# Bands of latitude by which normals are grouped; twice as many sectors in each, all of one solid angle.
_BANDS = 16


def draw(
    normals: Floats, telling: Floats, budget: int, rng: np.random.Generator, stands_for: Floats
) -> tuple[Ints, Floats]:
    """About `budget` of n samples, ascending, and what each stands for: evenly over normals, more where pixels are
    informative.

    normals : (n, 3). telling : (n,) >= 0, in any unit. stands_for : (n,), as of `Candidates`. A part of the budget is
    spread evenly over normals, the rest drawn with probabilities in proportion to the information in pixels (RMB07,
    section 6: sampling by gradients). A sample stands for its probability in an even draw over that in this one
    [Horvitz and Thompson 1952], so that sums stay unbiased.
    """
    even = _inclusion(_cells(normals), budget, stands_for)
    return by_information(even, telling, budget, rng)


def by_information(
    even: Floats, telling: Floats, budget: float, rng: np.random.Generator
) -> tuple[NDArray[np.int64], Floats]:
    """As `draw`, of samples whose even draw is given; all of them where the budget holds all.

    even : (n,), the probability with which an even draw of the budget takes each sample. telling : (n,) >= 0.
    """
    if budget >= len(even):
        return np.arange(len(even)), even / even.mean()
    drawn = 1 - (1 - (1 - _TELLING) * even) * (1 - _proportional(telling, _TELLING * budget))
    # Systematically along a random order: as many as the probabilities add up to, none twice.
    order = rng.permutation(len(even))
    total = np.cumsum(drawn[order]) + rng.random()
    taken = np.sort(order[np.floor(total) > np.floor(total - drawn[order])])
    shares = even[taken] / drawn[taken]
    return taken, shares / shares.mean()


def spread_with_highlights(
    normals: Floats, looked_at: Candidates, budget: int, rng: np.random.Generator
) -> tuple[Ints, Floats]:
    """Samples (k,) of n, evenly over normals (n, 3), with small highlights beside the budget, and what each stands for.

    A pixel of a highlight stands for the chance by which it would be drawn evenly, over that by which it is [Horvitz
    and Thompson 1952].
    """
    ordinary = np.flatnonzero(looked_at.at_random)
    drawn = ordinary[spread(normals[ordinary], budget, rng)]
    _, place = np.unique(_cells(normals), return_inverse=True)
    size = place.max() + 1
    counts = np.bincount(place[ordinary], minlength=size)
    taken = (np.bincount(place[drawn], minlength=size) / np.maximum(counts, 1))[place]
    kept = np.zeros(len(normals), bool)
    kept[drawn] = True
    left = np.flatnonzero(looked_at.bright & ~kept)
    more = rng.permutation(left)[: int(_HIGHLIGHTS * len(drawn))]
    beside = len(more) / max(len(left), 1)
    kept[more] = True
    chance, found = looked_at.chance, looked_at.found
    # A cell's count is raised: one over a small random count is, in the mean, more than one over the mean count.
    evenly = chance * taken * (counts / (counts + 1 - chance))[place]
    # By chance nothing of a highlight's cell may be drawn, nor more of it.
    either = np.maximum(evenly + beside * (chance * (1 - taken) + (1 - chance) * found), 1e-12)
    shares = np.where(looked_at.bright, evenly / either, 1.0)[kept]
    return np.flatnonzero(kept), shares / shares.mean()


def _inclusion(cell: Ints, budget: float, stands_for: Floats) -> Floats:
    """Probabilities (n,) with which an even draw over cells takes samples, by their cells and what they stand for."""
    place = np.unique(cell, return_inverse=True)[1]
    counts = np.bincount(place, weights=stands_for)
    if len(cell) <= budget:
        return stands_for
    # The quota that fills the budget: cells with fewer give all that they have.
    ascending = np.sort(counts)
    before = np.cumsum(ascending) - ascending
    quotas = (budget - before) / (len(ascending) - np.arange(len(ascending)))
    quota = quotas[np.argmax(quotas <= ascending)]
    return np.asarray(np.minimum(1, quota / counts)[place] * stands_for)


def _proportional(telling: Floats, budget: float) -> Floats:
    """Probabilities (n,) in proportion to numbers, as far as 1 allows, that add up to a budget where they can."""
    result = np.zeros(len(telling))
    rest = telling > 0
    for _ in range(_ROUNDS):
        if not rest.any() or result.sum() >= budget:
            break
        result[rest] = np.minimum(1, telling[rest] * ((budget - result[~rest].sum()) / telling[rest].sum()))
        rest &= result < 1
    return result


def spread(normals: Floats, budget: int, rng: np.random.Generator) -> NDArray[np.int64]:
    """Which `budget` of n samples to take, ascending, so that all normals (n, 3) count as evenly as can be.

    The sphere of normals is cut into cells of one solid angle; the same number is drawn from each, all from those that
    have fewer. A flat face of a mesh would otherwise take the budget of all that curves.
    """
    cell = _cells(normals)
    # In an order that is random within each cell, a sample's rank says whether its cell's quota takes it.
    order = rng.permutation(len(cell))
    order = order[np.argsort(cell[order], kind="stable")]
    sorted_cell = cell[order]
    first = np.flatnonzero(np.diff(sorted_cell, prepend=-1))
    rank = np.arange(len(order)) - np.repeat(first, np.diff(first, append=len(order)))
    # Ranks in turn: the first of each cell, the second of each ...; within one rank cells in random order.
    turn = np.lexsort((rng.random(len(order)), rank))
    return np.sort(order[turn[:budget]])


def _cells(normals: Floats) -> Ints:
    """The cell (n,) of the sphere of normals that each lies in; all have one solid angle."""
    band = np.minimum(((normals[:, 2] + 1) / 2 * _BANDS).astype(int), _BANDS - 1)
    azimuth = np.arctan2(normals[:, 1], normals[:, 0]) / (2 * np.pi) + 0.5
    sectors = 2 * _BANDS
    return np.asarray(band * sectors + np.minimum((azimuth * sectors).astype(int), sectors - 1))
