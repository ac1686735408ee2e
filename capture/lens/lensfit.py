"""Zhang's calibration: one lens and a pose for each view that bring board corners onto their images.

Zhang, "A flexible new technique for camera calibration", PAMI 2000, as OpenCV solves it; the derivatives at its
solution then say how well the lens is determined, and what it would be without any one view.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from capture.boards.board import Detection
from capture.boards.cornerwindow import HALF_PIXEL
from capture.camera import Camera
from capture.lens.distortion import PARAM_NAMES, LensModel

Floats = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class CornerView:
    """Corners of one view. board_points : (n, 3) metres. points : (n, 2) pixels. half : (n,) bool, every other one."""

    board_points: Floats
    points: Floats
    half: NDArray[np.bool_]


@dataclass(frozen=True, eq=False)
class LensFit:
    """A lens fitted to views.

    params : COLMAP's parameters. poses : (v, 4, 4) board to camera. residuals : per view (n, 2) pixels, seen minus
        predicted.
    """

    lens: LensModel
    size: tuple[int, int]
    params: Floats
    poses: Floats
    residuals: tuple[Floats, ...]

    @property
    def rms(self) -> float:
        """RMS distance of corners from their prediction, pixels."""
        return rms(np.concatenate(self.residuals))

    @property
    def camera(self) -> Camera:
        return self.lens.camera(self.params, self.size)


def rms(residuals: Floats) -> float:
    """Root mean square length of (n, 2) residuals."""
    return float(np.sqrt((np.asarray(residuals) ** 2).sum(axis=-1).mean()))


def view_of(detection: Detection, points: Floats | None = None) -> CornerView:
    """The corners of a detection as a view; `points` in place of its own."""
    return CornerView(
        detection.board_points,
        detection.points if points is None else points,
        detection.cells.sum(axis=1) % 2 == 0,
    )


def fit_lens(
    views: Sequence[CornerView], size: tuple[int, int], lens: LensModel, start: LensFit | None = None
) -> LensFit:
    """The lens and poses with the least squared distance of corners from their predictions.

    start : a fit of the same or a simpler lens from which to set out; without it Zhang's closed form is used.
    ValueError where OpenCV finds no solution.
    """
    import cv2

    matrix, coefficients, flags = np.eye(3), np.zeros(8), lens.flags
    if start is not None:
        matrix, coefficients = start.lens.opencv(start.params)
        if lens.one_focal:
            matrix[0, 0] = matrix[1, 1] = (matrix[0, 0] + matrix[1, 1]) / 2
        flags |= cv2.CALIB_USE_INTRINSIC_GUESS
    try:
        _, solved, solved_coefficients, turns, shifts = cv2.calibrateCamera(
            [view.board_points.astype(np.float32) for view in views],
            [(view.points - HALF_PIXEL).astype(np.float32)[:, None] for view in views],
            size,
            matrix,
            coefficients if "k4" in lens.free else coefficients[:5],
            flags=flags,
            criteria=(cv2.TERM_CRITERIA_EPS | cv2.TERM_CRITERIA_MAX_ITER, 200, 1e-14),
        )
    except cv2.error as error:
        raise ValueError(
            f"no {lens.name} camera brings the board onto its corners ({error.err}); check --board, and tilt the board"
            " in different directions"
        ) from error
    params = lens.params(np.asarray(solved, float), np.asarray(solved_coefficients, float))
    if not np.isfinite(params).all() or min(params[:2] if not lens.one_focal else params[:1]) <= 0:
        raise ValueError(
            f"no {lens.name} camera brings the board onto its corners (parameters would be {params.tolist()});"
            " check --board, and tilt the board in different directions"
        )
    poses = np.array([pose_matrix(turn, shift) for turn, shift in zip(turns, shifts, strict=True)])
    residuals = tuple(
        view.points - _project(lens, params, pose, view.board_points)[0]
        for view, pose in zip(views, poses, strict=True)
    )
    return LensFit(lens, size, params, poses, residuals)


def pose_matrix(turn: ArrayLike, shift: ArrayLike) -> Floats:
    """A 4x4 pose from OpenCV's rotation vector and translation."""
    import cv2

    pose = np.eye(4)
    pose[:3, :3] = cv2.Rodrigues(np.asarray(turn, float))[0]
    pose[:3, 3] = np.ravel(shift)
    return pose


def solve_pose(view: CornerView, lens: LensModel, params: Floats, start: Floats | None = None) -> Floats:
    """The pose (4, 4), board to camera, of a view under a known lens, least squares in the picture."""
    import cv2

    matrix, coefficients = lens.opencv(params)
    image_points = np.ascontiguousarray(view.points - HALF_PIXEL)
    if start is None:
        found, turn, shift = cv2.solvePnP(
            view.board_points, image_points, matrix, coefficients, flags=cv2.SOLVEPNP_IPPE
        )
        if not found:
            raise ValueError("no pose brings the board onto its corners")
    else:
        turn, shift = cv2.Rodrigues(start[:3, :3])[0], start[:3, 3:].copy()
    criteria = (cv2.TERM_CRITERIA_EPS | cv2.TERM_CRITERIA_MAX_ITER, 100, 1e-14)
    turn, shift = cv2.solvePnPRefineLM(
        view.board_points, image_points, matrix, coefficients, turn, shift, criteria
    )
    return pose_matrix(turn, shift)


def held_out_residuals(view: CornerView, lens: LensModel, params: Floats, pose: Floats) -> Floats:
    """Residuals (n, 2) of a view that the lens wasn't fitted to.

    Its pose is solved from every other corner, and the corners between are predicted with it, then the other way
    round: no corner is ever judged by a pose that it helped to find. pose : where to set out from.
    """
    residuals = np.empty_like(view.points)
    for known in (view.half, ~view.half):
        part = CornerView(view.board_points[known], view.points[known], view.half[known])
        posed = solve_pose(part, lens, params, pose)
        residuals[~known] = view.points[~known] - _project(lens, params, posed, view.board_points[~known])[0]
    return residuals


@dataclass(frozen=True, eq=False)
class LensInformation:
    """What each view says about the lens once its own pose is allowed for.

    matrices : (v, p, p), the views' shares of the normal equations' matrix. gradients : (v, p), their pull.
    noise : variance of one coordinate of one corner if all were independent, px^2.
    """

    matrices: Floats
    gradients: Floats
    noise: float

    @property
    def independent_covariance(self) -> Floats:
        """Covariance (p, p) if every corner's error were independent of every other's."""
        return self.noise * _inverse(self.matrices.sum(axis=0))

    @property
    def condition(self) -> float:
        """Condition number of the normal equations' matrix with all parameters brought to one scale."""
        return float(np.linalg.cond(_scaled(self.matrices.sum(axis=0))[0]))

    @property
    def jackknife_shifts(self) -> Floats:
        """How the parameters move, (v, p), when each view in turn is left out, to first order."""
        total = self.matrices.sum(axis=0)
        return np.array(
            [
                -_inverse(total - matrix) @ gradient
                for matrix, gradient in zip(self.matrices, self.gradients, strict=True)
            ]
        )


def lens_information(views: Sequence[CornerView], fit: LensFit) -> LensInformation:
    """What the views say about the fitted parameters, in the order of `fit.lens.fitted`."""
    matrices, gradients, squares = [], [], 0.0
    for view, pose, residual in zip(views, fit.poses, fit.residuals, strict=True):
        _, of_pose, of_lens = _project(fit.lens, fit.params, pose, view.board_points)
        basis, _ = np.linalg.qr(of_pose)
        free = of_lens - basis @ (basis.T @ of_lens)
        matrices.append(free.T @ free)
        gradients.append(free.T @ residual.ravel())
        squares += float((residual**2).sum())
    count = sum(2 * len(view.points) - 6 for view in views) - len(fit.lens.fitted)
    return LensInformation(np.array(matrices), np.array(gradients), squares / max(count, 1))


def pose_jacobian(
    view: CornerView, lens: LensModel, params: Floats, pose: Floats
) -> tuple[Floats, Floats, Floats]:
    """Predictions (n, 2) and their derivatives by the pose (2n, 6) and by the fitted lens parameters (2n, p).

    The pose's six are a small turn about the camera's axes, applied after the pose, radians, and a shift in metres.
    """
    import cv2

    predicted, of_pose, of_lens = _project(lens, params, pose, view.board_points)
    # OpenCV differentiates by its rotation vector; a small turn w after R moves the vector by J^-1 w.
    turn = np.asarray(cv2.Rodrigues(pose[:3, :3])[0], float).ravel()
    to_turn = np.asarray(np.linalg.inv(_left_jacobian(turn)), float)
    return predicted, np.hstack([of_pose[:, :3] @ to_turn, of_pose[:, 3:]]), of_lens


def derivatives(view: CornerView, lens: LensModel, params: Floats, pose: Floats) -> tuple[Floats, Floats]:
    """Derivatives of a view's predictions by OpenCV's pose (2n, 6), turn then shift, and by the fitted parameters."""
    return _project(lens, params, pose, view.board_points)[1:]


def _left_jacobian(turn: Floats) -> Floats:
    """The matrix that takes a change of a rotation vector to the small turn it amounts to, applied afterwards."""
    angle = float(np.linalg.norm(turn))
    x, y, z = turn
    cross = np.array([[0, -z, y], [z, 0, -x], [-y, x, 0]], float)
    if angle < 1e-6:
        return np.eye(3) + cross / 2
    bend, twist = (1 - np.cos(angle)) / angle**2, (angle - np.sin(angle)) / angle**3
    return np.asarray(np.eye(3) + bend * cross + twist * cross @ cross)


def _project(lens: LensModel, params: Floats, pose: Floats, points: Floats) -> tuple[Floats, Floats, Floats]:
    """Image points (n, 2), and their derivatives by OpenCV's pose (2n, 6) and by the fitted parameters (2n, p)."""
    import cv2

    matrix, coefficients = lens.opencv(params)
    turn = cv2.Rodrigues(pose[:3, :3])[0]
    projected = cv2.projectPoints(points, turn, pose[:3, 3], matrix, coefficients)
    image, jacobian = (np.asarray(part, float) for part in projected)
    columns = dict(zip(("fx", "fy", "cx", "cy"), jacobian[:, 6:10].T, strict=True))
    columns |= dict(zip(("k1", "k2", "p1", "p2", "k3", "k4", "k5", "k6"), jacobian[:, 10:18].T, strict=True))
    columns["f"] = columns["fx"] + columns["fy"]
    of_lens = np.column_stack([columns[name] for name in lens.fitted])
    return image[:, 0] + HALF_PIXEL, jacobian[:, :6], of_lens


def _scaled(matrix: Floats) -> tuple[Floats, Floats]:
    """A symmetric matrix with ones on its diagonal, and what it was divided by."""
    root = np.sqrt(np.maximum(np.diag(matrix), 1e-300))
    scale = np.outer(root, root)
    return matrix / scale, scale


def _inverse(matrix: Floats) -> Floats:
    """Inverse of a symmetric matrix whose parameters differ in scale."""
    scaled, scale = _scaled(matrix)
    return np.asarray(np.linalg.inv(scaled) / scale)


def full_covariance(lens: LensModel, covariance: Floats) -> Floats:
    """Covariance of all of COLMAP's parameters from that of the fitted ones; zero where a parameter is fixed."""
    names = PARAM_NAMES[lens.model]
    places = [names.index(name) for name in lens.fitted]
    full = np.zeros((len(names), len(names)))
    full[np.ix_(places, places)] = covariance
    return full
