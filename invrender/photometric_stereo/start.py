"""Least squares: normals and Kd of a Lambertian surface, to start from and to compare with.

R. Woodham, "Photometric method for determining surface orientation from multiple images", 1980: B / E = Kd n . l, so
that Kd n solves a linear system of all lamps.
"""

from __future__ import annotations

import numpy as np

from invrender.photometric_stereo.stack import PixelStack, PixelSurface, facing


def least_squares(stack: PixelStack) -> PixelSurface:
    """Normals by least squares over all usable samples, means of the channels, and Kd of each channel with them."""
    grey = stack.reflected.mean(axis=2) * stack.usable
    used = stack.usable.astype(float)
    lamps = np.broadcast_to(stack.lamps, (len(stack), *stack.lamps.shape[1:]))
    matrix = np.einsum("pj,pja,pjb->pab", used, lamps, lamps, optimize=True)
    right = np.einsum("pj,pja->pa", grey, lamps)
    # A pixel that is saturated under all lamps but one or two keeps what its equations say along those.
    ridge = 1e-9 * np.einsum("paa->p", matrix)[:, None, None] + 1e-12
    normals = facing(np.linalg.solve(matrix + ridge * np.eye(3), right[..., None])[..., 0], stack.views)
    cos = np.maximum(np.einsum("pk,pjk->pj", normals, lamps), 0) * used
    kd = np.einsum("pj,pjc->pc", cos, stack.reflected) / np.maximum((cos**2).sum(axis=1), 1e-12)[:, None]
    return PixelSurface(normals, np.maximum(kd, 0))
