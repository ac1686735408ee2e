"""From a structure to a registration: named as in the set, in its frame, checked against the masks."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from capture.camera import Camera
from capture.decode import photo_mask
from capture.photoset import PhotoSet
from recon.poses.register.frame import WorldFrame
from recon.poses.register.posesfile import Method, Registration, ScaleSource
from recon.poses.register.silhouettes import Conventions, check_silhouettes, check_viewing_directions
from recon.poses.register.structure import Structure

Ints = NDArray[np.int64]

# Silhouettes of fewer photographs bound no body.
_FEWEST = 3


def perspective_cameras(photoset: PhotoSet) -> list[Camera]:
    for photo in photoset.photos:
        if photo.camera.is_orthographic:
            raise ValueError(
                f'{photoset.manifest}: photo "{photo.name}": poses are found for perspective cameras; an ORTHOGRAPHIC'
                " one needs world_to_camera"
            )
    return [photo.camera for photo in photoset.photos]


def distinct_lenses(cameras: Sequence[Camera]) -> tuple[list[Camera], Ints]:
    """The different cameras, and which of them each photograph was taken by."""
    keys = [(camera.model, tuple(camera.params.tolist()), camera.width, camera.height) for camera in cameras]
    unique = list(dict.fromkeys(keys))
    return [cameras[keys.index(key)] for key in unique], np.array(
        [unique.index(key) for key in keys], np.int64
    )


def registration_of(
    photoset: PhotoSet,
    method: Method,
    structure: Structure,
    frame: WorldFrame,
    source: ScaleSource,
    reasons: dict[int, str],
    warnings: Sequence[str],
) -> Registration:
    """A structure in its frame, under the names of the set."""
    poses = frame.of_poses(structure.poses)
    covariance = structure.covariance
    stated = [photo.label for photo in photoset.photos if photo.posed]
    if stated and source in ("free", "board"):
        mixed = (
            f"the manifest itself states poses ({stated[0]}), in another frame than the found ones: write poses ="
            " with the name of the result at its top, so that all are taken from there, or take its own out"
        )
        warnings = [*warnings, mixed]
    return Registration(
        method=method,
        names=tuple(photoset.photos[place].name for place in structure.photos),
        labels=tuple(photoset.photos[place].label for place in structure.photos),
        poses=poses,
        covariance=None if covariance is None else frame.of_covariance(covariance, poses),
        rms_px=structure.rms_px,
        observations=structure.observations,
        unregistered={photoset.photos[place].name: why for place, why in sorted(reasons.items())},
        points=frame.apply(structure.points),
        colours=structure.colours,
        scale_from=source,
        relative_std=None if frame.covariance is None else float(np.sqrt(frame.covariance[6, 6])),
        warnings=tuple(warnings),
    )


def checked(
    photoset: PhotoSet, found: Registration, otherwise: str, conventions: Conventions | None = None
) -> Registration:
    """The registration if poses and masks agree, with a warning where they hardly do.

    conventions : in which another program may have written the poses; found ones are in none but ours.
    """
    by_name = {photo.name: photo for photo in photoset.photos}
    photos = [by_name[name] for name in found.names]
    cameras = [photo.camera.posed(pose) for photo, pose in zip(photos, found.poses, strict=True)]
    coverages = [mask for mask in map(photo_mask, photos) if mask is not None]
    warning = None
    try:
        if len(photos) >= _FEWEST and len(coverages) == len(photos):
            labels = [photo.label for photo in photos]
            warning = check_silhouettes(cameras, coverages, labels, conventions or {}, otherwise)
        elif conventions is not None:
            check_viewing_directions(cameras, conventions)
    except ValueError as error:
        raise ValueError(f"{photoset.manifest}: {error}") from error
    return found if warning is None else replace(found, warnings=(*found.warnings, warning))
