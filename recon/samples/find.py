"""The body of a photo set: the sphere found in its masks, or its mesh, placed and checked against them."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any

from capture.photoset import PhotoSet
from capture.progress import Track, silent
from recon.bodies import MeshBody
from recon.placement import MaskedView, Placement, check_placement
from recon.samples.stream import photo_mask
from recon.shape import placed, read_object_mesh
from recon.trianglemesh import TriangleMesh


@dataclass(frozen=True, eq=False)
class FoundMesh:
    """A mesh where the set says that it lies. mesh : in its own frame, metres. body : in the world."""

    mesh: TriangleMesh
    body: MeshBody
    placement: Placement
    warnings: tuple[str, ...]


def find_mesh(photoset: PhotoSet, track: Track = silent) -> FoundMesh:
    """The mesh of a set, in its place, checked against all masks; ValueError says what contradicts what."""
    read = read_object_mesh(photoset)
    assert photoset.mesh_to_world is not None, "a loaded set with a mesh has a place for it"
    body = MeshBody(placed(read.mesh, photoset.mesh_to_world))

    def views() -> Iterator[MaskedView]:
        photos: Any = track(photoset.photos, "Comparing the mesh with the masks")
        for photo in photos:
            yield MaskedView(str(photo.file), photo.camera, photo_mask(photo))

    placement = check_placement(body, photoset.mesh_to_world, views())
    return FoundMesh(read.mesh, body, placement, (*read.warnings, *placement.warnings))
