"""How sure the poses of an adjusted bundle are, and in what frame that holds.

What no picture shows, the world's seven similarities, is fixed by inner constraints (Triggs et al. 1999, "Bundle
adjustment: a modern synthesis", section 9.2): the covariance holds for a frame fitted to the cameras as a whole.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import csr_array

from recon.poses.register.bundle import CAUCHY, Bundle, cauchy_weights, normal_equations, spread
from recon.poses.similarity import cross_matrix

Floats = NDArray[np.float64]
Ints = NDArray[np.int64]

# Pixels within which points' errors may depend on each other: patches overlap, blur and light are shared.
_TOGETHER = 30.0


def pose_covariance(bundle: Bundle) -> Floats:
    """Covariance (6c, 6c) of the poses of an adjusted bundle, in inner constraints.

    Of each photograph a small turn about the camera's centre and axes (radians), then a shift along them. The frame is
    that in which the cameras as a whole neither turn, shift nor grow, radians counting as much as shifts over
    `Bundle.distance`. Errors of one point's observations may depend on each other: what they pull at the poses is
    squared point by point, not observation by observation (a sandwich with points as clusters), and raised by what
    the point and the poses took out of its residuals.
    """
    weights = cauchy_weights(bundle, CAUCHY * spread(bundle))
    system = normal_equations(bundle, weights)
    matrix, _, inverses = system.reduced()
    inverse = _inner_inverse(matrix, bundle)

    pulls = np.einsum("nij,ni,n->nj", bundle.camera_jacobian(), bundle.residuals, weights)
    columns = 6 * bundle.photo[:, None] + np.arange(6)
    rows = np.broadcast_to(bundle.point[:, None], columns.shape)
    shape = (len(bundle.points), len(matrix))
    scores = csr_array((pulls.ravel(), (rows.ravel(), columns.ravel())), shape=shape)
    places = np.arange(3 * len(bundle.points))
    moves = np.einsum("pij,pj->pi", inverses, system.pull)
    scores = scores - csr_array((moves.ravel(), (places // 3, places))) @ system.cross.T
    cells = _cells(bundle)
    seen = np.bincount(bundle.point, minlength=len(bundle.points))
    free = 2 * seen.sum() - 3 * len(bundle.points)
    growth = 1 / (1 - 3 / (2 * seen)) / (1 - min((6 * len(bundle.poses) - 7) / free, 0.9))
    summed = _summed(scores * np.sqrt(growth)[:, None], cells)
    filling = (summed.T @ summed).toarray()
    return np.asarray(inverse @ filling @ inverse)


def frame_changes(poses: Floats) -> Floats:
    """How poses (c, 4, 4) change, (6c, 7), with what no picture shows: the world's turn, shift and scale.

    Rows as in `pose_covariance`. The world's points X become X + turn x X + shift + scale X.
    """
    rotations, shifts = poses[:, :3, :3], poses[:, :3, 3]
    changes = np.zeros((len(poses), 6, 7))
    changes[:, :3, :3] = -rotations
    changes[:, 3:, :3] = -cross_matrix(shifts) @ rotations
    changes[:, 3:, 3:6] = -rotations
    changes[:, 3:, 6] = shifts
    return changes.reshape(-1, 7)


def _cells(bundle: Bundle) -> Ints:
    """Which cell of space, about `_TOGETHER` pixels wide in the pictures, each point (p,) lies in."""
    focal = float(np.median([lens.focal_px for lens in bundle.lenses]))
    side = _TOGETHER * bundle.distance / focal
    return np.unique(np.floor(bundle.points / side).astype(np.int64), axis=0, return_inverse=True)[1].ravel()


def _summed(scores: csr_array, cells: Ints) -> csr_array:
    """Rows (p, k) summed by the cells (p,) they belong to."""
    places = np.arange(len(cells))
    return csr_array((np.ones(len(cells)), (cells, places)), shape=(cells.max() + 1, len(cells))) @ scores


def _inner_inverse(matrix: Floats, bundle: Bundle) -> Floats:
    """The inverse (6c, 6c) of the reduced matrix, its null directions left out by inner constraints."""
    unit = np.tile(np.repeat([1.0, bundle.distance], 3), len(bundle.poses))
    basis, _ = np.linalg.qr(frame_changes(bundle.poses) / unit[:, None])
    scaled = matrix * np.outer(unit, unit)
    stiff = np.trace(scaled) / len(scaled)
    inverse = np.linalg.inv(scaled + stiff * basis @ basis.T) - basis @ basis.T / stiff
    return np.asarray(inverse * np.outer(unit, unit))
