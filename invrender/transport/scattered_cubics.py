"""Values at scattered rays of a picture from those at few of them, its nodes.

Around each node runs a polynomial, cubic over normals and linear in views, fitted to its neighbours; rays take what
those of the nearest nodes say [Renka 1988, "Multivariate interpolation of large sets of scattered data"].
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import KDTree

from capture.parallel import parallel_map
from recon.mesh.tangents import tangents

Floats = NDArray[np.float64]
Ints = NDArray[np.int64]

# Nodes that a cubic is fitted to, and whose cubics a ray takes.
_FITTED, _BLENDED = 20, 4
# Of a cubic over two numbers, and what is linear in three.
_TERMS = 10 + 3
# How the error grows with the distance to nodes: by the third power, from few tested nodes.
ERROR_ORDER = 3
# Views count as apart by so many radians where the half-vector takes up what they change; and below which exitant
# cosine it doesn't, with a typical cosine of each band from there to grazing.
_VIEWS_APART = 0.3
_BANDS = ((0.3, None), (0.15, 0.2), (0.07, 0.1), (-1.0, 0.05))
# What keeps bands apart, beyond all other distances.
_APART = 1e3
# Nodes, or rays, that are worked on at once.
_AT_A_TIME = 4000


@dataclass(frozen=True, eq=False)
class RayPlaces:
    """Where rays lie in the space that they are interpolated in.

    normals : (m, 3) over the lobe's width, as they would be if all views were alike: half-way between the mirrored view
    and the mean view; near grazing, where that is ill-posed, the normals themselves. others : (m, 3), the views, in
    units of what they change. features : (m, 7), all of it, and the band of exitant cosines.
    """

    normals: Floats
    others: Floats
    features: Floats

    @classmethod
    def of(cls, normals: Floats, views: Floats, width: float) -> RayPlaces:
        mean = views.mean(axis=0)
        mean /= np.linalg.norm(mean)
        cos = (normals * views).sum(axis=1)
        limits = [limit for limit, _ in _BANDS[:-1]]
        band = len(limits) - np.searchsorted(limits[::-1], cos, side="right")
        half, unit = normals.copy(), np.empty(len(normals))
        for place, (_, typical) in enumerate(_BANDS):
            rays = band == place
            if typical is None:
                half[rays] += (mean - views[rays]) / (2 * cos[rays, None])
                unit[rays] = _VIEWS_APART
            else:
                unit[rays] = 2 * width * typical
        half /= width * np.linalg.norm(half, axis=1, keepdims=True)
        others = views / unit[:, None]
        return cls(half, others, np.column_stack([half, others, _APART * band]))


@dataclass(frozen=True, eq=False)
class NearNodes:
    """The nearest nodes of rays: distances and numbers, (r, count) each."""

    distances: Floats
    numbers: Ints

    @property
    def spacing(self) -> Floats:
        """How far (r,) rays lie from those that they take."""
        return np.asarray(self.distances[:, :_BLENDED].mean(axis=1))

    def expected(self, steepness: Floats) -> Floats:
        """Errors (r,) that rays are to expect, from those found at nodes, (k,), over distance^ERROR_ORDER."""
        found = steepness[self.numbers[:, :_BLENDED]]
        return np.asarray(np.sqrt(np.mean(found**2, axis=1)) * self.spacing**ERROR_ORDER)

    def where(self, keep: NDArray[np.bool_] | slice) -> NearNodes:
        """Of some of the rays."""
        return NearNodes(self.distances[keep], self.numbers[keep])


@dataclass(frozen=True, eq=False)
class ScatteredCubics:
    """Polynomials around nodes: cubic over normals, linear in views.

    nodes : (k,), rays. values : (k, c). frames : (k, 2, 3), tangents. reach : (k,), to the farthest node that each was
    fitted to. coefficients : (k, terms, c), over normals in units of the reach.
    """

    places: RayPlaces
    nodes: Ints
    values: Floats
    tree: KDTree
    frames: Floats
    reach: Floats
    coefficients: Floats

    @classmethod
    def around(cls, places: RayPlaces, nodes: Ints, values: Floats) -> ScatteredCubics:
        """Fitted to nodes (k,), rays, with values (k, c)."""
        none = cls._of(
            places, nodes, values, np.zeros(len(nodes)), np.zeros((len(nodes), _TERMS, values.shape[1]))
        )
        return none._refitted(np.arange(len(nodes)))

    def joined_by(self, new: Ints, values: Floats) -> ScatteredCubics:
        """With new nodes (n,), rays, and their values (n, c): what these lie within reach of is fitted anew."""
        features = self.places.features
        closest = KDTree(features[new]).query(features[self.nodes], workers=-1)[0]
        changed = np.concatenate([closest < self.reach, np.ones(len(new), bool)])
        grown = self._of(
            self.places,
            np.concatenate([self.nodes, new]),
            np.concatenate([self.values, values]),
            np.concatenate([self.reach, np.zeros(len(new))]),
            np.concatenate([self.coefficients, np.zeros((len(new), *self.coefficients.shape[1:]))]),
        )
        return grown._refitted(np.flatnonzero(changed))

    @classmethod
    def _of(
        cls, places: RayPlaces, nodes: Ints, values: Floats, reach: Floats, coefficients: Floats
    ) -> ScatteredCubics:
        normals = places.normals[nodes]
        frames = tangents(normals / np.linalg.norm(normals, axis=1, keepdims=True))
        return cls(places, nodes, values, KDTree(places.features[nodes]), frames, reach, coefficients)

    def _refitted(self, which: Ints) -> ScatteredCubics:
        """With the cubics of some nodes fitted to all nodes' values."""
        normals, others = self.places.normals[self.nodes], self.places.others[self.nodes]

        def fitted(block: slice) -> tuple[Floats, Floats]:
            some = which[block]
            distances, near = self.tree.query(
                self.places.features[self.nodes[some]], min(_FITTED, len(self.nodes))
            )
            same = distances < _APART / 2
            distances = np.where(same, distances, 0)
            reach = distances.max(axis=1) + 1e-9
            offsets = normals[near] - normals[some, None]
            across = offsets @ self.frames[some].transpose(0, 2, 1) / reach[:, None, None]
            terms = _terms(across, others[near] - others[some, None])
            weights = np.where(same, np.exp(-2 * (distances / reach[:, None]) ** 2), 0)
            weights[:, 0] = 3
            weighted = (terms * weights[:, :, None]).transpose(0, 2, 1)
            # Few or flat neighbours leave terms open: these stay small.
            held = np.full(_TERMS, 1e-5)
            held[0], held[-3:] = 0, 1e-3
            squares = weighted @ terms + np.diag(held) * weights.sum(axis=1)[:, None, None]
            return reach, np.linalg.solve(squares, weighted @ self.values[near])

        reach, coefficients = self.reach.copy(), self.coefficients.copy()
        blocks = _blocks(len(which))
        for block, (own, of_own) in zip(blocks, parallel_map(fitted, blocks), strict=True):
            reach[which[block]], coefficients[which[block]] = own, of_own
        return replace(self, reach=reach, coefficients=coefficients)

    def near(self, rays: Ints) -> NearNodes:
        """The nodes nearest to rays (r,); those in other bands count as at the edge."""
        count = min(_BLENDED + 1, len(self.nodes))

        def found(block: slice) -> tuple[Floats, Ints]:
            distances, numbers = self.tree.query(self.places.features[rays[block]], np.arange(1, count + 1))
            return np.minimum(distances, _APART / 2), numbers

        distances, numbers = zip(*parallel_map(found, _blocks(len(rays))), strict=True)
        return NearNodes(np.concatenate(distances), np.concatenate(numbers))

    def at(self, rays: Ints, near: NearNodes | None = None) -> Floats:
        """Values (r, c) at rays; near : of these, if they are known."""
        near = near or self.near(rays)
        parts = parallel_map(lambda block: self._blended(rays[block], near.where(block)), _blocks(len(rays)))
        return np.concatenate(list(parts))

    def _blended(self, rays: Ints, near: NearNodes) -> Floats:
        reach = near.distances[:, -1:] * 1.0001 + 1e-12
        own = np.maximum(near.distances[:, :-1], 1e-6 * reach)
        weights = ((reach - own) / (reach * own)) ** 2
        weights /= weights.sum(axis=1, keepdims=True)
        normals, others = self.places.normals, self.places.others
        result = np.zeros((len(rays), self.values.shape[1]))
        for weight, node in zip(weights.T, near.numbers.T, strict=False):
            ray = self.nodes[node]
            apart = (self.frames[node] @ (normals[rays] - normals[ray])[:, :, None])[:, :, 0]
            terms = _terms(apart / self.reach[node, None], others[rays] - others[ray])
            result += weight[:, None] * (terms[:, None] @ self.coefficients[node])[:, 0]
        return result


def _blocks(count: int) -> list[slice]:
    """So many numbers, 0 or more, in blocks that caches hold what is made of."""
    return [slice(start, start + _AT_A_TIME) for start in range(0, max(count, 1), _AT_A_TIME)]


def _terms(across: Floats, others: Floats) -> Floats:
    """Terms (..., _TERMS) of cubics in tangents' coordinates (..., 2), and of views (..., 3)."""
    a, b = across[..., 0], across[..., 1]
    cubic = [np.ones_like(a), a, b, a * a, a * b, b * b, a**3, a * a * b, a * b * b, b**3]
    return np.concatenate([np.stack(cubic, axis=-1), others], axis=-1)
