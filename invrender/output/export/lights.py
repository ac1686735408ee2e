"""Environment maps as other programs read them; ours have azimuth, from +X towards +Y, to the right."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

Singles = NDArray[np.float32]


def panorama(radiance_map: Singles) -> Singles:
    """A map (H, 2H, 3) as one sees it from inside, +X in its middle and +Y to the left of that.

    What three.js, Blender and others show where the object was exported with +Z turned to their up.
    """
    return np.roll(radiance_map[:, ::-1], radiance_map.shape[1] // 2, axis=1)


def mitsuba_map(radiance_map: Singles) -> Singles:
    """A map (H, 2H, 3) for Mitsuba's `envmap` under `MITSUBA_MAP_TO_WORLD`, (2H + 1, 2H, 3).

    Its rows span 0 to pi inclusive, linear in between: ours are every other one, so that none is moved.
    """
    ours = radiance_map[:, ::-1]
    rows = np.empty((2 * len(ours) + 1, *ours.shape[1:]), np.float32)
    rows[1::2] = ours
    rows[2:-1:2] = (ours[1:] + ours[:-1]) / 2
    # A pole has one radiance.
    rows[0], rows[-1] = ours[0].mean(axis=0), ours[-1].mean(axis=0)
    return rows


# Its up, y, to our +Z; its columns begin at -z, our +X, and run towards +x, our -Y.
MITSUBA_MAP_TO_WORLD = np.array([[0.0, 0, -1, 0], [-1, 0, 0, 0], [0, 1, 0, 0], [0, 0, 0, 1]])
