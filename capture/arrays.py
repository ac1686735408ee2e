"""Arrays that frozen dataclasses can hand on safely."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import ArrayLike, DTypeLike, NDArray


def frozen_view(values: ArrayLike, dtype: DTypeLike) -> NDArray[Any]:
    """A read-only view, copied only to change the dtype: for images, whose maker hands them over for good."""
    view = np.asarray(values, dtype=dtype).view()
    view.flags.writeable = False
    return view


def frozen_array(values: ArrayLike, dtype: DTypeLike = np.float64) -> NDArray[Any]:
    """A read-only copy: `frozen=True` alone does not protect what is inside an array."""
    array = np.array(values, dtype=dtype)
    array.flags.writeable = False
    return array
