"""The shortest series of what a lobe reflects: functions of the view's angle in place of harmonics of the view.

About the mirrored view a lobe has the coefficients rho_lq(theta_o) [R02, eq. 2.57]. A singular value decomposition for
each q parts theta_o from l:

    rho_lq(theta_o) = sum_k rho_lk g_k(theta_o)

which takes the fewest terms that there are for an accuracy; [R02, section 5.8] has it in mind.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy.interpolate import BarycentricInterpolator

Floats = NDArray[np.float64]


def separated_terms(
    rho: Floats, weights: Floats, power: Floats, left_out: float
) -> tuple[NDArray[np.int64], Floats, Floats]:
    """Orders q (K,), < 0 for sines, with rho_lk (l_max + 1, K) and g_k(theta_o), (angles, K).

    rho : (angles, l_max + 1, q_max + 1), rho_lq at angles theta_o. weights : (angles,), with which squared errors are
    summed over theta_o. power : (l_max + 1,), of the light. left_out : of light turned at random, the share (RMS) of
    what is reflected that terms which are left out may hold.
    """
    shown = np.sqrt(power / (2 * np.arange(len(power)) + 1))[:, None]
    terms: list[tuple[float, int, Floats, Floats]] = []
    for q in range(rho.shape[2]):
        seen = rho[:, :, q].T * np.sqrt(weights)
        _, sizes, across = np.linalg.svd(shown * seen, full_matrices=False)
        # Of q > 0 there is a sine as well.
        squares = sizes**2 * (2 if q else 1)
        terms += [(squares[k], q, seen @ row, row / np.sqrt(weights)) for k, row in enumerate(across)]
    terms.sort(key=lambda term: term[0])
    sums = np.cumsum([term[0] for term in terms])
    kept = terms[int(np.searchsorted(sums, left_out**2 * sums[-1])) :]
    kept += [(square, -q, by_degree, function) for square, q, by_degree, function in kept if q]
    by_degree, functions = (np.stack([term[place] for term in kept], axis=1) for place in (2, 3))
    return np.array([term[1] for term in kept]), by_degree, functions


def tabulated(angles: Floats, functions: Floats, at: Floats) -> Floats:
    """g_k(theta_o) cos theta_o, (n, K), at angles (n,) between those of `separated_terms`, which are Gauss's.

    What grows as 1 / cos theta_o is no polynomial; multiplied by that it nearly is.
    """
    return np.asarray(BarycentricInterpolator(angles, functions * np.cos(angles)[:, None])(at))


def mirrored_frame(normals: Floats, views: Floats) -> tuple[Floats, Floats]:
    """The mirrored views R (m, 3), and azimuths (m,) of the views about them, radians from R's meridian southwards.

    normals, views : (m, 3), unit.
    """
    mirrored = 2 * (normals * views).sum(axis=1)[:, None] * normals - views
    level = np.maximum(np.hypot(mirrored[:, 0], mirrored[:, 1]), 1e-12)
    east = (mirrored[:, 0] * views[:, 1] - mirrored[:, 1] * views[:, 0]) / level
    south = ((mirrored * views).sum(axis=1) * mirrored[:, 2] - views[:, 2]) / level
    return mirrored, np.arctan2(east, south)
