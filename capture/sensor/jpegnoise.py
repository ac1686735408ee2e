"""What JPEG compression changes: the variance of its error, read off a decoded photograph and its tables.

Of each 8x8 block only coefficients above half a step survive. A surviving one is off by what is uniform within a step,
step^2 / 12; one set to zero by its own size, which the file no longer shows. Of natural pictures what was lost keeps a
proportion to what survives, smooth or textured, so that the survivors' error times a measured constant stands for both.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from capture.files.jpegtables import JpegTables

Floats = NDArray[np.float64]

BLOCK = 8
# Error of all coefficients over that of the surviving ones. Measured on churches, a room, a plaster cast and shaded
# spheres of 1500 to 20000 electrons, quality 75 to 98, with and without halved colour: 2 to 5.
_LOST = 5.0
# The coefficients (8, 8) of the highest octave.
_FINEST = np.maximum(*np.indices((BLOCK, BLOCK))) >= BLOCK // 2
# Components are rounded to integers before compression and after it.
_ROUNDING = 2 / 12
# Red, green and blue from Y, Cb, Cr, and back (JFIF 1.02, 1992).
_FROM_YCC = np.array([[1, 0, 1.402], [1, -0.344136, -0.714136], [1, 1.772, 0]])
_TO_YCC = np.linalg.inv(_FROM_YCC)


def jpeg_code_variance(pixels: NDArray[np.uint8], tables: JpegTables) -> NDArray[np.float32]:
    """Variance (h, w, 3) of the error that compression leaves in a decoded JPEG photograph, RGB, in codes squared.

    pixels : (h, w, 3) uint8 as decoded. Constant over blocks of 8 pixels; good to a factor of 1.5 or so between smooth
    and textured places. Errors are correlated within blocks: smooth ones are off as a whole.
    The noise of the sensor counts besides: compression takes its finest part away, but not what means are made of.
    """
    height, width = pixels.shape[:2]
    planes = pixels.astype(np.float32)
    mixing = np.eye(3)
    if tables.luma_chroma:
        planes = planes @ _TO_YCC.T.astype(np.float32)
        mixing = _FROM_YCC
    result = np.zeros((height, width, 3), np.float32)
    for number, (steps, reduction) in enumerate(zip(tables.steps, tables.reduction, strict=True)):
        variance = _component_variance(planes[..., number], steps, reduction)
        for channel, share in enumerate(mixing[:, number] ** 2):
            if share:
                result[..., channel] += np.float32(share) * variance
    return result


def _component_variance(
    plane: NDArray[np.float32], steps: Floats, reduction: tuple[int, int]
) -> NDArray[np.float32]:
    """Variance (h, w) of a component's error, constant over its blocks."""
    import cv2

    height, width = plane.shape
    down, across = reduction
    # As encoders do, the last row and column are repeated up to whole blocks.
    below, beside = -height % (BLOCK * down), -width % (BLOCK * across)
    whole = np.pad(plane, ((0, below), (0, beside)), mode="edge")
    if reduction != (1, 1):
        size = (whole.shape[1] // across, whole.shape[0] // down)
        whole = np.asarray(cv2.resize(whole, size, interpolation=cv2.INTER_AREA), np.float32)
    coefficients = _coefficients(whole)
    survives = np.abs(coefficients) > steps.astype(np.float32) / 2
    errors = steps**2 / 12
    detail = survives.reshape(*survives.shape[:2], -1)[..., 1:] @ errors.ravel()[1:].astype(np.float32)
    # No more than if every coefficient had been above its step; the mean of a block always counts.
    total = np.minimum(errors[0, 0] + _LOST * detail, errors.sum())
    if reduction != (1, 1):
        # Detail finer than the reduced samples is lost; natural pictures hold about as much in each octave.
        total = total + np.where(survives & _FINEST, coefficients**2, 0).sum(axis=(2, 3))
    variance = (total / BLOCK**2 + _ROUNDING).astype(np.float32)
    spread = variance.repeat(BLOCK * down, axis=0).repeat(BLOCK * across, axis=1)
    return np.asarray(spread[:height, :width])


def _coefficients(plane: NDArray[np.float32]) -> NDArray[Any]:
    """Orthonormal DCT coefficients (rows, columns, 8, 8) of the 8x8 blocks of a plane of whole blocks."""
    frequency, place = np.mgrid[:BLOCK, :BLOCK]
    basis = np.sqrt(2 / BLOCK) * np.cos((2 * place + 1) * frequency * np.pi / (2 * BLOCK))
    basis[0] /= np.sqrt(2)
    basis = basis.astype(np.float32)
    rows, columns = plane.shape[0] // BLOCK, plane.shape[1] // BLOCK
    blocks = plane.reshape(rows, BLOCK, columns, BLOCK).swapaxes(1, 2)
    return np.asarray(basis @ blocks @ basis.T)
