"""What is rendered: a sphere, or a mesh that shadows itself."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from pydantic import ConfigDict

from capture.camera import rigid_transform
from capture.files.documents import read_json
from capture.files.tables import Table
from invrender.model.transfer import LightElement
from invrender.theory.latlong import map_coefficients
from recon.bodies import Body, MeshBody, SphereBody
from recon.lightfield import LightField
from recon.shape import opening_warnings, placed, without_strays
from recon.sphere import Sphere
from recon.transfercache import cached_transfer
from recon.trianglemesh import read_mesh

Floats = NDArray[np.float64]

# As `lightfactor samples` has it, so that both find what the other has kept beside the mesh.
_L_MAX, _RAYS = 8, 256
_Row = tuple[float, float, float, float]


class _Placement(Table):
    model_config = ConfigDict(extra="ignore")

    mesh_to_world: tuple[_Row, _Row, _Row, _Row]


@dataclass(frozen=True, eq=False)
class Subject:
    """A body with what its own shadows leave of the diffuse light.

    centre : (3,) metres, what cameras look at. radius : metres, of a sphere about it that holds the body.
    transfer : (v, (l + 1)^2) shadowed diffuse transfer of a mesh's vertices in the world; None of a sphere.
    warnings : sentences on the mesh.
    """

    body: Body
    centre: Floats
    radius: float
    transfer: NDArray[np.float32] | None = None
    warnings: tuple[str, ...] = ()

    def vertex_irradiance(self, element: LightElement) -> Floats | None:
        """Irradiance (v, 3) of a mesh's vertices from an element's map, under its own shadows; None of a sphere."""
        if self.transfer is None:
            return None
        if element.slow_map is None:
            return np.zeros((len(self.transfer), 3))
        return np.asarray(self.transfer @ map_coefficients(element.slow_map, _L_MAX), float)

    def blended(self, at_vertices: Floats, field: LightField) -> Floats:
        """Values (m, 3) at a field's rays on a mesh, between those at its vertices (v, 3)."""
        assert isinstance(self.body, MeshBody)
        assert field.faces is not None
        assert field.corner_weights is not None
        corners = at_vertices[self.body.mesh.faces[field.faces]]
        return np.asarray(np.einsum("mk,mkc->mc", field.corner_weights, corners))


def sphere_subject(centre: Floats, radius: float) -> Subject:
    """A sphere; metres."""
    if not radius > 0:
        raise ValueError(f"--radius is {radius:g} m; it must be > 0")
    return Subject(SphereBody(Sphere(centre, radius, np.zeros((4, 4)))), centre, radius)


def mesh_subject(file: Path, placement: Path | None) -> Subject:
    """A mesh, read in metres, where a JSON file with `mesh_to_world` places it; without one in the world as it is."""
    mesh_to_world = np.eye(4)
    if placement is not None:
        what = "a file such as alignment.json holds mesh_to_world, 4x4"
        table = read_json(placement, _Placement, ("mesh_to_world",), what)
        try:
            mesh_to_world = rigid_transform(table.mesh_to_world, "mesh_to_world")
        except ValueError as error:
            raise ValueError(f"{placement}: {error}") from error
    mesh = read_mesh(file)
    try:
        mesh, warnings = without_strays(mesh)
        warnings += opening_warnings(mesh)
    except ValueError as error:
        raise ValueError(f"{file}: {error}") from error
    transfer, unkept = cached_transfer(mesh, file, _L_MAX, _RAYS)
    warnings = [f"{file.name}: {text}" for text in warnings] + ([unkept] if unkept else [])
    vertices = placed(mesh, mesh_to_world).vertices
    centre = (vertices.min(axis=0) + vertices.max(axis=0)) / 2
    return Subject(
        MeshBody(placed(mesh, mesh_to_world)),
        centre,
        float(np.linalg.norm(vertices - centre, axis=1).max()),
        transfer.rotated(mesh_to_world[:3, :3]).coefficients,
        tuple(warnings),
    )
