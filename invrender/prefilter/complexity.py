"""Orders and costs of prefiltering radially symmetric lobes, as R02 estimates them [R02, section 5.6.3 and 5.6.4].

Costs are numbers of operations up to a constant factor, of S x S pixels of light and of map. What prefiltering takes on
a computer is measured by `python -m benchmarks.papers r02-table5.3 r02-table5.4`.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike, NDArray

Floats = NDArray[np.float64]


def phong_order(exponent: ArrayLike, epsilon: float) -> Floats:
    """F = sqrt(-s log epsilon) that holds 1 - epsilon of the energy of Phong's lobe of exponent s [R02, eq. 5.28].

    Within 1 of the exact order for s of 8 to 512 and epsilon of 0.01 to 0.1. Raises ValueError for exponents that
    aren't above 0, and for an epsilon that isn't in (0, 1).
    """
    return np.sqrt(-_positive(exponent, "exponent") * np.log(_share(epsilon)))


def microfacet_order(sigma: ArrayLike, epsilon: float) -> Floats:
    """F = sqrt(-log epsilon / 2) / sigma, the same of microfacets of roughness sigma, radians, seen from the normal.

    From exp(-(sigma l)^2) [RH01, eq. 20] as eq. 5.28 is from eq. 5.27; R02 says F ~ 1 / sigma. Over all views up to
    twice as much is needed, since lobes become narrow streaks at grazing angles [R02, table 5.5]. Raises ValueError as
    `phong_order`.
    """
    return np.sqrt(-np.log(_share(epsilon)) / 2) / _positive(sigma, "sigma")


def phong_width(exponent: ArrayLike, epsilon: float) -> Floats:
    """W, the share of all directions that hold 1 - epsilon of the integral of Phong's lobe [R02, eq. 5.30].

    (1 - epsilon^(1 / (s + 1))) / 2, a cap about the mirrored view; for large s -log(epsilon) / (2 s). Eq. 5.31 prints
    this without the 2. Raises ValueError as `phong_order`.
    """
    return np.asarray((1 - _share(epsilon) ** (1 / (_positive(exponent, "exponent") + 1))) / 2)


def angular_cost(exponent: ArrayLike, size: int) -> Floats:
    """S^4 / s, of integration over angles [R02, eq. 5.32]; size : S, pixels. Raises ValueError as `phong_order`."""
    return float(size) ** 4 / _positive(exponent, "exponent")


def frequency_cost(exponent: ArrayLike, size: int) -> Floats:
    """S^2 sqrt(s), of prefiltering by harmonics [R02, eq. 5.29]; size : S, pixels. ValueError as `phong_order`."""
    return float(size) ** 2 * np.sqrt(_positive(exponent, "exponent"))


def crossover(size: int) -> float:
    """s* = S^(4/3), the exponent above which integration over angles costs less than harmonics [R02, eq. 5.33]."""
    return float(size) ** (4 / 3)


def measured_crossover(exponents: ArrayLike, ratios: ArrayLike) -> float:
    """The exponent at which measured ratios of times, angles over harmonics, reach 1.

    exponents, ratios : (n,), n >= 2, rising and falling. Between measured ones by their logarithms; beyond the last by
    the line through the last two. Raises ValueError for ratios that don't fall.
    """
    s, ratio = np.log(np.asarray(exponents, float)), np.log(np.asarray(ratios, float))
    if len(s) < 2 or not (np.diff(s) > 0).all() or not (np.diff(ratio) < 0).all():
        raise ValueError(
            f"ratios are {np.asarray(ratios).tolist()} at exponents {np.asarray(exponents).tolist()}; two or more that"
            " fall with the exponent are needed"
        )
    last = min(int(np.searchsorted(-ratio, 0.0)), len(s) - 1)
    last = max(last, 1)
    slope = (ratio[last] - ratio[last - 1]) / (s[last] - s[last - 1])
    return float(np.exp(s[last] - ratio[last] / slope))


def _positive(values: ArrayLike, name: str) -> Floats:
    values = np.asarray(values, float)
    if not (values > 0).all() or not np.isfinite(values).all():
        raise ValueError(f"{name} is {values.tolist()}; it must be finite and above 0")
    return values


def _share(epsilon: float) -> float:
    if not 0 < epsilon < 1:
        raise ValueError(f"epsilon is {epsilon}; the share that may be missing must be in (0, 1)")
    return epsilon
