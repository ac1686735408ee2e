"""The photo set that a result was made from, and its mesh, if they are still there: known by their hashes.

A set whose masks, lights or held-out photographs have changed since is still the result's, as long as its photographs
are taken by the same cameras from the same places.
"""

from __future__ import annotations

import hashlib
import json
from collections.abc import Iterator
from contextlib import suppress
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from capture.camera import Camera
from capture.files.documents import file_hash, numbers
from capture.photoset import PhotoSet, load_photoset
from invrender.result.saved import SavedResult, nearest
from recon.mesh.shape import read_object_mesh
from recon.mesh.trianglemesh import TriangleMesh

Floats = NDArray[np.float64]


def find_photoset(result: SavedResult, given: Path | None) -> PhotoSet | None:
    """The set of a result; None where it isn't given and isn't found.

    given : its folder or manifest; ValueError if the result was made from another one. Without it, the folders around
    the result and the current one are looked at.
    """
    names = [name for name in result.content.inputs if name.endswith(".toml")]
    if not names:
        return None
    name, expected = names[0], result.content.inputs[names[0]]
    if given is not None:
        photoset = load_photoset(given)
        if file_hash(photoset.manifest) != expected and not _has_its_cameras(result, photoset):
            raise ValueError(
                f"{photoset.manifest}: is not what {result.path} was made from (another hash): cameras, poses or"
                " photographs have changed since; run `lightfactor process` again"
            )
        return photoset
    manifests = [path for folder in _around(result) if (path := folder / Path(name).name).is_file()]
    for manifest in manifests:
        if file_hash(manifest) == expected:
            return load_photoset(manifest)
    for manifest in manifests:
        # Beside a result may lie what is no set of its own, or not any more.
        with suppress(ValueError, OSError):
            if _has_its_cameras(result, photoset := load_photoset(manifest)):
                return photoset
    return None


def cameras_hash(photoset: PhotoSet) -> str:
    """sha256 of what pictures ask of a set: its photographs' names, cameras and poses."""
    cameras = []
    for photo in photoset.photos:
        camera = photo.camera
        pose = numbers(camera.world_to_camera)
        cameras.append([photo.label, camera.model, list(camera.params), camera.width, camera.height, pose])
    return f"sha256:{hashlib.sha256(json.dumps(cameras).encode()).hexdigest()}"


def _has_its_cameras(result: SavedResult, photoset: PhotoSet) -> bool:
    return result.content.cameras == cameras_hash(photoset)


def photo_camera(result: SavedResult, photoset: PhotoSet | None, label: str) -> Camera:
    """The camera of a photograph by its name; ValueError where there is none."""
    if photoset is None:
        raise ValueError(
            f"photo {label!r}: the photo set that {result.path} was made from is not beside it; give its folder with"
            " --set"
        )
    cameras = {photo.label: photo.camera for photo in photoset.photos}
    if label not in cameras:
        raise ValueError(f"{photoset.manifest}: has no photo {label!r}; {nearest(label, cameras)}")
    return cameras[label]


def scanned_mesh(
    result: SavedResult, photoset: PhotoSet | None
) -> tuple[TriangleMesh, Path, Floats, tuple[str, ...]]:
    """The mesh of a result in its own axes, as its file has it, the file, its place in the world, and warnings.

    ValueError where the set isn't there, or the mesh has changed since.
    """
    if photoset is None:
        raise ValueError(
            f"{result.path}: its object is a mesh of the photo set that it was made from, which isn't beside it: name"
            " the set's folder with --set, or another mesh with --mesh"
        )
    found = read_object_mesh(photoset)
    assert photoset.object.mesh is not None
    file = photoset.resolve(photoset.object.mesh)
    _check_hash(result, file)
    # Where the mesh lay when the result was made, whatever has aligned it since.
    known = result.content.object
    pose = photoset.mesh_to_world if known.mesh_to_world is None else np.array(known.mesh_to_world)
    assert pose is not None, "a loaded set with a mesh has a place for it"
    return found.mesh, file, pose, found.warnings


def _check_hash(result: SavedResult, file: Path) -> None:
    """ValueError where a mesh has changed since a result was made of it."""
    if result.content.inputs.get(file.name, known := file_hash(file)) != known:
        raise ValueError(
            f"{file}: is not the mesh that {result.path} was made with (another hash): it has changed since; run"
            " `lightfactor process` again"
        )


def _around(result: SavedResult) -> Iterator[Path]:
    """Folders in which the set may be: the result's own, those beside it, the one above, the current one."""
    above = result.folder.resolve().parent
    yield from (result.folder, above, Path.cwd())
    yield from sorted(path for path in above.iterdir() if path.is_dir())
