"""What both procedures share: what a sample counts for, and the simplex [RH01, section 6.1: e04ccc of NAG]."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import minimize

from invrender.brdf.fresnel import MU_RANGE
from recon.sampling.lightfield import LightField

Floats = NDArray[np.float64]

# Sizes of the first simplex, and of the one that it starts again with, since it may have collapsed.
_SIZES = (0.3, 0.05)
_MUS = 12
MU_BOUNDS = tuple(np.log(np.array(MU_RANGE) - 1))


def simplex(cost: Callable[[Floats], float], start: Floats, bounds: Floats) -> Floats:
    """Where a cost is least near a start (k,), within bounds (k, 2)."""
    point = start
    for size in _SIZES:
        corners = np.vstack([point, point + size * np.eye(len(point))])
        corners = np.clip(np.where(corners > bounds[:, 1], corners - 2 * size, corners), *bounds.T)
        options = {"initial_simplex": corners, "xatol": 1e-4, "fatol": 1e-9, "maxfev": 800}
        point = minimize(cost, point, method="Nelder-Mead", bounds=bounds, options=options).x
    return np.asarray(point)


def root_weight(field: LightField) -> Floats:
    """Roots (n,) of the samples' weights.

    Our samples are even over normals, the paper counts pixels [RH01, section 6.1]: hence the exitant angle's cosine.
    """
    return np.asarray(np.sqrt(field.weight * field.cos_exitant))


def mu_nodes() -> tuple[Floats, Floats]:
    """Places of log(mu - 1) between which a search interpolates, (k,), and mu there."""
    low, high = MU_BOUNDS
    nodes = (low + high) / 2 + (high - low) / 2 * np.cos(np.pi * (np.arange(_MUS) + 0.5) / _MUS)
    return nodes, 1 + np.exp(nodes)
