"""Lambertian reflection as convolution with the clamped cosine."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike, NDArray

from recon.harmonics import clamped_cosine_transfer, evaluate_harmonics

Floats = NDArray[np.float64]


def irradiance(normals: ArrayLike, lighting_coefficients: ArrayLike) -> Floats:
    """Irradiance (n, c) at unit normals (n, 3) under unoccluded lighting ((l_max + 1)^2, c) [RH01, eq. 15]."""
    coefficients = np.asarray(lighting_coefficients, float)
    l_max = int(np.sqrt(len(coefficients))) - 1
    per_degree = np.repeat(clamped_cosine_transfer(l_max), 2 * np.arange(l_max + 1) + 1)
    return evaluate_harmonics(normals, l_max) @ (per_degree[:, None] * coefficients)
