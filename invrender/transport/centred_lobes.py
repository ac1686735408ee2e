"""A fitted BRDF as lobes about their own centres, as reflection maps take it [R02, section 5.3.1]."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from invrender.brdf.microfacet import Microfacet
from invrender.prefilter.centred import (
    CentredBrdf,
    CentredLobe,
    ViewFactor,
    lambertian_lobe,
    specular_lobe,
)
from invrender.transport.diffuse_base import interface_transmittance

Floats = NDArray[np.float64]

# Where the transmittance towards the viewer is tabulated.
_COS = np.linspace(0, 1, 200)


def centred_microfacet(brdf: Microfacet, description: str) -> CentredBrdf:
    """A fitted BRDF as a diffuse lobe about the normal and a specular one about the mirrored view.

    ValueError where it is black, and for a brushed one, whose lobe isn't symmetric about anything.
    """
    if brdf.form.axis is not None:
        raise ValueError(
            f"{description}: its lobe is brushed, and reflection maps are of lobes that look the same from all"
            " azimuths; render it instead (lightfactor render)"
        )
    form, mu, sigma = brdf.form, brdf.mu, brdf.sigma
    lobes: list[CentredLobe] = []
    if brdf.kd.any():
        lobes.append(_base(brdf))
    if brdf.ks.any() and sigma is not None:
        lobes.append(specular_lobe("specular", (form.lobe_of(mu, sigma),), brdf.ks))
    if not lobes:
        raise ValueError(f"{description}: Kd and Ks are 0, so that it reflects nothing; give another BRDF")
    return CentredBrdf(description, tuple(lobes))


def _base(brdf: Microfacet) -> CentredLobe:
    """What is below the lobe. Above a base under an interface or a coat, the share towards the viewer is its factor."""
    form, mu = brdf.form, brdf.mu
    if not form.interface and form.coat is None:
        return lambertian_lobe("diffuse", brdf.kd)

    def base(normals: Floats, wi: Floats, wo: Floats) -> Floats:
        cos = np.maximum((normals * wi).sum(axis=-1), 0)
        return cos * interface_transmittance(form, mu, cos)

    factor = ViewFactor(_COS, interface_transmittance(form, mu, _COS))
    return CentredLobe("diffuse", (base,), brdf.kd, False, factor)
