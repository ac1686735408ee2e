"""Standard deviations: what leaving out lamps changes, what noise does, and what is off that all pixels share.

Residuals of shadows, bounces and of a lobe that is nearly right are alike for lamps side by side, and differ from side
to side. So the jackknife leaves out a group of neighbouring lamps at a time; it counts all causes without knowing
their size [Tukey 1958; Kott, "The delete-a-group jackknife", 2001]. Few lamps leave small residuals whatever is wrong:
what the photographs' noise implies is the least that a bar can be.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from scipy.cluster.vq import kmeans2

from capture.parallel import one_blas_thread, parallel_map
from capture.progress import Track, silent
from invrender.photometric_stereo.joint import joint_equations
from invrender.photometric_stereo.pixels import pixel_blocks, pixel_equations
from invrender.photometric_stereo.shading import LinearisedShading, SharedReflection, linearised
from invrender.photometric_stereo.stack import PixelStack, PixelSurface, tangents
from invrender.photometric_stereo.weights import robust_weights, scales

Floats = NDArray[np.float64]
# Of pixels whose photographs determine no normal: as far off as a normal that faces the camera can be, degrees.
WIDEST_DEG = 90.0
# Groups of lamps, where there are enough of them.
_GROUPS = 6
# Of a normal matrix's diagonal, so that it has an inverse; and by how much lamps are turned for derivatives, radians.
_RIDGE, _TURN = 1e-6, 1e-5


@dataclass(frozen=True, eq=False)
class Deviations:
    """Standard deviations of pixels: normal_deg (p,), RMS angle to the true normal, and kd (p, 3), 1/sr."""

    normal_deg: Floats
    kd: Floats

    def widened(self, normal_deg: Floats) -> Deviations:
        """The same with something more (p,) that normals may be off, degrees."""
        return Deviations(np.minimum(np.hypot(self.normal_deg, normal_deg), WIDEST_DEG), self.kd)


def shared_covariance(
    reflection: SharedReflection, surface: PixelSurface, stack: PixelStack, floor: float, turning: bool = True
) -> Floats:
    """Covariance (g, g) of the shared numbers and Ks by how photographs disagree; those that nothing moves have 0."""
    squares = scales(stack, reflection.predicted(surface, stack), floor)
    equations = joint_equations(reflection, surface, stack, squares, 1e-6, turning)
    used = np.diag(equations.matrix) > 0
    covariance = np.zeros_like(equations.matrix)
    if not used.any():
        return covariance
    matrix = equations.matrix[np.ix_(used, used)]
    scale = 1 / np.sqrt(np.diag(matrix))
    inverse = np.linalg.pinv(matrix * scale * scale[:, None], rcond=1e-9) * scale * scale[:, None]
    pulls = equations.by_photo[:, used] @ inverse
    photos = len(pulls)
    covariance[np.ix_(used, used)] = pulls.T @ pulls * photos / max(photos - used.sum(), 1)
    return covariance


def deviations(
    reflection: SharedReflection,
    surface: PixelSurface,
    stack: PixelStack,
    floor: float,
    shared: Floats,
    lamp_std: float = 0.0,
    turning: bool = True,
    track: Track = silent,
) -> Deviations:
    """Standard deviations of all pixels.

    shared : of `shared_covariance`. lamp_std : radians, of each lamp's direction, either way across.
    """
    groups = lamp_groups(stack.lamps.mean(axis=0))

    def of_block(block: slice) -> Deviations:
        return _block(
            reflection, surface.at(block), stack.at(block), floor, shared, lamp_std, turning, groups
        )

    with one_blas_thread():
        parts = list(parallel_map(of_block, track(list(pixel_blocks(len(stack))), "Computing error bars")))
    return Deviations(
        np.concatenate([part.normal_deg for part in parts]), np.concatenate([part.kd for part in parts])
    )


def lamp_groups(lamps: Floats) -> NDArray[np.int64]:
    """The group (j,) of each lamp (j, 3): of neighbours, two or more each; a group of its own where there are few."""
    count = min(_GROUPS, len(lamps) // 2)
    if count < 3:
        return np.arange(len(lamps))
    _, found = kmeans2(lamps, count, minit="++", rng=0)
    return np.asarray(np.unique(found, return_inverse=True)[1], np.int64)


def _block(
    reflection: SharedReflection,
    surface: PixelSurface,
    stack: PixelStack,
    floor: float,
    shared: Floats,
    lamp_std: float,
    turning: bool,
    groups: NDArray[np.int64],
) -> Deviations:
    predicted = reflection.predicted(surface, stack)
    squares = scales(stack, predicted, floor)
    about = linearised(reflection, surface, stack, turning)
    weights, _ = robust_weights(stack, predicted, squares)
    matrix, _ = pixel_equations(about, stack, weights)
    # (p, j, 5, 5) and (p, j, 5): each photograph's part.
    own, pull = _by_photo(about.turns, about.base, stack.reflected - predicted, weights)
    member = np.eye(groups.max() + 1)[groups]
    own, pull = np.einsum("pjab,jk->pkab", own, member, optimize=True), np.einsum("pja,jk->pka", pull, member)
    ridge = (_RIDGE * np.einsum("paa->pa", matrix) + 1e-30)[:, :, None] * np.eye(5)
    changes = np.linalg.solve(matrix[:, None] - own + ridge[:, None], pull[..., None])[..., 0]
    count = member.shape[1]
    variance = (changes**2).sum(axis=1) * (count - 1) / count
    inverse = np.linalg.inv(matrix + ridge)
    noise, _ = pixel_equations(about, stack, weights**2 * stack.variance)
    variance = np.maximum(variance, np.einsum("pab,pbc,pac->pa", inverse, noise, inverse, optimize=True))
    if lamp_std:
        variance += lamp_std**2 * _turned_lamps(reflection, surface, stack, about, weights, inverse)
    equations = joint_equations(reflection, surface, stack, squares, 1e-6, turning)
    variance += np.einsum("pag,gh,pah->pa", equations.answer, shared, equations.answer, optimize=True)
    degrees = np.degrees(np.sqrt(variance[:, :2].sum(axis=1)))
    if turning:
        # A black pixel looks the same whichever way it faces.
        degrees = np.where(np.einsum("paa->p", matrix[:, :2, :2]) > 0, degrees, WIDEST_DEG)
    return Deviations(np.minimum(degrees, WIDEST_DEG), np.sqrt(variance[:, 2:]))


def _turned_lamps(
    reflection: SharedReflection,
    surface: PixelSurface,
    stack: PixelStack,
    about: LinearisedShading,
    weights: Floats,
    inverse: Floats,
) -> Floats:
    """What a radian of each lamp's direction, either way across, adds to the variances (p, 5)."""
    total = np.zeros(inverse.shape[:2])
    flat = stack.lamps.reshape(-1, 3)
    for across in tangents(flat):
        turned = replace(stack, lamps=(flat + _TURN * across).reshape(stack.lamps.shape))
        change = (reflection.predicted(surface, turned) - about.predicted) / _TURN
        _, pull = _by_photo(about.turns, about.base, change, weights)
        total += (np.einsum("pab,pjb->pja", inverse, pull, optimize=True) ** 2).sum(axis=1)
    return total


def _by_photo(turns: Floats, base: Floats, residuals: Floats, weights: Floats) -> tuple[Floats, Floats]:
    """Parts of a pixel's normal matrix (p, j, 5, 5) and right side (p, j, 5) of each photograph."""
    weighted = weights[..., None, None] * turns
    matrix = np.zeros((*base.shape, 5, 5))
    matrix[..., :2, :2] = np.einsum("pjca,pjcb->pjab", weighted, turns)
    mixed = (weighted * base[..., None, None]).transpose(0, 1, 3, 2)
    matrix[..., :2, 2:], matrix[..., 2:, :2] = mixed, mixed.transpose(0, 1, 3, 2)
    matrix[..., (2, 3, 4), (2, 3, 4)] = (weights * base**2)[..., None]
    right = np.zeros((*base.shape, 5))
    right[..., :2] = np.einsum("pjca,pjc->pja", weighted, residuals)
    right[..., 2:] = (weights * base)[..., None] * residuals
    return matrix, right
