"""What a lobe reflects of a map, integrated for few rays and interpolated for all others of a picture.

Under distant light, what a lobe gathers hangs on the normal and the view alone: all its gradients come from curvature
[RMB07, section 4.5]. So the rays of a picture are looked at over their normals, where the lobe's width is the same all
over, and not over pixels. There the integral is taken for one ray to a cell, with cells the smaller, the more the last
ones showed that the interpolation is off. All other rays are interpolated between these nodes (`scattered_cubics`).
A sphere's have a grid of their own (`sphere_rays`).

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

from invrender.brdf.form import part_width
from invrender.brdf.microfacet import Microfacet
from invrender.transport.form_transfer import OneIndex, form_transfer
from invrender.transport.scattered_cubics import ERROR_ORDER, RayPlaces, ScatteredCubics
from invrender.transport.sphere_rays import SphereLobe, SphereRays
from invrender.transport.transfer import LightElement

Floats = NDArray[np.float64]
Ints = NDArray[np.int64]
# Normals and views (m, 3) to what arrives from there, (m, c).
Integral = Callable[[Floats, Floats], Floats]

# Cells' sides in widths of the lobe: the first, by what share they shrink, and how often at most.
_FIRST_CELL, _SHRINKS, _SIZES = 1.8, 0.6, 7
# In the dark, errors may be so many times the tolerance of what is there: below what shows.
_LOCALLY = 2
# Fewer rays than this for each first cell: then there is nothing to save.
_FEW_PER_CELL = 4


@dataclass(frozen=True, eq=False)
class InterpolatedLobe:
    """A BRDF's lobe under an element's map.

    tolerance : RMS error of what is reflected over its RMS, of a picture; 0 integrates for each ray. sphere : the rays
    of the picture, if it is of a sphere. finer : whether the integral takes more half-vectors than fits do.
    """

    brdf: Microfacet
    light: LightElement
    tolerance: float
    sphere: SphereRays | None = None
    finer: bool = True

    # Least exitant cosine that `towards` holds for.
    least_cos = 0.0

    def towards(self, normals: Floats, views: Floats) -> Floats:
        """Radiance (m, c) per unit of Ks, Fresnel's factor included; normals, views : (m, 3), unit."""
        if self.tolerance == 0:
            return self._integrated(normals, views)
        if self.over_sphere is not None:
            return self.over_sphere.towards(normals, views)
        white = LightElement("uniform", np.zeros((0, 3)), np.zeros((0, 1)), uniform=1.0)
        uniform = self._gathered(white, normals, views)[:, 0]
        return interpolated(self._integrated, uniform, normals, views, self._width, self.tolerance)

    def _integrated(self, normals: Floats, views: Floats) -> Floats:
        return self._gathered(self._mapped, normals, views)

    def _gathered(self, light: LightElement, normals: Floats, views: Floats) -> Floats:
        sigma, fresnel = np.array([self.brdf.sigma], float), OneIndex(self.brdf.mu)
        return np.asarray(
            form_transfer(self.brdf.form, light, normals, views, sigma, fresnel)[:, 0, 0], float
        )

    @property
    def _width(self) -> float:
        """Of the lobe's narrowest part, radians."""
        factors = [factor for _, factor in self.brdf.form.parts] or [1.0]
        sigma = np.array([self.brdf.sigma], float)
        return min(float(part_width(np.array(factor), sigma)[0]) for factor in factors)

    @cached_property
    def over_sphere(self) -> SphereLobe | None:
        """The same for a sphere's rays, if there is one."""
        if self.sphere is None:
            return None
        return SphereLobe(self.sphere, self._integrated, self._width, self.brdf.mu, self.tolerance)

    @cached_property
    def _mapped(self) -> LightElement:
        # All parts of a picture share what is made ready of the map.
        return replace(self.light.without_sources, finer=self.finer)


def interpolated(
    integral: Integral, uniform: Floats, normals: Floats, views: Floats, width: float, tolerance: float
) -> Floats:
    """An integral over a lobe at all rays (m, c), taken at few of them.

    uniform : (m,), the same of unit uniform light. normals, views : (m, 3) unit, of one picture. width : of the lobe,
    radians. tolerance : RMS error over the integral's RMS.
    """
    places = RayPlaces.of(normals, views, width)
    # Any order does in which neighbours don't follow each other.
    order = np.random.default_rng(0).permutation(len(normals))

    def means(rays: Ints) -> Floats:
        return integral(normals[rays], views[rays]) / uniform[rays, None]

    nodes = _one_per_cell(places.features, _FIRST_CELL, order)
    if len(nodes) * _FEW_PER_CELL > len(normals):
        return integral(normals, views)
    values = means(nodes)
    allowed = tolerance * np.sqrt(np.mean((values * uniform[nodes, None]) ** 2))
    cubics = ScatteredCubics.around(places, nodes, values)
    steepness = np.empty(0)  # of tested nodes: error over distance^ERROR_ORDER
    for size in range(1, _SIZES):
        new = np.setdiff1d(
            _one_per_cell(places.features, _FIRST_CELL * _SHRINKS**size, order),
            cubics.nodes,
            assume_unique=True,
        )
        near = cubics.near(new)
        predicted = cubics.at(new, near)
        if size > 1:
            expected = near.expected(steepness) * uniform[new]
            here = np.sqrt(np.mean(predicted**2, axis=1)) * uniform[new]
            asked = expected > np.minimum(allowed, _LOCALLY * tolerance * here)
            new, near, predicted = new[asked], near.where(asked), predicted[asked]
        if not len(new):
            break
        there = means(new)
        error = np.sqrt(np.mean((there - predicted) ** 2, axis=1))
        found = error / near.spacing**ERROR_ORDER
        if size == 1:
            # The first cells' nodes take what was found beside them.
            beside = KDTree(places.features[new]).query(places.features[nodes])[1]
            steepness = found[beside]
        steepness = np.concatenate([steepness, found])
        cubics = cubics.joined_by(new, there)
    result = cubics.at(np.arange(len(normals)))
    result[cubics.nodes] = cubics.values
    return np.asarray(np.maximum(result, 0) * uniform[:, None])


def _one_per_cell(features: Floats, side: float, order: Ints) -> Ints:
    """The first of the rays, in an order, in each cell of a grid."""
    cells = np.floor(features[order] / side).astype(np.int64)
    # Distinct cells share a number once in 10^13 pairs; then one cell goes without a node.
    keys = cells @ np.random.default_rng(1).integers(2**40, 2**62, cells.shape[1])
    return order[np.unique(keys, return_index=True)[1]]
