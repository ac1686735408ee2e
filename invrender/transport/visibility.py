"""What visibility does to transfer: a mesh keeps light from itself [RH01, section 6.4].

Three parts of the reflected light field, three rules:

- light of a directional source, diffuse and specular, counts where the ray towards it is free; where the border of a
  shadow runs through a pixel, by the share of it that is lit;
- the irradiance from all else is that of the clear sky at the normal, less what the mesh hides of it: its shadow, known
  per vertex and degree (`recon.mesh.transfer`) and blended between vertices. What varies with the normal is thus exact
  at each ray, and only the shadow is interpolated;
- the lobe's integral over all else counts where the mirrored ray is free. RH01's approximation takes one ray for the
  whole lobe: it is weak where an edge stands in part of the lobe, within about 2 sigma of the mirrored direction, and
  there the light is either all counted or not at all.

What hides light counts as black; what it sends itself is added by `bounce`.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import csr_array

from capture.lighting import cosines, seen_from
from invrender.transport.transfer import LightElement, diffuse_transfer
from recon.harmonics.basis import clamped_cosine_transfer, degree_of, evaluate_harmonics, to_degree
from recon.mesh.bodies import MeshBody, blended, sees
from recon.mesh.tangents import tangents
from recon.mesh.transfer import TransferVectors
from recon.sampling.lightfield import LightField

Floats = NDArray[np.float64]
Mask = NDArray[np.bool_]
# Which of m rays: indices, or all.
Rays = NDArray[np.int64] | slice

MIN_COS = 0.03
# Steps of a ring of directions around another.
_AROUND = 6
# Where a ray's part of its pixel is looked at for the border of a shadow, in halves of its sides; and where one runs
# through it, how many points per side measure how much of it is lit.
_CORNERS = ((-1, -1), (1, -1), (-1, 1), (1, 1))
_PER_SIDE = 4
# How far above a facet such points lie, over their distance from the ray's own: above adjoining facets, mostly.
_LIFT = 0.2


@dataclass(frozen=True, eq=False)
class Shadows:
    """A mesh in the world, and what it hides of the sky.

    body : the mesh. shadow : (v, (l + 1)^2) per vertex, transfer of each harmonic without the mesh less that with it.
    """

    body: MeshBody
    shadow: NDArray[np.float32]

    @classmethod
    def of(cls, body: MeshBody, transfer: TransferVectors) -> Shadows:
        """The shadows of a mesh whose transfer vectors, in the world's axes, are known."""
        l_max = transfer.l_max
        per_degree = np.repeat(clamped_cosine_transfer(l_max), 2 * np.arange(l_max + 1) + 1)
        clear = per_degree * evaluate_harmonics(body.mesh.normals, l_max)
        return cls(body, (clear - transfer.coefficients).astype(np.float32))

    def visible(self, element: LightElement, field: LightField) -> RayVisibility:
        """What the rays of a photograph's samples see of an element's light."""
        assert field.faces is not None
        coefficients = _sky(element, self.l_max)
        hidden = None if coefficients is None else self.hidden(field, coefficients)
        sources = [self.lit(field, source) for source in element.directions]
        return RayVisibility(_columns(sources, len(field.faces)), field.reflected_visible, hidden)

    def of_vertices(self, element: LightElement) -> RayVisibility:
        """What vertices see of an element's light; nothing is said of mirrored rays, which they have none of."""
        mesh, coefficients = self.body.mesh, _sky(element, self.l_max)
        hidden = None if coefficients is None else self.kept_off(coefficients)
        sources = [sees(self.body, mesh.vertices, mesh.normals, source) for source in element.directions]
        return RayVisibility(
            _columns(sources, len(mesh.vertices)), np.zeros(len(mesh.vertices), bool), hidden
        )

    @property
    def l_max(self) -> int:
        """Degree up to which the shadow of the sky is known."""
        return degree_of(self.shadow.shape[1])

    def free(self, field: LightField, source: Floats) -> Mask:
        """Which rays (m,) of a photograph's samples meet the mesh where it sees a source, (3,) or (4,)."""
        assert field.faces is not None
        return sees(self.body, field.positions, self.body.facets[field.faces], source)

    def lit(self, field: LightField, source: Floats) -> Floats:
        """How much of each ray's part of its pixel (m,) sees a source, (3,) or (4,), 0 to 1.

        Without footprints all of it or nothing, as its ray does.
        """
        assert field.faces is not None
        lit = self.free(field, source).astype(float)
        if field.footprints is None:
            return lit
        # What turns away is dark all over.
        towards = cosines(self.body.facets[field.faces], seen_from(source[None], field.positions)[0])[:, 0]
        rays = np.flatnonzero((towards > 0) & field.footprints.any(axis=(1, 2)))
        corners = [sees(self.body, *self._beside(field, rays, *corner), source) for corner in _CORNERS]
        crossed = rays[np.any([corner != (lit[rays] > 0) for corner in corners], axis=0)]
        steps = (2 * np.arange(_PER_SIDE) + 1) / _PER_SIDE - 1
        points = [self._below(*self._beside(field, crossed, x, y)) for x in steps for y in steps]
        lit[crossed] = np.mean([sees(self.body, *point, source) for point in points], axis=0)
        return lit

    def _beside(
        self, field: LightField, rays: NDArray[np.int64], right: float, down: float
    ) -> tuple[Floats, Floats]:
        """Points (r, 3) in rays' parts of their pixels, -1 to 1 each way, just above the mesh, and the rays' facets."""
        assert field.faces is not None
        assert field.footprints is not None
        facets = self.body.facets[field.faces[rays]]
        off = 0.5 * (right * field.footprints[rays, 0] + down * field.footprints[rays, 1])
        lift = _LIFT * np.linalg.norm(off, axis=1, keepdims=True)
        return field.positions[rays] + off + lift * facets, facets

    def _below(self, points: Floats, facets: Floats) -> tuple[Floats, Floats]:
        """Where the mesh lies below points above facets (r, 3), and its facets there."""
        mesh = self.body.mesh
        found = self.body.tracer.first_hits(points, -facets)
        there = self.body.facets[found.faces]
        met = ((found.faces >= 0) & ((there * facets).sum(axis=1) > 0))[:, None]
        on = blended(mesh.vertices, mesh.faces[found.faces], found.weights)
        return np.where(met, on, points), np.where(met, there, facets)

    def around(self, field: LightField, towards: Floats, angle: float) -> Iterator[tuple[Mask, Mask]]:
        """Whether rays meet the mesh where it sees directions an angle (radians) off theirs, all around in a few steps.

        towards : (m, 3) or (3,) unit. Yields (m,) seen, and (m,) whether the direction is above the facet's horizon.
        """
        assert field.faces is not None
        facets = self.body.facets[field.faces]
        towards = np.broadcast_to(towards, facets.shape)
        across, other = np.moveaxis(tangents(towards), -2, 0)
        for turn in np.arange(_AROUND) * (2 * np.pi / _AROUND):
            off = np.cos(turn) * across + np.sin(turn) * other
            directions = np.cos(angle) * towards + np.sin(angle) * off
            seen = self.body.visible(field.positions, facets, directions)
            yield seen, (facets * directions).sum(axis=1) > 0

    def hidden(self, field: LightField, lighting: Floats) -> Floats:
        """Irradiance (m, c) at rays that the mesh keeps off, of harmonic light ((l + 1)^2, c)."""
        return self.at_rays(self.kept_off(lighting), field)

    def kept_off(self, lighting: Floats) -> Floats:
        """Irradiance (v, c) that the mesh keeps off its vertices, of harmonic light ((l + 1)^2, c)."""
        return np.asarray(self.shadow @ to_degree(lighting, self.l_max).astype(np.float32), float)

    def hidden_rows(self, field: LightField, l_max: int) -> Floats:
        """Rows (n, (l_max + 1)^2) of samples that yield what `hidden` does from light of degree l_max."""
        size = (l_max + 1) ** 2
        rows = np.zeros((len(field), size))
        known = self.shadow[:, :size]
        rows[:, : known.shape[1]] = field.mean_over_rays(self.at_rays(known, field))
        return rows

    def at_rays(self, values: NDArray[np.floating], field: LightField) -> Floats:
        """Values of the mesh's vertices (v, c) at rays on it, (m, c)."""
        assert field.faces is not None
        assert field.corner_weights is not None
        return blended(values, self.body.mesh.faces[field.faces], field.corner_weights)


@dataclass(frozen=True, eq=False)
class RayVisibility:
    """What m rays see of an element's light.

    sources : (m, k), how much of each of its directional sources, 0 to 1. mirrored : (m,), whether the mirror direction
    of the view is free, 0 or 1; of means of rays, the share of them. hidden : (m, channels), irradiance that the mesh
    keeps off, of all but the sources; None where there is no such light.
    """

    sources: Floats
    mirrored: NDArray[np.floating] | Mask
    hidden: Floats | None

    @property
    def of_sources(self) -> RayVisibility:
        """Of the element's sources alone."""
        return replace(self, hidden=None)

    def of_map(self, means: csr_array) -> RayVisibility:
        """Of all but the element's sources, for means (k, m) of the rays."""
        hidden = None if self.hidden is None else means @ self.hidden
        return RayVisibility(np.zeros((means.shape[0], 0)), means @ self.mirrored.astype(float), hidden)


def seen_diffuse(element: LightElement, normals: Floats, visible: RayVisibility | None) -> Floats:
    """`diffuse_transfer` under visibility, (m, channels), of an element at the normals' places.

    visible : None where nothing is hidden.
    """
    if visible is None:
        return diffuse_transfer(element, normals)
    total = element.falling(element.cosines(normals) * visible.sources)
    if visible.hidden is not None:
        # Below zero only by rounding, and by harmonics that end at some degree.
        total += np.maximum(diffuse_transfer(element.without_sources, normals) - visible.hidden, 0)
    return np.asarray(total)


def seen_specular(
    element: LightElement,
    visible: RayVisibility | None,
    gather: Callable[[LightElement, Rays], NDArray[np.floating]],
) -> NDArray[np.floating]:
    """What a lobe gathers of an element's light under visibility, (m, ...); visible : None where nothing is hidden.

    gather(part, rays) : what it gathers of a part of the light at some of the rays, (r, ...), nothing being hidden;
    `specular_transfer` of the part at these rays' places, say.
    """
    if visible is None:
        return gather(element, slice(None))
    total: NDArray[np.floating] | None = None
    parts = [] if visible.hidden is None else [(element.without_sources, visible.mirrored.astype(float))]
    parts += [(_source(element, k), seen) for k, seen in enumerate(visible.sources.T)]
    for part, seen in parts:
        rays = np.flatnonzero(seen)
        values, share = gather(part, rays), seen[rays]
        # Values may be a gigabyte, and most rays see all of a source.
        if (share != 1).any():
            values = values * share.astype(values.dtype).reshape(-1, *[1] * (values.ndim - 1))
        if total is None:
            total = np.zeros((len(seen), *values.shape[1:]), values.dtype)
            total[rays] = values
        else:
            total[rays] += values
    assert total is not None, "an element holds some light"
    return total


def _sky(element: LightElement, l_max: int) -> Floats | None:
    """Harmonic coefficients ((l_max + 1)^2, channels) of all of an element's light but its sources; None if none."""
    if element.diffuse_coefficients is None and not element.uniform:
        return None
    result = np.zeros(((l_max + 1) ** 2, element.channels))
    if element.diffuse_coefficients is not None:
        result += to_degree(element.diffuse_coefficients, l_max)
    result[0] += np.sqrt(4 * np.pi) * element.uniform
    return result


def _columns(seen: Sequence[NDArray[Any]], count: int) -> Floats:
    """Shares (count,) as columns; there may be none."""
    return np.array(seen, float).reshape(len(seen), count).T


def _source(element: LightElement, k: int) -> LightElement:
    one = slice(k, k + 1)
    return LightElement(element.name, element.directions[one], element.irradiances[one])


def facing(field: LightField) -> LightField:
    """The field, its normals that a mesh's smoothing turns away from the view turned back to it.

    The lobe as printed grows as 1 / cos theta_o: beyond 88 degrees a normal is taken to lie at 88, as of a sphere only
    the outermost 0.05% do.
    """
    normals = facing_normals(field.normals, field.views)
    return field if normals is field.normals else replace(field, normals=normals)


def facing_normals(normals: Floats, views: Floats) -> Floats:
    """Unit normals (m, 3), those at less than `MIN_COS` to their unit views (m, 3) turned back to that."""
    cos = (normals * views).sum(axis=1)
    turned = np.flatnonzero(cos < MIN_COS)
    if not len(turned):
        return normals
    across = normals[turned] - cos[turned, None] * views[turned]
    across /= np.maximum(np.linalg.norm(across, axis=1, keepdims=True), 1e-12)
    facing_us = normals.copy()
    facing_us[turned] = MIN_COS * views[turned] + np.sqrt(1 - MIN_COS**2) * across
    return facing_us
