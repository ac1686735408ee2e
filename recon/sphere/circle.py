"""The circle that most points of a plane lie near."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.float64]

# Circles tried, and points that each is tried on: half of the points may be others', and one circle in eight is good.
_TRIED, _LOOKED_AT = 400, 400


@dataclass(frozen=True)
class Disk:
    """A circle in an image: column, row and radius in pixels; the first pixel's centre is (0.5, 0.5)."""

    x: float
    y: float
    radius: float

    def scaled(self, factor: float) -> Disk:
        """The circle in the image at another size, so many times as large."""
        return Disk(factor * self.x, factor * self.y, factor * self.radius)


def circles_through(triples: Floats) -> Floats:
    """Circles (x, y, radius), (n, 3), through three points each, (n, 3, 2); NaN where they lie on a line."""
    first, *others = np.moveaxis(triples, 1, 0)
    (ax, ay), (bx, by) = ((other - first).T for other in others)
    twice_area = 2 * (ax * by - ay * bx)
    a, b = ax**2 + ay**2, bx**2 + by**2
    with np.errstate(divide="ignore", invalid="ignore"):
        middle = np.column_stack([by * a - ay * b, ax * b - bx * a]) / twice_area[:, None]
    middle[twice_area == 0] = np.nan
    return np.column_stack([first + middle, np.linalg.norm(middle, axis=1)])


def consensus_circle(points: Floats) -> Disk:
    """The circle, of many through three points each, that most of the points (n, 2) lie near.

    Near is 1 px and 2% of the radius: outlines of spheres are ellipses. Good to about as much. At least 3 points.
    """
    rng = np.random.default_rng(0)
    circles = circles_through(points[rng.integers(len(points), size=(_TRIED, 3))])
    circles = circles[np.isfinite(circles).all(axis=1)]
    if not len(circles):
        raise ValueError("the points lie on a line; no circle passes through them")
    some = points[np.linspace(0, len(points) - 1, min(len(points), _LOOKED_AT)).astype(int)]
    away = np.linalg.norm(some - circles[:, None, :2], axis=2) - circles[:, 2:]
    near = (np.abs(away) < 1 + 0.02 * circles[:, 2:]) & (circles[:, 2:] <= 2 * np.ptp(points, axis=0).max())
    return Disk(*(float(value) for value in circles[near.sum(axis=1).argmax()]))
