"""What a lobe reflects of a map towards a camera that looks at a sphere: integrated on a grid, interpolated between.

Under distant light what a lobe gathers hangs on the normal and the view alone [RMB07, section 4.5]. All rays from a
camera to a sphere are a family of two numbers, the turn of the normal from the camera's direction and the azimuth about
it. Over normals, what is reflected of any map changes over no less than the lobe's width; so an even grid serves.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field
from functools import cached_property
from threading import Lock

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import map_coordinates, spline_filter

from capture.camera import Camera
from invrender.brdf.fresnel import normalised_fresnel
from recon.mesh.bodies import Body, SphereBody
from recon.mesh.tangents import tangents

Floats = NDArray[np.float64]
# Normals and views (m, 3) to what is reflected, (m, c).
Integral = Callable[[Floats, Floats], Floats]

# A grid's spacing in widths of the lobe, and the tolerance that it is for: cubics are off by its fourth power.
_SPACING, _FOR_TOLERANCE, _ORDER = 0.5, 0.005, 4
_LEAST_SPACING, _MOST_SPACING = 0.2, 1.1
# Towards the outline rings lie closer: so many more for each time that the distance from it falls to 1/e, down to the
# second number, radians.
_MORE, _OUTLINE = 2.0, 0.02
# Rows and columns by which a grid is continued beyond its ends: a cubic spline forgets what lies further off.
_BEYOND = 8
# Exitant cosine of the last ring: at zero there is no lobe.
_LEAST_COS = 1e-3
# Turns that numbers of rings are computed for, to look up the others.
_FINE = 4096


@dataclass(frozen=True)
class SphereRays:
    """All rays from a camera to a sphere.

    towards : (3,) unit, from the sphere's centre to the camera. closeness : the radius over the distance of the camera
    from the centre, below 1; 0 for one infinitely far away.
    """

    towards: tuple[float, float, float]
    closeness: float

    @staticmethod
    def of(body: Body, camera: Camera) -> SphereRays | None:
        """Of a camera that looks at a body from outside, if that is a sphere."""
        if not isinstance(body, SphereBody):
            return None
        if camera.is_orthographic:
            x, y, z = (-camera.camera_to_world[:3, 2]).tolist()
            return SphereRays((x, y, z), 0.0)
        if body.clearance(camera.centre) <= 0:
            return None
        way = camera.centre - body.centre
        distance = float(np.linalg.norm(way))
        x, y, z = (way / distance).tolist()
        return SphereRays((x, y, z), body.sphere.radius / distance)

    def views(self, normals: Floats) -> Floats:
        """Unit views (m, 3) from where the sphere has unit normals, (m, 3)."""
        views = np.array(self.towards) - self.closeness * normals
        return np.asarray(views / np.linalg.norm(views, axis=1, keepdims=True))


@dataclass(frozen=True, eq=False)
class SphereLobe:
    """A lobe's reflection of a map, over the rays to a sphere: its integral is taken on a grid, when first asked for.

    rays : to the sphere. integral : what is reflected, ray by ray. width : of the lobe, radians. mu : of its Fresnel
    factor, if it has one. tolerance : RMS error of the interpolation over the reflection's RMS, > 0.
    """

    rays: SphereRays
    integral: Integral
    width: float
    mu: float | None
    tolerance: float
    _making: Lock = field(default_factory=Lock, repr=False)

    def towards(self, normals: Floats, views: Floats) -> Floats:
        """What is reflected (m, c) at unit normals towards unit views, (m, 3) each, which are of the family."""
        with self._making:
            splines = self._splines
        axis, along, across = self._frame
        rings, sectors = len(self._nodes), self._sectors
        turn = np.arccos(np.clip(normals @ axis, -1, 1))
        ring = (rings - 1) * (1 - self._rings_beyond(turn) / self._rings_beyond(np.zeros(1)))
        azimuth = np.arctan2(normals @ across, normals @ along) % (2 * np.pi)
        places = np.array([ring, azimuth * sectors / (2 * np.pi)]) + _BEYOND
        smooth = [map_coordinates(spline, places, order=3, prefilter=False) for spline in splines]
        return np.asarray(np.maximum(np.transpose(smooth), 0) * self._factor(normals, views)[:, None])

    @property
    def count(self) -> int:
        """How many integrals it takes."""
        return int(self._nodes.sum())

    @property
    def _frame(self) -> Floats:
        """The direction of the camera, and two axes across it, (3, 3)."""
        axis = np.array(self.rays.towards)
        return np.vstack([axis, tangents(axis)])

    @cached_property
    def _spacing(self) -> float:
        ratio = (self.tolerance / _FOR_TOLERANCE) ** (1 / _ORDER)
        return self.width * float(np.clip(_SPACING * ratio, _LEAST_SPACING, _MOST_SPACING))

    @cached_property
    def _outline(self) -> float:
        """Turn of the last ring, radians, where views have the least exitant cosine."""
        outline = float(np.arccos(self.rays.closeness))
        return max(outline - _LEAST_COS, outline / 2)

    def _rings_beyond(self, turn: Floats) -> Floats:
        """How many rings lie between turns and the outline, not only whole ones; none beyond it."""
        apart = np.maximum(self._outline - turn, 0)
        return np.asarray(apart / self._spacing + _MORE * np.log1p(apart / _OUTLINE))

    @cached_property
    def _turns(self) -> Floats:
        """Of the rings, from the camera's direction to the outline, (rings,) radians."""
        turns = np.linspace(self._outline, 0, _FINE)
        beyond = self._rings_beyond(turns)
        rings = max(int(np.ceil(beyond[-1])), _BEYOND) + 1
        return np.interp(np.linspace(0, beyond[-1], rings), beyond, turns)[::-1]

    @cached_property
    def _nodes(self) -> NDArray[np.int64]:
        """How many of each ring, (rings,): as many as it is long, and an odd number for Fourier's series."""
        half = np.ceil(np.pi * np.sin(self._turns) / self._spacing).astype(int)
        return np.maximum(2 * half, _BEYOND) + 1

    @property
    def _sectors(self) -> int:
        """Azimuths that all rings are continued to, an even number."""
        return int(self._nodes.max()) + 1

    def _factor(self, normals: Floats, views: Floats) -> Floats:
        """What makes the reflection change fast near grazing, (m,): splines leave it out."""
        cos = np.maximum((normals * views).sum(axis=1), 1e-6)
        return np.asarray(normalised_fresnel(self.mu, cos) / cos)

    @cached_property
    def _splines(self) -> Floats:
        """Coefficients of cubic splines (c, rings, sectors) of the reflection less its factor, continued all around."""
        axis, along, across = self._frame
        turn = self._turns.repeat(self._nodes)[:, None]
        azimuth = np.concatenate([np.arange(count) * (2 * np.pi / count) for count in self._nodes])[:, None]
        out = np.cos(azimuth) * along + np.sin(azimuth) * across
        normals = np.cos(turn) * axis + np.sin(turn) * out
        views = self.rays.views(normals)
        values = self.integral(normals, views) / self._factor(normals, views)[:, None]
        rings = np.split(values, np.cumsum(self._nodes)[:-1])
        # Fourier's series of each ring, at all sectors.
        series = [np.fft.rfft(ring, axis=0, norm="forward") for ring in rings]
        grid = np.stack([np.fft.irfft(own, self._sectors, axis=0, norm="forward") for own in series])
        grid = grid.transpose(2, 0, 1)
        # Across the middle lies the other side; beyond the outline slopes go on.
        before = np.roll(grid[:, _BEYOND:0:-1], self._sectors // 2, axis=2)
        grid = np.concatenate([before, grid], axis=1)
        grid = np.pad(grid, ((0, 0), (0, _BEYOND), (0, 0)), "reflect", reflect_type="odd")
        grid = np.pad(grid, ((0, 0), (0, 0), (_BEYOND, _BEYOND)), "wrap")
        return np.stack([spline_filter(channel, order=3) for channel in grid])
