"""The object where a fit will look for it: among the cameras, and in each photograph."""

from __future__ import annotations

from functools import lru_cache
from pathlib import Path
from threading import Lock
from typing import Any

import numpy as np
from numpy.typing import NDArray

from capture.decode import decode_photo
from capture.photo import Photo
from capture.photoset import PhotoSet, load_photoset
from invrender.output.live.packed import packed
from invrender.process.pipeline import DEFAULT_SAMPLES
from lightfactor.studio.opened import Opened
from lightfactor.studio.pictures import ONE_AT_A_TIME, SHOWN_SIDE
from recon.mesh.bodies import MeshBody, SphereBody, body_coverage
from recon.mesh.simplified import simplified
from recon.mesh.tessellated import tessellated
from recon.sampling.draw import NO_SOURCES, sample_body
from recon.sampling.find import FoundBody, find_body

# Faces that a page sorts and paints while it is turned; rows of a sphere.
_FACES, _ROWS = 2500, 24
_ONE_SEARCH = Lock()


def surface(opened: Opened) -> bytes:
    """The object in the world, of few faces, packed: positions in radii about its centre, and that, metres.

    Where nobody knows yet where it is, `said` says why.
    """
    try:
        photoset = opened.photoset()
        with _ONE_SEARCH:
            return _surface_of(photoset.manifest, _stamps(photoset))
    except (ValueError, OSError) as error:
        return packed({"said": str(error)}, {})


def checks(opened: Opened, photo: Photo) -> bytes:
    """What a photograph is checked by, packed: where the object covers it, and what samples a fit takes of it.

    covered : (h, w) of every so many rows and columns. samples : (n, 3) columns, rows and weights. overlap : of mask
    and mesh, intersection over union, None without both.
    """
    photoset = opened.photoset()
    found = _found(photoset)
    stride = max(-(-max(photo.camera.width, photo.camera.height) // SHOWN_SIDE), 1)
    number = [each.label for each in photoset.photos].index(photo.label)
    with ONE_AT_A_TIME:
        image = decode_photo(photoset.radiometry, photo)
        budget = -(-DEFAULT_SAMPLES // max(len(photoset.fitted), 1))
        field = sample_body(
            found.body,
            photo.camera,
            image,
            found.mask_of(photo),
            NO_SOURCES,
            budget,
            np.random.default_rng(number),
        )
    arrays: dict[str, NDArray[Any]] = {
        "covered": body_coverage(found.body, photo.camera, stride).astype(np.uint8),
        "samples": np.column_stack([field.columns, field.rows, field.weight]).astype(np.float32),
    }
    return packed({"overlap": found.overlaps[number]}, arrays)


def _found(photoset: PhotoSet) -> FoundBody:
    with _ONE_SEARCH:
        return _found_of(photoset.manifest, _stamps(photoset))


def _stamps(photoset: PhotoSet) -> tuple[int, ...]:
    """When the files were written that say where the object is."""
    files = [photoset.manifest, *photoset.calibration_files]
    files += [photo.mask for photo in photoset.photos if photo.mask is not None]
    if photoset.object.mesh is not None:
        files.append(photoset.resolve(photoset.object.mesh))
    return tuple(file.stat().st_mtime_ns for file in files if file.is_file())


@lru_cache(maxsize=1)
def _found_of(manifest: Path, stamps: tuple[int, ...]) -> FoundBody:
    """The body of a set, the last one kept."""
    return find_body(load_photoset(manifest))


@lru_cache(maxsize=1)
def _surface_of(manifest: Path, stamps: tuple[int, ...]) -> bytes:
    body = _found_of(manifest, stamps).body
    if isinstance(body, MeshBody):
        mesh = simplified(body.mesh, _FACES, seams=False)
    else:
        assert isinstance(body, SphereBody)
        mesh = tessellated(body.sphere.centre, body.sphere.radius, _ROWS)
    centre = (mesh.vertices.min(axis=0) + mesh.vertices.max(axis=0)) / 2
    radius = float(np.linalg.norm(mesh.vertices - centre, axis=1).max())
    arrays: dict[str, NDArray[Any]] = {
        "positions": ((mesh.vertices - centre) / radius).astype(np.float32),
        "faces": mesh.faces.astype(np.uint32),
    }
    return packed({"centre": centre.tolist(), "radius": radius}, arrays)
