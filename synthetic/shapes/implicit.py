"""Shapes as the zero level of functions that are negative inside and nearly a distance.

Every function here comes with its gradient, by the chain rule. All are twice continuously differentiable away
from the shapes' medial axes, so that the normals of a blended surface have no kink in which a highlight would
show one.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.interpolate import CubicSpline

Floats = NDArray[np.float64]
# Points (n, 3) to values (n,) and gradients (n, 3).
Implicit = Callable[[Floats], tuple[Floats, Floats]]

# Share of a round cone's axis over which its closest point slows down towards an end.
_SLOWING = 0.3


def ellipsoid(centre: Sequence[float], radii: Sequence[float]) -> Implicit:
    """An ellipsoid with axes along x, y and z; exact where the radii are equal.

    The value is k (k - 1) / m with k = |p / radii| and m = |p / radii^2|: the plain k - 1 over its gradient's
    length, which makes it a distance near the surface.
    """
    middle, axes = np.array(centre, float), np.array(radii, float)

    def field(points: Floats) -> tuple[Floats, Floats]:
        offset = points - middle
        once, twice = offset / axes, offset / axes**2
        # At the centre itself, where the quotient has no limit, any value inside will do.
        k = np.maximum(np.linalg.norm(once, axis=1), 1e-9)
        m = np.maximum(np.linalg.norm(twice, axis=1), 1e-9 / axes.max())
        slope_k, slope_m = twice / k[:, None], twice / axes**2 / m[:, None]
        value = k * (k - 1) / m
        gradient = ((2 * k - 1) / m)[:, None] * slope_k - (value / m)[:, None] * slope_m
        return value, gradient

    return field


def round_cone(
    start: Sequence[float], end: Sequence[float], start_radius: float, end_radius: float
) -> Implicit:
    """A rod with round ends whose radius goes from one value to the other."""
    origin, along = np.array(start, float), np.subtract(end, start).astype(float)
    length2, growth = float(along @ along), end_radius - start_radius

    def field(points: Floats) -> tuple[Floats, Floats]:
        offset = points - origin
        place, slope = _smooth_clamp(offset @ along / length2)
        across = offset - place[:, None] * along
        distance = np.maximum(np.linalg.norm(across, axis=1), 1e-9)
        outward = across / distance[:, None]
        pull = slope * (outward @ along + growth) / length2
        return distance - (start_radius + growth * place), outward - pull[:, None] * along

    return field


def curled_tube(
    azimuths: ArrayLike, distances: ArrayLike, heights: ArrayLike, squared_radii: ArrayLike
) -> Implicit:
    """A tube whose axis winds about z: its course is a cubic spline over the azimuth, -pi to pi.

    distances : of the tube's axis from z. squared_radii : of the tube; it ends, rounded, where they fall below
    zero, which they must do before -pi and pi, where the function jumps.
    """
    course = CubicSpline(azimuths, np.column_stack([distances, heights, squared_radii]), bc_type="natural")
    change = course.derivative()
    size = float(np.sqrt(np.max(squared_radii)))

    def field(points: Floats) -> tuple[Floats, Floats]:
        x, y, z = points.T
        around = np.arctan2(y, x)
        reach = np.maximum(np.hypot(x, y), 1e-9)
        distance, height, squared_radius = course(around).T
        turn = np.column_stack([-y, x, np.zeros_like(x)]) / reach[:, None] ** 2
        slopes = change(around)[:, :, None] * turn[:, None, :]
        outward = np.column_stack([x, y, np.zeros_like(x)]) / reach[:, None]
        aside, above = reach - distance, z - height
        squared = aside**2 + above**2
        rise = 2 * aside[:, None] * (outward - slopes[:, 0])
        rise += 2 * above[:, None] * (np.array([0.0, 0.0, 1.0]) - slopes[:, 1])
        # Over this the difference of squares becomes a distance far off, yet has no kink on the tube's axis.
        long = np.sqrt(squared + size**2)
        value = (squared - squared_radius) / (long + size)
        gradient = (rise - slopes[:, 2]) / (long + size)[:, None]
        gradient -= (value / (long + size) / (2 * long))[:, None] * rise
        return value, gradient

    return field


def union(blend: float, first: Implicit, *others: Implicit) -> Implicit:
    """Shapes joined by fillets that reach `blend` far, in the unit of the points."""

    def field(points: Floats) -> tuple[Floats, Floats]:
        value, gradient = first(points)
        for other in others:
            value_b, gradient_b = other(points)
            value, share = _smooth_minimum(value, value_b, blend)
            gradient = share[:, None] * gradient + (1 - share)[:, None] * gradient_b
        return value, gradient

    return field


def difference(blend: float, shape: Implicit, *holes: Implicit) -> Implicit:
    """A shape less others, edges rounded by `blend`."""
    outside = union(blend, _negative(shape), *holes)
    return _negative(outside)


def mirrored(shape: Implicit) -> Implicit:
    """The shape on the other side of the plane y = 0."""
    flip = np.array([1.0, -1.0, 1.0])

    def field(points: Floats) -> tuple[Floats, Floats]:
        value, gradient = shape(points * flip)
        return value, gradient * flip

    return field


def squeezed(shape: Implicit, centre: Sequence[float], factor: float) -> Implicit:
    """The shape made thinner by `factor` < 1 along x about a centre; the value stays below the distance."""
    middle, scale = np.array(centre, float), np.array([1 / factor, 1.0, 1.0])

    def field(points: Floats) -> tuple[Floats, Floats]:
        value, gradient = shape((points - middle) * scale + middle)
        return factor * value, factor * gradient * scale

    return field


def scaled(shape: Implicit, factor: float) -> Implicit:
    """The shape `factor` times as large about the origin."""

    def field(points: Floats) -> tuple[Floats, Floats]:
        value, gradient = shape(points / factor)
        return factor * value, gradient

    return field


def _negative(shape: Implicit) -> Implicit:
    def field(points: Floats) -> tuple[Floats, Floats]:
        value, gradient = shape(points)
        return -value, -gradient

    return field


def _smooth_minimum(a: Floats, b: Floats, blend: float) -> tuple[Floats, Floats]:
    """Minimum of two values with a cubic fillet, and how much of its gradient is that of `a`, 0 to 1.

    The cubic, unlike the usual quadratic, has a continuous second derivative where the fillet begins.
    """
    near = np.maximum(1 - np.abs(a - b) / blend, 0)
    value = np.minimum(a, b) - near**3 * (blend / 6)
    of_other = near**2 / 2
    return value, np.where(a < b, 1 - of_other, of_other)


def _smooth_clamp(t: Floats) -> tuple[Floats, Floats]:
    """t held between 0 and 1, with rounded corners, and its derivative."""
    zero, one = np.zeros_like(t), np.ones_like(t)
    low, share_low = _smooth_minimum(-t, zero, _SLOWING)
    high, share_high = _smooth_minimum(-low, one, _SLOWING)
    return high, share_low * share_high
