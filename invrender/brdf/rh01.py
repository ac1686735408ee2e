"""The microfacets of RH01."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from invrender.brdf.form import LEAST_COS, Angles, LobeForm
from invrender.theory.specialcases import lobe

Floats = NDArray[np.float64]


class RH01Microfacet(LobeForm):
    """RH01's: Fresnel's factor at theta_o, and no facet hides another [RH01, section 5.2]."""

    name = "microfacet"
    description = "microfacets as in RH01, Fresnel's factor at the exitant angle"

    def shape(self, angles: Angles, sigma: float | Floats) -> Floats:
        lit = (angles.cos_i > 0) & (angles.cos_o > 0)
        return np.where(lit, lobe(angles.theta_h, sigma) / (4 * np.maximum(angles.cos_o, LEAST_COS)), 0)

    def fresnel_cosine(self, angles: Angles) -> Floats:
        return angles.cos_o
