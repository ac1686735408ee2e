"""Places of a mesh that its masks allow, from nowhere: what is known is the shape, the masks and the cameras.

A tangent of a mask's convex hull spans, with the camera's centre, a plane that touches the object. The mesh touches it
where its support function says, which for a given rotation is linear in scale and shift: thousands of rotations are
judged in a moment, exactly, under perspective and lens distortion alike. The best are then fitted to whole outlines.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import ConvexHull, QhullError
from scipy.spatial.transform import Rotation

from recon.harmonics.basis import sphere_directions
from recon.poses.align.outlines import Outline
from recon.poses.align.pixelrays import from_one_place, pixel_rays
from recon.poses.similarity import Similarity, rotations_all_over

Floats = NDArray[np.float64]

_ROTATIONS = 2000
# Tangents of each photo, of one or two more; photos that are asked, spread over the set.
_TANGENTS, _PHOTOS = 20, 6
# Corners of the mesh's hull that are kept, rotations whose motions are computed at a time, and whose supports are: all
# corners along all planes, in a core's cache.
_HULL_POINTS, _AT_A_TIME, _SUPPORTS_AT_A_TIME = 300, 250, 30
# Starts that are refined on the hull, and those that are handed on: radians by which they differ, and how much worse
# than the best they may be, as a factor and in shares of the object's size in the pictures.
_REFINED, _HANDED_ON, _APART = 160, 12, np.radians(8)
_WORSE, _WORSE_SHARE = 3.0, 0.04
# Share of the tangent planes by which a place is judged.
_BELIEVED = 0.75


@dataclass(frozen=True, eq=False)
class _Planes:
    """Planes that touch the object: normal . x = level. normals : (m, 3) world, unit, outward; per_length : pixels that
    a unit of distance from each is worth."""

    normals: Floats
    levels: Floats
    per_length: Floats


def starting_places(vertices: Floats, outlines: Sequence[Outline], free_scale: bool) -> list[Similarity]:
    """Places whose convex hull fits the masks' hulls, the best first.

    vertices : (v, 3) of the mesh. free_scale : false holds it at 1. Outlines that the image's edge cuts off count where
    they are whole. ValueError where too little of the outlines is left.
    """
    chosen = np.unique(np.linspace(0, len(outlines) - 1, min(len(outlines), _PHOTOS)).round().astype(int))
    planes = _touching_planes([outlines[i] for i in chosen])
    middle = (vertices.max(axis=0) + vertices.min(axis=0)) / 2
    corners = _hull_points(vertices - middle)
    rotations = rotations_all_over(_ROTATIONS)
    motion, off = _fitted(corners, planes, rotations, free_scale)
    best = np.argsort(off)[:_REFINED]
    rotations, motion, off = _refined(corners, planes, rotations[best], free_scale)
    places: list[Similarity] = []
    worst = _WORSE * off.min() + _WORSE_SHARE * float(np.mean([outline.radius for outline in outlines]))
    for index in np.argsort(off):
        if len(places) == _HANDED_ON or not off[index] <= worst:
            break
        scale, shift, rotation = motion[index, 0], motion[index, 1:], rotations[index]
        place = Similarity(scale, rotation, shift - scale * rotation @ middle)
        if all(place.angle_to(other) > _APART for other in places):
            places.append(place)
    if not places:
        raise ValueError(
            "no place of the mesh fits the masks' outlines at all; check poses, masks and mesh, or give picks"
        )
    return places


def _touching_planes(outlines: Sequence[Outline]) -> _Planes:
    normals, levels, sizes, depths_of = [], [], [], []
    count = max(_TANGENTS, 3 * _TANGENTS // len(outlines))
    angles = 2 * np.pi * np.arange(count) / count
    ways = np.column_stack([np.cos(angles), np.sin(angles)])
    middle = meeting_point(outlines)
    for outline in outlines:
        camera = outline.camera
        rays = pixel_rays(camera, outline.points)
        turn = camera.world_to_camera[:3, :3]
        local = rays.directions @ turn.T
        plane = local[:, :2] / local[:, 2:]
        if camera.is_orthographic:
            plane = (rays.origins @ turn.T)[:, :2] + camera.world_to_camera[:2, 3]
        touching = (plane @ ways.T).argmax(axis=0)
        size = np.array([camera.width, camera.height])
        gap = np.minimum(outline.points[touching], size - outline.points[touching]).min(axis=1)
        # Where the image ends the object goes on.
        use = gap > max(4.0, 0.02 * outline.radius) if not outline.whole else np.ones(len(ways), bool)
        touching, across = touching[use], ways[use]
        along = np.zeros(len(across)) if camera.is_orthographic else -(across * plane[touching]).sum(axis=1)
        normal = np.column_stack([across, along]) @ turn
        normal /= np.linalg.norm(normal, axis=1, keepdims=True)
        normals.append(normal)
        levels.append((normal * rays.origins[touching]).sum(axis=1))
        depth = 1.0 if camera.is_orthographic else float(camera.depth(middle)[0])
        depths_of.append(depth)
        sizes.append(np.full(len(normal), camera.focal_px / max(depth, 1e-9)))
    planes = _Planes(np.concatenate(normals), np.concatenate(levels), np.concatenate(sizes))
    if len(planes.normals) < 16:
        raise ValueError(
            "the image's edge cuts the object off nearly all around: its place can't be found from such masks; give"
            " picks"
        )
    if min(depths_of) <= 0:
        raise ValueError(
            "the masks' lines of sight meet behind a camera: check the poses (world_to_camera with OpenCV axes, x"
            " right, y down, z forward)"
        )
    return planes


def meeting_point(outlines: Sequence[Outline]) -> Floats:
    """The point (3,) nearest to the rays through the outlines' middles; from one place, at any depth before it."""
    matrix, vector = np.zeros((3, 3)), np.zeros(3)
    for outline in outlines:
        (origin,), (way,) = outline.camera.rays(outline.points.mean(axis=0)[None])
        across = np.eye(3) - np.outer(way, way)
        matrix += across
        vector += across @ origin
    strengths = np.linalg.eigvalsh(matrix)
    centres = np.array([outline.camera.centre for outline in outlines])
    # Rays from one place meet there, and parallel ones nowhere.
    if from_one_place(centres) or strengths[0] < 1e-6 * strengths[2]:
        camera = outlines[0].camera
        (origin,), (way,) = camera.rays(outlines[0].points.mean(axis=0)[None])
        return np.asarray(origin + way * max(float(np.linalg.norm(camera.centre)), 1.0))
    return np.asarray(np.linalg.solve(matrix, vector))


def _hull_points(points: Floats) -> Floats:
    """Corners of the convex hull, evenly thinned."""
    try:
        corners = points[ConvexHull(points).vertices]
    except QhullError:  # a flat sheet
        corners = points
    if len(corners) <= _HULL_POINTS:
        return np.asarray(corners)
    # The farthest in so many directions.
    ways = sphere_directions(4 * _HULL_POINTS)
    return np.asarray(corners[np.unique((corners @ ways.T).argmax(axis=0))])


def _fitted(corners: Floats, planes: _Planes, rotations: Floats, free_scale: bool) -> tuple[Floats, Floats]:
    """Scale and shift (g, 4) for each rotation (g, 3, 3), and how far (g,) off the planes are in pixels; infinite where
    none is sensible."""
    motion, off = np.ones((len(rotations), 4)), np.full(len(rotations), np.inf)
    for first in range(0, len(rotations), _AT_A_TIME):
        part = slice(first, first + _AT_A_TIME)
        support, _ = _supports(corners, planes, rotations[part])
        motion[part], off[part] = _solved(support, planes, free_scale)
    return motion, off


def _supports(corners: Floats, planes: _Planes, rotations: Floats) -> tuple[Floats, NDArray[np.int64]]:
    """How far the turned mesh reaches along each plane's normal, (g, m), and the corner that does."""
    support = np.empty((len(rotations), len(planes.normals)))
    touching = np.empty(support.shape, np.int64)
    for first in range(0, len(rotations), _SUPPORTS_AT_A_TIME):
        part = slice(first, first + _SUPPORTS_AT_A_TIME)
        ways = np.einsum("gij,mi->gmj", rotations[part], planes.normals)
        reach = (ways.reshape(-1, 3) @ corners.T).reshape(*ways.shape[:2], -1)
        touching[part] = reach.argmax(axis=2)
        support[part] = np.take_along_axis(reach, touching[part, :, None], axis=2)[:, :, 0]
    return support, touching


def _solved(support: Floats, planes: _Planes, free_scale: bool) -> tuple[Floats, Floats]:
    weight = planes.per_length
    count, planes_count = support.shape
    rows = np.zeros((count, planes_count, 4))
    rows[:, :, 0] = support * weight
    rows[:, :, 1:] = planes.normals * weight[:, None]
    right = np.broadcast_to(planes.levels * weight, (count, planes_count))
    motion, trust = np.ones((count, 4)), np.ones((count, planes_count))
    for _ in range(2):
        if free_scale:
            motion = _least_squares(rows, right, trust)
        else:
            motion[:, 1:] = _least_squares(rows[:, :, 1:], right - rows[:, :, 0], trust)
        square = (np.einsum("gmp,gp->gm", rows, motion) - right) ** 2
        trust = 1 / (1 + square / (4 * np.median(square, axis=1, keepdims=True) + 1e-30))
    gaps = np.abs(np.einsum("gmp,gp->gm", rows, motion) - right)
    # A few planes may be wrong, a bad mask's or a bad pose's.
    spread = np.partition(gaps, int(_BELIEVED * planes_count), axis=1)[:, int(_BELIEVED * planes_count)]
    return motion, np.where(motion[:, 0] > 0, spread, np.inf)


def _least_squares(rows: Floats, right: Floats, trust: Floats) -> Floats:
    scale = np.sqrt((rows**2).sum(axis=1)) + 1e-30
    rows = rows / scale[:, None, :]
    trusted = (rows * trust[:, :, None]).transpose(0, 2, 1)
    inverse = np.linalg.pinv(trusted @ rows, rcond=1e-10, hermitian=True)
    return np.asarray((inverse @ (trusted @ right[:, :, None]))[:, :, 0] / scale)


def _refined(
    corners: Floats, planes: _Planes, rotations: Floats, free_scale: bool
) -> tuple[Floats, Floats, Floats]:
    """Rotations turned to fit the planes better, by Gauss-Newton; their motion and how far off they are."""
    motion, off = _fitted(corners, planes, rotations, free_scale)
    # Not `capture.gaussnewton`: thousands of rotations step side by side.
    for _ in range(6):
        support, touching = _supports(corners, planes, rotations)
        weight = planes.per_length
        # normal . (turn x arm) = turn . (arm x normal), the arm being that of the touching corner.
        arms = np.einsum("gij,gmj->gmi", rotations, corners[touching])
        by_turn = np.cross(arms, planes.normals) * (motion[:, :1] * weight)[:, :, None]
        by_shift = np.broadcast_to(planes.normals * weight[:, None], by_turn.shape)
        parts = [by_turn, by_shift] + ([(support * weight)[:, :, None]] if free_scale else [])
        rows = np.concatenate(parts, axis=2)
        now = motion[:, :1] * support + motion[:, 1:] @ planes.normals.T
        gap = (planes.levels - now) * weight
        trust = 1 / (1 + gap**2 / (4 * np.median(gap**2, axis=1, keepdims=True) + 1e-30))
        step = _least_squares(rows, gap, trust)[:, :3]
        length = np.linalg.norm(step, axis=1, keepdims=True)
        step *= np.minimum(1, 0.2 / np.maximum(length, 1e-12))
        turned = _turned(rotations, step)
        new_motion, new_off = _fitted(corners, planes, turned, free_scale)
        better = new_off < off
        rotations = np.where(better[:, None, None], turned, rotations)
        motion, off = np.where(better[:, None], new_motion, motion), np.where(better, new_off, off)
    return rotations, motion, off


def _turned(rotations: Floats, steps: Floats) -> Floats:
    return np.asarray(np.einsum("gij,gjk->gik", Rotation.from_rotvec(steps).as_matrix(), rotations))
