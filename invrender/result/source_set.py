"""The photo set that a result was made from, if it is still there: known by the hash of its manifest."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

from capture.camera import Camera
from capture.files.documents import file_hash
from capture.photoset import PhotoSet, load_photoset
from invrender.result.saved import SavedResult, nearest


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


def _around(result: SavedResult) -> Iterator[Path]:
    """Folders in which the set may be: the result's own, those beside it, the one above, the current one."""
    above = result.folder.resolve().parent
    yield from (result.folder, above, Path.cwd())
    yield from sorted(path for path in above.iterdir() if path.is_dir())
