"""The visual hull: the largest body that fits all silhouettes, a stand-in for a scan.

A point belongs to it if every photograph shows it within its mask [Laurentini 1994, "The visual hull concept"]. Hollows
that no silhouette shows are filled, so normals there are not the object's.
"""

from __future__ import annotations

from collections.abc import Sequence

import cv2
import numpy as np
from numpy.typing import NDArray
from skimage.measure import marching_cubes

from capture.camera import Camera
from capture.parallel import parallel_map
from capture.progress import Track, silent
from recon.mesh.shape import largest_piece
from recon.mesh.trianglemesh import TriangleMesh, smooth_normals

Floats = NDArray[np.float64]
Coverage = NDArray[np.float32]

# Cells along the longest side of the box in a first look, which finds the box.
_COARSE = 48
_FEWEST_VIEWS = 3
# Points at once, to bound memory.
_POINTS_AT_A_TIME = 100_000
# Rows that OpenCV's remap takes.
_REMAP_ROWS = 32_000


def visual_hull(
    cameras: Sequence[Camera],
    coverages: Sequence[Coverage],
    cells: int = 160,
    track: Track = silent,
) -> TriangleMesh:
    """The visual hull of masks, one per camera, as a closed mesh in the world.

    coverages : (h, w) in 0 to 1 each. cells : along the longest side of its box; 8 to 1024. track : may show progress.
    ValueError where there are fewer than 3 masks, or the masks have no body in common.
    """
    if len(cameras) < _FEWEST_VIEWS:
        raise ValueError(f"{len(cameras)} masks are too few for a visual hull; {_FEWEST_VIEWS} are the least")
    if not 8 <= cells <= 1024:
        raise ValueError(f"cells is {cells}; it must be 8 to 1024")
    insides = [_signed_distance(coverage) for coverage in coverages]
    low, high = _first_box(cameras, coverages)
    # The first look may cut the box's cells to what is inside; a second one makes sure.
    for _ in range(2):
        axes, depth = _field(cameras, insides, low, high, _COARSE)
        inside = depth > 0
        if not inside.any():
            raise ValueError(
                "the masks have no body in common: poses and masks contradict each other; check world_to_camera and its"
                " convention, and that every mask is nonzero where the object is"
            )
        step = axes[0][1] - axes[0][0]
        where = np.argwhere(inside)
        corner = np.array([axis[0] for axis in axes])
        low, high = corner + (where.min(axis=0) - 2) * step, corner + (where.max(axis=0) + 2) * step
    axes, depth = _field(cameras, insides, low, high, cells, track)
    step = axes[0][1] - axes[0][0]
    # Nothing is known beyond the box: the hull ends there.
    depth = np.pad(depth, 1, constant_values=min(float(depth.min()), -step))
    vertices, faces, _, _ = marching_cubes(depth, 0.0, spacing=(step,) * 3, gradient_direction="ascent")
    vertices = vertices.astype(float) + np.array([axis[0] for axis in axes]) - step
    faces = faces.astype(np.int64)
    mesh = TriangleMesh(vertices, faces, smooth_normals(vertices, faces))
    return largest_piece(mesh)


def _field(
    cameras: Sequence[Camera],
    insides: Sequence[NDArray[np.float32]],
    low: Floats,
    high: Floats,
    cells: int,
    track: Track = silent,
) -> tuple[list[Floats], NDArray[np.float32]]:
    """Axes of a grid over a box, and at its points the depth below the hull's surface, metres, negative outside."""
    step = float((high - low).max()) / cells
    axes = [
        first + step * np.arange(int(np.ceil((last - first) / step)) + 1)
        for first, last in zip(low, high, strict=True)
    ]
    slab = max(min(_POINTS_AT_A_TIME // (len(axes[1]) * len(axes[2])), _REMAP_ROWS // len(axes[1])), 1)

    def carved(first: int) -> NDArray[np.float32]:
        grid = np.meshgrid(axes[0][first : first + slab], axes[1], axes[2], indexing="ij")
        points = np.stack(grid, axis=-1).reshape(-1, 3)
        least = np.full(len(points), np.inf, np.float32)
        for camera, inside in zip(cameras, insides, strict=True):
            # OpenCV counts centres of pixels at integers. What is behind the camera isn't seen.
            pixels = np.nan_to_num(camera.project(points) - 0.5, nan=-1e6).astype(np.float32)
            places = pixels.reshape(-1, len(axes[2]), 2)
            border = cv2.BORDER_REPLICATE
            shown = cv2.remap(
                inside, places[..., 0], places[..., 1], cv2.INTER_LINEAR, borderMode=border
            ).ravel()
            size = np.ones(len(points)) if camera.is_orthographic else np.maximum(camera.depth(points), 1e-9)
            np.minimum(least, shown * (size / camera.focal_px).astype(np.float32), out=least)
        return least.reshape(grid[0].shape)

    starts = range(0, len(axes[0]), slab)
    work = parallel_map(carved, starts)
    return axes, np.concatenate([next(work) for _ in track(starts, "Carving")])


def _signed_distance(coverage: Coverage) -> NDArray[np.float32]:
    """Distance of pixels' centres from the outline, in pixels, positive inside; the image's edge is no outline."""
    inside = (coverage >= 0.5).astype(np.uint8)
    within = cv2.distanceTransform(inside, cv2.DIST_L2, cv2.DIST_MASK_PRECISE)
    beyond = cv2.distanceTransform(1 - inside, cv2.DIST_L2, cv2.DIST_MASK_PRECISE)
    # To the next pixel's centre it is half a pixel more than to the outline between them.
    return np.where(inside > 0, within - 0.5, 0.5 - beyond).astype(np.float32)


def _first_box(cameras: Sequence[Camera], coverages: Sequence[Coverage]) -> tuple[Floats, Floats]:
    """A box that holds the hull: about the point nearest to all masks' axes, as large as the largest mask there."""
    matrix, vector = np.zeros((3, 3)), np.zeros(3)
    spans = []
    for camera, coverage in zip(cameras, coverages, strict=True):
        rows, columns = np.nonzero(coverage >= 0.5)
        if not len(rows):
            raise ValueError("a mask is empty; it must be nonzero where the object is")
        centroid = np.array([[columns.mean() + 0.5, rows.mean() + 0.5]])
        origin, direction = camera.rays(centroid)
        across = np.eye(3) - np.outer(direction[0], direction[0])
        matrix += across
        vector += across @ origin[0]
        spans.append(np.hypot(*(np.ptp(rows), np.ptp(columns))) + 2)
    if np.linalg.cond(matrix) > 1e6:
        raise ValueError(
            "all photographs were taken from one direction: silhouettes bound no body; add other sides"
        )
    centre = np.linalg.solve(matrix, vector)
    reach = max(
        span / camera.focal_px * (1.0 if camera.is_orthographic else abs(float(camera.depth(centre)[0])))
        for camera, span in zip(cameras, spans, strict=True)
    )
    return centre - reach, centre + reach
