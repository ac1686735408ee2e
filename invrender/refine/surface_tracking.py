"""Points of a textured surface, as one photograph shows them when its pose moves.

Of a point it shows Kd times the light that falls on it and Ks times the lobe, which moves with the view, averaged over
a pixel. Points stay where they are on the surface; the place in the picture where each is looked for moves.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import (
    binary_dilation,
    distance_transform_edt,
    generate_binary_structure,
    map_coordinates,
    spline_filter,
)

from capture.camera import Camera
from capture.radiance import RadianceImage
from invrender.estimate.textured.layout import SurfacePoints
from invrender.estimate.textured.observe import observe
from invrender.refine.photometric import BLOCK, PoseTarget
from recon.mesh.tangents import tangents
from recon.sampling.draw import samples_around
from recon.sampling.lightfield import LightField

Floats = NDArray[np.float64]
Singles = NDArray[np.float32]
Ints = NDArray[np.int64]

# Of a view, radians, and of a change, in its unit: for slopes. Along the surface, pixels.
_TURN, _STEP_PX = 1e-3, 0.01
# How far a point's Ks is from the mean, as a share of it, standard deviation, where it varies.
_KS_SPREAD = 0.5
# Pixels around what is used that a picture is kept with.
_MARGIN = 3


@dataclass(frozen=True)
class Lobe:
    """Ks (3,), mean over the surface, and whether it varies."""

    ks: Floats
    varies: bool

    @property
    def firmness(self) -> Floats:
        """Of a point's Ks at the mean, (3,): 1 / variance."""
        return 1 / np.maximum(_KS_SPREAD * self.ks, 1e-12) ** 2 if self.varies else np.full(3, np.inf)


@dataclass(frozen=True, eq=False)
class RadianceSpline:
    """Radiance between pixels, by cubics.

    splines : (3, h, w), their coefficients; lacking : (h, w), 1 where a pixel isn't usable, else 0; both of a part of
    the photograph. corner : (2,), row and column of its first pixel.
    """

    splines: Singles
    lacking: Singles
    corner: Ints

    @classmethod
    def of(cls, radiance: Singles, usable: NDArray[np.bool_]) -> RadianceSpline:
        """Of a photograph (h, w, 3), of which some pixels (h, w) are usable."""
        rows, columns = (np.flatnonzero(usable.any(axis=axis)) for axis in (1, 0))
        corner = np.maximum([rows[0] - _MARGIN, columns[0] - _MARGIN], 0)
        part = slice(corner[0], rows[-1] + _MARGIN + 1), slice(corner[1], columns[-1] + _MARGIN + 1)
        # What isn't usable is as the nearest that is: no step, and nothing swings.
        nearest = distance_transform_edt(~usable[part], return_distances=False, return_indices=True)
        filled = radiance[part][*nearest].transpose(2, 0, 1)
        splines = np.stack([spline_filter(channel, output=np.float32) for channel in filled])
        return cls(splines, (~usable[part]).astype(np.float32), corner)

    def at(self, pixels: Floats) -> Floats:
        """Radiance (r, 3) at places (r, 2), 0 at the middle of the first pixel; NaN beside what isn't usable."""
        places = np.nan_to_num(pixels[:, ::-1] - self.corner, nan=-1.0).T
        channels = [map_coordinates(spline, places, prefilter=False) for spline in self.splines]
        lacking = map_coordinates(self.lacking, places, order=1, cval=1.0) > 0
        return np.where(lacking[:, None], np.nan, np.stack(channels, axis=1)).astype(float)


@dataclass(frozen=True, eq=False)
class Followed:
    """Points of the surface that a photograph shows.

    points : (r,) their numbers. rays : one to each, from where the camera was. diffuse, specular : (r, 3), radiance of
    Kd = 1, and of Ks = 1, mean over a pixel around it. ways : (r, 2, 3) unit, along the surface, the same in all
    photographs. expected : (r, 3, 2), gradient along them of the picture as it was predicted, per metre. reflected :
    radiance of Ks = 1, of rays. trust : (r,), 0 to 1.
    """

    target: PoseTarget
    picture: RadianceSpline
    points: Ints
    rays: LightField
    diffuse: Floats
    specular: Floats
    ways: Floats
    expected: Floats
    reflected: Callable[[LightField], Floats]
    lobe: Lobe
    trust: Floats

    def shown(self, change: Floats) -> ShownPoints:
        """What the photograph shows of the points after a change (6,) of its pose."""
        target, at, camera = self.target, self.rays.positions, self.target.at(change)
        pixels = camera.project(at) - 0.5
        along = _along(camera, at, self.ways, _STEP_PX / target.px_per_metre)
        uphill = np.stack(
            [self.picture.at(pixels + way) - self.picture.at(pixels - way) for way in np.eye(2) / 2], axis=-1
        )
        specular, slopes = self._specular(change)
        whole = np.nan_to_num(pixels, nan=-1).astype(np.int64) // BLOCK
        return ShownPoints(
            radiance=self.picture.at(pixels),
            specular=specular,
            gradient=np.einsum("rcp,rpw->rcw", uphill, along),
            moves=np.asarray(np.linalg.solve(along, target.motion(change, at)), float),
            highlight=self.lobe.ks[:, None] * slopes,
            blocks=whole[:, 1] * 100_000 + whole[:, 0],
        )

    def _specular(self, change: Floats) -> tuple[Floats, Floats]:
        """Radiance of Ks = 1 at the points after a change, (r, 3), and its slopes in it, (r, 3, 6): highlights move."""
        here = self._views(change)
        ways = [
            (self._views(change + step) - self._views(change - step)) / (2 * _TURN)
            for step in _TURN * np.eye(6)
        ]
        now = self.reflected(replace(self.rays, views=here))
        slopes = np.zeros((*now.shape, 6))
        for across in tangents(here).transpose(1, 0, 2):
            side = here + _TURN * across
            side /= np.linalg.norm(side, axis=1, keepdims=True)
            moved = self.reflected(replace(self.rays, views=side))
            along = np.stack([(way * across).sum(axis=1) for way in ways], axis=-1)
            slopes += ((moved - now) / _TURN)[..., None] * along[:, None]
        # By how much a pixel's mean differs from its middle moves along.
        return self.specular + now - self._before, slopes

    @cached_property
    def _before(self) -> Floats:
        return self.reflected(self.rays)

    def _views(self, change: Floats) -> Floats:
        return self.target.at(change).views(self.rays.positions)


@dataclass(frozen=True, eq=False)
class ShownPoints:
    """What a photograph shows of points: radiance, and that of Ks = 1, (r, 3); blocks (r,) of pixels.

    gradient : (r, 3, 2), of the radiance along the surface, per metre. moves : (r, 2, 6), by how much what a point's
    place shows lies beside the point after a change of the pose, metres. highlight : (r, 3, 6), slopes of the lobe of
    the mean Ks in that change. NaN where a point has left what can be used.
    """

    radiance: Floats
    specular: Floats
    gradient: Floats
    moves: Floats
    highlight: Floats
    blocks: Ints


def followed_in(
    target: PoseTarget,
    image: RadianceImage,
    now: Camera,
    field: LightField,
    points: SurfacePoints,
    transfers: Callable[[LightField], tuple[Floats, Floats]],
    lobe: Lobe,
) -> Followed:
    """The points that a photograph shows from where its camera is now.

    image : the photograph; field : all its usable pixels. transfers : radiance of Kd = 1, and of Ks = 1, of samples.
    """
    usable = np.zeros(image.saturated.shape, bool)
    usable[field.rows, field.columns] = True
    seen = observe(target.body, now, field, points)
    places = now.project(points.positions[seen.points])
    rays, hit = samples_around(target.body, now, image, places, across=False)
    around, whole = samples_around(target.body, now, image, places[hit])
    chosen = np.flatnonzero(hit)[whole]
    rays = rays.where(whole)
    # Where the surface bends, a pixel's mean lies beside what its middle shows: looked for as much to the other side.
    beside = around.mean_over_rays(around.positions) - rays.positions
    beside -= (beside * rays.normals).sum(axis=1, keepdims=True) * rays.normals
    diffuse, specular = transfers(around)
    ways = tangents(points.normals[seen.points[chosen]])
    along = _along(now, points.positions[seen.points[chosen]], ways, _STEP_PX / target.px_per_metre)
    return Followed(
        target=target,
        picture=RadianceSpline.of(image.radiance, usable),
        points=seen.points[chosen],
        rays=replace(rays, positions=rays.positions - beside),
        diffuse=diffuse,
        specular=specular,
        ways=ways,
        expected=np.einsum("rcp,rpw->rcw", _uphill(target, field, places[chosen]), along),
        reflected=lambda rays: transfers(rays)[1],
        lobe=lobe,
        trust=np.maximum(seen.at_points(field.weight)[chosen], 0.01),
    )


def _along(camera: Camera, positions: Floats, ways: Floats, step: float) -> Floats:
    """How places of points (r, 3) in the picture move along ways (r, 2, 3), pixels per metre: (r, 2, 2), way last."""
    start = camera.project(positions)
    ends = [camera.project(positions + step * way) for way in ways.transpose(1, 0, 2)]
    return np.stack([(end - start) / step for end in ends], axis=-1)


def _uphill(target: PoseTarget, field: LightField, places: Floats) -> Floats:
    """Gradient (r, 3, 2) of the picture as it is predicted, at places (r, 2), pixels; NaN where that isn't known."""
    height, width = target.camera.height, target.camera.width
    around = np.zeros((height, width), bool)
    columns, rows = np.floor(places - 0.5).astype(np.int64).T
    for down, right in ((0, 0), (0, 1), (1, 0), (1, 1)):
        around[np.minimum(rows + down, height - 1), np.minimum(columns + right, width - 1)] = True
    around = binary_dilation(around, structure=generate_binary_structure(2, 1))
    near = field.where(around[field.rows, field.columns])
    picture = np.full((height, width, 3), np.nan)
    picture[near.rows, near.columns] = target.radiance(near)
    at = places[:, ::-1].T - 0.5
    slopes = [
        [map_coordinates(way, at, order=1, cval=np.nan) for way in np.gradient(channel)[::-1]]
        for channel in picture.transpose(2, 0, 1)
    ]
    return np.array(slopes).transpose(2, 0, 1)
