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
from recon.mesh.tessellated import tessellated
from recon.mesh.trianglemesh import TriangleMesh

Floats = NDArray[np.float64]


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
