"""How microfacets lean: distributions of slopes with Smith's shadowing and masking.

Both distributions are one bell, of slope along the tangent and across it, stretched by two widths; equal
widths make it isotropic. With t = (tan theta_h)^2 over the width squared:

    Beckmann  D = exp(-t) / (pi a^2 cos^4)            [Walter et al. 2007, eq. 25]
    GGX       D = 1 / (pi a^2 cos^4 (1 + t)^2)        [Walter et al. 2007, eq. 33]

Walter, Marschner, Li, Torrance, "Microfacet models for refraction through rough surfaces", EGSR 2007. Heitz,
"Understanding the masking-shadowing function in microfacet-based BRDFs", JCGT 3(2), 2014, has the anisotropic
forms and Lambda. Half vectors come unnormalised, wi + wo, which saves a square root per evaluation.
"""

from __future__ import annotations

import math
from abc import abstractmethod
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.special import erf

from synthetic.vectors import dot

AnyFloats = NDArray[np.floating]

# Least square of the cosine of a half vector: keeps powers of it within single precision.
_LEAST_COS2 = 1e-12
# Smith's integral for Beckmann is below single precision where the cotangent is above this many widths.
_STEEPEST = 6.0


@dataclass(frozen=True)
class Facets:
    """A distribution of microfacets. along, across : widths of slope along the tangent and bitangent, > 0."""

    along: float
    across: float

    def __post_init__(self) -> None:
        for name in ("along", "across"):
            value = getattr(self, name)
            if not 0 < value < np.inf:
                raise ValueError(f"the roughness {name} the tangent is {value}; it must be > 0")
            # Python's own numbers leave float32 arrays as they are.
            object.__setattr__(self, name, float(value))

    @abstractmethod
    def density(self, half: AnyFloats) -> AnyFloats:
        """Density D (...,) of facets, 1/sr, at upward vectors (..., 3) of any length; D cos integrates to 1."""

    @abstractmethod
    def hidden(self, w: AnyFloats) -> AnyFloats:
        """Lambda cos_theta (...,) of unit directions (..., 3): what facets hide of each other from there.

        Of facets that show an area cos + hidden, an area cos is seen: G1 = cos / (cos + hidden). Times the cosine,
        Lambda is finite at grazing.
        """

    def _slope2(self, w: AnyFloats) -> AnyFloats:
        return (w[..., 0] / self.along) ** 2 + (w[..., 1] / self.across) ** 2

    def _spread2(self, w: AnyFloats) -> AnyFloats:
        return (self.along * w[..., 0]) ** 2 + (self.across * w[..., 1]) ** 2


class BeckmannSlopes(Facets):
    """Slopes as a Gaussian: along and across are RMS slopes times sqrt(2)."""

    def density(self, half: AnyFloats) -> AnyFloats:
        cos2 = np.maximum(half[..., 2] ** 2, _LEAST_COS2)
        secant2 = dot(half, half) / cos2
        return np.exp(-self._slope2(half) / cos2) * secant2**2 / (np.pi * self.along * self.across)

    def hidden(self, w: AnyFloats) -> AnyFloats:
        # Lambda = (erf(a) - 1) / 2 + exp(-a^2) / (2 a sqrt(pi)), a = cos / spread      [Heitz 2014, eq. 72]
        cos = w[..., 2]
        spread = np.sqrt(self._spread2(w))
        a = cos / np.maximum(spread, np.abs(cos) / _STEEPEST)
        return (cos * (erf(a) - 1) + spread * np.exp(-a * a) / math.sqrt(math.pi)) / 2


class GGXSlopes(Facets):
    """Slopes with long tails: along and across are the widths alpha."""

    def density(self, half: AnyFloats) -> AnyFloats:
        # 1e-30 is below any square of an upward vector; it keeps 0 / 0 out where wi = -wo.
        stretched = np.maximum(self._slope2(half) + half[..., 2] ** 2, 1e-30)
        return (dot(half, half) / stretched) ** 2 / (np.pi * self.along * self.across)

    def hidden(self, w: AnyFloats) -> AnyFloats:
        # Lambda = (sqrt(1 + 1 / a^2) - 1) / 2, a = cos / spread                        [Heitz 2014, eq. 72]
        return (np.sqrt(w[..., 2] ** 2 + self._spread2(w)) - w[..., 2]) / 2

    def sample(self, wo: AnyFloats, u: AnyFloats) -> AnyFloats:
        """Directions (..., 3) that wo (..., 3) is reflected to by the facets it sees, for u (..., 2) in 0 to 1.

        Heitz, "Sampling the GGX distribution of visible normals", JCGT 7(4), 2018.
        """
        stretch = np.array([self.along, self.across, 1], wo.dtype)
        # Stretched so that the facets are a hemisphere.
        view = _unit(wo * stretch)
        x, y, z = np.moveaxis(view, -1, 0)
        level = np.sqrt(x * x + y * y)
        flat = level < 1e-6
        level = np.where(flat, 1, level)
        cos, sin = np.where(flat, 0, x / level), np.where(flat, -1, y / level)
        # Seen from there it shows as a disk, one half of it shortened.
        radius, phi = np.sqrt(u[..., 0]), 2 * np.pi * u[..., 1]
        first = radius * np.cos(phi)
        second = radius * np.sin(phi)
        share = (1 + z) / 2
        second = (1 - share) * np.sqrt(1 - first * first) + share * second
        third = np.sqrt(np.maximum(1 - first * first - second * second, 0))
        # Axes of the disk: (-sin, cos, 0) and (-z cos, -z sin, level of the view).
        across = second * np.where(flat, 0, level)
        normal = np.stack(
            [
                third * x - first * sin - second * z * cos,
                third * y + first * cos - second * z * sin,
                np.maximum(third * z + across, 0),
            ],
            axis=-1,
        )
        half = _unit(normal * stretch)
        return 2 * dot(wo, half)[..., None] * half - wo

    def sampled_density(self, wi: AnyFloats, wo: AnyFloats) -> AnyFloats:
        """Density (...,) of `sample`, 1/sr, at directions wi (..., 3) for viewers wo (..., 3)."""
        half = wi + wo
        # G1 D (wo.h) / cos_o, and 1 / (4 wo.h) from half vector to direction.
        seen = self.density(half) / (4 * (wo[..., 2] + self.hidden(wo)))
        return np.where(half[..., 2] > 0, seen, 0)


def _unit(v: AnyFloats) -> AnyFloats:
    return v / np.sqrt(dot(v, v))[..., None]
