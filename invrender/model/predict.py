"""Prediction of radiance from a BRDF and lighting, directly and through prepared columns."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from invrender.model.columns import PhotoColumns, specular_weights
from invrender.model.fresnel import normalised_fresnel
from invrender.model.microfacet import Microfacet
from invrender.model.transfer import LightElement, specular_transfer
from invrender.model.visibility import Shadows, seen_diffuse, seen_specular
from recon.lightfield import LightField

Floats = NDArray[np.float64]


def predict(
    brdf: Microfacet,
    elements: Sequence[LightElement],
    strengths: Floats,
    field: LightField,
    shadows: Shadows | None = None,
) -> Floats:
    """Radiance (n, 3) of samples, without tables or interpolation [RH01, eq. 24].

    strengths : (elements, 3). shadows : of a mesh, if it has any.
    """
    total = np.zeros((len(field.normals), 3))
    cos = (field.normals * field.views).sum(axis=1)
    fresnel = normalised_fresnel(brdf.mu, cos)[:, None]
    sigmas = np.array([brdf.sigma or np.nan])
    for element, strength in zip(elements, strengths, strict=True):
        sight = None if shadows is None else shadows.sight(element, field)
        total += brdf.kd * strength * seen_diffuse(element, field.normals, sight)
        if brdf.sigma is not None and brdf.ks.any():
            lobe = seen_specular(
                element,
                sight,
                lambda part, rays: specular_transfer(part, field.normals[rays], field.views[rays], sigmas),
            )
            total += brdf.ks * strength * fresnel * lobe[:, 0]
    return np.asarray(field.mean_over_rays(total))


def transfers(photo: PhotoColumns, mu: float | None, sigma: float | None) -> tuple[Floats, Floats]:
    """Diffuse and specular transfers of a photograph's samples at mu and sigma, (channels, n, elements) each."""
    diffuse = photo.columns[..., 0].astype(float)
    if sigma is None:
        return diffuse, np.zeros_like(diffuse)
    weights = specular_weights(mu, sigma).astype(np.float32)
    return diffuse, (photo.columns[..., 1:] @ weights).astype(float)


def predict_columns(photo: PhotoColumns, brdf: Microfacet, strengths: Floats) -> Floats:
    """Radiance (n, 3) of a photograph's samples through its columns."""
    diffuse, specular = transfers(photo, brdf.mu, brdf.sigma)
    shading = brdf.kd[:, None, None] * diffuse + brdf.ks[:, None, None] * specular
    return np.einsum("cne,ec->nc", shading, strengths)
