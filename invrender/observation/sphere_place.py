"""What samples of a sphere show if it lies elsewhere or is larger: of its normals, and of predicted radiance."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from capture.photoset import PhotoSet
from recon.sampling.lightfield import LightField
from recon.sphere.sphere import Sphere

Floats = NDArray[np.float64]
# Radiance (n, 3) of a photograph, by its place in a list, where a field of it has the surface.
Radiance = Callable[[int, LightField], Floats]

# Principal variances, as shares of the largest, below which an error counts for nothing.
_NEGLIGIBLE = 1e-9


def on_sphere(field: LightField, centre: Floats, radius: float) -> LightField:
    """A field as if its rays met another sphere; those that pass it show its rim."""
    offset = centre - field.positions
    gap = offset - (offset * field.views).sum(axis=1)[:, None] * field.views
    depth = np.sqrt(np.maximum(radius**2 - (gap**2).sum(axis=1), 0))
    normals = depth[:, None] * field.views - gap
    normals /= np.linalg.norm(normals, axis=1, keepdims=True)
    return replace(field, normals=normals, positions=centre + radius * normals)


def place_changes(fields: Sequence[LightField], sphere: Sphere, radiance: Radiance) -> list[list[Floats]]:
    """By how much each principal error of a sphere's place changes radiance, one standard deviation each.

    fields : of photographs. radiance : of a photograph, by its index, and its field, (n, 3). Returns per principal
    direction of the covariance, the largest first, (n, 3) per photograph; none of a sphere that was given.
    """
    variances, directions = np.linalg.eigh(sphere.covariance)
    notable = variances > _NEGLIGIBLE * max(float(variances.max()), 1e-300)
    place, changes = np.append(sphere.centre, sphere.radius), []
    for error in (directions * np.sqrt(np.maximum(variances, 0)))[:, notable].T[::-1]:
        ends = place + error / 2, place - error / 2
        changes.append(
            [
                np.subtract(*(radiance(k, on_sphere(field, end[:3], end[3])) for end in ends))
                for k, field in enumerate(fields)
            ]
        )
    return changes


def found_of_sphere(photoset: PhotoSet) -> NDArray[np.bool_]:
    """What of a sphere's centre and radius (4,) its outlines gave; nothing of a mesh."""
    given = photoset.object
    is_sphere = given.shape == "sphere"
    return np.array([is_sphere and given.centre is None] * 3 + [is_sphere and given.radius is None])
