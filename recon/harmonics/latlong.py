"""Spherical harmonic analysis and synthesis on lat-long grids in O(l_max S^2) [R02, eq. 5.21].

A harmonic is a function of theta times a wave in phi. The waves are separated first, by FFT along the rows; what is
left is one short matrix product per order m, between the rows and the degrees.
"""

from __future__ import annotations

from functools import lru_cache

import numpy as np
import scipy.fft
from numpy.typing import ArrayLike, NDArray

from capture.lighting import latlong_solid_angles
from recon.harmonics.basis import check_degree, degree_of, finite, to_degree

Floats = NDArray[np.float64]

_ROWS = 128


def highest_degree(height: int) -> int:
    """The highest degree that a grid of `height` rows carries: products of two such functions it integrates exactly."""
    return (height - 1) // 2


def analyse_latlong(values: ArrayLike, l_max: int) -> Floats:
    """Coefficients ((l_max + 1)^2, c) of a function given at the centres of a lat-long grid's pixels, (H, 2H, c).

    Exact for functions of degree up to `highest_degree(H)`: Fejer's first rule in theta, equal steps in phi. Of a map
    whose pixels are means over their areas, `project_latlong` in `harmonics` is what conserves light. Raises ValueError
    for values that aren't finite or not of that shape, and for an l_max that the grid can't carry.
    """
    if np.iscomplexobj(values):
        raise ValueError("the lat-long grid is complex; analyse its real and imaginary parts on their own")
    values = np.asarray(values, float)
    return weighted_analysis(values, l_max, _fejer_weights(_checked_height(values)))


def project_latlong(radiance_map: ArrayLike, l_max: int) -> Floats:
    """Coefficients ((l_max + 1)^2, c) of a lat-long map (H, 2H, c) whose pixels are means over their areas.

    Each pixel counts with its solid angle, so that a lamp in a single pixel keeps its light; of a function that varies
    smoothly the error is of second order in the pixel. Raises ValueError as `analyse_latlong`.
    """
    radiance_map = np.asarray(radiance_map, float)
    height = _checked_height(radiance_map)
    return weighted_analysis(radiance_map, l_max, latlong_solid_angles(height)[:, 0] * 2 * height)


def integrate_latlong(radiance_map: ArrayLike, l_max: int) -> Floats:
    """Coefficients ((l_max + 1)^2, c) of a lat-long map (H, 2H, c) that is constant within each pixel, to rounding.

    Any degree, whatever the map's height: steps have all degrees. Raises ValueError for values that aren't finite, not
    of that shape, and for an l_max below 0.
    """
    radiance_map = np.asarray(radiance_map, float)
    height = _checked_height(radiance_map)
    check_degree(l_max)
    step, m = np.pi / height, np.arange(l_max + 1)
    # In phi by the integral of a wave over a pixel, in theta by Gauss-Legendre within each row. Some rows at a time,
    # since the waves of a large map take twice its memory.
    parts = [radiance_map[start : start + _ROWS] for start in range(0, height, _ROWS)]
    waves = np.concatenate([scipy.fft.fft(part, axis=1)[:, m % (2 * height)] for part in parts]).transpose(
        1, 0, 2
    )
    waves *= (step * np.sinc(m / (2 * height)) * np.exp(-0.5j * step * m))[:, None, None]
    node, weight = np.polynomial.legendre.leggauss(int(np.ceil(l_max * step / 2)) + 4)
    theta = ((np.arange(height)[:, None] + (node + 1) / 2) * step).ravel()
    weighted = theta_factors(np.cos(theta), l_max) * (np.tile(weight, height) * step / 2 * np.sin(theta))
    rows = weighted.reshape(l_max + 1, l_max + 1, height, -1).sum(axis=-1)
    found = rows @ np.concatenate([waves.real, -waves.imag], axis=2)
    channels = radiance_map.shape[2]
    result = np.empty(((l_max + 1) ** 2, channels))
    cosine, sine = _places(l_max)
    l, m = np.tril_indices(l_max + 1)
    result[cosine] = found[m, l, :channels]
    result[sine[m > 0]] = found[m[m > 0], l[m > 0], channels:]
    return result


def map_coefficients(radiance_map: ArrayLike, l_max: int) -> Floats:
    """As `project_latlong`, whatever the map's height: degrees that it can't carry are 0."""
    height = len(np.asarray(radiance_map))
    return to_degree(project_latlong(radiance_map, min(l_max, highest_degree(height))), l_max)


def weighted_analysis(values: Floats, l_max: int, row_weights: Floats) -> Floats:
    """Sum over a grid of values (H, 2H, c) times harmonics, times weights (H,) of whole rows in steradian."""
    height = len(values)
    check_carried(l_max, height)
    waves = scipy.fft.rfft(values, axis=1)[:, : l_max + 1].transpose(1, 0, 2)
    turned = (_half_pixel(height, l_max)[:, None, None] / (2 * height)) * (waves * row_weights[:, None])
    # Pixel centres are half a pixel off phi = 0; real and imaginary parts go through one product.
    parts = np.concatenate([turned.real, turned.imag], axis=2)
    found = _table(height, l_max) @ parts
    channels = values.shape[2]
    result = np.empty(((l_max + 1) ** 2, channels))
    cosine, sine = _places(l_max)
    l, m = np.tril_indices(l_max + 1)
    result[cosine] = found[m, l, :channels]
    result[sine[m > 0]] = -found[m[m > 0], l[m > 0], channels:]
    return result


def synthesise_latlong(coefficients: ArrayLike, height: int) -> Floats:
    """Values (height, 2 height, c) at the centres of a lat-long grid's pixels of coefficients ((l_max + 1)^2, c).

    Raises ValueError for a wrong number of coefficients, ones that aren't finite, or a grid too coarse to carry them.
    """
    coefficients = finite(np.asarray(coefficients, float), "coefficients")
    l_max = degree_of(len(coefficients))
    check_carried(l_max, height)
    channels = coefficients.shape[1]
    by_order = np.zeros((l_max + 1, l_max + 1, 2 * channels))
    cosine, sine = _places(l_max)
    l, m = np.tril_indices(l_max + 1)
    by_order[m, l, :channels] = coefficients[cosine]
    by_order[m[m > 0], l[m > 0], channels:] = -coefficients[sine[m > 0]]
    rows = _table(height, l_max).transpose(0, 2, 1) @ by_order
    waves = np.zeros((height, height + 1, channels), complex)
    waves[:, : l_max + 1] = (rows[..., :channels] + 1j * rows[..., channels:]).transpose(1, 0, 2)
    waves[:, : l_max + 1] *= _half_pixel(height, l_max).conj()[:, None]
    waves[:, 1:] /= 2
    return np.asarray(scipy.fft.irfft(waves, 2 * height, axis=1, norm="forward"))


def theta_factors(cos_theta: ArrayLike, l_max: int) -> Floats:
    """f_lm(theta) of real harmonics, (l_max + 1, l_max + 1, n): first m >= 0, then l; 0 where l < m.

    y_lm = f_lm cos(m phi), y_l-m = f_lm sin(m phi): N_lm |P_lm|, with sqrt(2) for m > 0. cos_theta : (n,). By the usual
    recurrence in l, normalised throughout so that nothing overflows.
    """
    z = np.asarray(cos_theta, float)
    sin = np.sqrt(np.maximum(1 - z * z, 0))
    table = np.zeros((l_max + 1, l_max + 1, len(z)))
    corner = np.full(len(z), np.sqrt(1 / (4 * np.pi)))
    for m in range(l_max + 1):
        if m:
            corner = corner * sin * np.sqrt((2 * m + 1) / (2 * m)) * (np.sqrt(2) if m == 1 else 1)
        table[m, m] = corner
        for l in range(m + 1, l_max + 1):
            up = np.sqrt((4 * l * l - 1) / (l * l - m * m))
            table[m, l] = up * z * table[m, l - 1]
            if l > m + 1:
                down = np.sqrt(((l - 1) ** 2 - m * m) / (4 * (l - 1) ** 2 - 1))
                table[m, l] -= up * down * table[m, l - 2]
    return table


def _checked_height(values: Floats) -> int:
    if values.ndim != 3 or values.shape[1] != 2 * values.shape[0] or not values.size:
        raise ValueError(f"a lat-long grid is (H, 2H, channels), not {values.shape}")
    finite(values, "lat-long grid")
    return len(values)


def check_carried(l_max: int, height: int) -> None:
    """Raise ValueError for a degree that a lat-long grid of `height` rows can't carry."""
    check_degree(l_max)
    if l_max > highest_degree(height):
        raise ValueError(
            f"l_max is {l_max}; a lat-long grid of {height} rows carries degrees up to {highest_degree(height)}: take a"
            f" finer one ({2 * l_max + 1} rows or more) or a lower l_max"
        )


@lru_cache(maxsize=16)
def _table(height: int, l_max: int) -> Floats:
    return theta_factors(np.cos((np.arange(height) + 0.5) * np.pi / height), l_max)


@lru_cache(maxsize=16)
def _fejer_weights(height: int) -> Floats:
    """Weights (H,) of rows, steradian: Fejer's first rule, exact for polynomials in cos theta below degree H."""
    theta = (np.arange(height) + 0.5) * np.pi / height
    k = np.arange(1, height // 2 + 1)
    # For even H the last wave is 0 at all nodes.
    waves = np.cos(2 * np.outer(theta, k)) / (4 * k * k - 1)
    return 4 * np.pi / height * (1 - 2 * waves.sum(axis=1))


def _half_pixel(height: int, l_max: int) -> NDArray[np.complex128]:
    return np.exp(-0.5j * np.pi / height * np.arange(l_max + 1))


@lru_cache(maxsize=16)
def _places(l_max: int) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """Places of cos(m phi) and sin(m phi) among the coefficients, for all (l, m >= 0) in `tril_indices` order."""
    l, m = np.tril_indices(l_max + 1)
    return l * l + l + m, l * l + l - m
