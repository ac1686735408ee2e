"""Lambertian reflection as convolution with the clamped cosine."""

from __future__ import annotations

from math import factorial, pi

import numpy as np
from numpy.typing import ArrayLike, NDArray

from invrender.theory.harmonics import evaluate_harmonics

Floats = NDArray[np.float64]


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


def irradiance(normals: ArrayLike, lighting_coefficients: ArrayLike) -> Floats:
    """Irradiance (n, c) at unit normals (n, 3) under unoccluded lighting ((l_max + 1)^2, c) [RH01, eq. 15]."""
    coefficients = np.asarray(lighting_coefficients, float)
    l_max = int(np.sqrt(len(coefficients))) - 1
    per_degree = np.repeat(clamped_cosine_transfer(l_max), 2 * np.arange(l_max + 1) + 1)
    return evaluate_harmonics(normals, l_max) @ (per_degree[:, None] * coefficients)
