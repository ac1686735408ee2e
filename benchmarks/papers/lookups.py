"""Values of lat-long maps at many directions, as quick as a graphics card's lookup is simple."""

from __future__ import annotations

import cv2
import numpy as np
from numpy.typing import NDArray

from capture.lighting import latlong_pixels

Singles = NDArray[np.float32]


def looked_up(values: Singles, directions: Singles) -> Singles:
    """Values (n, 3) of a map (3, H, 2H) in directions (n, 3), unit; linear between pixel centres."""
    height = values.shape[1]
    # A pixel more on each side: the other side of the poles, and the next turn.
    padded = np.empty((height + 2, 2 * height + 2, 3), np.float32)
    inner = padded[:, 1:-1]
    inner[1:-1] = values.transpose(1, 2, 0)
    inner[0], inner[-1] = np.roll(inner[1], height, axis=0), np.roll(inner[-2], height, axis=0)
    padded[:, 0], padded[:, -1] = padded[:, -2], padded[:, 1]
    row, column = latlong_pixels(directions, height)
    return cv2.remap(padded, column[:, None] + 0.5, row[:, None] + 0.5, cv2.INTER_LINEAR)[:, 0]
