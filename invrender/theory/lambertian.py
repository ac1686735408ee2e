"""Lambertian reflection as convolution with the clamped cosine."""

from __future__ import annotations

from functools import lru_cache

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.ndimage import map_coordinates, spline_filter

from capture.lighting import latlong_pixels, padded_latlong
from recon.harmonics.basis import (
    check_unit,
    clamped_cosine_transfer,
    degree_of,
    degrees,
    evaluate_harmonics,
    finite,
)
from recon.harmonics.latlong import synthesise_latlong

Floats = NDArray[np.float64]

# From so many normals on, cubic splines over a grid serve them, to 1e-6 of the largest value, for a tenth of the time.
_MANY = 4000
# Rows of that grid: per degree, and at least; and how many more lie beyond each pole.
_ROWS_PER_DEGREE, _ROWS, _BEYOND = 8, 128, 16


def irradiance(normals: ArrayLike, lighting_coefficients: ArrayLike) -> Floats:
    """Irradiance (n, c) at unit normals (n, 3) under unoccluded lighting ((l_max + 1)^2, c) [RH01, eq. 15]."""
    coefficients = finite(np.asarray(lighting_coefficients, float), "lighting_coefficients")
    if coefficients.ndim != 2:
        raise ValueError(
            f"lighting_coefficients are {coefficients.shape}; they must be ((l_max + 1)^2, channels)"
        )
    l_max = degree_of(len(coefficients))
    per_degree = clamped_cosine_transfer(l_max)[degrees(l_max)]
    reflected = per_degree[:, None] * coefficients
    normals = np.asarray(normals, float)
    check_unit(normals, "normals")
    if len(normals) < _MANY:
        return evaluate_harmonics(normals, l_max) @ reflected
    splines = _splines(reflected.tobytes(), l_max)
    places = np.array(latlong_pixels(normals, splines.shape[1] - 2 * _BEYOND)) + (_BEYOND - 0.5)
    return np.stack([map_coordinates(channel, places, prefilter=False) for channel in splines], axis=-1)


# All parts of all photographs under a light ask for the same.
@lru_cache(maxsize=8)
def _splines(reflected: bytes, l_max: int) -> Floats:
    """Cubic splines (c, H + 32, 2H + 32) over a padded lat-long grid of harmonics ((l_max + 1)^2, c)."""
    coefficients = np.frombuffer(reflected).reshape((l_max + 1) ** 2, -1)
    grid = synthesise_latlong(coefficients, max(_ROWS_PER_DEGREE * (l_max + 1), _ROWS))
    return np.stack([spline_filter(channel) for channel in np.moveaxis(padded_latlong(grid, _BEYOND), -1, 0)])
