"""The object's silhouette where no mask is given: what is bright before a black background."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from recon.sphere.outline import largest_filled


def bright_region(radiance: NDArray[np.float32], share: float) -> NDArray[np.float32]:
    """Coverage (h, w), 0 or 1, of the largest region brighter than a share of the brightest radiance; holes are filled.

    radiance : (h, w, 3). share : 0 to 1, of the 99.9% quantile of the luminance. A visual hull bears parts too many,
    which other photographs cut away, but none too few: a low share is the safe one.
    """
    luminance = radiance.mean(axis=2)
    level = share * float(np.quantile(luminance, 0.999))
    return largest_filled(((luminance > level) & (level > 0)).astype(np.uint8))
