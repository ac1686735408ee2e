"""The half-vector integral: a lat-long map seen through the specular lobe.

A source at wi(h) = 2 (wo.h) h - wo is reflected to the viewer by facets of normal h, so that the specular
part of the reflected light field, per unit of Ks F, is [RH01, eq. 22 before the lobe is taken for symmetric]

    integral S(theta_h) L(wi(h)) (wo.h) / cos theta_o  dh     over  n.wi > 0, wo.h > 0.

Rings of constant theta_h around the normal make the lobe S a weight per ring, so that all roughnesses
share one walk through the map.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import cv2
import numpy as np
from numpy.typing import NDArray

from capture.lighting import latlong_pixels, latlong_solid_angles, padded_latlong
from capture.parallel import parallel_map
from invrender.theory.specialcases import lobe

Floats = NDArray[np.float64]
Singles = NDArray[np.float32]

# Where rings begin, radians; in maps whose pixels are finer than twice that so much farther in, in the logarithm.
_FIRST_RING, _INNER = 0.004, 1.1
# Places and weights of an integral over the disc within the first ring, in parts of its area.
_WITHIN = tuple(part / 2 for part in np.polynomial.legendre.leggauss(6))
_RAYS_PER_CHUNK = 1024
PAD = 2
# Turns one ring against the next so that azimuths never line up.
_GOLDEN_ANGLE = np.pi * (3 - np.sqrt(5))
# Turn of a normal, radians, over which what a smooth map reflects is nearly linear.
_EVEN = 0.06
# Weight of a ring, relative to the heaviest, below which it is left out.
_NEGLIGIBLE = 1e-6


@dataclass(frozen=True)
class _Fineness:
    """How densely half-vectors are sampled.

    log_step : rings grow by this factor (its logarithm). The trapezoid rule in log theta converges
        exponentially for a Gaussian lobe, and 0.22 leaves 1e-6 of it; the rest is for the map's structure.
    azimuths : (theta, nodes) pairs: nodes on rings up to theta radians.
    """

    log_step: float
    azimuths: tuple[tuple[float, int], ...]

    @property
    def finer(self) -> _Fineness:
        """Of about half the error: 0.2 to 0.6% of Grace cathedral (RMS) where the rough one leaves 0.7 to 1.6%."""
        azimuths = tuple((theta, round(1.5 * count)) for theta, count in self.azimuths)
        return _Fineness(0.7 * self.log_step, azimuths)

    def nodes(self, theta: float) -> int:
        return next(count for limit, count in self.azimuths if theta < limit)


# For maps that vary slowly, and for those with lamps and windows: 0.3% and, of Grace cathedral, 0.4% (RMS,
# sigma = 0.12). The second takes 2.5 times as long.
_SMOOTH = _Fineness(0.22, ((0.03, 6), (0.1, 12), (np.inf, 20)))
_ROUGH = _Fineness(0.10, ((0.03, 8), (0.06, 16), (0.12, 32), (np.inf, 48)))
# Share of a map (RMS) that averaging over four by four pixels may take away, for it to count as smooth.
_SMOOTH_SHARE = 0.1


@dataclass(frozen=True, eq=False)
class PreparedMap:
    """A lat-long map made ready for `map_transfer`, once for all photographs under it.

    levels : the map and, unless it is smooth, its halves; (h, w, c) each, padded around.
    """

    levels: tuple[Singles, ...]
    fineness: _Fineness

    @classmethod
    def of(cls, radiance_map: Singles) -> PreparedMap:
        """Prepare a map (H, 2H, c)."""
        levels = _pyramid(radiance_map)
        if _is_rough(levels):
            return cls(tuple(padded_latlong(level.astype(np.float32), PAD) for level in levels), _ROUGH)
        return cls((padded_latlong(radiance_map.astype(np.float32), PAD),), _SMOOTH)

    @property
    def even(self) -> float:
        """How far a normal may turn, radians, for the mean of what is reflected to be what the mean normal reflects.

        In a smooth map the mean of all samples is off by 1e-5, one in a thousand by 0.2%. In others it is half a pixel,
        since the mirrored view turns twice as far.
        """
        pixel = np.pi / (self.levels[0].shape[0] - 2 * PAD)
        return _EVEN if len(self.levels) == 1 else min(_EVEN, pixel / 2)

    def with_rings(self, share: float) -> PreparedMap:
        """The same, in whose integrals rings lie a share as far apart, in the logarithm."""
        fineness = replace(self.fineness, log_step=share * self.fineness.log_step)
        return replace(self, fineness=fineness)

    @property
    def finer(self) -> PreparedMap:
        """The same, with more half-vectors."""
        return replace(self, fineness=self.fineness.finer)

    def seen(self, directions: Singles, spacing: float) -> Singles:
        """Radiance (m, p, c) from unit directions (m, p, 3) that lie about `spacing` radians apart."""
        level = _level(self.levels, spacing)
        row, column = latlong_pixels(directions, level.shape[0] - 2 * PAD)
        # OpenCV counts pixel centres at integers, so ours, at + 0.5, lie half a pixel back.
        shift = np.float32(PAD - 0.5)
        values: Singles = cv2.remap(level, column + shift, row + shift, cv2.INTER_CUBIC).astype(
            np.float32, copy=False
        )
        return values.reshape(*directions.shape[:2], -1)


def map_transfer(light: PreparedMap, normals: Floats, views: Floats, sigmas: Floats) -> Floats:
    """The half-vector integral over a lat-long map of c channels: (m, sigmas, c) per unit of Ks F.

    normals, views : (m, 3) unit. Each chunk of rays shifts and turns the rings at random (fixed seed), and in
    a map that isn't smooth each ring looks at a level as coarse as its nodes are apart, so that structure
    finer than the rings averages out instead of biasing all samples alike.
    """

    def of_chunk(chunk: Chunk) -> Floats:
        weights = ring_weights(lobe, chunk.thetas, sigmas, light.fineness.log_step)
        used = np.flatnonzero(weights.max(axis=1) > _NEGLIGIBLE * weights.max())
        frame = RayFrames.of(normals[chunk.rays], views[chunk.rays])
        means = [_ring_mean(frame, facet_ring(light, frame, chunk.thetas[k], chunk.turns[k])) for k in used]
        return np.einsum("mck,kj->mjc", np.stack(means, axis=-1), weights[used])

    result = np.empty((len(normals), len(sigmas), light.levels[0].shape[2]))
    fill(result, light, of_chunk)
    return result


@dataclass(frozen=True, eq=False)
class Chunk:
    """Some of the rays, and the half-vectors that they take.

    thetas, turns : (k,) rings' angles, and azimuths to start at, radians.
    """

    rays: slice
    thetas: Floats
    turns: Floats


def fill(
    result: NDArray[np.floating], light: PreparedMap, of_chunk: Callable[[Chunk], NDArray[np.floating]]
) -> None:
    """Enter what a function finds for each chunk of the rays under a map, over all cores; result : (m, ...)."""
    chunks = _chunks(light, len(result))
    for chunk, found in zip(chunks, parallel_map(of_chunk, chunks), strict=True):
        result[chunk.rays] = found


def _chunks(light: PreparedMap, count: int) -> list[Chunk]:
    """So many rays in chunks."""
    rng = np.random.default_rng(0)
    log_step = light.fineness.log_step
    fine = np.pi / (light.levels[0].shape[0] - 2 * PAD) < 2 * _FIRST_RING
    last = int(np.ceil(np.log(np.pi / 2 / _FIRST_RING) / log_step))
    place = np.arange(-round(_INNER / log_step) if fine else 0, last)
    found = []
    for start in range(0, count, _RAYS_PER_CHUNK):
        shift, turn = rng.random(2)
        thetas = _FIRST_RING * np.exp(log_step * (shift + place))
        turns = 2 * np.pi * turn + _GOLDEN_ANGLE * place
        found.append(Chunk(slice(start, start + _RAYS_PER_CHUNK), thetas, turns))
    return found


def _ring_mean(frame: RayFrames, ring: Ring) -> Singles:
    """Mean (m, c) over azimuth of L(wi(h)) (wo.h) / cos theta_o."""
    weight = ring.lit * np.maximum(ring.toward, 0) / np.maximum(frame.along_normal[:, None], np.float32(1e-6))
    return np.einsum("mp,mpc->mc", weight, ring.radiance) / np.float32(weight.shape[1])


def ring_weights(
    density: Callable[[Floats, Floats], Floats], rings: Floats, sigmas: Floats, log_step: float
) -> Floats:
    """Weights (rings, sigmas) with which ring means add up to the integral of a density over the hemisphere.

    density : of angle and roughness, 1/sr.
    """
    # What of the last ring's cell lies beyond the hemisphere doesn't count: tails of long-tailed densities end there.
    cell = np.clip(np.log(np.pi / 2 / rings) + log_step / 2, 0, log_step)
    inside = np.minimum(rings, np.pi / 2)
    weights = 2 * np.pi * density(inside[:, None], sigmas) * (np.sin(inside) * inside * cell)[:, None]
    # The disc within the first ring, where the map is constant to the eye of the quadrature; lobes may be narrower.
    inner, (places, shares) = rings[0] * np.exp(-log_step / 2), _WITHIN
    within = density(inner * np.sqrt(0.5 + places)[:, None], sigmas)
    weights[0] += np.pi * inner**2 * (shares @ within)
    return weights


@dataclass(frozen=True, eq=False)
class RayFrames:
    """Local frames of a chunk of rays, (m, 3) each, and the view in them, (m,) each; float32."""

    tangent: Singles
    bitangent: Singles
    normal: Singles
    view: Singles
    along_tangent: Singles
    along_bitangent: Singles
    along_normal: Singles

    @classmethod
    def of(cls, normals: Floats, views: Floats, tangent: Floats | None = None) -> RayFrames:
        """Frames with given tangents (m, 3), or arbitrary but fixed ones."""
        if tangent is None:
            helper = np.where(np.abs(normals[:, 2:]) < 0.9, [[0.0, 0.0, 1.0]], [[1.0, 0.0, 0.0]])
            tangent = np.cross(helper, normals)
            tangent /= np.linalg.norm(tangent, axis=1, keepdims=True)
        axes = (tangent, np.cross(normals, tangent), normals)
        along = [(axis * views).sum(axis=1) for axis in axes]
        return cls(*(part.astype(np.float32) for part in (*axes, views, *along)))

    @cached_property
    def axes(self) -> Singles:
        """Tangents, bitangents and normals (3, m, 3), component by component: these come first, the axes last."""
        return np.stack([self.tangent, self.bitangent, self.normal], axis=-1).transpose(1, 0, 2).copy()

    @cached_property
    def level(self) -> Singles:
        """The view along tangent and bitangent, (m, 2)."""
        return np.stack([self.along_tangent, self.along_bitangent], axis=-1)


@dataclass(frozen=True, eq=False)
class Ring:
    """What the nodes of a ring of half-vectors meet, (m, p) each; float32.

    toward : cosine of half-vector to view, theta_d's. lit : the share of a node's cell that is above the horizon.
    cos_incident : of the light, its mean over that share. radiance : (m, p, c) that arrives there.
    """

    toward: Singles
    cos_incident: Singles
    lit: Singles
    radiance: Singles


def facet_ring(light: PreparedMap, frame: RayFrames, theta: float, turn: float) -> Ring:
    """The ring theta_h = theta, its azimuths turned by an angle."""
    count, log_step = light.fineness.nodes(theta), light.fineness.log_step
    azimuth = turn + 2 * np.pi * np.arange(count) / count
    unit_x, unit_y = np.array([np.cos(azimuth), np.sin(azimuth)], np.float32)
    z = np.float32(np.cos(theta))
    x, y = np.float32(np.sin(theta)) * unit_x, np.float32(np.sin(theta)) * unit_y
    cos_exitant = frame.along_normal[:, None]
    level = frame.level @ np.stack([unit_x, unit_y])
    toward = np.float32(np.sin(theta)) * level + cos_exitant * z
    # n.wi is sin(2 theta) level + cos(2 theta) cos(theta_o). Where the horizon crosses a node's cell, the node
    # counts by the share that is lit: all or nothing converges slowly (1% of a wide lobe against 0.2%).
    sin_twice, cos_twice = np.float32(np.sin(2 * theta)), np.float32(np.cos(2 * theta))
    sideways = frame.level @ np.stack([-unit_y, unit_x])
    around = np.float32(2 * np.pi / count) * sin_twice * sideways
    outward = np.float32(2 * log_step * theta) * (cos_twice * level - sin_twice * cos_exitant)
    # Four times as fast as np.hypot, whose care for huge numbers isn't needed.
    cell = np.sqrt(around * around + outward * outward) + np.float32(1e-9)
    cos_incident = sin_twice * level + cos_twice * cos_exitant
    lit = np.clip(cos_incident / cell + np.float32(0.5), 0, 1)
    cos_incident = np.maximum(cos_incident, lit * cell / 2)
    half_vectors = np.stack([x, y, np.full_like(x, z)])
    incident = frame.axes @ half_vectors
    incident *= 2 * toward
    incident -= frame.view.T[:, :, None]
    # Incident directions move by twice the half-vector's angle.
    spacing = 2 * min(log_step * theta, 2 * np.pi * np.sin(theta) / count)
    radiance = light.seen(np.moveaxis(incident, 0, -1), spacing)
    return Ring(toward, cos_incident, lit, radiance)


def mirror_ring(light: PreparedMap, frame: RayFrames, angle: float, turn: float) -> Singles:
    """Mean (m, c) of L(wi) (n.wi) over the ring of directions wi at an angle from the frames' axes.

    frame : around the mirrored views, n taking the view's place.
    """
    # As many nodes as a ring of half-vectors of half the angle.
    count = light.fineness.nodes(angle / 2)
    azimuth = turn + 2 * np.pi * np.arange(count) / count
    sin, cos = np.float32(np.sin(angle)), np.float32(np.cos(angle))
    x, y = (sin * np.array([np.cos(azimuth), np.sin(azimuth)])).astype(np.float32)
    incident = np.stack(
        [
            frame.tangent[:, k, None] * x + frame.bitangent[:, k, None] * y + frame.normal[:, k, None] * cos
            for k in range(3)
        ],
        axis=-1,
    )
    cosine = frame.along_tangent[:, None] * x + frame.along_bitangent[:, None] * y
    cosine = np.maximum(cosine + frame.along_normal[:, None] * cos, 0)
    radiance = light.seen(incident, min(light.fineness.log_step * angle, 2 * np.pi * float(sin) / count))
    return np.einsum("mp,mpc->mc", cosine, radiance) / np.float32(count)


def _level(levels: Sequence[Singles], spacing: float) -> Singles:
    """The coarsest map whose pixels are no larger than a spacing in radians; the finest if none is."""
    fitting = [level for level in levels if np.pi / (level.shape[0] - 2 * PAD) <= spacing]
    return fitting[-1] if fitting else levels[0]


def _pyramid(radiance_map: Singles) -> list[Singles]:
    """The map and its halves, each pixel the mean over what it covers, by solid angle; of any height."""
    levels = [radiance_map]
    while (height := levels[-1].shape[0]) > 8:
        weights = np.broadcast_to(latlong_solid_angles(height)[:, :, None], levels[-1].shape)
        half = (2 * (height // 2), height // 2)
        flux, total = (
            cv2.resize(part.astype(np.float64), half, interpolation=cv2.INTER_AREA)
            for part in (levels[-1] * weights, weights)
        )
        levels.append((flux / total).reshape(half[1], half[0], -1).astype(np.float32))
    return levels


def is_rough(radiance_map: Singles) -> bool:
    """Whether a lat-long map (H, 2H, c) has structure as fine as its pixels: lamps, windows and their edges."""
    return _is_rough(_pyramid(radiance_map))


def _is_rough(levels: Sequence[Singles]) -> bool:
    """Whether averaging over four by four pixels takes a notable part of the map away."""
    if len(levels) < 3:
        return True
    fine, coarse = levels[0], levels[2]
    weights = latlong_solid_angles(fine.shape[0])[:, :, None]
    # What a mean hides: the mean square within the blocks less the square of their means, per solid angle.
    energy = float((fine.astype(float) ** 2 * weights).sum())
    kept = float((coarse.astype(float) ** 2 * latlong_solid_angles(coarse.shape[0])[:, :, None]).sum())
    return energy > 0 and (energy - kept) / energy > _SMOOTH_SHARE**2
