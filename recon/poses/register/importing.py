"""Poses that another program found, for the photographs of a set: matched by name, checked, taken as they are."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np

from capture.camera import Camera
from capture.photoset import PhotoSet
from recon.placement.conventions import other_conventions
from recon.poses.register.advice import some_missing
from recon.poses.register.frame import WorldFrame
from recon.poses.register.importcolmap import read_colmap
from recon.poses.register.imported import ImportedPose, camera_warning, same_camera
from recon.poses.register.importtransforms import read_transforms, transforms_conventions
from recon.poses.register.names import match_names, missing_reason
from recon.poses.register.outcome import checked, distinct_lenses, perspective_cameras, registration_of
from recon.poses.register.posesfile import Method, Registration
from recon.poses.register.silhouettes import Conventions
from recon.poses.register.structure import Structure, bundle_of, structure_of


def register_by_colmap(photoset: PhotoSet, folder: Path) -> Registration:
    """Poses and points of a COLMAP model, as they are; in the frame of the manifest's own poses if it has some."""
    cameras = perspective_cameras(photoset)
    model, numbers, poses = read_colmap(folder)
    entries, reasons, warnings = _matched(photoset, cameras, poses, folder.name)
    place_of = {numbers[entry]: place for place, entry in entries.items()}
    same = all(same_camera(cameras[place], poses[entry].camera) for place, entry in entries.items())
    structure = _imported_structure(poses, entries)
    if same and len(entries) >= 2:
        lenses, lens_of = distinct_lenses(cameras)
        mapped = bundle_of(model, place_of, lenses, lens_of)
        # A model without points, as a renderer writes it, has poses only.
        if len(mapped.bundle.points) > 2 * len(mapped.photos):
            structure = structure_of(mapped.bundle, mapped.photos, mapped.colours)
    elif model.num_points3D():
        points = [point for _, point in sorted(model.points3D.items())]
        colours = np.array([point.color for point in points], np.uint8)
        structure = replace(structure, points=np.array([point.xyz for point in points]), colours=colours)
    return _finish_import(photoset, "colmap", structure, reasons, warnings, other_conventions())


def register_by_transforms(photoset: PhotoSet, path: Path) -> Registration:
    """Poses of a transforms.json, as they are; in the frame of the manifest's own poses if it has some."""
    cameras = perspective_cameras(photoset)
    poses = read_transforms(path)
    entries, reasons, warnings = _matched(photoset, cameras, poses, path.name)
    structure = _imported_structure(poses, entries)
    return _finish_import(photoset, "transforms", structure, reasons, warnings, transforms_conventions())


def _matched(
    photoset: PhotoSet, cameras: Sequence[Camera], poses: Sequence[ImportedPose], source: str
) -> tuple[dict[int, int], dict[int, str], list[str]]:
    """Which entry belongs to which photograph, by place; why the others have none; and what is to be warned of."""
    names, others = [photo.name for photo in photoset.photos], [pose.name for pose in poses]
    found = match_names(names, others, source)
    entries = {place: entry for place, entry in enumerate(found) if entry is not None}
    reasons = {
        place: missing_reason(names[place], others, source)
        for place, entry in enumerate(found)
        if entry is None
    }
    labels = [photoset.photos[place].label for place in entries]
    warning = camera_warning(
        [cameras[place] for place in entries], [poses[entry].camera for entry in entries.values()], labels
    )
    warnings = [] if warning is None else [warning]
    if reasons:
        warnings.append(some_missing(photoset, reasons, len(entries)))
    return entries, reasons, warnings


def _imported_structure(poses: Sequence[ImportedPose], entries: dict[int, int]) -> Structure:
    return Structure(
        photos=np.array(list(entries), np.int64),
        poses=np.array([poses[entry].world_to_camera for entry in entries.values()]),
        covariance=None,
        points=np.zeros((0, 3)),
        colours=np.zeros((0, 3), np.uint8),
    )


def _finish_import(
    photoset: PhotoSet,
    method: Method,
    structure: Structure,
    reasons: dict[int, str],
    warnings: list[str],
    conventions: Conventions,
) -> Registration:
    frame = WorldFrame(1.0, np.eye(3), np.zeros(3))
    found = registration_of(photoset, method, structure, frame, "free", reasons, warnings)
    return checked(photoset, found, "check that the file belongs to this set, and the masks", conventions)
