"""The microfacet BRDF of RH01 as printed.

    rho = Kd + Ks F(mu, theta_o) / F(mu, 0) S(theta_h) / (4 cos theta_i cos theta_o)     [RH01, section 5.2]
    S   = exp(-(theta_h / sigma)^2) / (pi sigma^2)

Taken as printed, so that truth and fit mean the same parameters: Fresnel at the exitant angle instead of
the half vector's, and no shadowing-masking. Both make it wrong physics at grazing angles, where its
reflectance grows without bound; `smith` has the right physics.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import ArrayLike

from synthetic.materials.facets import GGXSlopes
from synthetic.materials.fresnel import checked_index, relative_fresnel
from synthetic.materials.material import AnyFloats, Material


@dataclass(frozen=True, eq=False)
class MicrofacetMaterial(Material):
    """A Lambertian base under a lobe of microfacets.

    kd, ks : (3,) RGB, 1/sr, >= 0; the diffuse albedo is pi kd, at most 1.
    mu : refractive index, > 1; None for no Fresnel factor (metals in RH01).
    sigma : surface roughness, radians, > 0.
    """

    mu: float | None
    sigma: float

    def __post_init__(self) -> None:
        super().__post_init__()
        if np.pi * self.kd.max() > 1:
            raise ValueError(
                f"kd is {self.kd.tolist()}: an albedo pi kd of {np.pi * self.kd.max():.2f} reflects more"
                " light than falls on it; Fig. 11 of RH01 gives ratios, which `radiometric` scales"
            )
        if self.mu is not None and np.iscomplexobj(self.mu):
            raise ValueError(f"mu is {self.mu}; RH01's index is real, `smith` takes a metal's")
        object.__setattr__(self, "mu", checked_index(self.mu))
        if not 0 < self.sigma < np.inf:
            raise ValueError(f"sigma is {self.sigma} rad; it must be > 0")
        object.__setattr__(self, "sigma", float(self.sigma))

    def fresnel(self, cos_exitant: ArrayLike) -> AnyFloats:
        """F(mu, theta_o) / F(mu, 0), shape of `cos_exitant` (0 to 1); 1 without a refractive index."""
        return relative_fresnel(self.mu, cos_exitant)

    def facets(self, cos_half: AnyFloats) -> AnyFloats:
        """Density S of facets, 1/sr, at the cosine of theta_h (-1 to 1); keeps the dtype."""
        return self._facets_at(np.arccos(np.minimum(cos_half, 1)))

    def _facets_at(self, angle: AnyFloats) -> AnyFloats:
        return np.exp(-((angle / self.sigma) ** 2)) / (np.pi * self.sigma**2)

    def lobe(self, wi: AnyFloats, wo: AnyFloats) -> AnyFloats:
        cos_i, cos_o = wi[..., 2], wo[..., 2]
        above = (cos_i > 0) & (cos_o > 0)
        half = wi + wo
        # Not by arccos, which loses half the digits where the lobe peaks.
        angle = np.arctan2(np.sqrt(half[..., 0] ** 2 + half[..., 1] ** 2), half[..., 2])
        lobe = self._facets_at(angle) / np.where(above, 4 * cos_i * cos_o, 1)
        if self.mu is not None:
            lobe = lobe * self.fresnel(np.maximum(cos_o, 0))
        return np.where(above, lobe, 0)[..., None]

    # Nowhere is S more than 1.5 times GGX's density: its visible facets leave to the weights of the samples no
    # more than RH01's own 1 / cos theta_o, where half vectors as dense as S would add their wo.h.
    @cached_property
    def _proposal(self) -> GGXSlopes:
        return GGXSlopes(self.sigma, self.sigma)

    def sample(self, wo: AnyFloats, u: AnyFloats) -> AnyFloats:
        return self._proposal.sample(wo, u)

    def density(self, wi: AnyFloats, wo: AnyFloats) -> AnyFloats:
        return self._proposal.sampled_density(wi, wo)
