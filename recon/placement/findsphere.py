"""The sphere of a photo set: given, or found in its masks and, where there are none, in the photographs."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from capture.decode import decode_photo, photo_mask
from capture.parallel import one_blas_thread, parallel_map
from capture.photo import Photo
from capture.photoset import PhotoSet
from capture.progress import Track, silent
from capture.radiometry import Radiometry
from capture.tasks.stage import stage_results
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
    outlined = _Outlined(photoset.radiometry, must_find)
    work = stage_results("outlines", outlined, photoset.photos, lambda photo: str(photo.file))
    silhouettes = [next(work) for _ in track(photoset.photos, "Finding the sphere")]
    sphere = _located(photoset, silhouettes)
    lost = [k for k, found in enumerate(silhouettes) if found is None] if must_find else []

    # Those that show too little of it to find it by themselves may show enough where the others say it is.
    def nearby(index: int) -> Silhouette:
        photo = photoset.photos[index]
        rim = rim_near(sphere, photo.camera, decode_photo(photoset.radiometry, photo))
        if rim is None:
            raise ValueError(
                f"{photo.file}: no mask is given, and no sphere was found in the photograph, not even where the others"
                " show it; write mask = '...' in its table (nonzero where the object is), or leave it out"
            )
        return rim_silhouette(rim, photo.camera)

    for index, found in zip(lost, parallel_map(nearby, lost), strict=True):
        silhouettes[index] = found
    return _located(photoset, silhouettes) if lost else sphere


@dataclass(frozen=True, eq=False)
class SphereMasks:
    """Masks of a sphere's photographs. found : whether the sphere was found in them, not given."""

    sphere: Sphere
    found: bool

    def __call__(self, photo: Photo) -> NDArray[np.float32] | None:
        """A photo's mask (h, w) in 0 to 1. Without one, that of the sphere if it was found: its rim is known to a share
        of a pixel only, which samples keep away from; None if it was given."""
        mask = photo_mask(photo)
        if mask is None and self.found:
            return body_coverage(SphereBody(self.sphere), photo.camera).astype(np.float32)
        return mask


def sphere_masks(photoset: PhotoSet, sphere: Sphere) -> SphereMasks:
    """The masks of a set's photographs of its sphere."""
    return SphereMasks(sphere, _must_find(photoset))


@dataclass(frozen=True, eq=False)
class _Outlined:
    """Finds the outline that a photograph's mask shows, or, where a sphere is looked for, the photograph itself."""

    radiometry: Radiometry
    must_find: bool

    def __call__(self, photo: Photo) -> Silhouette | None:
        mask = photo_mask(photo)
        if mask is not None:
            return mask_silhouette(mask)
        rim = find_rim(photo.camera, decode_photo(self.radiometry, photo)) if self.must_find else None
        return None if rim is None else rim_silhouette(rim, photo.camera)


def _must_find(photoset: PhotoSet) -> bool:
    return photoset.object.centre is None or photoset.object.radius is None


def _located(photoset: PhotoSet, silhouettes: Sequence[Silhouette | None]) -> Sphere:
    views = [
        LocatedPhoto(str(photo.file), photo.camera, silhouette)
        for photo, silhouette in zip(photoset.photos, silhouettes, strict=True)
    ]
    return locate_sphere(views, photoset.object.centre, photoset.object.radius)
