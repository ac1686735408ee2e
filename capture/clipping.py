"""Where floats are cut off: files without a white level whose writer clipped them all the same."""

from __future__ import annotations

from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

# Fewer pixels at the largest value, and fewer different values in another channel among them, may be chance.
_FEWEST, _VARIED = 10, 5
# Up to this share below the largest value lie two steps of half floats, or of a Radiance file's shared exponents. The
# top of a smooth highlight, whose values are spread evenly there, leaves fewer on it than that; cut off, several times
# as many.
_STEPS = {"Radiance": 2 / 128}
_HALF_STEPS = 2 / 1024
_PILED = 3
# What has gone through a display's curve ends here.
_WHITE = 1.0


def cut_off(pixels: NDArray[np.floating[Any]], kind: str) -> NDArray[np.bool_]:
    """(h, w) where any channel of an image of floats (h, w, 3) is at a value that it was clipped at.

    kind : the file's format. A channel that many pixels share the largest value of was clipped, where among these
    another channel varies: light or albedo that is constant is so in all. In an image that is grey throughout nothing
    varies, and only 1 counts.
    """
    result = np.zeros(pixels.shape[:2], bool)
    channels = cv2.split(pixels.astype(np.float32))
    tops = [cv2.minMaxLoc(channel)[1] for channel in channels]
    at_top = [channel == np.float32(top) for channel, top in zip(channels, tops, strict=True)]
    for channel, top, at in zip(channels, tops, at_top, strict=True):
        count = np.count_nonzero(at)
        if count < _FEWEST or top <= 0:
            continue
        below = np.float32(top * (1 - _STEPS.get(kind, _HALF_STEPS)))
        near = np.count_nonzero(channel >= below) - count
        varied = any(
            len(np.unique(other[at & ~end])) >= _VARIED for other, end in zip(channels, at_top, strict=True)
        )
        if count > _PILED * near and count < at.size and (varied or top == _WHITE):
            result |= at
    return result
