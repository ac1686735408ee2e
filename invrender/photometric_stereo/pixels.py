"""Normals and Kd of pixels under a reflection that all share: damped Gauss-Newton in five numbers each, all at once.

Pixels don't depend on each other, so that blocks of them are solved side by side.
"""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
from numpy.typing import NDArray

from capture.parallel import one_blas_thread, parallel_map
from capture.progress import Track, silent
from invrender.photometric_stereo.shading import LinearisedShading, SharedReflection, linearised
from invrender.photometric_stereo.stack import PixelStack, PixelSurface
from invrender.photometric_stereo.weights import robust_weights, scales

Floats = NDArray[np.float64]
# Pixels that are solved at once: their arrays fit into a core's cache.
BLOCK = 2000
# The longest turn of a normal in one step, radians; a pixel whose loss falls by less than a share is done.
LONGEST_TURN, _ENOUGH = 0.3, 1e-4
_DAMPING, _RISE, _FALL = 1e-3, 8.0, 5.0
# Of the largest diagonal entry: a number that nothing determines stays where it is.
_RIDGE = 1e-9


def pixel_equations(about: LinearisedShading, stack: PixelStack, weights: Floats) -> tuple[Floats, Floats]:
    """Normal matrices (p, 5, 5) and right sides (p, 5) of steps: two turns, three Kd."""
    residuals = stack.reflected - about.predicted
    count = len(residuals)
    matrix, right = np.zeros((count, 5, 5)), np.zeros((count, 5))
    turns = about.turns.reshape(count, -1, 2)
    weighted = (weights[..., None, None] * about.turns).reshape(count, -1, 2)
    matrix[:, :2, :2] = weighted.transpose(0, 2, 1) @ turns
    right[:, :2] = (weighted * residuals.reshape(count, -1, 1)).sum(axis=1)
    mixed = np.einsum("pj,pjca->pac", weights * about.base, about.turns)
    matrix[:, :2, 2:], matrix[:, 2:, :2] = mixed, mixed.transpose(0, 2, 1)
    weighted_base = weights * about.base
    matrix[:, (2, 3, 4), (2, 3, 4)] = (weighted_base * about.base).sum(axis=1)[:, None]
    right[:, 2:] = (weighted_base[..., None] * residuals).sum(axis=1)
    return matrix, right


def damped(matrix: Floats, damping: Floats | float) -> Floats:
    """Normal matrices (p, n, n) with their diagonals raised by a share (p,), so that each has an inverse."""
    diagonal = np.einsum("paa->pa", matrix)
    raised = np.asarray(damping)[..., None] * diagonal + _RIDGE * diagonal.max(axis=1, keepdims=True) + 1e-30
    return np.asarray(matrix + raised[:, :, None] * np.eye(matrix.shape[1]))


def shortened(steps: Floats) -> Floats:
    """Steps (p, 5) whose turns are no longer than the model stays linear."""
    length = np.linalg.norm(steps[:, :2], axis=1, keepdims=True)
    return np.asarray(steps * np.minimum(1, LONGEST_TURN / np.maximum(length, 1e-12)))


def solve_pixels(
    reflection: SharedReflection,
    start: PixelSurface,
    stack: PixelStack,
    floor: float,
    steps: int,
    turning: bool = True,
    track: Track = silent,
    what: str = "Solving pixels",
) -> PixelSurface:
    """Normals and Kd of all pixels, from a start; turning : False holds the normals.

    floor : of `weights.floor_of`. steps : at most. track, what : to show progress by.
    """

    def solved(block: slice) -> PixelSurface:
        return _block(reflection, start.at(block), stack.at(block), floor, steps, turning)

    with one_blas_thread():
        parts = list(parallel_map(solved, track(list(pixel_blocks(len(stack))), what)))
    return PixelSurface(
        np.concatenate([part.normals for part in parts]), np.concatenate([part.kd for part in parts])
    )


def pixel_blocks(count: int) -> Iterator[slice]:
    """Slices of so many pixels, a block each."""
    for first in range(0, count, BLOCK):
        yield slice(first, min(first + BLOCK, count))


def _block(
    reflection: SharedReflection,
    surface: PixelSurface,
    stack: PixelStack,
    floor: float,
    steps: int,
    turning: bool,
) -> PixelSurface:
    squares = scales(stack, reflection.predicted(surface, stack), floor)
    normals, kd, damping = surface.normals.copy(), surface.kd.copy(), np.full(len(surface), _DAMPING)
    left = np.arange(len(surface))
    for _ in range(steps):
        own, here = stack.at(left), PixelSurface(normals[left], kd[left])
        about = linearised(reflection, here, own, turning)
        weights, losses = robust_weights(own, about.predicted, squares[left])
        matrix, right = pixel_equations(about, own, weights)
        step = np.asarray(np.linalg.solve(damped(matrix, damping[left]), right[..., None])[..., 0], float)
        tried = here.moved(shortened(step), own.views)
        loss = losses.sum(axis=1)
        gain = loss - robust_weights(own, reflection.predicted(tried, own), squares[left])[1].sum(axis=1)
        better = gain >= 0
        normals[left[better]], kd[left[better]] = tried.normals[better], tried.kd[better]
        damping[left] = np.where(better, damping[left] / _FALL, damping[left] * _RISE)
        left = left[~better | (gain > _ENOUGH * loss)]
        left = left[damping[left] < 1e3]
        if not len(left):
            break
    return PixelSurface(normals, kd)
