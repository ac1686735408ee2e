"""Fresnel reflectance."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike, NDArray

Floats = NDArray[np.float64]


def fresnel_dielectric(mu: float, cos_theta: ArrayLike) -> Floats:
    """Unpolarised Fresnel reflectance (0 to 1) of a dielectric from outside, index mu > 1, shape kept."""
    cos = np.asarray(cos_theta, float)
    cos_inside = np.sqrt(1 - (1 - cos**2) / mu**2)
    perpendicular = (cos - mu * cos_inside) / (cos + mu * cos_inside)
    parallel = (mu * cos - cos_inside) / (mu * cos + cos_inside)
    return np.asarray((perpendicular**2 + parallel**2) / 2)
