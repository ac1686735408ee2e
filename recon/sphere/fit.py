"""A sphere's centre and radius from its outlines in photographs.

The rays through a sphere's outline touch it, so the distance from the centre to each such ray is the radius. That
one statement holds for every camera, perspective (where the outline is an ellipse) or orthographic, and joins any
number of views in one least-squares problem.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import maximum_filter1d
from scipy.optimize import least_squares

from capture.camera import Camera
from recon.sphere.circle import consensus_circle
from recon.sphere.outline import Silhouette
from recon.sphere.scatter import common_spread, jackknife
from recon.sphere.sphere import Sphere

Floats = NDArray[np.float64]
Bools = NDArray[np.bool_]

# Outline points per photo that enter the fit: beyond a few thousand the pixel grid's error is averaged out.
_POINTS_PER_PHOTO = 2000
# Arcs of an outline whose errors count as independent: within them a mask's stairs and a picture's edges err alike.
_ARCS = 20
# Tukey's biweight: standard deviations beyond which a point counts for nothing (95% efficient for Gaussian errors).
_REACH = 4.685
# Points on either side of an outlier that count for nothing either.
_BESIDE = 3
# Least scatter of an outline's points, in pixels: an 8-bit mask rounds coverage to 1/255.
_LEAST_SCATTER = 0.003
_STEPS = 50


@dataclass(frozen=True, eq=False)
class _Touching:
    """Rays (n, 3) through outlines that ought to touch a sphere. view : (n,) int, which camera each belongs to."""

    cameras: Sequence[Camera]
    origins: Floats
    directions: Floats
    view: NDArray[np.int64]

    def residuals(self, sphere: Floats) -> tuple[Floats, Floats]:
        """How far outside the sphere (centre, radius) rays pass, in pixels (n,), and the derivatives (n, 4)."""
        offset = sphere[:3] - self.origins
        along = (offset * self.directions).sum(axis=1)
        gap = offset - along[:, None] * self.directions
        distance = np.linalg.norm(gap, axis=1)
        focal = np.array([camera.focal_px for camera in self.cameras])[self.view]
        parallel = np.array([camera.is_orthographic for camera in self.cameras])[self.view]
        depth = np.where(parallel, 1.0, np.copysign(np.maximum(np.abs(along), 1e-12), along))
        per_metre = focal / np.abs(depth)
        residual = (distance - sphere[3]) * per_metre
        slope = np.empty((len(distance), 4))
        slope[:, :3] = gap * (per_metre / np.maximum(distance, 1e-300))[:, None]
        slope[:, :3] -= np.where(parallel, 0.0, residual / depth)[:, None] * self.directions
        slope[:, 3] = -per_metre
        return residual, slope


def fit_sphere(
    cameras: Sequence[Camera],
    silhouettes: Sequence[Silhouette],
    centre: Sequence[float] | None = None,
    radius: float | None = None,
) -> Sphere:
    """Fit a sphere to its silhouettes, one per camera; what is given is kept.

    centre : (3,) metres or None. radius : metres or None. See `fit_to_outlines`. One mask that several photographs from
    one place share is one measurement.
    """
    keys = [_key(*pair) for pair in zip(cameras, silhouettes, strict=True)]
    first = {key: place for place, key in reversed(list(enumerate(keys)))}
    places = sorted(first.values())
    found = _fit_distinct([cameras[k] for k in places], [silhouettes[k] for k in places], centre, radius)
    rank = {place: number for number, place in enumerate(places)}
    return replace(found, residual_px=tuple(found.residual_px[rank[first[key]]] for key in keys))


def _key(camera: Camera, silhouette: Silhouette) -> tuple[object, ...]:
    """What two photographs have in common if their outlines are one measurement: camera, pose and points."""
    arrays = camera.params, camera.world_to_camera, silhouette.points
    return camera.model, camera.width, camera.height, *(np.asarray(array).tobytes() for array in arrays)


def _fit_distinct(
    cameras: Sequence[Camera],
    silhouettes: Sequence[Silhouette],
    centre: Sequence[float] | None,
    radius: float | None,
) -> Sphere:
    """`fit_sphere` of outlines each of which is a measurement of its own."""
    outlines = [_around(silhouette.points) for silhouette in silhouettes]
    guess = _first_guess(cameras, outlines, radius)
    if centre is not None:
        guess[:3] = centre
    if radius is not None:
        guess[3] = radius
    free = np.array([centre is None] * 3 + [radius is None])
    hidden = [silhouette.hidden_px for silhouette in silhouettes]
    edge = [silhouette.edge_px for silhouette in silhouettes]
    return fit_to_outlines(cameras, outlines, guess, free, hidden, edge)


def fit_to_outlines(
    cameras: Sequence[Camera],
    outlines: Sequence[Floats],
    guess: Floats,
    free: Bools,
    hidden_px: Sequence[float],
    edge_px: Sequence[float] | None = None,
) -> Sphere:
    """The sphere that rays through outline points touch.

    outlines : (n, 2) pixels per camera, in any order. guess : (4,) centre and radius in metres. free : (4,) which of
    them are fitted. Outliers, such as points of a stand that a mask includes, count
    for nothing. The covariance comes from how arcs of the outlines, and photographs, disagree; to it are added
    errors that neither shows, standard deviations: `hidden_px` per camera, by which a whole outline may be shifted, and
    all together be grown; `edge_px` per camera, by which all together may be grown without a shift.
    One outline in several cameras errs in all of them alike.

    ValueError where an outline has fewer than 12 points or the lens distortion can't be undone.
    """
    points = [_around(outline) for outline in outlines]
    rays = [camera.rays(each) for camera, each in zip(cameras, points, strict=True)]
    if not all(np.isfinite(directions).all() for _, directions in rays):
        raise ValueError("the camera's distortion cannot be undone at the mask's outline; check its params")
    view = np.repeat(np.arange(len(points)), [len(each) for each in points])
    touching = _Touching(
        cameras, np.concatenate([o for o, _ in rays]), np.concatenate([d for _, d in rays]), view
    )
    sphere, scatter = _solve(touching, guess, free)
    numbers: dict[bytes, int] = {}
    same = [numbers.setdefault(each.tobytes(), len(numbers)) for each in points]
    arcs = [
        np.arange(len(each)) * _ARCS // len(each) + _ARCS * k for each, k in zip(points, same, strict=True)
    ]
    growth = np.hypot(hidden_px, 0.0 if edge_px is None else edge_px)
    covariance = np.zeros((4, 4))
    if free.any():
        covariance[np.ix_(free, free)] = _covariance(
            touching, sphere, scatter, free, np.concatenate(arcs), hidden_px, growth
        )
    residual = touching.residuals(sphere)[0]
    per_photo = tuple(_robust_rms(residual[view == k]) for k in range(len(points)))
    return Sphere(sphere[:3], float(abs(sphere[3])), covariance, per_photo)


def _around(points: Floats) -> Floats:
    """Outline points in their order around it, thinned."""
    if len(points) < 12:
        raise ValueError("the outline has fewer than 12 points; the object is too small or fills the image")
    offset = points - points.mean(axis=0)
    # The stairs of a mask are longest where its outline is upright or level: such places are amid an arc.
    turn = np.arctan2(offset[:, 1], offset[:, 0]) + np.pi / _ARCS
    points = points[np.argsort(turn % (2 * np.pi))]
    return points[np.linspace(0, len(points) - 1, min(len(points), _POINTS_PER_PHOTO)).astype(int)]


def _robust_rms(residual: Floats) -> float:
    """1.4826 median absolute residual is the RMS of Gaussian ones."""
    return float(1.4826 * np.median(np.abs(residual)))


def _solve(touching: _Touching, guess: Floats, free: Bools) -> tuple[Floats, Floats]:
    """The sphere (4,), and each ray's scatter (n,) in pixels: that of its photo, or the usual one if larger."""
    determined = _determined(touching.residuals(guess)[1], free)
    starts = [guess.astype(float)]
    if free.any():
        # A guess may be far off, and the best fit to all points, to the pixel, be bent by outliers.
        near = least_squares(
            lambda step: touching.residuals(guess + determined @ step)[0],
            np.zeros(determined.shape[1]),
            lambda step: touching.residuals(guess + determined @ step)[1] @ determined,
            loss="cauchy",
            x_scale=guess[3],
        )
        starts.append(guess + determined @ near.x)
    return min(
        (_reweighted(touching, start, determined) for start in starts),
        key=lambda fit: float(np.median(fit[1])),
    )


def _reweighted(touching: _Touching, start: Floats, determined: Floats) -> tuple[Floats, Floats]:
    """The nearest fit that forgets outliers beyond the points' own scatter, and that scatter (n,)."""
    sphere = start
    # Not `capture.gaussnewton`: weights are renewed with each step, so that costs can't be compared.
    for _ in range(_STEPS):
        residual, slope = touching.residuals(sphere)
        scatter = _scatter(residual, touching.view)
        weight = _weight(residual / scatter)[0] / scatter**2
        slope = slope @ determined
        step = -determined @ _inverse(slope.T @ (slope * weight[:, None])) @ (slope.T @ (weight * residual))
        sphere = sphere + step
        # Far below what any outline resolves.
        if np.linalg.norm(step) <= 1e-9 * abs(sphere[3]):
            break
    return sphere, scatter


def _determined(slope: Floats, free: Bools) -> Floats:
    """Orthonormal directions (4, m) of the free parameters that outlines determine: not that along which one viewpoint
    changes distance and size together, where a search would drift."""
    _, strength, directions = np.linalg.svd(slope[:, free], full_matrices=False)
    determined = np.zeros((4, int((strength > 3e-5 * strength.max(initial=0.0)).sum())))
    determined[free] = directions[: determined.shape[1]].T
    return determined


def _scatter(residual: Floats, view: NDArray[np.int64]) -> Floats:
    """A photo that fits better than most does not count for more: one alone can always be fitted."""
    rms = np.array([_robust_rms(residual[view == k]) for k in range(view[-1] + 1)])
    return np.asarray(np.maximum(rms, max(float(np.median(rms)), _LEAST_SCATTER))[view])


def _weight(ratio: Floats) -> tuple[Floats, Floats]:
    """The biweight of residuals in standard deviations, and the derivative of weight times residual.

    ratio : (n,) in order around the outlines. A stand leaves the outline gradually, so that points beside
    outliers are its own, too.
    """
    outlying = maximum_filter1d((np.abs(ratio) > _REACH).astype(np.uint8), 2 * _BESIDE + 1) > 0
    square = np.where(outlying, 1.0, np.minimum((ratio / _REACH) ** 2, 1.0))
    return (1 - square) ** 2, (1 - square) * (1 - 5 * square)


def _inverse(matrix: Floats) -> Floats:
    """Zero along what one viewpoint leaves free: distance and size together."""
    return np.asarray(np.linalg.pinv(matrix, rcond=1e-9, hermitian=True))


def _covariance(
    touching: _Touching,
    sphere: Floats,
    scatter: Floats,
    free: Bools,
    arcs: NDArray[np.int64],
    hidden_px: Sequence[float],
    growth_px: Sequence[float] | Floats,
) -> Floats:
    """Covariance of the free parameters: the jackknife over arcs, and what makes photographs disagree beyond it."""
    residual, slope = touching.residuals(sphere)
    weight, change = _weight(residual / scatter)
    gradients = slope * (weight * residual / scatter**2)[:, None]
    curvatures = slope * np.sqrt(np.maximum(change, 0))[:, None] / scatter[:, None]
    local = [seen_by(camera, sphere) for camera in touching.cameras]
    shifts, variances, responses = [], [], []
    total = curvatures[:, free].T @ curvatures[:, free]
    for k, basis in enumerate(local):
        mine = touching.view == k
        own, push = curvatures[mine] @ basis, gradients[mine] @ basis
        shifts.append(-_inverse(own.T @ own) @ push.sum(axis=0))
        variances.append(jackknife(own, push, arcs[mine]))
        responses.append(_inverse(total) @ (curvatures[mine][:, free].T @ own))
    moves, spreads = np.array(shifts), np.array(variances)
    covariance = jackknife(curvatures[:, free], gradients[:, free], arcs)
    # Errors of poses turn and shift a photo much more than they scale it.
    for part, fitted in ((slice(0, 2), int(free[:3].sum())), (slice(2, 3), int(free[3]))):
        spread = common_spread(moves[:, part], spreads[:, part, part], fitted)
        covariance += spread * sum(response[:, part] @ response[:, part].T for response in responses)
    for hidden, response in zip(hidden_px, responses, strict=True):
        covariance += hidden**2 * response[:, :2] @ response[:, :2].T
    grown = sum(growth * response[:, 2] for growth, response in zip(growth_px, responses, strict=True))
    return np.asarray(covariance + np.outer(grown, grown))


def seen_by(camera: Camera, sphere: Floats) -> Floats:
    """Basis (4, 3): one pixel to the right and down, and of the radius, in which one photo sees a sphere."""
    body = Sphere(sphere[:3], float(abs(sphere[3])), np.zeros((4, 4)))
    turned = camera.camera_to_world[:3, :3]
    axis = turned[:, 2] if camera.is_orthographic else body.centre - camera.centre
    axis = axis / np.linalg.norm(axis)
    right = turned[:, 0] - (turned[:, 0] @ axis) * axis
    right /= np.linalg.norm(right)
    basis = np.zeros((4, 3))
    basis[:3, 0], basis[:3, 1], basis[3, 2] = right, np.cross(axis, right), 1.0
    return basis * body.radius / body.pixel_radius(camera)


def _first_guess(cameras: Sequence[Camera], outlines: Sequence[Floats], radius: float | None) -> Floats:
    """Centre and radius (4,) from circles near the outlines: axes through their middles, intersected."""
    axes, sizes = [], []
    for camera, outline in zip(cameras, outlines, strict=True):
        circle = consensus_circle(outline)
        origin, direction = camera.rays([circle.x, circle.y])
        axes.append((origin[0], direction[0]))
        sizes.append(circle.radius / camera.focal_px)
    # Distance along the first axis that holds if the axes say nothing of it: all views from one place.
    if cameras[0].is_orthographic:
        depth = float(-axes[0][0] @ axes[0][1])
    else:
        depth = radius / sizes[0] if radius is not None else float(np.linalg.norm(cameras[0].centre)) or 1.0
    start = axes[0][0] + depth * axes[0][1]
    weak = 1e-6
    matrix = weak * np.eye(3)
    vector = weak * start
    for origin, direction in axes:
        across = np.eye(3) - np.outer(direction, direction)
        matrix += across
        vector += across @ origin
    centre = np.linalg.solve(matrix, vector)
    spans = [
        size if camera.is_orthographic else size * float(np.linalg.norm(centre - camera.centre))
        for camera, size in zip(cameras, sizes, strict=True)
    ]
    return np.append(centre, np.median(spans))
