"""What makes the gradient of a predicted photograph, pixel by pixel [RMB07, sections 4.4 and 4.5].

`surface` has the formula of lobes that have a centre. Here the prediction itself is differentiated, whatever its lobe
and light: for each term one thing moves on to the next pixel, and the others rest.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from capture.lighting import seen_from
from invrender.brdf.microfacet import Microfacet
from invrender.gradients.surface import GradientTerms
from invrender.transport.predict import reflected_of
from invrender.transport.transfer import LightElement
from invrender.transport.visibility import RayVisibility, Shadows
from recon.sampling.lightfield import LightField

Floats = NDArray[np.float64]

# Of a pixel: the central difference errs by its square, far below the thousandth that gradients are judged to.
_STEP = 0.005
# Radians per pixel by which normals that are blended between equal ones may seem to turn.
_ROUNDING = 1e-9
# 1 / d over 2 k below which light counts as far, the paper's "much less" than 1. At a tenth, a lamp's nearness makes a
# sixth of a plastic sphere's gradient; it falls with the distance.
FAR = 0.01


@dataclass(frozen=True, eq=False)
class MaterialRays:
    """One ray through each of n image points.

    field : where it meets the body. brdf : what it meets there; its kd and ks are those of all, (3,), or (n, 3).
    """

    field: LightField
    brdf: Microfacet


@dataclass(frozen=True, eq=False)
class PixelCross:
    """Rays through the middles of n pixels, and half a pixel before and after them, to the right and down.

    Their normals face the camera (`transport.visibility.facing`).
    """

    middle: MaterialRays
    ends: Sequence[tuple[MaterialRays, MaterialRays]]

    def steps(self, name: str) -> Floats:
        """Derivatives (n, 2, 3), per pixel, of the rays' positions, normals or views."""
        return np.stack(
            [getattr(after.field, name) - getattr(before.field, name) for before, after in self.ends], axis=1
        )

    @property
    def curvature(self) -> Floats:
        """How far the normal turns over how far one goes, (n,), 1 / metres: 1 / r of a sphere, 0 of a flat facet.

        Both are root mean squares over the two ways.
        """
        turned, gone = ((self.steps(name) ** 2).sum(axis=(1, 2)) for name in ("normals", "positions"))
        bent = turned > _ROUNDING**2
        return np.sqrt(np.divide(turned, gone, out=np.zeros(len(gone)), where=bent))


def predicted_terms(
    cross: PixelCross, element: LightElement, shadows: Shadows | None = None
) -> tuple[GradientTerms, Floats]:
    """Terms (n, 2, 3) of the predicted radiance's gradient, per pixel, and its difference across [RMB07, eq. 25].

    Ways are to the right and down. The difference, (n, 2, 3), lets everything move at once by a whole pixel: what the
    terms lack of it isn't of first order. Visibility has no derivative at a shadow's border, so that its term is a
    difference across the pixel, too. element : of known strength. shadows : of a mesh. Light that the body sends itself
    has no part.
    """
    middle, ends = cross.middle, (*cross.ends[0], *cross.ends[1])
    seen = _visible(shadows, element, middle.field)
    diffuse, specular = reflected_of(middle.brdf, element, middle.field, seen)

    def slope(name: str, way: int) -> Floats:
        """What changes as one of the field's vectors moves on."""
        step = cross.steps(name)[:, way]
        if not step.any() or (name == "positions" and element.directions.shape[-1] == 3):
            return np.zeros((len(step), 3))
        more, less = (
            _radiance(middle, element, _moved(middle.field, name, h * step), seen) for h in (_STEP, -_STEP)
        )
        return (more - less) / (2 * _STEP)

    def across(which: Sequence[Floats]) -> Floats:
        return np.stack([which[1] - which[0], which[3] - which[2]], axis=1)

    painted = [rays.brdf.kd * diffuse + rays.brdf.ks * specular for rays in ends]
    shown = [_visible(shadows, element, rays.field) for rays in ends]
    moved = [_radiance(rays, element, rays.field, visible) for rays, visible in zip(ends, shown, strict=True)]
    visibility = np.zeros((len(diffuse), 2, 3))
    if shadows is not None:
        visibility = across([_radiance(middle, element, middle.field, visible) for visible in shown])
    spatial, curvature, perspective = (
        np.stack([slope(name, way) for way in (0, 1)], axis=1) for name in ("positions", "normals", "views")
    )
    radiance = middle.brdf.kd * diffuse + middle.brdf.ks * specular
    terms = GradientTerms(radiance, spatial, curvature, perspective, across(painted), visibility)
    return terms, across(moved)


def nearness(cross: PixelCross, element: LightElement, shadows: Shadows | None = None) -> Floats:
    """1 / d over 2 k, (n,), of the nearest near lamp that each pixel sees; 0 where it sees none [RMB07, section 4.5].

    d is the lamp's distance, k the curvature; on a plane it is infinite. Light counts as far well below 1 (`FAR`).
    """
    field = cross.middle.field
    if element.directions.shape[-1] == 3 or not len(element.directions):
        return np.zeros(len(field))
    factors = seen_from(element.directions, field.positions)[1]
    # A source's distance is that vector's length over its closeness.
    closeness = element.directions[:, 3] * np.sqrt(factors)
    lit = element.at(field.positions).cosines(field.normals) > 0
    visible = _visible(shadows, element, field)
    if visible is not None:
        lit &= visible.sources > 0
    nearest = (closeness * lit).max(axis=1)
    bend = 2 * cross.curvature
    return np.divide(nearest, bend, out=np.where(nearest > 0, np.inf, 0.0), where=bend > 0)


def _visible(shadows: Shadows | None, element: LightElement, field: LightField) -> RayVisibility | None:
    return None if shadows is None else shadows.visible(element, field)


def _moved(field: LightField, name: str, step: Floats) -> LightField:
    """The field with one of its vectors (n, 3) a step on; normals and views keep their length."""
    moved = getattr(field, name) + step
    if name == "positions":
        return replace(field, positions=moved)
    unit = moved / np.linalg.norm(moved, axis=1, keepdims=True)
    return replace(field, normals=unit) if name == "normals" else replace(field, views=unit)


def _radiance(
    rays: MaterialRays, element: LightElement, field: LightField, visible: RayVisibility | None
) -> Floats:
    """Radiance (n, 3) of a field with the material of rays."""
    diffuse, specular = reflected_of(rays.brdf, element, field, visible)
    return np.asarray(rays.brdf.kd * diffuse + rays.brdf.ks * specular)
