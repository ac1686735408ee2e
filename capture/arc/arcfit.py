"""A gantry's arc from photographs of a board that stands still: axis, centre, radius, start and the camera's mount.

A camera that travels by an angle t about a fixed axis has world_to_camera(t) = world_to_camera(0) R(-t), R being the
rotation about that axis. So all photographs together have the six numbers of one pose, the four of a line in space,
and one angle each; they are fitted to the corners at once, by least squares in pixels. A camera that stands still
before a turntable is the same thing, seen from the table.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import least_squares
from scipy.spatial.transform import Rotation
from scipy.special import chdtrc

from capture.arc.gantry import Arc, look_at
from capture.arrays import frozen_array
from capture.camera import Camera

Floats = NDArray[np.float64]

FEWEST_PHOTOS = 3
# An arc shorter than this hardly differs from a straight rail.
_SHORTEST_ARC_DEG = 5.0
# Standard deviation of the axis beyond which it counts as undetermined.
_WORST_AXIS_DEG = 5.0
# Probability of a scatter as wide as found, below which steps count as unequal.
_UNEQUAL = 1e-3
# Photographs that are left out in turn, the worst ones, to find one that doesn't fit.
_SUSPECTS = 8


@dataclass(frozen=True, eq=False)
class ArcView:
    """The board in one photograph.

    name : of the photograph, for messages. points : (n, 3) metres, corners in the board's frame, the world.
    pixels : (n, 2) where they are seen, the first pixel's centre at (0.5, 0.5).
    world_to_camera : (4, 4), the pose that these corners alone give.
    """

    name: str
    points: Floats
    pixels: Floats
    world_to_camera: Floats

    def __post_init__(self) -> None:
        for name in ("points", "pixels", "world_to_camera"):
            object.__setattr__(self, name, frozen_array(getattr(self, name)))


@dataclass(frozen=True, eq=False)
class ArcFit:
    """A calibrated arc.

    arc : with the step, if the photographs stand at equal ones.
    angles : (p,) radians, of each photograph. angle_std : (p,), how well each is known against the first.
    centre_std : (3,) metres. radius_std : metres. axis_std, start_std : radians, in any tangent direction.
    mount_std : radians, about any axis. step_std : radians, or None.
    rms_px : (p,) distance of corners from their places on the arc. free_rms_px : (p,) with each photo's own pose.
    """

    arc: Arc
    angles: Floats
    angle_std: Floats
    centre_std: Floats
    radius_std: float
    axis_std: float
    start_std: float
    mount_std: float
    step_std: float | None
    rms_px: Floats
    free_rms_px: Floats


def fit_arc(
    views: Sequence[ArcView],
    camera: Camera,
    nominal: Sequence[float] | Floats | None = None,
    camera_covariance: Floats | None = None,
) -> ArcFit:
    """Fit an arc to photographs of a board, taken in the order of travel, less than half a turn apart.

    camera : the calibrated camera, its pose ignored. nominal : angles in radians as the gantry shows them, one per
        photo; only their zero and their sense are used. Without them the first photo is at zero, and the axis is
        taken so that angles grow in the order of the photos.
    camera_covariance : (k, k) of the camera's parameters; None if they are exact.
    Standard deviations are clustered by photograph, since the corners of one share their errors. ValueError says why
    photographs don't determine an arc.
    """
    if len(views) < FEWEST_PHOTOS:
        raise ValueError(f"the board is seen in {len(views)} photos; an arc needs {FEWEST_PHOTOS} at least")
    if nominal is not None and len(nominal) != len(views):
        raise ValueError(f"{len(nominal)} angles for {len(views)} photos: give one for each, in their order")
    solution = _solved(views, camera, _start(views))
    parameters = solution.x
    angles = _unpack(parameters)[3]
    if np.degrees(np.ptp(angles)) < _SHORTEST_ARC_DEG:
        raise ValueError(
            f"the photos span an arc of {np.degrees(np.ptp(angles)):.1f} degrees; its axis is undetermined."
            f" Photograph the board over {_SHORTEST_ARC_DEG:.0f} degrees at least, better over 60"
        )
    covariance = _clustered_covariance(solution, views, camera)
    if camera_covariance is not None:
        covariance = covariance + _of_the_camera(parameters, views, camera, camera_covariance)
    return _report(
        views, camera, parameters, covariance, None if nominal is None else np.asarray(nominal, float)
    )


def outlying_views(views: Sequence[ArcView], camera: Camera) -> dict[int, float]:
    """The photographs, by their places, that don't fit the arc of the others, and by how many pixels (RMS).

    Where the arc explains the photographs much worse than poses of their own, one is left out after the other, as
    long as that halves what is left; never more than a third of them.
    """
    kept, found = list(range(len(views))), dict[int, float]()
    while len(kept) > max(FEWEST_PHOTOS, len(views) - len(views) // 3):
        part = [views[place] for place in kept]
        solution = _solved(part, camera, _start(part))
        errors = _rms_by_view(solution.fun, part)
        if _root_mean_square(errors) < 2 * _root_mean_square(_free_rms(part, camera)):
            break
        without: list[tuple[float, int]] = []
        for place in np.argsort(errors)[::-1][:_SUSPECTS].tolist():
            rest = part[:place] + part[place + 1 :]
            left = _root_mean_square(_rms_by_view(_solved(rest, camera, _start(rest)).fun, rest))
            without.append((left, place))
        left, worst = min(without)
        if left > 0.5 * _root_mean_square(errors):
            break
        found[kept.pop(worst)] = float(errors[worst])
    return found


def _solved(views: Sequence[ArcView], camera: Camera, start: Floats) -> Any:
    return least_squares(_residuals, start, args=(views, camera), x_scale="jac", method="lm")


def _of_the_camera(
    parameters: Floats, views: Sequence[ArcView], camera: Camera, covariance: Floats
) -> Floats:
    """Covariance of the arc's parameters that the camera's brings: each of its principal axes moves the solution."""
    values, vectors = np.linalg.eigh(covariance)
    moves = []
    for value, vector in zip(values, vectors.T, strict=True):
        if value > 1e-12 * values[-1]:
            other = replace(camera, params=camera.params + np.sqrt(value) * vector)
            moves.append(_solved(views, other, parameters).x - parameters)
    return np.asarray(np.transpose(moves) @ np.array(moves))


# Parameters: rotation vector and translation of the first pose (6), the axis' direction as a rotation vector of +Z
# without its z part (2), the axis' point nearest to the origin in its own plane (2), and the angles but the first.
_POSE_AND_AXIS = 10


def _unpack(parameters: Floats) -> tuple[Floats, Floats, Floats, Floats]:
    """First pose (4, 4), axis (3,), a point on it (3,), and all angles."""
    pose = np.eye(4)
    pose[:3, :3] = Rotation.from_rotvec(parameters[:3]).as_matrix()
    pose[:3, 3] = parameters[3:6]
    turn = Rotation.from_rotvec([*parameters[6:8], 0.0])
    axis, point = turn.apply([0.0, 0, 1]), turn.apply([*parameters[8:10], 0.0])
    return pose, axis, point, np.concatenate([[0.0], parameters[_POSE_AND_AXIS:]])


def _posed(pose: Floats, axis: Floats, point: Floats, angle: float) -> Floats:
    """world_to_camera (4, 4) after travelling by an angle about the axis through a point."""
    turn = Rotation.from_rotvec(-angle * axis).as_matrix()
    back = np.eye(4)
    back[:3, :3] = turn
    back[:3, 3] = point - turn @ point
    return np.asarray(pose @ back)


def _residuals(parameters: Floats, views: Sequence[ArcView], camera: Camera) -> Floats:
    pose, axis, point, angles = _unpack(parameters)
    errors = [
        camera.posed(_posed(pose, axis, point, angle)).project(view.points) - view.pixels
        for view, angle in zip(views, angles, strict=True)
    ]
    # Behind the camera there is no picture: as bad as any.
    return np.nan_to_num(np.concatenate(errors).ravel(), nan=1e3)


def _start(views: Sequence[ArcView]) -> Floats:
    """Parameters to begin with, from the poses of the photographs alone."""
    first = views[0].world_to_camera
    # Motion of each camera in the world, from the first: a rotation about the axis that we look for.
    motions = [np.linalg.inv(view.world_to_camera) @ first for view in views[1:]]
    vectors = np.array([Rotation.from_matrix(motion[:3, :3]).as_rotvec() for motion in motions])
    widest = vectors[np.argmax(np.linalg.norm(vectors, axis=1))]
    if np.linalg.norm(widest) < np.radians(_SHORTEST_ARC_DEG) / 2:
        raise ValueError(
            f"between the photos the camera turns by {np.degrees(np.linalg.norm(widest)):.2f} degrees at most; the"
            " arc's axis is undetermined. Let the camera travel further between photos, the board standing still"
        )
    signs = np.sign(vectors @ widest)
    axis = (signs[:, None] * vectors).sum(axis=0)
    axis /= np.linalg.norm(axis)
    angles = np.unwrap(np.append(0.0, vectors @ axis))[1:]
    # Points of the axis stay where they are: (R - 1) c = -t, by least squares over all motions.
    matrix = np.concatenate([motion[:3, :3] - np.eye(3) for motion in motions])
    offset = np.concatenate([-motion[:3, 3] for motion in motions])
    point, *_ = np.linalg.lstsq(np.vstack([matrix, axis]), np.append(offset, 0.0), rcond=None)
    tilt = np.cross([0.0, 0, 1], axis)
    length = np.linalg.norm(tilt)
    # An axis along -Z has no turn of its own from +Z; any half turn will do.
    angle = np.arctan2(length, axis[2])
    tilt = tilt / length * angle if length > 1e-12 else np.array([angle, 0.0, 0.0])
    local = Rotation.from_rotvec(tilt).inv().apply(point)
    pose = [*Rotation.from_matrix(first[:3, :3]).as_rotvec(), *first[:3, 3]]
    return np.array([*pose, *tilt[:2], *local[:2], *angles])


def _clustered_covariance(solution: Any, views: Sequence[ArcView], camera: Camera) -> Floats:
    """Covariance (k, k) of the parameters when the errors within each photograph may be correlated.

    Such errors act as an error of the photograph's own pose. Its covariance is read off how the poses scatter about
    the arc, all photographs together; it is never taken for less than independent errors of the corners imply. What
    shifts a picture along the direction of travel is taken up by the photo's angle and leaves no trace, so that the
    errors are taken to be alike along and across.
    """
    jacobian, residuals = solution.jac, solution.fun
    bread = np.linalg.pinv(jacobian.T @ jacobian)
    independent = bread * (residuals @ residuals) / max(len(residuals) - jacobian.shape[1], 1)
    pose, axis, point, angles = _unpack(solution.x)
    scores, deviations, begin = [], [], 0
    for view, angle in zip(views, angles, strict=True):
        rows = slice(begin, begin + 2 * len(view.points))
        begin = rows.stop
        motion = _pose_derivative(camera.posed(_posed(pose, axis, point, angle)), view.points)
        deviations.append(np.linalg.lstsq(motion, residuals[rows], rcond=None)[0])
        scores.append(bread @ jacobian[rows].T @ motion)
    # Of five numbers per photograph, its angle not counted, the fit has used as many as pose and axis have.
    left = 1 - _POSE_AND_AXIS / (5 * len(views))
    across = np.array(deviations).T @ np.array(deviations) / (len(views) * left)
    scatter = across + _QUARTER_TURN @ across @ _QUARTER_TURN.T
    covariance = sum(score @ scatter @ score.T for score in scores)
    larger = np.sqrt(np.maximum(np.diag(independent) / np.diag(covariance), 1.0))
    return np.asarray(covariance * np.outer(larger, larger))


# Of a rotation vector and a translation in the camera's frame, about its optical axis.
_QUARTER_TURN = np.kron(np.eye(2), [[0, -1, 0], [1, 0, 0], [0, 0, 1]])


def _pose_derivative(camera: Camera, points: Floats) -> Floats:
    """How the pixels of points (2n, 6) move with a small rotation and translation in the camera's frame."""

    def pixels(change: Floats) -> Floats:
        moved = np.eye(4)
        moved[:3, :3] = Rotation.from_rotvec(change[:3]).as_matrix()
        moved[:3, 3] = change[3:]
        return camera.posed(moved @ camera.world_to_camera).project(points).ravel()

    return _derivative(pixels, np.zeros(6))


def _report(
    views: Sequence[ArcView],
    camera: Camera,
    parameters: Floats,
    covariance: Floats,
    nominal: Floats | None,
) -> ArcFit:
    """The arc in the user's terms, with standard deviations by the derivative of each number."""
    _, _, _, angles = _unpack(parameters)
    if nominal is None:
        sense, zero = np.sign(angles[-1] - angles[0]), 0.0
    else:
        sense, zero = _sense(angles, nominal), nominal[0]
    arc = _arc(parameters, sense, zero)
    derived = _derivative(lambda p: _numbers(_arc(p, sense, zero), arc), parameters)
    variance = np.diag(derived @ covariance @ derived.T)
    # Directions have two tangent directions each, a rotation three axes.
    axis_std = float(np.sqrt(variance[4:7].sum() / 2))
    if not np.degrees(axis_std) <= _WORST_AXIS_DEG:
        raise ValueError(
            f"the arc's axis is undetermined (standard deviation {np.degrees(axis_std):.0f} degrees): photograph the"
            " board over a longer arc, and larger in the picture"
        )
    angle_covariance = covariance[_POSE_AND_AXIS:, _POSE_AND_AXIS:]
    step, step_std = None, None
    if nominal is None or np.allclose(np.diff(nominal), nominal[1] - nominal[0], atol=1e-9):
        step, step_std = _equal_step(sense * angles, angle_covariance)
    placed = sense * angles + zero
    if nominal is not None:
        placed = nominal + np.angle(np.exp(1j * (placed - nominal)))  # whole turns as the gantry counts them
    return ArcFit(
        arc=Arc(arc.centre, arc.axis, arc.radius, arc.start, arc.mount, step),
        angles=placed,
        angle_std=np.concatenate([[0.0], np.sqrt(np.diag(angle_covariance))]),
        centre_std=np.sqrt(variance[:3]),
        radius_std=float(np.sqrt(variance[3])),
        axis_std=axis_std,
        start_std=float(np.sqrt(variance[7:10].sum() / 2)),
        mount_std=float(np.sqrt(variance[10:].sum() / 3)),
        step_std=step_std,
        rms_px=_rms_by_view(_residuals(parameters, views, camera), views),
        free_rms_px=_free_rms(views, camera),
    )


def _rms_by_view(residuals: Floats, views: Sequence[ArcView]) -> Floats:
    ends = np.cumsum([2 * len(view.points) for view in views])[:-1]
    return np.array([_rms(part) for part in np.split(residuals, ends)])


def _free_rms(views: Sequence[ArcView], camera: Camera) -> Floats:
    errors = [camera.posed(view.world_to_camera).project(view.points) - view.pixels for view in views]
    return np.array([_rms(error.ravel()) for error in errors])


def _root_mean_square(values: Floats) -> float:
    return float(np.sqrt(np.mean(values**2)))


def _sense(angles: Floats, reference: Floats) -> float:
    """1 if angles go with those of reference, up to an offset and whole turns; -1 if against them."""
    along, against = (abs(np.exp(1j * (angles - sign * reference)).sum()) for sign in (1, -1))
    return 1.0 if along >= against else -1.0


def _arc(parameters: Floats, sense: float, zero: float) -> Arc:
    """The arc of fitted parameters; `sense` turns the axis round, `zero` is the first photograph's angle."""
    pose, axis, point, _ = _unpack(parameters)
    axis = sense * axis
    at_zero = _posed(pose, axis, point, -zero)
    position = -at_zero[:3, :3].T @ at_zero[:3, 3]
    centre = point + axis * ((position - point) @ axis)
    arm = position - centre
    inward = look_at(position, centre, axis)
    return Arc(centre, axis, float(np.linalg.norm(arm)), arm, at_zero[:3, :3] @ inward[:3, :3].T)


def _numbers(arc: Arc, about: Arc) -> Floats:
    """Centre (3), radius, and the turns of axis, start and mount from another arc's: small, in radians."""
    mount = Rotation.from_matrix(arc.mount @ about.mount.T).as_rotvec()
    return np.array(
        [*arc.centre, arc.radius, *np.cross(about.axis, arc.axis), *np.cross(about.start, arc.start), *mount]
    )


def _equal_step(angles: Floats, covariance: Floats) -> tuple[float | None, float | None]:
    """The step between photos and its standard deviation, where angles are multiples of one within their errors."""
    count = np.arange(1, len(angles))
    weight = np.linalg.pinv(covariance)
    variance = 1 / (count @ weight @ count)
    step = float(variance * (count @ weight @ angles[1:]))
    deviation = angles[1:] - step * count
    if chdtrc(len(count) - 1, deviation @ weight @ deviation) < _UNEQUAL:
        return None, None
    return step, float(np.sqrt(variance))


def _rms(errors: Floats) -> float:
    """Root mean square distance of x, y pairs in a row."""
    return float(np.sqrt(2 * np.mean(errors**2)))


def _derivative(function: Callable[[Floats], Floats], at: Floats) -> Floats:
    """Derivative (m, k) by central differences; the parameters are radians and metres, all of order one."""
    steps = 1e-6 * np.eye(len(at))
    return np.stack([(function(at + step) - function(at - step)) / 2e-6 for step in steps], axis=1)
