"""How far lamps are that a mirror ball shows from several places.

Each view sees a near lamp mirrored at a point of its own on the ball, and so in a direction of its own: the nearer the
lamp, the farther apart. One view can't tell, and neither can views that share a place.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import least_squares

from capture.lighting import seen_from
from recon.mesh.tangents import tangents
from recon.mirrorball.reflection import mirrored_directions, mirroring_points
from recon.mirrorball.view import BallSource, BallView
from recon.sphere.sphere import Sphere, to_camera

Floats = NDArray[np.float64]

# Angle, radians, between the views' axes from which on they place the ball.
_APART = np.radians(5.0)
# Of the ball's radius, by which views may miss its centre and disagree on its size.
_OFF = 0.1
# Radius of a ball, over the distance of what views have for its centre, that is none.
_NOWHERE = 1e-6
# Doubt of a view's direction that its pose leaves, radians, since poses are never exact.
_POSE = np.radians(0.1)
# Standard deviations of the closeness from which on a lamp is near.
_NEAR = 3.0
# Radii of the ball over the distance of the nearest lamps that are believed.
_NEAREST = 0.5


@dataclass(frozen=True, eq=False)
class PlacedSource:
    """Where a lamp is by what several views of a ball show of it.

    direction : (3,) unit, from the ball's centre. closeness, closeness_std : 1 / metres, one over the distance.
    brighter : (n,), what each view's irradiance is to be multiplied by, to be that at the ball's centre.
    """

    direction: Floats
    closeness: float
    closeness_std: float
    brighter: Floats


def common_ball(views: Sequence[BallView]) -> Sphere | None:
    """The ball in the world by the axes of all views; None where these don't place it, or not at one place."""
    axes = np.array([to_camera(view.sphere, view.camera)[0] for view in views])
    centres = np.array([view.sphere.centre for view in views])
    off_axis = np.eye(3) - axes[:, :, None] * axes[:, None, :]
    # The least eigenvalue is about the mean square of sines from a common axis.
    if np.linalg.eigvalsh(off_axis.mean(axis=0))[0] < np.sin(_APART / 2) ** 2:
        return None
    centre = np.linalg.solve(off_axis.sum(axis=0), np.einsum("nij,nj->i", off_axis, centres))
    missed = np.linalg.norm(np.einsum("nij,nj->ni", off_axis, centre - centres), axis=1)
    radii = np.array([_radius(view, centre) for view in views])
    radius = float(radii.mean())
    # Of views whose poses are rotations alone, all axes meet in the camera.
    if radius <= _NOWHERE * np.linalg.norm(centres - centre, axis=1).max():
        return None
    if missed.max() > _OFF * radius or np.abs(radii - radius).max() > _OFF * radius:
        return None
    return Sphere(centre, radius, np.zeros((4, 4)))


def _radius(view: BallView, centre: Floats) -> float:
    """A view's radius of the ball, if this is at a place: its distance along the axis is a gauge."""
    _, nearness = to_camera(view.sphere, view.camera)
    return float(nearness * np.linalg.norm(view.camera.centre - centre)) if nearness else view.sphere.radius


def _mirrored_at(ball: Sphere, view: BallView, direction: Floats) -> Floats:
    """The point (3,) of a ball at which a view sees light mirrored from a direction (3,)."""
    _, pixel = mirroring_points(ball, view.camera, direction[None])
    return _points(ball, view, pixel)[0]


def _points(ball: Sphere, view: BallView, pixels: Floats) -> Floats:
    """Points (n, 3) of a ball at pixels (n, 2) of a view."""
    _, normals = ball.hits(*view.camera.rays(pixels))
    return np.asarray(ball.centre + ball.radius * normals)


def apart(ball: Sphere | None, pair: Sequence[tuple[BallView, BallSource]]) -> float:
    """The angle, radians, between what two views say of a source that may be near: what no distance explains."""
    one, other = (source.direction for _, source in pair)
    across = one - other
    if ball is None:
        return float(np.linalg.norm(across))
    points = [_mirrored_at(ball, view, source.direction) for view, source in pair]
    mean = (one + other) / np.linalg.norm(one + other)
    base = points[1] - points[0]
    base = base - (base @ mean) * mean
    closeness = np.clip(across @ base / max(float(base @ base), 1e-300), 0, _NEAREST / ball.radius)
    return float(np.linalg.norm(across - closeness * base))


def placed(ball: Sphere, group: Sequence[tuple[BallView, BallSource]]) -> PlacedSource | None:
    """Where a lamp is that several views show; None where they don't show it to be near."""
    points = np.array([_mirrored_at(ball, view, source.direction) for view, source in group])
    directions = np.array([source.direction for _, source in group])
    std = np.hypot(np.radians([source.direction_std_deg for _, source in group]), _POSE)
    mean = directions.mean(axis=0) / np.linalg.norm(directions.mean(axis=0))
    (ways,), across = tangents(mean[None]), tangents(directions)

    def lamp(numbers: Floats) -> Floats:
        towards = mean + numbers[:2] @ ways
        towards /= np.linalg.norm(towards)
        closeness = numbers[2] / ball.radius
        return np.append(towards + closeness * ball.centre, closeness)

    def residuals(numbers: Floats) -> Floats:
        seen = seen_from(lamp(numbers)[None], points)[0][:, 0]
        return np.asarray(np.einsum("nkc,nc->nk", across, seen - directions) / std[:, None]).ravel()

    found = least_squares(
        residuals, [0, 0, 0.05], bounds=([-1, -1, 0], [1, 1, _NEAREST]), x_scale=[0.1, 0.1, 0.1]
    )
    excess = max(1.0, 2 * found.cost / (found.fun.size - 3))
    variance = np.linalg.pinv(found.jac.T @ found.jac)[2, 2] * excess
    if found.x[2] <= _NEAR * np.sqrt(variance):
        return None
    source = lamp(found.x)
    closeness = source[3]
    towards = source[:3] - closeness * ball.centre
    place = ball.centre + towards / closeness
    brighter = [
        _enlarged(ball, view, place, point) * (closeness * np.linalg.norm(place - point)) ** 2
        for (view, _), point in zip(group, points, strict=True)
    ]
    return PlacedSource(towards, closeness, float(np.sqrt(variance)) / ball.radius, np.array(brighter))


def _enlarged(ball: Sphere, view: BallView, place: Floats, point: Floats) -> float:
    """How many times as large a near lamp's solid angle is as the ball's pixels say, which take it for distant.

    From pixel to pixel the direction to the lamp turns against the mirrored one, so that it covers fewer of them.
    """
    pixel = view.camera.project(point[None])
    around = pixel + 0.5 * np.array([[1, 0], [-1, 0], [0, 1], [0, -1]])
    mirrored = mirrored_directions(ball, view.camera, around)[1]
    towards = place - _points(ball, view, around)
    towards /= np.linalg.norm(towards, axis=1, keepdims=True)
    turns = [of[[0, 2]] - of[[1, 3]] for of in (mirrored, mirrored - towards)]
    distant, near = (np.linalg.norm(np.cross(*of)) for of in turns)
    return float(near / distant)
