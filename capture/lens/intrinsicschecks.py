"""Checks that refuse a calibration: a focal length that the views don't determine, or a fit that diverged."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from capture.boards.board import Board, Detection
from capture.camera import Camera
from capture.lens.boardshape import BoardShape
from capture.lens.lensfit import LensFit
from capture.lens.lensladder import LensCandidate

Floats = NDArray[np.float64]

# Boards that are within this angle of each other say nothing reliable about the focal length (Zhang 2000, section 3.2).
MIN_SPREAD_DEG = 8.0
ADVISED_SPREAD_DEG = 25.0
# A standard deviation of the focal length above this share of it is as good as none.
MAX_FOCAL_STD = 0.05
ADVISED_FOCAL_STD = 0.01
# Half pixels at 640x480; a lens model that leaves this share of the diagonal has not found the lens.
MAX_RMS_SHARE = 1 / 800
ADVISED_REACH = 0.7
# Corner windows of other sizes move corners by about half of what these miss their predictions by, if all is noise.
ADVISED_MISFIT = 5.0
# A square of a metre or more is usually one that was counted in other units.
LARGE_SQUARE = 1.0
# Times the picture's longer side: from beyond any fisheye to beyond any telephoto lens.
FOCAL_RANGE = (0.15, 50.0)

TILT_REMEDY = (
    "tilt the board by 30 degrees or more, in different directions, in at least three of the photos"
    " (moving it sideways, or turning it in its own plane, doesn't help)"
)


def normal_spread(poses: Floats) -> float:
    """The widest angle in degrees between the boards of two views; poses : (v, 4, 4)."""
    normals = poses[:, :3, 2]
    cosines = np.clip(normals @ normals.T, -1, 1)
    return float(np.degrees(np.arccos(cosines.min())))


def coverage(points: Floats, camera: Camera) -> tuple[float, float]:
    """Share of the picture within the hull of all corners, and their reach.

    The reach is the distance from the principal point to the farthest corner of a board over that to the farthest
    corner of the picture. points : (n, 2) pixels.
    """
    import cv2

    area = cv2.contourArea(cv2.convexHull(points.astype(np.float32)))
    centre = camera.project(np.array([[0.0, 0, 1]]))[0]
    ends = np.array([[x, y] for x in (0, camera.width) for y in (0, camera.height)], float)
    farthest = np.linalg.norm(ends - centre, axis=1).max()
    reach = np.linalg.norm(points - centre, axis=1).max() / farthest
    return float(area / (camera.width * camera.height)), float(min(reach, 1.0))


def check_tilts(candidates: Sequence[LensCandidate]) -> None:
    """ValueError if all boards lie at one tilt in the model that fits best: nothing then fixes the focal length."""
    fits = [candidate.fit for candidate in candidates if candidate.fit is not None]
    if not fits:
        return
    spread = normal_spread(min(fits, key=lambda fit: fit.rms).poses)
    if spread < MIN_SPREAD_DEG:
        raise ValueError(
            f"the focal length is undetermined: all boards lie within {spread:.1f} degrees of one tilt; {TILT_REMEDY}"
        )


def check_focal(fit: LensFit, focal_std: float) -> None:
    """ValueError if the focal length is as good as unknown. focal_std : its standard deviation, pixels."""
    share, spread = focal_std / fit.camera.focal_px, normal_spread(fit.poses)
    if share < MAX_FOCAL_STD:
        return
    if spread < ADVISED_SPREAD_DEG:
        raise ValueError(
            f"the focal length is undetermined: its standard deviation would be {share:.0%} of it, because boards tilt"
            f" by only {spread:.0f} degrees against each other; {TILT_REMEDY}"
        )
    raise ValueError(
        f"the calibration failed: photos disagree on the focal length by {share:.0%}, though boards tilt by up to"
        f" {spread:.0f} degrees against each other; were all taken with one focus and zoom, and the board flat?"
    )


def check_error(fit: LensFit, held_out_rms: float) -> None:
    """ValueError if a fit misses its corners, or those of views that it wasn't fitted to."""
    limit = MAX_RMS_SHARE * float(np.hypot(*fit.size))
    remedy = "check --board and that all photos were taken with one focus and zoom, and the board was flat"
    if not fit.rms < limit:
        raise ValueError(
            f"the calibration failed: it misses corners by {fit.rms:.2f} px RMS (limit {limit:.2f}); {remedy}"
        )
    if not held_out_rms < 2 * limit:
        raise ValueError(
            f"the calibration failed: it misses corners of photos that it wasn't fitted to by {held_out_rms:.2f} px"
            f" RMS (limit {2 * limit:.2f}), fitted ones by {fit.rms:.2f}; add photos, or leave out those that differ"
        )


def check_lens(fit: LensFit) -> None:
    """ValueError if a fit's numbers are no lens's."""
    width, height = fit.size
    focal, longest = fit.camera.focal_px, max(fit.size)
    low, high = FOCAL_RANGE[0] * longest, FOCAL_RANGE[1] * longest
    if not low < focal < high:
        raise ValueError(
            f"the calibration failed: a focal length of {focal:.0f} px is no lens's for {width}x{height} pixels"
            f" ({low:.0f} to {high:.0f} are believed); {TILT_REMEDY}"
        )
    x, y = fit.camera.project(np.array([[0.0, 0, 1]]))[0]
    if not (0 < x < width and 0 < y < height):
        raise ValueError(
            f"the calibration failed: the principal point ({x:.0f}, {y:.0f}) lies outside the picture; {TILT_REMEDY}"
        )


def no_model(candidates: Sequence[LensCandidate]) -> ValueError:
    """What to say when no candidate of the ladder can be used, or only models that fold in the picture fit."""
    folding = [
        candidate
        for candidate in candidates
        if candidate.fault is not None and candidate.held_out_rms is not None
    ]
    if folding:
        best = min(folding, key=lambda candidate: candidate.held_out_rms or 0.0)
        return ValueError(
            f"the calibration failed: the lens model that predicts best, {best.lens.name}, {best.fault}, and others"
            " miss the corners; add photos with the board in the picture's corners, and tilted in different directions"
        )
    faults = "; ".join(f"{candidate.lens.name}: {candidate.fault}" for candidate in candidates)
    return ValueError(f"the calibration failed: no lens model can be used ({faults}); {TILT_REMEDY}")


def misfit_notes(
    fit: LensFit, shape: BoardShape | None, board: Board, detections: Sequence[Detection]
) -> list[str]:
    """Warnings on residuals that are no noise, and on a board whose sides are hardly in metres."""
    found = []
    if shape is not None:
        found.append(
            f"residuals repeat from photo to photo on the board: it is bent or badly printed, by about"
            f" {shape.bend / board.square:.2g} of a square's side; with that allowed for, RMS would be"
            f" {shape.left * fit.rms:.3f} px instead of {fit.rms:.3f}. Error bars are widened by what it does; use a"
            " flat, stiff board for better ones"
        )
    differences = np.concatenate([each.other_points - each.points for each in detections], axis=1)
    spread = float(np.median(np.linalg.norm(differences, axis=2), axis=1).max())
    if shape is None and fit.rms > max(ADVISED_MISFIT * spread, 0.1):
        found.append(
            f"corners miss their predictions by {fit.rms:.2f} px RMS, {fit.rms / max(spread, 1e-9):.0f} times as much"
            " as corner windows of other sizes move them: this is no noise. Is the board flat, did nothing move while"
            " the shutter was open, and are the photos as the camera wrote them?"
        )
    if board.square >= LARGE_SQUARE:
        found.append(
            f"squares of {board.square:g} m were said: sides are in metres; lens parameters don't depend"
            " on them, poses do"
        )
    return found


def advice(spread: float, focal_share: float, reach: float, aspect: float, views: int) -> list[str]:
    """Warnings on a calibration that holds, but could be better; focal_share : std of the focal length over itself."""
    found = []
    if spread < ADVISED_SPREAD_DEG:
        found.append(f"boards tilt by only {spread:.0f} degrees against each other; {TILT_REMEDY}")
    elif focal_share > ADVISED_FOCAL_STD:
        found.append(
            f"the focal length is known to {focal_share:.1%} only; add photos with the board tilted more"
        )
    if reach < ADVISED_REACH:
        found.append(
            f"corners reach out to {reach:.0%} of the way to the picture's corners; beyond, the distortion is"
            " extrapolated: add photos with the board in the picture's corners"
        )
    if views < 8:
        found.append(f"{views} photos are few, and error bars read off so few are rough; 10 to 20 are better")
    if abs(aspect - 1) > 0.02:
        found.append(f"fx / fy is {aspect:.3f}: are the pixels not square, or the squares of the board?")
    return found
