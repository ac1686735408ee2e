"""Better starts from neighbours: a pixel's normal may explain the next pixel, too.

Where shadows or highlights led a pixel's search to a wrong normal, its neighbours' often lead it to the right one
[PatchMatch: Barnes et al. 2009, on propagation].
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from capture.progress import Track, silent
from invrender.photometric_stereo.pixels import pixel_blocks, solve_pixels
from invrender.photometric_stereo.shading import SharedReflection
from invrender.photometric_stereo.stack import PixelStack, PixelSurface
from invrender.photometric_stereo.weights import pixel_losses

Ints = NDArray[np.int64]
# How far away neighbours are, round by round, in pixels; normals nearer than this (its cosine) are the same start.
_REACH = (1, 2, 4)
_ALIKE = float(np.cos(np.radians(3)))
# By how much a pixel's loss must fall, in samples that fit, for another normal to be taken.
_BETTER = 0.02
# The loss of a photograph on average up to which a pixel fits.
_FITS = 0.05
# Steps of Kd alone, and of a whole search.
_KD_STEPS, _STEPS = 2, 10


def with_neighbours_starts(
    reflection: SharedReflection,
    surface: PixelSurface,
    stack: PixelStack,
    floor: float,
    inside: NDArray[np.bool_],
    rounds: int,
    track: Track = silent,
) -> PixelSurface:
    """The surface with each pixel solved from its neighbours' normals as well, where that explains it better.

    inside : (h, w), the pixels, in the stack's order. rounds : with neighbours 1, 2 and 4 pixels away in turns.
    """
    place = np.full(inside.shape, -1)
    place[inside] = np.arange(len(stack))
    normals, kd = surface.normals.copy(), surface.kd.copy()
    shifts = [(reach * down, reach * along) for reach in _REACH[:rounds] for down, along in _SIDES]
    for shift in track(shifts, "Trying neighbours' normals"):
        neighbour = _shifted(place, shift)[inside]
        pixels = np.flatnonzero(neighbour >= 0)
        offered = normals[neighbour[pixels]]
        other = np.einsum("pk,pk->p", normals[pixels], offered) < _ALIKE
        pixels, offered = pixels[other], offered[other]
        if not len(pixels):
            continue
        before = _losses(reflection, PixelSurface(normals[pixels], kd[pixels]), stack.at(pixels), floor)
        # What fits all photographs needs no better start.
        bad = before > _FITS * stack.photos
        pixels, offered, before = pixels[bad], offered[bad], before[bad]
        if not len(pixels):
            continue
        own = stack.at(pixels)
        # Kd alone first: it says at once whether a normal is worth a search.
        tried = solve_pixels(
            reflection, PixelSurface(offered, kd[pixels]), own, floor, _KD_STEPS, turning=False
        )
        worth = np.flatnonzero(_losses(reflection, tried, own, floor) < before - _BETTER)
        if not len(worth):
            continue
        solved = solve_pixels(reflection, tried.at(worth), own.at(worth), floor, _STEPS)
        better = _losses(reflection, solved, own.at(worth), floor) < before[worth] - _BETTER
        taken = pixels[worth[better]]
        normals[taken], kd[taken] = solved.normals[better], solved.kd[better]
    return PixelSurface(normals, kd)


_SIDES = ((0, 1), (1, 0), (0, -1), (-1, 0))


def _shifted(place: Ints, shift: tuple[int, int]) -> Ints:
    """Numbers of the pixels that lie so many rows and columns away, -1 where none does."""
    reach = max(map(abs, shift))
    wide = np.pad(place, reach, constant_values=-1)
    height, width = place.shape
    down, along = reach + shift[0], reach + shift[1]
    return wide[down : down + height, along : along + width]


def _losses(
    reflection: SharedReflection, surface: PixelSurface, stack: PixelStack, floor: float
) -> NDArray[np.float64]:
    return np.concatenate(
        [
            pixel_losses(reflection.predicted(surface.at(block), stack.at(block)), stack.at(block), floor)
            for block in pixel_blocks(len(stack))
        ]
    )
