"""What a lobe reflects of a lamp, as a table that the graphics card interpolates.

Half vector and difference vector of the two directions are its axes [Rusinkiewicz 1998, "A new change of variables for
efficient BRDF representation"]: theta_h, the finer the nearer to the normal, theta_d and phi_d. What is tabulated is
the reflected radiance times cos theta_o, which stays bounded.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import map_coordinates

from invrender.brdf.form import Angles, part_width
from invrender.brdf.microfacet import Microfacet

Floats = NDArray[np.float64]

# Steps of theta_h, theta_d and phi_d.
_STEPS = (96, 48, 24)
# Beyond the horizon the table goes on as on it.
_HORIZON = 1e-3


@dataclass(frozen=True, eq=False)
class LobeVolume:
    """Radiance times cos theta_o per unit of Ks and of irradiance across the beam, (phi_d, theta_d, theta_h) float16.

    width : radians; theta_h = width sinh(s asinh(pi / 2 / width)) at even steps s from 0 to 1. theta_d = (pi / 2)
    (1 - (1 - s)^2), which is the finer the more grazing, and phi_d = pi s.
    """

    values: NDArray[np.float16]
    width: float

    def at(self, theta_h: Floats, theta_d: Floats, phi_d: Floats) -> Floats:
        """Values (m,) at angles (m,), linear in between, as the graphics card takes them."""
        shares = (
            phi_d / np.pi,
            1 - np.sqrt(np.maximum(1 - theta_d / (np.pi / 2), 0)),
            np.arcsinh(theta_h / self.width) / np.arcsinh(np.pi / 2 / self.width),
        )
        places = [share * (count - 1) for share, count in zip(shares, self.values.shape, strict=True)]
        return map_coordinates(self.values.astype(float), places, order=1, mode="nearest")


def lobe_volume(brdf: Microfacet) -> LobeVolume:
    """The table of a BRDF's isotropic lobe; zero of a BRDF without one."""
    if brdf.sigma is None or not brdf.ks.any():
        return LobeVolume(np.zeros((2, 2, 2), np.float16), 1.0)
    width = lobe_width(brdf)
    steps = np.linspace(0, 1, _STEPS[0])
    theta_h = width * np.sinh(steps * np.arcsinh(np.pi / 2 / width))
    theta_d = np.pi / 2 * (1 - (1 - np.linspace(0, 1, _STEPS[1])) ** 2)
    phi_d = np.linspace(0, np.pi, _STEPS[2])
    phi, difference, half = np.meshgrid(phi_d, theta_d, theta_h, indexing="ij")
    along = np.cos(half) * np.cos(difference)
    beside = np.sin(half) * np.sin(difference) * np.cos(phi)
    cos_i, cos_o = (np.maximum(cos, _HORIZON) for cos in (along - beside, along + beside))
    angles = Angles(half, cos_i, cos_o, np.cos(difference))
    values = brdf.form.reflected(angles, brdf.mu, brdf.sigma) * cos_o
    return LobeVolume(np.minimum(values, np.finfo(np.float16).max).astype(np.float16), width)


def lobe_width(brdf: Microfacet) -> float:
    """The width of the narrowest part of a BRDF's lobe, radians."""
    assert brdf.sigma is not None
    factors = [factor for _, factor in brdf.form.parts] or [1.0]
    return min(float(part_width(np.array(factor), brdf.sigma)) for factor in factors)
