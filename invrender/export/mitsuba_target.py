"""Mitsuba's blend of `diffuse` and `roughconductor`: facets shadow light and viewer apart, Fresnel's equations.

A conductor that doesn't absorb reflects as a dielectric does, and unlike `roughplastic` it can be as strong, and of any
colour, as it was found.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from invrender.export.target import LEAST_ALPHA, Numbers, Target
from invrender.model.fresnel import fresnel_reflectance
from invrender.model.lobes import BECKMANN, GGX_FORM, Angles, Smith
from invrender.model.microfacet import Microfacet

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


MITSUBA = (MitsubaBlend("beckmann", BECKMANN), MitsubaBlend("ggx", GGX_FORM))
