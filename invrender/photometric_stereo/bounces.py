"""Light that reaches a pixel by way of the rest of the object, from the surface that its normals integrate to.

Patches of a few pixels each give their light to each other, once, as diffuse surfaces do:

    E_b(x) = sum_y F(x, y) pi Kd(y) max(n_y . l, 0),   F = cos_x cos_y A_y / (pi r^2)

[Nayar, Ikeuchi, Kanade, "Shape from interreflections", 1991]. Kd is in relative units where lamps' irradiance
is, and nothing hides patches from each other here: the share of E_b that arrives is one of the numbers that are fitted.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from capture.camera import Camera
from capture.lighting import cosines
from invrender.photometric_stereo.stack import PixelStack, PixelSurface
from recon.normals.integration import surface_points

Floats = NDArray[np.float64]
# Patches at most: their form factors are its square.
_PATCHES = 3000
# An object that gives a patch no more of its surroundings than this is convex for our purpose.
CONCAVE_FROM = 0.02


def bounced_light(
    surface: PixelSurface, stack: PixelStack, camera: Camera, depths: Floats
) -> tuple[Floats, float]:
    """E_b of each pixel and photograph over the lamp's irradiance, (p, j), and the largest share of a patch's
    surroundings that is the object itself.

    depths : (h, w), of `recon.normals.integration`, finite where the pixels are.
    """
    points = surface_points(camera, depths)
    rows, columns = np.nonzero(np.isfinite(depths))
    side = int(np.ceil(np.sqrt(len(rows) / _PATCHES)))
    _, patch = np.unique(rows // side * depths.shape[1] + columns // side, return_inverse=True)
    count = np.bincount(patch)

    def mean(values: Floats) -> Floats:
        return np.stack([np.bincount(patch, column) / count for column in values.T], axis=1)

    normals = mean(surface.normals)
    normals /= np.linalg.norm(normals, axis=1, keepdims=True)
    pixel = _pixel_area(camera, float(np.nanmean(depths)))
    areas = count * pixel / np.maximum(normals[:, 2], 0.2)
    factors = form_factors(mean(points), normals, areas)
    lamps = (
        stack.lamps[0]
        if len(stack.lamps) == 1
        else np.stack([mean(lamp) for lamp in stack.lamps.transpose(1, 0, 2)], axis=1)
    )
    lit = np.maximum(cosines(normals, lamps), 0)
    albedo = np.pi * mean(surface.kd).mean(axis=1)
    return np.asarray((factors @ (albedo[:, None] * lit))[patch]), float(factors.sum(axis=1).max())


def form_factors(points: Floats, normals: Floats, areas: Floats) -> Floats:
    """Shares (m, m) of what arrives at each of m patches that each other one gives it; points, normals : (m, 3).

    areas : (m,), square metres. Nothing hides patches from each other. Rows sum to 1 at most.
    """
    squares = (points**2).sum(axis=1)
    distances = np.maximum(squares[:, None] + squares - 2 * points @ points.T, 0) + areas[None] / 4
    here = np.maximum(normals @ points.T - np.einsum("mk,mk->m", normals, points)[:, None], 0)
    factors = here * here.T * areas / (np.pi * distances**2)
    return np.asarray(factors / np.maximum(factors.sum(axis=1, keepdims=True), 1))


def _pixel_area(camera: Camera, depth: float) -> float:
    """Square metres across the view that a pixel covers."""
    return (1 if camera.is_orthographic else depth**2) / camera.focal_px**2
