"""A basis of reciprocal BRDFs of brushed surfaces, and what a sphere that has one reflects [R02, eq. 2.38 to 2.44].

In real harmonics y and the tangent frame, x along the circles about an axis and z along the normal,

    rho cos theta_i cos theta_o = sum over l, n, p, q of rho_lnpq y_ln(wi) y_pq(wo)

so that under lighting of coefficients L_ln in that frame B cos theta_o = sum of rho_lnpq L_ln y_pq(wo). Reciprocity,
rho_lnpq = rho_pqln, leaves those of (l, n) before (p, q) as unknowns. In R02's complex harmonics they are those of
`brdfcoefficients.anisotropic_coefficients` with `reciprocal=True`.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from invrender.brdf.form import Axis, brushed_tangents
from invrender.inverse_brdf.reciprocal import harmonic_norms
from invrender.theory.refinement import interval_rule
from recon.harmonics.basis import degree_of, degrees, evaluate_harmonics, orders, sphere_directions
from recon.harmonics.complex import to_complex
from recon.harmonics.rotations import rotated_harmonics

Floats = NDArray[np.float64]
Ints = NDArray[np.int64]
Complexes = NDArray[np.complex128]

# Frames that stand for all those of a sphere, which darkness below the horizon is taken over.
_FRAMES = 400


@dataclass(frozen=True)
class BrushedBasis:
    """The coefficients up to a degree that reciprocity leaves free: 1, 10, 45, 136, 325 of order 4.

    axis : about which the tangents go.
    """

    order: int
    axis: Axis

    @cached_property
    def pairs(self) -> tuple[Ints, Ints]:
        """Places (k,) of y_ln and of y_pq among the harmonics."""
        first, second = np.triu_indices((self.order + 1) ** 2)
        return first, second

    @property
    def degrees(self) -> tuple[Ints, Ints]:
        """l and p (k,)."""
        first, second = self.pairs
        l = degrees(self.order)
        return l[first], l[second]

    @property
    def bounds(self) -> Floats:
        """The largest |rho_lnpq| (k,) of any surface that reflects no more than it receives; see `energy_bounds`."""
        l, n = degrees(self.order), np.abs(orders(self.order))
        norm = harmonic_norms(self.order)[n, l]
        first, second = self.pairs
        return np.asarray(norm[first] * norm[second])

    def rows(self, light: Floats, normals: Floats, views: Floats) -> Floats:
        """Rows (n, k, c) that yield B cos theta_o at unit normals towards unit views (n, 3), both in the world.

        light : coefficients ((l_max + 1)^2, c) of the lighting in the world, of the order's degree.
        """
        frames = self._frames(normals)
        local = _turned(light, frames)
        exitant = evaluate_harmonics(np.einsum("nji,nj->ni", frames, views), self.order)[:, :, None]
        first, second = self.pairs
        result = local[:, first] * exitant[:, second]
        mixed = first != second
        result[:, mixed] += local[:, second[mixed]] * exitant[:, first[mixed]]
        return np.asarray(result)

    def below_horizon(self, lights: Sequence[Floats], weights: Sequence[float]) -> Floats:
        """Gram matrix (c, k, k) of the rows over views from below, the mean over frames all over a sphere.

        As `reciprocal.below_horizon`. lights : of photographs, of the order's degree, each with a weight.
        """
        normals = sphere_directions(_FRAMES)
        frames = self._frames(normals)
        size = (self.order + 1) ** 2
        met = np.zeros((lights[0].shape[1], size, size))
        for light, weight in zip(lights, weights, strict=True):
            local = _turned(light, frames)
            met += weight * np.einsum("nac,nbc->cab", local, local) / len(normals)
        cos, share = interval_rule(self.order + 1, -1.0, 0.0)
        azimuth = np.arange(4 * self.order + 4) * np.pi / (2 * self.order + 2)
        level = np.sqrt(1 - cos**2)[:, None]
        down = np.stack(
            np.broadcast_arrays(level * np.cos(azimuth), level * np.sin(azimuth), cos[:, None]), axis=-1
        )
        seen = evaluate_harmonics(down.reshape(-1, 3), self.order)
        shown = seen.T @ (seen * np.repeat(share / len(azimuth), len(azimuth))[:, None])
        first, second = self.pairs
        twice = (first != second).astype(float)
        gram = np.zeros((len(met), len(first), len(first)))
        for one, other, counts in ((first, second, np.ones(len(first))), (second, first, twice)):
            for its_one, its_other, its in ((first, second, np.ones(len(first))), (second, first, twice)):
                both = counts[:, None] * its * shown[np.ix_(other, its_other)]
                gram += met[:, one[:, None], its_one] * both
        return gram

    def whole(self, values: Floats) -> Floats:
        """rho_lnpq ((order + 1)^2, (order + 1)^2), symmetric, of the unknowns (k,)."""
        first, second = self.pairs
        size = (self.order + 1) ** 2
        result = np.zeros((size, size))
        result[first, second] = result[second, first] = values
        return result

    def complex_coefficients(self, values: Floats) -> Complexes:
        """rho~_ln,pq in R02's complex harmonics [eq. 2.38, times cos theta_o], of the unknowns (k,)."""
        turn = to_complex(np.eye((self.order + 1) ** 2)).conj()
        return np.asarray(turn @ self.whole(values) @ turn.conj().T)

    def _frames(self, normals: Floats) -> Floats:
        """Rotations (n, 3, 3) from tangent frames to the world."""
        tangents = brushed_tangents(normals, self.axis)
        return np.stack([tangents, np.cross(normals, tangents), normals], axis=-1)


def _turned(light: Floats, frames: Floats) -> Floats:
    """Coefficients (n, (l_max + 1)^2, c) of lighting in frames (n, 3, 3)."""
    assert degree_of(len(light)) >= 0
    turned = rotated_harmonics(light.T[:, None], np.swapaxes(frames, 1, 2))
    return np.asarray(turned.transpose(1, 2, 0))
