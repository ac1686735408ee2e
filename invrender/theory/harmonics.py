"""Lighting in the spherical harmonics of `recon.harmonics`."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike, NDArray

from capture.lighting import latlong_directions, latlong_solid_angles
from recon.harmonics import evaluate_harmonics

Floats = NDArray[np.float64]

_PIXELS_AT_A_TIME = 16_384


def project_latlong(radiance_map: ArrayLike, l_max: int) -> Floats:
    """Coefficients ((l_max + 1)^2, c) of a lat-long map (H, 2H, c): its pixels times their solid angles.

    Exact up to the map's pixelation; R02 eq. 5.21 is the fast form for high degrees.
    """
    radiance_map = np.asarray(radiance_map, float)
    height = radiance_map.shape[0]
    weighted = radiance_map * latlong_solid_angles(height)[:, :, None]
    directions = latlong_directions(height)
    result = np.zeros(((l_max + 1) ** 2, radiance_map.shape[2]))
    # Band by band: all harmonics at all pixels of a 2048x1024 map would take gigabytes.
    band = max(_PIXELS_AT_A_TIME // (2 * height), 1)
    for first in range(0, height, band):
        rows = slice(first, first + band)
        basis = evaluate_harmonics(directions[rows], l_max)
        result += basis.T @ weighted[rows].reshape(-1, radiance_map.shape[2])
    return result


def project_sources(directions: ArrayLike, irradiances: ArrayLike, l_max: int) -> Floats:
    """Coefficients ((l_max + 1)^2, c) of directional sources (k, 3) of irradiance (k, c): delta functions."""
    irradiances = np.asarray(irradiances, float)
    return evaluate_harmonics(directions, l_max).T @ irradiances
