"""What a lobe reflects of a map, integrated for few rays and interpolated for all others of a picture.

Under distant light, what a lobe gathers hangs on the normal and the view alone: all its gradients come from curvature
[RMB07, section 4.5]. So the rays of a picture are looked at over their normals, where the lobe's width is the same all
over, and not over pixels. There the integral is taken for one ray to a cell, with cells the smaller, the more the last
ones showed that the interpolation is off. Around each such node runs a cubic, fitted to its neighbours; rays take
what the cubics of the nearest nodes say [Renka 1988, "Multivariate interpolation of large sets of scattered data"].

What is interpolated is the mean of the map that the lobe takes: what it gathers over what it would gather of uniform
light, so that Fresnel's factor and 1 / cos theta_o stay exact.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import KDTree

from capture.parallel import parallel_map
from invrender.brdf.form import part_width
from invrender.brdf.microfacet import Microfacet
from invrender.transport.form_transfer import OneIndex, form_transfer
from invrender.transport.transfer import LightElement
from recon.mesh.tangents import tangents

Floats = NDArray[np.float64]
Ints = NDArray[np.int64]
# Normals and views (m, 3) to what arrives from there, (m, c).
Integral = Callable[[Floats, Floats], Floats]

# Cells' sides in widths of the lobe: the first, by what share they shrink, and how often at most.
_FIRST_CELL, _SHRINKS, _SIZES = 1.8, 0.6, 7
# Nodes that a cubic is fitted to, and whose cubics a ray takes.
_FITTED, _BLENDED = 20, 4
# How the error grows with the distance to nodes: by the third power, from few tested nodes.
_ORDER = 3
# In the dark, errors may be so many times the tolerance of what is there: below what shows.
_LOCALLY = 2
# Views count as apart by so many radians where the half-vector takes up what they change; and below which exitant
# cosine it doesn't, with a typical cosine of each band from there to grazing.
_VIEWS_APART = 0.3
_BANDS = ((0.3, None), (0.15, 0.2), (0.07, 0.1), (-1.0, 0.05))
# What keeps bands apart, beyond all other distances.
_APART = 1e3
# Nodes, or rays, that are worked on at once.
_AT_A_TIME = 1000
# Fewer rays than this for each first cell: then there is nothing to save.
_FEW_PER_CELL = 4


@dataclass(frozen=True, eq=False)
class InterpolatedLobe:
    """A BRDF's lobe under an element's map.

    tolerance : RMS error of what is reflected over its RMS, of a picture.
    """

    brdf: Microfacet
    light: LightElement
    tolerance: float

    # Least exitant cosine that `towards` holds for.
    least_cos = 0.0

    def towards(self, normals: Floats, views: Floats) -> Floats:
        """Radiance (m, c) per unit of Ks, Fresnel's factor included; normals, views : (m, 3), unit."""
        brdf = self.brdf
        assert brdf.sigma is not None
        sigma, fresnel = np.array([brdf.sigma]), OneIndex(brdf.mu)
        white = LightElement("uniform", np.zeros((0, 3)), np.zeros((0, 1)), uniform=1.0)

        def gathered(light: LightElement, normals: Floats, views: Floats) -> Floats:
            return np.asarray(form_transfer(brdf.form, light, normals, views, sigma, fresnel)[:, 0, 0], float)

        factors = [factor for _, factor in brdf.form.parts] or [1.0]
        width = min(float(part_width(np.array(factor), sigma)[0]) for factor in factors)
        return interpolated(
            lambda n, v: gathered(self._mapped, n, v),
            gathered(white, normals, views)[:, 0],
            normals,
            views,
            width,
            self.tolerance,
        )

    @cached_property
    def _mapped(self) -> LightElement:
        # All parts of a picture share what is made ready of the map.
        return replace(self.light.without_sources, finer=True)


def interpolated(
    integral: Integral, uniform: Floats, normals: Floats, views: Floats, width: float, tolerance: float
) -> Floats:
    """An integral over a lobe at all rays (m, c), taken at few of them.

    uniform : (m,), the same of unit uniform light. normals, views : (m, 3) unit, of one picture. width : of the lobe,
    radians. tolerance : RMS error over the integral's RMS.
    """
    places = _Places.of(normals, views, width)
    # Any order does in which neighbours don't follow each other.
    order = np.random.default_rng(0).permutation(len(normals))

    def means(rays: Ints) -> Floats:
        return integral(normals[rays], views[rays]) / uniform[rays, None]

    nodes = _one_per_cell(places.features, _FIRST_CELL, order)
    if len(nodes) * _FEW_PER_CELL > len(normals):
        return integral(normals, views)
    values = means(nodes)
    allowed = tolerance * np.sqrt(np.mean((values * uniform[nodes, None]) ** 2))
    found = np.full(len(normals), np.nan)  # error over distance^_ORDER, of tested nodes
    for size in range(1, _SIZES):
        cubics = _Cubics.around(places, nodes, values)
        new = np.setdiff1d(_one_per_cell(places.features, _FIRST_CELL * _SHRINKS**size, order), nodes)
        predicted = cubics.at(new)
        if size > 1:
            expected = cubics.nearby(found[nodes], new) * uniform[new]
            here = np.sqrt(np.mean(predicted**2, axis=1)) * uniform[new]
            asked = expected > np.minimum(allowed, _LOCALLY * tolerance * here)
            new, predicted = new[asked], predicted[asked]
        if not len(new):
            break
        there = means(new)
        error = np.sqrt(np.mean((there - predicted) ** 2, axis=1))
        found[new] = error / cubics.spacing(new) ** _ORDER
        if size == 1:
            # The first cells' nodes take what was found beside them.
            found[nodes] = _Cubics.around(places, new, there).nearest(found[new], nodes)
        nodes, values = np.concatenate([nodes, new]), np.concatenate([values, there])
    result = _Cubics.around(places, nodes, values).at(np.arange(len(normals)))
    result[nodes] = values
    return np.asarray(np.maximum(result, 0) * uniform[:, None])


@dataclass(frozen=True, eq=False)
class _Places:
    """Where rays lie in the space that they are interpolated in.

    normals : (m, 3) over the lobe's width, as they would be if all views were alike: half-way between the mirrored view
    and the mean view; near grazing, where that is ill-posed, the normals themselves. others : (m, 3), the views, in
    units of what they change. features : (m, 7), all of it, and the band of exitant cosines.
    """

    normals: Floats
    others: Floats
    features: Floats

    @classmethod
    def of(cls, normals: Floats, views: Floats, width: float) -> _Places:
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
class _Cubics:
    """Polynomials around nodes: cubic over normals, linear in views.

    nodes : (k,), rays. coefficients : (k, terms, c), over normals in units of each node's reach, (k,).
    """

    places: _Places
    nodes: Ints
    tree: KDTree
    frames: Floats
    reach: Floats
    coefficients: Floats

    @classmethod
    def around(cls, places: _Places, nodes: Ints, values: Floats) -> _Cubics:
        """Fitted to nodes (k,), rays, with values (k, c)."""
        features = places.features[nodes]
        tree = KDTree(features)
        normals, others = places.normals[nodes], places.others[nodes]
        frames = tangents(normals / np.linalg.norm(normals, axis=1, keepdims=True))

        def fitted(some: slice) -> tuple[Floats, Floats]:
            distances, near = tree.query(features[some], min(_FITTED, len(nodes)))
            same = distances < _APART / 2
            distances = np.where(same, distances, 0)
            reach = distances.max(axis=1) + 1e-9
            offsets = normals[near] - normals[some, None]
            across = offsets @ frames[some].transpose(0, 2, 1) / reach[:, None, None]
            terms = _terms(across, others[near] - others[some, None])
            weights = np.where(same, np.exp(-2 * (distances / reach[:, None]) ** 2), 0)
            weights[:, 0] = 3
            weighted = (terms * weights[:, :, None]).transpose(0, 2, 1)
            # Few or flat neighbours leave terms open: these stay small.
            held = np.full(terms.shape[2], 1e-5)
            held[0], held[-3:] = 0, 1e-3
            squares = weighted @ terms + np.diag(held) * weights.sum(axis=1)[:, None, None]
            return reach, np.linalg.solve(squares, weighted @ values[near])

        reach, coefficients = map(
            np.concatenate, zip(*parallel_map(fitted, _blocks(len(nodes))), strict=True)
        )
        return cls(places, nodes, tree, frames, reach, coefficients)

    def at(self, rays: Ints) -> Floats:
        """Values (r, c) at rays."""
        return np.concatenate(list(parallel_map(lambda some: self._at(rays[some]), _blocks(len(rays)))))

    def _at(self, rays: Ints) -> Floats:
        distances, near = self._near(rays, _BLENDED + 1)
        reach = distances[:, -1:] * 1.0001 + 1e-12
        own = np.maximum(distances[:, :-1], 1e-6 * reach)
        weights = ((reach - own) / (reach * own)) ** 2
        weights /= weights.sum(axis=1, keepdims=True)
        normals, others = self.places.normals, self.places.others
        result = np.zeros((len(rays), self.coefficients.shape[2]))
        for weight, node in zip(weights.T, near.T, strict=False):
            ray = self.nodes[node]
            apart = (self.frames[node] @ (normals[rays] - normals[ray])[:, :, None])[:, :, 0]
            terms = _terms(apart / self.reach[node, None], others[rays] - others[ray])
            result += weight[:, None] * (terms[:, None] @ self.coefficients[node])[:, 0]
        return result

    def spacing(self, rays: Ints) -> Floats:
        """How far (r,) rays lie from the nearest nodes."""
        return np.asarray(self._near(rays, _BLENDED)[0].mean(axis=1))

    def nearby(self, found: Floats, rays: Ints) -> Floats:
        """Errors (r,) that rays are to expect, from those found at nodes, (k,), over distance^_ORDER."""
        distances, near = self._near(rays, _BLENDED)
        return np.asarray(np.sqrt(np.mean(found[near] ** 2, axis=1)) * distances.mean(axis=1) ** _ORDER)

    def nearest(self, values: Floats, rays: Ints) -> Floats:
        """Those of the nodes' values (k,) that lie nearest to rays, (r,)."""
        return np.asarray(values[self._near(rays, 1)[1][:, 0]])

    def _near(self, rays: Ints, count: int) -> tuple[Floats, Ints]:
        """Distances and numbers, (r, count) each, of the nearest nodes; those in other bands count as at the edge."""
        count = min(count, len(self.nodes))
        distances, near = self.tree.query(self.places.features[rays], np.arange(1, count + 1))
        return np.minimum(distances, _APART / 2), near


def _blocks(count: int) -> list[slice]:
    """So many numbers in blocks that caches hold what is made of."""
    return [slice(start, start + _AT_A_TIME) for start in range(0, count, _AT_A_TIME)]


def _terms(across: Floats, others: Floats) -> Floats:
    """Terms (..., 13) of cubics in tangents' coordinates (..., 2), and of views (..., 3)."""
    a, b = across[..., 0], across[..., 1]
    cubic = [np.ones_like(a), a, b, a * a, a * b, b * b, a**3, a * a * b, a * b * b, b**3]
    return np.concatenate([np.stack(cubic, axis=-1), others], axis=-1)


def _one_per_cell(features: Floats, side: float, order: Ints) -> Ints:
    """The first of the rays, in an order, in each cell of a grid."""
    cells = np.floor(features[order] / side).astype(np.int64)
    # Distinct cells share a number once in 10^13 pairs; then one cell goes without a node.
    keys = cells @ np.random.default_rng(1).integers(2**40, 2**62, cells.shape[1])
    return order[np.unique(keys, return_index=True)[1]]
