"""Transfer: what one element of the lighting sends through the diffuse and the specular part of the BRDF.

For directional sources both are closed forms [RH01, eq. 23]. For a lat-long map the diffuse part is a
convolution [RH01, eq. 15]; the specular part is integrated exactly, without the symmetric-lobe
approximation of eq. 20, over half-vectors h: a source at wi(h) = 2 (wo.h) h - wo gives

    integral S(theta_h) L(wi(h)) (wo.h) / cos theta_o  dh     over  n.wi > 0, wo.h > 0.

Rings of constant theta_h around the normal make the lobe S a weight per ring, so that all roughnesses
share one walk through the map.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache

import cv2
import numpy as np
from numpy.typing import NDArray

from capture.lighting import Lighting, latlong_directions, latlong_pixels, latlong_solid_angles
from invrender.model.microfacet import lobe
from invrender.theory.harmonics import project_latlong
from invrender.theory.lambertian import irradiance

Floats = NDArray[np.float64]
Singles = NDArray[np.float32]

# Ring radii grow by this factor (its logarithm): the trapezoid rule in log theta converges exponentially
# for a Gaussian lobe, and 0.22 leaves 1e-6; the rest of the fineness is for the map's structure.
_LOG_STEP = 0.22
_FIRST_RING, _LAST_RING = 0.004, 1.5
_RAYS_PER_CHUNK = 1024
_PAD = 2
# Turns one ring against the next so that azimuths never line up.
_GOLDEN_ANGLE = np.pi * (3 - np.sqrt(5))
# The clamped cosine falls off as l^(-5/2): what is left beyond degree 10 is below 0.1% of a map.
_DIFFUSE_DEGREE = 10
# A pixel of a map is a source of its own when it holds this share of all light and stands out this far.
_SOURCE_SHARE, _SOURCE_CONTRAST, _MAX_SOURCES = 1e-3, 4.0, 64


@dataclass(frozen=True, eq=False)
class LightElement:
    """A part of the lighting whose strength is one number per channel (1 where known).

    name : "known", "source 1", "ambient". channels : 3, or 1 where all channels share the transfer.
    directions, irradiances : (k, 3) and (k, channels), directional sources.
    slow_map : (H, 2H, channels) float32 or None, what varies slowly enough to be looked up.
    uniform : radiance from all sides, in units of the element's strength.
    """

    name: str
    directions: Floats
    irradiances: Floats
    slow_map: Singles | None = None
    uniform: float = 0.0

    @property
    def channels(self) -> int:
        return self.irradiances.shape[1]


def light_elements(lighting: Lighting) -> tuple[LightElement, ...]:
    """A lighting as elements: everything known in one ("known"), then each strength to be recovered."""
    elements = []
    directions, irradiances = np.zeros((0, 3)), np.zeros((0, 3))
    slow_map = None
    if not lighting.recover_irradiance:
        directions, irradiances = lighting.directions, lighting.irradiances
    if lighting.radiance_map is not None and not lighting.recover_ambient:
        slow_map, hot_directions, hot_irradiances = split_map(lighting.radiance_map)
        directions = np.concatenate([directions, hot_directions])
        irradiances = np.concatenate([irradiances, hot_irradiances])
    if len(directions) or slow_map is not None:
        elements.append(LightElement("known", directions, irradiances, slow_map))
    if lighting.recover_irradiance:
        elements += [
            LightElement(f"source {k + 1}", direction[None], np.ones((1, 1)))
            for k, direction in enumerate(lighting.directions)
        ]
    if lighting.recover_ambient:
        elements.append(LightElement("ambient", np.zeros((0, 3)), np.zeros((0, 1)), uniform=1.0))
    return tuple(elements)


def split_map(radiance_map: Singles) -> tuple[Singles, Floats, Floats]:
    """A map as a slow part and compact sources [RH01, section 5.3: slow and fast-varying lighting].

    Returns the map with its outstanding pixels levelled to their neighbourhood, and directions (k, 3) and
    irradiances (k, 3) of what was taken off. The total light is unchanged.
    """
    height = radiance_map.shape[0]
    weights = latlong_solid_angles(height)[:, :, None]
    neighbourhood = cv2.medianBlur(np.pad(radiance_map, ((2, 2), (2, 2), (0, 0)), mode="wrap"), 5)[2:-2, 2:-2]
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
    cos = np.maximum(normals @ element.directions.T, 0)
    result = cos @ element.irradiances + np.pi * element.uniform
    if element.slow_map is not None:
        result += irradiance(normals, _map_coefficients(element))
    return result


def specular_transfer(element: LightElement, normals: Floats, views: Floats, sigmas: Floats) -> Floats:
    """Reflected radiance (m, sigmas, channels) per unit of Ks F, from a unit strength of the element.

    normals, views : (m, 3) unit. sigmas : (j,) roughnesses in radians.
    """
    sigmas = np.atleast_1d(np.asarray(sigmas, float))
    cos_exitant = np.maximum((normals * views).sum(axis=1), 1e-6)
    result = np.zeros((len(normals), len(sigmas), element.channels))
    for direction, strength in zip(element.directions, element.irradiances, strict=True):
        half = views + direction
        half /= np.maximum(np.linalg.norm(half, axis=1, keepdims=True), 1e-12)
        theta = np.arccos(np.clip((half * normals).sum(axis=1), -1, 1))
        lit = normals @ direction > 0
        weight = np.where(lit, 1 / (4 * cos_exitant), 0.0)  # [RH01, eq. 23]
        result += (lobe(theta[:, None], sigmas) * weight[:, None])[:, :, None] * strength
    if element.uniform:
        grid, table = _uniform_table(tuple(sigmas))
        for j in range(len(sigmas)):
            result[:, j, :] += element.uniform * np.interp(cos_exitant, grid, table[:, j])[:, None]
    if element.slow_map is not None:
        result += map_transfer(element.slow_map, normals, views, sigmas)
    return result


def map_transfer(radiance_map: Singles, normals: Floats, views: Floats, sigmas: Floats) -> Floats:
    """The half-vector integral over a lat-long map (H, 2H, c): (m, sigmas, c) per unit of Ks F.

    Each chunk of rays shifts and turns the rings at random (fixed seed), so that structure of the map
    finer than the rings averages out over samples instead of biasing all of them alike.
    """
    channels = radiance_map.shape[2]
    padded = _padded(radiance_map)
    rng = np.random.default_rng(0)
    result = np.empty((len(normals), len(sigmas), channels))
    for start in range(0, len(normals), _RAYS_PER_CHUNK):
        part = slice(start, start + _RAYS_PER_CHUNK)
        shift, turn = rng.random(2)
        count = int(np.ceil(np.log(_LAST_RING / _FIRST_RING) / _LOG_STEP))
        rings = _FIRST_RING * np.exp(_LOG_STEP * (shift + np.arange(count)))
        weights = _ring_weights(rings, sigmas)
        used = weights.max(axis=1) > 1e-7 * weights.max()
        frame = _Frame.of(normals[part], views[part])
        means = np.stack(
            [
                _ring_mean(padded, frame, theta, 2 * np.pi * turn + _GOLDEN_ANGLE * k)
                for k, theta in enumerate(rings[used])
            ],
            axis=-1,
        )
        result[part] = np.einsum("mck,kj->mjc", means, weights[used])
    return result


def _ring_weights(rings: Floats, sigmas: Floats) -> Floats:
    """Weights (rings, sigmas) with which ring means add up to the integral over the hemisphere of h."""
    weights = 2 * np.pi * lobe(rings[:, None], sigmas) * (np.sin(rings) * rings * _LOG_STEP)[:, None]
    # The disc within the first ring, where the map is constant to the eye of the quadrature.
    inner = rings[0] * np.exp(-_LOG_STEP / 2)
    weights[0] += 1 - np.exp(-((inner / sigmas) ** 2))
    return weights


@dataclass(frozen=True, eq=False)
class _Frame:
    """Local frames of a chunk of rays, (m, 3) each, and the view in them, (m,) each; float32."""

    tangent: Singles
    bitangent: Singles
    normal: Singles
    view: Singles
    along_tangent: Singles
    along_bitangent: Singles
    along_normal: Singles

    @classmethod
    def of(cls, normals: Floats, views: Floats) -> _Frame:
        """Frames with an arbitrary but fixed tangent."""
        helper = np.where(np.abs(normals[:, 2:]) < 0.9, [[0.0, 0.0, 1.0]], [[1.0, 0.0, 0.0]])
        tangent = np.cross(helper, normals)
        tangent /= np.linalg.norm(tangent, axis=1, keepdims=True)
        axes = (tangent, np.cross(normals, tangent), normals)
        along = [(axis * views).sum(axis=1) for axis in axes]
        return cls(*(part.astype(np.float32) for part in (*axes, views, *along)))


def _ring_mean(padded: Singles, frame: _Frame, theta: float, turn: float) -> Singles:
    """Mean (m, c) over azimuth of L(wi(h)) (wo.h) / cos theta_o on the ring theta_h = theta."""
    count = 6 if theta < 0.03 else 12 if theta < 0.1 else 20
    azimuth = turn + 2 * np.pi * np.arange(count) / count
    unit_x, unit_y = np.array([np.cos(azimuth), np.sin(azimuth)], np.float32)
    z = np.float32(np.cos(theta))
    x, y = np.float32(np.sin(theta)) * unit_x, np.float32(np.sin(theta)) * unit_y
    cos_exitant = frame.along_normal[:, None]
    level = frame.along_tangent[:, None] * unit_x + frame.along_bitangent[:, None] * unit_y
    toward = np.float32(np.sin(theta)) * level + cos_exitant * z
    # n.wi is sin(2 theta) level + cos(2 theta) cos(theta_o). Where the horizon crosses a node's cell, the node
    # counts by the share that is lit: all or nothing converges slowly (1% of a wide lobe against 0.2%).
    sin_twice, cos_twice = np.float32(np.sin(2 * theta)), np.float32(np.cos(2 * theta))
    sideways = frame.along_bitangent[:, None] * unit_x - frame.along_tangent[:, None] * unit_y
    around = np.float32(2 * np.pi / count) * sin_twice * sideways
    outward = np.float32(2 * _LOG_STEP * theta) * (cos_twice * level - sin_twice * cos_exitant)
    cell = np.hypot(around, outward) + np.float32(1e-9)
    lit = np.clip((sin_twice * level + cos_twice * cos_exitant) / cell + np.float32(0.5), 0, 1)
    weight = lit * np.maximum(toward, 0) / np.maximum(cos_exitant, np.float32(1e-6))
    twice = 2 * toward
    incident = np.empty((*toward.shape, 3), np.float32)
    for k in range(3):
        half = frame.tangent[:, k, None] * x + frame.bitangent[:, k, None] * y + frame.normal[:, k, None] * z
        incident[..., k] = twice * half - frame.view[:, k, None]
    row, column = latlong_pixels(incident, padded.shape[0] - 2 * _PAD)
    # OpenCV counts pixel centres at integers, so ours, at + 0.5, lie half a pixel back.
    shift = np.float32(_PAD - 0.5)
    values = cv2.remap(padded, column + shift, row + shift, cv2.INTER_CUBIC)
    values = values.reshape(*toward.shape, -1)
    return np.einsum("mp,mpc->mc", weight, values) / np.float32(count)


def _padded(radiance_map: Singles) -> Singles:
    """The map with two pixels more on each side: around in azimuth, across the poles in elevation."""
    turned = np.roll(radiance_map, radiance_map.shape[1] // 2, axis=1)
    rows = np.concatenate([turned[:_PAD][::-1], radiance_map, turned[-_PAD:][::-1]])
    return np.pad(rows, ((0, 0), (_PAD, _PAD), (0, 0)), mode="wrap").astype(np.float32)


@lru_cache(maxsize=4)
def _uniform_table(sigmas: tuple[float, ...]) -> tuple[Floats, Floats]:
    """Specular transfer of unit uniform light against the exitant cosine: (grid,), (grid, sigmas)."""
    grid = np.linspace(0.04, 1.0, 193)
    views = np.stack([np.sqrt(1 - grid**2), np.zeros_like(grid), grid], axis=-1)
    normals = np.broadcast_to([0.0, 0.0, 1.0], views.shape)
    white = np.ones((4, 8, 1), np.float32)
    return grid, map_transfer(white, normals, views, np.array(sigmas))[:, :, 0]


def _map_coefficients(element: LightElement) -> Floats:
    assert element.slow_map is not None
    return project_latlong(element.slow_map, _DIFFUSE_DEGREE)
