"""What all pixels share, found with the normals and Kd of some of them.

Each pixel's five numbers are eliminated from the normal equations [Schur's complement], so that the step of the shared
numbers allows for what normals would do.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from invrender.brdf.microfacet import SIGMA_RANGE
from invrender.brdf.richer import NUMBER_RANGE
from invrender.photometric_stereo.pixels import damped, pixel_equations, shortened
from invrender.photometric_stereo.shading import SharedReflection, linearised
from invrender.photometric_stereo.stack import PixelStack, PixelSurface
from invrender.photometric_stereo.weights import robust_weights, scales

Floats = NDArray[np.float64]
# Between which the shared numbers are sought, by name.
RANGES = {"ambient": (0.0, 0.5), "bounce": (0.0, 20.0), "sigma": SIGMA_RANGE, **NUMBER_RANGE}
# A step changes a number by at most this share of it or of its range; a gain below a share of the loss ends a search.
_BOLDEST, _ENOUGH = 0.3, 1e-4
_DAMPING, _RISE, _MOST_DAMPING = 1e-2, 10.0, 1e5


@dataclass(frozen=True, eq=False)
class JointEquations:
    """Normal equations of a step, pixels' numbers eliminated.

    matrix, right : (g, g), (g,) of the shared numbers and Ks. by_photo : (j, g), the right side photograph by
    photograph. answer : (p, 5, g), how pixels' numbers answer to the shared ones; own : (p, 5), their step alone.
    """

    matrix: Floats
    right: Floats
    by_photo: Floats
    answer: Floats
    own: Floats


def joint_equations(
    reflection: SharedReflection,
    surface: PixelSurface,
    stack: PixelStack,
    squares: Floats,
    damping: float,
    turning: bool = True,
) -> JointEquations:
    """The equations about a state; squares : squared scales (p, j); damping : of the pixels' numbers."""
    about = linearised(reflection, surface, stack, turning, with_shared=True)
    assert about.shared is not None
    weights, _ = robust_weights(stack, about.predicted, squares)
    matrix, right = pixel_equations(about, stack, weights)
    weighted = weights[..., None, None] * about.shared
    with_turns = np.einsum("pjca,pjcg->pag", about.turns, weighted, optimize=True)
    with_kd = np.einsum("pj,pjcg->pcg", about.base, weighted, optimize=True)
    coupling = np.concatenate([with_turns, with_kd], axis=1)
    solved = np.linalg.solve(damped(matrix, damping), np.concatenate([coupling, right[..., None]], axis=2))
    answer, own = solved[..., :-1], solved[..., -1]
    # What is left of a shared number's derivative once the pixels' numbers have answered to it.
    left = weighted - weights[..., None, None] * (
        np.einsum("pjca,pag->pjcg", about.turns, answer[:, :2], optimize=True)
        + about.base[..., None, None] * answer[:, None, 2:]
    )
    residuals = stack.reflected - about.predicted
    by_photo = np.einsum("pjcg,pjc->jg", left, residuals, optimize=True)
    own_matrix = np.einsum("pjcg,pjch->gh", left, about.shared, optimize=True)
    return JointEquations((own_matrix + own_matrix.T) / 2, by_photo.sum(axis=0), by_photo, -answer, own)


def fit_shared(
    reflection: SharedReflection,
    surface: PixelSurface,
    stack: PixelStack,
    floor: float,
    steps: int,
    turning: bool = True,
) -> tuple[SharedReflection, PixelSurface]:
    """What all pixels share, and the pixels' own numbers, from a start; arguments as of `pixels.solve_pixels`."""
    squares = scales(stack, reflection.predicted(surface, stack), floor)
    damping = _DAMPING

    def loss_of(reflection: SharedReflection, surface: PixelSurface) -> float:
        return float(robust_weights(stack, reflection.predicted(surface, stack), squares)[1].sum())

    loss = loss_of(reflection, surface)
    for _ in range(steps):
        while True:
            equations = joint_equations(reflection, surface, stack, squares, damping, turning)
            diagonal = np.diag(equations.matrix).clip(0)
            raised = damping * diagonal + _ENOUGH**2 * diagonal.max() + 1e-30
            step = np.asarray(np.linalg.solve(equations.matrix + np.diag(raised), equations.right), float)
            tried = moved(reflection, step)
            pixels = surface.moved(shortened(equations.own + equations.answer @ step), stack.views)
            after = loss_of(tried, pixels)
            if after < loss:
                break
            damping *= _RISE
            if damping > _MOST_DAMPING:
                return reflection, surface
        gain, loss, reflection, surface = loss - after, after, tried, pixels
        damping /= _RISE
        if gain < _ENOUGH * loss:
            break
    return reflection, surface


def moved(reflection: SharedReflection, step: Floats) -> SharedReflection:
    """The reflection after a step (n + 3,) of its numbers and Ks, within `RANGES`."""
    numbers = {}
    for (name, value), change in zip(reflection.numbers.items(), step, strict=False):
        low, high = RANGES[name]
        longest = _BOLDEST * max(abs(value), 0.1 * (high - low))
        numbers[name] = float(np.clip(value + np.clip(change, -longest, longest), low, high))
    return replace(reflection.with_numbers(numbers), ks=np.maximum(reflection.ks + step[-3:], 1e-6))
