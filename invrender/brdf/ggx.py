"""Microfacets of long-tailed slopes."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from invrender.brdf.form import LEAST_COS
from invrender.brdf.smith import Smith

Floats = NDArray[np.float64]


class GGX(Smith):
    """Facets of long-tailed slopes [Walter et al. 2007, eq. 33; Heitz 2014, eq. 72]."""

    name = "GGX"
    description = (
        "long-tailed microfacets that hide each other, Fresnel's factor at the half angle (Smith, GGX)"
    )

    def density(self, theta_h: Floats, sigma: float | Floats) -> Floats:
        cos2 = np.maximum(np.cos(theta_h), LEAST_COS) ** 2
        return np.asarray(sigma**2 / (np.pi * (cos2 * sigma**2 + 1 - cos2) ** 2))

    def hidden(self, cos: Floats, sigma: float | Floats) -> Floats:
        return np.asarray((np.sqrt(cos**2 + sigma**2 * np.maximum(1 - cos**2, 0)) - cos) / 2)
