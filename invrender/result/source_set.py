"""The photo set that a result was made from, and its mesh, if they are still there: known by their hashes."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from capture.camera import Camera
from capture.files.documents import file_hash
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
        if file_hash(photoset.manifest) != expected:
            raise ValueError(
                f"{photoset.manifest}: is not what {result.path} was made from (another hash): a set, or what is in"
                " it, has changed since; run `lightfactor process` again"
            )
        return photoset
    for folder in _around(result):
        manifest = folder / Path(name).name
        if manifest.is_file() and file_hash(manifest) == expected:
            return load_photoset(manifest)
    return None


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
