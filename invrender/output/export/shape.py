"""What is exported: the sphere or the mesh of a result, in the world."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from capture.photoset import PhotoSet
from invrender.output.render.subject import photographed_mesh
from invrender.result.saved import SavedResult
from recon.mesh.shape import placed
from recon.mesh.trianglemesh import TriangleMesh

Floats = NDArray[np.float64]

# Rows of a sphere's triangles: they lie within 0.03% of its radius of it on the mean.
_ROWS = 64


@dataclass(frozen=True, eq=False)
class Shape:
    """An object in the world, metres. mesh : its surface; is_sphere : that it stands for a sphere.

    centre, radius : of a sphere that holds it. file : of a mesh. warnings : sentences on it.
    """

    mesh: TriangleMesh
    centre: Floats
    radius: float
    is_sphere: bool
    file: Path | None = None
    warnings: tuple[str, ...] = ()


def result_shape(result: SavedResult, photoset: PhotoSet | None) -> Shape:
    """The object of a result; ValueError where it is a mesh, and the photo set that has it isn't there."""
    known = result.content.object
    centre = np.array(known.centre)
    if known.shape == "sphere":
        return Shape(tessellated(centre, known.radius), centre, known.radius, True)
    if photoset is None:
        raise ValueError(
            f"{result.path}: its object is a mesh of the photo set that it was made from, which isn't beside it: name"
            " the set's folder with --set"
        )
    mesh, file, mesh_to_world, warnings = photographed_mesh(result, photoset)
    return Shape(placed(mesh, mesh_to_world), centre, known.radius, False, file, tuple(warnings))


def tessellated(centre: Floats, radius: float, rows: int = _ROWS) -> TriangleMesh:
    """A sphere of triangles between meridians and parallels; u is the azimuth over 2 pi, v rises to 1 at +Z.

    Along the first meridian and at the poles vertices are doubled.
    """
    columns = 2 * rows
    theta = np.linspace(0, np.pi, rows + 1)[:, None]
    phi = np.linspace(0, 2 * np.pi, columns + 1)
    outward = np.stack(
        np.broadcast_arrays(np.sin(theta) * np.cos(phi), np.sin(theta) * np.sin(phi), np.cos(theta)), axis=-1
    )
    outward[:, -1] = outward[:, 0]
    outward[0], outward[-1] = [0, 0, 1], [0, 0, -1]
    u, v = np.broadcast_arrays(phi / (2 * np.pi), 1 - theta / np.pi)
    index = np.arange((rows + 1) * (columns + 1)).reshape(rows + 1, columns + 1)
    above, above_right, below, below_right = (
        part.ravel() for part in (index[:-1, :-1], index[:-1, 1:], index[1:, :-1], index[1:, 1:])
    )
    # At the poles one of a cell's two triangles has no area.
    lower = np.column_stack([above, below, below_right])[: (rows - 1) * columns]
    upper = np.column_stack([above, below_right, above_right])[columns:]
    normals = outward.reshape(-1, 3)
    return TriangleMesh(
        centre + radius * normals,
        np.concatenate([lower, upper]),
        normals,
        np.stack([u, v], axis=-1).reshape(-1, 2),
    )
