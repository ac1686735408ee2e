"""Mitsuba's blend of `diffuse` and `roughconductor`, and its `roughplastic`, whose base lies below the interface.

In both facets shadow light and viewer apart, with Fresnel's equations: a conductor that doesn't absorb reflects as a
dielectric does.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from invrender.brdf.form import Angles
from invrender.brdf.fresnel import fresnel_reflectance
from invrender.brdf.lobes import BECKMANN, GGX_FORM
from invrender.brdf.microfacet import Microfacet
from invrender.brdf.smith import Smith
from invrender.output.export.rough_interface import passed_and_kept
from invrender.output.export.target import LEAST_ALPHA, Numbers, Target

Floats = NDArray[np.float64]

_INDEX_RANGE = (1.01, 30.0)
# Stands for no Fresnel factor, as `material` "none" does there.
NO_INDEX = 0.0


class MitsubaBlend(Target):
    """`fresnel` is the index of refraction, `specular` the lobe's weight times its specular reflectance."""

    def __init__(self, distribution: str, form: Smith) -> None:
        self.distribution, self.form = distribution, form
        self.model = f"Mitsuba diffuse and roughconductor ({distribution})"

    def lobe(self, angles: Angles, numbers: Numbers) -> Floats:
        form, alpha = self.form, numbers.alpha
        facets = form.density(angles.theta_h, alpha) / (4 * angles.cos_o)
        for cos in (angles.cos_i, angles.cos_o):
            facets = facets * cos / (cos + form.hidden(cos, alpha))
        if numbers.fresnel > NO_INDEX:
            facets = facets * fresnel_reflectance(numbers.fresnel, angles.cos_d)
        return np.asarray(facets[:, None] * numbers.specular)

    def start(self, brdf: Microfacet) -> Numbers:
        assert brdf.sigma is not None
        if brdf.mu is None:
            return Numbers(brdf.sigma, NO_INDEX, np.pi * brdf.kd, brdf.ks)
        at_normal = fresnel_reflectance(brdf.mu, 1.0)
        return Numbers(brdf.sigma, brdf.mu, np.pi * brdf.kd, brdf.ks / at_normal)

    def bounds(self, brdf: Microfacet, strongest: float = 1.0) -> tuple[Numbers, Numbers]:
        low, high = (NO_INDEX, NO_INDEX) if brdf.mu is None else _INDEX_RANGE
        most = np.full(3, np.inf)
        return Numbers(LEAST_ALPHA, low, np.zeros(3), np.zeros(3)), Numbers(1, high, most, most)

    def matte(self, base: Floats) -> Numbers:
        return Numbers(1.0, NO_INDEX, base, np.zeros(3))


class MitsubaPlastic(MitsubaBlend):
    """`fresnel` is int_ior in vacuum, `base` diffuse_reflectance and `specular` specular_reflectance; not nonlinear."""

    def __init__(self, distribution: str, form: Smith) -> None:
        super().__init__(distribution, form)
        self.model = f"Mitsuba roughplastic ({distribution})"

    def takes(self, brdf: Microfacet) -> bool:
        return brdf.form.interface and bool(brdf.ks.any())

    def base_shown(self, angles: Angles, numbers: Numbers) -> Floats:
        directions = np.stack([angles.cos_i, angles.cos_o])
        (coming, leaving), kept = passed_and_kept(self.form, numbers.alpha, numbers.fresnel, directions)
        return np.asarray((coming * leaving / (numbers.fresnel**2 * (1 - kept)))[:, None])


MITSUBA = (
    MitsubaBlend("beckmann", BECKMANN),
    MitsubaBlend("ggx", GGX_FORM),
    MitsubaPlastic("beckmann", BECKMANN),
    MitsubaPlastic("ggx", GGX_FORM),
)
