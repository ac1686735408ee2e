"""What a camera's colours that are off by their matrix's errors do to Kd and Ks of points, to first order."""

from __future__ import annotations

from collections.abc import Iterable

import numpy as np
from numpy.typing import NDArray

from capture.lighting import Lighting
from invrender.estimate.textured.textures import FittedTextures
from recon.harmonics.latlong import map_coefficients

Floats = NDArray[np.float64]


def color_shares(covariance: Floats, textures: FittedTextures, lightings: Iterable[Lighting]) -> Floats:
    """Shares (n, 6) of themselves by which Kd and Ks of points are uncertain.

    covariance : (9, 9) of dM M^-1, row by row, as `CalibrationErrors` has it. What the base shows has the colour of Kd
    times the light's, what the lobe shows that of Ks times the light's; light is taken as the mean of all lightings.
    """
    light = np.sum([_colour(lighting) for lighting in lightings], axis=0)
    of_channels = np.stack([covariance[3 * c : 3 * c + 3, 3 * c : 3 * c + 3] for c in range(3)])

    def shares(reflectance: Floats) -> Floats:
        shown = reflectance * light
        seen = shown > 0
        # dB_c / B_c is the row of dM M^-1 times B / B_c.
        over = np.where(seen[:, :, None], shown[:, None] / np.where(seen, shown, 1)[:, :, None], 0)
        return np.asarray(np.sqrt(np.einsum("ncj,cjk,nck->nc", over, of_channels, over)))

    return np.hstack([shares(textures.kd), shares(textures.ks)])


def _colour(lighting: Lighting) -> Floats:
    """Irradiance (3,) of a lighting, sources facing the surface, the map from half of all sides."""
    total = lighting.irradiances.sum(axis=0)
    if lighting.radiance_map is not None:
        total = total + np.sqrt(np.pi) / 2 * map_coefficients(lighting.radiance_map, 0)[0]
    return np.asarray(total)
