"""The linear solve inside the search: Kd, Ks and strengths of the light, for given mu and sigma.

In known light they are two unknowns per channel. Where strengths are unknown, Kd and Ks multiply unknowns: the share
Ks / (Kd + Ks) is searched on a line, and all else solved linearly. Many fits are solved at once: of one model to the
same photographs at many mu and sigma, or to many subsets of the photographs.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from invrender.estimate.statistics import Statistics, Subsets

Floats = NDArray[np.float64]

# Points of the line search over the share of Ks.
_SHARES = 17


@dataclass(frozen=True, eq=False)
class LinearPart:
    """What is best in each of f fits.

    cost : (f,), weighted sum of squared residuals. kd, ks : (f, 3). strengths : per lighting (f, elements, 3), 1 where
    known, and where a subset of the photographs lacks the lighting.
    """

    cost: Floats
    kd: Floats
    ks: Floats
    strengths: Mapping[str, Floats]


@dataclass(frozen=True, eq=False)
class ReducedEquations:
    """Normal equations of f fits in k combinations of a lighting's columns.

    lighting, elements : as in `Statistics`. gram : (f, 3, elements, k, elements, k). right : (f, 3, elements, k).
    energy, count : (f,).
    """

    lighting: str
    elements: tuple[str, ...]
    gram: Floats
    right: Floats
    energy: Floats
    count: Floats


class _Lit(Protocol):
    @property
    def lighting(self) -> str: ...
    @property
    def elements(self) -> tuple[str, ...]: ...


def recovers_light(lit: Sequence[_Lit]) -> bool:
    """Whether any strength of the lighting of photographs, or of their statistics, is to be found."""
    return any(name != "known" for entry in lit for name in entry.elements)


def reduce_statistics(subsets: Subsets, combinations: Floats) -> list[ReducedEquations]:
    """Normal equations in combinations (f, q, k) of the columns, one set of them for each subset of the photographs."""
    found = {entry.lighting: _reduced(entry, combinations) for entry in subsets.everything}
    for fit, left_out in enumerate(subsets.left_out):
        for entry in left_out:
            whole, part = found[entry.lighting], _reduced(entry, combinations[fit : fit + 1])
            for total, less in (
                (whole.gram, part.gram),
                (whole.right, part.right),
                (whole.energy, part.energy),
                (whole.count, part.count),
            ):
                total[fit] -= less[0]
    return list(found.values())


def _reduced(entry: Statistics, combinations: Floats) -> ReducedEquations:
    fits, size, count = combinations.shape
    elements = len(entry.elements)
    side_by_side = combinations.transpose(1, 0, 2).reshape(size, -1)
    half = (entry.gram.reshape(-1, size) @ side_by_side).reshape(3, elements, size, elements, fits, count)
    # (f, 3, e, e, k, q) times (f, 1, 1, 1, q, k)
    gram = half.transpose(4, 0, 1, 3, 5, 2) @ combinations[:, None, None, None]
    right = (entry.right.reshape(-1, size) @ side_by_side).reshape(3, elements, fits, count)
    return ReducedEquations(
        entry.lighting,
        entry.elements,
        gram.transpose(0, 1, 2, 5, 3, 4),
        right.transpose(2, 0, 1, 3).copy(),
        np.full(fits, float(entry.energy.sum())),
        np.full(fits, float(entry.count)),
    )


def solve_linear(reduced: Sequence[ReducedEquations], specular: bool, neutral: bool = False) -> LinearPart:
    """The best Kd, Ks and strengths; the first two combinations are the diffuse and the specular transfer.

    specular : False for Ks of 0. neutral : one Ks for all channels, in known light. With no known light at all the
    gauge is a mean strength of 1 per channel, over all sources (over all elements where there is no source).
    """
    if recovers_light(reduced):
        return _solve_strengths(reduced, specular)
    return _solve_brdf(reduced, specular, neutral)


def symmetric_pinv(matrix: Floats) -> Floats:
    """Inverse of symmetric matrices (..., p, p) with their unobservable (gauge) directions left out.

    Scaled to unit diagonal first: the parameters' units differ by orders of magnitude.
    """
    scale = np.sqrt(np.maximum(np.diagonal(matrix, axis1=-2, axis2=-1), 1e-300))
    scales = scale[..., :, None] * scale[..., None, :]
    return np.asarray(np.linalg.pinv(matrix / scales, rcond=1e-11, hermitian=True) / scales)


def _solve_brdf(reduced: Sequence[ReducedEquations], specular: bool, neutral: bool) -> LinearPart:
    """Known light: Kd and Ks >= 0 per channel, or one Ks for all."""
    gram = np.sum([entry.gram[:, :, 0, :2, 0, :2] for entry in reduced], axis=0)
    right = np.sum([entry.right[:, :, 0, :2] for entry in reduced], axis=0)
    energy = np.sum([entry.energy for entry in reduced], axis=0)
    solution = np.zeros(right.shape)
    if neutral:
        solution = _one_specular(gram, right)
    elif specular:
        solution = _nonnegative_pair(gram, right)
    else:
        solution[..., 0] = np.maximum(right[..., 0] / np.maximum(gram[..., 0, 0], 1e-300), 0)
    fitted = (solution * (2 * right - (gram @ solution[..., None])[..., 0])).sum(axis=(1, 2))
    strengths = {entry.lighting: np.ones((len(energy), 1, 3)) for entry in reduced}
    return LinearPart(energy - fitted, solution[..., 0], solution[..., 1], strengths)


def _nonnegative_pair(gram: Floats, right: Floats) -> Floats:
    """Least squares in two unknowns, both >= 0: gram (..., 2, 2), right (..., 2)."""
    ridge = 1e-13 * np.trace(gram, axis1=-2, axis2=-1)[..., None, None]
    solution = np.linalg.solve(gram + (ridge + 1e-300) * np.eye(2), right[..., None])[..., 0]
    alone = np.maximum(right / np.maximum(np.diagonal(gram, axis1=-2, axis2=-1), 1e-300), 0)
    better = np.arange(2) == np.argmax(alone * right, axis=-1)[..., None]
    return np.where((solution < 0).any(axis=-1, keepdims=True), np.where(better, alone, 0), solution)


def _one_specular(gram: Floats, right: Floats) -> Floats:
    """Least squares in Kd per channel and one Ks, all >= 0: gram (f, c, 2, 2), right (f, c, 2); solution (f, c, 2)."""
    diffuse = np.maximum(gram[..., 0, 0], 1e-300)
    with_diffuse = np.ones(diffuse.shape, bool)
    for _ in range(diffuse.shape[1] + 1):
        share = np.where(with_diffuse, gram[..., 0, 1] / diffuse, 0)
        left = (gram[..., 1, 1] - share * gram[..., 0, 1]).sum(axis=1)
        ks = np.maximum((right[..., 1] - share * right[..., 0]).sum(axis=1), 0) / np.maximum(left, 1e-300)
        kd = (right[..., 0] - gram[..., 0, 1] * ks[:, None]) / diffuse
        # A channel that would have a negative diffuse part has none, and Ks is sought again.
        if (kd[with_diffuse] >= 0).all():
            break
        with_diffuse &= kd >= 0
    return np.stack([np.where(with_diffuse, kd, 0), np.broadcast_to(ks[:, None], kd.shape)], axis=-1)


def _solve_strengths(reduced: Sequence[ReducedEquations], specular: bool) -> LinearPart:
    """Partly unknown light: the share of Ks on a line per channel; (Kd + Ks) and its products with strengths."""
    fits = len(reduced[0].count)
    cost, kd, ks = np.empty(fits), np.empty((fits, 3)), np.empty((fits, 3))
    strengths = {entry.lighting: np.ones((fits, len(entry.elements), 3)) for entry in reduced}
    # One after the other: of many lightings there are many strengths.
    for fit in range(fits):
        shown = [entry for entry in reduced if entry.count[fit]]
        normal = [(entry.gram[fit, :, :, :2, :, :2], entry.right[fit, :, :, :2]) for entry in shown]
        explained, kd[fit], ks[fit], found = _with_strengths(shown, normal, specular)
        cost[fit] = sum(entry.energy[fit] for entry in shown) - explained
        for entry, own in zip(shown, found, strict=True):
            strengths[entry.lighting][fit] = own
    return LinearPart(cost, kd, ks, strengths)


def _with_strengths(
    lightings: Sequence[_Lit], normal: Sequence[tuple[Floats, Floats]], specular: bool
) -> tuple[float, Floats, Floats, list[Floats]]:
    """Explained energy, Kd (3,), Ks (3,) and strengths (elements, 3) of each lighting.

    normal : per lighting (3, e, 2, e, 2) and (3, e, 2).
    """
    places, has_known = _places(lightings)
    size = len(places) + has_known
    indices = [
        np.array([places.get((entry.lighting, name), size - 1) for name in entry.elements])
        for entry in lightings
    ]

    # Of all lightings side by side, before shares are tried: (3, 2, 2, size, size) and (3, 2, size).
    whole, whole_right = np.zeros((3, 2, 2, size, size)), np.zeros((3, 2, size))
    for index, (small, small_right) in zip(indices, normal, strict=True):
        whole[..., index[:, None], index] += small.transpose(0, 2, 4, 1, 3)
        whole_right[..., index] += small_right.transpose(0, 2, 1)
    unit = np.eye(size)

    def solve(shares: Floats) -> tuple[Floats, Floats]:
        """Explained energy (s, 3) and solutions (s, 3, size) at shares (s, 3)."""
        split = np.stack([1 - shares.T, shares.T], axis=-1)
        pairs = (split[..., :, None] * split[..., None, :]).reshape(3, -1, 4)
        gram = (pairs @ whole.reshape(3, 4, -1)).reshape(3, -1, size, size)
        right = split @ whole_right
        ridge = 1e-12 * np.trace(gram, axis1=2, axis2=3)[:, :, None, None] / size
        solution = np.linalg.solve(gram + (ridge + 1e-300) * unit, right[..., None])[..., 0]
        return (solution * right).sum(axis=-1).T, solution.transpose(1, 0, 2)

    shares = _best_shares(lambda s: solve(s)[0]) if specular else np.zeros(3)
    explained, solutions = solve(shares[None])
    solution = solutions[0]
    if has_known:
        scale = solution[:, -1]
    else:
        sources = [k for (_, name), k in places.items() if name.startswith("source")] or list(places.values())
        scale = solution[:, sources].mean(axis=1)
    scale = np.where(np.abs(scale) > 1e-300, scale, 1e-300)
    strengths = [(solution[:, index] / scale[:, None]).T for index in indices]
    return float(explained.sum()), (1 - shares) * scale, shares * scale, strengths


def _places(lightings: Sequence[_Lit]) -> tuple[dict[tuple[str, str], int], bool]:
    """A place among the unknowns for each (lighting, element) to recover, and whether any light is known."""
    pairs = [(entry.lighting, name) for entry in lightings for name in entry.elements]
    return {pair: k for k, pair in enumerate(p for p in pairs if p[1] != "known")}, any(
        name == "known" for _, name in pairs
    )


def _best_shares(explained: Callable[[Floats], Floats]) -> Floats:
    """Shares (3,) in 0 to 1 that explain most, each channel on its own: a grid, refined, then a parabola."""
    low, high = np.zeros(3), np.ones(3)
    for _ in range(4):
        grid = np.linspace(low, high, _SHARES)
        values = explained(grid)
        top = np.clip(values.argmax(axis=0), 1, _SHARES - 2)
        step = (high - low) / (_SHARES - 1)
        centre = low + top * step
        low, high = np.maximum(centre - step, 0), np.minimum(centre + step, 1)
    channel = np.arange(3)
    before, at, after = (values[top + k, channel] for k in (-1, 0, 1))
    bend = before - 2 * at + after
    shift = np.where(bend < 0, (before - after) / np.where(bend < 0, 2 * bend, 1), 0)
    return np.clip(centre + np.clip(shift, -1, 1) * step, 0, 1)
