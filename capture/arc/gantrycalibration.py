"""A gantry's calibration from photographs of a board that stands still while the camera travels along its arc."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from capture.arc.arcfit import ArcFit, ArcView, fit_arc
from capture.boards.board import Board, parse_board
from capture.boards.boardpose import board_pose
from capture.boards.boardsearch import check_board, missing, view_of_file
from capture.camera import Camera

Floats = NDArray[np.float64]
Progress = Callable[[Iterable[Path], str], Iterable[Path]]


def calibrate_gantry(
    photos: Sequence[Path],
    board: Board | str,
    camera: Camera,
    angles: Sequence[float] | None = None,
    progress: Progress | None = None,
) -> tuple[ArcFit, tuple[str, ...]]:
    """The arc that a camera travels along, from photographs of a board that stands still.

    photos : in the order of travel. board : as `capture.boards.board.parse_board` reads it, or parsed.
    camera : the calibrated camera; its pose doesn't matter.
    angles : radians, as the gantry shows them, one per photo; see `capture.arc.arcfit.fit_arc`.
    The world of the arc is the board's frame: origin at its first corner, x right and y up as printed, z out of its
    face. On a turntable the board turns instead, before a camera that stands still: the arc is then the camera's, as
    seen from the table.
    Returns the fit, and sentences that name photos without a usable board, which are left out. ValueError as in
    `fit_arc`, and if the photographs show another board.
    """
    board = parse_board(board) if isinstance(board, str) else board
    if angles is not None and len(angles) != len(photos):
        raise ValueError(f"{len(angles)} angles for {len(photos)} photos: give one for each, in their order")
    seen = [
        view_of_file(path, board)
        for path in (progress(photos, "Looking for the board") if progress else photos)
    ]
    check_board(seen, board)
    kept, views, left_out = [], [], []
    for index, view in enumerate(seen):
        if view.detection is None:
            left_out.append(f"{view.name}: {missing(view, board)}")
            continue
        try:
            pose, _, _ = board_pose(view.detection, camera)
        except ValueError as error:
            left_out.append(f"{view.name}: {error}")
            continue
        points = board.cell_points(view.detection.cells)
        kept.append(index)
        views.append(ArcView(view.name, points, view.detection.points, pose))
    if _is_ambiguous(board):
        views = _all_one_way_up(views, board)
    nominal = None if angles is None else [angles[index] for index in kept]
    return fit_arc(views, camera, nominal), tuple(left_out)


def gantry_document(fit: ArcFit, names: Sequence[str]) -> dict[str, Any]:
    """What a gantry.json holds, but for inputs and software: the arc as [gantry] takes it, with standard deviations."""
    arc = fit.arc
    return {
        "format": 1,
        "centre": arc.centre.tolist(),
        "axis": arc.axis.tolist(),
        "radius": arc.radius,
        "start": arc.start.tolist(),
        "mount": arc.mount.tolist(),
        "step_deg": None if arc.step is None else float(np.degrees(arc.step)),
        "std": {
            "centre": fit.centre_std.tolist(),
            "axis_deg": float(np.degrees(fit.axis_std)),
            "radius": fit.radius_std,
            "start_deg": float(np.degrees(fit.start_std)),
            "mount_deg": float(np.degrees(fit.mount_std)),
            "step_deg": None if fit.step_std is None else float(np.degrees(fit.step_std)),
        },
        "photos": [
            {
                "photo": name,
                "angle_deg": float(np.degrees(angle)),
                "angle_std_deg": float(np.degrees(std)),
                "rms_px": float(rms),
                "rms_px_with_its_own_pose": float(free),
            }
            for name, angle, std, rms, free in zip(
                names, fit.angles, fit.angle_std, fit.rms_px, fit.free_rms_px, strict=True
            )
        ],
    }


def _is_ambiguous(board: Board) -> bool:
    """Whether the board looks the same when it is turned by half."""
    columns, rows = board.corner_counts
    return board.kind == "chessboard" and (columns + rows) % 2 == 0


def _all_one_way_up(views: Sequence[ArcView], board: Board) -> list[ArcView]:
    """The views with the board turned by half wherever that brings the camera nearer to where it was before."""
    columns, rows = board.corner_counts
    middle = board.cell_points(np.array([[columns - 1, rows - 1]]))[0] / 2
    half = np.diag([-1.0, -1.0, 1.0, 1.0])
    half[:3, 3] = 2 * middle * [1, 1, 0]
    result: list[ArcView] = []
    for view in views:
        turned = ArcView(
            view.name, view.points @ half[:3, :3] + half[:3, 3], view.pixels, view.world_to_camera @ half
        )
        choices = [view, turned]
        if result:
            choices.sort(key=lambda choice: _turn(choice.world_to_camera, result[-1].world_to_camera))
        result.append(choices[0])
    return result


def _turn(one: Floats, other: Floats) -> float:
    """The angle between two poses in radians."""
    return float(Rotation.from_matrix(one[:3, :3] @ other[:3, :3].T).magnitude())
