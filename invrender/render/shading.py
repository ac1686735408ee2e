"""Radiance of samples under one element of light, with its slopes in the BRDF's numbers, and a mesh's own shadows.

As `invrender.model.predict` [RH01, eq. 24], its parts kept apart:

    B = Kd E + Ks F(mu, theta_o) S(sigma)

E is the irradiance, S what the lobe gathers. On a mesh, sources and the mirrored direction of the view are visible or
not, ray by ray, and the irradiance from the map is that of shadowed vertices. What hides light counts as black: light
from one part of the object to another is left out.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from invrender.model.fresnel import normalised_fresnel
from invrender.model.microfacet import Microfacet
from invrender.model.transfer import LightElement, diffuse_transfer, specular_transfer
from recon.lightfield import LightField

Floats = NDArray[np.float64]

# Numbers of the BRDF, in the order of slopes and covariances: kd, ks, mu, sigma.
SLOPES = 4
# Central differences in mu and sigma: far above what single precision of the map's look-up rounds, and their
# error, of second order, far below a percent of the slope.
_STEP = 5e-3
# The lobe as printed grows as 1 / cos theta_o: normals that a mesh's smoothing turns further from the view than
# this are turned back to it, as of a sphere only its outermost 0.05% are.
_MIN_COS = 0.03


def shade(
    brdf: Microfacet,
    element: LightElement,
    field: LightField,
    sky: Floats | None = None,
    slopes: bool = False,
) -> tuple[Floats, Floats | None]:
    """Radiance (n, 3) of samples and, if asked for, its slopes (n, 4, 3) in kd, ks, mu and sigma.

    element : of known strength. field : with `sources_visible` of the element's sources. sky : (m, 3), irradiance of
    each ray's point from the element's map under the body's own shadows; None of a convex body, which has none.
    """
    normals = _towards(field.normals, field.views)
    diffuse = _diffuse(element, field, normals, sky)
    if brdf.sigma is None:
        radiance = field.mean_over_rays(brdf.kd * diffuse)
        if not slopes:
            return np.asarray(radiance), None
        gradient = np.zeros((len(normals), SLOPES, 3))
        gradient[:, 0] = diffuse
        return np.asarray(radiance), np.asarray(field.mean_over_rays(gradient))
    steps = np.array([1.0, 1 - _STEP, 1 + _STEP]) if slopes else np.ones(1)
    gathered = _specular(element, field, normals, brdf.sigma * steps, sky is not None)
    cos = (normals * field.views).sum(axis=1)
    fresnel = normalised_fresnel(brdf.mu, cos)[:, None]
    specular = fresnel * gathered[:, 0]
    radiance = field.mean_over_rays(brdf.kd * diffuse + brdf.ks * specular)
    if not slopes:
        return np.asarray(radiance), None
    gradient = np.zeros((len(normals), SLOPES, 3))
    gradient[:, 0], gradient[:, 1] = diffuse, specular
    if brdf.mu is not None:
        low, high = (normalised_fresnel(brdf.mu * step, cos)[:, None] for step in steps[1:])
        gradient[:, 2] = brdf.ks * gathered[:, 0] * (high - low) / (2 * _STEP * brdf.mu)
    gradient[:, 3] = brdf.ks * fresnel * (gathered[:, 2] - gathered[:, 1]) / (2 * _STEP * brdf.sigma)
    return np.asarray(radiance), np.asarray(field.mean_over_rays(gradient))


def _diffuse(element: LightElement, field: LightField, normals: Floats, sky: Floats | None) -> Floats:
    if sky is None:
        return diffuse_transfer(element, normals)
    cos = np.maximum(normals @ element.directions.T, 0) * field.sources_visible
    return np.asarray(cos @ element.irradiances + sky)


def _specular(
    element: LightElement, field: LightField, normals: Floats, sigmas: Floats, shadowed: bool
) -> Floats:
    if not shadowed:
        return specular_transfer(element, normals, field.views, sigmas)
    rest = replace(element, directions=np.zeros((0, 3)), irradiances=np.zeros((0, element.channels)))
    total = specular_transfer(rest, normals, field.views, sigmas) * field.reflected_visible[:, None, None]
    for k, visible in enumerate(field.sources_visible.T):
        one = slice(k, k + 1)
        source = replace(
            element, directions=element.directions[one], irradiances=element.irradiances[one], slow_map=None
        )
        total += specular_transfer(source, normals, field.views, sigmas) * visible[:, None, None]
    return total


def _towards(normals: Floats, views: Floats) -> Floats:
    """Normals (m, 3), those too far from the view turned to the least cosine."""
    cos = (normals * views).sum(axis=1)
    turned = np.flatnonzero(cos < _MIN_COS)
    if not len(turned):
        return normals
    across = normals[turned] - cos[turned, None] * views[turned]
    across /= np.maximum(np.linalg.norm(across, axis=1, keepdims=True), 1e-12)
    result = normals.copy()
    result[turned] = _MIN_COS * views[turned] + np.sqrt(1 - _MIN_COS**2) * across
    return result
