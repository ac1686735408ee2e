"""RH01's lobe as a filter of harmonic lighting, for all roughnesses at once.

What a lobe of facets sends to a viewer at theta_o, per unit of Ks F, is the integral over half-vectors

    S(theta_h; sigma) L(wi(h)) (wo.h) / cos theta_o dh     over  n.wi > 0

of which only S holds sigma. So the harmonics are summed once along each ring of half-vectors around the normal, where
the light is above the horizon, and a roughness is a weight per ring. These are the rho^_lq(theta_o) of [R02, eq.
2.56] in real harmonics; nothing is approximated but by quadrature.

That is the transfer `exact`. Two coarser transfers are RH01's own: light looked up in the mirror direction as it is
(`mirror`, eq. 22), or after the lobe has blurred it (`filtered`, eq. 22 of light filtered by eq. 20).
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from functools import lru_cache
from typing import Literal, get_args

import numpy as np
from numpy.polynomial.chebyshev import chebpts2, chebvander
from numpy.typing import NDArray
from scipy.sparse import csr_array

from invrender.theory.operator import view_frames
from invrender.theory.refinement import interval_rule
from invrender.theory.specialcases import lobe, microfacet_gaussian
from recon.harmonics.basis import degree_of, degrees, evaluate_harmonics, orders
from recon.harmonics.rotations import Orders, rotated_orders
from recon.sampling.draw import MIN_COS_EXITANT
from recon.sampling.lightfield import LightField

Floats = NDArray[np.float64]
Singles = NDArray[np.float32]
Transfer = Literal["exact", "filtered", "mirror"]
TRANSFERS: tuple[Transfer, ...] = get_args(Transfer)

# Edges of panels in theta_h, radians, so that lobes of any roughness meet enough nodes; more where the horizon begins
# to cut a ring and where it has cut all of it.
_EDGES = (0.0, 0.03, 0.08, 0.2, 0.5, 1.0, np.pi / 2)
_NODES_PER_PANEL = 16
# Exitant angles of the table, beyond as many as there are degrees, and the steepest of them.
_SPARE_ANGLES = 17
_STEEPEST = float(np.arccos(MIN_COS_EXITANT)) + 0.02
# Coefficients that are turned at a time: some megabytes of all that is needed for them.
_AT_A_TIME = 2**18


@dataclass(frozen=True, eq=False)
class LobeTable:
    """Ring sums of the harmonics of degree up to l_max, seen at J exitant angles.

    rings : (J, R), theta_h. sums : (J, R, k), of a viewer in the local xz plane, times the measure: what S at a ring
    multiplies; of orders m >= 0 only, since those of -m are zero.
    """

    rings: Floats
    sums: Floats

    def at_angles(self, sigma: float) -> Floats:
        """Local transfer of roughness sigma (radians), per unit of Ks F, and its slope in log sigma, (J, 2, k)."""
        weights = lobe(self.rings, sigma)
        both = np.stack([weights, weights * (2 * (self.rings / sigma) ** 2 - 2)], axis=1)
        return np.asarray(both @ self.sums)


@lru_cache(maxsize=4)
def lobe_table(l_max: int) -> LobeTable:
    """The table for lighting of degree l_max and all exitant angles that samples may have."""
    rings, sums = zip(*(_rings(float(angle), l_max) for angle in exitant_angles(l_max)), strict=True)
    return LobeTable(np.stack(rings), np.stack(sums))


def exitant_angles(l_max: int) -> Floats:
    """Angles (J,) between which coefficients of degree up to l_max are interpolated, to beyond what samples have."""
    return np.asarray(_STEEPEST / 2 * (1 - chebpts2(l_max + _SPARE_ANGLES)[::-1]))


def over_angles(at_angles: Floats) -> Floats:
    """Chebyshev series (k, f, J) in the exitant angle through values (J, f, k) at `exitant_angles`."""
    count = len(at_angles)
    at_nodes = chebvander(chebpts2(count)[::-1], count - 1)
    series = np.linalg.solve(at_nodes, at_angles.reshape(count, -1)).reshape(at_angles.shape)
    return np.ascontiguousarray(series.transpose(2, 1, 0))


def at_cosines(series: NDArray[np.floating], cos_exitant: Floats) -> NDArray[np.floating]:
    """Values (k, f, n) at exitant cosines (n,) of `over_angles`' series (k, f, J), in the series' precision."""
    # Polynomials run wild beyond their nodes: steeper views see what the steepest of the table does.
    seen = np.minimum(np.arccos(np.minimum(cos_exitant, 1)), _STEEPEST)
    functions = chebvander(1 - 2 * seen / _STEEPEST, series.shape[-1] - 1).T.astype(series.dtype)
    values = series.reshape(-1, len(functions)) @ functions
    return np.asarray(values.reshape(*series.shape[:-1], -1))


def turned_lobes(
    field: LightField, series: Singles, factor: Floats | None = None
) -> Iterator[tuple[slice, Orders]]:
    """Lobes of an `over_angles` series (k, f, J) as rays see them in the world, some rays at a time.

    factor : (m,), what each ray's are multiplied by. Yields which rays, and their lobes' coefficients.
    """
    k, f, _ = series.shape
    count = max(1, _AT_A_TIME // (k * f))
    for start in range(0, len(field.normals), count):
        here = slice(start, start + count)
        normals, views = field.normals[here], field.views[here]
        local = at_cosines(series, np.einsum("nk,nk->n", normals, views))
        if factor is not None:
            local *= factor[here].astype(local.dtype)
        # What is the same in all directions stays as it is.
        yield (
            here,
            (
                Orders(local, np.zeros_like(local))
                if k == 1
                else rotated_orders(local, view_frames(normals, views))
            ),
        )


def lobe_rows(field: LightField, at_angles: Floats, factor: Floats | None = None) -> Singles:
    """Rows (f, m, (l_max + 1)^2) of rays over lighting coefficients, single precision, of lobes (J, f, k)."""
    series = over_angles(at_angles).astype(np.float32)
    l_max = len(at_angles) - _SPARE_ANGLES
    rows = np.empty((series.shape[1], len(field.normals), (l_max + 1) ** 2), np.float32)
    for here, turned in turned_lobes(field, series, factor):
        turned.write(rows[:, here])
    return rows


def mean_lobe_rows(field: LightField, at_angles: Floats, factors: Sequence[tuple[int, Floats]]) -> Singles:
    """Means of `lobe_rows` over the rays of samples, which aren't kept: (r, n, (l_max + 1)^2), r as many as factors.

    factors : which of the f lobes, and what each ray's are multiplied by, (m,).
    """
    series = over_angles(at_angles).astype(np.float32)
    l_max = len(at_angles) - _SPARE_ANGLES
    rows = np.zeros((len(factors), len(field), (l_max + 1) ** 2), np.float32)
    counts = np.bincount(field.ray_sample, minlength=len(field))
    weights = [(f, (factor / counts[field.ray_sample]).astype(np.float32)) for f, factor in factors]
    for here, turned in turned_lobes(field, series):
        own = field.ray_sample[here]
        of_rays = np.empty((series.shape[1], len(own), rows.shape[-1]), np.float32)
        turned.write(of_rays)
        samples = slice(int(own[0]), int(own[-1]) + 1)
        ends = np.searchsorted(own, np.arange(samples.start, samples.stop + 1))
        for mine, (f, weight) in zip(rows, weights, strict=True):
            # A sample's rays may be among the last of one turn and the first of the next.
            mine[samples] += csr_array((weight[here], np.arange(len(own)), ends)) @ of_rays[f]
    return rows


def lobe_radiance(
    field: LightField, at_angles: Floats, lighting: Floats, factor: Floats | None = None
) -> Floats:
    """What each ray sees (m, c) of lighting ((l_max + 1)^2, c) in a lobe (J, k)."""
    series, single = over_angles(at_angles[:, None]).astype(np.float32), lighting.astype(np.float32)
    radiance = np.empty((len(field.normals), lighting.shape[1]))
    for here, turned in turned_lobes(field, series, factor):
        radiance[here] = turned.dot(single)[0]
    return radiance


def specular_rows(field: LightField, l_max: int, sigma: float, transfer: Transfer = "exact") -> Singles:
    """Rows of rays over lighting coefficients of the specular part, and their slopes in log sigma.

    (2, m, (l_max + 1)^2), single precision, per unit of Ks F, of unshadowed surfaces.
    """
    if transfer == "exact":
        return lobe_rows(field, lobe_table(l_max).at_angles(sigma))
    at_mirror = mirrored_harmonics(field, l_max)
    return np.stack(
        [(at_mirror * by[degrees(l_max)]).astype(np.float32) for by in _blur(sigma, l_max, transfer)]
    )


def specular_radiance(
    field: LightField, lighting: Floats, sigma: float, transfer: Transfer = "exact"
) -> Floats:
    """What each ray (m, c) sees of lighting ((l_max + 1)^2, c) in the lobe, per unit of Ks F; unshadowed."""
    l_max = degree_of(len(lighting))
    if transfer != "exact":
        blurred = lighting * _blur(sigma, l_max, transfer)[0][degrees(l_max), None]
        return np.asarray(mirrored_harmonics(field, l_max) @ blurred)
    return lobe_radiance(field, lobe_table(l_max).at_angles(sigma)[:, 0], lighting)


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
    # Both sides of the xz plane were counted on one: what is odd in azimuth cancels.
    return theta, ((measure[:, None] @ harmonics)[:, 0] * across[:, None])[:, orders(l_max) >= 0]


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
