"""Pictures cut into square blocks of pixels."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray


def blocks(values: NDArray[Any], side: int) -> NDArray[Any]:
    """Pixels (h, w, ...) as (h / side, side, w / side, side, ...); what fills no block, right and below, is cut off."""
    down, across = (length // side for length in values.shape[:2])
    whole = values[: down * side, : across * side]
    return whole.reshape(down, side, across, side, *values.shape[2:])


def block_means(values: NDArray[np.float32], side: int) -> NDArray[np.float32]:
    """Means over the blocks of an image (h, w, ...)."""
    return np.asarray(blocks(values, side).mean(axis=(1, 3)), np.float32)
