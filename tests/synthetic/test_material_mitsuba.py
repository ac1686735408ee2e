"""Exact microfacets against Mitsuba 3's rough conductor and rough dielectric, lobe by lobe."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from numpy.testing import assert_allclose

from synthetic.materials.facets import BeckmannSlopes, Facets, GGXSlopes
from synthetic.materials.fresnel import fresnel_at_normal
from synthetic.materials.smith import SmithMaterial

mi = pytest.importorskip("mitsuba")
mi.set_variant("scalar_rgb")

ZERO = np.zeros(3)
COLOUR = np.array([0.9, 0.5, 0.2])
FACETS = [
    kind(*widths) for kind in (BeckmannSlopes, GGXSlopes) for widths in ((0.05, 0.05), (0.4, 0.4), (0.1, 0.5))
]


def pairs(rng: np.random.Generator, count: int) -> tuple[np.ndarray, np.ndarray]:
    """Directions (n, 3) away from grazing, half of them near the mirror direction."""
    wi, wo = rng.normal(size=(2, count, 3))
    wi[::2] = wo[::2] / np.linalg.norm(wo[::2], axis=1, keepdims=True) * [-1, -1, 1] + 0.1 * wi[::2]
    w = np.stack([wi, wo])
    w[..., 2] = np.abs(w[..., 2])
    w /= np.linalg.norm(w, axis=-1, keepdims=True)
    clear = (w[..., 2] > 0.05).all(axis=0)
    return w[0, clear], w[1, clear]


def mitsuba_brdf(bsdf: dict[str, Any], wi: np.ndarray, wo: np.ndarray) -> np.ndarray:
    plugin = mi.load_dict(bsdf)
    context = mi.BSDFContext()
    values = []
    for light, viewer in zip(wi, wo, strict=True):
        si = mi.SurfaceInteraction3f()
        # Mitsuba's wi is the viewer, its wo the light; `eval` includes the light's cosine.
        si.wi = viewer.tolist()
        values.append(np.array(plugin.eval(context, si, light.tolist())) / light[2])
    return np.array(values)


def with_uncorrelated_heights(facets: Facets, lobe: np.ndarray, wi: np.ndarray, wo: np.ndarray) -> np.ndarray:
    """The lobe with G1(wi) G1(wo), which Mitsuba takes, in place of the G2 of correlated heights."""
    hidden = [facets.hidden(w) / w[:, 2] for w in (wi, wo)]
    return lobe * ((1 + hidden[0] + hidden[1]) / ((1 + hidden[0]) * (1 + hidden[1])))[:, None]


def described(facets: Facets, kind: str) -> dict[str, Any]:
    distribution = "beckmann" if isinstance(facets, BeckmannSlopes) else "ggx"
    return {"type": kind, "distribution": distribution, "alpha_u": facets.along, "alpha_v": facets.across}


@pytest.mark.parametrize("facets", FACETS, ids=str)
def test_rough_conductors_agree(facets: Facets, rng: np.random.Generator) -> None:
    wi, wo = pairs(rng, 400)
    reflectance = {"type": "rgb", "value": COLOUR.tolist()}
    theirs = mitsuba_brdf(
        described(facets, "roughconductor") | {"material": "none", "specular_reflectance": reflectance},
        wi,
        wo,
    )
    ours = (
        with_uncorrelated_heights(facets, SmithMaterial(ZERO, COLOUR, None, facets).lobe(wi, wo), wi, wo)
        * COLOUR
    )
    # Single precision; Mitsuba's masking of Beckmann is a rational fit, good to 0.35%, on either side.
    rtol = 2e-4 if isinstance(facets, GGXSlopes) else 7.5e-3
    # Mitsuba sets densities below 1e-20 to 0.
    assert_allclose(ours, theirs, rtol=rtol, atol=1e-6)
    assert (theirs > 1e-3).mean() > 0.3


@pytest.mark.parametrize("facets", FACETS, ids=str)
@pytest.mark.parametrize("mu", [1.5, 0.2 + 3.9j])
def test_fresnel_agrees(facets: Facets, mu: complex, rng: np.random.Generator) -> None:
    wi, wo = pairs(rng, 200)
    if isinstance(mu, complex):
        index = {name: {"type": "rgb", "value": [v] * 3} for name, v in (("eta", mu.real), ("k", mu.imag))}
        bsdf = described(facets, "roughconductor") | index
    else:
        bsdf = described(facets, "roughdielectric") | {"int_ior": mu, "ext_ior": 1.0}
    theirs = mitsuba_brdf(bsdf, wi, wo)
    # The reflectance of the facets at normal incidence is F(mu, 0).
    material = SmithMaterial(ZERO, np.full(3, fresnel_at_normal(mu)), mu, facets)
    ours = with_uncorrelated_heights(facets, material.lobe(wi, wo), wi, wo) * material.ks
    # As above; the Fresnel equations in single precision lose little.
    assert_allclose(ours, theirs, rtol=5e-4 if isinstance(facets, GGXSlopes) else 8e-3, atol=1e-6)
