"""Pictures under one element of light: radiance of samples, and its slopes in the BRDF's numbers.

As `invrender.transport.predict` [RH01, eq. 24], with normals that a mesh's smoothing turns away turned back (`facing`),
and with what the mesh sends itself (`invrender.transport.radiosity`).
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from invrender.brdf.microfacet import Microfacet
from invrender.transport.column_basis import around
from invrender.transport.columns import photo_columns
from invrender.transport.interpolated import InterpolatedLobe
from invrender.transport.predict import reflected, transfer_slope, transfers
from invrender.transport.radiosity import Bounced
from invrender.transport.reflected import ReflectedMap
from invrender.transport.transfer import LightElement
from invrender.transport.visibility import Shadows, facing
from recon.sampling.lightfield import LightField

Floats = NDArray[np.float64]

_ONE = np.ones((1, 3))


def shade(
    brdf: Microfacet,
    element: LightElement,
    field: LightField,
    shadows: Shadows | None = None,
    prepared: ReflectedMap | InterpolatedLobe | None = None,
    bounced: Bounced | None = None,
) -> Floats:
    """Radiance (n, 3) of samples.

    brdf : its kd and ks may be those of each ray, (m, 3). element : of known strength. shadows : of a mesh,
    if it has any. prepared : of the element's map, in place of an integral for each ray. bounced : what the mesh sends
    itself under the element, if that is to be added.
    """
    field = facing(field)
    diffuse, specular = reflected(brdf, (element,), _ONE, field, shadows, prepared)
    if bounced is not None:
        by_mesh, mirrored = bounced.reflected(field, brdf)
        diffuse, specular = diffuse + by_mesh, specular + mirrored
    return np.asarray(field.mean_over_rays(brdf.kd * diffuse + brdf.ks * specular))


def shade_with_slopes(
    brdf: Microfacet,
    element: LightElement,
    field: LightField,
    shadows: Shadows | None = None,
    bounced: Bounced | None = None,
) -> tuple[Floats, Floats]:
    """Radiance (n, 3) of samples and its slopes (n, 4, 3) in kd, ks, mu and sigma; arguments as of `shade`.

    kd and ks of a sample's rays are their mean. What bounced light hangs on isn't in the slopes.
    """
    field = facing(field)
    kd, ks = (field.mean_over_rays(np.broadcast_to(of, field.normals.shape)) for of in (brdf.kd, brdf.ks))
    photo = photo_columns("", (element,), field, brdf.form, shadows, basis=around(brdf.mu, brdf.sigma))
    slopes = np.zeros((len(field), 4, 3))
    slopes[:, 0], slopes[:, 1] = (part[:, :, 0].T for part in transfers(photo, brdf))
    if bounced is not None:
        for k, part in enumerate(bounced.reflected(field, brdf)):
            slopes[:, k] += field.mean_over_rays(part)
    radiance = kd * slopes[:, 0] + ks * slopes[:, 1]
    for k, name in ((2, "mu"), (3, "sigma")):
        if getattr(brdf, name) is not None:
            diffuse, specular = (part[:, :, 0].T for part in transfer_slope(photo, brdf, name))
            slopes[:, k] = kd * diffuse + ks * specular
    return radiance, slopes
