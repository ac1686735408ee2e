"""Small shifts between photographs of one view: the camera was touched, or a tripod stood on a soft floor."""

from __future__ import annotations

from collections.abc import Sequence
from itertools import pairwise

import cv2
import numpy as np
from numpy.typing import NDArray

from capture.radiance import RadianceImage

Window = tuple[slice, slice]

# Shifts below this, in pixels, are left alone: interpolation would blur more than they do.
_NEGLIGIBLE = 0.2
# Share of the correlation that its peak must hold, 1 for equal pictures: noise alone reaches 0.05.
_LEAST_RESPONSE = 0.5
# Quantiles of brightness about which contrast is kept.
_LEVELS = (0.5, 0.9, 0.99)
WHOLE: Window = (slice(None), slice(None))


def shift_between(first: NDArray[np.float32], second: NDArray[np.float32]) -> tuple[float, float]:
    """The shift (right, down) in pixels that takes one picture to another; (0, 0) where none is clearly seen.

    first, second : (h, w) luminances as bright as each other. Phase correlation [C. D. Kuglin and D. C. Hines, "The
    phase correlation image alignment method", 1975], at the level of brightness at which it peaks highest: dark
    parts show nothing but noise in a short exposure.
    """
    # Both as dark as the one that saturates earlier.
    ceiling = min(float(first.max()), float(second.max()))
    one, other = (np.clip(each, 0, ceiling).astype(np.float32) for each in (first, second))
    window = cv2.createHanningWindow(first.shape[::-1], cv2.CV_32F)
    best, shift = _LEAST_RESPONSE, (0.0, 0.0)
    for middle in np.maximum(np.quantile(other, _LEVELS), 1e-6 * ceiling + 1e-30).astype(np.float32):
        (right, down), response = cv2.phaseCorrelate(one / (one + middle), other / (other + middle), window)
        if response > best:
            best, shift = response, (float(right), float(down))
    return shift


def moved(picture: NDArray[np.float32], shift: tuple[float, float]) -> NDArray[np.float32]:
    """A picture (h, w) or (h, w, c) shifted by (right, down) pixels, its edge pixels repeated."""
    if np.hypot(*shift) < _NEGLIGIBLE:
        return picture
    there = np.array([[1, 0, shift[0]], [0, 1, shift[1]]])
    size = (picture.shape[1], picture.shape[0])
    # OpenCV needs memory of its own.
    return np.asarray(cv2.warpAffine(np.array(picture), there, size, borderMode=cv2.BORDER_REPLICATE))


def moved_image(image: RadianceImage, shift: tuple[float, float]) -> RadianceImage:
    """A photograph shifted by (right, down) pixels; what saturated pixels touch is saturated."""
    if np.hypot(*shift) < _NEGLIGIBLE:
        return image
    return RadianceImage(
        moved(image.radiance, shift),
        moved(image.variance, shift),
        moved(image.saturated.astype(np.float32), shift) > 0,
    )


def bracket_shifts(images: Sequence[RadianceImage], window: Window = WHOLE) -> list[tuple[float, float]]:
    """The shift (right, down) of each photograph of a bracket that takes it to the first.

    images : radiance in one unit, in descending or ascending order of exposure, so that neighbours show the same.
    window : the part of the picture that counts.
    """
    total = [(0.0, 0.0)]
    for one, other in pairwise(images):
        grey = [np.ascontiguousarray(each.radiance[window].mean(axis=2)) for each in (other, one)]
        right, down = shift_between(*grey)
        total.append((total[-1][0] + right, total[-1][1] + down))
    return total
