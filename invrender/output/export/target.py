"""What a format can say of a reflectance: a formula with numbers, in which ours is written as well as it can be.

All targets have a diffuse base under a lobe of microfacets, each with its own Fresnel factor, shadowing and way in
which the lobe takes light from the base.
"""

from __future__ import annotations

from abc import abstractmethod
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from invrender.brdf.form import Angles
from invrender.brdf.microfacet import Microfacet

Floats = NDArray[np.float64]

# Lobes narrower than this are mirrors to every renderer.
LEAST_ALPHA = 1e-3


@dataclass(frozen=True, eq=False)
class Numbers:
    """Numbers of a target.

    alpha : roughness as facets have it; the formats' own is its square root, or itself. fresnel : the target's number
    for how it rises at grazing angles. base : (3,), albedo below the lobe. specular : (3,), the lobe's strength.
    """

    alpha: float
    fresnel: float
    base: Floats
    specular: Floats

    @property
    def vector(self) -> Floats:
        """All in a row, (8,)."""
        return np.concatenate([[self.alpha, self.fresnel], self.base, self.specular])

    @classmethod
    def of(cls, vector: Floats) -> Numbers:
        """The numbers of a row (8,)."""
        return cls(float(vector[0]), float(vector[1]), vector[2:5], vector[5:8])


class Target:
    """A target's formula. model : what it is called there, for messages."""

    model: str

    def reflected(self, angles: Angles, numbers: Numbers) -> Floats:
        """Reflectance times cos theta_i, (n, 3), 1/sr, at pairs of directions (n,) above the horizon."""
        base = self.base_shown(angles, numbers) * numbers.base * (angles.cos_i / np.pi)[:, None]
        return base + self.lobe(angles, numbers)

    def takes(self, brdf: Microfacet) -> bool:
        """Whether a BRDF is worth trying in it."""
        return True

    @abstractmethod
    def lobe(self, angles: Angles, numbers: Numbers) -> Floats:
        """The lobe's part, (n, 3)."""

    def base_shown(self, angles: Angles, numbers: Numbers) -> Floats:
        """What the lobe leaves of the base, (n, 1)."""
        return np.ones((len(angles.cos_i), 1))

    @abstractmethod
    def start(self, brdf: Microfacet) -> Numbers:
        """Where the search for a BRDF with a lobe starts."""

    @abstractmethod
    def bounds(self, brdf: Microfacet, strongest: float = 1.0) -> tuple[Numbers, Numbers]:
        """The least and the largest numbers that it takes, where a texture makes the lobe so many times as strong."""

    @abstractmethod
    def matte(self, base: Floats) -> Numbers:
        """The numbers without a lobe."""
