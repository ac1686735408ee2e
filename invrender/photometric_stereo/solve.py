"""Photometric stereo, whole: from a stack of pixels to normals, albedo and the shared lobe, with error bars."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from capture.progress import Track, silent
from invrender.photometric_stereo.models import (
    StereoModel,
    choose_form,
    compare_forms,
    first_reflection,
    fit_renewed,
)
from invrender.photometric_stereo.neighbours import with_neighbours_starts
from invrender.photometric_stereo.pixels import solve_pixels
from invrender.photometric_stereo.shading import SharedReflection
from invrender.photometric_stereo.stack import PixelStack, PixelSurface
from invrender.photometric_stereo.start import least_squares
from invrender.photometric_stereo.uncertainty import Deviations, deviations, shared_covariance
from invrender.photometric_stereo.weights import floor_of

Floats = NDArray[np.float64]
# Gives the stack as it is once the surface is known: near lamps from where each pixel lies, light that bounces. None
# where the surface changes nothing.
Surroundings = Callable[[PixelSurface], PixelStack | None]
# Pixels that the shared numbers are fitted to, and that forms are compared on.
_SHARED_PIXELS, _COMPARED_PIXELS = 1500, 400
# Steps of a search from afar, and from a surface that was nearly right.
_STEPS, _FEW_STEPS = 10, 4
# The surface and its surroundings are found in turns: at most so many, until normals turn by less on average, degrees.
_MOST_ROUNDS, _SETTLED_DEG = 6, 0.08
# Other forms' normals are compared at one pixel of so many in each row and column.
_SPREAD_STEP = 3


@dataclass(frozen=True, eq=False)
class SolvedSurface:
    """What photographs under many lamps say.

    least, robust : normals (p, 3) by least squares, and by robust least squares, Lambertian both. model : the chosen
    one; models : all that were compared. covariance : (g, g) of the shared numbers and Ks.
    """

    surface: PixelSurface
    deviations: Deviations
    reflection: SharedReflection
    covariance: Floats
    model: StereoModel
    models: Sequence[StereoModel]
    least: Floats
    robust: Floats
    stack: PixelStack


def solve_stereo(
    stack: PixelStack,
    inside: NDArray[np.bool_],
    surroundings: Surroundings,
    normals: Floats | None = None,
    lamp_std: float = 0.0,
    track: Track = silent,
) -> SolvedSurface:
    """Solve a stack; inside : (h, w), its pixels; normals : (p, 3), where they are known, else sought.

    lamp_std : radians, by which lamps' directions may be off, either way across.
    """
    turning, floor = normals is None, floor_of(stack)
    least = least_squares(stack)
    start = least if normals is None else PixelSurface(normals, least.kd)
    robust = solve_pixels(
        first_reflection(None), start, stack, floor, _STEPS, turning, track, "Robust least squares"
    )
    rng = np.random.default_rng(0)
    order = rng.permutation(len(stack))
    few = np.sort(order[:_COMPARED_PIXELS])
    models = compare_forms(robust.at(few), stack.at(few), floor, turning, track)
    chosen, others = choose_form(models)
    some = np.sort(order[:_SHARED_PIXELS])
    reflection, surface, unbounced = chosen.reflection, robust, None
    for turn in range(_MOST_ROUNDS):
        reflection, _ = fit_renewed(reflection, surface.at(some), stack.at(some), floor, turning)
        steps = _FEW_STEPS if turn else _STEPS
        found = solve_pixels(reflection, surface, stack, floor, steps, turning, track, "Solving pixels")
        if turning:
            found = with_neighbours_starts(
                reflection, found, stack, floor, inside, 2 if turn < 2 else 1, track
            )
        moved = float(np.degrees(angles(found.normals, surface.normals)).mean())
        surface = found
        unbounced = unbounced or surface
        if turn and moved < _SETTLED_DEG:
            break
        around = surroundings(surface)
        if around is None:
            break
        if stack.bounced is None and around.bounced is not None:
            reflection = replace(reflection, bounce=1.0)
        stack = around
    covariance = shared_covariance(reflection, surface.at(some), stack.at(some), floor, turning)
    own = deviations(reflection, surface, stack, floor, covariance, lamp_std, turning, track)
    if turning:
        assert unbounced is not None
        # Shadows and further bounces aren't in it: all that light that bounces did may be off.
        off = angles(surface.normals, unbounced.normals)
        spread = _spread(others, surface, stack, floor, inside, few, track)
        own = own.widened(np.degrees(np.hypot(off, spread)))
    return SolvedSurface(
        surface, own, reflection, covariance, chosen, models, least.normals, robust.normals, stack
    )


def angles(one: Floats, other: Floats) -> Floats:
    """Angles (p,) between unit vectors (p, 3), radians."""
    return np.asarray(2 * np.arcsin(np.clip(np.linalg.norm(one - other, axis=1) / 2, 0, 1)))


def _spread(
    others: Sequence[StereoModel],
    surface: PixelSurface,
    stack: PixelStack,
    floor: float,
    inside: NDArray[np.bool_],
    some: NDArray[np.int64],
    track: Track,
) -> Floats:
    """By how much other forms turn the normals of pixels, or of one nearby, radians (p,): the one that turns it most.

    Some of them are nearly the same, so that a mean over forms says less than any of them.
    """
    if not others:
        return np.zeros(len(surface))
    places = np.argwhere(inside)
    few = np.flatnonzero((places % _SPREAD_STEP == 0).all(axis=1))
    few = few if len(few) else np.arange(len(places))
    farthest = np.zeros(len(few))
    for model in track(others, "Comparing with other lobes"):
        first = replace(model.reflection, bounce=0.0 if stack.bounced is None else 1.0)
        reflection, _ = fit_renewed(first, surface.at(some), stack.at(some), floor, True)
        solved = solve_pixels(reflection, surface.at(few), stack.at(few), floor, _FEW_STEPS)
        farthest = np.maximum(farthest, angles(solved.normals, surface.normals[few]))
    nearest = cKDTree(places[few]).query(places)[1]
    return np.asarray(farthest[nearest])
