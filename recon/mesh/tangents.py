"""Two axes across a direction."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.float64]


def tangents(directions: Floats) -> Floats:
    """Two unit vectors (..., 2, 3) across each unit direction (..., 3) and each other."""
    # The axis farthest from a direction is never along it.
    first = np.cross(directions, np.eye(3)[np.abs(directions).argmin(axis=-1)])
    first /= np.linalg.norm(first, axis=-1, keepdims=True)
    return np.stack([first, np.cross(directions, first)], axis=-2)
