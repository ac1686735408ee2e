"""A diffuse base under a smooth interface, and the gloss of that interface, as plastic and varnish have them.

    rho = base T(theta_i) T(theta_o) / mean^2 + gloss(wi, wo)        T = 1 - F(mu, theta)

Wolff, "Diffuse-reflectance model for smooth dielectric surfaces", JOSA A 11(11), 1994, eq. 4; by Stokes' reversibility
what leaves at theta_o is let out as it would be let in. The mean of T is per projected solid angle: under light from
all sides the base reflects pi `base` of it.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from functools import cached_property

import numpy as np
from scipy.integrate import quad

from synthetic.materials.fresnel import fresnel_dielectric
from synthetic.materials.material import AnyFloats, Floats, Material, cosine_density, sample_cosine
from synthetic.materials.smith import SmithMaterial


@dataclass(frozen=True, eq=False)
class Plastic(Material):
    """Microfacets above a base that light reaches, and leaves, through a smooth interface of their index.

    gloss : the facets, whose kd is the base's and whose mu is a dielectric's. As the base isn't Lambertian, all is in
    the lobe: kd is 0 and ks 1.
    """

    gloss: SmithMaterial
    kd: Floats = field(default_factory=lambda: np.zeros(3), init=False)
    ks: Floats = field(default_factory=lambda: np.ones(3), init=False)

    def __post_init__(self) -> None:
        super().__post_init__()
        if not isinstance(self.gloss.mu, float):
            raise ValueError(f"mu is {self.gloss.mu}; the interface of a plastic has a real refractive index")

    @property
    def is_isotropic(self) -> bool:
        return self.gloss.is_isotropic

    def lobe(self, wi: AnyFloats, wo: AnyFloats) -> AnyFloats:
        above = (wi[..., 2:] > 0) & (wo[..., 2:] > 0)
        through = self._through(wi[..., 2:]) * self._through(wo[..., 2:])
        gloss = self.gloss.ks.astype(wi.dtype) * self.gloss.lobe(wi, wo)
        return np.where(above, self.gloss.kd.astype(wi.dtype) * through, 0) + gloss

    def _through(self, cos: AnyFloats) -> AnyFloats:
        assert isinstance(self.gloss.mu, float)
        return (1 - fresnel_dielectric(self.gloss.mu, np.clip(cos, 0, 1))) / self._mean

    @cached_property
    def _mean(self) -> float:
        mu = self.gloss.mu
        assert isinstance(mu, float)
        return float(quad(lambda cos: 2 * cos * (1 - fresnel_dielectric(mu, cos)), 0, 1)[0])

    # Half by the gloss, half by the base.
    def sample(self, wo: AnyFloats, u: AnyFloats) -> AnyFloats:
        first = u[..., :1] < 0.5
        again = np.concatenate([np.where(first, 2 * u[..., :1], 2 * u[..., :1] - 1), u[..., 1:]], axis=-1)
        return np.where(first, self.gloss.sample(wo, again), sample_cosine(again))

    def density(self, wi: AnyFloats, wo: AnyFloats) -> AnyFloats:
        return (self.gloss.density(wi, wo) + cosine_density(wi)) / 2
