"""Low et al. 2012, "BRDF models for accurate and efficient rendering of glossy surfaces": ABC microfacets."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from invrender.brdf.form import LEAST_COS, Angles
from invrender.brdf.fresnel import fresnel_reflectance

Floats = NDArray[np.float64]


@dataclass(frozen=True)
class AbcBrdf:
    """kd / pi + F G A / (1 + B (1 - cos theta_h))^C / (pi cos theta_i cos theta_o), of one channel.

    kd : albedo of the Lambertian part. a, b, c : of the distribution. index : refractive, of F at the half angle. G is
    that of Cook and Torrance 1982.
    """

    kd: float
    a: float
    b: float
    c: float
    index: float

    def __call__(self, normals: Floats, wi: Floats, wo: Floats) -> Floats:
        """The BRDF times the cosine of incidence, zero below the horizon: a `Lobe`."""
        angles = Angles.between(normals, wi, wo)
        lit = (angles.cos_i > 0) & (angles.cos_o > 0)
        cos_h = np.cos(angles.theta_h)
        density = self.a / (1 + self.b * (1 - cos_h)) ** self.c
        least = np.minimum(angles.cos_i, angles.cos_o)
        masking = np.clip(2 * cos_h * least / np.maximum(angles.cos_d, LEAST_COS), 0, 1)
        fresnel = fresnel_reflectance(self.index, np.clip(angles.cos_d, 0, 1))
        gloss = fresnel * masking * density / (np.pi * np.maximum(angles.cos_o, LEAST_COS))
        return np.where(lit, self.kd / np.pi * angles.cos_i + gloss, 0)
