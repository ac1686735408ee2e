"""Materials as plugins for Mitsuba 3, written from the papers' formulas: no formula of ours is called.

They need a vectorised variant of Mitsuba (`llvm_ad_rgb`), in which Python is called once per reflection of all paths.
"""

from __future__ import annotations

from typing import Any

import drjit as dr
import mitsuba as mi
import numpy as np

from synthetic.materials.facets import BeckmannSlopes, GGXSlopes
from synthetic.materials.material import Material
from synthetic.materials.microfacet import MicrofacetMaterial
from synthetic.materials.phong import PhongMaterial
from synthetic.materials.smith import SmithMaterial
from synthetic.materials.texture import Textured

from .mitsubascene import Plugin, reflectance


def has_llvm() -> bool:
    """Whether the `llvm` variants can be used here: LLVM 14 and 15 end the process on recent processors."""
    return bool(dr.has_backend(dr.JitBackend.LLVM)) and dr.detail.llvm_version() >= (16,)


def register_lobes() -> None:
    """Make the plugins known to the variant that is set, whose types they are made of."""

    class Lobe(mi.BSDF):
        """kd + ks lobe. Directions: Mitsuba's si.wi is the viewer's, its wo the light's; `eval` has the cosine."""

        def __init__(self, props: Any) -> None:
            mi.BSDF.__init__(self, props)
            self.kd, self.ks = props.get_texture("kd"), props.get_texture("ks")
            self.read(props)
            # What paths are continued by, no more: half of them after the cosine, half after the facets seen.
            self.facets = mi.MicrofacetDistribution(mi.MicrofacetType.GGXSlopes, self.width, True)
            flags = mi.BSDFFlags.DiffuseReflection | mi.BSDFFlags.GlossyReflection | mi.BSDFFlags.FrontSide
            self.m_components, self.m_flags = [flags], flags

        def eval(self, ctx: Any, si: Any, wo: Any, active: Any = True) -> Any:
            light, viewer = wo, si.wi
            above = (light.z > 0) & (viewer.z > 0)
            lobe = self.lobe(light, viewer, dr.normalize(light + viewer))
            brdf = self.kd.eval(si, active) + self.ks.eval(si, active) * lobe
            return dr.select(active & above, brdf * light.z, 0)

        def pdf(self, ctx: Any, si: Any, wo: Any, active: Any = True) -> Any:
            half = dr.normalize(wo + si.wi)
            seen = self.facets.pdf(si.wi, half) / (4 * dr.dot(wo, half))
            above = (wo.z > 0) & (si.wi.z > 0)
            return dr.select(active & above, (seen + mi.warp.square_to_cosine_hemisphere_pdf(wo)) / 2, 0)

        def sample(self, ctx: Any, si: Any, sample1: Any, sample2: Any, active: Any = True) -> Any:
            half, _ = self.facets.sample(si.wi, sample2)
            by_cosine = mi.warp.square_to_cosine_hemisphere(sample2)
            wo = dr.select(sample1 < 0.5, by_cosine, mi.reflect(si.wi, half))
            bs = dr.zeros(mi.BSDFSample3f)
            bs.wo, bs.eta = wo, 1.0
            bs.sampled_type, bs.sampled_component = mi.UInt32(+self.m_flags), mi.UInt32(0)
            bs.pdf = self.pdf(ctx, si, wo, active)
            active &= bs.pdf > 0
            return bs, dr.select(active, self.eval(ctx, si, wo, active) / bs.pdf, 0)

        def read(self, props: Any) -> None:
            self.mu, self.width = props["mu"], props["width"]

        def relative_fresnel(self, cosine: Any) -> Any:
            if self.mu == 0:
                return 1.0
            return mi.fresnel(cosine, mi.Float(self.mu))[0] / ((self.mu - 1) / (self.mu + 1)) ** 2

    class Printed(Lobe):
        """RH01, section 5.2, as printed: F(mu, theta_o) / F(mu, 0) S(theta_h) / (4 cos theta_i cos theta_o)."""

        def lobe(self, light: Any, viewer: Any, half: Any) -> Any:
            sigma = self.width
            facets = dr.exp(-((dr.safe_acos(half.z) / sigma) ** 2)) / (np.pi * sigma**2)
            return self.relative_fresnel(viewer.z) * facets / (4 * light.z * viewer.z)

    class Correlated(Lobe):
        """F(mu, theta_d) / F(mu, 0) D G2 / (4 cos theta_i cos theta_o), heights correlated [Heitz 2014, eq. 98, 99]."""

        def lobe(self, light: Any, viewer: Any, half: Any) -> Any:
            g2 = 1 / (1 + self.shadowed(light) + self.shadowed(viewer))
            fresnel = self.relative_fresnel(dr.dot(viewer, half))
            return fresnel * self.density(half) * g2 / (4 * light.z * viewer.z)

    class CorrelatedGGX(Correlated):
        def density(self, half: Any) -> Any:
            # Walter et al. 2007, eq. 33
            tan2 = 1 / half.z**2 - 1
            return self.width**2 / (np.pi * half.z**4 * (self.width**2 + tan2) ** 2)

        def shadowed(self, w: Any) -> Any:
            # Heitz 2014, eq. 72
            return (dr.sqrt(1 + self.width**2 * (1 / w.z**2 - 1)) - 1) / 2

    class CorrelatedBeckmann(Correlated):
        def density(self, half: Any) -> Any:
            # Walter et al. 2007, eq. 25
            tan2 = 1 / half.z**2 - 1
            return dr.exp(-tan2 / self.width**2) / (np.pi * self.width**2 * half.z**4)

        def shadowed(self, w: Any) -> Any:
            # Heitz 2014, eq. 68
            a = 1 / (self.width * dr.sqrt(dr.maximum(1 / w.z**2 - 1, 1e-12)))
            return (dr.erf(a) - 1) / 2 + dr.exp(-(a**2)) / (2 * a * np.sqrt(np.pi))

    class ModifiedPhong(Lobe):
        """(s + 2) / (2 pi) cos^s alpha [Lafortune and Willems 1994]."""

        def read(self, props: Any) -> None:
            self.exponent = props["exponent"]
            self.width = (2 / (self.exponent + 2)) ** 0.5

        def lobe(self, light: Any, viewer: Any, half: Any) -> Any:
            mirrored = mi.Vector3f(-viewer.x, -viewer.y, viewer.z)
            cosine = dr.maximum(dr.dot(light, mirrored), 0)
            return (self.exponent + 2) / (2 * np.pi) * cosine**self.exponent

    mi.register_bsdf("rh01_printed", Printed)
    mi.register_bsdf("correlated_ggx", CorrelatedGGX)
    mi.register_bsdf("correlated_beckmann", CorrelatedBeckmann)
    mi.register_bsdf("phong", ModifiedPhong)


def lobe_of(material: Material) -> Plugin:
    """The registered plugin for a material. ValueError where it has none."""
    lobe = material.material if isinstance(material, Textured) else material
    described: Plugin
    match lobe:
        case MicrofacetMaterial(mu=mu, sigma=sigma):
            described = {"type": "rh01_printed", "mu": mu or 0.0, "width": sigma}
        case SmithMaterial(mu=float() | None as mu, facets=GGXSlopes() | BeckmannSlopes() as facets) if (
            lobe.is_isotropic
        ):
            kind = "correlated_ggx" if isinstance(facets, GGXSlopes) else "correlated_beckmann"
            described = {"type": kind, "mu": mu or 0.0, "width": facets.along}
        case PhongMaterial(exponent=exponent):
            described = {"type": "phong", "exponent": exponent}
        case _:
            raise ValueError(f"no plugin has been written for {lobe}")
    if isinstance(material, Textured):
        return described | {"kd": reflectance(material.kd_map), "ks": reflectance(material.ks_map)}
    return described | {"kd": reflectance(material.kd), "ks": reflectance(material.ks)}
