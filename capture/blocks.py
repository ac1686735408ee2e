"""Pictures cut into square blocks of pixels."""

from __future__ import annotations

from typing import Any

from numpy.typing import NDArray


def blocks(values: NDArray[Any], side: int) -> NDArray[Any]:
    """Pixels (h, w, ...) as (h / side, side, w / side, side, ...); what fills no block, right and below, is cut off."""
    down, across = (length // side for length in values.shape[:2])
    whole = values[: down * side, : across * side]
    return whole.reshape(down, side, across, side, *values.shape[2:])
