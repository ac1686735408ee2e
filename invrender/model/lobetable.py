"""RH01's lobe as a filter of harmonic lighting, exactly, for all roughnesses at once.

What a lobe of facets sends to a viewer at theta_o, per unit of Ks F, is the integral over half-vectors

    S(theta_h; sigma) L(wi(h)) (wo.h) / cos theta_o dh     over  n.wi > 0

of which only S holds sigma. So the harmonics are summed once along each ring of half-vectors around the normal, where
the light is above the horizon, and a roughness is a weight per ring. These are the rho^_lq(theta_o) of [R02, eq.
2.56] in real harmonics; nothing is approximated but by quadrature.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray
from scipy.interpolate import BarycentricInterpolator

from invrender.theory.operator import view_frames
from invrender.theory.refinement import interval_rule
from invrender.theory.specialcases import lobe
from recon.harmonics import degree_of, evaluate_harmonics, orders
from recon.lightfield import LightField
from recon.rotations import rotated_harmonics
from recon.sampling import MIN_COS_EXITANT

Floats = NDArray[np.float64]
Singles = NDArray[np.float32]

# Edges of panels in theta_h, radians, so that lobes of any roughness meet enough nodes; more where the horizon begins
# to cut a ring and where it has cut all of it.
_EDGES = (0.0, 0.03, 0.08, 0.2, 0.5, 1.0, np.pi / 2)
_NODES_PER_PANEL = 16
# Exitant angles of the table, beyond as many as there are degrees.
_SPARE_ANGLES = 17


@dataclass(frozen=True, eq=False)
class LobeTable:
    """Ring sums of the harmonics of degree up to l_max, seen at J exitant angles.

    angles : (J,) radians. rings : (J, R), theta_h. sums : (J, R, (l_max + 1)^2), of a viewer in the local xz plane,
    times the measure: what S at a ring multiplies.
    """

    angles: Floats
    rings: Floats
    sums: Floats

    def coefficients(self, cos_exitant: Floats, sigma: float) -> Floats:
        """Local transfer (n, (l_max + 1)^2) at exitant cosines (n,), per unit of Ks F, of roughness sigma (radians)."""
        return self._interpolated(cos_exitant, lobe(self.rings, sigma))

    def slopes(self, cos_exitant: Floats, sigma: float) -> Floats:
        """Derivative of `coefficients` in log sigma."""
        weights = lobe(self.rings, sigma) * (2 * (self.rings / sigma) ** 2 - 2)
        return self._interpolated(cos_exitant, weights)

    def _interpolated(self, cos_exitant: Floats, weights: Floats) -> Floats:
        at_nodes = (weights[:, None] @ self.sums)[:, 0]
        # Polynomials run wild beyond their nodes: steeper views see what the steepest of the table does.
        angles = np.minimum(np.arccos(np.minimum(cos_exitant, 1)), self.angles[-1])
        return np.asarray(BarycentricInterpolator(self.angles, at_nodes)(angles))


@lru_cache(maxsize=4)
def lobe_table(l_max: int) -> LobeTable:
    """The table for lighting of degree l_max and all exitant angles that samples may have."""
    steepest = np.arccos(MIN_COS_EXITANT) + 0.02
    count = l_max + _SPARE_ANGLES
    angles = steepest / 2 * (1 - np.cos(np.pi * np.arange(count) / (count - 1)))
    rings, sums = zip(*(_rings(float(angle), l_max) for angle in angles), strict=True)
    return LobeTable(angles, np.stack(rings), np.stack(sums))


def specular_rows(field: LightField, l_max: int, sigma: float) -> tuple[Singles, Singles]:
    """Rows (n, (l_max + 1)^2) over lighting coefficients of the specular part, and their slopes in log sigma.

    Per unit of Ks F, single precision, of unshadowed surfaces; a row is the mean over its sample's rays.
    """
    cos = np.einsum("nk,nk->n", field.normals, field.views)
    frames = view_frames(field.normals, field.views)
    table = lobe_table(l_max)
    rows, slopes = (
        rotated_harmonics(local(cos, sigma).astype(np.float32), frames)
        for local in (table.coefficients, table.slopes)
    )
    return field.mean_over_rays(rows), field.mean_over_rays(slopes)


def specular_radiance(field: LightField, lighting: Floats, sigma: float) -> Floats:
    """What each ray (m, c) sees of lighting ((l_max + 1)^2, c) in the lobe, per unit of Ks F; unshadowed."""
    table = lobe_table(degree_of(len(lighting)))
    local = table.coefficients(np.einsum("nk,nk->n", field.normals, field.views), sigma).astype(np.float32)
    rows = rotated_harmonics(local, view_frames(field.normals, field.views))
    return np.asarray(rows @ lighting, float)


def _rings(theta_o: float, l_max: int) -> tuple[Floats, Floats]:
    """theta_h (R,) and sums (R, (l_max + 1)^2) over the lit part of each ring, times dh (wo.h) / cos theta_o."""
    theta, weight = _panels(theta_o)
    # n.wi = sin 2theta sin theta_o cos a + cos 2theta cos theta_o is positive for azimuths |a| up to:
    lit = -np.cos(2 * theta) * np.cos(theta_o) / np.maximum(np.sin(2 * theta) * np.sin(theta_o), 1e-300)
    reach = np.arccos(np.clip(lit, -1, 1))
    unit, share = interval_rule(2 * l_max + 16, 0, 1)
    azimuth = reach[:, None] * unit
    around = 2 * reach[:, None] * share
    sin, cos = np.sin(theta)[:, None], np.cos(theta)[:, None]
    half = np.stack(
        [sin * np.cos(azimuth), sin * np.sin(azimuth), np.broadcast_to(cos, azimuth.shape)], axis=-1
    )
    view = np.array([np.sin(theta_o), 0.0, np.cos(theta_o)])
    toward = half @ view
    incident = 2 * toward[..., None] * half - view
    harmonics = evaluate_harmonics(incident, l_max).reshape(*azimuth.shape, -1)
    measure = around * np.maximum(toward, 0) / np.cos(theta_o)
    sums = (measure[:, None] @ harmonics)[:, 0] * (weight * np.sin(theta))[:, None]
    # Both sides of the xz plane were counted on one: what is odd in azimuth cancels.
    sums[:, orders(l_max) < 0] = 0
    return theta, sums


def _panels(theta_o: float) -> tuple[Floats, Floats]:
    """theta_h (R,) and weights.

    The horizon cuts rings between two angles, at which their sums have a root: there theta = middle - half cos t,
    with equal panels in t.
    """
    low, high = (np.pi / 2 - theta_o) / 2, (np.pi / 2 + theta_o) / 2
    edges = np.array(_EDGES)
    middle = np.arccos(np.clip((low + high - 2 * edges) / max(high - low, 1e-12), -1, 1))
    parts = []
    for nodes, weights in _composite(np.clip(edges, 0, low)), _composite(np.clip(edges, high, np.pi / 2)):
        parts.append((nodes, weights))
    t, step = _composite(np.sort(np.concatenate([middle, np.linspace(0, np.pi, 5)])))
    parts.append(((low + high) / 2 - (high - low) / 2 * np.cos(t), (high - low) / 2 * np.sin(t) * step))
    theta, weight = (np.concatenate(each) for each in zip(*parts, strict=True))
    return theta, weight


def _composite(edges: Floats) -> tuple[Floats, Floats]:
    """Gauss-Legendre on each panel between edges."""
    rules = [interval_rule(_NODES_PER_PANEL, low, high) for low, high in pairwise(edges)]
    nodes, weights = (np.concatenate(each) for each in zip(*rules, strict=True))
    return nodes, weights
