"""Normal equations of a pose's change from residuals that err together in blocks."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from invrender.estimate.linear import symmetric_pinv

Floats = NDArray[np.float64]
Ints = NDArray[np.int64]


@dataclass(frozen=True, eq=False)
class PoseEquations:
    """What residuals say of a change of a pose.

    information : (6, 6). pull : (6,), information @ the step that they ask for. together : 1 or more, by what the
    independent information was divided.
    """

    information: Floats
    pull: Floats
    together: float


def block_equations(
    blocks: Ints, weight: Floats, slopes: Floats, residual: Floats, least: float = 1.0
) -> PoseEquations:
    """Equations of residuals (n,) of weights (n,) and slopes (n, 6) in the change; blocks : (n,) int.

    least : how many count as one whatever they say.

    What a model lacks, a blurred texture's edges or a mask's, is the same over a block: scores are then as much larger
    than noise would make them, and the residuals count for as much less.
    """
    number = np.unique(blocks, return_inverse=True)[1]
    scores = np.zeros((number.max(initial=-1) + 1, 6))
    np.add.at(scores, number, slopes * (weight * residual)[:, None])
    independent = (slopes * weight[:, None]).T @ slopes
    # Undetermined directions don't contribute.
    excess = float(np.trace(symmetric_pinv(independent) @ scores.T @ scores)) / 6
    together = max(excess, least)
    return PoseEquations(independent / together, scores.sum(axis=0) / together, together)
