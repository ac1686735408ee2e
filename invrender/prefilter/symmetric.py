"""Reflection maps of radially symmetric lobes, which don't depend on the view [R02, section 5.6.2, and eq. 2.62].

What `analyse_latlong`, `filtered` and `synthesise_latlong` do in double precision, by products of matrices in single
precision from pixel to pixel. Lobes of low degrees need few waves along a row, and for those a product is quicker than
an FFT, which makes all of them [R02, eq. 5.21 and 5.24].
"""

from __future__ import annotations

from functools import lru_cache

import numpy as np
from numpy.typing import ArrayLike, NDArray

from capture.lighting import latlong_solid_angles
from recon.harmonics.basis import finite
from recon.harmonics.latlong import check_carried, theta_factors

Singles = NDArray[np.float32]


def symmetric_map(radiance_map: ArrayLike, transfer: ArrayLike, height: int) -> Singles:
    """B(alpha, beta), (c, height, 2 height) single precision, of a lat-long map (H, 2H, c) whose pixels are means.

    transfer : (l_max + 1,), Lambda_l rho_l of the lobe about the mirrored view, the normal or a tangent. Off by 2e-6 of
    the largest value, by rounding. Raises ValueError for values that aren't finite, for other shapes, and for grids
    too coarse to carry l_max.
    """
    values, transfer = np.asarray(radiance_map, np.float32), np.asarray(transfer, np.float32)
    if values.ndim != 3 or values.shape[1] != 2 * values.shape[0] or not values.size:
        raise ValueError(f"a lat-long grid is (H, 2H, channels), not {values.shape}")
    if transfer.ndim != 1 or not transfer.size:
        raise ValueError(f"transfer is {transfer.shape}; it must be (l_max + 1,)")
    rows, channels, l_max = len(values), values.shape[2], len(transfer) - 1
    for carried in (rows, height):
        check_carried(l_max, carried)
    with np.errstate(over="ignore", invalid="ignore"):
        waves = (_waves(rows, l_max) @ values).reshape(rows, 2, l_max + 1, channels)
        by_order = waves.transpose(2, 0, 1, 3).reshape(l_max + 1, rows, 2 * channels)
        reflected = _analysis(rows, l_max) @ by_order * transfer[:, None]
    # What isn't finite in any pixel is in these; to look at all pixels takes a quarter of the whole.
    if not np.isfinite(reflected).all():
        finite(values, "lat-long grid")
        finite(transfer, "transfer")
        raise ValueError(
            "lat-long grid: sums over its values overflow single precision; give it in another unit"
        )
    lines = (_synthesis(height, l_max) @ reflected).reshape(l_max + 1, height, 2, channels)
    turned = lines.transpose(3, 1, 2, 0).reshape(channels * height, 2 * (l_max + 1))
    return (turned @ _waves(height, l_max)).reshape(channels, height, 2 * height)


@lru_cache(maxsize=8)
def _waves(height: int, l_max: int) -> Singles:
    """Cosines and sines (2 (l_max + 1), 2 height) of orders 0 to l_max at the centres of a row's pixels."""
    phases = np.outer(np.arange(l_max + 1), (np.arange(2 * height) + 0.5) * np.pi / height)
    return np.concatenate([np.cos(phases), np.sin(phases)]).astype(np.float32)


@lru_cache(maxsize=8)
def _synthesis(height: int, l_max: int) -> Singles:
    """f_lm of rows, (m, height, l)."""
    cos = np.cos((np.arange(height) + 0.5) * np.pi / height)
    return np.ascontiguousarray(theta_factors(cos, l_max).transpose(0, 2, 1), np.float32)


@lru_cache(maxsize=8)
def _analysis(height: int, l_max: int) -> Singles:
    """f_lm times the solid angle of a row's pixels, (m, l, height)."""
    weighted = _synthesis(height, l_max).transpose(0, 2, 1) * latlong_solid_angles(height)[:, 0]
    return np.ascontiguousarray(weighted, np.float32)
