"""A room around the object, to be seen behind it: the background that photographers forget to darken.

It is a picture on the walls of a box, the same from wherever it is seen; it lights nothing.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike, NDArray

from capture.camera import Camera

Floats = NDArray[np.float64]

# Points along a pixel's side.
_SAMPLES = 3
# Rectangles on each of the six walls: doors, windows, pictures, furniture, their sizes as shares of the wall.
_RECTANGLES, _SIZES = 7, (0.06, 0.35)
# Floorboards and stripes across a wall.
_STRIPES = 14


def room_background(
    camera: Camera, centre: ArrayLike, side_m: float, radiance: float, seed: int | list[int]
) -> Floats:
    """What a camera sees of an empty room (h, w, 3): means over pixels, radiance from about 0.05 to 2 times `radiance`.

    The room is a cube of side_m metres about centre (3,), and the camera must be in it. The seed decides how it looks.
    Where the lens distortion reaches no such pixel it is black.
    """
    centre = np.asarray(centre, float)
    if not 0 < side_m < np.inf:
        raise ValueError(f"the room's side is {side_m} m; it must be > 0")
    if not 0 <= radiance < np.inf:
        raise ValueError(f"the room's radiance is {radiance}; it must be finite and >= 0")
    walls = _walls(seed)
    offsets = (np.arange(_SAMPLES) + 0.5) / _SAMPLES
    columns, rows = np.meshgrid(np.arange(camera.width), np.arange(camera.height))
    total = np.zeros((camera.height * camera.width, 3))
    for down in offsets:
        for right in offsets:
            pixels = np.column_stack([(columns + right).ravel(), (rows + down).ravel()])
            origins, directions = camera.rays(pixels)
            local = 2 * (origins - centre) / side_m
            outside = float(np.max(np.abs(local)))
            if outside >= 1:
                raise ValueError(
                    f"the camera stands {outside * side_m / 2:.3g} m off the room's centre, but the walls are"
                    f" {side_m / 2:.3g} m away: give a larger room, or no room"
                )
            total += _seen(local, directions, walls)
    return total.reshape(camera.height, camera.width, 3) * (radiance / _SAMPLES**2)


def _walls(seed: int | list[int]) -> tuple[Floats, Floats, Floats]:
    """Of six walls their colours (6, 3), and the rectangles' edges (6, k, 4) and colours (6, k, 3)."""
    rng = np.random.default_rng(seed)
    plain = rng.uniform(0.3, 1.0, (6, 1)) * rng.uniform(0.8, 1.2, (6, 3))
    middles = rng.uniform(-0.9, 0.9, (6, _RECTANGLES, 2))
    halves = rng.uniform(*_SIZES, (6, _RECTANGLES, 2))
    # Some shine as windows, some are nearly black.
    colours = 10 ** rng.uniform(-1.3, 0.3, (6, _RECTANGLES, 1)) * rng.uniform(0.6, 1.0, (6, _RECTANGLES, 3))
    return plain, np.concatenate([middles - halves, middles + halves], axis=-1), colours


def _seen(origins: Floats, directions: Floats, walls: tuple[Floats, Floats, Floats]) -> Floats:
    """Radiance (n, 3) where rays from within the cube of half-side 1 meet it."""
    plain, edges, colours = walls
    reached = np.asarray(np.isfinite(directions).all(axis=1))
    toward = np.where(reached[:, None], directions, [0.0, 0.0, 1.0])
    with np.errstate(divide="ignore"):
        distances = (np.sign(toward) - origins) / toward
    # A ray along a wall never meets it: 0 / 0.
    distances = np.where(toward == 0, np.inf, distances)
    axis = distances.argmin(axis=1)
    rows = np.arange(len(axis))
    hit = origins + distances[rows, axis][:, None] * toward
    wall = 2 * axis + (toward[rows, axis] > 0)
    u, v = hit[rows, (axis + 1) % 3], hit[rows, (axis + 2) % 3]
    stripes = 1 + 0.15 * (-1.0) ** np.floor((u + 1) * _STRIPES / 2)
    result = plain[wall] * stripes[:, None]
    for number in range(edges.shape[1]):
        low_u, low_v, high_u, high_v = edges[wall, number].T
        inside = (u > low_u) & (u < high_u) & (v > low_v) & (v < high_v)
        result = np.where(inside[:, None], colours[wall, number], result)
    return np.where(reached[:, None], result, 0.0)
