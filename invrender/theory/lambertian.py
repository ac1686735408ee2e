"""Lambertian reflection as convolution with the clamped cosine."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike, NDArray

from recon.harmonics.basis import clamped_cosine_transfer, degree_of, degrees, evaluate_harmonics, finite

Floats = NDArray[np.float64]


def irradiance(normals: ArrayLike, lighting_coefficients: ArrayLike) -> Floats:
    """Irradiance (n, c) at unit normals (n, 3) under unoccluded lighting ((l_max + 1)^2, c) [RH01, eq. 15]."""
    coefficients = finite(np.asarray(lighting_coefficients, float), "lighting_coefficients")
    if coefficients.ndim != 2:
        raise ValueError(
            f"lighting_coefficients are {coefficients.shape}; they must be ((l_max + 1)^2, channels)"
        )
    l_max = degree_of(len(coefficients))
    per_degree = clamped_cosine_transfer(l_max)[degrees(l_max)]
    return evaluate_harmonics(normals, l_max) @ (per_degree[:, None] * coefficients)
