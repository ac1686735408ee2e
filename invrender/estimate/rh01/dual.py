"""The light that shares and mu imply: a map, and coefficients for the diffuse part [RH01, section 6.2, fig. 8].

The coefficients give the diffuse part, what is left is looked up in the mirror direction, and the map that comes of it
must have those coefficients. All is linear in them, so that the condition is a system of linear equations.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from numpy.typing import NDArray
from scipy.interpolate import BarycentricInterpolator

from capture.lighting import latlong_directions, latlong_solid_angles
from invrender.estimate.rh01.samples import Samples
from invrender.estimate.rh01.simplex import mu_nodes
from recon.harmonics.basis import clamped_cosine_transfer, degrees, evaluate_harmonics

Floats = NDArray[np.float64]

# Degree of the diffuse part. RH01 stops at 2, which leaves 4.7% of teflon's radiance under a directional source (RMS),
# and Ks and mu are bent to explain it; 6 leaves 1.2%.
DUAL_DEGREE = 6
# Coefficients (p,) that the diffuse part passes on: of odd degrees only the first.
_PASSED = np.flatnonzero(clamped_cosine_transfer(DUAL_DEGREE)[degrees(DUAL_DEGREE)])


@dataclass(frozen=True, eq=False)
class _Mirror:
    """The maps (P, 3 + p) that the radiance and each coefficient of the diffuse part imply at one mu.

    projected : (p, 3 + p), the maps' own coefficients. left : (3 + p, 3 + p), products of what no map explains of
    the judged samples.
    """

    maps: Floats
    projected: Floats
    left: Floats


@dataclass(frozen=True, eq=False)
class DualLighting:
    """Inverse lighting of samples by the dual method."""

    samples: Samples
    fresnel: bool

    def judging(self, judged: NDArray[np.bool_]) -> DualLighting:
        """The same, with the error of the marked samples (n,) only."""
        return replace(self, samples=replace(self.samples, judged=judged))

    def error(self, share: Floats, position: float) -> float:
        """RMS of the judged samples' residuals over that of their radiance, at shares (3,) and log(mu - 1)."""
        count = len(_PASSED)
        both = self._table(position) if self.fresnel else self._fixed
        coefficients = _consistent(share, both[:count])
        mixed = np.vstack([np.eye(3), -(1 - share) * coefficients])
        squares = np.einsum("ac,ab,bc->", mixed, both[count:], mixed)
        return float(np.sqrt(max(squares, 0.0) / self._power))

    def light(self, share: Floats, mu: float | None) -> tuple[Floats, Floats]:
        """Coefficients (k, 3), and the map (H, 2H, 3) that has them."""
        mirror, height = self._mirror(mu), self.samples.height
        passed = _consistent(share, mirror.projected)
        nodes = (mirror.maps[:, :3] - (1 - share) * (mirror.maps[:, 3:] @ passed)) / share
        coefficients = np.zeros(((DUAL_DEGREE + 1) ** 2, 3))
        coefficients[_PASSED] = passed
        return coefficients, np.asarray(nodes.reshape(height, 2 * height, 3))

    def _mirror(self, mu: float | None) -> _Mirror:
        samples = self.samples
        known = np.hstack([samples.radiance, samples.diffuse[:, _PASSED]])
        maps = samples.mirror_map(known, mu)
        left = known - samples.fresnel(mu)[:, None] * (samples.mirrored @ maps)
        left = (samples.root[:, None] * left)[samples.judged]
        return _Mirror(maps, self._projection @ maps, left.T @ left)

    @cached_property
    def _table(self) -> BarycentricInterpolator:
        """Projections and products of `_Mirror` over log(mu - 1): a simplex asks for many."""
        nodes, mus = mu_nodes()
        return BarycentricInterpolator(nodes, np.array([self._numbers(mu) for mu in mus]))

    @cached_property
    def _fixed(self) -> Floats:
        return self._numbers(None)

    def _numbers(self, mu: float | None) -> Floats:
        mirror = self._mirror(mu)
        return np.vstack([mirror.projected, mirror.left])

    @cached_property
    def _projection(self) -> Floats:
        """What yields a map's coefficients, (p, P)."""
        height = self.samples.height
        directions = latlong_directions(height).reshape(-1, 3)
        solid_angles = np.repeat(latlong_solid_angles(height)[:, 0], 2 * height)
        return np.asarray(evaluate_harmonics(directions, DUAL_DEGREE)[:, _PASSED].T * solid_angles)

    @cached_property
    def _power(self) -> float:
        samples = self.samples
        return float(((samples.root[:, None] * samples.radiance)[samples.judged] ** 2).sum())


def _consistent(share: Floats, projected: Floats) -> Floats:
    """The coefficients (p, 3) that their own map confirms."""
    systems = share[:, None, None] * np.eye(len(projected)) + (1 - share[:, None, None]) * projected[:, 3:]
    return np.asarray(np.linalg.solve(systems, projected[:, :3].T[..., None])[..., 0].T)
