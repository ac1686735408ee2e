"""The body of a photo set: its sphere found in the photographs, or its mesh, placed and checked against the masks."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from capture.decode import photo_mask
from capture.photo import Photo
from capture.photoset import PhotoSet
from capture.progress import Track, silent
from recon.lighting import frame_warnings
from recon.mesh.bodies import Body, MeshBody, SphereBody
from recon.mesh.shape import placed, read_object_mesh
from recon.mesh.trianglemesh import TriangleMesh
from recon.placement.check import MaskedView, check_placement
from recon.placement.findsphere import find_sphere, sphere_masks

Mask = NDArray[np.float32]

# Cameras closer together than this share of their distance from the origin are at one place.
_ONE_PLACE = 1e-3


@dataclass(frozen=True, eq=False)
class FoundBody:
    """The body of a set, in the world.

    mask_of : gives a photograph's mask, or None. overlaps : per photograph, intersection over union of a mesh and its
    mask; None without one. mesh : in its own frame, metres; None for a sphere.
    """

    body: Body
    mask_of: Callable[[Photo], Mask | None]
    overlaps: tuple[float | None, ...]
    mesh: TriangleMesh | None = None
    warnings: tuple[str, ...] = ()


def check_has_body(photoset: PhotoSet) -> None:
    """ValueError for a set that says of its object's shape no more than normals."""
    if photoset.object.shape == "normals":
        raise ValueError(
            f"{photoset.manifest}: [object] shape = 'normals' has no body that rays could meet; `lightfactor process`"
            " finds normals, `lightfactor integrate` makes a mesh of them, and shape = 'mesh' takes that"
        )


def check_unfiltered(photoset: PhotoSet) -> None:
    """ValueError for a set that was taken through polarising filters, where only `process` knows what they pass."""
    if photoset.extinction is not None:
        raise ValueError(
            f"{photoset.manifest}: the photographs were taken through polarising filters; only `lightfactor process`"
            " knows what these pass of highlights, on spheres and meshes: give it this set"
        )


def find_body(photoset: PhotoSet, track: Track = silent) -> FoundBody:
    """The body of a set, checked against all masks; ValueError says what contradicts what."""
    check_has_body(photoset)
    frame = frame_warnings(photoset)
    if photoset.object.shape == "sphere":
        sphere = find_sphere(photoset, track)
        return FoundBody(
            body=SphereBody(sphere),
            mask_of=sphere_masks(photoset, sphere),
            overlaps=(None,) * len(photoset.photos),
            warnings=(*frame, *_size_warnings(photoset)),
        )
    read = read_object_mesh(photoset)
    assert photoset.mesh_to_world is not None, "a loaded set with a mesh has a place for it"
    body = MeshBody(placed(read.mesh, photoset.mesh_to_world))

    def views() -> Iterator[MaskedView]:
        photos: Any = track(photoset.photos, "Comparing the mesh with the masks")
        for photo in photos:
            yield MaskedView(str(photo.file), photo.camera, photo_mask(photo))

    placement = check_placement(body, photoset.mesh_to_world, views())
    warnings = (*frame, *read.warnings, *placement.warnings)
    return FoundBody(body, photo_mask, placement.overlaps, read.mesh, warnings)


def _size_warnings(photoset: PhotoSet) -> list[str]:
    """A sentence if a sphere's size and distance are free together."""
    cameras = [photo.camera for photo in photoset.photos]
    if photoset.object.radius is not None or photoset.object.centre is not None or cameras[0].is_orthographic:
        return []
    centres = np.array([camera.centre for camera in cameras])
    if np.ptp(centres, axis=0).max() > _ONE_PLACE * np.linalg.norm(centres[0]):
        return []
    return [
        "all photographs were taken from one place, from which a sphere's size and distance are free together: its"
        " radius and the positions are right up to a common factor; give radius in [object]"
    ]
