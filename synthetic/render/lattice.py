"""Points that fill the unit square evenly: rank-1 lattices (Sloan and Joe, Lattice Methods, 1994), shifted at random.

A shifted lattice integrates without bias; smooth functions converge almost as 1/N^2, shadows' edges as N^(-3/4).
scipy.stats.qmc has nets (Sobol, Halton), but no lattices, whose parts are lattices again.
"""

from __future__ import annotations

from functools import cache

import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.float64]


@cache
def lattice(count: int) -> Floats:
    """The lattice (count, 2) in [0, 1), count >= 2 a power of two.

    Its generator is the one whose continued fraction has the smallest quotients: such lattices are the evenest.
    """
    if count < 2 or count & (count - 1):
        raise ValueError(f"a lattice of {count} points: the number must be a power of two")
    generator = min(range(1, count, 2), key=lambda a: (_quotients(a, count), abs(a - 0.618 * count)))
    index = np.arange(count)
    points = np.column_stack([index / count, index * generator % count / count])
    points.flags.writeable = False
    return points


def dealt(count: int, hands: int) -> Floats:
    """A lattice of `count` points dealt out to so many hands, (hands, count / hands, 2), both powers of two.

    Each hand's points are a lattice themselves, and together they are the whole one: so sub-samples of a pixel share
    the directions that are looked into from it.
    """
    return lattice(count).reshape(-1, hands, 2).swapaxes(0, 1)


def shifted(points: Floats, shifts: Floats) -> NDArray[np.float32]:
    """Points (n, k, 2) moved by shifts (n, 2) around the square, and folded in their first coordinate.

    The fold (the baker's map) makes what is smooth periodic too, which lattices integrate best; their second
    coordinate is an azimuth, periodic by itself.
    """
    moved = points.astype(np.float32) + shifts[:, None, :].astype(np.float32)
    # Both are below 1, so this is what % 1 is, in a tenth of its time.
    moved -= moved >= 1
    moved[..., 0] = 1 - np.abs(2 * moved[..., 0] - 1)
    return np.minimum(moved, np.float32(1 - 2**-24))


def _quotients(numerator: int, denominator: int) -> int:
    """Sum of the quotients of a continued fraction."""
    total = 0
    while numerator:
        total += denominator // numerator
        numerator, denominator = denominator % numerator, numerator
    return total
