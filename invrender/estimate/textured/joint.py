"""Kd and Ks of all texels at once: a pixel shows the mean over what it covers, edges of the albedo included.

Tiny systems come first: each pixel's say is dealt to the texels by how much it covers of them [RH01, section 6.4]. They
leave the albedo blurred by about a pixel. From there conjugate gradients solve the linear problem in which a pixel is
such a mean, on texels half as wide, with the tiny systems for a preconditioner; the texels given are means over four of
these.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import csr_array

from invrender.estimate.noise import NoiseModel, photo_weights
from invrender.estimate.textured.texel_equations import PointValues, TexelEquations, Usual, determined
from invrender.estimate.textured.texel_grid import Grid
from invrender.estimate.textured.texel_pixels import PixelsOfPoints, tiny_sums

Floats = NDArray[np.float64]
Singles = NDArray[np.float32]
Ints = NDArray[np.int64]

# Neighbouring half-width texels differ by this share of the mean, says the prior: the albedo may have edges.
_STEP = 0.5
# Conjugate gradients end where a step moves values by less than this share of their standard deviations (RMS), before
# the outliers are known and after; or after so many steps.
_FIRST_NEAR, _NEAR, _MOST_STEPS = 0.2, 0.035, 24
# What neighbouring texels differ by counts as error of a texel by this share; steps of Kd for Ks, and of Ks for Kd, by
# this share again (doll: z 1.1 RMS at edges of the albedo).
_UNRESOLVED, _SHARED = 0.2, 0.5
# Times that a mean over a point and its neighbours is taken: over some fifty of them.
_AROUND = 8
# What reaches a point in shadow is known to this share of the brightest light (doll).
_SHADOW = 0.002
# Residuals beyond what noise leaves by this factor, in squares, widen a point's error bars.
_BEYOND_NOISE = 2.0


def solve_apart(
    views: Sequence[PixelsOfPoints],
    grid: Grid,
    tiny: Callable[[TexelEquations], PointValues],
    noise: NoiseModel,
    lit: float,
) -> tuple[PointValues, PointValues]:
    """Kd and Ks of the grid's points, each for itself, about a pixel blurred; before outliers are known, and after.

    Arguments are as of `solve_joint`.
    """
    views = _weighed(views, noise, lit)
    start = tiny(tiny_sums(views, grid.count, grid.parents))
    both = np.concatenate([start.kd, start.ks], axis=1).astype(np.float32)
    at = np.where((grid.parents >= 0)[:, None], both[grid.parents], np.float32(0))
    views = [_trusted(view, at, noise) for view in views]
    return start, tiny(tiny_sums(views, grid.count, grid.parents))


def solve_joint(
    views: Sequence[PixelsOfPoints],
    cover: csr_array,
    grid: Grid,
    tiny: Callable[[TexelEquations], PointValues],
    noise: NoiseModel,
    usual: Usual,
    lit: float,
    rng: np.random.Generator,
) -> PointValues:
    """Kd and Ks of the grid's points with standard deviations, infinite where the photographs leave them open.

    views, cover : as `stacked` has them. tiny : solves the tiny systems under the model; the cost returned is theirs.
    usual : of the whole surface, of which the points may be a part. lit : the diffuse transfer where that is brightest,
    by the lighting itself.
    """
    views = _weighed(views, noise, lit)
    start = tiny(tiny_sums(views, grid.count, grid.parents))
    sure = determined(start, usual.scale)
    if not sure.any():
        return start
    both = np.concatenate([start.kd, start.ks], axis=1)
    if not (start.ks_std[sure] > 0).any():
        views = [_without_lobe(view, start.ks[0]) for view in views]
        both[:, 3:] = 0
    # Texels that the tiny systems hardly determine begin as is usual.
    level = usual.values * both.any(axis=0)
    of_points = np.where(sure[:, None], both, level).astype(np.float32)
    at = np.where((grid.parents >= 0)[:, None], of_points[grid.parents], level.astype(np.float32))
    step = _STEP * np.maximum(level, 0.1 * np.tile(level[:3] + level[3:], 2) + 1e-30)
    prior = _Prior(grid.laplacian, (1 / step**2).astype(np.float32))
    _conjugate(_System(views, cover, prior), at, [view.radiance for view in views], _FIRST_NEAR)
    views = [_trusted(view, at, noise) for view in views]
    system = _System(views, cover, prior)
    _conjugate(system, at, [view.radiance for view in views], _NEAR)
    # Noise in place of the photographs: what becomes of it says what noise does to the texels.
    drawn = np.zeros_like(at)
    _conjugate(system, drawn, (_drawn(view, rng) for view in views), _NEAR)
    return _values(views, grid, tiny, at, drawn, start, usual.settled)


def _without_lobe(view: PixelsOfPoints, ks: Floats) -> PixelsOfPoints:
    """The view less what a Ks (3,) that is the same everywhere makes of it."""
    left = view.radiance - (ks * view.specular).astype(np.float32)
    return replace(view, radiance=left, specular=np.zeros_like(view.specular))


def _trusted(view: PixelsOfPoints, at: Singles, noise: NoiseModel) -> PixelsOfPoints:
    """The view, weighed by what values leave of it: pixels farther off than noise explains count for less."""
    predicted = view.predicted(at)
    found = photo_weights(noise, predicted.astype(float), (view.radiance - predicted).astype(float))
    return replace(view, weight=(found.weight * view.trust).astype(np.float32))


def _drawn(view: PixelsOfPoints, rng: np.random.Generator) -> Singles:
    """Noise as of the view's radiance, (n, 3)."""
    noise = rng.standard_normal(view.radiance.shape, np.float32)
    return np.asarray(noise / np.sqrt(np.maximum(view.weight, np.float32(1e-30))), np.float32)


def in_shadow(brightest: Sequence[float]) -> list[bool]:
    """Which photographs show nothing that light reaches: all is below what visibility is exact to.

    brightest : of each photograph its largest transfer.
    """
    return [bright <= _SHADOW * max(brightest) for bright in brightest]


def _weighed(views: Sequence[PixelsOfPoints], noise: NoiseModel, bright: float) -> list[PixelsOfPoints]:
    """The views weighed by noise, pixels in shadow only as far as visibility is exact."""
    result = []
    for view in views:
        brightness = np.maximum(view.radiance, 0)
        off = _SHADOW * bright / np.maximum(view.lit, 1e-6 * bright)[:, None] * brightness
        variance = noise.variance(brightness)
        trust = view.trust * variance / (variance + off**2)
        result.append(
            replace(view, trust=trust.astype(np.float32), weight=(trust / variance).astype(np.float32))
        )
    return result


@dataclass(frozen=True, eq=False)
class _Prior:
    laplacian: csr_array
    precision: Singles


@dataclass(frozen=True, eq=False)
class _System:
    """The normal equations of all points: each channel for itself. cover : of all views' pixels together."""

    views: Sequence[PixelsOfPoints]
    cover: csr_array
    prior: _Prior

    def gathered(self, radiances: Iterable[Singles]) -> Singles:
        """What radiances (n, 3) of the views' pixels say of the points, (points, 6)."""
        return self.dealt(view.pull(one) for view, one in zip(self.views, radiances, strict=True))

    def dealt(self, parts: Iterable[Singles]) -> Singles:
        """Values (n, k) of each view's pixels, dealt to the points by their cover: sums (points, k)."""
        values, first = np.empty((0, 0), np.float32), 0
        for part in parts:
            if not len(values):
                values = np.empty((self.cover.shape[0], part.shape[1]), np.float32)
            values[first : first + len(part)] = part
            first += len(part)
        return np.asarray(self.cover.T @ values)

    def pressed(self, values: Singles) -> Singles:
        """Their matrix times values (points, 6)."""
        total = self.gathered(view.predicted(values) for view in self.views)
        smooth = self.prior.laplacian @ values
        smooth *= self.prior.precision
        total += smooth
        return total

    def inverse(self) -> tuple[Singles, Singles, Singles]:
        """Kd by Kd, Kd by Ks and Ks by Ks, (points, 3), of the inverse of each point's own equations."""
        dd = self.dealt(view.weight * view.diffuse**2 for view in self.views)
        ds = self.dealt(view.weight * view.diffuse * view.specular for view in self.views)
        ss = self.dealt(view.weight * view.specular**2 for view in self.views)
        degree = self.prior.laplacian.diagonal()[:, None] * self.prior.precision
        # Points without neighbours that nothing shows.
        dd, ss = (part + 1e-6 * part.max(axis=0) + 1e-30 for part in (dd + degree[:, :3], ss + degree[:, 3:]))
        determinant = dd.astype(np.float64) * ss - ds.astype(np.float64) ** 2
        kd, both, ks = ((part / determinant).astype(np.float32) for part in (ss, -ds, dd))
        return kd, both, ks


def _conjugate(system: _System, at: Singles, radiances: Iterable[Singles], near: float) -> None:
    """Move values (p, 6) to the solution by preconditioned conjugate gradients, until steps are `near` enough."""
    of_kd, of_both, of_ks = system.inverse()

    def preconditioned(values: Singles) -> Singles:
        kd, ks = values[:, :3], values[:, 3:]
        return np.concatenate([of_kd * kd + of_both * ks, of_both * kd + of_ks * ks], axis=1)

    def product(one: Singles, other: Singles) -> Floats:
        both = np.einsum("pk,pk->k", one, other, dtype=np.float64)
        return np.tile(both[:3] + both[3:], 2)

    left = system.gathered(radiances)
    left -= system.pressed(at)
    along = preconditioned(left)
    slope = product(left, along)
    for _ in range(_MOST_STEPS):
        pull = system.pressed(along)
        curved = np.maximum(product(along, pull), 1e-300)
        length = slope / curved
        at += length.astype(np.float32) * along
        # In each of three channels the step's square, in units of the variances that the equations leave.
        if np.sqrt((length**2 * curved)[:3].sum() / at.size) < near:
            return
        pull *= length.astype(np.float32)
        left -= pull
        towards = preconditioned(left)
        before, slope = slope, product(left, towards)
        along *= (slope / np.maximum(before, 1e-300)).astype(np.float32)
        along += towards


def _values(
    views: Sequence[PixelsOfPoints],
    grid: Grid,
    tiny: Callable[[TexelEquations], PointValues],
    at: Singles,
    drawn: Singles,
    start: PointValues,
    scale: Floats,
) -> PointValues:
    """Means over each point's texels with their standard deviations.

    at, drawn : (p, 6), solution and what noise alone gives. start : where Ks doesn't vary, it is this one's. scale : as
    of `determined`.
    """
    expected = tiny(tiny_sums(views, grid.count, grid.parents))
    known = determined(expected, scale)
    means = grid.means
    mean, off = (np.asarray(means @ values, np.float64) for values in (at, drawn))
    tiny_std = np.clip(np.concatenate([expected.kd_std, expected.ks_std], axis=1), 1e-30, 1e30)
    # What noise does to a texel over what the tiny systems expect of it; in the mean over some around it, for one draw
    # says little of one texel.
    square, count = (off / tiny_std) ** 2 * known[:, None], known.astype(float)
    near = grid.neighbours
    for _ in range(_AROUND):
        square, count = near @ square, near @ count
    noise_std = tiny_std * np.sqrt(square / np.maximum(count, 1e-9)[:, None]) * _widening(views, at, means)
    # What is lost at edges of the albedo is lost to Kd and Ks as the tiny systems share out an error of radiance.
    steps = np.sqrt(np.asarray(means @ _steps(at, grid.pairs), np.float64))
    kd_per_ks = tiny_std[:, :3] / tiny_std[:, 3:]
    lost = np.hypot(
        steps, _SHARED * np.concatenate([steps[:, 3:] * kd_per_ks, steps[:, :3] / kd_per_ks], axis=1)
    )
    varies = bool((start.ks_std[known] > 0).any())
    if not varies:
        lost = steps
    std = np.where(known[:, None], np.hypot(noise_std, _UNRESOLVED * lost), np.inf)
    mean = np.maximum(mean, 0)
    ks, ks_std = (mean[:, 3:], std[:, 3:]) if varies else (start.ks, start.ks_std)
    return replace(start, kd=mean[:, :3], ks=ks, kd_std=std[:, :3], ks_std=ks_std)


def _steps(at: Singles, pairs: Ints) -> Singles:
    """Mean squared difference (p, 6) of each point's values from those beside it."""
    one, other = pairs.T
    size = np.bincount(one, minlength=len(at)) + np.bincount(other, minlength=len(at))
    steps = np.empty_like(at)
    for k, values in enumerate(at.T):
        square = (values[one] - values[other]) ** 2
        total = np.bincount(one, square, minlength=len(at)) + np.bincount(other, square, minlength=len(at))
        steps[:, k] = total / np.maximum(size, 1)
    return steps


def _widening(views: Sequence[PixelsOfPoints], at: Singles, means: csr_array) -> Floats:
    """By how much residuals beyond noise widen the points' error bars, (count, 1)."""
    squares, covered = np.zeros(len(at)), np.zeros(len(at))
    for view in views:
        residual = (view.weight * (view.radiance - view.predicted(at)) ** 2).mean(axis=1)
        squares += view.cover.T @ residual
        covered += view.cover.T @ np.ones_like(residual)
    excess = (means @ squares) / np.maximum(means @ covered, 1e-6)
    return np.asarray(np.sqrt(np.where(excess > _BEYOND_NOISE, excess, 1))[:, None])
