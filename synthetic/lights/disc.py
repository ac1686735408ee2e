"""A distant lamp with a size: a disc of even brightness."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from capture.arrays import frozen_array
from synthetic.lights.values import about_axis, rgb, unit_vector
from synthetic.vectors import dot

Floats = NDArray[np.float64]
AnyFloats = NDArray[np.floating]


@dataclass(frozen=True, eq=False)
class DiscLight:
    """A distant disc, evenly bright, as a lamp or the sun: it casts soft shadows and is seen in mirrors.

    direction : (3,) from the object to the disc's middle, any length.
    irradiance : (3,) RGB on a plane that faces it, >= 0. radius_rad : angular radius, above 0 and below pi / 2.
    """

    direction: Floats
    irradiance: Floats
    radius_rad: float

    def __post_init__(self) -> None:
        object.__setattr__(
            self, "direction", frozen_array(unit_vector(self.direction, "direction of a disc"))
        )
        object.__setattr__(self, "irradiance", frozen_array(rgb(self.irradiance, "irradiance of a disc")))
        if not 0 < self.radius_rad < np.pi / 2:
            raise ValueError(f"radius of a disc is {self.radius_rad} rad; it must lie between 0 and pi / 2")
        # Python's own numbers leave float32 arrays as they are.
        object.__setattr__(self, "radius_rad", float(self.radius_rad))

    def radiance_from(self, directions: AnyFloats) -> AnyFloats:
        """Radiance (..., 3) from unit directions (..., 3); keeps the dtype."""
        # The disc's projected solid angle, by which the irradiance is its radiance: pi sin^2.
        radiance = self.irradiance / (np.pi * np.sin(self.radius_rad) ** 2)
        return self._inside(directions)[..., None] * radiance.astype(directions.dtype)

    def sample(self, u: AnyFloats) -> AnyFloats:
        """Directions (..., 3) spread evenly over the disc, for u (..., 2) in 0 to 1."""
        versine = u[..., 0] * (2 * math.sin(self.radius_rad / 2) ** 2)
        return about_axis(self.direction, versine, 2 * np.pi * u[..., 1])

    def density(self, directions: AnyFloats) -> AnyFloats:
        """Density (...,) of `sample`, 1/sr."""
        return self._inside(directions) * (1 / (4 * math.pi * math.sin(self.radius_rad / 2) ** 2))

    def turned(self, rotation: Floats) -> DiscLight:
        """The same light after a rotation (3, 3) of the world."""
        return replace(self, direction=rotation @ self.direction)

    def _inside(self, directions: AnyFloats) -> AnyFloats:
        # By the chord, which keeps its digits in single precision where the cosine is 1 to rounding.
        away = directions - self.direction.astype(directions.dtype)
        chord = 2 * math.sin(self.radius_rad / 2)
        return (dot(away, away) <= chord**2).astype(directions.dtype)
