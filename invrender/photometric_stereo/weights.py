"""Robust weights of samples: what shadows, bounces and missed highlights make of a pixel counts for less.

S. Geman, D. McClure, "Statistical methods for tomographic image reconstruction", 1987: the loss is r^2 / (1 + r^2),
whose weights are 1 / (1 + r^2)^2, r the residual in units of what a pixel may well be off.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from invrender.photometric_stereo.stack import PixelStack

Floats = NDArray[np.float64]
# What a lobe that all pixels share may be off: this share of the prediction, and of the median of all samples.
_RELATIVE, _FLOOR = 0.1, 0.01


def floor_of(stack: PixelStack) -> float:
    """What any sample of a stack may be off, 1/sr, however dark."""
    return _FLOOR * float(np.median(stack.reflected[stack.reflected > 0]))


def scales(stack: PixelStack, predicted: Floats, floor: float) -> Floats:
    """What samples may well be off, squared (p, j), where (p, j, 3) is predicted."""
    return np.asarray(stack.variance + floor**2 + (_RELATIVE * predicted.mean(axis=2)) ** 2)


def robust_weights(stack: PixelStack, predicted: Floats, squares: Floats) -> tuple[Floats, Floats]:
    """Weights (p, j) of samples, over squared scales (p, j), and their losses (p, j), 0 to 1."""
    off = ((stack.reflected - predicted) ** 2).mean(axis=2) / squares
    weights = np.where(stack.usable, 1 / (squares * (1 + off) ** 2), 0)
    return weights, np.where(stack.usable, off / (1 + off), 0)


def pixel_losses(predicted: Floats, stack: PixelStack, floor: float) -> Floats:
    """The loss (p,) of pixels of which (p, j, 3) is predicted."""
    return np.asarray(robust_weights(stack, predicted, scales(stack, predicted, floor))[1].sum(axis=1))


def error_of_loss(loss: float) -> float:
    """The error, as a share of what is predicted, that has a loss, 0 to 1, on average."""
    return _RELATIVE * float(np.sqrt(loss / max(1 - loss, 1e-6)))
