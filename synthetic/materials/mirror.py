"""A perfect mirror.

L(wo) = ks F(mu, theta_o) / F(mu, 0) L(mirrored wo)      over a Lambertian base kd
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from synthetic.materials.fresnel import checked_index, relative_fresnel
from synthetic.materials.material import AnyFloats, Material
from synthetic.vectors import mirrored as mirrored_direction


@dataclass(frozen=True, eq=False)
class Mirror(Material):
    """A Lambertian base under a perfect mirror, what `Smith` becomes as its roughness goes to 0.

    ks : the reflectance at normal incidence.
    mu : refractive index, > 1; complex, n + ik, of a metal; None for no Fresnel factor.
    """

    mu: complex | None = None

    def __post_init__(self) -> None:
        super().__post_init__()
        object.__setattr__(self, "mu", checked_index(self.mu))

    @property
    def is_mirror(self) -> bool:
        return True

    def mirrored(self, wo: AnyFloats) -> AnyFloats:
        return self.fresnel(wo[..., 2:])

    def fresnel(self, cos_exitant: ArrayLike) -> AnyFloats:
        """F(mu, theta_o) / F(mu, 0), shape of `cos_exitant` (0 to 1): what ks is to be multiplied by."""
        return relative_fresnel(self.mu, cos_exitant)

    def lobe(self, wi: AnyFloats, wo: AnyFloats) -> AnyFloats:
        return np.zeros_like((wi + wo)[..., :1])

    def sample(self, wo: AnyFloats, u: AnyFloats) -> AnyFloats:
        shape = np.broadcast_shapes(wo.shape[:-1], u.shape[:-1])
        return np.broadcast_to(mirrored_direction(wo), (*shape, 3))

    def density(self, wi: AnyFloats, wo: AnyFloats) -> AnyFloats:
        """0: the mirrored direction has no density."""
        return np.zeros_like((wi + wo)[..., 0])
