"""Radiance of samples under one element of light, with its slopes in the BRDF's numbers.

As `invrender.transport.predict` [RH01, eq. 24], its parts kept apart:

    B = Kd E + Ks S(mu, sigma)

E is the irradiance, as far as an interface lets it in and out again (`invrender.transport.diffuse_base`), S what the
lobe gathers, Fresnel's factor included, both of them as far as a mesh doesn't hide the light from itself
(`invrender.transport.visibility`), and with what it sends itself (`invrender.transport.radiosity`).
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from invrender.brdf.microfacet import Microfacet
from invrender.transport.diffuse_base import base_transfer
from invrender.transport.lobe_transfer import SourceWidths, gathered
from invrender.transport.radiosity import Bounced
from invrender.transport.reflected import ReflectedMap
from invrender.transport.transfer import LightElement
from invrender.transport.visibility import Rays, RayVisibility, Shadows, facing, seen_specular
from recon.sampling.draw import MIN_COS_EXITANT
from recon.sampling.lightfield import LightField

Floats = NDArray[np.float64]

# Numbers of the BRDF, in the order of slopes and covariances: kd, ks, mu, sigma.
SLOPES = 4
# Central differences in mu and sigma: far above what single precision of the map's look-up rounds, and their
# error, of second order, far below a percent of the slope.
_STEP = 5e-3


def shade(
    brdf: Microfacet,
    element: LightElement,
    field: LightField,
    shadows: Shadows | None = None,
    slopes: bool = False,
    reflected: ReflectedMap | None = None,
    bounced: Bounced | None = None,
) -> tuple[Floats, Floats | None]:
    """Radiance (n, 3) of samples and, if asked for, its slopes (n, 4, 3) in kd, ks, mu and sigma.

    brdf : its kd and ks may be those of each ray, (m, 3). element : of known strength. shadows : of a mesh,
    if it has any. reflected : of the element's map, in place of an integral for each ray; not with slopes. bounced :
    what the mesh sends itself under the element, if that is to be added; what it hangs on isn't in the slopes.
    """
    field = facing(field)
    visible = None if shadows is None else shadows.visible(element, field)
    diffuse = _base(brdf, brdf.mu, element, field, visible)
    mirrored: Floats | float = 0.0
    if bounced is not None:
        by_mesh, mirrored = bounced.reflected(field, brdf)
        diffuse = diffuse + by_mesh
    gradient = np.zeros((len(diffuse), SLOPES, 3)) if slopes else None
    if gradient is not None:
        gradient[:, 0] = diffuse
    total = brdf.kd * diffuse
    if brdf.sigma is not None:
        widths = _stepped(brdf.mu, brdf.sigma) if slopes else [(brdf.mu, brdf.sigma)]

        def gather(light: LightElement, rays: Rays) -> Floats:
            normals, views = field.normals[rays], field.views[rays]
            if reflected is None or light.slow_map is None:
                return gathered(brdf.form, light, normals, views, widths)
            rest = gathered(brdf.form, replace(light, slow_map=None), normals, views, widths)
            steep = (normals * views).sum(axis=1) < MIN_COS_EXITANT
            rest[~steep] += reflected.towards(normals[~steep], views[~steep])[:, None]
            rest[steep] = gathered(brdf.form, light, normals[steep], views[steep], widths)
            return rest

        specular = seen_specular(element, visible, gather)
        seen = specular[:, 0] + mirrored
        total = total + brdf.ks * seen
        if gradient is not None:
            gradient[:, 1] = seen
            gradient[:, 3] = brdf.ks * (specular[:, 2] - specular[:, 1]) / (2 * _STEP * brdf.sigma)
            if brdf.mu is not None:
                gradient[:, 2] = brdf.ks * (specular[:, 4] - specular[:, 3]) / (2 * _STEP * brdf.mu)
                if brdf.form.interface:
                    ends = [brdf.mu * step for step in (1 - _STEP, 1 + _STEP)]
                    low, high = (_base(brdf, end, element, field, visible) for end in ends)
                    gradient[:, 2] += brdf.kd * (high - low) / (2 * _STEP * brdf.mu)
    radiance = np.asarray(field.mean_over_rays(total))
    return radiance, None if gradient is None else np.asarray(field.mean_over_rays(gradient))


def _base(
    brdf: Microfacet,
    mu: float | None,
    element: LightElement,
    field: LightField,
    visible: RayVisibility | None,
) -> Floats:
    return base_transfer(brdf.form, mu, element, field.normals, field.views, visible)


def _stepped(mu: float | None, sigma: float) -> list[SourceWidths]:
    """Mu and sigma themselves, then a step less and more of sigma, and of mu if there is one."""
    steps: list[SourceWidths] = [(mu, sigma), *((mu, sigma * step) for step in (1 - _STEP, 1 + _STEP))]
    return steps if mu is None else [*steps, *((mu * step, sigma) for step in (1 - _STEP, 1 + _STEP))]
