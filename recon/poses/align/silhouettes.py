"""How far a mesh's silhouette lies from the outlines of masks, in pixels along the outlines' normals.

From each point of an outline rays are sent through the pixels along its normal; where they cease to meet the mesh is
its silhouette, found by bisection to a hundredth of a pixel. Nothing is assumed of the mesh: occlusion, holes, and
facets come out as they are. The last ray that meets it touches the surface at the rim, and to first order the
silhouette moves as that point does, because the surface is seen edge-on there: sliding along it changes nothing.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from recon.mesh.rays import RayTracer
from recon.poses.align.outlines import Outline
from recon.poses.align.pixelrays import PixelRays, joined, pixel_rays
from recon.poses.similarity import Similarity, motion_jacobian

Floats = NDArray[np.float64]
Bools = NDArray[np.bool_]

# Rays on either side of an outline's point, along its normal; and pixels to which the silhouette is then bisected.
_PER_SIDE = 8
_EXACT = 0.02


@dataclass(frozen=True, eq=False)
class Lines:
    """Lines across outlines, along which silhouettes are looked for.

    rays : n of them, through the outlines' points. normals : (n, 2) pixels. steps : (n, m) pixels along the normals,
    the same m for all. origins, directions : (n, m, 3) world. photo, sector : (n,) int that each belongs to.
    """

    rays: PixelRays
    normals: Floats
    steps: Floats
    origins: Floats
    directions: Floats
    photo: NDArray[np.int64]
    sector: NDArray[np.int64]

    def __len__(self) -> int:
        return len(self.normals)

    @property
    def reach(self) -> Floats:
        """Pixels (n,) that each line goes out and in."""
        return self.steps[:, -1]


@dataclass(frozen=True, eq=False)
class Crossings:
    """Where silhouettes cross lines. found : (n,) bool, some do. offsets : (n,) pixels outwards, 0 where none.

    points : (n, 3) world, where the mesh is touched there.
    """

    found: Bools
    offsets: Floats
    points: Floats


def no_lines() -> Lines:
    """Where there is no outline."""
    nothing, whole = np.zeros((0, 3)), np.zeros(0, np.int64)
    rays = PixelRays(nothing, nothing, np.zeros((0, 2, 3)), np.zeros(0, bool))
    return Lines(rays, np.zeros((0, 2)), np.zeros((0, 2)), *(np.zeros((0, 2, 3)),) * 2, whole, whole)


def overlap(tracer: RayTracer, place: Similarity, outline: Outline) -> float:
    """Intersection over union of mesh and mask in one photograph, by the outline's grid of pixels."""
    origins, directions = outline.camera.rays(outline.grid)
    parallel = np.full(len(origins), outline.camera.is_orthographic)
    seen = _hit(tracer, place, origins, directions, parallel)
    return float((seen & outline.inside).sum() / max((seen | outline.inside).sum(), 1))


def lines_across(outlines: Sequence[Outline], reaches: Sequence[float]) -> Lines:
    """Lines through all points of outlines, each going as far out and in as its photo's reach, pixels."""
    parts = []
    for photo, (outline, reach) in enumerate(zip(outlines, reaches, strict=True)):
        steps = np.linspace(-reach, reach, 2 * _PER_SIDE + 1)
        pixels = outline.points[:, None] + steps[:, None] * outline.normals[:, None]
        origins, directions = outline.camera.rays(pixels.reshape(-1, 2))
        parts.append(
            (
                pixel_rays(outline.camera, outline.points),
                outline.normals,
                np.broadcast_to(steps, pixels.shape[:2]),
                origins.reshape(*pixels.shape[:2], 3),
                directions.reshape(*pixels.shape[:2], 3),
                np.full(len(pixels), photo),
                outline.sectors,
            )
        )
    rays, *arrays = zip(*parts, strict=True)
    joint = [np.concatenate(array) for array in arrays]
    if not np.isfinite(joint[3]).all():
        raise ValueError("the camera's distortion cannot be undone about a mask's outline; check its params")
    return Lines(joined(rays), *joint)


def crossings(tracer: RayTracer, place: Similarity, lines: Lines) -> Crossings:
    """Where the silhouette of a mesh crosses lines, of several crossings the one nearest to the outline.

    tracer : of the mesh in its own frame, which `place` puts into the world.
    """
    count, steps = lines.steps.shape
    parallel = np.repeat(lines.rays.parallel, steps)
    origins, directions = lines.origins.reshape(-1, 3), lines.directions.reshape(-1, 3)
    inside = _hit(tracer, place, origins, directions, parallel).reshape(count, steps)
    leaves = inside[:, :-1] & ~inside[:, 1:]
    middles = np.abs((lines.steps[:, 1:] + lines.steps[:, :-1]) / 2)
    found = np.asarray(leaves.any(axis=1))
    row = np.flatnonzero(found)
    column = np.where(leaves, middles, np.inf)[row].argmin(axis=1)
    o0, d0 = lines.origins[row, column], lines.directions[row, column]
    o1, d1 = lines.origins[row, column + 1], lines.directions[row, column + 1]
    parallel = lines.rays.parallel[row]
    low, high = np.zeros((len(row), 1)), np.ones((len(row), 1))
    width = lines.steps[row, column + 1] - lines.steps[row, column]
    halvings = int(np.ceil(np.log2(max(float(width.max(initial=0)) / _EXACT, 2))))
    for _ in range(halvings):
        middle = (low + high) / 2
        met = _hit(tracer, place, *_between(o0, o1, d0, d1, middle), parallel)[:, None]
        low, high = np.where(met, middle, low), np.where(met, high, middle)
    offsets, points = np.zeros(count), np.zeros((count, 3))
    offsets[row] = lines.steps[row, column] + ((low + high) / 2)[:, 0] * width
    points[row] = place.apply(_touched(tracer, place, *_between(o0, o1, d0, d1, low), parallel))
    return Crossings(found, offsets, points)


def offset_jacobian(lines: Lines, met: Crossings, place: Similarity, pivot: Floats) -> Floats:
    """How the offsets follow the seven numbers of `Similarity.moved`, (n, 7); zero where nothing was found."""
    # Per unit of distance from the ray through the outline's point, along the normal, at the depth of the rim.
    across = np.einsum("nk,nkc->nc", lines.normals, lines.rays.across)
    depth = np.where(lines.rays.parallel, 1, lines.rays.depths(met.points))
    depth = np.where(met.found, depth, np.inf)
    return np.asarray(np.einsum("nc,ncp->np", across / depth[:, None], motion_jacobian(met.points, pivot)))


def _between(o0: Floats, o1: Floats, d0: Floats, d1: Floats, share: Floats) -> tuple[Floats, Floats]:
    directions = d0 + share * (d1 - d0)
    return o0 + share * (o1 - o0), directions / np.linalg.norm(directions, axis=1, keepdims=True)


def _in_mesh(
    tracer: RayTracer, place: Similarity, origins: Floats, directions: Floats, parallel: Bools
) -> tuple[Floats, Floats]:
    """Rays in the mesh's frame; those without a beginning start before the mesh."""
    starts, ways = place.undo(origins), directions @ place.rotation
    if parallel.any():
        along = np.einsum("nc,nc->n", starts - tracer.centre, ways) + 2 * tracer.size
        starts = starts - np.where(parallel, along, 0)[:, None] * ways
    return starts, ways


def _hit(tracer: RayTracer, place: Similarity, origins: Floats, directions: Floats, parallel: Bools) -> Bools:
    return tracer.met(*_in_mesh(tracer, place, origins, directions, parallel))


def _touched(
    tracer: RayTracer, place: Similarity, origins: Floats, directions: Floats, parallel: Bools
) -> Floats:
    """Where rays meet the mesh, in its frame; rays that just miss, by rounding, its centre's depth along them."""
    starts, ways = _in_mesh(tracer, place, origins, directions, parallel)
    hits = tracer.first_hits(starts, ways)
    corners = tracer.vertices[tracer.faces[hits.faces]]
    met = np.einsum("nk,nkc->nc", hits.weights, corners)
    passing = starts + np.einsum("nc,nc->n", tracer.centre - starts, ways)[:, None] * ways
    return np.where((hits.faces >= 0)[:, None], met, passing)
