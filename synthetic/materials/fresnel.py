"""Fresnel reflectance of unpolarised light, from outside."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

AnyFloats = NDArray[np.floating]


def fresnel_dielectric(mu: float, cos_theta: ArrayLike) -> AnyFloats:
    """Reflectance (0 to 1) of a dielectric, index mu > 1; shape and dtype of the cosines (0 to 1)."""
    cos = np.multiply(cos_theta, 1.0)  # whole numbers become float64, float32 stays
    cos_inside = np.sqrt(1 - (1 - cos * cos) / mu**2)
    perpendicular = (cos - mu * cos_inside) / (cos + mu * cos_inside)
    parallel = (mu * cos - cos_inside) / (mu * cos + cos_inside)
    return np.asarray((perpendicular * perpendicular + parallel * parallel) / 2)


def fresnel_conductor(mu: complex, cos_theta: ArrayLike) -> AnyFloats:
    """Reflectance (0 to 1) of a metal, index mu = n + ik; shape and dtype of the cosines (0 to 1)."""
    cos = np.multiply(cos_theta, 1.0)
    cos_inside = np.sqrt(1 - (1 - cos * cos) / mu**2)
    perpendicular = (cos - mu * cos_inside) / (cos + mu * cos_inside)
    parallel = (mu * cos - cos_inside) / (mu * cos + cos_inside)
    return np.asarray((_power(perpendicular) + _power(parallel)) / 2)


def _power(amplitude: NDArray[Any]) -> AnyFloats:
    return np.asarray(amplitude.real**2 + amplitude.imag**2)


def relative_fresnel(mu: complex | None, cos_theta: ArrayLike) -> AnyFloats:
    """F(mu, theta) / F(mu, 0), shape and dtype of the cosines (0 to 1); 1 without an index, mu None.

    The factor of the specular term in [RH01, eq. 24], there at the exitant angle.
    """
    if mu is None:
        return np.ones_like(np.multiply(cos_theta, 1.0))
    fresnel = (
        fresnel_conductor(mu, cos_theta) if isinstance(mu, complex) else fresnel_dielectric(mu, cos_theta)
    )
    return fresnel / fresnel_at_normal(mu)


def fresnel_at_normal(mu: complex) -> float:
    """F(mu, 0)."""
    return float(abs((mu - 1) / (mu + 1)) ** 2)


def checked_index(mu: complex | None) -> complex | None:
    """The index as a Python number, which leaves float32 arrays as they are.

    Raises ValueError for a dielectric's that is not > 1, or a metal's whose parts are not > 0.
    """
    if mu is None:
        return None
    if np.iscomplexobj(mu):
        mu = complex(mu)
        if not (0 < mu.real < np.inf and 0 < mu.imag < np.inf):
            raise ValueError(f"mu is {mu}; both parts of a metal's refractive index must be > 0")
        return mu
    if not 1 < mu < np.inf:  # type: ignore[operator]
        raise ValueError(f"mu is {mu}; a refractive index must be > 1, or None: no Fresnel factor")
    return float(mu)  # type: ignore[arg-type]
