"""What lights share: checked values, directions about an axis."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.float64]
AnyFloats = NDArray[np.floating]


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


def about_axis(axis: Floats, versine: AnyFloats, azimuth: AnyFloats) -> AnyFloats:
    """Unit directions (..., 3) at angles from an axis (3,), given by 1 - cosine and azimuth (...,); keeps the dtype.

    The cosine itself would leave small angles no digits in single precision.
    """
    first = np.eye(3)[np.abs(axis).argmin()]
    first = first - (first @ axis) * axis
    first /= np.linalg.norm(first)
    sine = np.sqrt(np.maximum(versine * (2 - versine), 0))
    local = np.stack([sine * np.cos(azimuth), sine * np.sin(azimuth), 1 - versine], axis=-1)
    return np.asarray(local @ np.stack([first, np.cross(axis, first), axis]).astype(local.dtype))
