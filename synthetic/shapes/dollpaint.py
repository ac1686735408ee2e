"""The turned doll's paint: texture maps of its reflectance, in centimetres on its surface."""

from __future__ import annotations

from collections.abc import Iterator
from itertools import chain

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import map_coordinates

from synthetic.shapes.doll import FOOT, heights_at, radii

Floats = NDArray[np.float64]

_CENTIMETRE = 0.01
# The piece of wood is always the same.
_WOOD_SEED = 20
_NOISE_PERIOD = 32
# Paint ends over this, centimetres, or over a texel where that is larger; the profile is so many long.
_PAINT_EDGE = 0.02
_PROFILE_LENGTH = 16.4

_Finish = tuple[tuple[float, float, float], float]

# Albedo (linear RGB) and specular reflectance of each finish; at most 0.8 and 0.06.
_EARLY_WOOD, _LATE_WOOD, _BARE_GLOSS = (0.66, 0.47, 0.27), (0.47, 0.29, 0.14), 0.01
_VARNISH_GLOSS = 0.035
_FACE = (0.78, 0.6, 0.45), 0.022
_HAIR = (0.018, 0.015, 0.015), 0.055
_KIMONO = (0.45, 0.03, 0.025), 0.05
_BELT = (0.03, 0.06, 0.2), 0.045
_CREAM = (0.8, 0.75, 0.62), 0.03
_GOLD = (0.55, 0.34, 0.06), 0.06
_FOOT_PAINT = (0.03, 0.03, 0.035), 0.06
_BLOSSOM = (0.8, 0.62, 0.62), 0.03
_BROWN = (0.3, 0.15, 0.08), 0.022
_LIPS = (0.5, 0.05, 0.05), 0.04
# Azimuth (degrees from the face), height and size (centimetres) of the blossoms.
_BLOSSOMS = (
    (15, -3.1, 0.5),
    (-40, -3.9, 0.62),
    (70, -4.1, 0.55),
    (125, -3.2, 0.6),
    (-105, -3.1, 0.48),
    (180, -4.0, 0.6),
    (-150, -0.5, 0.5),
    (120, -0.4, 0.45),
    (60, -0.75, 0.35),
)


def doll_textures(height: int) -> tuple[NDArray[np.float32], NDArray[np.float32]]:
    """Diffuse and specular reflectance of the doll, kd and ks (height, height, 3) float32, linear RGB.

    Row 0 is at v = 1, as in image files; texels are sampled at their centres. kd : BRDF, 1/sr, the albedo
    pi kd being at most 0.8. ks : share of light that the varnish reflects, 0.005 to 0.06.
    """
    if height < 1:
        raise ValueError(f"the texture's height is {height}; it must be at least 1")
    centres = (np.arange(height) + 0.5) / height
    azimuth = (2 * np.pi * centres - np.pi)[None, :]
    level = heights_at(1 - centres)[:, None]
    radius = radii(level) / _CENTIMETRE
    x, y = radius * np.cos(azimuth), radius * np.sin(azimuth)
    place = np.stack([x, y, np.broadcast_to(level / _CENTIMETRE, x.shape)])
    noise = np.random.default_rng(_WOOD_SEED).uniform(size=(_NOISE_PERIOD,) * 3)
    albedo, gloss = _wood(place, noise)
    # Centimetres around the doll from the middle of its face, and up.
    across, up = radius * azimuth, np.broadcast_to(level / _CENTIMETRE, x.shape)
    edge = max(_PAINT_EDGE, _PROFILE_LENGTH / height)
    for finish, distance in chain(_dress(across, up, radius), _head(across, up)):
        cover = np.clip(0.5 - distance / edge, 0, 1)
        on = cover > 0
        albedo[on] += cover[on][:, None] * (np.array(finish[0]) - albedo[on])
        gloss[on] += cover[on] * (finish[1] - gloss[on])
    # Hands have worn the varnish in places, and time has dulled the paint.
    worn = np.clip((_smooth_noise(noise, place * 0.9) - 0.5) / 0.2, 0, 1)
    gloss *= 1 - 0.4 * worn
    albedo *= (0.93 + 0.07 * _smooth_noise(noise, place * 2 + 11))[..., None]
    kd = (albedo / np.pi).astype(np.float32)
    return kd, np.repeat(gloss[..., None], 3, axis=2).astype(np.float32)


def _wood(place: Floats, noise: Floats) -> tuple[Floats, Floats]:
    """Albedo (h, w, 3) and gloss (h, w) of varnished wood: the year rings of a trunk whose pith is aside."""
    x, y, z = place
    wander = _smooth_noise(noise, place * np.array([0.5, 0.5, 0.12])[:, None, None])
    ring = 3.2 * np.hypot(x + 2.6 + 0.06 * z, y - 1.1) + 2.5 * wander
    late = (ring % 1) ** 3
    fibre = _smooth_noise(noise, place * np.array([9.0, 9.0, 0.8])[:, None, None])
    late = np.clip(0.85 * late + 0.3 * (fibre - 0.5), 0, 1)[..., None]
    albedo = np.array(_EARLY_WOOD) * (1 - late) + np.array(_LATE_WOOD) * late
    bottom = np.clip((FOOT / _CENTIMETRE + 0.15 - z) / 0.05, 0, 1)
    return albedo, _VARNISH_GLOSS + bottom * (_BARE_GLOSS - _VARNISH_GLOSS)


def _dress(across: Floats, up: Floats, radius: Floats) -> Iterator[tuple[_Finish, Floats]]:
    """Layers of paint below the neck, first to last: finish, and distance to its border, negative inside."""
    yield _KIMONO, _band(up, -2.5, 0.78)
    turn = np.pi * radius
    for degrees, height, size in _BLOSSOMS:
        aside = (across - np.radians(degrees) * radius + turn) % (2 * turn) - turn
        away, angle = np.hypot(aside, up - height), np.arctan2(up - height, aside)
        petals = _KIMONO if height < -2.5 else _BLOSSOM
        yield petals, away - size * (0.45 + 0.55 * np.sqrt(np.abs(np.cos(2.5 * angle))))
        yield _GOLD, away - 0.22 * size
    yield _BELT, _band(up, -2.5, -1.5)
    for low, high in ((-2.5, -2.38), (-2.04, -1.96), (-1.62, -1.5)):
        yield _GOLD, _band(up, low, high)
    # The collar: bare skin in a V, cream cloth along it and around the neck.
    skin = np.maximum(1.6 * np.abs(across) - 0.85 - up, -1.5 - up) / 1.9
    yield _CREAM, np.maximum(skin - 0.26, up - 0.78)
    yield _FACE, np.maximum(skin, up - 0.78)
    yield _CREAM, np.maximum(_band(up, 0.6, 0.82), -skin)
    yield _FOOT_PAINT, np.maximum(up + 5.25, FOOT / _CENTIMETRE + 0.12 - up)
    yield _GOLD, _band(up, -5.25, -5.05)


def _head(across: Floats, up: Floats) -> Iterator[tuple[_Finish, Floats]]:
    """Layers of paint above the neck."""
    head, aside = 1.75 - up, np.abs(across)
    yield _FACE, head
    face = (np.hypot(across / 1.75, (up - 3.25) / 1.6) - 1) * 1.6
    yield _HAIR, np.maximum(np.maximum(head, -face), 2.15 - up)
    yield _HAIR, np.maximum(4.3 + 0.1 * np.cos(9 * across) - 0.1 * across**2 - up, head)
    # Eyes: lid, iris and brow.
    yield _HAIR, np.maximum(np.abs(np.hypot(aside - 0.72, up - 2.95) - 0.55) - 0.045, 3.28 - up)
    yield _HAIR, np.hypot(aside - 0.72, up - 3.33) - 0.15
    yield _HAIR, np.maximum(np.abs(np.hypot(aside - 0.75, up - 2.9) - 1.0) - 0.03, 3.72 - up)
    yield _BROWN, np.maximum(np.abs(np.hypot(across, up - 3.0) - 0.13) - 0.025, up - 2.95)
    yield _LIPS, 0.12 * (np.hypot(across / 0.3, (up - 2.5) / 0.12) - 1)


def _band(up: Floats, low: float, high: float) -> Floats:
    return np.abs(up - (low + high) / 2) - (high - low) / 2


def _smooth_noise(noise: Floats, place: Floats) -> Floats:
    """Periodic noise between the lattice's random values, mostly 0.2 to 0.8."""
    # The spline overshoots a little.
    return np.clip(map_coordinates(noise, place, order=2, mode="grid-wrap"), 0, 1)
