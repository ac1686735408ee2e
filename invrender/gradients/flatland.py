"""The steps of shading in a plane, and the gradients of the light field after each [RMB07, section 4].

A light field has a value at arc length x along a curve and at an angle theta. Each step takes a field and returns a
field: its values, and its gradient by the rule of RMB07's fig. 2 for that operation, never by differences. In the
global frame angles are from one direction, in the surface's frame from its normal n(x); anticlockwise is positive.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

Floats = NDArray[np.float64]
# Of arc lengths and angles that broadcast.
OfBoth = Callable[[Floats, Floats], Floats]
OfPlace = Callable[[Floats], Floats]

# Angles that a convolution sums over: exact for lobes and light of degrees up to half as many.
_ANGLES = 2 * np.pi * np.arange(512) / 512


@dataclass(frozen=True, eq=False)
class PlaneField:
    """A light field in a plane, and its derivatives by arc length and by angle; radiance per unit of each."""

    value: OfBoth
    by_place: OfBoth
    by_angle: OfBoth


@dataclass(frozen=True, eq=False)
class PlaneTerms:
    """What the gradient of a reflected light field is made of [RMB07, eq. 25, fig. 4], broadcast over place and angle.

    spatial : SV, the light's variation along the surface. directional : DV, its variation over directions. curvature :
    CV, twice the curvature, by which the mirrored direction turns. texture : TV, the lobe's variation along the
    surface [eq. 19].
    """

    spatial: Floats
    directional: Floats
    curvature: Floats
    texture: Floats

    @property
    def curved(self) -> Floats:
        """CDV, the directional variation that curvature turns into spatial variation."""
        return self.curvature * self.directional

    @property
    def by_place(self) -> Floats:
        """The whole derivative of radiance along the surface."""
        return self.spatial + self.curved + self.texture

    @property
    def by_angle(self) -> Floats:
        """The whole derivative of radiance by the angle of the view."""
        return -self.directional


def rotated(field: PlaneField, normal: OfPlace, slope: OfPlace) -> PlaneField:
    """Step 1: into the surface's frame [RMB07, eq. 9 to 11; of any normal map, eq. 21].

    normal : n(x), radians. slope : its derivative, the curvature at each place.
    """

    def by_place(x: Floats, theta: Floats) -> Floats:
        turned = theta + normal(x)
        return field.by_place(x, turned) + slope(x) * field.by_angle(x, turned)

    return PlaneField(
        lambda x, theta: field.value(x, theta + normal(x)),
        by_place,
        lambda x, theta: field.by_angle(x, theta + normal(x)),
    )


def mirrored(field: PlaneField) -> PlaneField:
    """Step 2: by the mirrored direction [RMB07, eq. 12, 13]."""
    return PlaneField(
        lambda x, theta: field.value(x, -theta),
        lambda x, theta: field.by_place(x, -theta),
        lambda x, theta: -field.by_angle(x, -theta),
    )


def blurred(field: PlaneField, lobe: OfBoth, lobe_by_place: OfBoth | None = None) -> PlaneField:
    """Step 3: by a lobe that is symmetric about its centre [RMB07, eq. 14 to 16].

    lobe : of place and of the angle from its centre. lobe_by_place : its derivative along the surface, where the
    material varies [eq. 18, 19]; None where it doesn't.
    """

    def convolved(values: OfBoth, weights: OfBoth) -> OfBoth:
        def summed(x: Floats, theta: Floats) -> Floats:
            x, theta = np.broadcast_arrays(x, theta)
            x, apart = x[..., None], _wrapped(_ANGLES - theta[..., None])
            return np.asarray((values(x, _ANGLES) * weights(x, apart)).mean(axis=-1) * 2 * np.pi)

        return summed

    value, by_place, by_angle = (convolved(of, lobe) for of in (field.value, field.by_place, field.by_angle))
    if lobe_by_place is None:
        return PlaneField(value, by_place, by_angle)
    of_texture = convolved(field.value, lobe_by_place)
    return PlaneField(value, lambda x, theta: by_place(x, theta) + of_texture(x, theta), by_angle)


def unrotated(field: PlaneField, normal: OfPlace, slope: OfPlace) -> PlaneField:
    """Step 4: back into the global frame [RMB07, eq. 17]."""
    return rotated(field, lambda x: -normal(x), lambda x: -slope(x))


def shaded(
    field: PlaneField, normal: OfPlace, slope: OfPlace, lobe: OfBoth, lobe_by_place: OfBoth | None = None
) -> PlaneField:
    """All four steps: the light field that a curve reflects, in the global frame [RMB07, eq. 22]."""
    local = mirrored(rotated(field, normal, slope))
    return unrotated(blurred(local, lobe, lobe_by_place), normal, slope)


def gradient_terms(
    field: PlaneField,
    normal: OfPlace,
    slope: OfPlace,
    lobe: OfBoth,
    place: ArrayLike,
    angle: ArrayLike,
    lobe_by_place: OfBoth | None = None,
) -> PlaneTerms:
    """The terms of the reflected light field's gradient at a place and an angle of view [RMB07, eq. 25].

    Each is a convolution at the mirrored view, 2 n(x) - theta.
    """
    x, theta = np.broadcast_arrays(np.asarray(place, float), np.asarray(angle, float))
    centre = 2 * normal(x) - theta
    around = blurred(field, lobe)
    nothing = np.zeros_like(centre)
    texture = nothing if lobe_by_place is None else blurred(field, lobe_by_place).value(x, centre)
    return PlaneTerms(around.by_place(x, centre), around.by_angle(x, centre), 2 * slope(x) + nothing, texture)


def _wrapped(angle: Floats) -> Floats:
    """Into -pi to pi."""
    return np.asarray((angle + np.pi) % (2 * np.pi) - np.pi)
