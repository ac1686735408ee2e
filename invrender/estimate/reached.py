"""How much of the sphere of directions reflections show."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from scipy.spatial import cKDTree

from recon.harmonics.basis import sphere_directions
from recon.sampling.lightfield import LightField

_GRID = 1000
_NEAR_DEG = 5.0


def reached_share(fields: Sequence[LightField]) -> float:
    """Share of all directions that some free mirrored ray comes within five degrees of."""
    rays = np.concatenate([field.mirrored[field.reflected_visible] for field in fields])
    if not len(rays):
        return 0.0
    distance, _ = cKDTree(rays).query(sphere_directions(_GRID))
    return float((distance < 2 * np.sin(np.radians(_NEAR_DEG) / 2)).mean())
