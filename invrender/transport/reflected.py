"""What a lobe reflects of a map towards all views, prepared once for many pixels; `reflectionmap` with shorter series.

In the frame of the mirrored view R, where the view is at azimuth phi_o', a lobe gathers

    B = sum_q cos(q phi_o') sum_l rho_lq(theta_o) L'_lq + sin(q phi_o') sum_l rho_lq(theta_o) L'_l-q

[R02, eq. 2.57, about R]. Harmonics Y_pq take what hangs on theta_o for smooth even where the view is grazing, and need
many p for that. Here the terms of `separated` stand in their place.

Measured against sums over 51,000 and more half-vectors per pixel, under maps of a cathedral and a square, for sigma of
0.1 and 0.3, mu 1.5 and cos theta_o above 0.15: off by 0.2 to 0.5% of the RMS radiance in the square, where the integral
pixel by pixel (`half_vectors`) is off by 0.05 to 0.3%; in the cathedral by up to 2% at angles beyond 60 degrees and by
0.5% else, where that is off by about 1%. Closer to grazing lobes are streaks, of higher degrees than these.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache
from threading import Lock

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import csr_array

from capture.lighting import latlong_directions, latlong_pixels, padded_latlong
from invrender.brdf.form import LobeForm
from invrender.brdf.microfacet import Microfacet
from invrender.prefilter.energy import power_per_degree
from invrender.prefilter.reflectionmap import mirrored_coefficients, reflected_terms
from invrender.prefilter.separated import mirrored_frame, separated_terms, tabulated
from invrender.theory.refinement import interval_rule
from invrender.transport.half_vectors import PAD
from invrender.transport.transfer import LightElement
from recon.harmonics.latlong import analyse_latlong, highest_degree, project_latlong
from recon.sampling.draw import MIN_COS_EXITANT

Floats = NDArray[np.float64]
Singles = NDArray[np.float32]

# Lobes below reach beyond the degrees.
LEAST_SIGMA = 0.1
# Degrees of the light and orders about the mirrored view; exitant angles from which the rest is interpolated, and the
# last of them.
_DEGREE, _ORDERS, _ANGLES = 64, 12, 24
_STEEPEST = float(np.arccos(MIN_COS_EXITANT))
# Share of the light field (RMS) that terms which are left out may hold.
_LEFT_OUT = 5e-4
# Rows of the maps: five to the shortest wave, which is the weakest.
_HEIGHT = 160
_LOOKUP, _PIXELS_AT_A_TIME = 2048, 8192
_ONE_AT_A_TIME = Lock()


@dataclass(frozen=True, eq=False)
class ReflectedMap:
    """Terms of what is reflected, on a grid of mirrored directions.

    maps : (H + 4, 2H + 4, K c) single precision, padded around. functions : (n, K), g of evenly spaced exitant angles.
    orders : (K,), q, < 0 for sines.
    """

    maps: Singles
    functions: Singles
    orders: NDArray[np.int64]

    # Least exitant cosine that `towards` holds for.
    least_cos = MIN_COS_EXITANT

    def towards(self, normals: Floats, views: Floats) -> Floats:
        """Radiance (m, c) per unit of Ks, Fresnel's factor included, at unit normals towards unit views, (m, 3) each.

        For cos theta_o of 0.15 and more; steeper views are taken for that.
        """
        parts = np.array_split(np.arange(len(normals)), -(-len(normals) // _PIXELS_AT_A_TIME) or 1)
        return np.concatenate([self._towards(normals[part], views[part]) for part in parts])

    def _towards(self, normals: Floats, views: Floats) -> Floats:
        cos = (normals * views).sum(axis=1)
        mirrored, phi = mirrored_frame(normals, views)
        angle = np.arccos(np.clip(cos, 0, 1)) / _STEEPEST * (len(self.functions) - 1)
        functions = self.functions[np.minimum(angle + 0.5, len(self.functions) - 1).astype(int)]
        q = np.abs(self.orders)
        waves = np.exp(1j * np.arange(q.max(initial=0) + 1) * phi[:, None]).astype(np.complex64)
        basis = functions * np.where(self.orders < 0, waves.imag[:, q], waves.real[:, q])
        terms = self._between_pixels(mirrored)
        seen = np.einsum("mkc,mk->mc", terms.reshape(len(cos), len(q), -1), basis)
        # Series that end swing about zero where it is dark.
        return np.maximum(seen, 0).astype(float)

    def _between_pixels(self, directions: Floats) -> Singles:
        """The maps (m, K c) in directions (m, 3), by cubics through four by four pixels."""
        height, width = self.maps.shape[0] - 2 * PAD, self.maps.shape[1]
        rows, row_weights = _cubic(latlong_pixels(directions, height)[0])
        columns, column_weights = _cubic(latlong_pixels(directions, height)[1])
        places = (rows[:, :, None] * width + columns[:, None, :]).reshape(-1)
        weights = (row_weights[:, :, None] * column_weights[:, None, :]).reshape(-1).astype(np.float32)
        starts = np.arange(len(directions) + 1) * 16
        shape = len(directions), self.maps.shape[0] * width
        return np.asarray(csr_array((weights, places, starts), shape) @ self.maps.reshape(shape[1], -1))


def prepared_map(brdf: Microfacet, light: LightElement) -> ReflectedMap | None:
    """What a BRDF's lobe reflects of an element's map, if it has both and the lobe is isotropic and wide enough."""
    if brdf.form.axis is not None or brdf.sigma is None or brdf.sigma < LEAST_SIGMA or light.slow_map is None:
        return None
    # Who needs the same for another photograph waits for it.
    with _ONE_AT_A_TIME:
        return reflected_map(brdf.form, brdf.mu, brdf.sigma, light)


@lru_cache(maxsize=2)
def reflected_map(form: LobeForm, mu: float | None, sigma: float, light: LightElement) -> ReflectedMap:
    """What a lobe reflects of an element's map; mu None without Fresnel's factor, sigma in radians, 0.1 or more.

    The last two are kept. Raises ValueError for a narrower lobe, whose degrees are too many, and without a map.
    """
    if not sigma >= LEAST_SIGMA:
        raise ValueError(f"sigma is {sigma:g}; reflected maps carry lobes of {LEAST_SIGMA} radians and more")
    if light.slow_map is None:
        raise ValueError(f"light {light.name!r} has no map to reflect")
    lighting = map_lighting(light, _DEGREE)
    angles, weights = interval_rule(_ANGLES, 0, _STEEPEST)
    orders, by_degree, functions = separated_terms(
        _at_angles(form, mu, sigma), weights, power_per_degree(lighting).sum(axis=1), _LEFT_OUT
    )
    lookup = np.linspace(0, _STEEPEST, _LOOKUP)
    smooth = tabulated(angles, functions, lookup)
    maps = np.moveaxis(reflected_terms(lighting, by_degree, orders, _HEIGHT), (0, 1), (2, 3))
    across = np.repeat((-1.0) ** orders, maps.shape[3])
    return ReflectedMap(
        # Across the poles frames are turned by 180 degrees.
        padded_latlong(
            maps.reshape(_HEIGHT, 2 * _HEIGHT, -1).astype(np.float32), PAD, across.astype(np.float32)
        ),
        (smooth / np.cos(lookup)[:, None]).astype(np.float32),
        orders,
    )


def map_lighting(light: LightElement, degree: int) -> Floats:
    """Coefficients of an element's map, ((degree + 1)^2, c).

    A coarse one is as smooth between its pixels as `PreparedMap` has it.
    """
    assert light.slow_map is not None
    if highest_degree(len(light.slow_map)) >= degree:
        return project_latlong(light.slow_map, degree)
    assert light.prepared_map is not None
    directions = latlong_directions(2 * degree + 2).astype(np.float32)
    return analyse_latlong(light.prepared_map.seen(directions, 0), degree)


@lru_cache(maxsize=8)
def _at_angles(form: LobeForm, mu: float | None, sigma: float) -> Floats:
    """rho_lq at the exitant angles, (_ANGLES, _DEGREE + 1, _ORDERS + 1)."""
    angles, _ = interval_rule(_ANGLES, 0, _STEEPEST)
    return mirrored_coefficients(form.lobe_of(mu, sigma), _DEGREE, _ORDERS, np.cos(angles))[0]


def _cubic(place: Floats) -> tuple[NDArray[np.int64], Floats]:
    """Indices (m, 4) into a padded axis of what lies around places (m,) and Catmull-Rom's weights (m, 4)."""
    below = np.floor(place - 0.5).astype(int)
    t = (place - 0.5 - below)[:, None]
    weights = np.concatenate(
        [
            t * (-1 + t * (2 - t)) / 2,
            1 + t * t * (-5 + 3 * t) / 2,
            t * (1 + t * (4 - 3 * t)) / 2,
            t * t * (t - 1) / 2,
        ],
        axis=1,
    )
    return below[:, None] + np.arange(-1, 3) + PAD, weights
