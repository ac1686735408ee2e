"""More samples where small highlights are, and what each of them then stands for."""

from __future__ import annotations

import numpy as np

from recon.sampling.draw import _cells, _with_highlights, spread


def test_more_samples_of_highlights_leave_sums_unbiased() -> None:
    rng = np.random.default_rng(3)
    normals = rng.standard_normal((6000, 3))
    normals /= np.linalg.norm(normals, axis=1, keepdims=True)
    bright = np.arccos(normals[:, 2]) < 0.2
    cells = _cells(normals)
    share_drawn, share_counted = [], []
    for _ in range(60):
        drawn = spread(normals, 600, rng)
        kept, stands_for = _with_highlights(drawn, bright, cells, rng)
        # All of the highlight is there, a tenth of the rest.
        assert bright[kept].sum() == bright.sum()
        share_drawn.append(bright[drawn].mean())
        share_counted.append(stands_for[bright[kept]].sum() / stands_for.sum())
    # What it counts for is what an even draw would have of it: to the standard error of sixty draws.
    error = np.std(share_drawn) / np.sqrt(len(share_drawn))
    assert abs(np.mean(share_counted) - np.mean(share_drawn)) < 3 * error
