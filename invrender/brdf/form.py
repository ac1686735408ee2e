"""What a specular lobe is: a form of the specular part, per unit of Ks.

    rho = Kd + Ks F W     F the Fresnel factor relative to normal incidence, W the form's own shape

Forms are functions of four angles, and the width of each is sigma in radians: at normal incidence, to the first order
in sigma^2 and theta_h^2, they are the same exp(-(theta_h / sigma)^2) / (4 pi sigma^2), so that one sigma means one
width of the highlight.
"""

from __future__ import annotations

from abc import abstractmethod
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from types import MappingProxyType

import numpy as np
from numpy.typing import NDArray

from invrender.brdf.fresnel import normalised_fresnel

Floats = NDArray[np.float64]
# Radiance per unit of radiance and solid angle, (...), of unit normals, directions to the light and to the viewer,
# (..., 3) each, broadcast: a BRDF times the cosine of incidence.
Lobe = Callable[[Floats, Floats, Floats], Floats]
# A unit vector in the world.
Axis = tuple[float, float, float]
# A form's own, by name, one or (f,) each.
Numbers = Mapping[str, float | Floats]

# Width from which on a lobe looks like the base, radians.
WIDEST_HAZE = 0.3
# Below, the half-angle's tangent and the secants of grazing light lose all digits.
LEAST_COS = 1e-6
# Distance from a pole, radians, within which a brushed surface has no tangent, and squares without an azimuth.
_AT_POLE, _NO_AZIMUTH = 1e-9, 1e-300


def _dot(a: Floats, b: Floats) -> Floats:
    """Scalar products of vectors (..., 3)."""
    return np.asarray(np.einsum("...k,...k->...", a, b))


def _dot_of_coordinates(a: Sequence[Floats] | Floats, b: Sequence[Floats] | Floats) -> Floats:
    """The same of vectors given coordinate by coordinate, (3, ...): twice as fast."""
    return a[0] * b[0] + a[1] * b[1] + a[2] * b[2]


@dataclass(frozen=True, eq=False)
class Angles:
    """Pairs of directions above the surface, arrays of one shape: theta_h, radians, of the half vector to the normal;
    cosines of incidence, exitance and of half the angle between the two directions (theta_d).

    turns : of a brushed surface, cosines of twice the azimuth from its tangent, of half vector, light and viewer.
    """

    theta_h: Floats
    cos_i: Floats
    cos_o: Floats
    cos_d: Floats
    turns: tuple[Floats, Floats, Floats] | None = None

    @classmethod
    def between(cls, normals: Floats, wi: Floats, wo: Floats, axis: Axis | None = None) -> Angles:
        """Angles of unit vectors (..., 3), broadcast; axis : that the surface is brushed about, if it is."""
        normal, light, viewer = (np.ascontiguousarray(np.moveaxis(of, -1, 0)) for of in (normals, wi, wo))
        cos_i, cos_o = _dot_of_coordinates(normal, light), _dot_of_coordinates(normal, viewer)
        half, along = [i + o for i, o in zip(light, viewer, strict=True)], cos_i + cos_o
        # Not by arccos, which loses half the digits where the lobe peaks.
        beside = [h - along * n for h, n in zip(half, normal, strict=True)]
        theta_h = np.arctan2(np.sqrt(_dot_of_coordinates(beside, beside)), along)
        cos_d, turns = np.sqrt(_dot_of_coordinates(half, half)) / 2, None
        if axis is not None:
            tangent = brushed_tangents(normals, axis)
            across = np.cross(normals, tangent)
            turns = _turn(tangent, across, wi + wo), _turn(tangent, across, wi), _turn(tangent, across, wo)
        return cls(theta_h, cos_i, cos_o, cos_d, turns)

    @property
    def widened(self) -> Angles:
        """The same with an axis more, for widths along it."""
        theta_h, cos_i, cos_o, cos_d = (
            part[..., None] for part in (self.theta_h, self.cos_i, self.cos_o, self.cos_d)
        )
        if self.turns is None:
            return Angles(theta_h, cos_i, cos_o, cos_d)
        half, light, view = (turn[..., None] for turn in self.turns)
        return Angles(theta_h, cos_i, cos_o, cos_d, (half, light, view))


def brushed_tangents(normals: Floats, axis: Axis) -> Floats:
    """Unit tangents (..., 3) along circles about an axis, counterclockwise, at unit normals (..., 3).

    Where a normal lies along the axis: some direction across it.
    """
    along = np.cross(np.asarray(axis, float), normals)
    length = np.sqrt(_dot(along, along))[..., None]
    spare = np.cross(np.roll(axis, 1), axis)
    return np.asarray(np.where(length < _AT_POLE, spare, along) / np.where(length < _AT_POLE, 1, length))


def _turn(tangent: Floats, across: Floats, directions: Floats) -> Floats:
    """Cosine (...,) of twice the azimuth of directions (..., 3) from a tangent; 1 along the normal."""
    x, y = _dot(tangent, directions) ** 2, _dot(across, directions) ** 2
    return np.asarray((x - y + _NO_AZIMUTH) / (x + y + _NO_AZIMUTH))


class LobeForm:
    """A form of the specular part, and of what is below.

    name : as results call it. description : in words, as reports have it. has_fresnel : whether it has a refractive
    index. interface : whether the diffuse base lies under a smooth interface of that index (`transport.diffuse_base`).
    coat : strength of Shirley's coupled base, None where the base is another; Lambertian where it is neither. parts :
    share and width over sigma of each lobe of the sum. numbers : the form's own numbers, beside mu and sigma, by name.
    ranges : of sigma and the form's own numbers, where narrower than a search's. axis : that the surface is brushed
    about; None where it is isotropic.
    """

    name: str
    description: str
    has_fresnel: bool = True
    interface: bool = False
    coat: float | None = None
    parts: tuple[tuple[float, float], ...] = ((1.0, 1.0),)
    numbers: Mapping[str, float] = MappingProxyType({})
    ranges: Mapping[str, tuple[float, float]] = MappingProxyType({})
    axis: Axis | None = None

    @property
    def lobe(self) -> LobeForm:
        """The single lobe, above a Lambertian base, that the form's specular part is a sum of."""
        return self

    @property
    def family(self) -> LobeForm:
        """What all forms are that differ from this one in their numbers only."""
        return self

    def derived(self, sigma: float) -> Mapping[str, float]:
        """What follows from sigma and the form's own numbers and is reported beside them, by name."""
        return {}

    def with_numbers(self, numbers: Mapping[str, float]) -> LobeForm:
        """The form of the same family with other numbers, named as in `numbers`."""
        return self

    def parts_at(self, numbers: Numbers) -> Sequence[tuple[float | Floats, float | Floats]]:
        """`parts` of the form of the same family with other numbers."""
        return self.parts

    @abstractmethod
    def shape(self, angles: Angles, sigma: float | Floats) -> Floats:
        """W times cos theta_i, 1/sr, zero where light or viewer is below the horizon; sigma > 0, radians, broadcast."""

    @abstractmethod
    def fresnel_cosine(self, angles: Angles) -> Floats:
        """The cosine that its Fresnel factor is taken at."""

    def reflected(self, angles: Angles, mu: float | None, sigma: float) -> Floats:
        """F W cos theta_i: radiance per unit of Ks and of irradiance across the beam, 1/sr."""
        shape = self.shape(angles, sigma)
        if mu is None:
            return shape
        return shape * normalised_fresnel(mu, np.clip(self.fresnel_cosine(angles), 0, 1))

    def lobe_of(self, mu: float | None, sigma: float) -> Lobe:
        """`reflected` as a function of directions; mu None without Fresnel's factor, sigma in radians."""

        def lobe(normals: Floats, wi: Floats, wo: Floats) -> Floats:
            return self.reflected(Angles.between(normals, wi, wo), mu, sigma)

        return lobe


def part_width(factor: float | Floats, sigma: float | Floats) -> Floats:
    """The width of a part of a form that is so many times as wide as sigma, radians; a haze ends at 0.3.

    Wider ones would pass for the base.
    """
    sigma = np.asarray(sigma, float)
    return np.minimum(factor * sigma, np.maximum(WIDEST_HAZE, sigma))
