"""Photographs as features are looked for in them: eight bits, whatever the files hold."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

# Quantile of the brightest channel that is drawn white: highlights above it show no texture.
_WHITE = 0.99


def feature_picture(radiance: NDArray[np.float32], inside: NDArray[np.bool_] | None) -> NDArray[np.uint8]:
    """A photograph (h, w, 3) uint8 RGB for the eye and for feature detection.

    radiance : (h, w, 3) linear, any unit. inside : (h, w), where the object is, whose brightness then counts alone.
    The square root spreads dark tones about as cameras' own files do.
    """
    counted = radiance if inside is None or not inside.any() else radiance[inside]
    white = float(np.quantile(counted.max(axis=-1), _WHITE))
    if not white > 0:
        return np.zeros(radiance.shape, np.uint8)
    return np.round(255 * np.sqrt(np.clip(radiance / white, 0, 1))).astype(np.uint8)
