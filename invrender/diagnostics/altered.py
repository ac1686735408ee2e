"""What a photograph would show if something about its light, its object or its surface were otherwise.

Nothing is linearised: a ray whose light comes from elsewhere is turned, with its view, to where the light was given,
since radiance depends on angles only.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from invrender.brdf.form import Angles
from invrender.brdf.microfacet import Microfacet
from invrender.diagnostics.remainder import Remainder, Remainders
from invrender.transport.predict import reflected
from invrender.transport.transfer import LightElement
from recon.sampling.lightfield import LightField

Floats = NDArray[np.float64]

# Views are no flatter than this where an object is moved: normals at its rim would jump.
_LEAST_COS = 0.05


@dataclass(frozen=True, eq=False)
class Alteration:
    """What is otherwise; the default is nothing.

    nearness : radius of the object over the distance of its lamps from its centre, 0 for lamps far away. turns :
    (k, 2) radians, by which each source is turned along `ways_across` its direction. shift : (3,), by which the object
    lies elsewhere, in its radii. stretch : logarithm of the width of highlights
    along circles about `axis` of the world (0 to 2) over that across them, of the sources only.
    """

    nearness: float = 0.0
    turns: Floats | None = None
    shift: Floats | None = None
    stretch: float = 0.0
    axis: int = 2

    @property
    def is_nothing(self) -> bool:
        """Whether all is as it is given."""
        moved = any(own is not None and own.any() for own in (self.turns, self.shift))
        return not (moved or self.nearness or self.stretch)


NOTHING = Alteration()


def shown(
    scene: Remainders, photo: Remainder, brdf: Microfacet, otherwise: Alteration = NOTHING
) -> tuple[Floats, Floats]:
    """Radiance (n, 3) of a photograph's samples per unit of Kd, and of Ks, in all of its light."""
    if otherwise.is_nothing:
        return photo.unaltered(brdf, lambda: _shown(scene, photo, brdf, NOTHING))
    return _shown(scene, photo, brdf, otherwise)


def _shown(
    scene: Remainders, photo: Remainder, brdf: Microfacet, otherwise: Alteration
) -> tuple[Floats, Floats]:
    field = photo.field
    if otherwise.shift is not None:
        field = displaced(photo, scene.radius * otherwise.shift)
    diffuse, specular = np.zeros((2, len(field.normals), 3))
    if photo.rest is not None:
        diffuse, specular = photo.rest(brdf, field)
    for k in range(len(photo.directions)):
        more = source_parts(scene, photo, brdf, k, field, otherwise)
        diffuse, specular = diffuse + more[0], specular + more[1]
    return np.asarray(field.mean_over_rays(diffuse)), np.asarray(field.mean_over_rays(specular))


def source_parts(
    scene: Remainders,
    photo: Remainder,
    brdf: Microfacet,
    k: int,
    field: LightField,
    otherwise: Alteration = NOTHING,
) -> tuple[Floats, Floats]:
    """What rays (m, 3) reflect of one source per unit of Kd, and of Ks."""
    direction = photo.directions[k]
    strength = np.ones((len(field.normals), 1))
    if otherwise.turns is not None:
        direction = turned(direction, otherwise.turns[k])
    if otherwise.nearness:
        towards = direction - otherwise.nearness * (field.positions - scene.centre) / scene.radius
        distance = np.maximum(np.linalg.norm(towards, axis=1, keepdims=True), 1e-6)
        strength = 1 / distance**2
        field = _seen_from(field, towards / distance, direction)
    element = LightElement("source", direction[None], photo.irradiances[k][None])
    diffuse, specular = reflected(brdf, [element], np.ones((1, 3)), field, scene.shadows)
    if otherwise.stretch and brdf.sigma is not None:
        specular = _stretched(scene, brdf, field, direction, otherwise) * photo.irradiances[k]
    return strength * diffuse, strength * specular


def _stretched(
    scene: Remainders, brdf: Microfacet, field: LightField, direction: Floats, otherwise: Alteration
) -> Floats:
    """What rays (m, 1) reflect of a source per unit of Ks and of irradiance, in a lobe that is wider along one tangent.

    Facets whose slopes are stretched: the width seen at an azimuth phi of the half vector is that of the ellipse,
    1 / sigma^2 = cos^2 phi / along^2 + sin^2 phi / across^2, and their density goes by the ellipse's area [Heitz 2014,
    "Understanding the masking-shadowing function in microfacet-based BRDFs", eq. 85].
    """
    assert brdf.sigma is not None
    along, across = brdf.sigma * np.exp(otherwise.stretch * np.array([0.5, -0.5]))
    quadrupole = drawn_out(field, direction, otherwise.axis)
    width = np.sqrt(2 / ((1 + quadrupole) / along**2 + (1 - quadrupole) / across**2))
    angles = Angles.between(field.normals, direction, field.views)
    lobe = brdf.form.reflected(angles, brdf.mu, width) * width**2 / (along * across)
    if scene.shadows is not None:
        lobe = lobe * scene.shadows.lit(field, direction)
    return np.asarray(field.filtered(lobe[:, None]))


def drawn_out(field: LightField, direction: Floats, axis: int) -> Floats:
    """Cosine (m,) of twice the azimuth of the half vector to a direction (3,), from circles about a world's axis."""
    along = np.cross(np.eye(3)[axis], field.normals)
    along /= np.maximum(np.linalg.norm(along, axis=1, keepdims=True), 1e-9)
    half = field.views + direction
    x, y = (half * along).sum(axis=1), (half * np.cross(field.normals, along)).sum(axis=1)
    return np.asarray((x**2 - y**2) / np.maximum(x**2 + y**2, 1e-12))


def turned(direction: Floats, turn: Floats) -> Floats:
    """A unit direction (3,) turned by angles (2,), radians, along `ways_across` it."""
    angle = float(np.linalg.norm(turn))
    if angle == 0:
        return direction
    return np.asarray(np.cos(angle) * direction + np.sin(angle) / angle * (turn @ ways_across(direction)))


def ways_across(direction: Floats) -> Floats:
    """Two unit vectors (2, 3) at right angles to a unit direction (3,) and to each other."""
    first = np.cross(direction, np.eye(3)[np.abs(direction).argmin()])
    first /= np.linalg.norm(first)
    return np.stack([first, np.cross(direction, first)])


def _seen_from(field: LightField, towards: Floats, direction: Floats) -> LightField:
    """The field with each ray's normal and view turned so that light from `towards` (m, 3) comes from `direction`."""
    axis = np.cross(towards, direction)
    share = 1 / np.maximum(1 + towards @ direction, 1e-6)

    def moved(vectors: Floats) -> Floats:
        once = np.cross(axis, vectors)
        return np.asarray(vectors + once + share[:, None] * np.cross(axis, once))

    return replace(field, normals=moved(field.normals), views=moved(field.views))


def displaced(photo: Remainder, shift: Floats) -> LightField:
    """A photograph's samples with the normals that their rays would meet on the object shifted by (3,) metres.

    What a ray meets on a surface moved by d is what the unmoved one has at x - d + v (d.n) / (v.n); normals there
    follow from how normals around vary with place.
    """
    normals, views = photo.field.normals, photo.field.views
    cos = np.maximum((normals * views).sum(axis=1), _LEAST_COS)
    along = (normals @ shift) / cos
    there = normals + np.einsum("mij,mj->mi", photo.curvature, along[:, None] * views - shift)
    return replace(photo.field, normals=there / np.linalg.norm(there, axis=1, keepdims=True))
