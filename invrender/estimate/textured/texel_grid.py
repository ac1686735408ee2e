"""The points that a texture is solved for, and those that its values are given at: how they lie together."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import csr_array

Floats = NDArray[np.float64]
Ints = NDArray[np.int64]

# Pairs of neighbours that tell how far these lie apart.
_MANY = 100_000


@dataclass(frozen=True, eq=False)
class Grid:
    """Points that are solved for, and those that values are given at.

    parents : (p,), the point that each belongs to, -1 for none. count : of these. pairs : (m, 2), neighbours.
    """

    parents: Ints
    count: int
    pairs: Ints

    def of_points(self, solved: Ints, given: Ints) -> tuple[Grid, Ints]:
        """The grid of some of the points that are solved for, and of those that values are given at, by their numbers.

        Returns with it the numbers of the latter: of `given`, and of all others that points which are solved belong to.
        """
        number = np.full(len(self.parents), -1, np.int64)
        number[solved] = np.arange(len(solved))
        pairs = number[self.pairs]
        parents = self.parents[solved]
        given = np.union1d(given, parents[parents >= 0])
        renumbered = np.where(parents >= 0, np.searchsorted(given, parents), -1)
        return Grid(renumbered, len(given), pairs[(pairs >= 0).all(axis=1)]), given

    def spacing(self, positions: Floats) -> float:
        """How far neighbours lie apart, the median, for positions (p, 3)."""
        if not len(self.pairs):
            return 0.0
        one, other = positions[self.pairs[:_MANY]].transpose(1, 0, 2)
        return float(np.median(np.linalg.norm(one - other, axis=1)))

    @property
    def means(self) -> csr_array:
        """Means (count, p) over the points that belong to each."""
        own = np.flatnonzero(self.parents >= 0)
        size = np.bincount(self.parents[own], minlength=self.count)
        entries = ((1 / size[self.parents[own]]).astype(np.float32), (self.parents[own], own))
        return csr_array(entries, shape=(self.count, len(self.parents)))

    @property
    def neighbours(self) -> csr_array:
        """Means (count, count) over each point and those beside it."""
        sides = self.parents[self.pairs]
        sides = np.unique(sides[(sides >= 0).all(axis=1) & (sides[:, 0] != sides[:, 1])], axis=0)
        itself = np.arange(self.count)
        rows = np.concatenate([sides[:, 0], sides[:, 1], itself])
        columns = np.concatenate([sides[:, 1], sides[:, 0], itself])
        size = np.bincount(rows, minlength=self.count)
        return csr_array((1 / size[rows], (rows, columns)), shape=(self.count, self.count))

    @property
    def laplacian(self) -> csr_array:
        """The matrix (p, p) of the sum of squared differences between neighbours."""
        one, other = self.pairs.T
        entries = np.ones(len(one), np.float32)
        links = csr_array((entries, (one, other)), shape=(len(self.parents),) * 2)
        links = links + links.T
        degree = np.asarray(links.sum(axis=1)).ravel()
        diagonal = np.arange(len(degree))
        return csr_array((degree, (diagonal, diagonal)), shape=links.shape) - links


@dataclass(frozen=True, eq=False)
class SurfaceTiles:
    """A surface cut into boxes along the axes that hold about equally many of its points.

    low, high : (t, 3) metres, infinite where nothing lies beyond.
    """

    low: Floats
    high: Floats

    @classmethod
    def cut(cls, positions: Floats, count: int) -> SurfaceTiles:
        """So many tiles of points (n, 3), cut across wherever they reach farthest."""
        bounds: list[tuple[Floats, Floats]] = []

        def halve(points: Floats, low: Floats, high: Floats, count: int) -> None:
            if count == 1:
                bounds.append((low, high))
                return
            axis = int(np.argmax(np.ptp(points, axis=0)))
            cut = float(np.quantile(points[:, axis], (count // 2) / count))
            below, above = high.copy(), low.copy()
            below[axis] = above[axis] = cut
            beneath = points[:, axis] < cut
            halve(points[beneath], low, below, count // 2)
            halve(points[~beneath], above, high, count - count // 2)

        halve(positions, np.full(3, -np.inf), np.full(3, np.inf), count)
        low, high = (np.array(side) for side in zip(*bounds, strict=True))
        return cls(low, high)

    def __len__(self) -> int:
        return len(self.low)

    def holds(self, tile: int, positions: Floats, reach: float = 0.0) -> NDArray[np.bool_]:
        """Which of positions (n, 3) lie in a tile, or up to so many metres beyond it along the axes."""
        low, high = self.low[tile] - reach, self.high[tile] + reach
        return np.asarray(((positions >= low) & (positions < high)).all(axis=1))
