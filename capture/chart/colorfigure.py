"""A camera's colours as a picture: where the chart was found, its patches beside the reference, and its greys."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from capture.chart.chart import GRIDS
from capture.chart.colorfit import LUMINANCE
from capture.chart.colorrecovery import ColorRecovery
from capture.srgb import linear_to_srgb

Floats = NDArray[np.float64]


def color_figure(recovery: ColorRecovery) -> Any:
    """A matplotlib Figure of the photograph that is off most."""
    from matplotlib.figure import Figure

    worst = int(recovery.delta_e.mean(axis=1).argmax())
    figure = Figure(figsize=(14, 4.6), dpi=110, layout="constrained")
    found, patches, greys = figure.subplots(1, 3, width_ratios=[1.15, 1.15, 1])
    _draw_found(found, recovery, worst)
    _draw_patches(patches, recovery, worst)
    _draw_greys(greys, recovery, worst)
    off = recovery.delta_e
    figure.suptitle(
        f"{recovery.named} in {len(recovery.photos)} photograph{'s' if len(recovery.photos) > 1 else ''}: patches off"
        f" by {off.mean():.2f} in the mean, {off.max():.2f} at most (CIEDE2000)",
        fontsize=10,
    )
    return figure


def _shown(linear: Floats) -> Floats:
    return np.asarray(linear_to_srgb(np.clip(linear, 0, 1)))


def _draw_found(axes: Any, recovery: ColorRecovery, k: int) -> None:
    photo, fit = recovery.photos[k], recovery.fit
    level = recovery.chart.srgb[recovery.chart.greys].max() / max(
        float((photo.seen.rgb[recovery.chart.greys] @ fit.matrix.T).max()), 1e-12
    )
    axes.imshow(_shown(level * (photo.picture.astype(float) @ fit.matrix.T)))
    for quad in photo.grid.patches():
        closed = np.concatenate([quad, quad[:1]]) / photo.step
        axes.plot(closed[:, 0], closed[:, 1], color="white", lw=1.6)
        axes.plot(closed[:, 0], closed[:, 1], color="black", lw=0.7)
    axes.set_title(f"{photo.path.name}: corrected, and where patches are read", fontsize=9)
    axes.set_axis_off()


def _draw_patches(axes: Any, recovery: ColorRecovery, k: int) -> None:
    chart, off = recovery.chart, recovery.delta_e[k]
    columns, rows = GRIDS[chart.layout]
    for n, (column, row) in enumerate(chart.places - 0.5):
        for width, colours in ((0.94, chart.srgb), (0.47, recovery.fit.corrected[k])):
            colour = _shown(colours[n])
            axes.add_patch(_rectangle(column + 0.03, row + 0.03, width, 0.94, colour))
        dark = chart.srgb[n] @ LUMINANCE < 0.2
        axes.text(
            column + 0.5, row + 0.5, f"{off[n]:.1f}", ha="center", va="center",
            fontsize=8 if columns < 10 else 5, color="white" if dark else "black",
        )  # fmt: skip
    axes.set_xlim(0, columns)
    axes.set_ylim(rows, 0)
    axes.set_aspect("equal")
    axes.set_axis_off()
    axes.set_title("patches: left as photographed, right the reference; CIEDE2000", fontsize=9)


def _rectangle(x: float, y: float, width: float, height: float, colour: Floats) -> Any:
    from matplotlib.patches import Rectangle

    return Rectangle((x, y), width, height, facecolor=tuple(colour), edgecolor="none")


def _draw_greys(axes: Any, recovery: ColorRecovery, k: int) -> None:
    fit, greys = recovery.fit, recovery.chart.greys
    reference = fit.reference[greys] @ LUMINANCE
    off = 100 * (fit.corrected[k][greys] @ LUMINANCE / reference - 1)
    doubt = 100 * (fit.glare_std[k] @ LUMINANCE) / reference
    axes.axhline(0, color="black", lw=0.8)
    axes.errorbar(reference, off, doubt, fmt="o", ms=5, color="#444444", ecolor="#999999")
    axes.set_xscale("log")
    axes.set_xlabel("luminance of the reference (perfect white = 1)", fontsize=8)
    axes.set_ylabel("luminance off by (%); bars: glare's uncertainty", fontsize=8)
    axes.tick_params(labelsize=7)
    axes.grid(alpha=0.25)
    axes.set_title(
        f"greys, in even light without glare\nlinear at a power of {fit.exponent:.3f} ± {fit.exponent_std:.3f}",
        fontsize=9,
    )
