"""Slopes of the radiance that samples show, in the normal, view and position of each ray, at first order.

What an error of a pose, a lens or a shape does to a photograph follows from them and from how it moves the rays:
curvature, perspective and spatial terms of RMB07's eq. 25, with the error's step in place of a pixel's.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from invrender.brdf.microfacet import Microfacet
from invrender.transport.predict import reflected_of
from invrender.transport.transfer import LightElement
from invrender.transport.visibility import RayVisibility, Shadows
from recon.displacement.rays import RayChange
from recon.mesh.tangents import tangents
from recon.sampling.lightfield import LightField

Floats = NDArray[np.float64]

# Radians, at most and in units of a lobe's width, and metres in units of the distance to a lamp: central differences
# err by a thousandth of the slope.
_STEP, _OF_WIDTH, _OF_DISTANCE = 3e-3, 0.05, 1e-3


@dataclass(frozen=True, eq=False)
class Light:
    """What shines on a photograph: elements with their strengths, (elements, 3)."""

    elements: Sequence[LightElement]
    strengths: Floats


@dataclass(frozen=True, eq=False)
class RadianceSlopes:
    """Derivatives of rays' radiance, (m, channels, 3); positions : None far from lamps."""

    normals: Floats
    views: Floats
    positions: Floats | None

    def change(self, moved: RayChange) -> Floats:
        """By how much the rays' radiance (m, 3) changes."""
        result = np.einsum("mcx,mx->mc", self.normals, moved.normals)
        result += np.einsum("mcx,mx->mc", self.views, moved.views)
        if self.positions is not None:
            result += np.einsum("mcx,mx->mc", self.positions, moved.positions)
        return result


class PhotoRadiance:
    """What the rays of a photograph's samples reflect, what they see of the light being fixed.

    sky : what rays (m, 3) reflect of harmonic light per unit of Kd, and of Ks; none if None.
    """

    def __init__(
        self,
        brdf: Microfacet,
        light: Light,
        field: LightField,
        shadows: Shadows | None,
        sky: Callable[[LightField], tuple[Floats, Floats]] | None = None,
    ) -> None:
        self._brdf, self._light, self._field, self._shadows, self._sky = brdf, light, field, shadows, sky
        self._seen: list[RayVisibility | None] = [
            None if shadows is None else shadows.visible(element, field) for element in light.elements
        ]

    def under(self, light: Light) -> PhotoRadiance:
        """The same rays under other light."""
        return PhotoRadiance(self._brdf, light, self._field, self._shadows)

    @cached_property
    def here(self) -> Floats:
        """Radiance (m, 3) of the rays as they are."""
        return self.of(self._field)

    def of(self, field: LightField) -> Floats:
        """Radiance (m, 3) of the rays, moved a little as `field` has them."""
        total = np.zeros((len(field.normals), 3))
        if self._sky is not None:
            base, lobe = self._sky(field)
            total += self._brdf.kd * base + self._brdf.ks * lobe
        for element, strength, seen in zip(
            self._light.elements, self._light.strengths, self._seen, strict=True
        ):
            diffuse, specular = reflected_of(self._brdf, element, field, seen)
            total += strength * (self._brdf.kd * diffuse + self._brdf.ks * specular)
        return total

    @cached_property
    def slopes(self) -> RadianceSlopes:
        """Derivatives of the radiance, by central differences."""
        field, sigma = self._field, self._brdf.sigma
        step = _STEP if sigma is None else min(_STEP, _OF_WIDTH * sigma)

        def tangential(unit: Floats, moved: Callable[[Floats], LightField]) -> Floats:
            slopes = np.zeros((len(unit), 3, 3))
            for tangent in np.moveaxis(tangents(unit), 1, 0):
                ends = [self.of(moved(_unit(unit + way * step * tangent))) for way in (1, -1)]
                slopes += ((ends[0] - ends[1]) / (2 * step))[..., None] * tangent[:, None]
            return slopes

        near = any(element.directions.shape[-1] > 3 for element in self._light.elements)
        return RadianceSlopes(
            tangential(field.normals, lambda unit: replace(field, normals=unit)),
            tangential(field.views, lambda unit: replace(field, views=unit)),
            self._by_position() if near else None,
        )

    def _by_position(self) -> Floats:
        positions = self._field.positions
        closeness = max(
            float(element.directions[:, 3].max(initial=0))
            for element in self._light.elements
            if element.directions.shape[-1] > 3
        )
        step = _OF_DISTANCE / max(closeness, 1e-12)
        slopes = [
            (
                self.of(replace(self._field, positions=positions + step * axis))
                - self.of(replace(self._field, positions=positions - step * axis))
            )
            / (2 * step)
            for axis in np.eye(3)
        ]
        return np.stack(slopes, axis=-1)


def _unit(vectors: Floats) -> Floats:
    return np.asarray(vectors / np.linalg.norm(vectors, axis=1, keepdims=True))
