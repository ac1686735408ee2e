"""How uncertain a fit is, read off how parts of its data disagree with it."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import brentq
from scipy.special import ndtri, stdtrit

Floats = NDArray[np.float64]


def jackknife(curvatures: Floats, gradients: Floats, arcs: NDArray[np.int64]) -> Floats:
    """Covariance of a fit from what leaving out one arc after the other changes, to first order.

    curvatures : (n, p), whose square is the cost's Hessian. gradients : (n, p) of the cost. arcs : (n,), in any order.
    """
    order = np.argsort(arcs, kind="stable")
    curvatures, gradients = curvatures[order], gradients[order]
    starts = np.flatnonzero(np.diff(arcs[order], prepend=-1))
    total = curvatures.T @ curvatures
    parts = np.add.reduceat(curvatures[:, :, None] * curvatures[:, None, :], starts, axis=0)
    pushes = np.add.reduceat(gradients, starts, axis=0)
    without = np.linalg.pinv(total - parts, rcond=1e-9, hermitian=True)
    changes = (without @ pushes[:, :, None])[:, :, 0]
    return np.asarray((1 - 1 / len(starts)) * changes.T @ changes)


def common_spread(moves: Floats, variances: Floats, fitted: int) -> float:
    """Variance, in pixels^2, of what moves or scales whole outlines beyond their own uncertainty: errors of poses.

    moves : (k, m) by which each photo alone would change the sphere in its picture. variances : (k, m, m) of them.
    fitted : how many parameters they have decided. The value with which chi^2 is as it should be (R. C. Paule and
    J. Mandel, J. Res. Natl. Bur. Stand. 87 (1982) 377), widened by Student's t: few photos determine it badly.
    """
    freedom = moves.size - fitted
    if len(moves) < 2 or freedom < 1:
        return 0.0

    def excess(spread: float) -> float:
        inverse = np.linalg.pinv(variances + spread * np.eye(moves.shape[1]), hermitian=True)
        return float(np.einsum("ki,kij,kj->", moves, inverse, moves)) - freedom

    if excess(0.0) <= 0:
        return 0.0
    highest = float((moves**2).sum())  # there chi^2 is less than 1
    widened = stdtrit(freedom, 0.975) / ndtri(0.975)
    return float(brentq(excess, 0.0, highest) * widened**2)
