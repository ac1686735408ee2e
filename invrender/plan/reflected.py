"""What samples reflect, by RH01's model under visibility (`invrender.transport.visibility`), and its slopes."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from invrender.brdf.fresnel import normalised_fresnel
from invrender.brdf.microfacet import Microfacet
from invrender.plan.experiment import PlannedLight
from invrender.theory.specialcases import lobe
from invrender.transport.transfer import LightElement, light_elements, specular_transfer
from invrender.transport.visibility import Rays, RayVisibility, Shadows, seen_diffuse, seen_specular
from recon.mesh.bodies import Body, MeshBody
from recon.mesh.tangents import tangents
from recon.mesh.transfer import transfer_vectors
from recon.sampling.lightfield import LightField

Floats = NDArray[np.float64]

# Central differences: of mu and sigma relative, of directions in radians.
_STEP = 1e-3
# Rays per vertex that look for shadows of the sky: what is planned needs no more.
_RAYS = 96


@dataclass(frozen=True, eq=False)
class Reflected:
    """What n samples reflect of some light, per unit of Kd and of Ks, (n, c) each; c is 3, or 1 where channels agree.

    by_mu, by_sigma : derivatives of `lobe`, the specular part with its Fresnel factor.
    """

    diffuse: Floats
    lobe: Floats
    by_mu: Floats
    by_sigma: Floats

    def __add__(self, other: Reflected) -> Reflected:
        return Reflected(
            self.diffuse + other.diffuse,
            self.lobe + other.lobe,
            self.by_mu + other.by_mu,
            self.by_sigma + other.by_sigma,
        )

    def times(self, strength: Floats) -> Reflected:
        """Under light so many times as strong, (3,)."""
        return Reflected(
            self.diffuse * strength, self.lobe * strength, self.by_mu * strength, self.by_sigma * strength
        )

    def radiance(self, brdf: Microfacet) -> Floats:
        """Radiance (n, 3) [RH01, eq. 24]."""
        return np.asarray(brdf.kd * self.diffuse + brdf.ks * self.lobe)

    def columns(self, brdf: Microfacet) -> list[Floats]:
        """Derivatives (n, 3) of the radiance in each channel's Kd and Ks, in mu and in sigma, as the BRDF has them."""
        if brdf.sigma is None:
            return [self.diffuse]
        by_mu = [] if brdf.mu is None else [brdf.ks * self.by_mu]
        return [self.diffuse, self.lobe, *by_mu, brdf.ks * self.by_sigma]


@dataclass(frozen=True, eq=False)
class LightParts:
    """A lighting taken apart, so that each part has its own visibility.

    slow : what varies slowly, or None. spots : (h, 3), directions of the map's outstanding pixels, with
        `spot_irradiances` (h, 3). sources : (k, 3), directions, with `irradiances` (k, 3).
    """

    slow: LightElement | None
    spots: Floats
    spot_irradiances: Floats
    sources: Floats
    irradiances: Floats

    @property
    def compact(self) -> Floats:
        """Directions (k + h, 3) whose visibility samples are asked for: sources, then spots."""
        return np.concatenate([self.sources, self.spots])


class ReflectingObject:
    """An object and its BRDF: what samples of it reflect.

    shadows : of a mesh, up to the degree of unknown light and not below 8; None of a sphere.
    """

    def __init__(self, body: Body, brdf: Microfacet, degree: int) -> None:
        self.brdf = brdf
        self.shadows: Shadows | None = None
        if isinstance(body, MeshBody):
            self.shadows = Shadows.of(body, transfer_vectors(body.mesh, max(degree, 8), _RAYS))

    def parts(self, light: PlannedLight) -> LightParts:
        """A light taken apart."""
        lighting = light.lighting
        known = light_elements(replace(lighting, recover_irradiance=False, recover_ambient=False))[0]
        count = len(lighting.directions)
        dark = replace(known, directions=np.zeros((0, 3)), irradiances=np.zeros((0, 3)))
        slow = dark if known.slow_map is not None else None
        return LightParts(
            slow,
            known.directions[count:],
            known.irradiances[count:],
            known.directions[:count],
            known.irradiances[:count],
        )

    def of_extended(self, parts: LightParts, field: LightField) -> Reflected:
        """What the slow part and the spots of a lighting give; `sources_visible` as `LightParts.compact` has it."""
        count = len(parts.sources)
        total = Reflected(*(np.zeros((len(field), 3)) for _ in range(4)))
        for k, (direction, irradiance) in enumerate(zip(parts.spots, parts.spot_irradiances, strict=True)):
            total += self.of_source(direction, field, field.sources_visible[:, count + k]).times(irradiance)
        if parts.slow is None:
            return total
        visible = None if self.shadows is None else self.shadows.visible(parts.slow, field)
        return total + self._reflected(parts.slow, field, visible)

    def of_source(self, direction: Floats, field: LightField, visible: NDArray[np.bool_]) -> Reflected:
        """What a source of unit irradiance gives, one channel; visible : (m,), of the rays."""
        source = LightElement("source", direction[None], np.ones((1, 1)))
        return self._reflected(
            source, field, RayVisibility(visible[:, None].astype(float), field.reflected_visible, None)
        )

    def by_direction(
        self, direction: Floats, field: LightField, visible: NDArray[np.bool_]
    ) -> list[Reflected]:
        """Derivatives of `of_source` as the source moves along its two tangents, per radian."""
        result = []
        for tangent in tangents(direction):
            ends = [direction + sign * _STEP * tangent for sign in (-1, 1)]
            before, after = (self.of_source(end / np.linalg.norm(end), field, visible) for end in ends)
            slope = np.full(1, 1 / (2 * np.arctan(_STEP)))
            result.append((after + before.times(-np.ones(1))).times(slope))
        return result

    def lobe_without_fresnel(self, incident: Floats, exitant: Floats) -> Floats:
        """S / (4 cos theta_i cos theta_o) in local directions (..., 3), z along the normal [RH01, section 5.2]."""
        half = incident + exitant
        theta = np.arctan2(np.hypot(half[..., 0], half[..., 1]), half[..., 2])
        cosines = incident[..., 2] * exitant[..., 2]
        above = (incident[..., 2] > 0) & (exitant[..., 2] > 0)
        return np.where(above, lobe(theta, self.brdf.sigma or 1.0) / (4 * np.where(above, cosines, 1)), 0.0)

    def _reflected(
        self, element: LightElement, field: LightField, visible: RayVisibility | None
    ) -> Reflected:
        diffuse = np.asarray(field.mean_over_rays(seen_diffuse(element, field.normals, visible)))
        if self.brdf.sigma is None:
            return Reflected(diffuse, *(np.zeros_like(diffuse) for _ in range(3)))
        sigmas = self.brdf.sigma * np.array([1, 1 - _STEP, 1 + _STEP])

        def gather(light: LightElement, rays: Rays) -> Floats:
            return specular_transfer(light, field.normals[rays], field.views[rays], sigmas)

        specular = seen_specular(element, visible, gather)
        cos = (field.normals * field.views).sum(axis=1)
        fresnel = normalised_fresnel(self.brdf.mu, cos)
        by_mu = np.zeros_like(fresnel)
        if self.brdf.mu is not None:
            # An index of 1 is air: below it nothing is defined.
            low, high = max(self.brdf.mu * (1 - _STEP), 1.0), self.brdf.mu * (1 + _STEP)
            by_mu = (normalised_fresnel(high, cos) - normalised_fresnel(low, cos)) / (high - low)
        by_sigma = (specular[:, 2] - specular[:, 1]) / (sigmas[2] - sigmas[1])
        return Reflected(
            diffuse,
            *(
                np.asarray(field.mean_over_rays(values))
                for values in (
                    fresnel[:, None] * specular[:, 0],
                    by_mu[:, None] * specular[:, 0],
                    fresnel[:, None] * by_sigma,
                )
            ),
        )
