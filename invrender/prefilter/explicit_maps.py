"""Reflection maps in the explicit forms of earlier work, made of spherical harmonic ones [R02, section 5.6.2].

Cabral et al. 1999 keep plain maps of twelve viewers, the vertices of an icosahedron, and mix the three around a view.
Kautz and McCool 2000 keep one map per angle between the view and the centre, and drop the azimuth. Both are tables of
what a reflection map is a sum for; what they lose is measured by `python -m benchmarks.papers r02-fig5.8 r02-fig5.9`.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cache
from itertools import combinations

import numpy as np
from numpy.typing import ArrayLike, NDArray

from invrender.prefilter.globalmap import GlobalReflectionMap, interpolated
from invrender.prefilter.reflectionmap import ReflectionMap
from recon.harmonics.basis import check_degree, degree_of, degrees, orders
from recon.harmonics.latlong import theta_factors

Floats = NDArray[np.float64]
Singles = NDArray[np.float32]


@dataclass(frozen=True, eq=False)
class IcosahedralMaps:
    """Cabral's twelve reflection maps, (12, c, H, 2H), of the viewers `icosahedron()`."""

    maps: Singles

    def radiance(self, centres: Floats, views: Floats) -> Floats:
        """Radiance (n, c) at centres R (n, 3) seen from (n, 3), all unit: of the three viewers around the view."""
        weights = _shares(views)
        values = np.stack([interpolated(each, centres) for each in self.maps], axis=1)
        return np.asarray(np.einsum("nk,nkc->nc", weights, values))


@dataclass(frozen=True, eq=False)
class ViewAngleTexture:
    """Kautz and McCool's 3D texture, (T, c, H, 2H), at T equal steps of theta_o' from 0 to pi."""

    maps: Singles

    def radiance(self, centres: Floats, views: Floats) -> Floats:
        """Radiance (n, c) at centres R (n, 3) seen from (n, 3), all unit; linear in the angle between them."""
        angle = np.arccos(np.clip((centres * views).sum(axis=1), -1, 1))
        place = angle / np.pi * (len(self.maps) - 1)
        below = np.minimum(place.astype(int), len(self.maps) - 2)
        values = np.stack([interpolated(each, centres) for each in self.maps])
        pixel = np.arange(len(centres))
        share = (place - below)[:, None]
        return np.asarray((1 - share) * values[below, pixel] + share * values[below + 1, pixel])


def icosahedral_maps(world: GlobalReflectionMap) -> IcosahedralMaps:
    """Cabral's maps of a global reflection map [R02, eq. 5.35 at the vertices of an icosahedron]."""
    return IcosahedralMaps(world.seen_from(icosahedron()))


def view_angle_texture(local: ReflectionMap, count: int) -> ViewAngleTexture:
    """Kautz and McCool's texture of a local reflection map, on `count` angles, 2 or more [R02, eq. 5.25].

    The sum over p of B_p0 Y_p0(theta_o'); R02 takes T ~ 10 P of them. Raises ValueError for fewer than 2.
    """
    check_degree(count - 2, "count - 2")
    p_max = degree_of(len(local.maps))
    axial = local.maps[np.flatnonzero(orders(p_max) == 0)]
    factors = theta_factors(np.cos(np.linspace(0, np.pi, count)), p_max)[
        0, degrees(p_max)[orders(p_max) == 0]
    ]
    return ViewAngleTexture(np.tensordot(factors.T.astype(np.float32), axial, axes=1))


@cache
def icosahedron() -> Floats:
    """The vertices (12, 3) of an icosahedron, unit."""
    golden = (1 + np.sqrt(5)) / 2
    corners = np.array([[0, one, other] for one in (1, -1) for other in (golden, -golden)])
    return np.concatenate([np.roll(corners, turn, axis=1) for turn in range(3)]) / np.hypot(1, golden)


@cache
def _faces() -> tuple[tuple[int, int, int], ...]:
    """The 20 faces: threes of vertices that are neighbours."""
    cosines = icosahedron() @ icosahedron().T
    near = cosines > 0.4
    return tuple(
        (a, b, c) for a, b, c in combinations(range(12), 3) if near[a, b] and near[b, c] and near[a, c]
    )


def _shares(views: ArrayLike) -> Floats:
    """How much each vertex counts for views (n, 3), (n, 12): of the face that the view goes through, sum 1."""
    views = np.asarray(views, float)
    inverses = np.linalg.inv(icosahedron()[np.array(_faces())])
    inside = np.einsum("nk,fkj->nfj", views, inverses)
    face = inside.min(axis=2).argmax(axis=1)
    own = np.maximum(inside[np.arange(len(views)), face], 0)
    result = np.zeros((len(views), 12))
    np.put_along_axis(result, np.array(_faces())[face], own / own.sum(axis=1, keepdims=True), axis=1)
    return result
