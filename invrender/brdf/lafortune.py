"""Lafortune's generalised cosine lobes."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from invrender.brdf.form import Lobe

Floats = NDArray[np.float64]


@dataclass(frozen=True)
class LafortuneLobe:
    """(C_xy (x x' + y y') + C_z z z')^n where that is above 0, 1/sr, of local directions [Lafortune et al. 1997].

    xy, z, exponent : red, green, blue.
    """

    xy: tuple[float, float, float]
    z: tuple[float, float, float]
    exponent: tuple[float, float, float]


@dataclass(frozen=True)
class LafortuneBrdf:
    """albedo : of its Lambertian part, red, green, blue. lobes : that are added."""

    albedo: tuple[float, float, float]
    lobes: Sequence[LafortuneLobe]

    def specular(self, channel: int) -> Lobe:
        """The sum of the lobes times the cosine of incidence, zero below the horizon, of a channel."""

        def reflected(normals: Floats, wi: Floats, wo: Floats) -> Floats:
            cos_i, cos_o = (normals * wi).sum(axis=-1), (normals * wo).sum(axis=-1)
            upright = cos_i * cos_o
            level = (wi * wo).sum(axis=-1) - upright
            total = np.zeros(np.broadcast(cos_i, cos_o).shape)
            for lobe in self.lobes:
                along = lobe.xy[channel] * level + lobe.z[channel] * upright
                total += np.maximum(along, 0) ** lobe.exponent[channel]
            return np.where((cos_i > 0) & (cos_o > 0), total * np.maximum(cos_i, 0), 0)

        return reflected


# Human skin, as measured by Marschner et al. 1999 ("Image-based BRDF measurement including human skin") and fitted by
# Lafortune's lobes; the numbers are those of pbrt's material "skin" [Pharr and Humphreys 2004].
SKIN = LafortuneBrdf(
    albedo=(0.428425, 0.301341, 0.331054),
    lobes=(
        LafortuneLobe(
            (-1.131747, -1.016939, -0.966018),
            (-1.209182, -1.462488, -1.222419),
            (6.421658, 3.699932, 3.524889),
        ),
        LafortuneLobe(
            (-0.546570, -0.643533, -0.638934), (0.380123, 0.410559, 0.437367), (3.685044, 4.266495, 4.539742)
        ),
        LafortuneLobe(
            (-0.998888, -1.020153, -1.027479),
            (0.857998, 0.703913, 0.573625),
            (64.208486, 63.919687, 43.809866),
        ),
    ),
)
