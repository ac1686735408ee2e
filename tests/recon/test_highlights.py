"""More samples where small highlights are, and what each of them then stands for."""

from __future__ import annotations

import numpy as np
import pytest

from recon.sampling.budget import draw, spread, spread_with_highlights
from recon.sampling.candidates import Candidates


def drawn_again(bright, normals, found: float, rng: np.random.Generator) -> Candidates:
    """A quarter of the pixels at random, and of the highlight's others such a share."""
    at_random = np.zeros(len(normals), bool)
    at_random[rng.choice(len(normals), len(normals) // 4, replace=False)] = True
    beside = bright & ~at_random & (rng.random(len(normals)) < found)
    index = np.flatnonzero(at_random | beside)
    return Candidates(index, index, at_random[index], bright[index], 0.25, found)


@pytest.mark.parametrize("found", [1.0, 0.4])
@pytest.mark.parametrize("how", ["beside the budget", "by information"])
def test_more_samples_of_highlights_leave_sums_unbiased(how: str, found: float) -> None:
    rng = np.random.default_rng(3)
    normals = rng.standard_normal((12000, 3))
    normals /= np.linalg.norm(normals, axis=1, keepdims=True)
    bright = np.arccos(normals[:, 2]) < 0.15
    expected, counted, samples = [], [], []
    for _ in range(100):
        expected.append(bright[spread(normals, 600, rng)].mean())
        looked_at = drawn_again(bright, normals, found, rng)
        own = normals[looked_at.rows]
        if how == "beside the budget":
            kept, stands_for = spread_with_highlights(own, looked_at, 600, rng)
        else:
            kept, stands_for = draw(own, np.where(looked_at.bright, 9.0, 1.0), 600, rng, looked_at.rarity)
        samples.append(looked_at.bright[kept].sum())
        counted.append(stands_for[looked_at.bright[kept]].sum() / stands_for.sum())
    # Four times what an even draw has, and more.
    assert np.mean(samples) > 4 * 600 * np.mean(expected) * found
    # What it counts for is what an even draw would have of it: to the standard error of a hundred draws.
    error = np.hypot(np.std(expected), np.std(counted)) / np.sqrt(len(expected))
    assert abs(np.mean(counted) - np.mean(expected)) < 3 * error
