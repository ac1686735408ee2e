"""The rule that selects a model: the simplest whose error on unseen data lies within one standard error of the least.

L. Breiman, J. Friedman, R. Olshen, C. Stone, "Classification and Regression Trees", 1984, section 3.4.3; T. Hastie,
R. Tibshirani, J. Friedman, "The Elements of Statistical Learning", 2nd ed., 2009, section 7.10. Losses come by groups
of data that share their errors (photographs, views, tiles), so that the standard error is one over groups.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.float64]


def excess(losses: Floats, best: Floats, paired: bool = True) -> tuple[float, float]:
    """By how much losses (groups,) exceed the best candidate's in the mean, and the standard error of that difference.

    Differences are paired by group: what is hard for both candidates then adds nothing to the standard error, which is
    0 for a single group. paired : False takes that of the best's own mean instead, as Breiman et al. do.
    """
    return float((losses - best).mean()), standard_error(losses - best if paired else best)


def standard_error(losses: Floats) -> float:
    """Standard error of the mean of losses (groups,); 0 for a single group."""
    return float(losses.std(ddof=1) / np.sqrt(len(losses))) if len(losses) > 1 else 0.0


def as_good(
    losses: Floats,
    best: Floats,
    standard_errors: float = 1.0,
    negligible: float = 0.0,
    paired: bool = True,
) -> bool:
    """Whether a candidate predicts unseen data as well as the best one.

    losses, best : (groups,), of the two candidates on the same groups. standard_errors : by how many its mean loss may
    exceed the best's. negligible : an excess that never matters, in the unit of the losses. paired : as of `excess`.
    """
    mean, error = excess(losses, best, paired)
    return mean <= max(standard_errors * error, negligible)


def plausibility(losses: Floats, best: Floats, paired: bool = True) -> float:
    """How plausible it is that a candidate is as good as the best one, from 1 (they look alike) to 0.

    losses, best, paired : as of `as_good`. It is the likelihood of equal means over that of the means that were found,
    with an unknown variance: (1 + t^2 / (n - 1))^(-n / 2), t the excess in standard errors, of n groups [Student 1908].
    1 where the candidate is better; 0 where it is worse and the standard error is 0.
    """
    mean, error = excess(losses, best, paired)
    count = len(losses)
    if mean <= 0:
        return 1.0
    return 0.0 if error == 0 else float((1 + (mean / error) ** 2 / (count - 1)) ** (-count / 2))


def simplest(losses: Sequence[Floats] | Floats, parameters: Sequence[int], negligible: float = 0.0) -> int:
    """The index of the candidate with fewest parameters that is as good as the one of least mean loss.

    losses : (candidates, groups). parameters : (candidates,), how many numbers each has; of equals the first is taken.
    negligible : as of `as_good`.
    """
    best = min(losses, key=np.mean)
    good = [index for index, own in enumerate(losses) if as_good(own, best, negligible=negligible)]
    return min(good, key=lambda index: parameters[index])
