"""How sure a mesh's place is: covariance from residuals that err together, and what silhouettes leave open."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from recon.poses.align.outlines import SECTORS
from recon.poses.align.refine import RefinedPlace
from recon.poses.similarity import Similarity

Floats = NDArray[np.float64]

# Directions in which the pixels move by less than this share of the strongest one's are gauges: nothing moves.
_GAUGE = 1e-10
# A turn that is not known better than this isn't known: radians, standard deviation.
_UNKNOWN_TURN = np.radians(4.0)

# Pixels to which outlines are read off even perfect masks, piece by piece: coverage isn't quite linear in the place of
# an edge.
_READ_PX = 0.03


@dataclass(frozen=True, eq=False)
class PlaceUncertainty:
    """Covariance (7, 7) of `Similarity.moved` about the fit's pivot: turn (rad), shift, log scale; zero where held.

    open_turn : (3,) unit, the axis in the world about which the mesh may turn as it likes; None if there is none.
    open_depth : whether some shift changes nothing that is seen (an orthographic camera's depth): a gauge, counted as
    zero.
    """

    covariance: Floats
    open_turn: Floats | None
    open_depth: bool


def uncertainty(refined: RefinedPlace, radius: float, silhouettes: bool) -> PlaceUncertainty:
    """Covariance by the jackknife over sectors of outlines, within which errors of masks go together [Efron & Stein
    1981, "The jackknife estimate of variance"], and, on top, what photographs are off as a whole, poses and masks.

    radius : of the mesh in the world, by which shifts are compared with turns. silhouettes : whether there were any.
    """
    free = refined.free
    unit = np.array([1.0] * 3 + [radius] * 3 + [1.0, 1.0])[free]
    jacobian = refined.left.jacobian[:, free] * unit
    of_silhouettes = (jacobian * refined.left.weights[:, None]).T @ jacobian
    information = refined.information[np.ix_(free, free)] * np.outer(unit, unit)
    information -= (1 - refined.left.curvature) * of_silhouettes
    values, vectors = np.linalg.eigh(information)
    known = values > _GAUGE * values[-1]
    bread = (vectors[:, known] / values[known]) @ vectors[:, known].T
    gauges = vectors[:, ~known]
    spread = bread
    if silhouettes:
        of_photos, explained = _whole_photos(refined, bread, unit)
        spread = of_photos + _jackknife(refined, information, unit, vectors[:, known], explained)
    covariance = np.zeros((8, 8))
    covariance[np.ix_(free, free)] = spread * np.outer(unit, unit)
    # A gauge that turns is no gauge: the picture doesn't determine how the mesh is turned.
    open_turn = None
    turns, axes = np.linalg.eigh(covariance[:3, :3] + 1e3 * gauges[:3] @ gauges[:3].T)
    if turns[-1] > _UNKNOWN_TURN**2:
        open_turn = axes[:, -1]
    return PlaceUncertainty(covariance[:7, :7], open_turn, bool((~known).any()))


def in_mesh_metres(covariance: Floats, place: Similarity, pivot: Floats) -> Floats:
    """The covariance in the world as it is after it was scaled to the mesh's metres.

    Of a small turn about that world's axes through its origin, applied after mesh_to_world, a shift along them in
    metres, and the logarithm of world_scale.
    """
    world_scale = 1 / place.scale
    middle = world_scale * pivot
    change = np.zeros((7, 7))
    change[:3, :3] = np.eye(3)
    change[3:6, 3:6] = world_scale * np.eye(3)
    # The turn about the origin moves the middle by turn x middle, which the shift takes back.
    x, y, z = middle
    change[3:6, :3] = [[0, -z, y], [z, 0, -x], [-y, x, 0]]
    change[3:6, 6] = -middle
    change[6, 6] = -1
    return np.asarray(change @ covariance @ change.T)


def _jackknife(
    refined: RefinedPlace, information: Floats, unit: Floats, known: Floats, explained: Floats
) -> Floats:
    """Scatter of the estimate when each part of an outline is left out in turn: a sector, or a quarter of the outline,
    whichever scatters more, for nobody knows how far errors of masks reach.

    One step of Gauss-Newton stands for fitting again. What doesn't come from silhouettes, picks and the prior of the
    masks' growth, counts with the covariance that it was given. known : (p, k) directions that are no gauge.
    explained : (n,) part of the residuals that is accounted for elsewhere.
    """
    left, free = refined.left, refined.free
    jacobian = left.jacobian[:, free] * unit @ known
    residual = np.where(left.found, left.offsets - refined.growth, 0) - explained
    whole = known.T @ information @ known
    bread = np.linalg.inv(whole)
    scatters: list[Floats] = []
    for together in (1, SECTORS // 4):
        part = left.photo * SECTORS + left.sector // together
        order = np.argsort(part, kind="stable")
        starts = np.flatnonzero(np.diff(part[order], prepend=-1))
        if len(starts) <= 2 * len(whole) and scatters:
            continue  # too few to judge
        rows, weight = jacobian[order], left.weights[order]
        pulled = rows * weight[:, None]
        scores = np.add.reduceat(pulled * residual[order, None], starts, axis=0)
        informs = left.curvature * np.add.reduceat(pulled[:, :, None] * rows[:, None, :], starts, axis=0)
        floor = 1e-9 * np.trace(whole) * np.eye(len(whole))
        steps = np.linalg.solve(whole - informs + floor, scores[:, :, None])[:, :, 0]
        shifts = left.curvature * np.add.reduceat(pulled, starts, axis=0) @ bread * _READ_PX
        scatters.append(steps.T @ steps * (1 - 1 / len(starts)) + shifts.T @ shifts)
    of_silhouettes = left.curvature * (jacobian * left.weights[:, None]).T @ jacobian
    given = bread @ (whole - of_silhouettes) @ bread
    return np.asarray(known @ (max(scatters, key=np.trace) + given) @ known.T)


def _whole_photos(refined: RefinedPlace, bread: Floats, unit: Floats) -> tuple[Floats, Floats]:
    """What whole photographs that are shifted against the others, as by errors of their poses, add to the covariance,
    and the part of the residuals (n,) that these shifts explain.
    """
    left, free = refined.left, refined.free
    residual = np.where(left.found, left.offsets - refined.growth, 0)
    jacobian = left.jacobian[:, free] * unit
    photos, parameters = np.unique(left.photo), int(free.sum())
    freedom = 2 * len(photos) - parameters
    # The fit itself takes up what few photographs are off.
    if freedom < 3:
        return np.zeros_like(bread), np.zeros_like(residual)
    square = noise = 0.0
    influence, explained = np.zeros_like(bread), np.zeros_like(residual)
    for photo in photos:
        mine = left.photo == photo
        normals = left.normals[mine]
        weighted = normals * left.weights[mine, None]
        inverse = np.linalg.pinv(weighted.T @ normals, rcond=1e-6, hermitian=True)
        shift = inverse @ weighted.T @ residual[mine]
        explained[mine] = normals @ shift
        scores = weighted * (residual[mine] - explained[mine])[:, None]
        sums = np.stack([np.bincount(left.sector[mine], column) for column in scores.T], axis=1)
        square += float(shift @ shift) / freedom
        # Shifts that sectors' own errors make.
        noise += float(np.trace(inverse @ sums.T @ sums @ inverse)) / (2 * len(photos))
        follows = left.curvature * bread @ jacobian[mine].T @ weighted
        influence += follows @ follows.T
    excess = max(square - noise, 0.0)
    return excess * influence, explained * excess / max(square, 1e-30)
