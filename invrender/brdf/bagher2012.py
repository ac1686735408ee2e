"""Bagher et al. 2012, "Accurate fitting of measured reflectances using a shifted gamma micro-facet distribution"."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from invrender.brdf.form import LEAST_COS, Angles

Floats = NDArray[np.float64]

# exp of more is beyond doubles, and what is masked by it is 0 long before.
_LARGEST = 700.0


@dataclass(frozen=True)
class ShiftedGammaBrdf:
    """(rho_d + rho_s F G1(theta_i) G1(theta_o) D / (cos theta_i cos theta_o)) / pi, of one channel.

    D = kappa exp(-x) / (pi x^p cos^4 theta_h), x = alpha + tan^2 theta_h / alpha
    F = f0 - f1 cos theta_d + (1 - f0) (1 - cos theta_d)^5
    G1 = 1 + lambda (1 - exp(c (theta - theta0)^k)) for theta > theta0, within 0 and 1
    """

    rho_d: float
    rho_s: float
    alpha: float
    p: float
    f0: float
    f1: float
    kappa: float
    lam: float
    c: float
    k: float
    theta0: float

    def __call__(self, normals: Floats, wi: Floats, wo: Floats) -> Floats:
        """The BRDF times the cosine of incidence, zero below the horizon: a `Lobe`."""
        angles = Angles.between(normals, wi, wo)
        lit = (angles.cos_i > 0) & (angles.cos_o > 0)
        cos2 = np.maximum(np.cos(angles.theta_h), LEAST_COS) ** 2
        x = self.alpha + (1 - cos2) / cos2 / self.alpha
        density = self.kappa * np.exp(-x) / (np.pi * x**self.p * cos2**2)
        cos_d = np.clip(angles.cos_d, 0, 1)
        fresnel = self.f0 - self.f1 * cos_d + (1 - self.f0) * (1 - cos_d) ** 5
        masking = self._masking(angles.cos_i) * self._masking(angles.cos_o)
        gloss = self.rho_s * fresnel * masking * density / np.maximum(angles.cos_o, LEAST_COS)
        return np.where(lit, (self.rho_d * angles.cos_i + gloss) / np.pi, 0)

    def _masking(self, cos: Floats) -> Floats:
        beyond = np.maximum(np.arccos(np.clip(cos, 0, 1)) - self.theta0, 0)
        rise = np.exp(np.minimum(self.c * beyond**self.k, _LARGEST))
        return np.clip(1 + self.lam * (1 - rise), 0, 1)
