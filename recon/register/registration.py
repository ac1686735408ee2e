"""The poses of a photo set's photographs: by features, a board, or another program's files; framed and checked."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
from numpy.typing import NDArray

from capture.boards.board import Board
from capture.camera import Camera
from capture.decode import decode_photo, read_mask
from capture.manifest import read_manifest
from capture.parallel import parallel_map
from capture.photoset import Photo, PhotoSet
from capture.progress import Track
from recon.conventions import other_conventions
from recon.register.advice import nothing_matches, some_missing, unsteady
from recon.register.boards import BoardSightings, board_structure, corner_landmarks, find_board
from recon.register.bundle import Bundle, adjust, spread
from recon.register.features import Matches, Shot, match_features
from recon.register.frame import Frame, frame_of_points, frame_of_poses, free_frame
from recon.register.importcolmap import read_colmap
from recon.register.imported import ImportedPose, camera_warning, same_camera
from recon.register.importtransforms import read_transforms, transforms_conventions
from recon.register.names import match_names, missing_reason
from recon.register.patches import refine_places
from recon.register.pictures import feature_picture
from recon.register.posesfile import Method, Registration, ScaleSource
from recon.register.silhouettes import Conventions, check_sight, check_silhouettes
from recon.register.structure import (
    Model,
    Structure,
    bundle_of,
    map_incrementally,
    structure_of,
    with_landmarks,
)

Floats = NDArray[np.float64]
Ints = NDArray[np.int64]

# Fewer photographs than these make no registration (two, where a set has no more).
_FEWEST = 3
# Features that a photograph must share with the others, and corners of a board that the poses must see, to count.
_FEWEST_FEATURES, _FEWEST_CORNERS = 15, 4
# Beyond these, poses that the manifest gives and found ones disagree: worth a word, and hopeless.
_NOTABLE_DEG, _WRONG_DEG = 0.5, 5.0


def register_by_features(
    photoset: PhotoSet, folder: Path, masked: bool, board: Board | None, track: Track
) -> Registration:
    """Poses by structure from motion, in the frame of the board, of the manifest's own poses, or free.

    folder : empty, for pictures and COLMAP's files. masked : whether features count only within masks.
    A board that all photographs show makes features needless: then its corners give each pose.
    ValueError, with advice, where too few photographs can be placed.
    """
    cameras = _perspective(photoset)
    if len(cameras) < 2:
        raise ValueError(
            f"{photoset.manifest}: lists one photo; poses are found from two or more, of many sides"
        )
    sightings = None if board is None else find_board(photoset, board, track)
    if sightings is not None and len(sightings.detections) == len(cameras):
        return _by_board(photoset, sightings)
    lenses, lens_of = _distinct(cameras)
    shots = _write_pictures(photoset, folder, masked, lens_of, track)
    database = folder / "features.db"
    matches = match_features(database, folder, shots, lenses, masked, track)
    model = map_incrementally(database, folder, len(shots))
    needed = min(_FEWEST, len(cameras))
    if model is None or model.num_reg_images() < needed:
        if sightings is not None and len(sightings.detections) >= needed:
            return _by_board(photoset, sightings)
        raise ValueError(f"{photoset.manifest}: {nothing_matches(photoset, matches, masked)}")
    place_of = {number: number - 1 for number in model.images}
    mapped = bundle_of(model, place_of, lenses, lens_of, matches.shapes)
    photos = mapped.photos
    pictures = [folder / shots[place].name for place in photos]
    bundle = _refined(mapped, pictures)
    numbers: Ints = np.zeros(0, np.int64)
    if sightings is not None:
        bundle, numbers = with_landmarks(bundle, photos, corner_landmarks(sightings))
        bundle = adjust(bundle)
    structure, weak = _sound(structure_of(bundle, photos, mapped.colours))
    if len(structure.photos) < needed:
        raise ValueError(f"{photoset.manifest}: {nothing_matches(photoset, matches, masked)}")
    assert structure.rms_px is not None
    try:
        rms, width = float(np.median(structure.rms_px)), max(camera.width for camera in cameras)
        doubt = unsteady(structure.disagreement, rms, width)
    except ValueError as error:
        raise ValueError(f"{photoset.manifest}: {error}") from error
    reasons = {**_unplaced(matches, photos, len(cameras)), **weak}
    frame, source, warnings = _frame(photoset, structure)
    if sightings is not None:
        if len(numbers) < _FEWEST_CORNERS:
            raise ValueError(
                f"--board {sightings.board.spec}: {len(numbers)} of its corners are seen by two or more of the photos"
                f" that could be placed, {_FEWEST_CORNERS} are the least; let more photos show it"
            )
        frame = frame_of_points(
            bundle.points[len(bundle.points) - len(numbers) :], sightings.board.corners[numbers]
        )
        source, warnings = "board", []
    if doubt:
        warnings = [*warnings, doubt]
    if reasons:
        warnings = [*warnings, some_missing(photoset, reasons, len(structure.photos))]
    found = _registration(photoset, "features", structure, frame, source, reasons, warnings)
    otherwise = (
        "check the masks"
        if masked
        else "if the object turned before a backdrop that stood still, the poses are the backdrop's: register with"
        " --masked"
    )
    return _checked(photoset, found, otherwise)


def register_by_colmap(photoset: PhotoSet, folder: Path) -> Registration:
    """Poses and points of a COLMAP model, as they are; in the frame of the manifest's own poses if it has some."""
    cameras = _perspective(photoset)
    model, numbers, poses = read_colmap(folder)
    entries, reasons, warnings = _matched(photoset, cameras, poses, folder.name)
    place_of = {numbers[entry]: place for place, entry in entries.items()}
    same = all(same_camera(cameras[place], poses[entry].camera) for place, entry in entries.items())
    structure = _imported_structure(poses, entries)
    if same and len(entries) >= 2:
        lenses, lens_of = _distinct(cameras)
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
    cameras = _perspective(photoset)
    poses = read_transforms(path)
    entries, reasons, warnings = _matched(photoset, cameras, poses, path.name)
    structure = _imported_structure(poses, entries)
    return _finish_import(photoset, "transforms", structure, reasons, warnings, transforms_conventions())


def masks_of(photoset: PhotoSet) -> bool:
    """Whether every photograph has a mask."""
    return all(photo.mask is not None for photo in photoset.photos)


def _perspective(photoset: PhotoSet) -> list[Camera]:
    for photo in photoset.photos:
        if photo.camera.is_orthographic:
            raise ValueError(
                f'{photoset.manifest}: photo "{photo.name}": poses are found for perspective cameras; an ORTHOGRAPHIC'
                " one needs world_to_camera"
            )
    return [photo.camera for photo in photoset.photos]


def _distinct(cameras: Sequence[Camera]) -> tuple[list[Camera], Ints]:
    """The different cameras, and which of them each photograph was taken by."""
    keys = [(camera.model, tuple(camera.params.tolist()), camera.width, camera.height) for camera in cameras]
    unique = list(dict.fromkeys(keys))
    return [cameras[keys.index(key)] for key in unique], np.array(
        [unique.index(key) for key in keys], np.int64
    )


def _write_pictures(
    photoset: PhotoSet, folder: Path, masked: bool, lens_of: Ints, track: Track
) -> list[Shot]:
    """The photographs as pictures for COLMAP, and their masks."""
    masks = folder / "masks"
    masks.mkdir()
    names = [f"{place:05d}.png" for place in range(len(photoset.photos))]

    def write(entry: tuple[Photo, str]) -> None:
        photo, name = entry
        radiance = decode_photo(photoset, photo).radiance
        inside = None
        if masked:
            assert photo.mask is not None
            inside = read_mask(photo.mask, radiance.shape[:2]) >= 0.5
            cv2.imwrite(str(masks / f"{name}.png"), np.where(inside, 255, 0).astype(np.uint8))
        cv2.imwrite(str(folder / name), feature_picture(radiance, inside)[:, :, ::-1])

    work = parallel_map(write, zip(photoset.photos, names, strict=True))
    for _ in track(names, "Reading the photos"):
        next(work)
    return [Shot(name, int(lens)) for name, lens in zip(names, lens_of, strict=True)]


def _refined(mapped: Model, pictures: Sequence[Path]) -> Bundle:
    """The adjusted bundle, features' places being refined by the pictures of its photographs."""
    bundle = adjust(mapped.bundle)

    def picture(photo: int) -> NDArray[np.uint8]:
        return np.asarray(cv2.imread(str(pictures[photo]), cv2.IMREAD_GRAYSCALE), np.uint8)

    return adjust(refine_places(bundle, mapped.shapes, picture, spread(bundle)))


def _by_board(photoset: PhotoSet, sightings: BoardSightings) -> Registration:
    structure, failed = board_structure(sightings, [photo.camera for photo in photoset.photos])
    reasons = {place: f"the board: {why}" for place, why in {**sightings.reasons, **failed}.items()}
    warnings = [some_missing(photoset, reasons, len(structure.photos))] if reasons else []
    frame = Frame(np.eye(3), np.zeros(3), 1.0)
    found = _registration(photoset, "board", structure, frame, "board", reasons, warnings)
    return _checked(photoset, found, "check the masks, and that the board moved with the object")


def _sound(structure: Structure) -> tuple[Structure, dict[int, str]]:
    """The structure without photographs that hang on too few features, and those by their places."""
    assert structure.observations is not None
    assert structure.rms_px is not None
    assert structure.covariance is not None
    keep = structure.observations >= _FEWEST_FEATURES
    weak = {
        int(
            structure.photos[row]
        ): f"only {structure.observations[row]} of its features agree with other photos"
        for row in np.flatnonzero(~keep)
    }
    six = np.repeat(keep, 6)
    return replace(
        structure,
        photos=structure.photos[keep],
        poses=structure.poses[keep],
        covariance=structure.covariance[np.ix_(six, six)],
        rms_px=structure.rms_px[keep],
        observations=structure.observations[keep],
    ), weak


def _unplaced(matches: Matches, photos: Ints, count: int) -> dict[int, str]:
    """Why photographs could not be placed, by their places."""
    reasons = {}
    for place in sorted(set(range(count)) - set(photos.tolist())):
        partners = int((matches.pairs == place).any(axis=1).sum())
        reasons[place] = (
            f"its {matches.keypoints[place]} features match {partners} other photos,"
            " which is too little to place it"
        )
    return reasons


def _frame(photoset: PhotoSet, structure: Structure) -> tuple[Frame, ScaleSource, list[str]]:
    """The world's frame where no board gives it: the manifest's own poses, or a free one."""
    rows = [row for row, place in enumerate(structure.photos.tolist()) if photoset.photos[place].posed]
    if len(rows) < 2:
        return free_frame(structure.poses, structure.points), "free", []
    places = structure.photos[rows]
    given = np.array([photoset.photos[place].camera.world_to_camera for place in places])
    centre = np.median(structure.points, axis=0)
    distance = float(
        np.median(np.linalg.norm(structure.poses[:, :3, :3] @ centre + structure.poses[:, :3, 3], axis=1))
    )
    frame = frame_of_poses(structure.poses[rows], given, distance)
    assert frame.residuals is not None
    turns = np.degrees(np.linalg.norm(frame.residuals[:, :3], axis=1))
    shifts = np.degrees(np.linalg.norm(frame.residuals[:, 3:], axis=1) / (distance * frame.scale))
    off = np.maximum(turns, shifts)
    worst = int(np.argmax(off))
    sentence = (
        f"the manifest's own poses and the found ones are {np.median(off):.2f} degrees apart (median of {len(rows)}, as"
        f" seen from the camera or from the object), {photoset.photos[places[worst]].label} most: {off[worst]:.2f}"
    )
    if np.median(off) > _WRONG_DEG:
        raise ValueError(
            f"{photoset.manifest}: {sentence}; check the gantry's axis and angles and the order of the photos, or take"
            " the poses out of the manifest"
        )
    manifest = read_manifest(photoset.manifest)
    source: ScaleSource = "gantry" if manifest.gantry is not None else "poses"
    return frame, source, [sentence] if off[worst] > _NOTABLE_DEG else []


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
    frame = Frame(np.eye(3), np.zeros(3), 1.0)
    found = _registration(photoset, method, structure, frame, "free", reasons, warnings)
    return _checked(photoset, found, "check that the file belongs to this set, and the masks", conventions)


def _registration(
    photoset: PhotoSet,
    method: Method,
    structure: Structure,
    frame: Frame,
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
        points=frame.of_points(structure.points),
        colours=structure.colours,
        scale_from=source,
        relative_std=None if frame.covariance is None else float(np.sqrt(frame.covariance[6, 6])),
        warnings=tuple(warnings),
    )


def _checked(
    photoset: PhotoSet, found: Registration, otherwise: str, conventions: Conventions | None = None
) -> Registration:
    """The registration if poses and masks agree, with a warning where they hardly do.

    conventions : in which another program may have written the poses; found ones are in none but ours.
    """
    by_name = {photo.name: photo for photo in photoset.photos}
    photos = [by_name[name] for name in found.names]
    cameras = [photo.camera.posed(pose) for photo, pose in zip(photos, found.poses, strict=True)]
    coverages = [
        read_mask(photo.mask, (photo.camera.height, photo.camera.width))
        for photo in photos
        if photo.mask is not None
    ]
    warning = None
    try:
        if len(photos) >= _FEWEST and len(coverages) == len(photos):
            labels = [photo.label for photo in photos]
            warning = check_silhouettes(cameras, coverages, labels, conventions or {}, otherwise)
        elif conventions is not None:
            check_sight(cameras, conventions)
    except ValueError as error:
        raise ValueError(f"{photoset.manifest}: {error}") from error
    return found if warning is None else replace(found, warnings=(*found.warnings, warning))
