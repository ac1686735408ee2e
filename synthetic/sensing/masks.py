"""Masks as images: how much of each pixel something covers."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from numpy.typing import NDArray


def write_mask(path: Path, coverage: NDArray[np.floating] | NDArray[np.bool_]) -> None:
    """Write coverage (h, w), 0 to 1, as an 8-bit PNG."""
    import cv2

    _, data = cv2.imencode(".png", np.round(coverage * 255.0).astype(np.uint8))
    path.write_bytes(data.tobytes())
