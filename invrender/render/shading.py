"""Radiance of samples under one element of light, with its slopes in the BRDF's numbers, and a mesh's own shadows.

As `invrender.model.predict` [RH01, eq. 24], its parts kept apart:

    B = Kd E + Ks S(mu, sigma)

E is the irradiance, S what the lobe gathers, Fresnel's factor included. On a mesh, sources and the mirrored direction
of the view are visible or not, ray by ray, and the irradiance from the map is that of shadowed vertices. What hides
light counts as black: light from one part of the object to another is left out.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from invrender.model.microfacet import Microfacet
from invrender.model.transfer import LightElement, diffuse_transfer
from invrender.render.lobe import Widths, gathered
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

    brdf : its kd and ks may be those of each ray, (m, 3). element : of known strength. field : with `sources_visible`
    of the element's sources. sky : (m, 3), irradiance of each ray's point from the element's map under the body's
    own shadows; None of a convex body, which has none.
    """
    normals = _towards(field.normals, field.views)
    diffuse = _diffuse(element, field, normals, sky)
    gradient = np.zeros((len(normals), SLOPES, 3)) if slopes else None
    if gradient is not None:
        gradient[:, 0] = diffuse
    total = brdf.kd * diffuse
    if brdf.sigma is not None:
        widths = _stepped(brdf.mu, brdf.sigma) if slopes else [(brdf.mu, brdf.sigma)]
        specular = _specular(brdf, element, field, normals, widths, sky is not None)
        total = total + brdf.ks * specular[:, 0]
        if gradient is not None:
            gradient[:, 1] = specular[:, 0]
            gradient[:, 3] = brdf.ks * (specular[:, 2] - specular[:, 1]) / (2 * _STEP * brdf.sigma)
            if brdf.mu is not None:
                gradient[:, 2] = brdf.ks * (specular[:, 4] - specular[:, 3]) / (2 * _STEP * brdf.mu)
    radiance = np.asarray(field.mean_over_rays(total))
    return radiance, None if gradient is None else np.asarray(field.mean_over_rays(gradient))


def _stepped(mu: float | None, sigma: float) -> list[Widths]:
    """Mu and sigma themselves, then a step less and more of sigma, and of mu if there is one."""
    steps: list[Widths] = [(mu, sigma), *((mu, sigma * step) for step in (1 - _STEP, 1 + _STEP))]
    return steps if mu is None else [*steps, *((mu * step, sigma) for step in (1 - _STEP, 1 + _STEP))]


def _diffuse(element: LightElement, field: LightField, normals: Floats, sky: Floats | None) -> Floats:
    if sky is None:
        return diffuse_transfer(element, normals)
    cos = np.maximum(normals @ element.directions.T, 0) * field.sources_visible
    return np.asarray(cos @ element.irradiances + sky)


def _specular(
    brdf: Microfacet,
    element: LightElement,
    field: LightField,
    normals: Floats,
    widths: Sequence[Widths],
    shadowed: bool,
) -> Floats:
    """S (m, widths, 3) of rays."""
    if not shadowed:
        return gathered(brdf.form, element, normals, field.views, widths)
    rest = replace(element, directions=np.zeros((0, 3)), irradiances=np.zeros((0, element.channels)))
    total = gathered(brdf.form, rest, normals, field.views, widths) * field.reflected_visible[:, None, None]
    for k, visible in enumerate(field.sources_visible.T):
        one = slice(k, k + 1)
        source = replace(
            element, directions=element.directions[one], irradiances=element.irradiances[one], slow_map=None
        )
        total += gathered(brdf.form, source, normals, field.views, widths) * visible[:, None, None]
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
