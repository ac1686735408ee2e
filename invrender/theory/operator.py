"""The reflection operator at the normals and views of actual samples: its rows, over harmonics of the lighting.

Radiance is a row times the lighting's real coefficients. For a fixed exitant angle the BRDF is a function of the
incident direction alone [R02, eq. 2.56 and 2.57]; its coefficients are tabulated against the exitant angle and turned
from each sample's frame into the world's.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.interpolate import BarycentricInterpolator

from invrender.theory.brdfcoefficients import BRDF, outgoing_coefficients
from recon.harmonics.basis import check_unit, clamped_cosine_transfer, degrees, evaluate_harmonics
from recon.harmonics.rotations import rotated_harmonics

Floats = NDArray[np.float64]

_FIRST_ANGLES, _LAST_ANGLES = 9, 129
# Samples whose coefficients may be computed each on its own where no table serves.
_MOST_ONE_BY_ONE = 500


def irradiance_operator(normals: ArrayLike, l_max: int) -> Floats:
    """Rows (n, (l_max + 1)^2) that yield the irradiance at unit normals (n, 3) of unoccluded light [RH01, eq. 15]."""
    return evaluate_harmonics(normals, l_max) * clamped_cosine_transfer(l_max)[degrees(l_max)]


def reflection_operator(
    brdf: BRDF, normals: ArrayLike, views: ArrayLike, l_max: int, tolerance: float = 1e-6
) -> Floats:
    """Rows (n, (l_max + 1)^2) that yield the radiance at unit normals (n, 3) towards unit views (n, 3).

    brdf : isotropic, as in `brdfcoefficients`. tolerance : of the rows, relative to their largest entry. Exact for
    light of degree l_max up to that: the lobe's own coefficients, nothing approximated [R02, eq. 2.57]. Raises
    ValueError for directions that aren't unit, views from below the surface, and BRDFs that `outgoing_coefficients`
    can't integrate.
    """
    normals, views = np.asarray(normals, float), np.asarray(views, float)
    check_unit(normals, "normals")
    check_unit(views, "views")
    cos = np.sum(normals * views, axis=1)
    if not (cos > 0).all():
        worst = int(cos.argmin())
        raise ValueError(
            f"views[{worst}] is {views[worst].tolist()}, from below a surface of normal {normals[worst].tolist()}"
        )
    local = _interpolated(brdf, l_max, np.minimum(cos, 1), tolerance)
    return np.asarray(rotated_harmonics(local, view_frames(normals, views)))


def view_frames(normals: Floats, views: Floats) -> Floats:
    """Rotations (n, 3, 3) to the world from local axes: z along the normal, the view in the xz plane with x > 0."""
    across = np.cross(normals, views)
    length = np.linalg.norm(across, axis=1, keepdims=True)
    # Seen head-on any azimuth will do: then the plane is that of the normal and of the axis farthest from it.
    axis = np.eye(3)[np.abs(normals).argmin(axis=1)]
    across = np.where(length > 1e-9, across, np.cross(normals, axis))
    y = across / np.linalg.norm(across, axis=1, keepdims=True)
    return np.stack([np.cross(y, normals), y, normals], axis=-1)


def _interpolated(brdf: BRDF, l_max: int, cos: Floats, tolerance: float) -> Floats:
    """Outgoing coefficients at cosines (n,), by polynomials in the exitant angle through as many nodes as it takes."""
    theta = np.arccos(cos)
    low, high = float(theta.min()), float(theta.max())
    if high - low < 1e-9 or len(theta) <= _FIRST_ANGLES:
        return outgoing_coefficients(brdf, l_max, cos, tolerance / 10)
    count = _FIRST_ANGLES
    nodes, values = _at_chebyshev(brdf, l_max, low, high, count, tolerance)
    while count < _LAST_ANGLES:
        # Nodes of the finer rule include those of the coarser one; the others show how good that was.
        count = 2 * count - 1
        finer_nodes, finer = _at_chebyshev(brdf, l_max, low, high, count, tolerance)
        error = np.abs(BarycentricInterpolator(nodes, values)(finer_nodes) - finer).max()
        nodes, values = finer_nodes, finer
        if error <= tolerance * np.abs(values).max():
            return np.asarray(BarycentricInterpolator(nodes, values)(theta))
    if len(theta) > _MOST_ONE_BY_ONE:
        raise ValueError(
            f"the BRDF changes too abruptly with the exitant angle: between {_LAST_ANGLES} angles its coefficients are"
            f" off by {error / np.abs(values).max():.1g} of the largest; {tolerance:.1g} is asked. Give"
            f" {_MOST_ONE_BY_ONE} samples or fewer at a time, or a larger tolerance"
        )
    return outgoing_coefficients(brdf, l_max, cos, tolerance / 10)


def _at_chebyshev(
    brdf: BRDF, l_max: int, low: float, high: float, count: int, tolerance: float
) -> tuple[Floats, Floats]:
    nodes = (low + high) / 2 - (high - low) / 2 * np.cos(np.pi * np.arange(count) / (count - 1))
    return nodes, outgoing_coefficients(brdf, l_max, np.cos(nodes), tolerance / 10)
