"""The picture that shows the cause of what a model leaves."""

from __future__ import annotations

import numpy as np
from matplotlib.figure import Figure
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from invrender.diagnostics.named import NamedCause

Floats = NDArray[np.float64]

# Pixels of a panel along the object's longer side, and how many steps of samples apart a pixel may lie from one.
_ACROSS, _APART = 160, 2.0


def cause_figure(cause: NamedCause) -> Figure:
    """A photograph's difference, what of it a cause explains, and the rest, on one scale; where there are samples."""
    panels = {
        "photograph minus prediction": cause.difference,
        "what this explains": cause.explained,
        "the rest": cause.difference - cause.explained,
    }
    limit = max(float(np.quantile(np.abs(cause.difference), 0.98)), 1e-30)
    near, seen = _nearest(cause)
    figure = Figure(figsize=(8.6, 3.1))
    axes = figure.subplots(1, len(panels))
    for panel, (title, values) in zip(axes, panels.items(), strict=True):
        picture = np.where(seen, values[near], np.nan)
        shown = panel.imshow(picture, cmap="RdBu_r", vmin=-limit, vmax=limit, interpolation="nearest")
        panel.set_title(title, fontsize=9)
        panel.set_axis_off()
    figure.colorbar(shown, ax=axes, shrink=0.8, label="radiance, mean of channels")
    return figure


def _nearest(cause: NamedCause) -> tuple[NDArray[np.int64], NDArray[np.bool_]]:
    """The sample (h, w) nearest to each pixel of a panel, and whether there is one about there."""
    places = np.stack([cause.rows, cause.columns], axis=-1).astype(float)
    low, high = places.min(axis=0), places.max(axis=0)
    step = max(float((high - low).max()) / _ACROSS, 1.0)
    axes = [np.arange(start, end + step, step) for start, end in zip(low, high, strict=True)]
    grid = np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1)
    tree = cKDTree(places)
    apart = np.median(tree.query(places, [2])[0]) if len(places) > 1 else 1.0
    distance, near = tree.query(grid)
    return np.asarray(near), np.asarray(distance <= _APART * max(apart, step))
