"""The object where a fit will look for it: among the cameras, and in each photograph."""

from __future__ import annotations

from functools import lru_cache
from pathlib import Path
from threading import Lock
from typing import Any

import numpy as np
from numpy.typing import NDArray

from capture.decode import decode_photo
from capture.photoset import Photo, PhotoSet, load_photoset
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
        body = _found(opened.photoset()).body
    except (ValueError, OSError) as error:
        return packed({"said": str(error)}, {})
    if isinstance(body, MeshBody):
        mesh = simplified(body.mesh, _FACES)
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
        image = decode_photo(photoset, photo)
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
    files = [photoset.manifest, *photoset.calibration_files]
    files += [photo.mask for photo in photoset.photos if photo.mask is not None]
    stamps = tuple(file.stat().st_mtime_ns for file in files if file.is_file())
    with _ONE_SEARCH:
        return _found_of(photoset.manifest, stamps)


@lru_cache(maxsize=1)
def _found_of(manifest: Path, stamps: tuple[int, ...]) -> FoundBody:
    """The body of a set, the last one kept. stamps : when its files were written."""
    return find_body(load_photoset(manifest))
