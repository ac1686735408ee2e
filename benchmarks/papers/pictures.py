"""Photographs beside their renderings."""

from __future__ import annotations

import matplotlib
import numpy as np
from matplotlib.axes import Axes
from numpy.typing import NDArray

from capture.srgb import linear_to_srgb
from invrender.result.run import Prediction

Floats = NDArray[np.floating]

# Of the photograph's white, where the colours of differences end.
_LIMIT = 0.05


def white_of(seen: Prediction) -> float:
    """The radiance that is drawn white: the object's brightest, but for its highlights' peaks."""
    return float(np.percentile(seen.observed.radiance[seen.inside].max(axis=1), 99.5))


def draw_photograph(axes: Axes, seen: Prediction, title: str) -> None:
    """The photograph, cut to the object."""
    _draw(axes, seen, seen.observed.radiance, title)


def draw_rendering(axes: Axes, seen: Prediction, title: str) -> float:
    """The rendering in the photograph's scale; returned is how far it is off in parts of white (RMS)."""
    off = _difference(seen)[seen.inside]
    rms = float(np.sqrt(np.mean(off**2)))
    _draw(axes, seen, seen.predicted, f"{title}: {rms:.2%}")
    return rms


def draw_difference(axes: Axes, seen: Prediction, title: str) -> None:
    """Photograph minus rendering, mean of the channels, in per cent of white."""
    off = _difference(seen).mean(axis=2)
    off[~seen.inside] = np.nan
    colours = matplotlib.colormaps["RdBu_r"].with_extremes(bad="0.9")
    drawn = axes.imshow(100 * off[_crop(seen)], cmap=colours, vmin=-100 * _LIMIT, vmax=100 * _LIMIT)
    axes.figure.colorbar(drawn, ax=axes, label="photograph minus rendering (% of white)", shrink=0.9)
    _bare(axes, title)


def _difference(seen: Prediction) -> Floats:
    return (seen.observed.radiance.astype(float) - seen.predicted) / white_of(seen)


def _draw(axes: Axes, seen: Prediction, radiance: Floats, title: str) -> None:
    axes.imshow(linear_to_srgb(np.clip(np.asarray(radiance, float)[_crop(seen)] / white_of(seen), 0, 1)))
    _bare(axes, title)


def _crop(seen: Prediction) -> tuple[slice, slice]:
    rows, columns = np.nonzero(seen.inside)
    return np.s_[max(rows.min() - 4, 0) : rows.max() + 5, max(columns.min() - 4, 0) : columns.max() + 5]


def _bare(axes: Axes, title: str) -> None:
    axes.set(xticks=[], yticks=[])
    axes.set_title(title, fontsize=10)
