"""What specular lobes look like: forms of the specular part, per unit of Ks.

    rho = Kd + Ks F W     F the Fresnel factor relative to normal incidence, W the form's own shape

All four are functions of four angles, and the width of each is sigma in radians: at normal incidence, to the first
order in sigma^2 and theta_h^2, they are the same exp(-(theta_h / sigma)^2) / (4 pi sigma^2), so that one sigma means
one width of the highlight.
"""

from __future__ import annotations

from abc import abstractmethod
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from types import MappingProxyType

import numpy as np
from numpy.typing import NDArray
from scipy.special import erf

from invrender.brdf.fresnel import normalised_fresnel
from invrender.theory.specialcases import lobe

Floats = NDArray[np.float64]
# A form's own, by name, one or (f,) each.
Numbers = Mapping[str, float | Floats]

_WIDEST_HAZE = 0.3
# Below, the half-angle's tangent and the secants of grazing light lose all digits.
_LEAST_COS = 1e-6


def _dot(a: Floats, b: Floats) -> Floats:
    # Half again as fast as sums of products.
    return np.asarray(np.einsum("...k,...k->...", a, b))


@dataclass(frozen=True, eq=False)
class Angles:
    """Pairs of directions above the surface, arrays of one shape: theta_h, radians, of the half vector to the normal;
    cosines of incidence, exitance and of half the angle between the two directions (theta_d)."""

    theta_h: Floats
    cos_i: Floats
    cos_o: Floats
    cos_d: Floats

    @classmethod
    def between(cls, normals: Floats, wi: Floats, wo: Floats) -> Angles:
        """Angles of unit vectors (..., 3), broadcast."""
        half = wi + wo
        along = _dot(half, normals)
        # Not by arccos, which loses half the digits where the lobe peaks.
        beside = half - along[..., None] * normals
        theta_h = np.arctan2(np.sqrt(_dot(beside, beside)), along)
        return cls(theta_h, _dot(normals, wi), _dot(normals, wo), np.sqrt(_dot(half, half)) / 2)


class LobeForm:
    """A form of the specular part, and of what is below.

    name : as results call it. has_fresnel : whether it has a refractive index. interface : whether the diffuse base
    lies under a smooth interface of that index (`base`). coat : strength of Shirley's coupled base, None where the base
    is another; Lambertian where it is neither. parts : share and width over sigma of each lobe of the sum. numbers :
    the form's own numbers, beside mu and sigma, by name.
    """

    name: str
    has_fresnel: bool = True
    interface: bool = False
    coat: float | None = None
    parts: tuple[tuple[float, float], ...] = ((1.0, 1.0),)
    numbers: Mapping[str, float] = MappingProxyType({})

    @property
    def lobe(self) -> LobeForm:
        """The single lobe, above a Lambertian base, that the form's specular part is a sum of."""
        return self

    @property
    def family(self) -> LobeForm:
        """What all forms are that differ from this one in their numbers only."""
        return self

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


class RH01Microfacet(LobeForm):
    """RH01's: Fresnel's factor at theta_o, and no facet hides another [RH01, section 5.2]."""

    name = "microfacet"

    def shape(self, angles: Angles, sigma: float | Floats) -> Floats:
        lit = (angles.cos_i > 0) & (angles.cos_o > 0)
        return np.where(lit, lobe(angles.theta_h, sigma) / (4 * np.maximum(angles.cos_o, _LEAST_COS)), 0)

    def fresnel_cosine(self, angles: Angles) -> Floats:
        return angles.cos_o


class Smith(LobeForm):
    """Fresnel's factor at the half vector, D G2 / (4 cos cos).

    correlated : whether facets that the viewer sees are the likelier lit, for standing out [Heitz 2014, eq. 99];
    False if the one says nothing of the other, as in many renderers [Walter et al. 2007, eq. 23]. over : the same form
    above a Lambertian base, where this one's is under an interface.
    """

    def __init__(self, correlated: bool = True, over: LobeForm | None = None) -> None:
        self.correlated, self.interface, self._over = correlated, over is not None, over
        self.name = self.name if correlated else f"uncorrelated {self.name}"
        if over is not None:
            self.name = f"{self.name} plastic"

    @property
    def lobe(self) -> LobeForm:
        return self._over or self

    def shape(self, angles: Angles, sigma: float | Floats) -> Floats:
        lit = (angles.cos_i > 0) & (angles.cos_o > 0)
        # Each by itself: many lamps share an exitant angle.
        cos_i, cos_o = (np.where(cos > 0, cos, 1.0) for cos in (angles.cos_i, angles.cos_o))
        # cos_i cos_o / G2, finite at grazing.
        lost_i, lost_o = self.hidden(cos_i, sigma), self.hidden(cos_o, sigma)
        shown = cos_i * cos_o + cos_o * lost_i + cos_i * lost_o
        if not self.correlated:
            shown = shown + lost_i * lost_o
        return np.where(lit, self.density(angles.theta_h, sigma) * cos_i / (4 * shown), 0)

    def fresnel_cosine(self, angles: Angles) -> Floats:
        return angles.cos_d

    @abstractmethod
    def density(self, theta_h: Floats, sigma: float | Floats) -> Floats:
        """D, 1/sr; D cos theta_h integrates to 1 over the hemisphere."""

    @abstractmethod
    def hidden(self, cos: Floats, sigma: float | Floats) -> Floats:
        """Lambda times the cosine: what facets hide of each other."""


class Beckmann(Smith):
    """Facets of Gaussian slopes [Walter et al. 2007, eq. 25; Heitz 2014, eq. 72]."""

    name = "half-angle microfacet"

    def density(self, theta_h: Floats, sigma: float | Floats) -> Floats:
        cos2 = np.maximum(np.cos(theta_h), _LEAST_COS) ** 2
        return np.asarray(np.exp(-(1 - cos2) / (cos2 * sigma**2)) / (np.pi * sigma**2 * cos2**2))

    def hidden(self, cos: Floats, sigma: float | Floats) -> Floats:
        spread = sigma * np.sqrt(np.maximum(1 - cos**2, 0))
        a = cos / np.maximum(spread, 1e-12)
        return np.asarray((cos * (erf(a) - 1) + spread * np.exp(-(a**2)) / np.sqrt(np.pi)) / 2)


class GGX(Smith):
    """Facets of long-tailed slopes [Walter et al. 2007, eq. 33; Heitz 2014, eq. 72]."""

    name = "GGX"

    def density(self, theta_h: Floats, sigma: float | Floats) -> Floats:
        cos2 = np.maximum(np.cos(theta_h), _LEAST_COS) ** 2
        return np.asarray(sigma**2 / (np.pi * (cos2 * sigma**2 + 1 - cos2) ** 2))

    def hidden(self, cos: Floats, sigma: float | Floats) -> Floats:
        return np.asarray((np.sqrt(cos**2 + sigma**2 * np.maximum(1 - cos**2, 0)) - cos) / 2)


class Phong(LobeForm):
    """cos^s of the angle to the mirror direction, s = 1 / (2 sigma^2), normalised as by Lafortune and Willems 1994."""

    name = "Phong"
    has_fresnel = False

    def shape(self, angles: Angles, sigma: float | Floats) -> Floats:
        lit = (angles.cos_i > 0) & (angles.cos_o > 0)
        exponent = phong_exponent(sigma)
        # The mirrored viewer's cosine to the light.
        mirrored = 2 * angles.cos_i * angles.cos_o - (2 * angles.cos_d**2 - 1)
        lobe = (exponent + 2) / (2 * np.pi) * np.clip(mirrored, 0, 1) ** exponent
        return np.where(lit, lobe * angles.cos_i, 0)

    def fresnel_cosine(self, angles: Angles) -> Floats:
        return angles.cos_o


def phong_exponent(sigma: float | Floats) -> Floats:
    """The exponent s of Phong's lobe whose highlight is as wide as that of facets of roughness sigma, radians."""
    return np.asarray(1 / (2 * np.asarray(sigma, float) ** 2))


def phong_sigma(exponent: float) -> float:
    """The roughness, radians, whose `phong_exponent` is a given one, > 0."""
    return float(np.sqrt(1 / (2 * exponent)))


def part_width(factor: float | Floats, sigma: float | Floats) -> Floats:
    """The width of a part of a form that is so many times as wide as sigma, radians; a haze ends at 0.3.

    Wider ones look like the base, and would pass for it.
    """
    sigma = np.asarray(sigma, float)
    return np.minimum(factor * sigma, np.maximum(_WIDEST_HAZE, sigma))


RH01_FORM, BECKMANN, GGX_FORM, PHONG = RH01Microfacet(), Beckmann(), GGX(), Phong()
FORMS = {form.name: form for form in (RH01_FORM, BECKMANN, GGX_FORM, PHONG)}
# The same lobes above a base under an interface.
PLASTICS: dict[LobeForm, LobeForm] = {BECKMANN: Beckmann(over=BECKMANN), GGX_FORM: GGX(over=GGX_FORM)}
# The same with light and viewer hidden apart.
UNCORRELATED: dict[LobeForm, LobeForm] = {
    BECKMANN: Beckmann(correlated=False),
    GGX_FORM: GGX(correlated=False),
}
UNCORRELATED |= {
    PLASTICS[BECKMANN]: Beckmann(correlated=False, over=UNCORRELATED[BECKMANN]),
    PLASTICS[GGX_FORM]: GGX(correlated=False, over=UNCORRELATED[GGX_FORM]),
}
