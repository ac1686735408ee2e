"""How views of a mirror ball are turned to each other, found by making them show the same room.

Light is distant, so that two views differ by a rotation alone. It is searched for over all rotations on coarse
maps of log radiance, best first, and refined by least squares on finer ones; what is left between the maps, and
the balls' outlines, then say how certain it is. Rooms of few features, or the same all round, leave it open: that is
refused.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import map_coordinates
from scipy.optimize import least_squares
from scipy.spatial.transform import Rotation

from capture.lighting import latlong_directions, latlong_pixels
from recon.mirrorball.view import BallView
from recon.mirrorball.viewmap import view_map

Floats = NDArray[np.float64]

# Rows of the maps for the search and for the refinement: pixels of 11 and of 2.8 degrees.
_COARSE, _FINE = 16, 64
# Spacing of the rotations that are tried, in degrees; how many of the best are refined, and how far apart these are.
_SPACING_DEG, _BASINS, _APART_DEG = 15.0, 6, 20.0
# Correlation that the best rotation must reach; and the share that it leaves unexplained of what any other does: of
# a hundred independent patches, more would be chance less than once in a million.
_LEAST_CORRELATION, _CLEAR = 0.6, 0.75
# What maps of one room leave unexplained by their pixels alone; and the standard deviation of a turn that is no use.
_ALIKE, _WORST_STD_DEG = 0.01, 3.0
# Degrees over which the errors of a map's pixels are one: the blur of the finest map and of the ball.
_CORRELATED_DEG = 8.0


@dataclass(frozen=True)
class Turn:
    """How a view's camera is turned to the first one's. std_deg : of the turn about any axis, the worst one's."""

    angle_deg: float
    std_deg: float
    correlation: float


@dataclass(frozen=True, eq=False)
class _Samples:
    """Log radiance of a view at directions (n, 3) with weights (n,), and as a map (H, 2H) with weights (H, 2H)."""

    directions: Floats
    values: Floats
    weights: Floats
    picture: Floats
    confidence: Floats


def registered(views: Sequence[BallView]) -> tuple[list[BallView], tuple[Turn, ...]]:
    """The views turned to the first one's world, and how each one is.

    ValueError names the view for which no rotation, or more than one, makes it show the first one's room.
    """
    turned, turns = [views[0]], [Turn(0.0, 0.0, 1.0)]
    coarse, fine = _samples(views[0], _COARSE), _samples(views[0], _FINE)
    for view in views[1:]:
        rotation, std, correlation = _rotation(view, views[0].name, coarse, fine)
        std = float(np.sqrt(std**2 + _outline_variance(view) + _outline_variance(views[0])))
        turned.append(_turned(view, rotation))
        angle = float(np.degrees(rotation.magnitude()))
        turns.append(Turn(angle, float(np.degrees(std)), correlation))
    return turned, tuple(turns)


def _rotation(view: BallView, first: str, coarse: _Samples, fine: _Samples) -> tuple[Rotation, float, float]:
    """The rotation that takes a view's directions to the first one's, its std in radians, and the correlation."""
    own, fine_own = _samples(view, _COARSE), _samples(view, _FINE)
    tried = _all_rotations()
    scores = np.array([_correlation(own, coarse, rotation) for rotation in tried])
    basins: list[Rotation] = []
    for index in np.argsort(scores)[::-1]:
        if len(basins) < _BASINS and all(_apart_deg(tried[index], other) > _APART_DEG for other in basins):
            basins.append(tried[index])
    found = []
    for start in basins:
        rotation, std = _refine(fine_own, fine, _refine(own, coarse, start)[0])
        found.append((_correlation(fine_own, fine, rotation), rotation, std))
    found.sort(key=lambda entry: -entry[0])
    best, rotation, std = found[0]
    rival = max((r for r, other, _ in found if _apart_deg(rotation, other) > _APART_DEG / 2), default=-1.0)
    unlike = (1 - rival + _ALIKE) * _CLEAR > 1 - best + _ALIKE
    if best < _LEAST_CORRELATION or not unlike or std > np.radians(_WORST_STD_DEG):
        raise ValueError(
            f"{view.name}: how it is turned to {first} cannot be determined: the best rotation shows the same room with"
            f" a correlation of {best:.3f}, another with {rival:.3f}; give the angles or the poses of the cameras"
            " (--view-angle-deg, --poses)"
        )
    return rotation, std, best


def _outline_variance(view: BallView) -> float:
    """Variance, radians^2, of a turn about any axis that an outline's error looks like.

    One that is off by d pixels turns what the middle of the ball shows by 2 d / r.
    """
    covariance, sphere = view.sphere.covariance, view.sphere
    return float(4 * (np.trace(covariance[:3, :3]) / 2 + covariance[3, 3]) / sphere.radius**2)


def _apart_deg(one: Rotation, other: Rotation) -> float:
    return float(np.degrees((one.inv() * other).magnitude()))


def _samples(view: BallView, height: int) -> _Samples:
    # With the sources: lamps are the best marks of all.
    seen = view_map(replace(view, without_sources=view.pixels.radiance), height)
    light = seen.radiance.mean(axis=2).astype(float)
    known = seen.covered > 0.5
    floor = 0.05 * float(np.median(light[known])) + 1e-12
    picture = np.log(light + floor)
    mean = float(np.average(picture[known], weights=seen.covered[known]))
    picture = np.where(known, picture - mean, 0.0)
    # Of both views together, a direction then counts with about the inverse variance of its place. Coarsely all
    # count alike: else a few pixels that happen to match would speak for the whole room.
    weight = np.sqrt(seen.weight) if height == _FINE else np.ones_like(seen.weight)
    confidence = np.where(known, weight / max(float(weight.max()), 1e-12), 0.0)
    directions = latlong_directions(height)
    solid_angle = np.broadcast_to(np.sqrt(1 - directions[..., 2] ** 2), confidence.shape)
    return _Samples(
        directions=directions[known],
        values=picture[known],
        weights=(confidence * solid_angle)[known],
        picture=picture,
        confidence=confidence,
    )


def _looked_up(other: _Samples, directions: Floats) -> tuple[Floats, Floats]:
    """Values and weights (n,) of another view's map at directions (n, 3)."""
    height = len(other.picture)
    row, column = latlong_pixels(directions, height)
    at = np.stack([np.clip(row - 0.5, 0, height - 1), column - 0.5])
    # Round in columns, not in rows.
    pad = ((0, 0), (1, 1))
    at[1] += 1
    wrapped = [np.pad(each, pad, mode="wrap") for each in (other.picture, other.confidence)]
    value, weight = (map_coordinates(each, at, order=1, mode="nearest") for each in wrapped)
    return value, weight


def _correlation(own: _Samples, other: _Samples, rotation: Rotation) -> float:
    """Weighted correlation of two views' log radiance where they overlap, -1 if hardly anywhere."""
    value, weight = _looked_up(other, rotation.apply(own.directions))
    weight = weight * own.weights
    if not weight.sum() > 0:
        return -1.0
    a, b = own.values - np.average(own.values, weights=weight), value - np.average(value, weights=weight)
    scale = np.sqrt((weight * a * a).sum() * (weight * b * b).sum())
    return float((weight * a * b).sum() / scale) if scale > 0 else -1.0


def _refine(own: _Samples, other: _Samples, start: Rotation) -> tuple[Rotation, float]:
    """The rotation near another at which two maps differ least, and its standard deviation in radians."""

    def residuals(step: Floats) -> Floats:
        rotation = Rotation.from_rotvec(step[:3]) * start
        value, weight = _looked_up(other, rotation.apply(own.directions))
        return np.asarray(np.sqrt(weight * own.weights) * (value - own.values - step[3]))

    # The map is piecewise linear: differences over a good part of a pixel, not over rounding.
    fit = least_squares(residuals, np.zeros(4), diff_step=0.02, x_scale=0.1, loss="soft_l1")
    weights = (
        _looked_up(other, (Rotation.from_rotvec(fit.x[:3]) * start).apply(own.directions))[1] * own.weights
    )
    count = max(float(weights.sum() ** 2 / max((weights**2).sum(), 1e-12)), 5.0)
    variance = float((residuals(fit.x) ** 2).sum()) / count
    # Neighbouring pixels err alike.
    shared = max(1.0, (_CORRELATED_DEG / (180 / len(other.picture))) ** 2)
    jacobian = fit.jac
    covariance = np.linalg.pinv(jacobian.T @ jacobian, hermitian=True)[:3, :3] * variance * shared
    return Rotation.from_rotvec(fit.x[:3]) * start, float(np.sqrt(np.linalg.eigvalsh(covariance)[-1]))


def _all_rotations() -> list[Rotation]:
    """Rotations at most about `_SPACING_DEG` from any: axes on a Fibonacci sphere, turned about themselves."""
    step = np.radians(_SPACING_DEG)
    count = int(np.ceil(4 * np.pi / step**2))
    index = np.arange(count) + 0.5
    z, phi = 1 - 2 * index / count, index * np.pi * (3 - np.sqrt(5))
    tilts = Rotation.from_euler("ZY", np.column_stack([phi, np.arccos(z)]))
    spins = Rotation.from_rotvec(np.outer(np.arange(0, 2 * np.pi, step), [0, 0, 1]))
    return [tilt * spin for tilt in tilts for spin in spins]


def _turned(view: BallView, rotation: Rotation) -> BallView:
    """The view with its camera, ball and directions turned."""
    matrix = rotation.as_matrix()
    world_to_camera = view.camera.world_to_camera.copy()
    world_to_camera[:3, :3] = world_to_camera[:3, :3] @ matrix.T
    covariance = view.sphere.covariance.copy()
    covariance[:3, :3] = matrix @ covariance[:3, :3] @ matrix.T
    covariance[:3, 3] = matrix @ covariance[:3, 3]
    covariance[3, :3] = covariance[:3, 3]
    return replace(
        view,
        camera=view.camera.posed(world_to_camera),
        sphere=replace(view.sphere, centre=matrix @ view.sphere.centre, covariance=covariance),
        pixels=replace(view.pixels, directions=view.pixels.directions @ matrix.T),
        sources=tuple(replace(source, direction=matrix @ source.direction) for source in view.sources),
    )
