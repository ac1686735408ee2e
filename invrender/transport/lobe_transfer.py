"""What lobes of any form gather of an element of light, for several of their widths at once."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from invrender.brdf.form import LobeForm
from invrender.brdf.fresnel import normalised_fresnel
from invrender.brdf.lobes import RH01_FORM
from invrender.transport.form_transfer import form_transfer
from invrender.transport.transfer import LightElement, specular_transfer

Floats = NDArray[np.float64]
# mu, None without a Fresnel factor, and sigma in radians.
SourceWidths = tuple[float | None, float]


def gathered(
    form: LobeForm, element: LightElement, normals: Floats, views: Floats, widths: Sequence[SourceWidths]
) -> Floats:
    """Radiance (m, widths, channels) per unit of Ks, Fresnel's factor included, of unshadowed surfaces.

    normals, views : (m, 3) unit.
    """
    mus = tuple(dict.fromkeys(mu for mu, _ in widths))
    sigmas = tuple(dict.fromkeys(sigma for _, sigma in widths))
    of_sigma = [sigmas.index(sigma) for _, sigma in widths]
    of_mu = [mus.index(mu) for mu, _ in widths]
    if form is RH01_FORM:
        # In double precision, which is all that this has before `form_transfer`.
        factors = Indices(mus)((normals * views).sum(axis=1))
        plain = specular_transfer(element, normals, views, np.array(sigmas))
        return np.asarray(factors[:, of_mu, None] * plain[:, of_sigma])
    found = form_transfer(form, element, normals, views, np.array(sigmas), Indices(mus))
    return np.asarray(found[:, of_mu, of_sigma], float)


@dataclass(frozen=True)
class Indices:
    """Fresnel's factors of several refractive indices, each relative to normal incidence; None for no factor."""

    mus: tuple[float | None, ...]

    def __call__(self, cos: Floats) -> Floats:
        """F (..., k) at cosines (...,)."""
        return np.stack([normalised_fresnel(mu, np.clip(cos, 0, 1)) for mu in self.mus], axis=-1)
