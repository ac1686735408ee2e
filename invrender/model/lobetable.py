"""RH01's lobe as a filter of harmonic lighting, for all roughnesses at once.

What a lobe of facets sends to a viewer at theta_o, per unit of Ks F, is the integral over half-vectors

    S(theta_h; sigma) L(wi(h)) (wo.h) / cos theta_o dh     over  n.wi > 0

of which only S holds sigma. So the harmonics are summed once along each ring of half-vectors around the normal, where
the light is above the horizon, and a roughness is a weight per ring. These are the rho^_lq(theta_o) of [R02, eq.
2.56] in real harmonics; nothing is approximated but by quadrature.

That is the transfer `exact`. Two coarser rungs are RH01's own: light looked up in the mirror direction as it is
(`mirror`, eq. 22), or after the lobe has blurred it (`filtered`, eq. 22 of light filtered by eq. 20).
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache
from typing import Literal, get_args

import numpy as np
from numpy.typing import NDArray
from scipy.interpolate import BarycentricInterpolator

from invrender.theory.operator import view_frames
from invrender.theory.refinement import interval_rule
from invrender.theory.specialcases import lobe, microfacet_gaussian
from recon.harmonics import degree_of, degrees, evaluate_harmonics, orders
from recon.lightfield import LightField
from recon.rotations import rotated_harmonics
from recon.sampling import MIN_COS_EXITANT

Floats = NDArray[np.float64]
Singles = NDArray[np.float32]
Transfer = Literal["exact", "filtered", "mirror"]
TRANSFERS: tuple[Transfer, ...] = get_args(Transfer)

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
        return between_angles(self.angles, self._at_angles(lobe(self.rings, sigma)), cos_exitant)

    def with_slopes(self, cos_exitant: Floats, sigma: float) -> Singles:
        """`coefficients`, and their derivatives in log sigma: (n, 2, (l_max + 1)^2), single precision."""
        weights = lobe(self.rings, sigma)
        slopes = weights * (2 * (self.rings / sigma) ** 2 - 2)
        both = np.stack([self._at_angles(weights), self._at_angles(slopes)], axis=1)
        return between_angles(self.angles, both.astype(np.float32), cos_exitant).astype(np.float32)

    def _at_angles(self, weights: Floats) -> Floats:
        return np.asarray((weights[:, None] @ self.sums)[:, 0])


@lru_cache(maxsize=4)
def lobe_table(l_max: int) -> LobeTable:
    """The table for lighting of degree l_max and all exitant angles that samples may have."""
    angles = exitant_angles(l_max)
    rings, sums = zip(*(_rings(float(angle), l_max) for angle in angles), strict=True)
    return LobeTable(angles, np.stack(rings), np.stack(sums))


def exitant_angles(l_max: int) -> Floats:
    """Angles (J,) between which coefficients of degree up to l_max are interpolated, to beyond what samples have."""
    steepest = np.arccos(MIN_COS_EXITANT) + 0.02
    count = l_max + _SPARE_ANGLES
    return np.asarray(steepest / 2 * (1 - np.cos(np.pi * np.arange(count) / (count - 1))))


def between_angles(angles: Floats, at_angles: Floats, cos_exitant: Floats) -> Floats:
    """Values (n, ...) at exitant cosines (n,) by the polynomial through those (J, ...) at `exitant_angles`."""
    # Polynomials run wild beyond their nodes: steeper views see what the steepest of the table does.
    seen = np.minimum(np.arccos(np.minimum(cos_exitant, 1)), angles[-1])
    share = BarycentricInterpolator(angles, np.eye(len(angles)))(seen).astype(at_angles.dtype)
    return np.asarray(share @ at_angles.reshape(len(angles), -1)).reshape(len(seen), *at_angles.shape[1:])


def specular_rows(
    field: LightField, l_max: int, sigma: float, transfer: Transfer = "exact"
) -> tuple[Singles, Singles]:
    """Rows (n, (l_max + 1)^2) over lighting coefficients of the specular part, and their slopes in log sigma.

    Per unit of Ks F, single precision, of unshadowed surfaces; a row is the mean over its sample's rays.
    """
    if transfer == "exact":
        cos = np.einsum("nk,nk->n", field.normals, field.views)
        local = lobe_table(l_max).with_slopes(cos, sigma)
        rows, slopes = rotated_harmonics(local.swapaxes(0, 1), view_frames(field.normals, field.views))
    else:
        at_mirror = mirrored_harmonics(field, l_max)
        rows, slopes = (
            (at_mirror * factor[degrees(l_max)]).astype(np.float32)
            for factor in _blur(sigma, l_max, transfer)
        )
    return field.mean_over_rays(rows), field.mean_over_rays(slopes)


def specular_radiance(
    field: LightField, lighting: Floats, sigma: float, transfer: Transfer = "exact"
) -> Floats:
    """What each ray (m, c) sees of lighting ((l_max + 1)^2, c) in the lobe, per unit of Ks F; unshadowed."""
    l_max = degree_of(len(lighting))
    if transfer != "exact":
        blurred = lighting * _blur(sigma, l_max, transfer)[0][degrees(l_max), None]
        return np.asarray(mirrored_harmonics(field, l_max) @ blurred)
    table = lobe_table(l_max)
    local = table.coefficients(np.einsum("nk,nk->n", field.normals, field.views), sigma).astype(np.float32)
    rows = rotated_harmonics(local, view_frames(field.normals, field.views))
    return np.asarray(rows @ lighting, float)


def mirrored_harmonics(field: LightField, l_max: int) -> Floats:
    """Y_lm (m, (l_max + 1)^2) where a mirror in each ray's place would look [RH01, eq. 22].

    Zero for rays from below the horizon, whose mirror directions are below it too.
    """
    cos = np.einsum("nk,nk->n", field.normals, field.views)[:, None]
    return evaluate_harmonics(2 * cos * field.normals - field.views, l_max) * (cos > 0)


def _blur(sigma: float, l_max: int, transfer: Transfer) -> tuple[Floats, Floats]:
    """Factors (l_max + 1,) of the degrees of light in the mirror direction, and their slopes in log sigma."""
    if transfer == "mirror":
        return np.ones(l_max + 1), np.zeros(l_max + 1)
    factors = microfacet_gaussian(sigma, l_max)
    return factors, -2 * (sigma * np.arange(l_max + 1)) ** 2 * factors


def half_vectors(theta_o: float, l_max: int) -> tuple[Floats, Floats, Floats, Floats]:
    """Rings of half-vectors around the normal, as far as light over the horizon has them, for light of degree l_max.

    Returns theta_h (R,), directions (R, A, 3) on one side of the xz plane, in which the viewer is, and weights whose
    products, ring by ring, are areas of both sides: around the ring (R, A) and across it (R,).
    """
    theta, across = _panels(theta_o)
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
    return theta, half, around, across * np.sin(theta)


def viewer(theta_o: float) -> Floats:
    """Unit direction (3,) in the local xz plane."""
    return np.array([np.sin(theta_o), 0.0, np.cos(theta_o)])


def _rings(theta_o: float, l_max: int) -> tuple[Floats, Floats]:
    """theta_h (R,) and sums (R, (l_max + 1)^2) over the lit part of each ring, times dh (wo.h) / cos theta_o."""
    theta, half, around, across = half_vectors(theta_o, l_max)
    view = viewer(theta_o)
    toward = half @ view
    incident = 2 * toward[..., None] * half - view
    harmonics = evaluate_harmonics(incident, l_max).reshape(*toward.shape, -1)
    measure = around * np.maximum(toward, 0) / np.cos(theta_o)
    sums = (measure[:, None] @ harmonics)[:, 0] * across[:, None]
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
    unit, share = interval_rule(_NODES_PER_PANEL, 0, 1)
    width = np.diff(edges)[:, None]
    return (edges[:-1, None] + width * unit).ravel(), (width * share).ravel()
