"""The microfacets of RH01."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from invrender.brdf.form import LEAST_COS, Angles, Lobe, LobeForm
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


def simplified_microfacet(sigma: float) -> Lobe:
    """exp(-(theta_h / sigma)^2) / (4 pi sigma^2) above the horizon, cosine included [R02, eq. 5.34]; sigma in rad."""

    def of_angles(normals: Floats, wi: Floats, wo: Floats) -> Floats:
        angles = Angles.between(normals, wi, wo)
        lit = (angles.cos_i > 0) & (angles.cos_o > 0)
        return np.where(lit, lobe(angles.theta_h, sigma) / 4, 0)

    return of_angles
