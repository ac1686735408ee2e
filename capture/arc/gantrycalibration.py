"""A gantry's calibration from photographs of a board that stands still while the camera travels along its arc."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from capture.arc.arcfit import FEWEST_PHOTOS, ArcFit, ArcView, fit_arc, outlying_views
from capture.boards.board import Board, parse_board
from capture.boards.boardpose import board_pose
from capture.boards.boardsearch import check_board, missing, view_of_file
from capture.camera import Camera

Floats = NDArray[np.float64]
# RMS distance of corners from their places, as a share of the picture's width, that no camera that was calibrated
# leaves: half a pixel in a thousand is worth a word, two and a half are hopeless.
_DOUBTFUL, _HOPELESS = 0.0005, 0.0025
# Nor do corners in any photographs lie nearer than this.
_SMALL_PX = 0.15
# How far a photograph may be from the angle that the gantry shows.
_NOTABLE_ANGLE_DEG, _WRONG_ANGLE_DEG = 0.2, 10.0
Progress = Callable[[Iterable[Path], str], Iterable[Path]]


@dataclass(frozen=True, eq=False)
class GantryCalibration:
    """A calibrated gantry.

    fit : the arc. names : of the photographs that it was fitted to. nominal : (p,) radians, their angles as the gantry
        shows them, or None. left_out : sentences that name the other photographs. warnings : in plain words.
    """

    fit: ArcFit
    names: tuple[str, ...]
    nominal: Floats | None
    left_out: tuple[str, ...]
    warnings: tuple[str, ...]

    @property
    def deviation(self) -> Floats | None:
        """(p,) radians, how far each photograph is from where the gantry says it stood."""
        return None if self.nominal is None else self.fit.angles - self.nominal


def calibrate_gantry(
    photos: Sequence[Path],
    board: Board | str,
    camera: Camera,
    angles: Sequence[float] | None = None,
    camera_covariance: Floats | None = None,
    camera_rms: float | None = None,
    progress: Progress | None = None,
) -> GantryCalibration:
    """The arc that a camera travels along, from photographs of a board that stands still.

    photos : in the order of travel. board : as `capture.boards.board.parse_board` reads it, or parsed.
    camera : the calibrated camera; its pose doesn't matter. camera_covariance : of its parameters, and camera_rms : in
        pixels, of its own calibration, if known.
    angles : radians, as the gantry shows them, one per photo; see `capture.arc.arcfit.fit_arc`.
    The world of the arc is the board's frame: origin at its first corner, x right and y up as printed, z out of its
    face. On a turntable the board turns instead, before a camera that stands still: the arc is then the camera's, as
    seen from the table.
    Photographs without a usable board are left out, and such as don't fit the arc of the others. ValueError as in
    `fit_arc`; if the photographs show another board, were taken with another camera, or contradict the angles.
    """
    board = parse_board(board) if isinstance(board, str) else board
    _check_arguments(photos, angles)
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
    if len(views) < FEWEST_PHOTOS and left_out:
        raise ValueError(
            f"{len(views)} photos show the board, and an arc needs {FEWEST_PHOTOS}; left out: {'; '.join(left_out[:3])}"
            + (f"; and {len(left_out) - 3} more" if len(left_out) > 3 else "")
        )
    if _is_ambiguous(board):
        views = _all_one_way_up(views, board)
    warnings = _check_camera(views, camera, camera_rms)
    nominal = None if angles is None else np.array([angles[index] for index in kept])
    outlying = outlying_views(views, camera)
    fits = [place for place in range(len(views)) if place not in outlying]
    left_out += [
        f"{views[place].name}: doesn't fit the arc of the others ({off:.1f} px off): the board or camera moved"
        for place, off in outlying.items()
    ]
    views = [views[place] for place in fits]
    nominal = None if nominal is None else nominal[fits]
    found = GantryCalibration(
        fit=fit_arc(views, camera, nominal, camera_covariance),
        names=tuple(view.name for view in views),
        nominal=nominal,
        left_out=tuple(left_out),
        warnings=(),
    )
    return replace(found, warnings=(*warnings, *_angle_warnings(found), *_arc_warnings(found)))


def _check_arguments(photos: Sequence[Path], angles: Sequence[float] | None) -> None:
    for photo in photos:
        if list(photos).count(photo) > 1:
            raise ValueError(f"{photo}: is given twice; every photo may count once")
    if angles is None:
        return
    if len(angles) != len(photos):
        raise ValueError(f"{len(angles)} angles for {len(photos)} photos: give one for each, in their order")
    if not np.isfinite(angles).all() or np.ptp(angles) == 0:
        raise ValueError(
            f"the angles are {np.round(np.degrees(angles), 3).tolist()} degrees; they must be finite and differ"
        )


def _check_camera(views: Sequence[ArcView], camera: Camera, camera_rms: float | None) -> list[str]:
    """ValueError, or a warning, if no pose of this camera explains what it is said to have seen."""
    errors = [camera.posed(view.world_to_camera).project(view.points) - view.pixels for view in views]
    off = float(np.sqrt(np.mean([np.mean((error**2).sum(axis=1)) for error in errors])))
    sentence = (
        f"corners lie {off:.2f} px (RMS) from where this camera can see them from anywhere: the camera file belongs to"
        " another camera, focus or zoom, or the board isn't as it was said"
    )
    if off > _HOPELESS * camera.width:
        raise ValueError(sentence)
    if camera_rms is not None and off > max(3 * camera_rms, _SMALL_PX):
        return [f"{sentence} (its own calibration left {camera_rms:.2f} px)"]
    return [sentence] if off > _DOUBTFUL * camera.width else []


def _angle_warnings(found: GantryCalibration) -> list[str]:
    """ValueError, or a warning, if the gantry's own angles are not where the photographs were taken."""
    if found.deviation is None or found.nominal is None:
        return []
    worst = int(np.argmax(np.abs(found.deviation)))
    off = np.degrees(found.deviation[worst])
    sentence = (
        f"{found.names[worst]} was taken at {np.degrees(found.fit.angles[worst]):.2f} degrees, not at the"
        f" {np.degrees(found.nominal[worst]):.2f} that was given"
    )
    if abs(off) > _WRONG_ANGLE_DEG:
        raise ValueError(f"{sentence}; check the angles and the order of the photos")
    return (
        [sentence] if abs(off) > max(_NOTABLE_ANGLE_DEG, 5 * np.degrees(found.fit.angle_std[worst])) else []
    )


def _arc_warnings(found: GantryCalibration) -> list[str]:
    on_arc, free = (np.sqrt(np.mean(rms**2)) for rms in (found.fit.rms_px, found.fit.free_rms_px))
    if on_arc <= 2 * free:
        return []
    worst = int(np.argmax(found.fit.rms_px))
    return [
        f"the camera doesn't keep to an arc, {found.names[worst]} least of all ({found.fit.rms_px[worst]:.1f} px off):"
        " the board moved, or the arm bends. The standard deviations allow for it; if they are too large, give each"
        " photo a pose of its own"
    ]


def gantry_document(found: GantryCalibration) -> dict[str, Any]:
    """What a gantry.json holds, but for inputs and software: the arc as [gantry] takes it, with standard deviations."""
    fit, arc = found.fit, found.fit.arc
    nominal = np.full(len(found.names), np.nan) if found.nominal is None else np.degrees(found.nominal)
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
                "given_angle_deg": None if np.isnan(given) else float(given),
                "rms_px": float(rms),
                "rms_px_with_its_own_pose": float(free),
            }
            for name, angle, std, given, rms, free in zip(
                found.names, fit.angles, fit.angle_std, nominal, fit.rms_px, fit.free_rms_px, strict=True
            )
        ],
        "left_out": list(found.left_out),
        "warnings": list(found.warnings),
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
