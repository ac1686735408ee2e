"""The gradient of reflected radiance along a surface, split into what makes it [RMB07, sections 4.3 and 4.4].

A lobe is symmetric about its centre, the mirrored view or the normal, times a factor of the angle between view and
normal: the form of reflection maps. Then what changes along the surface is the light at a place, the centre's direction
(by curvature and by the camera's perspective), and the material. The derivative of a convolution is taken of the light.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.float64]
# Of cosines.
OfCosine = Callable[[Floats], Floats]


@dataclass(frozen=True, eq=False)
class CurvedSurface:
    """Points of a surface and how it bends there.

    positions, normals, views : (n, 3); normals and views, towards the camera, are of unit length. tangents : (n, 2, 3),
    orthonormal. normal_steps : (n, 2, 3), derivatives of the normal along the tangents, 1 / unit of length: by the
    shape operator, or a normal map's. distances : (n,), to the camera; infinite of a distant one.
    """

    positions: Floats
    normals: Floats
    tangents: Floats
    normal_steps: Floats
    views: Floats
    distances: Floats

    @property
    def view_steps(self) -> Floats:
        """Derivatives (n, 2, 3) of the view along the tangents: it turns towards a near camera."""
        along = (self.tangents * self.views[:, None]).sum(axis=-1, keepdims=True)
        return (along * self.views[:, None] - self.tangents) / self.distances[:, None, None]


def steps_of_shape(tangents: Floats, shape: Floats) -> Floats:
    """Derivatives (n, 2, 3) of the normal along tangents (n, 2, 3), by the shape operator (n, 2, 2) in these.

    A step t turns the normal by -shape @ t: shape is -1 / r of a sphere seen from outside.
    """
    return -np.einsum("nij,njk->nik", shape, tangents)


@dataclass(frozen=True, eq=False)
class IncidentLight:
    """Light by place and direction, at k directions (k, 3) with solid angles (k,).

    radiance : (n, k). by_place : (n, k, 3), its gradient over positions. by_direction : (n, k, 3), over directions,
    tangent to each.
    """

    directions: Floats
    solid_angles: Floats
    radiance: Floats
    by_place: Floats
    by_direction: Floats


@dataclass(frozen=True, eq=False)
class CentredShading:
    """A lobe about its centre. profile : of the cosine between centre and light. factor, factor_slope : of the cosine
    between view and normal, and its derivative. about_mirrored_view : else about the normal.
    """

    profile: OfCosine
    factor: OfCosine
    factor_slope: OfCosine
    about_mirrored_view: bool


@dataclass(frozen=True, eq=False)
class GradientTerms:
    """Derivatives of reflected radiance along two ways, (n, 2) or (n, 2, channels), and the radiance, (n, ...).

    spatial : SV, of light that differs from place to place. curvature : CDV, of a normal that turns. perspective : of
    a view that turns towards a near camera. texture : TV, of a material that varies. visibility : of what the surface
    hides from itself.
    """

    radiance: Floats
    spatial: Floats
    curvature: Floats
    perspective: Floats
    texture: Floats
    visibility: Floats

    @property
    def whole(self) -> Floats:
        """All of the gradient."""
        return self.spatial + self.curvature + self.perspective + self.texture + self.visibility


def gradient_terms(
    points: CurvedSurface, light: IncidentLight, shading: CentredShading, albedo_steps: Floats | None = None
) -> GradientTerms:
    """What makes the gradient of the radiance that a surface reflects [RMB07, eq. 25 in three dimensions].

    albedo_steps : (n, 2), derivatives of the logarithm of a texture that multiplies the radiance [eq. 20]; None
    without.
    Light, lobe and surface must be smooth; shadows have no part in it.
    """
    cosine = (points.normals * points.views).sum(axis=1)
    centres = _centres(points, shading)
    lobe = shading.profile(centres @ light.directions.T) * light.solid_angles
    factor = shading.factor(cosine)
    gathered = (lobe * light.radiance).sum(axis=1)
    radiance = factor * gathered
    places = np.einsum("nk,nkc->nc", lobe, light.by_place) * factor[:, None]
    # A centre that turns about an axis b turns the light by it: grad L . (b x w), b = centre x step.
    turning = np.einsum("nk,nkc->nc", lobe, np.cross(light.directions, light.by_direction)) * factor[:, None]

    def turned(normal_steps: Floats, view_steps: Floats) -> Floats:
        steps = _centre_steps(points, shading, normal_steps, view_steps)
        of_centre = (np.cross(centres[:, None], steps) * turning[:, None]).sum(axis=-1)
        of_cosine = (normal_steps * points.views[:, None] + view_steps * points.normals[:, None]).sum(axis=-1)
        return of_centre + of_cosine * (shading.factor_slope(cosine) * gathered)[:, None]

    nothing = np.zeros_like(points.tangents)
    still = np.zeros((len(radiance), 2))
    return GradientTerms(
        radiance=radiance,
        spatial=(points.tangents * places[:, None]).sum(axis=-1),
        curvature=turned(points.normal_steps, nothing),
        perspective=turned(nothing, points.view_steps),
        texture=still if albedo_steps is None else albedo_steps * radiance[:, None],
        visibility=still,
    )


def _centres(points: CurvedSurface, shading: CentredShading) -> Floats:
    if not shading.about_mirrored_view:
        return points.normals
    cosine = (points.normals * points.views).sum(axis=1, keepdims=True)
    return 2 * cosine * points.normals - points.views


def _centre_steps(
    points: CurvedSurface, shading: CentredShading, normal_steps: Floats, view_steps: Floats
) -> Floats:
    """Derivatives (n, 2, 3) of the centres."""
    if not shading.about_mirrored_view:
        return normal_steps
    normals, views = points.normals[:, None], points.views[:, None]
    cosine = (normals * views).sum(axis=-1, keepdims=True)
    of_cosine = (normal_steps * views + normals * view_steps).sum(axis=-1, keepdims=True)
    return 2 * of_cosine * normals + 2 * cosine * normal_steps - view_steps
