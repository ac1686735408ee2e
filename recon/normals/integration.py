"""The surface that has given normals: depths by weighted least squares, and a mesh through them.

Along a picture's axis u, a ray's origin o and direction d change, and the depth Z with them:

    n . (do/du + d(Z d)/du) = 0
    orthographic: dZ/du = -(n . do/du) / (n . d);  perspective: d log Z / du = -(n . dd/du) / (n . d)

where d reaches unit depth. Neighbours share the mean of their slopes; a slope counts for less where the surface is seen
from the side [Queau, Durou, Aujol, "Normal integration: a survey", 2018, section 2 and on weighted least squares].
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import coo_array, csc_array, diags_array, eye_array
from scipy.sparse.csgraph import connected_components
from scipy.sparse.linalg import spsolve

from capture.camera import Camera
from recon.mesh.trianglemesh import TriangleMesh, area_vectors
from recon.normals.normalmap import NormalMap, picture_axes

Floats = NDArray[np.float64]
Ints = NDArray[np.int64]
# Cosine to the viewer below which a slope is no steeper: outlines turn away altogether.
_STEEPEST = 0.1
# Pieces of the picture that nothing joins keep the mean depth; of the largest weight.
_HELD = 1e-8


def pixel_rays(camera: Camera, rows: Ints | Floats, columns: Ints | Floats) -> tuple[Floats, Floats]:
    """Origins and directions (p, 3) of pixels' rays in the picture's axes; directions reach unit depth."""
    origins, directions = camera.rays(np.column_stack([columns, rows]) + 0.5)
    axes = picture_axes(camera)
    origins = (origins - camera.centre) @ axes.T
    directions = directions @ axes.T
    return origins, directions / -directions[:, 2:]


def integrate(found: NormalMap, camera: Camera, depth: float) -> Floats:
    """Depths (h, w) along the camera's axis of a surface that has the normals, metres, whose mean is `depth`.

    NaN outside. Pieces of the map that don't touch have the same mean depth each: nothing says how they lie. ValueError
    where fewer than three pixels have a normal.
    """
    inside = found.inside
    if inside.sum() < 3:
        raise ValueError(
            f"the normal map has {int(inside.sum())} pixels with a normal; a surface takes three"
        )
    rows, columns = np.nonzero(inside)
    normals = found.normals[inside]
    place = np.full(inside.shape, -1)
    place[inside] = np.arange(len(rows))
    pairs, slopes, weights = [], [], []
    for down, along in ((0, 1), (1, 0)):
        one, other = _neighbours(place, down, along)
        slope = (_slopes(camera, normals, rows, columns, down, along)[[one, other]]).mean(axis=0)
        pairs.append(np.stack([one, other]))
        slopes.append(slope)
        weights.append(np.minimum(normals[one, 2], normals[other, 2]).clip(_STEEPEST))
    one, other = np.concatenate(pairs, axis=1)
    heights = _solve(one, other, np.concatenate(slopes), np.concatenate(weights), len(rows))
    depths = np.full(inside.shape, np.nan)
    depths[inside] = depth + heights if camera.is_orthographic else depth * np.exp(heights)
    return depths


def _neighbours(place: Ints, down: int, along: int) -> tuple[Ints, Ints]:
    """Numbers of pixels and of their neighbours, for those that have one inside."""
    height, width = place.shape
    first = place[: height - down, : width - along]
    second = place[down:, along:]
    both = (first >= 0) & (second >= 0)
    return first[both], second[both]


def _slopes(camera: Camera, normals: Floats, rows: Ints, columns: Ints, down: int, along: int) -> Floats:
    """Changes of the depth, or of its logarithm, from a pixel to the next one, (p,)."""
    origins, directions = pixel_rays(camera, rows, columns)
    next_origins, next_directions = pixel_rays(camera, rows + down, columns + along)
    changed = next_origins - origins if camera.is_orthographic else next_directions - directions
    facing = np.einsum("pk,pk->p", normals, -directions)
    facing = np.maximum(facing, _STEEPEST * np.linalg.norm(directions, axis=1))
    return np.asarray(np.einsum("pk,pk->p", normals, changed) / facing)


def _solve(one: Ints, other: Ints, slopes: Floats, weights: Floats, count: int) -> Floats:
    """Heights (count,) whose differences come nearest to slopes; of each piece the mean is 0."""
    equation = np.arange(len(one))
    signs = np.concatenate([-np.ones(len(one)), np.ones(len(one))])
    places = (np.concatenate([equation, equation]), np.concatenate([one, other]))
    difference = coo_array((signs, places), shape=(len(one), count)).tocsr()
    weighted = diags_array(weights) @ difference
    matrix = csc_array(difference.T @ weighted + _HELD * weights.max(initial=1.0) * eye_array(count))
    heights = np.asarray(spsolve(matrix, weighted.T @ slopes))
    graph = coo_array((np.ones(len(one)), (one, other)), shape=(count, count))
    piece = connected_components(graph, directed=False)[1]
    means = np.bincount(piece, heights) / np.bincount(piece)
    return np.asarray(heights - means[piece])


def surface_points(camera: Camera, depths: Floats) -> Floats:
    """Points (p, 3) of a depth map, in the picture's axes about the camera, in the order of its pixels inside."""
    rows, columns = np.nonzero(np.isfinite(depths))
    origins, directions = pixel_rays(camera, rows, columns)
    return np.asarray(origins + depths[rows, columns][:, None] * directions)


def surface_mesh(found: NormalMap, camera: Camera, depths: Floats) -> TriangleMesh:
    """The mesh of a depth map in the world, two triangles for each square of four pixels.

    Its texture coordinates are the picture's, so that maps of the picture's size are its textures. Its normals are the
    map's.
    """
    inside = np.isfinite(depths)
    place = np.full(inside.shape, -1)
    place[inside] = np.arange(inside.sum())
    corners = place[:-1, :-1], place[1:, :-1], place[1:, 1:], place[:-1, 1:]
    whole = np.all([corner >= 0 for corner in corners], axis=0)
    a, b, c, d = (corner[whole] for corner in corners)
    faces = np.concatenate([np.stack([a, b, c], axis=1), np.stack([a, c, d], axis=1)])
    if not len(faces):
        raise ValueError("no four neighbouring pixels have normals; a mesh needs at least one such square")
    used, numbers = np.unique(faces, return_inverse=True)
    axes = picture_axes(camera)
    rows, columns = (of[used] for of in np.nonzero(inside))
    height, width = inside.shape
    uv = np.column_stack([(columns + 0.5) / width, 1 - (rows + 0.5) / height])
    return TriangleMesh(
        surface_points(camera, depths)[used] @ axes + camera.centre,
        numbers.reshape(-1, 3),
        found.normals[inside][used] @ axes,
        uv,
    )


def slope_errors(found: NormalMap, camera: Camera, depths: Floats) -> float:
    """Median angle between the normals of a surface's triangles and those of the map at their corners, degrees."""
    mesh = surface_mesh(found, camera, depths)
    facets = area_vectors(mesh.vertices, mesh.faces)
    facets /= np.maximum(np.linalg.norm(facets, axis=1, keepdims=True), 1e-300)
    corners = mesh.normals[mesh.faces].mean(axis=1)
    corners /= np.linalg.norm(corners, axis=1, keepdims=True)
    cosines = np.clip(np.einsum("fk,fk->f", facets, corners), -1, 1)
    return float(np.degrees(np.median(np.arccos(cosines))))
