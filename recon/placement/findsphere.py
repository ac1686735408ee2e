"""The sphere of a photo set: given, or found in its masks and, where there are none, in the photographs."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from capture.decode import decode_photo, photo_mask
from capture.parallel import one_blas_thread, parallel_map
from capture.photoset import Photo, PhotoSet
from capture.progress import Track, silent
from recon.mesh.bodies import SphereBody, body_coverage
from recon.placement.locate import LocatedPhoto, locate_sphere
from recon.sphere.finddisk import find_rim, rim_near, rim_silhouette
from recon.sphere.outline import Silhouette, mask_silhouette
from recon.sphere.sphere import Sphere


def find_sphere(photoset: PhotoSet, track: Track = silent) -> Sphere:
    """The sphere of a photo set; ValueError names the photograph that contradicts it.

    Photographs and masks are read by turns: of each, its outline and the bits of its mask are kept.
    """
    with one_blas_thread():
        return _find_sphere(photoset, track)


def _find_sphere(photoset: PhotoSet, track: Track) -> Sphere:
    must_find = _must_find(photoset)

    def silhouette(photo: Photo) -> Silhouette | None:
        mask = photo_mask(photo)
        if mask is not None:
            return mask_silhouette(mask)
        rim = find_rim(photo.camera, decode_photo(photoset, photo)) if must_find else None
        return None if rim is None else rim_silhouette(rim, photo.camera)

    work = parallel_map(silhouette, photoset.photos)
    silhouettes = [next(work) for _ in track(photoset.photos, "Finding the sphere")]
    sphere = _located(photoset, silhouettes)
    lost = [k for k, found in enumerate(silhouettes) if found is None] if must_find else []

    # Those that show too little of it to find it by themselves may show enough where the others say it is.
    def nearby(index: int) -> Silhouette:
        photo = photoset.photos[index]
        rim = rim_near(sphere, photo.camera, decode_photo(photoset, photo))
        if rim is None:
            raise ValueError(
                f"{photo.file}: no mask is given, and no sphere was found in the photograph, not even where the others"
                " show it; write mask = '...' in its table (nonzero where the object is), or leave it out"
            )
        return rim_silhouette(rim, photo.camera)

    for index, found in zip(lost, parallel_map(nearby, lost), strict=True):
        silhouettes[index] = found
    return _located(photoset, silhouettes) if lost else sphere


def sphere_mask(photoset: PhotoSet, photo: Photo, sphere: Sphere) -> NDArray[np.float32] | None:
    """A photo's mask (h, w) in 0 to 1. Without one, that of the sphere if it was found: its rim is known to a share
    of a pixel only, which samples keep away from; None if it was given."""
    mask = photo_mask(photo)
    if mask is None and _must_find(photoset):
        return body_coverage(SphereBody(sphere), photo.camera).astype(np.float32)
    return mask


def _must_find(photoset: PhotoSet) -> bool:
    return photoset.object.centre is None or photoset.object.radius is None


def _located(photoset: PhotoSet, silhouettes: Sequence[Silhouette | None]) -> Sphere:
    views = [
        LocatedPhoto(str(photo.file), photo.camera, silhouette)
        for photo, silhouette in zip(photoset.photos, silhouettes, strict=True)
    ]
    return locate_sphere(views, photoset.object.centre, photoset.object.radius)
