"""Real spherical harmonics: orthonormal, without Condon-Shortley phase, Y[1,1] positive along +x.

The coefficient of degree l (the papers say order) and order m is stored at l * l + l + m.
"""

from __future__ import annotations

from math import factorial, pi

import numpy as np
import sphericart
from numpy.typing import ArrayLike, NDArray

Floats = NDArray[np.float64]


def evaluate_harmonics(directions: ArrayLike, l_max: int) -> Floats:
    """Y_lm at directions (n, 3), unit, as (n, (l_max + 1)^2)."""
    directions = np.ascontiguousarray(np.asarray(directions, float).reshape(-1, 3))
    return np.asarray(sphericart.SphericalHarmonics(l_max).compute(directions))


def clamped_cosine_transfer(l_max: int) -> Floats:
    """Transfer A_l of Lambertian reflection, (l_max + 1,) steradian: irradiance has coefficients A_l L_lm.

    [RH01, eq. 15 and 16]: A_0 = pi, A_1 = 2 pi / 3, A_2 = pi / 4, zero for odd l > 1, and for even l
    2 pi (-1)^(l/2-1) / ((l+2)(l-1)) * l! / (2^l (l/2)!^2), which falls off as l^(-5/2).
    """
    transfer = np.zeros(l_max + 1)
    for degree in range(l_max + 1):
        if degree == 1:
            transfer[degree] = 2 * pi / 3
        elif degree % 2 == 0:
            half = degree // 2
            central = factorial(degree) / (2**degree * factorial(half) ** 2)
            transfer[degree] = 2 * pi * (-1) ** (half - 1) / ((degree + 2) * (degree - 1)) * central
    return transfer


def rotated_harmonics(coefficients: ArrayLike, rotation: ArrayLike) -> NDArray[np.floating]:
    """Coefficients (..., (l_max + 1)^2) of the functions that a rotation (3, 3) makes of functions on the sphere.

    What had its value in direction w has it in direction R w. Degree by degree the harmonics of turned directions are
    combinations of those of the directions themselves; they are solved for.
    """
    coefficients, rotation = np.asarray(coefficients), np.asarray(rotation, float)
    l_max = int(np.sqrt(coefficients.shape[-1])) - 1
    directions = sphere_directions(4 * (l_max + 1) ** 2)
    here, turned = (evaluate_harmonics(ways, l_max) for ways in (directions, directions @ rotation.T))
    result = np.empty_like(coefficients)
    for degree in range(l_max + 1):
        band = slice(degree**2, (degree + 1) ** 2)
        matrix = np.linalg.lstsq(turned[:, band], here[:, band])[0]
        result[..., band] = coefficients[..., band] @ matrix.T.astype(coefficients.dtype)
    return result


def sphere_directions(count: int) -> Floats:
    """Unit vectors (count, 3), spread evenly over the sphere along a spiral [Hannay and Nye 2004]."""
    step = np.arange(count) + 0.5
    z, azimuth = 1 - 2 * step / count, pi * (1 + np.sqrt(5)) * step
    around = np.sqrt(1 - z**2)
    return np.column_stack([around * np.cos(azimuth), around * np.sin(azimuth), z])
