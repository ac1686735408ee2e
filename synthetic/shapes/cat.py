"""A sculpture of a seated cat: ears, legs and tail that shadow the body and each other."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from synthetic.shapes.implicit import (
    Implicit,
    curled_tube,
    difference,
    ellipsoid,
    mirrored,
    round_cone,
    scaled,
    squeezed,
    union,
)

Floats = NDArray[np.float64]

# Metres: the sphere about the origin that holds the cat.
REACH = 0.07
# The parts are given in centimetres. The cat looks along +x, its left is +y.
_CENTIMETRE = 0.01


def cat_field(points: Floats) -> tuple[Floats, Floats]:
    """The cat as an implicit surface: values (n,) in metres, negative inside, and gradients (n, 3).

    points : (n, 3) metres. The value is like a distance, not one: on the surface its gradient is
    0.2 to 1.3 long, and shorter than 0.5 on 1% of it, at the tail's tip and in creases.
    """
    return _CAT(points)


def contains(points: Floats) -> NDArray[np.bool_]:
    """Whether points (n, 3), metres, lie inside the cat."""
    return np.asarray(cat_field(points)[0] < 0)


def _both(shape: Implicit) -> tuple[Implicit, Implicit]:
    return shape, mirrored(shape)


def _torso() -> Implicit:
    back = round_cone((-1.2, 0, -3.1), (0.5, 0, 0.2), 2.35, 1.6)
    chest = ellipsoid((1.0, 0, -0.6), (1.25, 1.45, 1.7))
    neck = round_cone((0.7, 0, 0.8), (1.0, 0, 2.3), 1.35, 1.2)
    haunches = _both(ellipsoid((-0.95, 1.75, -3.6), (1.7, 1.0, 1.75)))
    feet = _both(ellipsoid((0.65, 2.15, -5.15), (1.25, 0.52, 0.45)))
    return union(0.5, union(0.9, back, chest, neck), *haunches, *feet)


def _forelegs() -> Implicit:
    legs = _both(round_cone((1.2, 0.95, -0.7), (1.9, 0.86, -4.9), 0.85, 0.46))
    paws = _both(ellipsoid((2.25, 0.88, -5.15), (0.85, 0.58, 0.45)))
    return union(0.35, *legs, *paws)


def _head() -> Implicit:
    skull = ellipsoid((1.35, 0, 3.25), (1.65, 1.85, 1.5))
    cheeks = _both(ellipsoid((1.75, 0.85, 2.75), (0.95, 0.95, 0.8)))
    muzzle = _both(ellipsoid((2.85, 0.33, 2.75), (0.5, 0.48, 0.38)))
    chin = ellipsoid((2.7, 0, 2.4), (0.4, 0.4, 0.3))
    bridge = round_cone((2.5, 0, 3.6), (3.05, 0, 3.1), 0.42, 0.24)
    nose = ellipsoid((3.22, 0, 3.1), (0.2, 0.27, 0.17))
    head = union(0.5, skull, *cheeks)
    head = union(0.3, head, bridge, *muzzle, chin)
    head = union(0.2, head, nose)
    sockets = _both(ellipsoid((2.95, 0.8, 3.6), (0.4, 0.46, 0.36)))
    eyes = _both(ellipsoid((2.38, 0.75, 3.58), (0.42, 0.42, 0.3)))
    head = union(0.2, difference(0.35, head, *sockets), *eyes)
    ear = squeezed(round_cone((0.9, 1.1, 4.0), (0.8, 1.5, 5.7), 0.95, 0.22), (0.9, 1.1, 4.0), 0.6)
    hollow = squeezed(round_cone((1.45, 1.15, 4.35), (1.2, 1.47, 5.5), 0.6, 0.1), (1.45, 1.15, 4.35), 0.8)
    return union(0.3, head, *_both(difference(0.2, ear, hollow)))


def _tail() -> Implicit:
    # From behind the cat (azimuth 180 degrees, where the root is inside it) past its left side to the paws.
    azimuths = np.radians([-180, -120, -60, 0, 15, 30, 60, 90, 120, 145, 165, 180])
    distances = [3.6, 3.6, 3.6, 3.7, 3.75, 3.8, 3.9, 3.95, 3.95, 3.8, 3.0, 1.8]
    heights = [-3.6, -5.0, -5.0, -5.0, -5.0, -5.0, -5.0, -5.0, -4.95, -4.8, -4.4, -3.7]
    squared_radii = [-4, -4, -3, -0.35, -0.05, 0.15, 0.21, 0.24, 0.27, 0.29, 0.31, 0.32]
    return curled_tube(azimuths, distances, heights, squared_radii)


_CAT = scaled(
    union(0.55, union(0.5, union(0.8, _torso(), _forelegs()), _head()), _tail()),
    _CENTIMETRE,
)
