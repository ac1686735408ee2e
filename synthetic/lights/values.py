"""Checked values of lights."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.float64]


def unit_vector(vector: Floats, what: str) -> Floats:
    vector = np.asarray(vector, float)
    length = np.linalg.norm(vector)
    if vector.shape != (3,) or not 0 < length < np.inf:
        raise ValueError(f"{what} is {vector.tolist()}; it must be three finite numbers, not all zero")
    return vector / length


def rgb(values: Floats, what: str) -> Floats:
    values = np.asarray(values, float)
    if values.shape != (3,) or not np.isfinite(values).all() or (values < 0).any():
        raise ValueError(f"{what} is {values.tolist()}; it must be three finite numbers >= 0")
    return values
