"""The normal equations of harmonic BRDF coefficients, added up photograph by photograph, and their solution.

Samples count alike in B cos theta_o, whatever their noise; that is in the errors.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from invrender.estimate.clusters import tile_of
from invrender.inverse_brdf.brushed_harmonics import BrushedBasis
from invrender.inverse_brdf.reciprocal import IsotropicBasis
from recon.harmonics.basis import finite
from recon.sampling.lightfield import LightField

Floats = NDArray[np.float64]
Bools = NDArray[np.bool_]
Basis = IsotropicBasis | BrushedBasis

# Noise never passes for less than this share of the radiance: renderings have none.
_LEAST_NOISE = 1e-4
_NOISE_STEPS = 4
_TINY = 1e-300
# Rows of many unknowns are large.
_SAMPLES_AT_A_TIME = 2048


class ReflectanceEquations(NamedTuple):
    """Weighted normal equations of k unknowns per channel: data (3, k, k), right (3, k), energy (3,) of the samples.

    dark : (3, k, k), what darkness below the horizon adds. trust : sum of the weights. samples : how many.
    """

    data: Floats
    dark: Floats
    right: Floats
    energy: Floats
    bounds: Floats
    trust: float
    samples: int

    @property
    def matrix(self) -> Floats:
        return self.data + self.dark

    @property
    def freedom(self) -> float:
        return self.samples / (self.samples - len(self.bounds))

    def of(self, kept: Bools) -> ReflectanceEquations:
        """Those of some unknowns alone, the others being 0."""
        block = np.ix_(np.arange(3), kept, kept)
        return self._replace(
            data=self.data[block], dark=self.dark[block], right=self.right[:, kept], bounds=self.bounds[kept]
        )


class LeastSquaresSolution(NamedTuple):
    """solution : (3, k). inverse : (3, k, k), of the equations over the noise, with bounds. noise2 : (3,)."""

    solution: Floats
    inverse: Floats
    noise2: Floats


def harmonic_equations(
    fields: Sequence[LightField], lights: Sequence[Floats], basis: Basis
) -> ReflectanceEquations:
    """The equations of photographs' samples, each under lighting of coefficients ((order + 1)^2, 3).

    Raises ValueError if no sample has any weight.
    """
    size = len(basis.bounds)
    data = np.zeros((3, size, size))
    right, energy, trust = np.zeros((3, size)), np.zeros(3), 0.0
    for part in _observed(fields, lights, basis):
        weighted = part.rows * part.weight[:, None, None]
        data += weighted.transpose(2, 1, 0) @ part.rows.transpose(2, 0, 1)
        right += np.einsum("nkc,nc->ck", weighted, part.values)
        energy += part.weight @ part.values**2
        trust += float(part.weight.sum())
    if not trust > 0:
        raise ValueError("no sample has any weight: all lie at grazing angles or at edges")
    # The upper hemisphere's samples weigh so much together; as much the lower one's darkness.
    dark = basis.below_horizon(lights, [float(field.weight.sum()) for field in fields])
    samples = sum(len(field) for field in fields)
    return ReflectanceEquations(data, dark, right, energy, basis.bounds, trust, samples)


def solve(equations: ReflectanceEquations) -> LeastSquaresSolution:
    """Least squares within the bounds, whose weight depends on the noise, which is what the fit leaves."""
    shrinking = np.diag(equations.bounds**-2)
    mean = np.asarray(np.maximum(equations.energy / equations.trust, _TINY), float)
    noise2 = mean
    for _ in range(_NOISE_STEPS):
        inverse = np.linalg.inv(equations.matrix / noise2[:, None, None] + shrinking)
        solution = np.einsum("ckj,cj->ck", inverse, equations.right) / noise2[:, None]
        fitted = 2 * solution * equations.right - solution * np.einsum("ckj,cj->ck", equations.data, solution)
        left = equations.freedom * (equations.energy - fitted.sum(axis=1)) / equations.trust
        noise2 = np.asarray(np.maximum(left, _LEAST_NOISE**2 * mean))
    inverse = np.linalg.inv(equations.matrix / noise2[:, None, None] + shrinking)
    solution = np.einsum("ckj,cj->ck", inverse, equations.right) / noise2[:, None]
    return LeastSquaresSolution(solution, inverse, noise2)


def scatter_of(
    fields: Sequence[LightField], lights: Sequence[Floats], basis: Basis, solution: Floats
) -> tuple[tuple[Floats, Floats], float]:
    """Covariances (3, k, k) of the normal equations' right-hand side, and the relative RMS residual of radiance.

    The first takes residuals as independent, the second those of a tile as one.
    """
    independent, by_tile = np.zeros((2, 3, solution.shape[1], solution.shape[1]))
    square, energy = 0.0, 0.0
    for part in _observed(fields, lights, basis):
        residual = part.values - np.einsum("nkc,ck->nc", part.rows, solution)
        per_cos = part.weight / part.cos_exitant**2
        square += float(np.sum(per_cos @ residual**2))
        energy += float(np.sum(per_cos @ part.values**2))
        pull = (part.rows * (part.weight[:, None] * residual)[:, None, :]).transpose(2, 0, 1)
        independent += pull.transpose(0, 2, 1) @ pull
        starts = np.flatnonzero(np.diff(part.tile, prepend=-1))
        together = np.add.reduceat(pull, starts, axis=1)
        by_tile += together.transpose(0, 2, 1) @ together
    return (independent, by_tile), float(np.sqrt(square / max(energy, _TINY)))


class _Part(NamedTuple):
    """Some samples of a photograph: rows (n, k, 3) and values (n, 3) of B cos theta_o, ordered by their tile."""

    rows: Floats
    values: Floats
    weight: Floats
    cos_exitant: Floats
    tile: NDArray[np.int64]


def _observed(fields: Sequence[LightField], lights: Sequence[Floats], basis: Basis) -> Iterator[_Part]:
    for field, light in zip(fields, lights, strict=True):
        if not len(field):
            continue
        tile = tile_of(field)
        order = np.argsort(tile, kind="stable")
        for places in np.array_split(order, len(order) // _SAMPLES_AT_A_TIME + 1):
            kept = np.zeros(len(field), bool)
            kept[places] = True
            part = field.where(kept)
            cos = (part.normals * part.views).sum(axis=1)
            # A pixel is a mean of radiance, which 1 / cos theta_o bends at grazing angles.
            per_ray = basis.rows(light, part.normals, part.views) / cos[:, None, None]
            mean_cos = part.cos_exitant
            found = part.mean_over_rays(per_ray) * mean_cos[:, None, None]
            values = finite(part.radiance, "radiance") * mean_cos[:, None]
            by_tile = np.argsort(tile[kept], kind="stable")
            yield _Part(
                np.asarray(found)[by_tile],
                values[by_tile],
                part.weight[by_tile],
                mean_cos[by_tile],
                tile[kept][by_tile],
            )
