"""A measured BRDF as lobes without a formula: between the values of a table over half and difference angles.

Measurements at scattered pairs of directions are brought onto such a table first. Towards the horizon, where nothing
was measured, the nearest measured value stands.
"""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from scipy.interpolate import RBFInterpolator
from scipy.ndimage import distance_transform_edt
from scipy.sparse import csr_array

from capture.reflectance.merl import read_merl
from capture.reflectance.samples import ReflectanceSamples
from invrender.brdf.form import Lobe
from invrender.inverse_brdf.halfangles import HalfAngles, directions, half_angles
from invrender.inverse_brdf.measured import read_measured
from invrender.inverse_brdf.table import bin_centres

Floats = NDArray[np.float64]

# Of tables that scattered samples are brought onto.
_BINS = (72, 60, 24)
# Of more samples than that so many around a table's bin count; of fewer all.
_MANY, _NEIGHBOURS = 4000, 60
# Reflectance in 1/sr below which differences count as such, not as ratios.
_DARK = 1e-3
_UP = np.array([0.0, 0.0, 1.0])


def measured_table(path: Path) -> Floats:
    """The table (n_h, n_d, n_p, 3) of a measured BRDF, 1/sr, as `BRDFTable` has its bins; without gaps.

    path : as of `read_measured`, which says what is wrong with other files. Negative values, of colours outside the
    gamut, become 0. Raises ValueError where nothing was measured.
    """
    if path.suffix == ".binary":
        return _without_gaps(read_merl(path))
    samples = read_measured(path)
    if not len(samples):
        raise ValueError(f"{path}: holds no values with light and sensor above the surface")
    return scattered_table(samples)


def scattered_table(samples: ReflectanceSamples) -> Floats:
    """The same of scattered samples: linear in the logarithms of the nearest ones; the mean of those of one place.

    Directions that lean further than any that was measured reflect as if they leaned that far.
    """
    # Light and sensor can be exchanged; the turn of the light about the half vector means nothing where that is
    # upright or the two directions meet.
    places = _embedded(half_angles(_UP, samples.wi, samples.wo))
    places, of_sample = np.unique(places.round(9), axis=0, return_inverse=True)
    of_place = csr_array((np.ones(len(samples)), (of_sample, np.arange(len(samples)))))
    means = (of_place @ samples.rgb) / of_place.sum(axis=1)[:, None]
    logs = np.log(np.maximum(means, 0) + _DARK)
    spline = RBFInterpolator(
        places, logs, neighbors=_NEIGHBOURS if len(places) > _MANY else None, kernel="linear", degree=0
    )
    # Mirrored and exchanged directions reflect alike: half of phi_d holds all.
    half = _BINS[2] // 2
    steepest = min(float(samples.wi[:, 2].min()), float(samples.wo[:, 2].min()))
    wi, wo = (_raised(w[:, :, :half], steepest) for w in directions(bin_centres(_BINS)))
    found = spline(_embedded(half_angles(_UP, wi, wo)).reshape(-1, 3)).clip(
        logs.min(axis=0), logs.max(axis=0)
    )
    values = np.maximum(np.exp(found) - _DARK, 0).reshape(*_BINS[:2], half, 3)
    return np.concatenate([values, values[:, :, ::-1]], axis=2)


def _raised(w: Floats, least: float) -> Floats:
    """Directions (..., 3) that lean no further from the normal than to a cosine of `least`."""
    level = np.linalg.norm(w[..., :2], axis=-1, keepdims=True)
    up = np.maximum(w[..., 2:], least)
    flat = w[..., :2] * np.sqrt(1 - np.minimum(up, 1) ** 2) / np.maximum(level, 1e-12)
    return np.concatenate([flat, up], axis=-1)


def table_lobes(values: Floats) -> Sequence[Lobe]:
    """Lobes of the three channels of a table without gaps: the BRDF times the cosine of incidence, linear between bins'
    centres, 0 below the horizon."""
    return [_lobe(np.ascontiguousarray(values[..., channel])) for channel in range(3)]


def _lobe(values: Floats) -> Lobe:
    _, n_d, n_p = values.shape

    def lobe(normals: Floats, wi: Floats, wo: Floats) -> Floats:
        angles = half_angles(normals, wi, wo)
        cos_i, cos_o = (normals * wi).sum(axis=-1), (normals * wo).sum(axis=-1)
        shares = (np.sqrt(angles.theta_h * (2 / np.pi)), angles.theta_d * (2 / np.pi), angles.phi_d / np.pi)
        total = np.zeros(np.broadcast(cos_i, cos_o).shape)
        steps = []
        for share, count in zip(shares, values.shape, strict=True):
            place = (share * count - 0.5).clip(0, count - 1)
            low = np.minimum(place.astype(int), max(count - 2, 0))
            steps.append((low, np.minimum(low + 1, count - 1), place - low))
        (h0, h1, h), (d0, d1, d), (p0, p1, p) = steps
        flat = values.ravel()
        for at_h, of_h in ((h0, 1 - h), (h1, h)):
            for at_d, of_d in ((d0, 1 - d), (d1, d)):
                row = (at_h * n_d + at_d) * n_p
                total += of_h * of_d * ((1 - p) * flat[row + p0] + p * flat[row + p1])
        return np.where((cos_i > 0) & (cos_o > 0), total * cos_i, 0)

    return lobe


def _embedded(angles: HalfAngles) -> Floats:
    """Coordinates (..., 3) in which pairs that reflect alike are near: the root spreads highlights."""
    turn = np.sin(angles.theta_h) * np.sin(angles.theta_d) * np.abs(np.cos(angles.phi_d))
    return np.stack([np.sqrt(angles.theta_h), angles.theta_d, turn], axis=-1)


def _without_gaps(values: Floats) -> Floats:
    """Each bin without a value gets the nearest one's, counted in bins."""
    missing = ~np.isfinite(values).all(axis=-1)
    if missing.all():
        raise ValueError("no value of the table is finite: nothing was measured")
    nearest = distance_transform_edt(missing, return_distances=False, return_indices=True)
    return np.maximum(values[tuple(nearest)], 0)
