"""glTF's metallic-roughness material with KHR_materials_specular and KHR_materials_ior.

Its formula is that of the specification's appendix B: GGX, Smith's shadowing of light and viewer apart, Schlick's
Fresnel.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from invrender.brdf.form import Angles
from invrender.brdf.fresnel import fresnel_reflectance
from invrender.brdf.lobes import GGX_FORM
from invrender.brdf.microfacet import Microfacet
from invrender.output.export.target import LEAST_ALPHA, Numbers, Target

Floats = NDArray[np.float64]

# Reflectance at normal incidence; at 1, to which no index of refraction belongs, Schlick's factor is flat.
_MOST_F0 = 0.98


class MetallicRoughness(Target):
    """`fresnel` is the specular factor, `specular` the reflectance F0 at normal incidence before it.

    A metal is the case of a black base and a factor of 1: `metallic` says nothing more.
    """

    model = "glTF metallic-roughness"

    def lobe(self, angles: Angles, numbers: Numbers) -> Floats:
        return self._fresnel(angles, numbers) * _facets(angles, numbers.alpha)[:, None]

    def base_shown(self, angles: Angles, numbers: Numbers) -> Floats:
        return np.asarray(1 - self._fresnel(angles, numbers).max(axis=1, keepdims=True))

    def start(self, brdf: Microfacet) -> Numbers:
        assert brdf.sigma is not None
        f0 = 0.5 if brdf.mu is None else float(fresnel_reflectance(brdf.mu, 1.0))
        factor = min(float(brdf.ks.max()) / f0, 1.0)
        return Numbers(brdf.sigma, factor, np.pi * brdf.kd, brdf.ks / factor)

    def bounds(self, brdf: Microfacet, strongest: float = 1.0) -> tuple[Numbers, Numbers]:
        most = np.full(3, _MOST_F0)
        return Numbers(LEAST_ALPHA, 0, np.zeros(3), np.zeros(3)), Numbers(1, 1 / strongest, np.ones(3), most)

    def matte(self, base: Floats) -> Numbers:
        return Numbers(1.0, 0.0, np.minimum(base, 1), np.full(3, 0.04))

    def _fresnel(self, angles: Angles, numbers: Numbers) -> Floats:
        """Schlick's factor times the specular factor, (n, 3)."""
        rise = ((1 - np.minimum(angles.cos_d, 1)) ** 5)[:, None]
        return np.asarray(numbers.fresnel * (numbers.specular + (1 - numbers.specular) * rise))


def _facets(angles: Angles, alpha: float) -> Floats:
    """GGX with both shadowings, times cos theta_i, (n,)."""
    density = GGX_FORM.density(angles.theta_h, alpha)
    shown = [cos + np.sqrt(alpha**2 + (1 - alpha**2) * cos**2) for cos in (angles.cos_i, angles.cos_o)]
    return np.asarray(density * angles.cos_i / (shown[0] * shown[1]))


def index_of(f0: float) -> float:
    """The index of refraction that reflects f0 at normal incidence."""
    root = np.sqrt(f0)
    return float((1 + root) / (1 - root))


GLTF = MetallicRoughness()
