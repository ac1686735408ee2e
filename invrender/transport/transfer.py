"""Transfer: what one element of the lighting sends through the diffuse and the specular part of the BRDF.

Of an element with near sources, it is what points see of it, `at` them. For sources both are closed forms [RH01, eq.
23]. For a lat-long map the diffuse part is a
convolution [RH01, eq. 15], the specular part an integral over half-vectors (`half_vectors`).
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace
from functools import cached_property, lru_cache

import cv2
import numpy as np
from numpy.typing import NDArray

from capture.lighting import Lighting, cosines, latlong_directions, latlong_solid_angles, seen_from
from invrender.theory.lambertian import irradiance
from invrender.theory.specialcases import lobe
from invrender.transport.half_vectors import PreparedMap, map_transfer
from recon.harmonics.latlong import map_coefficients

Floats = NDArray[np.float64]
Singles = NDArray[np.float32]

# The clamped cosine falls off as l^(-5/2), and the degrees of a map with bright windows hardly at all.
_DIFFUSE_DEGREE = 24
# A pixel of a map is a source of its own when it holds this share of all light and stands out this far.
_SOURCE_SHARE, _SOURCE_CONTRAST, _MAX_SOURCES = 1e-3, 4.0, 64


@dataclass(frozen=True, eq=False)
class LightElement:
    """A part of the lighting whose strength is one number per channel (1 where known).

    name : "known", "source 1", "ambient". channels : 3, or 1 where all channels share the transfer.
    directions, irradiances : (k, 3) and (k, channels), sources; directions (k, 4) where some are near, which at points
    become (m, k, 3), and irradiances (m, k, channels).
    slow_map : (H, 2H, channels) float32 or None, what varies slowly enough to be looked up.
    uniform : radiance from all sides, in units of the element's strength.
    finer : whether its map is integrated with more half-vectors than fits take.
    """

    name: str
    directions: Floats
    irradiances: Floats
    slow_map: Singles | None = None
    uniform: float = 0.0
    finer: bool = False

    @property
    def channels(self) -> int:
        return self.irradiances.shape[-1]

    def at(self, positions: Floats) -> LightElement:
        """The element as points (m, 3) see it, metres in the world; itself where all its sources are far away."""
        if self.directions.shape[-1] == 3:
            return self
        directions, factors = seen_from(self.directions, positions)
        return replace(self, directions=directions, irradiances=factors[..., None] * self.irradiances)

    def nearer(self, closeness: float, centre: Floats) -> LightElement:
        """The element with its far sources so near to a centre (3,), 1/m; itself with none, or where some are near."""
        if not len(self.directions) or self.directions.shape[-1] == 4:
            return self
        near = np.column_stack(
            [self.directions + closeness * centre, np.full(len(self.directions), closeness)]
        )
        return replace(self, directions=near)

    def cosines(self, normals: Floats) -> Floats:
        """Cosines (m, k) of incidence at unit normals (m, 3), 0 of sources below the horizon."""
        return np.maximum(cosines(normals, self.directions), 0)

    def falling(self, shares: Floats) -> Floats:
        """Irradiance (m, channels) of sources that count by shares (m, k), cosines say."""
        if self.irradiances.ndim == 2:
            return np.asarray(shares @ self.irradiances)
        return np.einsum("mk,mkc->mc", shares, self.irradiances)

    @property
    def sources(self) -> Iterator[tuple[Floats, Floats]]:
        """Direction, (3,) or (m, 3), and irradiance, (channels,) or (m, channels), of each source."""
        count = self.irradiances.shape[-2]
        return ((self.directions[..., k, :], self.irradiances[..., k, :]) for k in range(count))

    @cached_property
    def diffuse_coefficients(self) -> Floats | None:
        """Harmonic coefficients of the map, ((l + 1)^2, channels), as far as diffuse reflection shows them."""
        return None if self.slow_map is None else map_coefficients(self.slow_map, _DIFFUSE_DEGREE)

    @cached_property
    def prepared_map(self) -> PreparedMap | None:
        """The map made ready for the half-vector integral."""
        if self.slow_map is None:
            return None
        prepared = PreparedMap.of(self.slow_map)
        return prepared.finer if self.finer else prepared

    @property
    def sources_alone(self) -> LightElement:
        """The element's directional sources without the rest."""
        return replace(self, slow_map=None, uniform=0.0)

    @cached_property
    def without_sources(self) -> LightElement:
        """The rest of the element, from which its directional sources are taken."""
        return replace(self, directions=np.zeros((0, 3)), irradiances=np.zeros((0, self.channels)))


def light_elements(lighting: Lighting) -> tuple[LightElement, ...]:
    """A lighting as elements: everything known in one ("known"), then each strength to be recovered."""
    elements = []
    directions, irradiances = np.zeros((0, 3)), np.zeros((0, 3))
    slow_map = None
    if not lighting.recover_irradiance:
        directions, irradiances = lighting.sources, lighting.irradiances
    if lighting.radiance_map is not None and not lighting.recover_ambient:
        slow_map, hot_directions, hot_irradiances = split_map(lighting.radiance_map)
        hot = np.column_stack([hot_directions, np.zeros((len(hot_directions), directions.shape[1] - 3))])
        directions = np.concatenate([directions, hot])
        irradiances = np.concatenate([irradiances, hot_irradiances])
    if len(directions) or slow_map is not None:
        elements.append(LightElement("known", directions, irradiances, slow_map))
    if lighting.recover_irradiance:
        elements += [
            LightElement(f"source {k + 1}", direction[None], np.ones((1, 1)))
            for k, direction in enumerate(lighting.sources)
        ]
    if lighting.recover_ambient:
        elements.append(LightElement("ambient", np.zeros((0, 3)), np.zeros((0, 1)), uniform=1.0))
    return tuple(elements)


def split_map(radiance_map: Singles) -> tuple[Singles, Floats, Floats]:
    """A map as a slow part and compact sources [RH01, section 5.3: slow and fast-varying lighting].

    Returns the map with its outstanding pixels levelled to their neighbourhood, and directions (k, 3) and
    irradiances (k, 3) of what was taken off. The total light is unchanged. The neighbourhood is what is left of the
    map without all that is narrower than five pixels: a lamp of several pixels doesn't hide in its own surroundings.
    """
    height = radiance_map.shape[0]
    weights = latlong_solid_angles(height)[:, :, None]
    padded = np.pad(radiance_map, ((2, 2), (2, 2), (0, 0)), mode="wrap")
    neighbourhood = cv2.morphologyEx(padded, cv2.MORPH_OPEN, np.ones((5, 5), np.uint8))[2:-2, 2:-2]
    excess = radiance_map - neighbourhood
    flux = (excess * weights).sum(axis=2)
    total = float((radiance_map * weights).sum())
    hot = (flux > _SOURCE_SHARE * total) & (
        radiance_map.sum(axis=2) > _SOURCE_CONTRAST * neighbourhood.sum(axis=2)
    )
    rows, columns = np.nonzero(hot)
    strongest = np.argsort(-flux[rows, columns])[:_MAX_SOURCES]
    rows, columns = rows[strongest], columns[strongest]
    slow = radiance_map.copy()
    slow[rows, columns] = neighbourhood[rows, columns]
    irradiances = (excess * weights)[rows, columns].astype(float)
    return slow, latlong_directions(height)[rows, columns], irradiances


def diffuse_transfer(element: LightElement, normals: Floats) -> Floats:
    """Irradiance (m, channels) at unit normals (m, 3) from a unit strength of the element."""
    result = element.falling(element.cosines(normals)) + np.pi * element.uniform
    if element.diffuse_coefficients is not None:
        result += irradiance(normals, element.diffuse_coefficients)
    return result


def specular_transfer(element: LightElement, normals: Floats, views: Floats, sigmas: Floats) -> Floats:
    """Reflected radiance (m, sigmas, channels) per unit of Ks F, from a unit strength of the element.

    normals, views : (m, 3) unit. sigmas : (j,) roughnesses in radians.
    """
    sigmas = np.atleast_1d(np.asarray(sigmas, float))
    cos_exitant = np.maximum((normals * views).sum(axis=1), 1e-6)
    result = np.zeros((len(normals), len(sigmas), element.channels))
    for direction, strength in element.sources:
        half = views + direction
        half /= np.maximum(np.linalg.norm(half, axis=1, keepdims=True), 1e-12)
        theta = np.arccos(np.clip((half * normals).sum(axis=1), -1, 1))
        lit = (normals * direction).sum(axis=1) > 0
        weight = np.where(lit, 1 / (4 * cos_exitant), 0.0)  # [RH01, eq. 23]
        result += (lobe(theta[:, None], sigmas) * weight[:, None])[:, :, None] * strength[..., None, :]
    if element.uniform:
        grid, table = _uniform_table(tuple(sigmas))
        for j in range(len(sigmas)):
            result[:, j, :] += element.uniform * np.interp(cos_exitant, grid, table[:, j])[:, None]
    if element.prepared_map is not None:
        result += map_transfer(element.prepared_map, normals, views, sigmas)
    return result


@lru_cache(maxsize=4)
def _uniform_table(sigmas: tuple[float, ...]) -> tuple[Floats, Floats]:
    """Specular transfer of unit uniform light against the exitant cosine: (grid,), (grid, sigmas)."""
    grid, normals, views = exitant_grid()
    white = PreparedMap.of(np.ones((4, 8, 1), np.float32))
    return grid, map_transfer(white, normals, views, np.array(sigmas))[:, :, 0]


def exitant_grid() -> tuple[Floats, Floats, Floats]:
    """Exitant cosines (193,) that a transfer of uniform light is tabulated at, and their normals and views, (193, 3).

    From 0.002 on: of a sphere's picture 4 millionths have less. They lie closer towards grazing, where 1 / cosine and
    Fresnel's factor rise.
    """
    cosines = 0.002 + 0.998 * np.linspace(0, 1, 193) ** 2
    views = np.stack([np.sqrt(1 - cosines**2), np.zeros_like(cosines), cosines], axis=-1)
    return cosines, np.broadcast_to([0.0, 0.0, 1.0], views.shape), views
