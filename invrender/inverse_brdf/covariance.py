"""Covariances that each describe some causes of error only."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.float64]


def larger_covariance(covariances: Sequence[Floats]) -> Floats:
    """The first of covariances (..., k, k), stretched to the largest variances among them all."""
    first = np.diagonal(covariances[0], axis1=-2, axis2=-1)
    largest = np.max([np.diagonal(entry, axis1=-2, axis2=-1) for entry in covariances], axis=0)
    stretch = np.sqrt(np.divide(largest, first, out=np.ones_like(first), where=first > 0))
    return np.asarray(covariances[0] * stretch[..., :, None] * stretch[..., None, :])
