"""What passes a rough interface, as Mitsuba's `roughplastic` lets light in to its base and out again.

Each facet that is seen transmits what Fresnel's equations leave, and what other facets hide of the refracted light
is lost [Walter et al. 2007, eq. 21; single scattering].
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from invrender.brdf.fresnel import fresnel_reflectance
from invrender.brdf.smith import Smith
from invrender.output.export.directions import facet_directions

Floats = NDArray[np.float64]

_LEAST_COS = 1e-6
# Mitsuba reads both of tables with so many entries, evenly spaced in the cosine and straight between them.
_COS = np.maximum(np.linspace(0, 1, 64), _LEAST_COS)


def passed_and_kept(form: Smith, alpha: float, index: float, cos: Floats) -> tuple[Floats, float]:
    """Shares of light that come in at cosines (any shape), and of diffuse light that is reflected back from below."""
    outside, weights, mz = _facets_seen(form, alpha)
    inside = np.sqrt(1 - (1 - outside**2) / index**2)
    refracted = _shown(form, (inside - outside / index) * mz + _COS[:, None] / index, alpha)
    passed = (weights * (1 - fresnel_reflectance(index, outside)) * refracted).sum(axis=1)

    # From below, the same facets at the inverse index: beyond the critical angle they reflect all.
    sin2_outside = (1 - outside**2) * index**2
    cos_outside = np.sqrt(np.maximum(1 - sin2_outside, 0))
    reflectance = np.where(sin2_outside < 1, fresnel_reflectance(index, cos_outside), 1)
    reflected = _shown(form, 2 * outside * mz - _COS[:, None], alpha)
    kept = (weights * reflectance * reflected).sum(axis=1)
    return np.interp(cos, _COS, passed), 2 * float((kept * _COS).mean())


def _facets_seen(form: Smith, alpha: float) -> tuple[Floats, Floats, Floats]:
    """Of viewers at `_COS` (v,): cosines to facets and shares of the view, (v, n), and facets' own cosine (n,)."""
    facets, solid = facet_directions(alpha)
    density = form.density(np.arccos(facets[:, 2]), alpha) * solid
    toward = np.sqrt(1 - _COS[:, None] ** 2) * facets[:, 0] + _COS[:, None] * facets[:, 2]
    toward = np.clip(toward, 0, 1)
    shares = density * toward / (_COS + form.hidden(_COS, alpha))[:, None]
    return toward, shares, facets[:, 2]


def _shown(form: Smith, cos: Floats, alpha: float) -> Floats:
    """What other facets leave of light at a cosine; none from beyond the horizon."""
    above = np.maximum(cos, _LEAST_COS)
    return np.where(cos > 0, above / (above + form.hidden(above, alpha)), 0)
