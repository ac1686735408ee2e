"""The sRGB curve (IEC 61966-2-1), both ways."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray


def srgb_to_linear(codes: NDArray[np.floating]) -> NDArray[np.float64]:
    """The sRGB decoding curve (IEC 61966-2-1), codes and result in 0 to 1."""
    codes = np.asarray(codes, float)
    return np.where(codes <= 0.04045, codes / 12.92, ((codes + 0.055) / 1.055) ** 2.4)


def linear_to_srgb(linear: NDArray[np.floating]) -> NDArray[np.float64]:
    """The sRGB encoding curve (IEC 61966-2-1), values and result in 0 to 1; for pictures to look at."""
    linear = np.asarray(linear, float)
    return np.where(linear <= 0.0031308, 12.92 * linear, 1.055 * linear ** (1 / 2.4) - 0.055)
