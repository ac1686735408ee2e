"""Directions on a surface that anisotropic materials follow."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.float64]


def tangents(normals: Floats, along: Floats | None = None) -> Floats:
    """Unit tangents (n, 3) at unit normals (n, 3), as near to vectors `along` (n, 3) as can be.

    Without them, and where they are zero or along the normal: horizontal, counterclockwise about +Z; +Y where the
    normal is vertical.
    """
    level = np.stack([-normals[:, 1], normals[:, 0], np.zeros(len(normals))], axis=1)
    level[np.hypot(normals[:, 0], normals[:, 1]) < 1e-9] = [0, 1, 0]
    if along is None:
        chosen = level
    else:
        across = along - (along * normals).sum(axis=1, keepdims=True) * normals
        steep = np.linalg.norm(across, axis=1) <= 1e-6 * np.linalg.norm(along, axis=1)
        chosen = np.where(steep[:, None], level, across)
    # Twice, because what is left of a nearly parallel vector is perpendicular to a few digits only.
    chosen = chosen / np.linalg.norm(chosen, axis=1, keepdims=True)
    chosen = chosen - (chosen * normals).sum(axis=1, keepdims=True) * normals
    return np.asarray(chosen / np.linalg.norm(chosen, axis=1, keepdims=True))
