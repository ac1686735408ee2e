"""A merged bracket as a picture: the scene, its certainty, how many photographs show it, and how well they agree."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

from capture.bracket.hdr import Merge
from capture.bracket.mapcomparison import Comparison
from capture.figures import printable, short_name
from capture.srgb import linear_to_srgb

_COLOURS = {"red": "#c8372d", "green": "#2c8a3d", "blue": "#2b5fb8"}
_LARGEST = 900


def hdr_figure(
    merged: Merge, exposures: Sequence[float], names: Sequence[str], comparison: Comparison | None = None
) -> Any:
    """A matplotlib Figure; with a comparison a second row shows where another map differs, and by how much."""
    from matplotlib.figure import Figure

    height, width = merged.image.saturated.shape
    tall = 3.3 * min(1.8, max(0.5, height / width))
    rows = 1 if comparison is None else 2
    figure = Figure(figsize=(17, (tall + 0.9) * rows), dpi=110, layout="constrained")
    axes = figure.subplots(rows, 4, squeeze=False)
    stride = max(1, -(-max(height, width) // _LARGEST))
    thin = (slice(None, None, stride), slice(None, None, stride))
    _picture(axes[0, 0], tone_mapped(merged)[thin], "merged radiance, compressed to be seen", stride)
    relative = np.sqrt(merged.image.variance.mean(axis=2)) / np.maximum(
        merged.image.radiance.mean(axis=2), 1e-30
    )
    relative = np.where(merged.image.saturated, np.nan, relative)
    shown = _picture(
        axes[0, 1],
        100 * relative[thin],
        "standard deviation of the radiance (%)",
        stride,
        _logarithmic(100 * relative),
    )
    _bar(figure, shown, axes[0, 1])
    shown = _picture(
        axes[0, 2],
        merged.count[thin],
        "photographs that count\n(white: they differ by more than noise)",
        stride,
    )
    _bar(figure, shown, axes[0, 2])
    _overlay(axes[0, 2], merged.deviating[thin], merged)
    _agreement(axes[0, 3], merged, exposures, names)
    if comparison is not None:
        _comparison_row(figure, axes[1], comparison, thin, stride)
    return figure


def tone_mapped(merged: Merge) -> Any:
    """A picture (h, w, 3) in 0 to 1: logarithm of the luminance between its 1% and 99.5% quantiles, hue kept."""
    radiance = np.maximum(merged.image.radiance.astype(float), 0)
    luminance = radiance.mean(axis=2, keepdims=True)
    positive = luminance[luminance > 0]
    if not positive.size:
        return radiance
    low, high = np.log(np.quantile(positive, [0.01, 0.995]))
    share = np.clip((np.log(np.maximum(luminance, np.exp(low))) - low) / max(high - low, 1e-6), 0, 1)
    colour = radiance / np.maximum(luminance, 1e-30)
    # As bright as the share says on the screen, and never beyond white.
    linear = colour * (0.02 + 0.98 * share) ** 2.2
    return linear_to_srgb(np.clip(linear, 0, 1))


def _picture(axis: Any, image: Any, title: str, stride: int, norm: Any = None, cmap: str = "viridis") -> Any:
    height, width = image.shape[:2]
    extent = (0, width * stride, height * stride, 0)
    shown = axis.imshow(image, extent=extent, interpolation="nearest", norm=norm, cmap=cmap)
    axis.set_title(title, fontsize=8)
    axis.tick_params(labelsize=6)
    axis.set_xlabel("column (pixels)", fontsize=7)
    axis.set_ylabel("row (pixels)", fontsize=7)
    return shown


def _bar(figure: Any, shown: Any, axis: Any) -> None:
    bar = figure.colorbar(shown, ax=axis, fraction=0.05, pad=0.02)
    bar.ax.tick_params(labelsize=6, which="both")


def _logarithmic(values: Any) -> Any:
    from matplotlib.colors import LogNorm

    known = values[np.isfinite(values) & (values > 0)]
    low, high = np.quantile(known, [0.01, 0.99]) if known.size else (0.1, 10.0)
    return LogNorm(max(low, 1e-3), max(high, 10 * low, 1e-2), clip=True)


def _overlay(axis: Any, mask: Any, merged: Merge) -> None:
    height, width = merged.image.saturated.shape
    layer = np.ones((*mask.shape, 4))
    layer[..., 3] = 0.85 * mask
    axis.imshow(layer, extent=(0, width, height, 0), interpolation="nearest")


def _agreement(axis: Any, merged: Merge, exposures: Sequence[float], names: Sequence[str]) -> None:
    order = np.argsort(exposures, kind="stable")
    labels = [short_name(names[index]) for index in order]
    axis.barh(range(len(order)), np.nan_to_num(merged.chi_square[order]), color="#5b7fa6")
    axis.axvline(1, color="black", lw=0.8, ls="--")
    axis.set_yticks(range(len(order)), labels, fontsize=6)
    axis.tick_params(axis="x", labelsize=6)
    axis.set_xlabel("mean squared difference / variance (1: noise alone)", fontsize=7)
    axis.set_title("how well each photograph agrees with the others", fontsize=8)


def _comparison_row(figure: Any, axes: Any, comparison: Comparison, thin: Any, stride: int) -> None:
    from matplotlib.colors import Normalize

    for column, (name, one) in enumerate(zip(_COLOURS, comparison.channels, strict=True)):
        shown = _picture(
            axes[column],
            100 * comparison.difference[thin][..., column],
            f"{name}: merged / other - 1 (%), grey: not compared\n"
            f"median {one.median:.1%}; beyond the 90% quantile, {one.quantile90:.1%}: black line",
            stride,
            Normalize(-25, 25),
            "RdBu",
        )
        axes[column].set_facecolor("#808080")
        beyond = np.abs(comparison.difference[thin][..., column]) > one.quantile90
        rows, columns = beyond.shape
        places = (np.arange(columns) + 0.5) * stride, (np.arange(rows) + 0.5) * stride
        axes[column].contour(*places, beyond, [0.5], colors="black", linewidths=0.3)
        _bar(figure, shown, axes[column])
    for column, name in enumerate(_COLOURS):
        size = 100 * np.abs(comparison.difference[..., column])
        size = np.sort(size[np.isfinite(size)])
        axes[3].plot(size, np.linspace(0, 100, len(size)), color=_COLOURS[name], label=name)
    axes[3].axhline(90, color="grey", lw=0.8, ls="--")
    axes[3].axhline(50, color="grey", lw=0.8, ls=":")
    axes[3].set_xscale("log")
    axes[3].set_xlim(0.1, 200)
    axes[3].set_ylim(0, 100)
    axes[3].grid(alpha=0.25)
    axes[3].tick_params(labelsize=6)
    axes[3].set_xlabel("relative difference (%)", fontsize=7)
    axes[3].set_ylabel("share of compared pixels below (%)", fontsize=7)
    axes[3].set_title(f"differences from {printable(comparison.name)} (dashed: 90%)", fontsize=8)
    axes[3].legend(fontsize=7)
