"""The poses of a photo set's photographs by features and by a board, in the frame that these or the set itself give."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
from numpy.typing import NDArray

from capture.boards.board import Board
from capture.decode import decode_photo, read_mask
from capture.manifest import read_manifest
from capture.parallel import parallel_map
from capture.photo import Photo
from capture.photoset import PhotoSet
from capture.progress import Track
from recon.poses.register.advice import nothing_matches, some_missing, unsteady
from recon.poses.register.boards import BoardDetections, board_structure, corner_landmarks, find_board
from recon.poses.register.bundle import Bundle, adjust, spread
from recon.poses.register.features import Matches, PhotoRecord, mask_file, match_features
from recon.poses.register.frame import WorldFrame, frame_of_points, frame_of_poses, free_frame
from recon.poses.register.outcome import checked, distinct_lenses, perspective_cameras, registration_of
from recon.poses.register.patches import refine_places
from recon.poses.register.pictures import feature_picture
from recon.poses.register.posesfile import Registration, ScaleSource
from recon.poses.register.structure import (
    SparseModel,
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
    cameras = perspective_cameras(photoset)
    if len(cameras) < 2:
        raise ValueError(
            f"{photoset.manifest}: lists one photo; poses are found from two or more, of many sides"
        )
    sightings = None if board is None else find_board(photoset, board, track)
    if sightings is not None and len(sightings.detections) == len(cameras):
        return _by_board(photoset, sightings)
    lenses, lens_of = distinct_lenses(cameras)
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
    found = registration_of(photoset, "features", structure, frame, source, reasons, warnings)
    otherwise = (
        "check the masks"
        if masked
        else "if the object turned before a backdrop that stood still, the poses are the backdrop's: register with"
        " --masked"
    )
    return checked(photoset, found, otherwise)


def masks_of(photoset: PhotoSet) -> bool:
    """Whether every photograph has a mask."""
    return all(photo.mask is not None for photo in photoset.photos)


def _write_pictures(
    photoset: PhotoSet, folder: Path, masked: bool, lens_of: Ints, track: Track
) -> list[PhotoRecord]:
    """The photographs as pictures for COLMAP, and their masks."""
    if masked:
        mask_file(folder / "of").parent.mkdir()
    names = [f"{place:05d}.png" for place in range(len(photoset.photos))]

    def write(entry: tuple[Photo, str]) -> None:
        photo, name = entry
        radiance = decode_photo(photoset.radiometry, photo).radiance
        inside = None
        if masked:
            assert photo.mask is not None
            inside = read_mask(photo.mask, radiance.shape[:2]) >= 0.5
            cv2.imwrite(str(mask_file(folder / name)), np.where(inside, 255, 0).astype(np.uint8))
        cv2.imwrite(str(folder / name), feature_picture(radiance, inside)[:, :, ::-1])

    work = parallel_map(write, zip(photoset.photos, names, strict=True))
    for _ in track(names, "Reading the photos"):
        next(work)
    return [PhotoRecord(name, int(lens)) for name, lens in zip(names, lens_of, strict=True)]


def _refined(mapped: SparseModel, pictures: Sequence[Path]) -> Bundle:
    """The adjusted bundle, features' places being refined by the pictures of its photographs."""
    bundle = adjust(mapped.bundle)

    def picture(photo: int) -> NDArray[np.uint8]:
        return np.asarray(cv2.imread(str(pictures[photo]), cv2.IMREAD_GRAYSCALE), np.uint8)

    return adjust(refine_places(bundle, mapped.shapes, picture, spread(bundle)))


def _by_board(photoset: PhotoSet, sightings: BoardDetections) -> Registration:
    structure, failed = board_structure(sightings, [photo.camera for photo in photoset.photos])
    reasons = {place: f"the board: {why}" for place, why in {**sightings.reasons, **failed}.items()}
    warnings = [some_missing(photoset, reasons, len(structure.photos))] if reasons else []
    frame = WorldFrame(1.0, np.eye(3), np.zeros(3))
    found = registration_of(photoset, "board", structure, frame, "board", reasons, warnings)
    return checked(photoset, found, "check the masks, and that the board moved with the object")


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


def _frame(photoset: PhotoSet, structure: Structure) -> tuple[WorldFrame, ScaleSource, list[str]]:
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
