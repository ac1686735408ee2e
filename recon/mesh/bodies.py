"""What was photographed, as rays see it: a sphere or a mesh, each with the same questions answered.

Everything that samples photographs asks these and nothing else of a shape.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, field
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from capture.camera import Camera
from capture.lighting import seen_from
from recon.harmonics.basis import sphere_directions
from recon.mesh.rays import RayTracer
from recon.mesh.trianglemesh import TriangleMesh, area_vectors
from recon.sphere.sphere import Sphere

Floats = NDArray[np.float64]
Ints = NDArray[np.int64]

# Rays that are traced at once, to bound memory.
_RAYS_AT_A_TIME = 200_000
# Pixels so near a sphere's outline, as they appear undistorted, may have a corner beyond it.
_RIM_PX = 2.0
# A pixel's corners, in half its side, around it.
_CORNERS: Floats = np.array([(-1.0, -1.0), (1.0, -1.0), (1.0, 1.0), (-1.0, 1.0)])
# Pixels around a pixel of a mesh in which no edge of it may be for the pixel to count as clear.
_CLEARANCE = 3


@dataclass(frozen=True, eq=False)
class SurfaceHits:
    """Where n rays meet a body first. Rows of rays that miss it are zero.

    hit : (n,) bool. views : (n, 3) unit, back along the rays, of those that miss, too. positions : (n, 3) metres.
    normals : (n, 3) unit, of the smooth surface. facets : (n, 3) unit, of the surface that rays meet: a mesh's flat
    triangles, on the side that is seen.
    faces : (n,) triangle, -1 where none, and weights : (n, 3) of its corners; None of both on a sphere.
    """

    hit: NDArray[np.bool_]
    views: Floats
    positions: Floats
    normals: Floats
    facets: Floats
    faces: Ints | None = None
    weights: Floats | None = None


@dataclass(frozen=True, eq=False)
class PixelGeometry:
    """How the surface lies in n pixels, by which samples are chosen.

    whole : (n,) bool, the pixel shows one smooth piece of surface. clear : (n,) bool, so do the pixels around it.
    normals : (n, 3) at its centre. cos : (n,) of the exitant angle there.
    turn : (n,) radians by which the normal turns across the pixel. positions : (n, 3) metres, at its centre.
    """

    whole: NDArray[np.bool_]
    clear: NDArray[np.bool_]
    normals: Floats
    cos: Floats
    turn: Floats
    positions: Floats


class Body(Protocol):
    """A shape in the world."""

    @property
    def centre(self) -> Floats:
        """Its middle (3,), metres in the world."""

    @property
    def size(self) -> float:
        """Its largest extent, metres."""

    def pixel_geometry(self, camera: Camera, rows: Ints, columns: Ints) -> PixelGeometry:
        """How the surface lies in given pixels, (n,) rows and columns."""

    def hits(self, camera: Camera, pixels: Floats) -> SurfaceHits:
        """What rays through image points (n, 2) meet first."""

    def visible(
        self, positions: Floats, facets: Floats, directions: Floats, distances: Floats | None = None
    ) -> NDArray[np.bool_]:
        """Whether points of the surface (n, 3) see unit directions (n, 3), as far as distances (n,), (n,)."""

    def clearance(self, point: Floats) -> float:
        """How far a point (3,) is from the surface, metres; negative inside."""

    def outline_points(self, camera: Camera) -> Floats:
        """Points (n, 3) whose box in the image holds the body's image, but for a few percent."""


@dataclass(frozen=True, eq=False)
class SphereBody:
    """A sphere as a body: its geometry is exact, so a pixel that lies on it is good."""

    sphere: Sphere

    @property
    def centre(self) -> Floats:
        return self.sphere.centre

    @property
    def size(self) -> float:
        return 2 * self.sphere.radius

    def pixel_geometry(self, camera: Camera, rows: Ints, columns: Ints) -> PixelGeometry:
        centres = _centres(rows, columns)
        at = self.hits(camera, centres)
        cos = (at.normals * at.views).sum(axis=1)
        radius = self.sphere.pixel_radius(camera)
        whole = at.hit.copy()
        # Corners of pixels well within the outline lie on the sphere, too.
        near = np.flatnonzero(whole & (1 - np.sqrt(np.clip(1 - cos**2, 0, 1)) < _RIM_PX / radius))
        for corner in _CORNERS:
            whole[near] &= self.hits(camera, centres[near] + 0.5 * corner).hit
        turn = 1 / (radius * np.maximum(cos, 1e-9))
        return PixelGeometry(whole, whole, at.normals, cos, turn, at.positions)

    def hits(self, camera: Camera, pixels: Floats) -> SurfaceHits:
        origins, directions = camera.rays(pixels)
        hit, normals = self.sphere.hits(origins, directions)
        if not camera.is_orthographic and camera.depth(self.sphere.centre)[0] <= self.sphere.radius:
            hit, normals = np.zeros_like(hit), np.zeros_like(normals)  # behind the camera, or around it
        positions = np.where(hit[:, None], self.sphere.centre + self.sphere.radius * normals, 0.0)
        return SurfaceHits(hit, -directions, positions, normals, normals)

    def visible(
        self, positions: Floats, facets: Floats, directions: Floats, distances: Floats | None = None
    ) -> NDArray[np.bool_]:
        return (facets * directions).sum(axis=1) > 0

    def clearance(self, point: Floats) -> float:
        return float(np.linalg.norm(point - self.sphere.centre)) - self.sphere.radius

    def outline_points(self, camera: Camera) -> Floats:
        return self.sphere.centre + self.sphere.radius * sphere_directions(600)


@dataclass(frozen=True, eq=False)
class MeshBody:
    """A mesh in the world as a body. Poses and scans are off by a pixel or so: its edges are kept away from.

    facets : (f, 3) unit outward normals of its flat faces; zero of faces without area.
    """

    mesh: TriangleMesh
    tracer: RayTracer = field(init=False, repr=False)
    facets: Floats = field(init=False, repr=False)

    def __post_init__(self) -> None:
        object.__setattr__(self, "tracer", RayTracer(self.mesh.vertices, self.mesh.faces))
        areas = area_vectors(self.mesh.vertices, self.mesh.faces)
        lengths = np.linalg.norm(areas, axis=1, keepdims=True)
        object.__setattr__(self, "facets", areas / np.maximum(lengths, np.finfo(float).tiny))

    @property
    def centre(self) -> Floats:
        return self.tracer.centre

    @property
    def size(self) -> float:
        return self.tracer.size

    def pixel_geometry(self, camera: Camera, rows: Ints, columns: Ints) -> PixelGeometry:
        centres = _centres(rows, columns)
        at = self.hits(camera, centres)
        depth = np.ones(len(centres)) if camera.is_orthographic else camera.depth(at.positions)
        per_metre = camera.focal_px / np.where(at.hit, depth, 1.0)
        whole, turn = at.hit.copy(), np.zeros(len(centres))
        corners = []
        for corner in _CORNERS:
            near = self.hits(camera, centres + corner)
            whole &= _continues(at, near, per_metre)
            corners.append(near.normals)
        # Sides and diagonals of the square of the corners, by their lengths in pixels.
        for one, other, length in (
            (0, 1, 2),
            (1, 2, 2),
            (2, 3, 2),
            (3, 0, 2),
            (0, 2, 8**0.5),
            (1, 3, 8**0.5),
        ):
            chord = np.linalg.norm(corners[one] - corners[other], axis=1)
            turn = np.maximum(turn, 2 * np.arcsin(np.minimum(chord / 2, 1)) / length)
        clear = whole.copy()
        for corner in _CORNERS:
            clear &= _continues(at, self.hits(camera, centres + _CLEARANCE * corner), per_metre, _CLEARANCE)
        cos = (at.normals * at.views).sum(axis=1)
        return PixelGeometry(whole, clear, at.normals, cos, turn, at.positions)

    def hits(self, camera: Camera, pixels: Floats) -> SurfaceHits:
        origins, directions = camera.rays(pixels)
        reached = np.asarray(np.isfinite(directions).all(axis=1))
        if not reached.all():
            # No ray belongs to pixels that the lens distortion doesn't reach.
            directions = np.where(reached[:, None], directions, [0.0, 0.0, 1.0])
        if camera.is_orthographic:
            # Such a ray has no beginning: it comes from before the mesh.
            along = ((self.tracer.centre - origins) * directions).sum(axis=1)
            origins = origins + (along - 2 * self.tracer.size)[:, None] * directions
        found = self.tracer.first_hits(origins, directions)
        facets = self.facets[found.faces]
        # The back of a face, seen through a hole, is no surface.
        hit = np.asarray(reached & (found.faces >= 0) & ((facets * directions).sum(axis=1) < 0))
        corners = self.mesh.faces[found.faces]
        weights = np.where(hit[:, None], found.weights, 0.0)
        normals = blended(self.mesh.normals, corners, weights)
        lengths = np.linalg.norm(normals, axis=1, keepdims=True)
        return SurfaceHits(
            hit=hit,
            views=-directions,
            positions=blended(self.mesh.vertices, corners, weights),
            normals=normals / np.where(hit[:, None], lengths, 1.0),
            facets=np.where(hit[:, None], facets, 0.0),
            faces=np.where(hit, found.faces, -1).astype(np.int64),
            weights=weights,
        )

    def visible(
        self, positions: Floats, facets: Floats, directions: Floats, distances: Floats | None = None
    ) -> NDArray[np.bool_]:
        return ~self.tracer.occluded(positions, facets, directions, distances)

    def clearance(self, point: Floats) -> float:
        """How far a point (3,) is from the nearest vertex, metres; negative where it sees the mesh from within."""
        offsets = self.mesh.vertices - point
        distances = np.linalg.norm(offsets, axis=1)
        nearest = distances.argmin()
        # Towards the middle of a face beside the nearest vertex: rays through vertices may slip between faces.
        beside = self.mesh.faces[(self.mesh.faces == nearest).any(axis=1).argmax()]
        towards = self.mesh.vertices[beside].mean(axis=0) - point
        ray = (towards / np.linalg.norm(towards))[None]
        met = self.tracer.first_hits(point[None], ray).faces[0]
        inside = met >= 0 and float(self.facets[met] @ ray[0]) > 0
        return float(-distances[nearest] if inside else distances[nearest])

    def outline_points(self, camera: Camera) -> Floats:
        return self.mesh.vertices


def sees(body: Body, positions: Floats, facets: Floats, source: Floats) -> NDArray[np.bool_]:
    """Whether points of the surface (n, 3) see a source (3,), or (4,) that may be near, (n,)."""
    directions, factors = seen_from(source[None], positions)
    if directions.ndim == 2:
        return body.visible(positions, facets, np.broadcast_to(source, facets.shape))
    # A source's distance is that vector's length over its closeness.
    reach = np.full(len(positions), np.inf) if source[3] == 0 else 1 / (source[3] * np.sqrt(factors[:, 0]))
    return body.visible(positions, facets, directions[:, 0], reach)


def body_window(body: Body, camera: Camera) -> tuple[int, int, int, int]:
    """Top, left, bottom and right (the latter two exclusive) of the part of the image that may show the body.

    Empty (all zeros) where no point of it lies before the camera.
    """
    pixels = camera.project(body.outline_points(camera))
    behind = np.isnan(pixels).any(axis=1)
    if behind.all():
        return 0, 0, 0, 0
    edge = np.array([camera.width, camera.height])
    if behind.any():
        return 0, 0, camera.height, camera.width
    margin = 2 + 0.05 * np.ptp(pixels, axis=0)
    left, top = np.clip(pixels.min(axis=0) - margin, 0, edge).astype(int)
    right, bottom = np.clip(np.ceil(pixels.max(axis=0) + margin), 0, edge).astype(int)
    return int(top), int(left), int(bottom), int(right)


def larger_pixels(body: Body, camera: Camera, count: int) -> int:
    """So many pixels across and down, taken for one, leave about `count` around a body; 1 where there are fewer."""
    top, left, bottom, right = body_window(body, camera)
    return max(round(np.sqrt((bottom - top) * (right - left) / count)), 1)


def body_coverage(body: Body, camera: Camera, stride: int = 1) -> NDArray[np.bool_]:
    """Whether rays through the centres of pixels, every stride-th row and column of them, meet the body."""
    covered = np.zeros((camera.height, camera.width), bool)[::stride, ::stride]
    top, left, bottom, right = (-(-edge // stride) for edge in body_window(body, camera))
    for rows, columns in _bands((top, left, bottom, right)):
        y, x = np.mgrid[rows, columns] * stride
        pixels = np.column_stack([x.ravel(), y.ravel()]) + 0.5
        covered[rows, columns] = body.hits(camera, pixels).hit.reshape(y.shape)
    return covered


def body_pixels(
    body: Body, camera: Camera, outline: bool = False
) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """Rows and columns of the pixels whose corners all lie on the body; of those that only some do if `outline`."""
    corners = np.zeros((camera.height + 1, camera.width + 1), bool)
    top, left, bottom, right = body_window(body, camera)
    for rows, columns in _bands((top, left, bottom + 1, right + 1)):
        y, x = np.mgrid[rows, columns]
        pixels = np.column_stack([x.ravel(), y.ravel()]).astype(float)
        corners[rows, columns] = body.hits(camera, pixels).hit.reshape(y.shape)
    four = np.stack([corners[:-1, :-1], corners[:-1, 1:], corners[1:, :-1], corners[1:, 1:]])
    whole = four.all(axis=0)
    rows_, columns_ = np.nonzero(four.any(axis=0) & ~whole if outline else whole)
    return rows_, columns_


def _bands(window: tuple[int, int, int, int]) -> Iterator[tuple[slice, slice]]:
    """The window row by row, as many rows at once as memory is meant to hold."""
    top, left, bottom, right = window
    band = max(_RAYS_AT_A_TIME // max(right - left, 1), 1)
    for first in range(top, bottom, band):
        yield slice(first, min(first + band, bottom)), slice(left, right)


def _centres(rows: Ints, columns: Ints) -> Floats:
    """Image points (n, 2) of pixels' centres."""
    return np.asarray(np.column_stack([columns, rows]) + 0.5, dtype=np.float64)


def _continues(
    at: SurfaceHits, near: SurfaceHits, per_metre: Floats, reach: float = 1.0
) -> NDArray[np.bool_]:
    """Whether the same piece of surface is met a few pixels on: no further than that from the plane that touches it.

    per_metre : (n,) pixels. A surface that turns by less than a quarter of a radian per pixel, and is seen at less than
    81 degrees, leaves its tangent plane by less than a pixel; another piece behind an edge is further away.
    """
    off = ((near.positions - at.positions) * at.normals).sum(axis=1) * per_metre
    return near.hit & (np.abs(off) < reach)


def blended(values: NDArray[np.floating], corners: Ints, weights: Floats) -> Floats:
    """Vertex values (v, c) at points of faces, (n, c), by the weights of their corners (n, 3), (n, 3)."""
    return np.asarray(np.einsum("nk,nkc->nc", weights, values[corners]))
