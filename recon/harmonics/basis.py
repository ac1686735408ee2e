"""Real spherical harmonics: orthonormal, without Condon-Shortley phase, Y[1,1] positive along +x.

The coefficient of degree l (the papers say order) and order m is stored at l * l + l + m.
"""

from __future__ import annotations

from math import factorial, isqrt, pi
from typing import Any, TypeVar

import numpy as np
import sphericart
from numpy.typing import ArrayLike, NDArray
from threadpoolctl import ThreadpoolController

Floats = NDArray[np.float64]
Array = TypeVar("Array", bound=NDArray[Any])

# How far a direction's length may be from 1: rounding of single precision, and no more.
_UNIT = 1e-5
# sphericart's factors overflow a little above.
_HIGHEST = 140

# Loads sphericart's library, and OpenMP's with it unless another library has.
sphericart.SphericalHarmonics(0)
_OPENMP = ThreadpoolController().select(user_api="openmp")


def evaluate_harmonics(directions: ArrayLike, l_max: int) -> Floats:
    """Y_lm at directions (n, 3), unit, as (n, (l_max + 1)^2).

    Raises ValueError for l_max below 0 or above 140, and for directions that aren't finite and unit.
    """
    check_degree(l_max)
    if l_max > _HIGHEST:
        raise ValueError(
            f"l_max is {l_max}; scattered harmonics are evaluated up to degree {_HIGHEST}; lat-long grids carry"
            " higher ones"
        )
    directions = np.ascontiguousarray(np.asarray(directions, float).reshape(-1, 3))
    check_unit(directions)
    # We spread the work ourselves. Two threads of OpenMP that share cores with other work wait for each other:
    # harmonics of a hundred directions then take up to a hundred times as long.
    with _OPENMP.limit(limits=1):
        return np.asarray(sphericart.SphericalHarmonics(l_max).compute(directions))


def check_degree(l_max: int, name: str = "l_max") -> None:
    """Raise ValueError for a highest degree that isn't an integer >= 0."""
    if l_max < 0 or l_max != int(l_max):
        raise ValueError(f"{name} is {l_max}; it must be an integer >= 0")


def finite(values: Array, name: str) -> Array:
    """The values, if all are finite; ValueError with the number of those that aren't."""
    wrong = values.size - int(np.isfinite(values).sum())
    if wrong:
        raise ValueError(f"{name}: {wrong} of {values.size} values are not finite")
    return values


def check_unit(directions: Floats, name: str = "directions") -> None:
    """Raise ValueError, with the worst of them, for directions (..., 3) that aren't finite and unit."""
    # By a product with ones: four times as fast as a sum over the short axis.
    squares = (directions * directions) @ np.ones(3)
    # `not <=`: NaN is no length either.
    if squares.size and not (squares.max() <= 1 + 2 * _UNIT and squares.min() >= 1 - 2 * _UNIT):
        off = np.where(np.isnan(squares), np.inf, np.abs(squares - 1))
        worst = np.unravel_index(np.argmax(off), off.shape)
        raise ValueError(
            f"{name}[{', '.join(map(str, worst))}] is {directions[worst].tolist()}; directions must be finite and of"
            " length 1: divide them by their length"
        )


def degree_of(count: int) -> int:
    """l_max of `count` coefficients, (l_max + 1)^2 of them; ValueError for any other number."""
    l_max = isqrt(count) - 1
    if count < 1 or (l_max + 1) ** 2 != count:
        raise ValueError(
            f"there are {count} coefficients; a function of degree l_max has (l_max + 1)^2: 1, 4, 9, 16, ..."
        )
    return l_max


def degrees(l_max: int) -> NDArray[np.int64]:
    """Degree l of each coefficient in storage order, ((l_max + 1)^2,)."""
    return np.repeat(np.arange(l_max + 1), 2 * np.arange(l_max + 1) + 1)


def orders(l_max: int) -> NDArray[np.int64]:
    """Order m of each coefficient in storage order, ((l_max + 1)^2,)."""
    l = degrees(l_max)
    return np.arange(len(l)) - l * l - l


def to_degree(coefficients: ArrayLike, l_max: int) -> Floats:
    """Coefficients ((l_max + 1)^2, ...) of the same function, cut off above l_max or filled up with zeros."""
    check_degree(l_max)
    coefficients = np.asarray(coefficients, float)
    degree_of(len(coefficients))
    result = np.zeros(((l_max + 1) ** 2, *coefficients.shape[1:]))
    kept = min(len(result), len(coefficients))
    result[:kept] = coefficients[:kept]
    return result


def clamped_cosine_transfer(l_max: int) -> Floats:
    """Transfer A_l of Lambertian reflection, (l_max + 1,) steradian: irradiance has coefficients A_l L_lm.

    [RH01, eq. 15 and 16]: A_0 = pi, A_1 = 2 pi / 3, A_2 = pi / 4, zero for odd l > 1, and for even l
    2 pi (-1)^(l/2-1) / ((l+2)(l-1)) * l! / (2^l (l/2)!^2), which falls off as l^(-5/2).
    """
    check_degree(l_max)
    transfer = np.zeros(l_max + 1)
    for degree in range(l_max + 1):
        if degree == 1:
            transfer[degree] = 2 * pi / 3
        elif degree % 2 == 0:
            half = degree // 2
            central = factorial(degree) / (2**degree * factorial(half) ** 2)
            transfer[degree] = 2 * pi * (-1) ** (half - 1) / ((degree + 2) * (degree - 1)) * central
    return transfer


def sphere_directions(count: int) -> Floats:
    """Unit vectors (count, 3), spread evenly over the sphere along a spiral [Hannay and Nye 2004]."""
    step = np.arange(count) + 0.5
    z, azimuth = 1 - 2 * step / count, pi * (1 + np.sqrt(5)) * step
    around = np.sqrt(1 - z**2)
    return np.column_stack([around * np.cos(azimuth), around * np.sin(azimuth), z])
