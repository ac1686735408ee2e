"""A matte surface: the same radiance to all sides."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np

from synthetic.materials.material import AnyFloats, Floats, Material, cosine_density, sample_cosine


@dataclass(frozen=True, eq=False)
class Lambertian(Material):
    """A base without a lobe. kd : (3,) RGB, 1/sr; the albedo is pi kd."""

    ks: Floats = field(init=False, default_factory=lambda: np.zeros(3))

    def lobe(self, wi: AnyFloats, wo: AnyFloats) -> AnyFloats:
        return np.zeros_like((wi + wo)[..., :1])

    def sample(self, wo: AnyFloats, u: AnyFloats) -> AnyFloats:
        return sample_cosine(u)

    def density(self, wi: AnyFloats, wo: AnyFloats) -> AnyFloats:
        return cosine_density(wi)
