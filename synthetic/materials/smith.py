"""The physically exact microfacet BRDF.

    rho = kd + ks F(mu, theta_d) / F(mu, 0) D(h) G2 / (4 cos theta_i cos theta_o)
    G2  = 1 / (1 + Lambda(wi) + Lambda(wo))              heights correlated  [Heitz 2014, eq. 99]

Beside `microfacet`, RH01's form as printed: Fresnel at the half vector's angle theta_d (cos theta_d = wo.h),
shadowing and masking, and a density that shows every facet once (the integral of D cos is 1). It is reciprocal and
never reflects more than ks F / F(mu, 0). As there, ks is the reflectance at normal incidence of the facets, so
kd, ks, mu and sigma mean the same in both, which differ at grazing angles only, and by sigma^2.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from synthetic.materials.facets import Facets, GGXSlopes
from synthetic.materials.fresnel import checked_index, relative_fresnel
from synthetic.materials.material import AnyFloats, Material
from synthetic.vectors import dot


@dataclass(frozen=True, eq=False)
class SmithMaterial(Material):
    """A Lambertian base under microfacets that shadow and mask each other.

    mu : refractive index, > 1; complex, n + ik, of a metal; None for no Fresnel factor.
    facets : how they lean; `Beckmann(sigma, sigma)` is next to RH01's roughness sigma.
    """

    mu: complex | None
    facets: Facets

    def __post_init__(self) -> None:
        super().__post_init__()
        object.__setattr__(self, "mu", checked_index(self.mu))

    @property
    def is_isotropic(self) -> bool:
        return self.facets.along == self.facets.across

    def lobe(self, wi: AnyFloats, wo: AnyFloats) -> AnyFloats:
        cos_i, cos_o = wi[..., 2], wo[..., 2]
        above = (cos_i > 0) & (cos_o > 0)
        half = wi + wo
        # cos_i cos_o / G2, which is 0 at grazing only if both are.
        shown = cos_i * cos_o + cos_o * self.facets.hidden(wi) + cos_i * self.facets.hidden(wo)
        lobe = self.facets.density(half) / (4 * np.where(above, shown, 1))
        if self.mu is not None:
            # Half of |wi + wo| is wo.h.
            lobe = lobe * relative_fresnel(self.mu, np.sqrt(dot(half, half)) / 2)
        return np.where(above, lobe, 0)[..., None]

    # Visible facets of GGX serve Beckmann's too: nowhere is the lobe more than 2.6 times as dense.
    @cached_property
    def _proposal(self) -> GGXSlopes:
        return GGXSlopes(self.facets.along, self.facets.across)

    def sample(self, wo: AnyFloats, u: AnyFloats) -> AnyFloats:
        return self._proposal.sample(wo, u)

    def density(self, wi: AnyFloats, wo: AnyFloats) -> AnyFloats:
        return self._proposal.sampled_density(wi, wo)
