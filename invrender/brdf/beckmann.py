"""Microfacets of Gaussian slopes."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy.special import erf

from invrender.brdf.form import LEAST_COS
from invrender.brdf.smith import Smith

Floats = NDArray[np.float64]


class Beckmann(Smith):
    """Facets of Gaussian slopes [Walter et al. 2007, eq. 25; Heitz 2014, eq. 72]."""

    name = "half-angle microfacet"
    description = "microfacets that hide each other, Fresnel's factor at the half angle (Smith, Beckmann)"

    def density(self, theta_h: Floats, sigma: float | Floats) -> Floats:
        cos2 = np.maximum(np.cos(theta_h), LEAST_COS) ** 2
        return np.asarray(np.exp(-(1 - cos2) / (cos2 * sigma**2)) / (np.pi * sigma**2 * cos2**2))

    def hidden(self, cos: Floats, sigma: float | Floats) -> Floats:
        spread = sigma * np.sqrt(np.maximum(1 - cos**2, 0))
        a = cos / np.maximum(spread, 1e-12)
        return np.asarray((cos * (erf(a) - 1) + spread * np.exp(-(a**2)) / np.sqrt(np.pi)) / 2)
