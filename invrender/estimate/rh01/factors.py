"""Light and BRDF, both unknown [RH01, section 6.3]: a simplex over Ks and mu; the light solved linearly within.

The light is the dual one of section 6.2, as for the paper's spheres: nine coefficients give the diffuse part, what is
left is looked up in the mirror direction, and the map that comes of it must have those nine coefficients. It is the
light as the lobe blurs it. sigma follows from the source's peak in it [eq. 26].
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray
from scipy.interpolate import BarycentricInterpolator
from scipy.sparse import csr_array, vstack
from scipy.sparse.linalg import splu

from capture.lighting import latlong_directions, latlong_solid_angles
from invrender.brdf.fresnel import normalised_fresnel
from invrender.estimate.rh01.nodes import bilinear, laplacian
from invrender.estimate.rh01.roughness import Peak, find_peak, without_source
from invrender.estimate.rh01.simplex import MU_BOUNDS, root_weight, simplex
from invrender.estimate.unknown_light.start import Region
from invrender.theory.operator import irradiance_operator
from recon.harmonics.basis import evaluate_harmonics
from recon.harmonics.latlong import map_coefficients
from recon.sampling.lightfield import LightField

Floats = NDArray[np.float64]

_NINE, _L_MAX = 9, 2
# Degrees of the light less its source, which is slow.
_SLOW_DEGREE = 12
_SHARES = (0.005, 0.995)
_START_SHARE, _START_MU = 0.3, 1.5
# Rows of the map: so that about eight samples meet at each node, within what shows a lobe of 0.1 rad.
_SAMPLES_PER_NODE, _HEIGHTS = 8, (24, 64)
# Of a node's own equation: by which it follows its neighbours where no reflection reaches it.
_SMOOTH = 1e-4
# Places of log(mu - 1) between which the search interpolates.
_MUS = 12


@dataclass(frozen=True, eq=False)
class PublishedFactors:
    """What section 6.3 finds, in the gauge Kd + Ks = 1.

    share : (3,) Ks. mu : None where no Fresnel factor was fitted. light : (H, 2H, 3), lat-long, as the lobe blurs it,
    the source included; noise and ringing leave it negative here and there. nine : (9, 3), its first coefficients.
    peak : the source, with sigma in radians; None where the light has no peak. rms : relative, of the residuals.
    """

    share: Floats
    mu: float | None
    light: Floats
    nine: Floats
    peak: Peak | None
    rms: float

    @property
    def sigma(self) -> float | None:
        return None if self.peak is None else self.peak.sigma

    def slow_and_source(self) -> tuple[Floats, Floats, Floats]:
        """The light as slow coefficients (169, 3), up to degree 12, sources' directions (k, 3) and irradiances (k, 3).

        The blurred source is taken off the light and put back sharp; k is 1, or 0 without.
        """
        if self.peak is None:
            return map_coefficients(self.light, _SLOW_DEGREE), np.zeros((0, 3)), np.zeros((0, 3))
        slow, irradiance = without_source(self.light, self.peak)
        return map_coefficients(slow, _SLOW_DEGREE), self.peak.direction[None], irradiance[None]

    def radiance(self, field: LightField) -> Floats:
        """Radiance (n, 3) of a photograph's samples, as predicted."""
        seen = _Seen.of(field, len(self.light))
        highlight = seen.fresnel(self.mu)[:, None] * (seen.mirrored @ self.light.reshape(-1, 3))
        return np.asarray((1 - self.share) * (seen.diffuse @ self.nine) + self.share * highlight)


def published_factors(
    photos: Sequence[LightField],
    fresnel: bool = True,
    region: Region | None = None,
) -> PublishedFactors:
    """Light and BRDF of a convex body, both unknown, by the nested procedure of [RH01, section 6.3].

    fresnel : False leaves mu out, as the paper does for metals. region : around the source, which the paper marks by
    hand; None takes the sharpest peak of the recovered light, as far out as it gets darker. Raises ValueError for too
    few samples.
    """
    samples = sum(len(photo) for photo in photos)
    low, high = _HEIGHTS
    if samples < 2 * low**2:
        raise ValueError(
            f"there are {samples} samples; RH01's procedure fills a map of light from them, which takes"
            f" {2 * low**2} at least"
        )
    height = int(np.clip(np.sqrt(samples / (2 * _SAMPLES_PER_NODE)), low, high))
    problem = _Problem.of([_Seen.of(photo, height) for photo in photos], photos, height, fresnel)
    start = np.array([_START_SHARE] * 3 + [np.log(_START_MU - 1)] * fresnel)
    best = simplex(problem.trial, start, np.array([_SHARES] * 3 + [MU_BOUNDS] * fresnel))
    solved, light = problem.solution(best)
    mu = _mu(best[3]) if fresnel else None
    return PublishedFactors(best[:3], mu, light, solved.nine, find_peak(light, region), solved.rms)


def _mu(position: float) -> float:
    return 1 + float(np.exp(position))


@dataclass(frozen=True, eq=False)
class _Seen:
    """Samples of a photograph: rows over the nine coefficients (n, 9) and over the map's nodes (n, P), sparse."""

    field: LightField
    diffuse: Floats
    mirrored: csr_array

    @staticmethod
    def of(field: LightField, height: int) -> _Seen:
        diffuse = field.mean_over_rays(irradiance_operator(field.normals, _L_MAX))
        cos = np.einsum("nk,nk->n", field.normals, field.views)[:, None]
        nodes, weights = bilinear(2 * cos * field.normals - field.views, height)
        counts = np.bincount(field.ray_sample, minlength=len(field))
        mean = csr_array(
            (1 / counts[field.ray_sample], (field.ray_sample, np.arange(len(cos)))),
            shape=(len(field), len(cos)),
        )
        rays = np.repeat(np.arange(len(cos)), 4)
        lookup = csr_array((weights.ravel(), (rays, nodes.ravel())), shape=(len(cos), 2 * height**2))
        return _Seen(field, np.asarray(diffuse, float), mean @ lookup)

    def fresnel(self, mu: float | None) -> Floats:
        """Fresnel's factor (n,), mean over rays."""
        cos = np.einsum("nk,nk->n", self.field.normals, self.field.views)
        return np.asarray(self.field.mean_over_rays(normalised_fresnel(mu, cos)))


@dataclass(frozen=True, eq=False)
class _Solved:
    nine: Floats
    rms: float


@dataclass(frozen=True, eq=False)
class _Mirror:
    """The maps (P, 3 + 9) that the radiance and each diffuse coefficient imply at one mu.

    projected : (9, 12), the maps' first coefficients. left : (12, 12), products of what no map explains of both.
    """

    maps: Floats
    projected: Floats
    left: Floats


@dataclass(frozen=True, eq=False)
class _Problem:
    """The samples of all photographs.

    root : (n,), of their weights; radiance (n, 3) and diffuse (n, 9) are multiplied by it. projection : (9, P), a map's
    first coefficients. smooth : (P, P), what holds nodes together.
    """

    seen: tuple[_Seen, ...]
    root: Floats
    radiance: Floats
    diffuse: Floats
    mirrored: csr_array
    projection: Floats
    smooth: csr_array
    fresnel: bool

    @staticmethod
    def of(seen: Sequence[_Seen], photos: Sequence[LightField], height: int, fresnel: bool) -> _Problem:
        root = np.concatenate([root_weight(photo) for photo in photos])
        directions = latlong_directions(height).reshape(-1, 3)
        solid_angles = np.repeat(latlong_solid_angles(height)[:, 0], 2 * height)
        return _Problem(
            tuple(seen),
            root,
            root[:, None] * np.concatenate([photo.radiance for photo in photos]),
            root[:, None] * np.concatenate([one.diffuse for one in seen]),
            csr_array(vstack([one.mirrored for one in seen])),
            evaluate_harmonics(directions, _L_MAX).T * solid_angles,
            laplacian(height),
            fresnel,
        )

    def mirror(self, mu: float | None) -> _Mirror:
        """What holds at one mu."""
        factor = self.root * np.concatenate([one.fresnel(mu) for one in self.seen])
        rows = csr_array(self.mirrored.multiply(factor[:, None]))
        gram = rows.T @ rows
        mean = gram.trace() / gram.shape[0]
        known = np.hstack([self.radiance, self.diffuse])
        maps = splu((gram + _SMOOTH * mean * self.smooth).tocsc()).solve(rows.T @ known)
        left = known - rows @ maps
        return _Mirror(maps, self.projection @ maps, left.T @ left)

    @cached_property
    def _table(self) -> BarycentricInterpolator:
        """Projections (9, 12) and squares (12, 12) of `mirror` over log(mu - 1): a simplex asks for many."""
        low, high = MU_BOUNDS
        nodes = (low + high) / 2 + (high - low) / 2 * np.cos(np.pi * (np.arange(_MUS) + 0.5) / _MUS)
        found = [self.mirror(_mu(node)) for node in nodes]
        return BarycentricInterpolator(
            nodes, np.array([np.vstack([one.projected, one.left]) for one in found])
        )

    def trial(self, point: Floats) -> float:
        """Relative RMS at shares (3,) and, fourth, log(mu - 1) [RH01, ObjFun]."""
        both = self._table(point[3]) if self.fresnel else self._fixed
        return self._solve(point[:3], both[:_NINE], both[_NINE:]).rms

    @cached_property
    def _fixed(self) -> Floats:
        mirror = self.mirror(None)
        return np.vstack([mirror.projected, mirror.left])

    def _solve(self, share: Floats, projected: Floats, left: Floats) -> _Solved:
        """The nine coefficients (9, 3) that their own map confirms."""
        nine, squares = np.empty((_NINE, 3)), 0.0
        for c in range(3):
            system = share[c] * np.eye(_NINE) + (1 - share[c]) * projected[:, 3:]
            nine[:, c] = np.linalg.solve(system, projected[:, c])
            mixed = np.concatenate([np.eye(3)[c], -(1 - share[c]) * nine[:, c]])
            squares += float(mixed @ left @ mixed)
        return _Solved(nine, float(np.sqrt(max(squares, 0.0) / (self.radiance**2).sum())))

    def solution(self, point: Floats) -> tuple[_Solved, Floats]:
        """Coefficients, error, and the map (H, 2H, 3) at a point of the search."""
        share, mirror = point[:3], self.mirror(_mu(point[3]) if self.fresnel else None)
        solved = self._solve(share, mirror.projected, mirror.left)
        nodes = (mirror.maps[:, :3] - (1 - share) * (mirror.maps[:, 3:] @ solved.nine)) / share
        height = int(np.sqrt(len(nodes) / 2))
        return solved, np.asarray(nodes.reshape(height, 2 * height, 3))
