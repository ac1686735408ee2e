"""Photographs of materials of any lobe around the half vector, by brute force: sums over incident directions.

`synthetic.render.lobes` serves RH01's form alone; this is slower and takes what a material itself says its lobe is.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from invrender.theory.operator import view_frames
from synthetic.lights.arealight import AreaLight
from synthetic.lights.sources import DirectionalSource
from synthetic.materials.material import Material
from synthetic.render.lobes import irradiance

Floats = np.ndarray

# Half-width of the lobe, in its roughness: outside is less than 1e-7 of a Gaussian.
_EXTENT = 4.0
_CHUNK = 300


def radiance_of(
    material: Material,
    sigma: float,
    lights: Sequence[AreaLight],
    sources: Sequence[DirectionalSource],
    normals: Floats,
    views: Floats,
    order: int = 16,
) -> Floats:
    """Radiance (m, 3) of points with unit normals and views (m, 3); of lobes about as wide as sigma."""
    parts = [slice(start, start + _CHUNK) for start in range(0, len(normals), _CHUNK)]
    return np.concatenate(
        [_of_chunk(material, sigma, lights, sources, normals[part], views[part], order) for part in parts]
    )


def _of_chunk(
    material: Material,
    sigma: float,
    lights: Sequence[AreaLight],
    sources: Sequence[DirectionalSource],
    normals: Floats,
    views: Floats,
    order: int,
) -> Floats:
    frames = view_frames(normals, views)
    cos = np.clip((normals * views).sum(axis=1), 0, 1)
    theta = np.arccos(cos)
    view = np.stack([np.sin(theta), np.zeros_like(theta), cos], axis=-1)
    total = np.zeros_like(normals)
    for source in sources:
        incident = np.einsum("mji,j->mi", frames, source.direction)
        reflected = material.kd + material.ks * material.lobe(incident, view)
        total += reflected * np.maximum(incident[:, 2:], 0) * source.irradiance
    incident, area = _directions(theta, sigma, order)
    lobe = material.lobe(incident, view[:, None])[..., 0] * np.maximum(incident[..., 2], 0) * area
    for light in lights:
        axis = np.einsum("mji,j->mi", frames, light.axis)
        seen = (lobe * light.profile(np.einsum("mki,mi->mk", incident, axis))).sum(axis=1)[:, None]
        total += light.radiance * (material.kd * irradiance(light, normals)[:, None] + material.ks * seen)
    return total


def _directions(theta_o: Floats, sigma: float, order: int) -> tuple[Floats, Floats]:
    """Local directions (m, k, 3) over the horizon whose half vectors are in the lobe, and their solid angles (m, k).

    In polar coordinates about the viewer half vectors are at half the polar angle, so that the lobe stays a circle
    however grazing the view.
    """
    sin, cos = np.sin(theta_o)[:, None], np.cos(theta_o)[:, None]
    extent = _EXTENT * sigma
    ratio = np.sin(min(extent, np.pi / 2)) / np.maximum(sin, 1e-12)
    reach = np.where(theta_o[:, None] > extent, np.arcsin(np.minimum(ratio, 1)), np.pi)
    azimuth = reach * (np.arange(2 * order) + 0.5 - order) / order
    horizon = np.arctan2(cos, -sin * np.cos(azimuth))
    low = 2 * np.maximum(theta_o[:, None] - extent, 0)
    span = np.maximum(np.minimum(horizon, 2 * (theta_o[:, None] + extent)) - low, 0)
    node, weight = np.polynomial.legendre.leggauss(order)
    polar = low[..., None] + span[..., None] * (node + 1) / 2
    area = np.sin(polar) * span[..., None] * weight / 2 * (reach / order)[..., None]
    sin, cos, azimuth = sin[..., None], cos[..., None], azimuth[..., None]
    # From the viewer the normal is at azimuth 0.
    x = sin * np.cos(polar) - cos * np.cos(azimuth) * np.sin(polar)
    z = cos * np.cos(polar) + sin * np.cos(azimuth) * np.sin(polar)
    ways = np.stack([x, np.sin(azimuth) * np.sin(polar), z], axis=-1)
    return ways.reshape(len(theta_o), -1, 3), area.reshape(len(theta_o), -1)
