"""Distant light with a formula: smooth area lights."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from capture.arrays import frozen_array
from synthetic.lights.values import about_axis, rgb, unit_vector

Floats = NDArray[np.float64]
AnyFloats = NDArray[np.floating]


@dataclass(frozen=True, eq=False)
class AreaLight:
    """A broad, smooth light: L(w) = radiance exp((w . axis - 1) / width^2).

    Near the axis this is a Gaussian of standard deviation `width_rad`. At 0.35 rad over 99% of its energy is
    in degrees l <= 6, as in RH01's projection screen (section 6, "Data Acquisition").

    axis : (3,) direction from the object to the light, any length. radiance : (3,) RGB on the axis, >= 0.
    width_rad : > 0; large ones tend to uniform light.
    """

    axis: Floats
    radiance: Floats
    width_rad: float

    def __post_init__(self) -> None:
        object.__setattr__(self, "axis", frozen_array(unit_vector(self.axis, "axis of an area light")))
        object.__setattr__(self, "radiance", frozen_array(rgb(self.radiance, "radiance of an area light")))
        if not self.width_rad > 0:
            raise ValueError(f"width of an area light is {self.width_rad} rad; it must be > 0")
        # Python's own numbers leave float32 arrays as they are.
        object.__setattr__(self, "width_rad", float(self.width_rad))

    def profile(self, cosine: NDArray[np.floating]) -> NDArray[np.floating]:
        """Radiance relative to the axis, 0 to 1, at the cosine of the angle from it; keeps the dtype."""
        return np.exp((cosine - 1) * (1 / self.width_rad**2))

    def radiance_from(self, directions: AnyFloats) -> AnyFloats:
        """Radiance (..., 3) from unit directions (..., 3); keeps the dtype."""
        dtype = directions.dtype
        return self.profile(directions @ self.axis.astype(dtype))[..., None] * self.radiance.astype(dtype)

    def sample(self, u: AnyFloats) -> AnyFloats:
        """Directions (..., 3) exactly as dense as the radiance, for u (..., 2) in 0 to 1."""
        w2 = self.width_rad**2
        # The density of c = cosine is exp((c - 1) / w^2), whose integral from c to 1 is inverted.
        versine = -w2 * np.log1p(u[..., 0] * math.expm1(-2 / w2))
        return about_axis(self.axis, versine, 2 * np.pi * u[..., 1])

    def density(self, directions: AnyFloats) -> AnyFloats:
        """Density (...,) of `sample`, 1/sr."""
        w2 = self.width_rad**2
        solid_angle = -2 * math.pi * w2 * math.expm1(-2 / w2)
        return self.profile(directions @ self.axis.astype(directions.dtype)) * (1 / solid_angle)

    def turned(self, rotation: Floats) -> AreaLight:
        """The same light after a rotation (3, 3) of the world."""
        return replace(self, axis=rotation @ self.axis)
