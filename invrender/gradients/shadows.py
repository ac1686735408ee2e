"""Gradients of what an occluder hides of distant light, from the edges that block [RMB07, sections 6 and 7].

Visibility is 0 or 1. Its derivative is a pulse at the blocking edge, times the rate at which the edge's direction
turns as the point moves: a step t turns the direction w of an edge at distance r by -(t - (t.w) w) / r. A curved
occluder's edge is where rays touch it; that this place slides along the ray changes nothing to first order.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import ConvexHull

from recon.harmonics.basis import evaluate_harmonics, sphere_directions
from recon.mesh.bodies import blended
from recon.mesh.rays import RayTracer

Floats = NDArray[np.float64]
Ints = NDArray[np.int64]

# Nodes of the integral over the angles that an occluder hides.
_ANGLES, _WEIGHTS = np.polynomial.legendre.leggauss(64)
# How often the angle between a blocked and a free ray is halved to find the border: to 1e-3 of it.
_HALVINGS = 10


@dataclass(frozen=True, eq=False)
class BlockedAngles:
    """What an occluder in a plane hides from n points: from the first to the second edge, anticlockwise.

    edges : (n, 2), radians. by_place : (n, 2, 2), of each edge its gradient over positions, radians per unit of length.
    """

    edges: Floats
    by_place: Floats

    @classmethod
    def by_polygon(cls, corners: Floats, points: Floats) -> BlockedAngles:
        """By a convex polygon with corners (k, 2), seen from points (n, 2) outside."""
        offsets = corners - points[:, None]
        middle = offsets.mean(axis=1, keepdims=True)
        turned = _angle(middle, offsets)
        ends = np.stack([turned.argmin(axis=1), turned.argmax(axis=1)], axis=1)
        return cls._of(np.take_along_axis(offsets, ends[..., None], axis=1), middle)

    @classmethod
    def by_disc(cls, centre: Floats, radius: float, points: Floats) -> BlockedAngles:
        """By a disc with a centre (2,), seen from points (n, 2) outside."""
        offset = (centre - points)[:, None]
        squared = (offset**2).sum(axis=-1, keepdims=True)
        along = 1 - radius**2 / squared
        across = radius * np.sqrt(along / squared) * np.array([[-1.0], [1.0]])
        left = np.stack([-offset[..., 1], offset[..., 0]], axis=-1)
        return cls._of(along * offset + across * left, offset)

    @classmethod
    def _of(cls, touched: Floats, middle: Floats) -> BlockedAngles:
        """By what touches the edges at offsets (n, 2, 2) from the points, about a direction between them (n, 1, 2)."""
        start = np.arctan2(middle[..., 1], middle[..., 0])
        right = np.stack([touched[..., 1], -touched[..., 0]], axis=-1)
        return cls(start + _angle(middle, touched), right / (touched**2).sum(axis=-1, keepdims=True))

    def hidden(self, density: Callable[[Floats], Floats]) -> Floats:
        """What is hidden (n,) of light times a smooth lobe, density : of angles (n, a), per radian."""
        middle, half = self.edges.mean(axis=1)[:, None], np.diff(self.edges, axis=1) / 2
        return np.asarray((density(middle + half * _ANGLES) * half) @ _WEIGHTS)

    def hidden_by_place(self, density: Callable[[Floats], Floats]) -> Floats:
        """The gradient (n, 2) of `hidden` over positions, for a density that doesn't change with them."""
        pulses = density(self.edges)[..., None] * self.by_place
        return np.asarray(pulses[:, 1] - pulses[:, 0])


@dataclass(frozen=True, eq=False)
class HiddenTransfer:
    """What a mesh hides of each harmonic's irradiance at n points, steradian, and its gradients.

    value : (n, (l_max + 1)^2). by_place : (n, 3, (l_max + 1)^2), over positions, per metre. by_normal : the same, over
    the normal.
    """

    value: Floats
    by_place: Floats
    by_normal: Floats


def hidden_transfer(
    tracer: RayTracer, positions: Floats, normals: Floats, l_max: int, rays: int, turn: Floats | None = None
) -> HiddenTransfer:
    """What a mesh hides of distant light from points (n, 3) with unit normals (n, 3), and how that changes.

    rays : over the whole sphere, 4 or more, an even set; more look for borders between them. turn : a rotation (3, 3)
    of the set; None for none. Raises ValueError for fewer rays.
    """
    if rays < 4:
        raise ValueError(f"rays is {rays}; directions have neighbours from 4 on")
    directions = sphere_directions(rays) @ (np.eye(3) if turn is None else turn).T
    everywhere = np.tile(directions, (len(positions), 1))
    blocked = tracer.met(np.repeat(positions, rays, axis=0), everywhere).reshape(-1, rays)
    borders = _borders(tracer, positions, directions, blocked)
    facing = blocked * (normals @ directions.T > 0) * (4 * np.pi / rays)
    moment = np.einsum(
        "nk,kc,kh->nch", facing, directions, evaluate_harmonics(directions, l_max), optimize=True
    )
    own_normals = normals[borders.points]
    above = ((own_normals * borders.middles).sum(axis=1) > 0)[:, None, None]
    there = above * borders.middles[:, :, None] * evaluate_harmonics(borders.middles, l_max)[:, None]
    np.add.at(moment, borders.points, borders.uncounted[:, None, None] * there)
    pulses = np.einsum("sd,sc,sch->sdh", borders.by_place, own_normals, there)
    by_place = np.zeros_like(moment)
    np.add.at(by_place, borders.points, pulses)
    return HiddenTransfer(np.einsum("nc,nch->nh", normals, moment), by_place, moment)


@dataclass(frozen=True, eq=False)
class _Borders:
    """Short pieces (s,) of borders between blocked and free directions, of all points together.

    points : (s,), whose. middles : (s, 3), their directions. by_place : (s, 3), by what solid angle each goes over
    the free side as the point moves, steradian per metre. uncounted : (s,), what each hides beyond the blocked
    directions' share of its triangle, a third of it each, steradian; negative where it hides less.
    """

    points: Ints
    middles: Floats
    by_place: Floats
    uncounted: Floats


def _borders(
    tracer: RayTracer, positions: Floats, directions: Floats, blocked: NDArray[np.bool_]
) -> _Borders:
    """Borders through the triangles of neighbouring directions (k, 3), blocked : (n, k), straight in each of these."""
    triangles = ConvexHull(directions).simplices
    sides, side_of = np.unique(
        np.sort(np.stack([triangles, np.roll(triangles, -1, axis=1)], axis=-1), axis=-1).reshape(-1, 2),
        axis=0,
        return_inverse=True,
    )
    crossed = blocked[:, sides[:, 0]] != blocked[:, sides[:, 1]]
    points, which = np.nonzero(crossed)
    ends = np.where(blocked[points, sides[which, 0]][:, None], sides[which], sides[which, ::-1])
    starts, frees = directions[ends[:, 0]], directions[ends[:, 1]]
    stops, nearness = _edges(tracer, positions[points], starts, frees)
    number = np.full(crossed.shape, -1)
    number[points, which] = np.arange(len(points))
    # A border enters a triangle through one side and leaves it through another.
    own = number[:, side_of.reshape(-1, 3)]
    whose, triangle = np.nonzero((own >= 0).any(axis=2))
    pair = np.sort(own[whose, triangle], axis=1)[:, 1:]
    one, other = stops[pair[:, 0]], stops[pair[:, 1]]
    middles = _unit(one + other)
    across = np.cross(middles, other - one)
    outwards = directions[ends[pair[:, 0], 1]] - directions[ends[pair[:, 0], 0]]
    across *= np.sign((across * outwards).sum(axis=1, keepdims=True))
    by_place = -across * nearness[pair].mean(axis=1, keepdims=True)
    # One corner is alone on its side of the border, with the product of both sides' parts of the triangle.
    alone = blocked[whose[:, None], triangles[triangle]].sum(axis=1) == 1
    reached = np.linalg.norm(stops - starts, axis=1) / np.linalg.norm(frees - starts, axis=1)
    parts = np.where(alone[:, None], reached[pair], 1 - reached[pair]).prod(axis=1)
    hidden = np.where(alone, parts - 1 / 3, 1 / 3 - parts)
    return _Borders(whose, middles, by_place, hidden * _areas(directions[triangles])[triangle])


def _edges(tracer: RayTracer, origins: Floats, stops: Floats, frees: Floats) -> tuple[Floats, Floats]:
    """Last blocked directions (s, 3) from given blocked to free ones, and one over the distances (s,) seen there."""
    for _ in range(_HALVINGS):
        middles = _unit(stops + frees)
        met = tracer.met(origins, middles)[:, None]
        stops, frees = np.where(met, middles, stops), np.where(met, frees, middles)
    hits = tracer.first_hits(origins, stops)
    there = blended(tracer.vertices, tracer.faces[hits.faces].astype(np.int64), hits.weights)
    return stops, 1 / np.linalg.norm(there - origins, axis=1)


def _areas(corners: Floats) -> Floats:
    """Solid angles (t,) of small triangles with corners (t, 3, 3) of unit length [Van Oosterom and Strackee 1983]."""
    a, b, c = np.moveaxis(corners, 1, 0)
    around = 1 + (a * b).sum(axis=1) + (b * c).sum(axis=1) + (c * a).sum(axis=1)
    return np.asarray(2 * np.arctan2(np.abs((a * np.cross(b, c)).sum(axis=1)), around))


def _unit(vectors: Floats) -> Floats:
    return np.asarray(vectors / np.linalg.norm(vectors, axis=-1, keepdims=True))


def _angle(start: Floats, end: Floats) -> Floats:
    """Angles (...) from one vector (..., 2) anticlockwise to another, -pi to pi."""
    cross = start[..., 0] * end[..., 1] - start[..., 1] * end[..., 0]
    return np.arctan2(cross, (start * end).sum(axis=-1))
