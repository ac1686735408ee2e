"""The light on an evenly lit wall, which is never quite even: a gradient and a saddle over the image.

A lamp nearby makes a wall brighter towards it, and along it another way than across. What is alike in all directions,
a hill or a bowl about the centre, no photograph separates from vignetting: that part of a wall must be even.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from capture.sensor.flatfield import half_diagonal

Floats = NDArray[np.float64]

# x, y (the gradient), x^2 - y^2 and 2 x y (the saddle).
TERMS = 4


def light_terms(position: Floats) -> Floats:
    """The terms (..., 4) of the light at positions (..., 2), in half diagonals from the image centre."""
    x, y = position[..., 0], position[..., 1]
    return np.stack([x, y, x**2 - y**2, 2 * x * y], axis=-1)


def light_over(width: int, height: int, light: Floats) -> NDArray[np.float32]:
    """The light (h, w), 1 in the middle, of its four terms' amounts."""
    unit = half_diagonal(width, height)
    x = (np.arange(width) + 0.5 - width / 2) / unit
    y = (np.arange(height) + 0.5 - height / 2) / unit
    terms = light_terms(np.stack(np.meshgrid(x, y), axis=-1))
    return (1 + terms @ light).astype(np.float32)
