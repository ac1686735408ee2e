"""Distant light with a formula: smooth area lights."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from capture.arrays import frozen_array
from synthetic.lights.values import rgb, unit_vector

Floats = NDArray[np.float64]

# Sub-samples per side of a lat-long pixel.
_SUBSAMPLES = 3


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

    def profile(self, cosine: NDArray[np.floating]) -> NDArray[np.floating]:
        """Radiance relative to the axis, 0 to 1, at the cosine of the angle from it; keeps the dtype."""
        return np.exp((cosine - 1) * (1 / self.width_rad**2))


def latlong_map(lights: Sequence[AreaLight], height: int) -> NDArray[np.float32]:
    """Lat-long map (height, 2 height, 3) float32 of the lights' sum, pixels being means over their areas.

    Rows run from +Z, columns from +X towards +Y, as `capture.lighting` has it.
    """
    fine = height * _SUBSAMPLES
    # Equal steps of cos(theta) within a row: sub-samples of equal solid angle.
    edges = np.cos(np.arange(height + 1) * np.pi / height)
    share = (np.arange(_SUBSAMPLES) + 0.5) / _SUBSAMPLES
    z = (edges[:-1, None] + np.diff(edges)[:, None] * share).ravel()
    phi = (np.arange(2 * fine) + 0.5) * np.pi / fine
    ring = np.sqrt(1 - z**2)
    radiance = np.zeros((height, 2 * height, 3))
    for light in lights:
        across = light.axis[0] * np.cos(phi) + light.axis[1] * np.sin(phi)
        profile = light.profile(ring[:, None] * across + (z * light.axis[2])[:, None])
        pixels = profile.reshape(height, _SUBSAMPLES, 2 * height, _SUBSAMPLES).mean(axis=(1, 3))
        radiance += pixels[..., None] * light.radiance
    return radiance.astype(np.float32)
