"""A board in photographs of a set: poses in its frame, and corners that fix a world's place and size."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import partial

import numpy as np
from numpy.typing import NDArray

from capture.boards.board import Board, Detection
from capture.boards.boardpose import board_pose
from capture.boards.boardsearch import BoardView, board_view, check_board, missing
from capture.camera import Camera
from capture.decode import decode_photo
from capture.photo import Photo
from capture.photoset import PhotoSet
from capture.progress import Track
from capture.radiometry import Radiometry
from capture.tasks.stage import stage_results
from recon.poses.register.structure import Landmarks, Structure
from recon.poses.similarity import cross_matrix

Floats = NDArray[np.float64]

# A board that no pose brings within this share of the picture's width of its corners isn't what it was said to be.
_HOPELESS = 0.01


@dataclass(frozen=True, eq=False)
class BoardDetections:
    """Where photographs of a set show a board.

    detections : by the photographs' places. reasons : why the others show none.
    """

    board: Board
    detections: dict[int, Detection]
    reasons: dict[int, str]


def find_board(photoset: PhotoSet, board: Board, track: Track) -> BoardDetections:
    """Look for a board in all photographs; ValueError if they show another one, or none at all."""
    columns, rows = board.corner_counts
    if board.kind == "chessboard" and (columns + rows) % 2 == 0:
        raise ValueError(
            f"--board {board.spec}: looks the same turned by half, so that no pose follows from it; use a charuco"
            " board, or a chessboard of one even and one odd count"
        )
    view = partial(_view, photoset.radiometry, board)
    found = stage_results("boards", view, photoset.photos, lambda photo: str(photo.file))
    views = [next(found) for _ in track(photoset.photos, "Looking for the board")]
    check_board(views, board)
    detections, reasons = {}, {}
    for place, seen in enumerate(views):
        if seen.detection is None:
            reasons[place] = missing(seen, board)
        elif not seen.detection.located:
            reasons[place] = "only a part of the chessboard was seen, and it could be any part"
        else:
            detections[place] = seen.detection
    if not detections:
        raise ValueError(f"--board {board.spec}: no photo shows it; {views[0].name}: {reasons[0]}")
    return BoardDetections(board, detections, reasons)


def _view(radiometry: Radiometry, board: Board, photo: Photo) -> BoardView:
    return board_view(decode_photo(radiometry, photo).radiance, board, photo.label)


def board_structure(
    sightings: BoardDetections, cameras: Sequence[Camera]
) -> tuple[Structure, dict[int, str]]:
    """Poses in the board's frame, each from its own corners; and photographs, by place, whose corners give none.

    The points are the board's corners. ValueError where corners lie so far off that camera or board must be wrong.
    """
    photos, poses, blocks, residuals, counts = [], [], [], [], []
    failed = {}
    for place, detection in sorted(sightings.detections.items()):
        camera = cameras[place]
        try:
            pose, covariance, rms = board_pose(detection, camera)
        except ValueError as error:
            failed[place] = str(error)
            continue
        if rms > _HOPELESS * camera.width:
            failed[place] = (
                f"no pose brings the board within {rms:.1f} px (RMS) of its corners: the camera's parameters or the"
                " board's measures are wrong, or the board isn't flat"
            )
            continue
        photos.append(place)
        poses.append(pose)
        # From a shift of the world's origin, as board_pose has it, to one of the camera.
        to_centre = np.eye(6)
        to_centre[3:, :3] = cross_matrix(pose[:3, 3])
        blocks.append(to_centre @ covariance @ to_centre.T)
        residuals.append(rms)
        counts.append(len(detection.cells))
    if not photos:
        place = min(failed)
        raise ValueError(f"--board {sightings.board.spec}: photo {place + 1} of the set: {failed[place]}")
    full = np.zeros((6 * len(photos),) * 2)
    for number, block in enumerate(blocks):
        full[6 * number : 6 * number + 6, 6 * number : 6 * number + 6] = block
    corners = sightings.board.corners
    structure = Structure(
        photos=np.array(photos, np.int64),
        poses=np.array(poses),
        covariance=full,
        points=corners,
        colours=np.full((len(corners), 3), 128, np.uint8),
        rms_px=np.array(residuals),
        observations=np.array(counts, np.int64),
    )
    return structure, failed


def corner_landmarks(sightings: BoardDetections) -> Landmarks:
    """The board's corners as landmarks, numbered as in `Board.corners`."""
    columns, _ = sightings.board.corner_counts
    entries = sorted(sightings.detections.items())
    return Landmarks(
        photo=np.concatenate([np.full(len(seen.cells), place) for place, seen in entries]),
        point=np.concatenate([seen.cells[:, 1] * columns + seen.cells[:, 0] for _, seen in entries]),
        pixels=np.concatenate([seen.points for _, seen in entries]),
    )
