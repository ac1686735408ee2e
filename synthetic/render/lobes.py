"""Reflected radiance by numerical integration over the directions that light comes from.

    B(n, wo) = integral over the hemisphere about n of rho(wi, wo) L(wi) cos(theta_i) dwi

This is what the fit is judged by, so it shares no formula with it: no spherical harmonics, no filtered
maps, no integral over half vectors. Every integral is a product of Gauss-Legendre and trapezoid rules over
incident directions, in polar coordinates whose pole makes the integrand smooth; they converge exponentially.
"""

from __future__ import annotations

from collections.abc import Sequence
from concurrent.futures import ThreadPoolExecutor
from functools import lru_cache
from threading import Lock

import numpy as np
from numpy.typing import NDArray
from scipy.interpolate import CubicSpline

from capture.parallel import cores
from synthetic.lights.arealight import AreaLight
from synthetic.lights.sources import DirectionalSource
from synthetic.materials.microfacet import MicrofacetMaterial
from synthetic.render.specular_table import SpecularTable

Floats = NDArray[np.float64]

# Half-width of the lobe that is integrated, in sigma: outside, S is below exp(-16) = 1e-7 of its peak.
_LOBE_EXTENT = 4.0
# Pairs of point and direction at a time: arrays of this many float32 stay in the cache.
_PAIRS_PER_CHUNK = 1 << 17
# Who brings no more than these spreads the work over the cores alone; threads within threads wait for each other.
_FEW_CHUNKS = 64
# Exitant cosine below which a table isn't good enough: the lobe grows there without bound.
_STEEP = 0.1
# Nodes of the irradiance table; its spline is good to 1e-7 of the peak for a light 0.1 rad wide.
_IRRADIANCE_NODES = 257


def reflected_radiance(
    material: MicrofacetMaterial,
    area_lights: Sequence[AreaLight],
    sources: Sequence[DirectionalSource],
    normals: Floats,
    views: Floats,
    order: int = 16,
    tabled: bool = False,
) -> Floats:
    """Radiance (n, 3) that leaves a convex surface towards the viewer; zero where it faces away.

    normals, views : (n, 3) unit; outward, and towards the viewer.
    order : nodes per polar angle of the quadrature over the specular lobe, which has 2 order^2 directions.
        The default is good to 1e-4 of the specular part for area lights no narrower than 2 sigma.
    tabled : whether integrals are interpolated between those of a table, which many more points share.
    """
    facing = np.flatnonzero((normals * views).sum(axis=1) > 0)
    n, wo = normals[facing], views[facing]
    radiance = np.zeros((len(facing), 3))
    for source in sources:
        cos_i = np.maximum(n @ source.direction, 0)
        radiance += material.evaluate(n, source.direction, wo) * cos_i[:, None] * source.irradiance
    if area_lights and len(facing):
        for light in area_lights:
            radiance += material.kd * light.radiance * irradiance(light, n)[:, None]
        fresnel = material.fresnel(np.minimum((n * wo).sum(axis=1), 1))
        specular = _tabled_specular if tabled else _specular
        gathered = fresnel[:, None] * specular(material, area_lights, n, wo, order)
        for light, lobe in zip(area_lights, gathered.T, strict=True):
            radiance += material.ks * light.radiance * lobe[:, None]
    result = np.zeros_like(normals, dtype=float)
    result[facing] = radiance
    return result


def irradiance(light: AreaLight, normals: Floats) -> Floats:
    """Irradiance (n,) from a light of unit radiance on its axis, per normal (n, 3).

    The light is symmetric about its axis, so the irradiance depends on the angle between normal and axis alone.
    """
    spline = _irradiance_by_angle(light.width_rad)
    return np.asarray(spline(np.arccos(np.clip(normals @ light.axis, -1, 1))))


@lru_cache(maxsize=16)
def _irradiance_by_angle(width_rad: float) -> CubicSpline:
    """Irradiance over the angle between normal and axis, from a table.

    For each angle the hemisphere is integrated, its pole being the normal, where cos(theta_i) has no kink.
    """
    light = AreaLight(np.array([0.0, 0.0, 1.0]), np.ones(3), width_rad)
    # Nodes at most 0.8 of the light's width apart, which a Gaussian needs for ten digits.
    order = max(32, int(np.ceil(4 / width_rad)))
    angle = np.linspace(0, np.pi, _IRRADIANCE_NODES)
    node, weight = np.polynomial.legendre.leggauss(order)
    cos_i, weight = (node + 1) / 2, weight / 2
    phi = np.arange(2 * order) * np.pi / order
    along = np.cos(angle)[:, None, None] * cos_i[:, None]
    across = np.sin(angle)[:, None, None] * np.sqrt(1 - cos_i**2)[:, None] * np.cos(phi)
    ring_means = light.profile(along + across).mean(axis=2)
    table = 2 * np.pi * ring_means @ (weight * cos_i)
    # Even about both ends, so the slope vanishes there.
    return CubicSpline(angle, table, bc_type="clamped")


def _specular(
    material: MicrofacetMaterial, lights: Sequence[AreaLight], normals: Floats, views: Floats, order: int
) -> Floats:
    """Integral of S L / (4 cos_o) over the incident hemisphere, (n, lights), for lights of unit radiance."""
    size = max(1, _PAIRS_PER_CHUNK // order**2)
    starts = range(0, len(normals), size)

    def chunk(start: int) -> Floats:
        part = slice(start, start + size)
        return _specular_chunk(material, lights, normals[part], views[part], order)

    if not starts:
        return np.zeros((0, len(lights)))
    if len(starts) <= _FEW_CHUNKS:
        return np.concatenate([chunk(start) for start in starts])
    with ThreadPoolExecutor(cores()) as pool:
        return np.concatenate(list(pool.map(chunk, starts)))


def _tabled_specular(
    material: MicrofacetMaterial, lights: Sequence[AreaLight], normals: Floats, views: Floats, order: int
) -> Floats:
    """`_specular` between the points of tables, to 1e-5 of its RMS; towards steep views itself."""
    steep = (normals * views).sum(axis=1) < _STEEP
    found = np.empty((len(normals), len(lights)))
    found[steep] = _specular(material, lights, normals[steep], views[steep], order)
    for column, light in enumerate(lights):
        table = _table(material.sigma, light.width_rad, order)
        found[~steep, column] = table.at(normals[~steep], views[~steep], light.axis)
    return found


# Who needs the same table waits for the first to make it.
_ONE_AT_A_TIME = Lock()


def _table(sigma: float, width_rad: float, order: int) -> SpecularTable:
    with _ONE_AT_A_TIME:
        return _kept_table(sigma, width_rad, order)


@lru_cache(maxsize=8)
def _kept_table(sigma: float, width_rad: float, order: int) -> SpecularTable:
    material = MicrofacetMaterial(np.zeros(3), np.ones(3), None, sigma)

    def gathered(normals: Floats, views: Floats, axis: Floats) -> Floats:
        return _specular(material, [AreaLight(axis, np.ones(3), width_rad)], normals, views, order)[:, 0]

    return SpecularTable.of(gathered, sigma, width_rad)


def _specular_chunk(
    material: MicrofacetMaterial, lights: Sequence[AreaLight], normals: Floats, views: Floats, order: int
) -> Floats:
    """`_specular` of a few points, all directions at once.

    Incident directions are at polar angle beta and azimuth phi about the viewer, the normal lying at phi = 0:
    there the half vector is at (beta / 2, phi), and the lobe keeps its width of sigma in it however grazing
    the view (about any fixed axis it shrinks with cos_o, and no fixed grid finds it). Two bounds hold beta:
    the lobe's extent, and the horizon, at which the integrand jumps (its cosines cancel), so that a grid
    across it would converge slowly.
    """
    cos_o = (normals * views).sum(axis=1)
    tangent = normals - cos_o[:, None] * views
    sin_o = np.linalg.norm(tangent, axis=1)
    # Facing the viewer, any tangent will do.
    spare = np.cross(views, np.eye(3)[np.abs(views).argmin(axis=1)])
    tangent = np.where(sin_o[:, None] > 1e-9, tangent, spare)
    tangent /= np.linalg.norm(tangent, axis=1, keepdims=True)
    bitangent = np.cross(views, tangent)
    theta_o = np.arctan2(sin_o, cos_o)

    # The cone of half vectors around the normal, seen from the viewer: an interval of azimuths, or all.
    extent = _LOBE_EXTENT * material.sigma
    outside = (theta_o > extent) & (extent < np.pi / 2)
    ratio = np.sin(min(extent, np.pi / 2)) / np.where(outside, sin_o, 1.0)
    reach = np.where(outside, np.arcsin(np.minimum(ratio, 1)), np.pi)
    # The lobe is the same at phi and -phi: it is computed for one of them.
    phi = reach[:, None] * ((np.arange(order) + 0.5) / order)
    cos_phi, sin_phi = np.cos(phi), np.sin(phi)

    low = 2 * np.maximum(theta_o - extent, 0)[:, None]
    horizon = np.arctan2(cos_o[:, None], -sin_o[:, None] * cos_phi)
    high = np.minimum(horizon, 2 * (theta_o + extent)[:, None])
    span = np.maximum(high - low, 0)
    node, weight = np.polynomial.legendre.leggauss(order)

    # From here on (points, azimuths, polar angles) in single precision, good to 1e-5 of the sum.
    def single(values: Floats) -> NDArray[np.float32]:
        return values.astype(np.float32)[..., None]

    half_beta = single(low / 2) + single(span / 2) * ((node + 1) / 2).astype(np.float32)
    sin, cos = np.sin(half_beta), np.cos(half_beta)
    cos_half = single(sin_o[:, None] * cos_phi) * sin + single(cos_o[:, None]) * cos
    sin_beta = 2 * sin * cos
    lobe = material.facets(cos_half) * sin_beta * (weight / 2).astype(np.float32)

    measure = span * (reach / order / (4 * cos_o))[:, None]
    sums = np.zeros((len(normals), len(lights)))
    for column, light in enumerate(lights):
        level = single((views @ light.axis)[:, None]) * (1 - 2 * sin * sin)
        forward = (tangent @ light.axis)[:, None] * cos_phi
        sideways = (bitangent @ light.axis)[:, None] * sin_phi
        for across in (forward + sideways, forward - sideways):
            seen = light.profile(single(across) * sin_beta + level)
            sums[:, column] += (np.einsum("pak,pak->pa", lobe, seen) * measure).sum(axis=1)
    return sums
