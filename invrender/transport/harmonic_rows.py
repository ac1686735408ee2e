"""What each coefficient of the lighting sends to a sample: the diffuse and the specular rows of [RH01, eq. 25].

The specular row comes in three forms of transfer. `mirror` looks the light up in the mirror direction [eq. 22],
`filtered` does so in light that the lobe has blurred, exp(-(sigma l)^2) [eq. 20], `exact` is the lobe's own transfer at
the sample's exitant angle.
"""

from __future__ import annotations

from dataclasses import dataclass
from itertools import pairwise

import numpy as np
from numpy.polynomial.legendre import legvander
from numpy.typing import NDArray

from capture.arrays import frozen_array
from invrender.brdf.form import Angles, LobeForm
from invrender.brdf.fresnel import normalised_fresnel
from invrender.brdf.lobes import RH01_FORM
from invrender.brdf.microfacet import Microfacet
from invrender.theory.refinement import interval_rule
from invrender.theory.specialcases import microfacet_gaussian, microfacet_transfer
from invrender.transport.diffuse_base import base_rows
from invrender.transport.form_table import form_rows
from invrender.transport.lobe_table import Transfer, lobe_rows, lobe_table, mirrored_harmonics
from recon.harmonics.basis import degree_of, degrees
from recon.sampling.lightfield import LightField

Floats = NDArray[np.float64]
Singles = NDArray[np.float32]

# Where powers don't fall yet at the last degrees, they are taken to do so from there on, by this.
_SLOWEST_FALL = 0.95
# Angles of incidence, radians.
_HEAD_ON_EDGES = (0.0, 0.05, 0.2, 0.6, np.pi / 2)


@dataclass(frozen=True, eq=False)
class PhotoRows:
    """The samples of one photograph and their rows over lighting coefficients.

    field : samples of weight above 0. diffuse : (n, (l_max + 1)^2), radiance per unit of Kd. specular : the same of the
    specular part per unit of Ks, Fresnel's factor included; None where there is no specular part.
    """

    field: LightField
    diffuse: Singles
    specular: Singles | None

    def __post_init__(self) -> None:
        object.__setattr__(self, "diffuse", frozen_array(self.diffuse, np.float32))
        if self.specular is not None:
            object.__setattr__(self, "specular", frozen_array(self.specular, np.float32))

    def of_channel(self, brdf: Microfacet, channel: int, degree: int) -> Floats:
        """Rows (n, (degree + 1)^2) whose product with a channel's coefficients is its radiance; degree <= l_max."""
        first = slice((degree + 1) ** 2)
        rows = brdf.kd[channel] * self.diffuse[:, first].astype(float)
        if self.specular is not None:
            rows += brdf.ks[channel] * self.specular[:, first]
        return np.asarray(rows)

    def power_beyond(self, brdf: Microfacet, degree: int) -> Floats:
        """Sum of squares (n, 3) of the entries of a sample's row above a degree, up to l_max and beyond.

        Beyond it powers are taken to fall on as they do over the last four degrees; lobes' fall ever faster. They are
        added up in pairs, since a diffuse surface shows even degrees only.
        """
        l_max = degree_of(self.diffuse.shape[1])
        l = degrees(l_max)
        power = np.empty((len(self.field), 3))
        for channel in range(3):
            squares = self.of_channel(brdf, channel, l_max) ** 2
            last = squares[:, l > l_max - 2].sum(axis=1)
            before = squares[:, (l > l_max - 4) & (l <= l_max - 2)].sum(axis=1)
            fall = np.minimum(last / np.maximum(before, 1e-300), _SLOWEST_FALL)
            power[:, channel] = squares[:, l > degree].sum(axis=1) + last * fall / (1 - fall)
        return power

    def predict(self, brdf: Microfacet, coefficients: Floats) -> Floats:
        """Radiance (n, 3) under lighting coefficients ((degree + 1)^2, 3)."""
        first = slice(len(coefficients))
        radiance = brdf.kd * (self.diffuse[:, first] @ coefficients)
        if self.specular is not None:
            radiance += brdf.ks * (self.specular[:, first] @ coefficients)
        return np.asarray(radiance)


def photo_rows(field: LightField, brdf: Microfacet, l_max: int, transfer: Transfer = "exact") -> PhotoRows:
    """Rows of a photograph's samples of an unshadowed, convex object, each the mean over its sample's rays."""
    field = field.where(field.weight > 0)
    diffuse = field.mean_over_rays(base_rows(brdf.form, brdf.mu, field.normals, field.views, l_max))
    if brdf.sigma is None or not brdf.ks.any():
        return PhotoRows(field, diffuse.astype(np.float32), None)
    cos = np.einsum("nk,nk->n", field.normals, field.views)
    fresnel = normalised_fresnel(brdf.mu, cos)
    rays: Floats | Singles
    if transfer == "exact" and brdf.form is not RH01_FORM:
        rays, _, _ = form_rows(field, l_max, brdf.form, brdf.mu, brdf.sigma)
    elif transfer == "exact":
        rays = lobe_rows(field, lobe_table(l_max).at_angles(brdf.sigma)[:, :1], fresnel)[0]
    else:
        blurred = lobe_blur(brdf, l_max, transfer)[degrees(l_max)]
        rays = fresnel[:, None] * blurred * mirrored_harmonics(field, l_max)
    return PhotoRows(field, diffuse.astype(np.float32), field.mean_over_rays(rays).astype(np.float32))


def lobe_blur(brdf: Microfacet, l_max: int, transfer: Transfer = "exact") -> Floats:
    """Factor (l_max + 1,) by which a lobe leaves each degree of the light, seen head-on, per unit of degree 0.

    Of the transfers only `exact` knows of the lobe's form.
    """
    assert brdf.sigma is not None
    if transfer == "mirror":
        return np.ones(l_max + 1)
    if transfer == "filtered":
        return microfacet_gaussian(brdf.sigma, l_max)
    if brdf.form is RH01_FORM:
        factors = microfacet_transfer(brdf.sigma, l_max)
    else:
        factors = _head_on(brdf.form, brdf.mu, brdf.sigma, l_max)
    return factors / factors[0]


def _head_on(form: LobeForm, mu: float | None, sigma: float, l_max: int) -> Floats:
    """The zonal transfer (l_max + 1,) of a lobe at normal exitance, F W cos theta_i over the hemisphere."""
    # Panels that grow from the lobe's middle: the narrowest lobes and the longest tails meet enough nodes.
    panels = [interval_rule(32 + l_max, low, high) for low, high in pairwise(_HEAD_ON_EDGES)]
    theta, weight = (np.concatenate(each) for each in zip(*panels, strict=True))
    cos, cos_half = np.cos(theta), np.cos(theta / 2)
    seen = form.reflected(Angles(theta / 2, cos, np.ones_like(cos), cos_half), mu, sigma)
    return np.asarray(legvander(cos, l_max).T @ (2 * np.pi * seen * np.sin(theta) * weight))


def mirrored_views(field: LightField) -> Floats:
    """Unit directions (n, 3) of the light that a mirror in each sample's place would show, means over its rays."""
    cos = np.einsum("nk,nk->n", field.normals, field.views)[:, None]
    mean = np.asarray(field.mean_over_rays(2 * cos * field.normals - field.views))
    return mean / np.linalg.norm(mean, axis=1, keepdims=True)
