"""Fresnel reflection of a dielectric, normalised to 1 at normal exitance as in RH01 section 5.2."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike, NDArray

Floats = NDArray[np.float64]

# Refractive indices between which the search looks, and the steepest exitant cosine they are needed for.
MU_RANGE = (1.1, 4.0)
_MIN_COS = 0.05
# Enough for 0.05% over the whole range (a test holds it).
_RANK = 7


def fresnel_reflectance(mu: float | Floats, cos_theta: ArrayLike) -> Floats:
    """Unpolarised reflectance of a smooth dielectric of relative refractive index mu > 1, in 0 to 1.

    cos_theta : cosine of the angle to the normal, in 0 to 1.
    """
    cos = np.clip(np.asarray(cos_theta, float), 0, 1)
    cos_inside = np.sqrt(1 - (1 - cos**2) / mu**2)
    s = (cos - mu * cos_inside) / (cos + mu * cos_inside)
    p = (mu * cos - cos_inside) / (mu * cos + cos_inside)
    return (s**2 + p**2) / 2


def normalised_fresnel(mu: float | Floats | None, cos_theta: ArrayLike) -> Floats:
    """F(mu, theta) / F(mu, 0) [RH01, section 5.2]; all ones where mu is None (no Fresnel factor)."""
    cos = np.asarray(cos_theta, float)
    if mu is None:
        return np.ones_like(cos)
    return fresnel_reflectance(mu, cos) / ((mu - 1) / (mu + 1)) ** 2


class FresnelBasis:
    """F(mu, theta_o) as a short sum a_k(mu) f_k(theta_o), so that mu leaves the sums over samples.

    The f_k are the leading singular functions of the whole family, the constant (no Fresnel) included.
    """

    def __init__(self) -> None:
        self._cos = np.linspace(_MIN_COS, 1.0, 1000)
        mus = 1 + np.geomspace(MU_RANGE[0] - 1, MU_RANGE[1] - 1, 200)
        family = np.array([normalised_fresnel(mu, self._cos) for mu in mus] + [np.ones_like(self._cos)])
        # Each member scaled to unit size: the error is relative, for weak and strong Fresnel alike.
        _, _, rows = np.linalg.svd(
            family / np.linalg.norm(family, axis=1, keepdims=True), full_matrices=False
        )
        self._functions = rows[:_RANK]

    @property
    def rank(self) -> int:
        return _RANK

    def functions(self, cos_exitant: Floats) -> Floats:
        """f_k at exitant cosines (n,), as (n, rank)."""
        return np.stack([np.interp(cos_exitant, self._cos, f) for f in self._functions], axis=-1)

    def coefficients(self, mu: float | Floats | None) -> Floats:
        """a_k(mu), (rank,); of several (f,), (f, rank)."""
        if mu is None or np.ndim(mu) == 0:
            return self._functions @ normalised_fresnel(mu, self._cos)
        different, place = np.unique(mu, return_inverse=True)
        return (normalised_fresnel(different[:, None], self._cos) @ self._functions.T)[place]
