"""What is rendered: a sphere, or a mesh that shadows itself."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from pydantic import ConfigDict

from capture.camera import Camera, rigid_transform
from capture.files.documents import read_json
from capture.files.tables import Table
from capture.photoset import PhotoSet
from invrender.result.saved import SavedResult
from invrender.result.saved_textures import RayReflectance, SavedTextures
from invrender.result.source_set import scanned_mesh
from invrender.transport.visibility import Shadows
from recon.mesh.bodies import Body, MeshBody, SphereBody
from recon.mesh.shape import opening_warnings, placed, without_loose_pieces
from recon.mesh.transfer import TransferVectors
from recon.mesh.transfercache import cached_transfer
from recon.mesh.trianglemesh import TriangleMesh, read_mesh
from recon.sphere.sphere import Sphere

Floats = NDArray[np.float64]
Ints = NDArray[np.int64]

_Row = tuple[float, float, float, float]


class _Placement(Table):
    model_config = ConfigDict(extra="ignore")

    mesh_to_world: tuple[_Row, _Row, _Row, _Row]


@dataclass(frozen=True, eq=False)
class Subject:
    """A body with its shadows on itself.

    centre : (3,) metres, what cameras look at. radius : metres, of a sphere about it that holds the body.
    shadows : of a mesh; None of a sphere, which has none. warnings : sentences on the mesh.
    """

    body: Body
    centre: Floats
    radius: float
    shadows: Shadows | None = None
    warnings: tuple[str, ...] = ()

    @property
    def turns_visibly(self) -> bool:
        """Whether it looks different from other sides, whatever its light; a sphere doesn't."""
        return isinstance(self.body, MeshBody)

    @property
    def has_texture_coordinates(self) -> bool:
        return isinstance(self.body, MeshBody) and self.body.mesh.uv is not None

    def ray_reflectance(self, textures: SavedTextures, camera: Camera, pixels: Floats) -> RayReflectance:
        """Kd and Ks where rays through image points (m, 2) meet a mesh that the textures go with; zero beside it."""
        assert isinstance(self.body, MeshBody)
        hits = self.body.hits(camera, pixels)
        assert hits.faces is not None
        assert hits.weights is not None
        return self._textured(textures, self.body.mesh.faces[hits.faces], hits.weights).where(hits.hit)

    def face_reflectance(self, textures: SavedTextures) -> RayReflectance:
        """Kd and Ks in the middle of each face of a mesh that the textures go with."""
        assert isinstance(self.body, MeshBody)
        corners = self.body.mesh.faces
        return self._textured(textures, corners, np.full(corners.shape, 1 / 3))

    def _textured(self, textures: SavedTextures, corners: Ints, weights: Floats) -> RayReflectance:
        assert isinstance(self.body, MeshBody)
        if textures.at_vertices:
            return textures.between(corners, weights)
        assert self.body.mesh.uv is not None
        return textures.at(np.einsum("mk,mkc->mc", weights, self.body.mesh.uv[corners]))


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
        mesh, warnings = without_loose_pieces(mesh)
        warnings += opening_warnings(mesh)
    except ValueError as error:
        raise ValueError(f"{file}: {error}") from error
    return _mesh_subject(mesh, file, mesh_to_world, [f"{file.name}: {text}" for text in warnings])


def photographed_subject(result: SavedResult, photoset: PhotoSet | None) -> Subject:
    """The object of a result; ValueError where it is a mesh, and the photo set that has it isn't there."""
    known = result.content.object
    if known.shape == "sphere":
        return sphere_subject(np.array(known.centre), known.radius)
    mesh, file, mesh_to_world, warnings = scanned_mesh(result, photoset)
    return _mesh_subject(mesh, file, mesh_to_world, warnings, _with_coordinates(result, mesh))


def photographed_mesh(
    result: SavedResult, photoset: PhotoSet | None
) -> tuple[TriangleMesh, Path, Floats, tuple[str, ...]]:
    """The mesh of a result in its own axes, its file, its place in the world, and warnings; ValueError as above.

    Where texture coordinates were made for it, it has them, vertices doubled along their seams.
    """
    mesh, file, pose, warnings = scanned_mesh(result, photoset)
    return _with_coordinates(result, mesh), file, pose, warnings


def _with_coordinates(result: SavedResult, mesh: TriangleMesh) -> TriangleMesh:
    """The mesh with the texture coordinates that lie beside the result, if any do; its faces keep their order."""
    table = result.content.texture
    if table is None or table.mesh is None:
        return mesh
    file = result.folder / table.mesh
    found = read_mesh(file)
    apart = np.inf
    if found.faces.shape == mesh.faces.shape:
        apart = float(np.abs(found.vertices[found.faces] - mesh.vertices[mesh.faces]).max())
    # Files have nine digits.
    if apart > 1e-6 * float(np.ptp(mesh.vertices, axis=0).max()) or found.uv is None:
        raise ValueError(
            f"{file}: is not the object's mesh with texture coordinates; run `lightfactor process` again"
        )
    return found


def _mesh_subject(
    mesh: TriangleMesh,
    file: Path,
    mesh_to_world: Floats,
    warnings: Sequence[str],
    textured: TriangleMesh | None = None,
) -> Subject:
    """A mesh in its own axes, metres, put into the world. file : beside which its transfer vectors are kept.

    textured : the same mesh with texture coordinates, face by face; itself if None.
    """
    transfer, unkept = cached_transfer(mesh, file)
    textured = textured or mesh
    # Along seams several vertices of the textured mesh are one of the mesh's.
    original = np.zeros(len(textured.vertices), int)
    original[textured.faces] = mesh.faces
    transfer = TransferVectors(transfer.coefficients[original], transfer.std[original])
    in_world = placed(textured, mesh_to_world)
    body = MeshBody(in_world)
    centre = (in_world.vertices.min(axis=0) + in_world.vertices.max(axis=0)) / 2
    return Subject(
        body,
        centre,
        float(np.linalg.norm(in_world.vertices - centre, axis=1).max()),
        Shadows.of(body, transfer.rotated(mesh_to_world[:3, :3])),
        (*warnings, unkept) if unkept else tuple(warnings),
    )
