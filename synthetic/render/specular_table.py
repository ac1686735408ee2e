"""What RH01's lobe gathers of an area light, tabled: of many points the integral is taken at few.

The lobe looks the same from all sides of its normal, and the light from all sides of its axis. So what a lobe gathers
depends on three angles only: that of the view with the normal, that of the light with the view, and the turn of the
normal about the view. It changes no faster than the light does.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import map_coordinates, spline_filter

Floats = NDArray[np.float64]

# Nodes to a width of the light, and of the lobe where the horizon cuts it: cubic splines are then off by less than
# 1e-5 of the peak.
_PER_LIGHT, _PER_LOBE = 7.0, 5.0
# Nodes beyond either end of an angle, over which what ends there does to splines has died away.
_BEYOND = 10
# Points at a time.
_AT_ONCE = 1 << 14


def node_count(sigma: float, width_rad: float) -> int:
    """How many integrals a table takes."""
    return int(np.prod(_counts(sigma, width_rad)))


def _counts(sigma: float, width_rad: float) -> tuple[int, int, int]:
    """Intervals of the exitant angle (to 90 degrees), of the light's polar angle and of its azimuth (to 180)."""
    step = width_rad / _PER_LIGHT
    # As the normal turns the mirrored view turns twice as far.
    exitant = min(step / 2, sigma / _PER_LOBE)
    exitants, turns = (max(int(np.ceil(count)), 2 * _BEYOND) for count in (np.pi / 2 / exitant, np.pi / step))
    return exitants, turns, turns


@dataclass(frozen=True, eq=False)
class SpecularTable:
    """Splines over what a lobe gathers, times the exitant cosine, for a light of unit radiance."""

    splines: Floats
    counts: tuple[int, int, int]

    @classmethod
    def of(
        cls, gathered: Callable[[Floats, Floats, Floats], Floats], sigma: float, width_rad: float
    ) -> SpecularTable:
        """Tabulate `gathered`: (n,) of unit normals, unit views (n, 3) and the light's axis (3,)."""
        counts = _counts(sigma, width_rad)
        angles = [np.linspace(0, end, count + 1) for end, count in zip((90, 180, 180), counts, strict=True)]
        # Edge-on nothing is tabled: the node there continues those before it.
        exitant, polar, azimuth = np.meshgrid(*map(np.radians, (angles[0][:-1], *angles[1:])), indexing="ij")
        zero = np.zeros_like(polar)
        # About a light on z: the view, the tangent at it towards the light, and what is normal to both.
        view = np.stack([np.sin(polar), zero, np.cos(polar)], axis=-1)
        towards = np.stack([-np.cos(polar), zero, np.sin(polar)], axis=-1)
        beside = np.stack([zero, zero + 1, zero], axis=-1)
        turned = np.cos(azimuth)[..., None] * towards + np.sin(azimuth)[..., None] * beside
        normal = np.cos(exitant)[..., None] * view + np.sin(exitant)[..., None] * turned
        shape, axis = exitant.shape, np.array([0.0, 0.0, 1.0])
        values = gathered(normal.reshape(-1, 3), view.reshape(-1, 3), axis).reshape(shape) * np.cos(exitant)
        return cls(spline_filter(_extended(values)), counts)

    def at(self, normals: Floats, views: Floats, axis: Floats) -> Floats:
        """What lobes gather (n,) of a light on an axis (3,); normals, views : (n, 3) unit, that face each other."""
        parts = np.array_split(np.arange(len(normals)), len(normals) // _AT_ONCE + 1)
        return np.concatenate([self._at(normals[part], views[part], axis) for part in parts])

    def _at(self, normals: Floats, views: Floats, axis: Floats) -> Floats:
        cos_o, lit, seen = (normals * views).sum(axis=1), normals @ axis, views @ axis
        sine = np.linalg.norm(np.cross(views, axis), axis=1)
        across = np.abs(np.cross(views, normals) @ axis)
        azimuth = np.arctan2(across, lit - seen * cos_o)
        angles = np.arccos(np.clip(cos_o, 0, 1)), np.arctan2(sine, seen), azimuth
        places = [
            angle / end * count + _BEYOND
            for angle, end, count in zip(angles, (np.pi / 2, np.pi, np.pi), self.counts, strict=True)
        ]
        # The azimuth ends at mirrors of itself, as splines of scipy's do.
        places[2] -= _BEYOND
        values: Floats = map_coordinates(self.splines, places, prefilter=False, mode="mirror")
        return values / np.maximum(cos_o, 1e-12)


def _extended(values: Floats) -> Floats:
    """A table continued beyond 0 and 90 degrees of the exitant angle, and beyond both poles of the light's."""
    # Beyond the last node, which lies before edge-on, a parabola through the last three continues them.
    beyond = np.arange(1.0, _BEYOND + 2)[:, None, None]
    slope, bend = values[-1] - values[-2], values[-1] - 2 * values[-2] + values[-3]
    after = values[-1] + beyond * slope + beyond * (beyond + 1) / 2 * bend
    values = np.concatenate([values[_BEYOND:0:-1, :, ::-1], values, after])
    flipped = values[..., ::-1]
    before, after = flipped[:, _BEYOND:0:-1], flipped[:, -2 : -_BEYOND - 2 : -1]
    return np.concatenate([before, values, after], axis=1)
