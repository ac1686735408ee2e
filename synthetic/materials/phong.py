"""The modified Phong BRDF.

    rho = kd + ks (s + 2) / (2 pi) cos^s alpha,    alpha between wi and the mirrored viewer

Lafortune and Willems, "Using the modified Phong reflectance model for physically based rendering", 1994. The
cosine of incidence is not part of it; RH01 (section 5.1) and R02 (section 5.6.4) normalise the product with it instead,
(s + 1) / (2 pi) cos^s alpha, which as a BRDF would need 1 / cos theta_i, neither reciprocal nor bounded. Here ks
is the reflectance at normal incidence, which falls towards grazing as the lobe sinks below the horizon.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from synthetic.materials.material import AnyFloats, Material
from synthetic.vectors import dot, local_frame, mirrored, to_world


@dataclass(frozen=True, eq=False)
class PhongMaterial(Material):
    """A Lambertian base under a lobe about the mirror direction. exponent : s, >= 0; 0 is Lambertian again."""

    exponent: float

    def __post_init__(self) -> None:
        super().__post_init__()
        if not 0 <= self.exponent < np.inf:
            raise ValueError(f"the exponent is {self.exponent}; it must be >= 0")
        object.__setattr__(self, "exponent", float(self.exponent))

    def lobe(self, wi: AnyFloats, wo: AnyFloats) -> AnyFloats:
        above = (wi[..., 2] > 0) & (wo[..., 2] > 0)
        lobe = (self.exponent + 2) / (2 * np.pi) * self._cosine(wi, wo) ** self.exponent
        return np.where(above, lobe, 0)[..., None]

    def sample(self, wo: AnyFloats, u: AnyFloats) -> AnyFloats:
        cos = u[..., 0] ** (1 / (self.exponent + 1))
        sin, phi = np.sqrt(1 - cos * cos), 2 * np.pi * u[..., 1]
        about = np.stack([sin * np.cos(phi), sin * np.sin(phi), cos], axis=-1)
        return to_world(local_frame(mirrored(wo)), about)

    def density(self, wi: AnyFloats, wo: AnyFloats) -> AnyFloats:
        cos = self._cosine(wi, wo)
        density = (self.exponent + 1) / (2 * np.pi) * cos**self.exponent
        return np.where(cos > 0, density, 0)

    def _cosine(self, wi: AnyFloats, wo: AnyFloats) -> AnyFloats:
        return np.maximum(dot(wi, mirrored(wo)), 0)
