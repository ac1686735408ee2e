"""Camera intrinsics from photographs of a board, with what they rest on and how certain they are."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from capture.arrays import frozen_array
from capture.boards.board import Board, Detection, parse_board
from capture.boards.boardsearch import check_board, missing, odd_sizes, view_of_file
from capture.camera import Camera
from capture.lens import intrinsicschecks as checks
from capture.lens.boardshape import board_shape
from capture.lens.distortion import PARAM_NAMES, LensModel
from capture.lens.intrinsicserror import (
    model_covariance,
    shift_covariance,
    statistical_covariance,
    window_shifts,
)
from capture.lens.lensfit import rms, view_of
from capture.lens.lensladder import LensCandidate, climb
from capture.lens.viewoutliers import MIN_VIEWS, outliers

Floats = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class ViewFit:
    """One photograph in a calibration.

    rms, held_out_rms : pixels; None in a photograph where they were not had. dropped : why it wasn't used, in words.
    points, residuals : (n, 2) pixels, where corners were seen, and seen minus predicted; empty if dropped.
    corners_dropped : corners found that don't fit while the others of their photograph do.
    """

    name: str
    points: Floats
    residuals: Floats
    rms: float | None = None
    held_out_rms: float | None = None
    dropped: str | None = None
    corners_dropped: int = 0


@dataclass(frozen=True, eq=False)
class CameraCalibration:
    """A calibrated camera.

    lens : the chosen lens model. params : COLMAP's, pixels; the centre of the first one is (0.5, 0.5).
    width, height : pixels.
    covariance : (p, p) of the parameters, zero where the lens model leaves one at zero; the sum of what the scatter of
        the residuals says (`statistical_covariance`) and of how much corner windows, lens models and, where residuals
        show one, an uneven board move them.
    window_shifts : (k, p), how the parameters move with smaller and with larger corner windows.
    views : all photographs, those included that weren't used.
    rms, held_out_rms : pixels, over all corners; the latter in views that the lens was not fitted to.
    hull_share, reach : the share of the picture within the hull of all corners, and how far out towards the picture's
        corners they reach.
    spread_deg : the widest angle between the boards of two views.
    """

    board: Board
    lens: LensModel
    params: Floats
    width: int
    height: int
    covariance: Floats
    statistical_covariance: Floats
    window_shifts: Floats
    views: tuple[ViewFit, ...]
    rms: float
    held_out_rms: float
    ladder: tuple[LensCandidate, ...]
    hull_share: float
    reach: float
    spread_deg: float
    warnings: tuple[str, ...]

    def __post_init__(self) -> None:
        for name in ("params", "covariance", "statistical_covariance", "window_shifts"):
            object.__setattr__(self, name, frozen_array(getattr(self, name)))

    @property
    def model(self) -> str:
        """COLMAP's name of the lens model."""
        return self.lens.model

    @property
    def param_names(self) -> tuple[str, ...]:
        """COLMAP's names of the parameters."""
        return PARAM_NAMES[self.model]

    @property
    def std(self) -> Floats:
        """Standard deviations of the parameters, (p,); 1.96 of them on both sides hold 95 %."""
        return np.asarray(np.sqrt(np.diag(self.covariance)))

    @property
    def camera(self) -> Camera:
        """The camera at the world's origin."""
        return self.lens.camera(self.params, (self.width, self.height))

    @property
    def used(self) -> tuple[ViewFit, ...]:
        """The photographs that were used."""
        return tuple(view for view in self.views if view.dropped is None)


def calibrate_camera(
    photos: Iterable[Path | str],
    board: Board | str,
    track: Callable[[Sequence[Path]], Iterable[Path]] = iter,
) -> CameraCalibration:
    """Calibrate a camera from photographs of a board.

    photos : image files, taken with one lens, focus and zoom; at least three that show the board, tilted in different
        ways. Those of another size than most are left out. board : a `Board` or its text, such as
        "chessboard:9x6:0.025". track : wraps the list of photographs, to show progress.
    ValueError says what is wrong: a board that isn't the one that was said, photographs without a usual size, a focal
    length that they leave undetermined, a fit that failed.
    """
    board = parse_board(board) if isinstance(board, str) else board
    paths = [Path(photo) for photo in photos]
    for path in paths:
        if paths.count(path) > 1:
            raise ValueError(f"{path}: is given twice; every photo may count once")
        if path.is_dir():
            raise ValueError(f"{path}: is a folder; give the photos in it")
    if len(paths) < MIN_VIEWS:
        given = "1 photo is" if len(paths) == 1 else f"{len(paths)} photos are"
        raise ValueError(
            f"{given} too few, {MIN_VIEWS} are the least and 10 to 20 are good; {checks.TILT_REMEDY}"
        )
    names = [path.name for path in paths]
    if len(set(names)) < len(names):
        names = [str(path) for path in paths]
    seen = [view_of_file(path, board, name) for path, name in zip(track(paths), names, strict=True)]
    lost = odd_sizes(seen)
    alike = [view for view in seen if view.name not in lost]
    check_board(alike, board)
    found = {view.name: view.detection for view in alike if view.detection is not None}
    lost |= {view.name: missing(view, board) for view in alike if view.detection is None}
    if len(found) < MIN_VIEWS:
        raise ValueError(
            f"the board {board.spec} was found in {len(found)} of {len(seen)} photos, but {MIN_VIEWS} are needed:"
            f" {'; '.join(f'{name}: {why}' for name, why in list(lost.items())[:5])}"
        )
    return calibrate_detections(found, board, lost)


def calibrate_detections(
    detections: Mapping[str, Detection], board: Board, lost: Mapping[str, str] | None = None
) -> CameraCalibration:
    """Calibrate a camera from a board's corners in at least three photographs, by their names.

    lost : why other photographs weren't used, for the record. Errors as in `calibrate_camera`.
    """
    lost = dict(lost or {})
    names, found = list(detections), list(detections.values())
    if len(found) < MIN_VIEWS:
        raise ValueError(f"{len(found)} views are too few; at least {MIN_VIEWS} are needed")
    size = found[0].size
    off, good = outliers([view_of(detection) for detection in found], size)
    used = [k for k in range(len(found)) if k not in off]
    found = [detection.subset(keep) for detection, keep in zip(found, good, strict=True)]
    kept = [found[k] for k in used]
    views = [view_of(detection) for detection in kept]
    candidates = climb(views, size)
    checks.check_tilts(candidates)
    chosen = next((candidate for candidate in candidates if candidate.chosen), None)
    if chosen is None or chosen.fit is None or chosen.squares is None:
        raise checks.no_model(candidates)
    fit = chosen.fit
    counts = np.array([len(view.points) for view in views])
    held_out_rms = float(np.sqrt((chosen.squares * counts).sum() / counts.sum()))
    statistical = statistical_covariance(views, fit)
    shifts = window_shifts(kept, fit)
    shape = board_shape(views, [detection.located for detection in kept], fit)
    covariance = statistical + shift_covariance(shifts) + model_covariance(candidates, chosen)
    if shape is not None:
        covariance = covariance + shift_covariance(shape.shift[None])
    focal = np.array([name.startswith("f") for name in PARAM_NAMES[fit.lens.model]]) / (
        1 if fit.lens.one_focal else 2
    )
    focal_std = float(np.sqrt(focal @ covariance @ focal))
    checks.check_error(fit, held_out_rms)
    checks.check_focal(fit, focal_std)
    checks.check_lens(fit)
    hull_share, reach = checks.coverage(np.concatenate([view.points for view in views]), fit.camera)
    spread = checks.normal_spread(fit.poses)

    nothing = np.empty((0, 2))
    entries = [ViewFit(name, nothing, nothing, dropped=why) for name, why in lost.items()]
    for k, (error, limit) in off.items():
        why = f"outlier: its corners are {error:.3f} px RMS off, limit {limit:.3f}"
        entries.append(ViewFit(names[k], nothing, nothing, rms=error, dropped=why))
    for k, view, residual, square in zip(used, views, fit.residuals, chosen.squares, strict=True):
        entries.append(
            ViewFit(
                names[k],
                view.points,
                residual,
                rms(residual),
                float(np.sqrt(square)),
                corners_dropped=int((~good[k]).sum()),
            )
        )
    aspect = 1.0 if fit.lens.one_focal else float(fit.params[0] / fit.params[1])
    warnings = [f"{view.name}: {view.dropped}" for view in entries if view.dropped is not None]
    warnings += [
        f"{view.name}: corners left out because they don't fit: {view.corners_dropped}"
        for view in entries
        if view.corners_dropped
    ]
    warnings += checks.misfit_notes(fit, shape, board, kept)
    warnings += checks.advice(spread, focal_std / fit.camera.focal_px, reach, aspect, len(views))
    return CameraCalibration(
        board=board,
        lens=fit.lens,
        params=fit.params,
        width=size[0],
        height=size[1],
        covariance=covariance,
        statistical_covariance=statistical,
        window_shifts=shifts,
        views=tuple(entries),
        rms=fit.rms,
        held_out_rms=held_out_rms,
        ladder=candidates,
        hull_share=hull_share,
        reach=reach,
        spread_deg=spread,
        warnings=tuple(warnings),
    )
