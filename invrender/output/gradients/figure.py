"""Gradients of a photograph as a picture: its radiance, each term's strength, and where light counts as near."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from capture.figures import printable
from capture.srgb import linear_to_srgb
from invrender.gradients.predicted import FAR
from invrender.output.gradients.document import named_terms, near_below, share_of
from invrender.output.gradients.photograph import PhotoGradients

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.colors import Normalize
    from matplotlib.figure import Figure

Floats = NDArray[np.float64]

_MOST_COLUMNS = 4
_TITLES = {
    "spatial": "spatial light\n(a lamp nearby)",
    "curvature": "curvature\n(the normal turns)",
    "perspective": "perspective\n(the view turns)",
    "texture": "texture\n(the material varies)",
    "visibility": "visibility\n(the object's shadow)",
    "remainder": "remainder\n(beyond first order)",
}
# Of the strongest gradients, what is still told from nothing.
_DECADES = 1e-3
_BACKGROUND = "#e6e6e6"


def gradients_figure(name: str, found: PhotoGradients) -> Figure:
    """The prediction, its gradient, the terms that there are on the gradient's scale, and nearness."""
    from matplotlib.figure import Figure

    whole = found.difference
    terms = {term: values for term, values in named_terms(found).items() if values.any()}
    panels = 3 + len(terms)
    rows = -(-panels // _MOST_COLUMNS)
    columns = -(-panels // rows)
    figure = Figure(figsize=(3.5 * columns, 3.4 * rows + 0.4), dpi=90, layout="constrained")
    figure.suptitle(printable(f"Gradient of the predicted radiance of {name}"))
    axes = figure.subplots(rows, columns, squeeze=False).ravel()
    for each in axes:
        each.set_axis_off()
    _draw_radiance(axes[0], found)
    strongest = float(np.percentile(_length(whole), 99.9))
    _draw_strength(axes[1], found, whole, strongest, "all of it\n(difference across a pixel)")
    for place, (term, values) in zip(axes[2:], terms.items(), strict=False):
        share = share_of(values, whole)
        title = _TITLES[term] + ("" if share is None else f": {share:.1%}")
        _draw_strength(place, found, values, strongest, title)
    _draw_nearness(axes[2 + len(terms)], found)
    return figure


def _draw_radiance(axes: Axes, found: PhotoGradients) -> None:
    radiance = found.terms.radiance
    white = max(float(np.percentile(radiance, 99.5)), 1e-12)
    picture = found.picture(linear_to_srgb(np.clip(radiance / white, 0, 1)), 0.9)
    axes.imshow(picture, interpolation="nearest")
    pixels = "every pixel" if found.stride == 1 else f"one pixel in {found.stride} each way"
    axes.set_title(f"predicted radiance\n({pixels})")


def _draw_strength(axes: Axes, found: PhotoGradients, values: Floats, strongest: float, title: str) -> None:
    from matplotlib.colors import LogNorm

    strongest = strongest if strongest > 0 else 1.0
    norm = LogNorm(_DECADES * strongest, strongest, clip=True)
    _draw(axes, found.picture(_length(values), np.nan), norm, "magma", "radiance per pixel")
    axes.set_title(title)


def _draw_nearness(axes: Axes, found: PhotoGradients) -> None:
    """1 / d over 2 k; where no lamp is at a place, how far away one would have to be to count as far."""
    from matplotlib.colors import LogNorm

    if (found.nearness > 0).any():
        share = float((found.nearness >= FAR).mean())
        norm = LogNorm(FAR / 10, 1, clip=True)
        _draw(axes, found.picture(found.nearness, np.nan), norm, "cividis", "(1 / d) / (2 k)")
        axes.set_title(f"1 / d against 2 k\n(light is near at {share:.0%})")
        return
    distances = near_below(found.curvature)
    finite = distances[np.isfinite(distances)]
    if not len(finite):
        axes.set_title("no curvature:\nany lamp at a place counts as near")
        return
    low, high = np.percentile(finite, (2, 98))
    # Of a sphere both are the same.
    norm = LogNorm(low / 1.5, high * 1.5)
    _draw(axes, found.picture(distances, np.nan), norm, "viridis", "metres")
    axes.set_title(f"light is far; a lamp is near\nwithin (median {np.median(finite):.4g} m)")


def _draw(axes: Axes, picture: NDArray[np.float32], norm: Normalize, colours: str, label: str) -> None:
    from matplotlib import colormaps

    shown = axes.imshow(
        picture, norm=norm, cmap=colormaps[colours].with_extremes(bad=_BACKGROUND), interpolation="nearest"
    )
    assert axes.figure is not None
    axes.figure.colorbar(shown, ax=axes, shrink=0.85, label=label)


def _length(values: Floats) -> Floats:
    """Of gradients (n, 2, 3), mean over channels."""
    return np.asarray(np.sqrt((values**2).sum(axis=1)).mean(axis=1))
