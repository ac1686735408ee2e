"""Damped Gauss-Newton steps on any state, until a step promises less than matters beside the noise.

K. Levenberg, "A method for the solution of certain non-linear problems in least squares", 1944; D. Marquardt, "An
algorithm for least-squares estimation of nonlinear parameters", 1963. Where a plain residual function suffices,
scipy.optimize.least_squares serves.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Generic, TypeVar

import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.float64]
State = TypeVar("State")
_RISE, _LEAST_DAMPING = 10.0, 1e-9


@dataclass(frozen=True, eq=False)
class LocalProblem(Generic[State]):
    """A least-squares problem about a state. Its cost is the squared residuals in variances of the noise.

    step : the Gauss-Newton step (n,) under a damping, the share by which the normal matrix's diagonal is raised.
    pull : (n,), half the negative gradient of the cost; a step promises its product with it. moved : the state after a
    step. gain : by how much the cost is lower at another state than here.
    """

    step: Callable[[float], Floats]
    pull: Floats
    moved: Callable[[Floats], State]
    gain: Callable[[State], float]


def damped_step(matrix: Floats, right: Floats, damping: float) -> Floats:
    """The step (n,) of normal equations whose diagonal is raised by a share of it; 0 where the diagonal is 0."""
    diagonal = np.diag(matrix)
    used = diagonal > 0
    raised = matrix + np.diag(np.where(used, damping * diagonal, 1.0))
    return np.where(used, np.linalg.solve(raised, np.where(used, right, 0.0)), 0.0)


def gauss_newton(
    state: State,
    about: Callable[[State], LocalProblem[State]],
    least: float,
    most_steps: int,
    damping: float = 1e-3,
    told_apart: float = 0.0,
) -> State:
    """The state of least cost near a given one.

    about : the problem about a state. least : a promise or a gain below this ends the search, in variances of the
    noise: parameters are then within its square root of their standard deviations. damping : the first step's.
    told_apart : costs closer than this can't be compared, so that a failed step which promised less is the last one.
    """
    for _ in range(most_steps):
        here = about(state)
        while True:
            step = here.step(damping)
            promise = float(step @ here.pull)
            if not promise >= least:
                return state
            tried = here.moved(step)
            gain = here.gain(tried)
            if gain >= 0 or promise < told_apart:
                break
            damping *= _RISE
        if gain > 0:
            state = tried
        if gain < least:
            break
        damping = max(damping / _RISE, _LEAST_DAMPING)
    return state
