"""MaterialX's standard_surface (Autodesk) and open_pbr_surface (OpenPBR): a dielectric layer over a Lambertian base.

As their reference implementation has it: GGX, heights correlated [Heitz 2014], Fresnel's equations, light that bounces
between facets made up for [Turquin 2019, eq. 14, 16]; the base gets what the layer doesn't reflect to the viewer.
"""

from __future__ import annotations

from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

from invrender.brdf.form import Angles
from invrender.brdf.fresnel import fresnel_reflectance
from invrender.brdf.lobes import GGX_FORM
from invrender.brdf.microfacet import Microfacet
from invrender.output.export.directions import pairs_at
from invrender.output.export.target import LEAST_ALPHA, Numbers, Target

Floats = NDArray[np.float64]

_INDEX_RANGE = (1.01, 30.0)


class StandardSurface(Target):
    """`fresnel` is specular_IOR, `specular` the weight specular times the colour specular_color."""

    model = "MaterialX standard_surface"

    def lobe(self, angles: Angles, numbers: Numbers) -> Floats:
        single, _ = self._per_view(angles, numbers)
        return np.asarray(_layer(angles, numbers.alpha, numbers.fresnel, single)[:, None] * numbers.specular)

    def base_shown(self, angles: Angles, numbers: Numbers) -> Floats:
        _, reflected = self._per_view(angles, numbers)
        return np.asarray(1 - numbers.specular.max() * reflected[:, None])

    def start(self, brdf: Microfacet) -> Numbers:
        assert brdf.sigma is not None
        mu = 5.0 if brdf.mu is None else brdf.mu
        return Numbers(brdf.sigma, mu, np.pi * brdf.kd, brdf.ks / fresnel_reflectance(mu, 1.0))

    def bounds(self, brdf: Microfacet, strongest: float = 1.0) -> tuple[Numbers, Numbers]:
        low, high = _INDEX_RANGE
        most = np.full(3, 1 / strongest)
        return Numbers(LEAST_ALPHA, low, np.zeros(3), np.zeros(3)), Numbers(1, high, np.ones(3), most)

    def matte(self, base: Floats) -> Numbers:
        return Numbers(1.0, 1.5, np.minimum(base, 1), np.zeros(3))

    def _per_view(self, angles: Angles, numbers: Numbers) -> tuple[Floats, Floats]:
        """What facets and the whole layer reflect of uniform light to each pair's viewer, (n,) each."""
        views, place = np.unique(angles.cos_o.round(9), return_inverse=True)
        single, reflected = _integrals(tuple(views.tolist()), numbers.alpha, numbers.fresnel)
        return single[place], reflected[place]


class OpenPbr(StandardSurface):
    """`fresnel` is specular_ior, `specular` the colour specular_color, which tints the layer and not what it leaves.

    specular_weight, which would scale the layer by way of its index, is 1.
    """

    model = "MaterialX open_pbr_surface"

    def base_shown(self, angles: Angles, numbers: Numbers) -> Floats:
        if not numbers.specular.any():
            return super().base_shown(angles, numbers)
        _, reflected = self._per_view(angles, numbers)
        return np.asarray(1 - reflected[:, None])


# Slopes in base and specular ask for the same integrals again.
@lru_cache(maxsize=4)
def _integrals(views: tuple[float, ...], alpha: float, index: float) -> tuple[Floats, Floats]:
    """What facets and the whole layer reflect of uniform light to viewers at cosines (v,), (v,) each."""
    pairs = pairs_at(np.array(views), np.ones(len(views)), alpha)
    single = pairs.per_view(GGX_FORM.shape(pairs.angles, alpha)[:, None])[:, 0]
    layer = _layer(pairs.angles, alpha, index, single[pairs.view])
    return single, pairs.per_view(layer[:, None])[:, 0]


def _layer(angles: Angles, alpha: float, index: float, single: Floats) -> Floats:
    """The layer's reflectance times cos theta_i, (n,), per unit of weight."""
    fresnel = fresnel_reflectance(index, angles.cos_d)
    return np.asarray(GGX_FORM.shape(angles, alpha) * fresnel * (1 + fresnel * (1 - single) / single))


STANDARD_SURFACE, OPEN_PBR = StandardSurface(), OpenPbr()
