"""What a lobe reflects of a map towards all views: the reflection maps of a live picture [R02, section 5.4 and 5.8]."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from capture.lighting import padded_latlong
from invrender.brdf.microfacet import Microfacet
from invrender.output.live.lobe_volume import lobe_width
from invrender.prefilter.energy import power_per_degree
from invrender.prefilter.globalmap import interpolated
from invrender.prefilter.reflectionmap import mirrored_coefficients, reflected_terms
from invrender.prefilter.separated import mirrored_frame, separated_terms, tabulated
from invrender.theory.refinement import interval_rule
from invrender.transport.reflected import map_lighting
from invrender.transport.transfer import LightElement
from invrender.transport.visibility import MIN_COS

Floats = NDArray[np.float64]
Halves = NDArray[np.float16]

_STEEPEST = float(np.arccos(MIN_COS))
# Angles of the view at which the lobe is expanded, orders about its centre, and entries of the table of functions.
_ANGLES, _ORDERS, _ENTRIES = 32, 12, 128
# Of exp(-(l sigma / 2)^2) less than a fiftieth is left from this l sigma on; and the last degree.
_REACH, _MOST_DEGREE = 4.0, 80
# Shares (RMS) that terms may leave out, the least whose maps fit into so many bytes is taken.
_LEFT_OUT = (0.01, 0.02, 0.04, 0.08, 0.16)
_MOST_BYTES = 3_000_000
_ROWS_PER_DEGREE, _LEAST_ROWS = 1.6, 24


@dataclass(frozen=True, eq=False)
class LobeMaps:
    """B = sum_k g_k(theta_o) trig(q_k phi) maps_k(R), by the mirrored view R and the view's azimuth phi about it.

    maps : (K, rows + 2, 2 rows, 3), a row more across each pole. functions : (n, K), g_k cos theta_o at angles that go
    evenly from 0 to that of `visibility.MIN_COS`. orders : (K,), q_k, < 0 for sines.
    """

    maps: Halves
    functions: Halves
    orders: NDArray[np.int64]

    def towards(self, normals: Floats, views: Floats) -> Floats:
        """Radiance (m, 3) per unit of Ks, at unit normals (m, 3) towards unit views (m, 3)."""
        cos = np.clip((normals * views).sum(axis=1), MIN_COS, 1)
        mirrored, phi = mirrored_frame(normals, views)
        entry = np.arccos(cos) / _STEEPEST * (len(self.functions) - 1)
        total = np.zeros_like(normals)
        for q, function, values in zip(self.orders, self.functions.T, self.maps, strict=True):
            wave = np.sin(-q * phi) if q < 0 else np.cos(q * phi)
            weight = wave * np.interp(entry, np.arange(len(function)), function.astype(float)) / cos
            inner = values[1:-1].astype(np.float32).transpose(2, 0, 1)
            total += weight[:, None] * interpolated(inner, mirrored)
        # Series that end swing about zero where it is dark.
        return np.maximum(total, 0)


def no_maps() -> LobeMaps:
    """Maps of a lobe that reflects nothing."""
    return LobeMaps(np.zeros((1, 3, 2, 3), np.float16), np.zeros((2, 1), np.float16), np.zeros(1, np.int64))


def lobe_maps(brdf: Microfacet, light: LightElement, unit: float) -> LobeMaps:
    """The maps of a BRDF's isotropic lobe under an element's map, over a unit of radiance; zero without either.

    As many terms are kept as fit into 3 MB; `LobeMaps.towards` shows what that leaves out.
    """
    if brdf.sigma is None or not brdf.ks.any() or light.slow_map is None:
        return no_maps()
    degree = min(int(np.ceil(_REACH / lobe_width(brdf))), _MOST_DEGREE)
    rows = max(int(_ROWS_PER_DEGREE * degree), _LEAST_ROWS)
    lighting = map_lighting(light, degree)
    angles, weights = interval_rule(_ANGLES, 0, _STEEPEST)
    lobe = brdf.form.lobe_of(brdf.mu, brdf.sigma)
    rho = mirrored_coefficients(lobe, degree, _ORDERS, np.cos(angles))[0]
    power = power_per_degree(lighting).sum(axis=1)
    for left_out in _LEFT_OUT:
        # A ball shows angles by sin(2 theta_o).
        orders, by_degree, functions = separated_terms(rho, weights * np.sin(2 * angles), power, left_out)
        if len(orders) * rows * 2 * rows * 6 <= _MOST_BYTES:
            break
    even = np.linspace(0, _STEEPEST, _ENTRIES)
    table = tabulated(angles, functions, even)
    maps = reflected_terms(lighting / unit, by_degree, orders, rows)
    # Across the poles frames are turned by 180 degrees.
    across = np.repeat((-1.0) ** orders, 3)
    flat = np.moveaxis(maps, (0, 1), (2, 3)).reshape(rows, 2 * rows, -1)
    padded = padded_latlong(flat, 1, across.astype(np.float32))[:, 1:-1]
    layers = np.moveaxis(padded.reshape(rows + 2, 2 * rows, len(orders), 3), 2, 0)
    return LobeMaps(layers.astype(np.float16), table.astype(np.float16), orders)
