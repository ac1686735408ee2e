"""A mesh's place from picks in photographs of known pose, without a first guess.

For a given rotation the distances of points from their rays are linear in shift and scale [Lu, Hager & Mjolsness 2000,
"Fast and globally convergent pose estimation from video images", here for several cameras and with scale]: that
is solved for rotations all over, the best are refined to least reprojection, and what agrees best is kept.
"""

from __future__ import annotations

from dataclasses import dataclass
from itertools import combinations

import numpy as np
from numpy.typing import NDArray

from capture.gaussnewton import LocalProblem, damped_step, gauss_newton
from recon.poses.align.pixelrays import PixelRays
from recon.poses.similarity import Similarity, motion_jacobian, rotations_all_over

Floats = NDArray[np.float64]
Bools = NDArray[np.bool_]

LEAST_PICKS = 4
_ROTATIONS = 600
# Starts that are refined, and degrees by which they differ.
_STARTS, _APART = 6, np.radians(25)
# Squared pixels below which a further step is worth nothing, and the most steps.
_CONVERGED, _STEPS = 1e-9, 100
# Subsets of picks that are tried where not all agree.
_SUBSETS = 120
# How far off a click may be before it is doubted, pixels; or as a share of the photo's focal length.
_CLICK_PX, _CLICK_SHARE = 4.0, 0.004


@dataclass(frozen=True, eq=False)
class PickFit:
    """Places that picks allow, the best first. kept : (n,) bool, picks that agree. residuals : (n,) pixels each.

    sigma : pixels, scatter of those that agree in u and v.
    """

    places: tuple[Similarity, ...]
    kept: Bools
    residuals: Floats
    sigma: float


def fit_picks(rays: PixelRays, points: Floats, free_scale: bool, focal_px: float) -> PickFit:
    """The similarity that puts points (n, 3) of a mesh on the rays of their picks, and which picks don't agree.

    free_scale : false holds it at 1. ValueError where the picks don't determine it, or more than a third don't agree.
    """
    check_spread(points)
    tolerance = max(_CLICK_PX, _CLICK_SHARE * focal_px)
    places = _places(rays, points, free_scale)
    count = len(points)
    kept = np.ones(count, bool)
    if not places or _off(rays, points, places[0]).max() > tolerance:
        if _fits_mirrored(rays, points, free_scale, tolerance):
            raise ValueError(
                "the picks look mirrored: they fit the mesh's mirror image, not the mesh; are two of x, y, z swapped,"
                " or one of the wrong sign?"
            )
        kept, place = _consensus(rays, points, free_scale, tolerance)
        if place is None:
            raise ValueError(_disagreement(rays, points, places, tolerance))
        places = [place]
    residuals = _off(rays, points, places[0])
    freedom = max(2 * int(kept.sum()) - (7 if free_scale else 6), 1)
    sigma = float(np.sqrt((residuals[kept] ** 2).sum() / freedom))
    alike = [
        p for p in places if np.sqrt((_off(rays, points, p)[kept] ** 2).mean()) < max(2 * sigma, tolerance)
    ]
    return PickFit(tuple(alike), kept, residuals, sigma)


def check_spread(points: Floats) -> None:
    """ValueError unless there are enough different points, not all on a line."""
    distinct = np.unique(points, axis=0)
    if len(distinct) < LEAST_PICKS:
        raise ValueError(
            f"{len(distinct)} different points are picked; at least {LEAST_PICKS} are needed, 6 or more are better"
        )
    spread = np.linalg.svd(distinct - distinct.mean(axis=0), compute_uv=False)
    if spread[1] < 0.02 * spread[0]:
        raise ValueError(
            "all picks lie on a line, about which the mesh could turn; pick points spread over the object"
        )


def _fits_mirrored(rays: PixelRays, points: Floats, free_scale: bool, tolerance: float) -> bool:
    """Whether all picks fit the mesh's mirror image."""
    spread = np.linalg.svd(points - points.mean(axis=0), compute_uv=False)
    # A flat figure is its own mirror image, seen from behind.
    if spread[2] < 0.02 * spread[0]:
        return False
    mirrored = points * [1, 1, -1]
    places = _places(rays, mirrored, free_scale)
    return bool(places) and float(_off(rays, mirrored, places[0]).max()) <= tolerance


def _places(rays: PixelRays, points: Floats, free_scale: bool, most: int = _STARTS) -> list[Similarity]:
    """Places of least reprojection, from rotations all over, the best first; none if points would lie behind."""
    rotations = rotations_all_over(_ROTATIONS)
    cost, scales, shifts = _shifts(rays, points, rotations, free_scale)
    found: list[tuple[float, Similarity]] = []
    chosen: list[Similarity] = []
    for index in np.argsort(cost):
        if not np.isfinite(cost[index]) or len(chosen) == most:
            break
        start = Similarity(scales[index], rotations[index], shifts[index])
        if all(start.angle_to(other) > _APART for other in chosen):
            chosen.append(start)
            place = _polished(rays, points, start, free_scale)
            if (rays.parallel | (rays.depths(place.apply(points)) > 0)).all():
                found.append((_rms(rays, points, place), place))
    found.sort(key=lambda pair: pair[0])
    distinct: list[Similarity] = []
    for _, place in found:
        if all(place.angle_to(other) > np.radians(2) for other in distinct):
            distinct.append(place)
    return distinct


def _shifts(
    rays: PixelRays, points: Floats, rotations: Floats, free_scale: bool
) -> tuple[Floats, Floats, Floats]:
    """For each rotation (g, 3, 3): cost (g,), and the scale (g,) and shift (g, 3) of least distance from rays."""
    across = np.eye(3) - rays.directions[:, :, None] * rays.directions[:, None, :]
    # Far points count less: what matters is the angle. The rays' common point stands for the object.
    middle = np.linalg.lstsq(across.sum(axis=0), np.einsum("nij,nj->i", across, rays.origins), rcond=1e-9)[0]
    depth = np.where(
        rays.parallel, 1, np.maximum(rays.depths(np.broadcast_to(middle, rays.origins.shape)), 1e-9)
    )
    nearness = (
        (np.median(depth) / depth) ** 2 if len(np.unique(rays.origins, axis=0)) > 1 else np.ones(len(depth))
    )
    across = across * nearness[:, None, None]
    turned = np.einsum("gij,nj->gni", rotations, points)
    pulled = np.einsum("nij,gnj->gni", across, turned)
    count = len(rotations)
    normal = np.zeros((count, 4, 4))
    right = np.zeros((count, 4))
    normal[:, 0, 0] = (turned * pulled).sum(axis=(1, 2))
    normal[:, 0, 1:] = normal[:, 1:, 0] = pulled.sum(axis=1)
    normal[:, 1:, 1:] = across.sum(axis=0)
    to_origin = np.einsum("nij,nj->ni", across, rays.origins)
    right[:, 0] = np.einsum("gni,ni->g", turned, to_origin)
    right[:, 1:] = to_origin.sum(axis=0)
    if not free_scale:
        right[:, 1:] -= normal[:, 1:, 0]
        solution = np.ones((count, 4))
        solution[:, 1:] = _solved(normal[:, 1:, 1:], right[:, 1:])
    else:
        solution = _solved(normal, right)
    scales, shifts = solution[:, 0], solution[:, 1:]
    gap = scales[:, None, None] * turned + shifts[:, None] - rays.origins
    cost = np.einsum("gni,nij,gnj->g", gap, across, gap)
    ahead = rays.parallel | (np.einsum("gni,ni->gn", gap, rays.directions) > 0)
    return np.where((scales > 0) & ahead.all(axis=1), cost, np.inf), scales, shifts


def _solved(normal: Floats, right: Floats) -> Floats:
    """Solutions of small symmetric systems; where they leave a direction open, the shortest."""
    inverse = np.linalg.pinv(normal, rcond=1e-10, hermitian=True)
    return np.asarray(np.einsum("gij,gj->gi", inverse, right))


def _polished(rays: PixelRays, points: Floats, start: Similarity, free_scale: bool) -> Similarity:
    """The place of least reprojection next to a start."""
    free = 7 if free_scale else 6

    def about(place: Similarity) -> LocalProblem[Similarity]:
        placed = place.apply(points)
        pivot = placed.mean(axis=0)
        offsets, by_point = rays.offsets(placed)
        jacobian = (by_point @ motion_jacobian(placed, pivot)[:, :, :free]).reshape(-1, free)
        normal, pull = jacobian.T @ jacobian, -jacobian.T @ offsets.ravel()

        def moved(step: Floats) -> Similarity:
            full = np.zeros(7)
            full[:free] = step
            full[6] = np.clip(full[6], -1, 1)
            return place.moved(full, pivot)

        return LocalProblem(
            step=lambda damping: damped_step(normal, pull, damping),
            pull=pull,
            moved=moved,
            gain=lambda other: float((offsets**2).sum() - (rays.offsets(other.apply(points))[0] ** 2).sum()),
        )

    return gauss_newton(start, about, _CONVERGED, _STEPS, told_apart=_CONVERGED)


def _off(rays: PixelRays, points: Floats, place: Similarity) -> Floats:
    return np.linalg.norm(rays.offsets(place.apply(points))[0], axis=1)


def _rms(rays: PixelRays, points: Floats, place: Similarity) -> float:
    return float(np.sqrt((_off(rays, points, place) ** 2).mean()))


def _consensus(
    rays: PixelRays, points: Floats, free_scale: bool, tolerance: float
) -> tuple[Bools, Similarity | None]:
    """Which picks agree, and on what place: least median of squares over small subsets [Rousseeuw 1984].

    None where fewer than two thirds, or than one more than are needed, agree.
    """
    count = len(points)
    needed = max(int(np.ceil(2 * count / 3)), LEAST_PICKS + 1)
    if count < needed + 1:
        return np.ones(count, bool), None
    subsets = list(combinations(range(count), LEAST_PICKS))
    if len(subsets) > _SUBSETS:
        rng = np.random.default_rng(0)
        subsets = [tuple(rng.permutation(count)[:LEAST_PICKS]) for _ in range(_SUBSETS)]
    best, least = None, np.inf
    for subset in subsets:
        chosen = np.array(subset)
        try:
            check_spread(points[chosen])
        except ValueError:
            continue
        for place in _places(rays.of(chosen), points[chosen], free_scale, most=2):
            middle = float(np.sort(_off(rays, points, place))[needed - 1])
            if middle < least:
                best, least = place, middle
    if best is None:
        return np.ones(count, bool), None
    off = _off(rays, points, best)
    kept = off <= np.sort(off)[needed - 1]
    place = _polished(rays.of(kept), points[kept], best, free_scale)
    # Far from the few that it was fitted to, a place is unsure: who seems wrong may come in if that makes all agree.
    for candidate in np.argsort(_off(rays, points, place)):
        trial = kept.copy()
        trial[candidate] = True
        wider = _polished(rays.of(trial), points[trial], place, free_scale)
        if _off(rays, points, wider)[trial].max() <= tolerance:
            kept, place = trial, wider
    agree = _off(rays, points, place)[kept].max() <= tolerance
    return kept, place if agree else None


def _disagreement(rays: PixelRays, points: Floats, places: list[Similarity], tolerance: float) -> str:
    if not places:
        return "the picks fit no place of the mesh in front of all cameras; check the photos' poses and the picks"
    worst = _off(rays, points, places[0]).max()
    return (
        f"the picks don't agree: the best place leaves one of them {worst:.3g} px off, more than {tolerance:.3g} px;"
        " check that u is the column and v the row, that no rows are swapped, and the photos' poses; with 8 or more"
        " picks a wrong one is found and named"
    )
