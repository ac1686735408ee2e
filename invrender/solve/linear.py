"""The linear solve inside the search: Kd, Ks and strengths of the light, for given mu and sigma.

In known light they are two unknowns per channel. Where strengths are unknown, Kd and Ks multiply unknowns: the share
Ks / (Kd + Ks) is searched on a line, and all else solved linearly.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from invrender.solve.statistics import Statistics

Floats = NDArray[np.float64]

# Points of the line search over the share of Ks.
_SHARES = 17


@dataclass(frozen=True, eq=False)
class LinearPart:
    """What is best.

    cost : weighted sum of squared residuals. kd, ks : (3,). strengths : per lighting (elements, 3), 1 where known
    """

    cost: float
    kd: Floats
    ks: Floats
    strengths: dict[str, Floats]


class _Lit(Protocol):
    @property
    def elements(self) -> tuple[str, ...]: ...


def recovers_light(lit: Sequence[_Lit]) -> bool:
    """Whether any strength of the lighting of photographs, or of their statistics, is to be found."""
    return any(name != "known" for entry in lit for name in entry.elements)


def solve_linear(
    statistics: Sequence[Statistics], weights: Floats | None, neutral: bool = False
) -> LinearPart:
    """The best Kd, Ks and strengths for given weights of the specular columns, None without specular part.

    neutral : one Ks for all channels, in known light. With no known light at all the gauge is a mean strength of 1 per
    channel, over all sources (over all elements where there is no source).
    """
    reduced = [reduce_statistics(entry, weights) for entry in statistics]
    if recovers_light(statistics):
        return _solve_strengths(statistics, reduced, weights is not None)
    return _solve_brdf(statistics, reduced, weights is not None, neutral)


def symmetric_pinv(matrix: Floats) -> Floats:
    """Inverse of a symmetric matrix with its unobservable (gauge) directions left out.

    Scaled to unit diagonal first: the parameters' units differ by orders of magnitude.
    """
    scale = np.sqrt(np.maximum(np.diag(matrix), 1e-300))
    inverse = np.linalg.pinv(matrix / np.outer(scale, scale), rcond=1e-11, hermitian=True)
    return inverse / np.outer(scale, scale)


def reduce_statistics(entry: Statistics, weights: Floats | None) -> tuple[Floats, Floats]:
    """Normal equations in (diffuse, specular) transfers only: (3, e, 2, e, 2) and (3, e, 2).

    weights : of the specular columns, for given mu and sigma; None leaves the specular part zero.
    """
    gram, right = entry.gram, entry.right
    elements = gram.shape[1]
    small = np.zeros((3, elements, 2, elements, 2))
    small_right = np.zeros((3, elements, 2))
    small[:, :, 0, :, 0] = gram[:, :, 0, :, 0]
    small_right[:, :, 0] = right[:, :, 0]
    if weights is not None:
        half = gram[..., 1:] @ weights  # (3, e, q, e)
        small[:, :, 0, :, 1] = half[:, :, 0]
        small[:, :, 1, :, 0] = half[:, :, 0].transpose(0, 2, 1)
        small[:, :, 1, :, 1] = np.einsum("ceqf,q->cef", half[:, :, 1:], weights)
        small_right[:, :, 1] = right[:, :, 1:] @ weights
    return small, small_right


def _solve_brdf(
    statistics: Sequence[Statistics],
    reduced: Sequence[tuple[Floats, Floats]],
    specular: bool,
    neutral: bool,
) -> LinearPart:
    """Known light: Kd and Ks >= 0 per channel, or one Ks for all."""
    gram = np.sum([small[:, 0, :, 0, :] for small, _ in reduced], axis=0)
    right = np.sum([small_right[:, 0] for _, small_right in reduced], axis=0)
    energy = sum(float(entry.energy.sum()) for entry in statistics)
    solution = np.zeros((3, 2))
    if neutral:
        solution = _one_specular(gram, right)
    elif specular:
        solution = _nonnegative_pair(gram, right)
    else:
        solution[:, 0] = np.maximum(right[:, 0] / np.maximum(gram[:, 0, 0], 1e-300), 0)
    fitted = 2 * (solution * right).sum() - np.einsum("ci,cij,cj->", solution, gram, solution)
    strengths = {entry.lighting: np.ones((1, 3)) for entry in statistics}
    return LinearPart(float(energy - fitted), solution[:, 0], solution[:, 1], strengths)


def _nonnegative_pair(gram: Floats, right: Floats) -> Floats:
    """Least squares in two unknowns, both >= 0: gram (c, 2, 2), right (c, 2)."""
    ridge = 1e-13 * np.trace(gram, axis1=1, axis2=2)[:, None, None] * np.eye(2)
    solution = np.linalg.solve(gram + ridge + 1e-300 * np.eye(2), right[:, :, None])[:, :, 0]
    for c in np.flatnonzero((solution < 0).any(axis=1)):
        alone = np.maximum(right[c] / np.maximum(np.diag(gram[c]), 1e-300), 0)
        gain = alone * right[c]
        solution[c] = np.where(np.arange(2) == np.argmax(gain), alone, 0)
    return solution


def _one_specular(gram: Floats, right: Floats) -> Floats:
    """Least squares in Kd per channel and one Ks, all >= 0: gram (c, 2, 2), right (c, 2); solution (c, 2)."""
    diffuse = np.maximum(gram[:, 0, 0], 1e-300)
    with_diffuse = np.ones(len(gram), bool)
    for _ in range(len(gram) + 1):
        share = np.where(with_diffuse, gram[:, 0, 1] / diffuse, 0)
        left = float((gram[:, 1, 1] - share * gram[:, 0, 1]).sum())
        ks = max(float((right[:, 1] - share * right[:, 0]).sum()), 0) / max(left, 1e-300)
        kd = (right[:, 0] - gram[:, 0, 1] * ks) / diffuse
        # A channel that would have a negative diffuse part has none, and Ks is sought again.
        if (kd[with_diffuse] >= 0).all():
            break
        with_diffuse &= kd >= 0
    return np.stack([np.where(with_diffuse, kd, 0), np.full(len(gram), ks)], axis=-1)


def _solve_strengths(
    statistics: Sequence[Statistics], reduced: Sequence[tuple[Floats, Floats]], specular: bool
) -> LinearPart:
    """Partly unknown light: the share of Ks on a line per channel; (Kd + Ks) and its products with strengths."""
    places, has_known = _places(statistics)
    size = len(places) + has_known
    indices = [
        np.array([places.get((entry.lighting, name), size - 1) for name in entry.elements])
        for entry in statistics
    ]

    def solve(shares: Floats) -> tuple[Floats, Floats]:
        """Explained energy (s, 3) and solutions (s, 3, size) at shares (s, 3)."""
        split = np.stack([1 - shares, shares], axis=-1)
        gram, right = np.zeros((len(shares), 3, size, size)), np.zeros((len(shares), 3, size))
        for index, (small, small_right) in zip(indices, reduced, strict=True):
            gram[:, :, index[:, None], index] += np.einsum("sci,ceifj,scj->scef", split, small, split)
            right[:, :, index] += np.einsum("sci,cei->sce", split, small_right)
        ridge = 1e-12 * np.trace(gram, axis1=2, axis2=3)[:, :, None, None] / size
        solution = np.linalg.solve(gram + (ridge + 1e-300) * np.eye(size), right[..., None])[..., 0]
        return (solution * right).sum(axis=-1), solution

    shares = _best_shares(lambda s: solve(s)[0]) if specular else np.zeros(3)
    explained, solutions = solve(shares[None])
    solution = solutions[0]
    if has_known:
        scale = solution[:, -1]
    else:
        sources = [k for (_, name), k in places.items() if name.startswith("source")] or list(places.values())
        scale = solution[:, sources].mean(axis=1)
    scale = np.where(np.abs(scale) > 1e-300, scale, 1e-300)
    strengths = {
        entry.lighting: (solution[:, index] / scale[:, None]).T
        for entry, index in zip(statistics, indices, strict=True)
    }
    energy = sum(float(entry.energy.sum()) for entry in statistics)
    return LinearPart(energy - float(explained.sum()), (1 - shares) * scale, shares * scale, strengths)


def _places(statistics: Sequence[Statistics]) -> tuple[dict[tuple[str, str], int], bool]:
    """A place among the unknowns for each (lighting, element) to recover, and whether any light is known."""
    pairs = [(entry.lighting, name) for entry in statistics for name in entry.elements]
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
