"""A picture of registered photographs: where the cameras stood, what they saw, and how well it agrees."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from capture.figures import short_name
from recon.poses.register.posesfile import Registration

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

Floats = NDArray[np.float64]

# Of the cloud so much is drawn: stray points would make the rest small.
_SHOWN = 0.98
_MOST_POINTS = 20_000


def pose_figure(found: Registration) -> Figure:
    """Cameras and points from above and from the side, and each photograph's distance from its points."""
    from matplotlib.figure import Figure

    unit = "m" if found.metric else "relative units"
    figure = Figure(figsize=(13, 5.2), dpi=110, layout="constrained")
    above, side, errors = figure.subplots(1, 3, width_ratios=[1, 1, 1.1])
    _draw_world(above, found, (0, 1), unit, "From above")
    _draw_world(side, found, (0, 2), unit, "From the side")
    handles, labels = above.get_legend_handles_labels()
    figure.legend(handles, labels, loc="outside lower center", ncols=3, fontsize=9, markerscale=2)
    _draw_errors(errors, found)
    return figure


def _draw_world(axes: Axes, found: Registration, plane: tuple[int, int], unit: str, title: str) -> None:
    first, second = plane
    points, colours = _shown(found)
    if len(points):
        axes.scatter(points[:, first], points[:, second], s=1, c=colours / 255, label="points")
    centres = -np.einsum("nji,nj->ni", found.poses[:, :3, :3], found.poses[:, :3, 3])
    forward = found.poses[:, 2, :3]
    length = 0.15 * float(np.ptp(centres, axis=0).max() or 1.0)
    axes.plot(centres[:, first], centres[:, second], "o", color="C0", markersize=4, label="cameras")
    axes.quiver(
        centres[:, first],
        centres[:, second],
        length * forward[:, first],
        length * forward[:, second],
        angles="xy",
        scale_units="xy",
        scale=1,
        color="C0",
        width=0.004,
    )
    axes.annotate(
        short_name(found.labels[0]),
        (centres[0, first], centres[0, second]),
        textcoords="offset points",
        xytext=(0, 7),
        ha="center",
        fontsize=8,
    )
    axes.plot(0, 0, "+", color="C3", markersize=12, label="the world's origin")
    axes.margins(0.12)
    axes.set_aspect("equal", adjustable="datalim")
    axes.set(xlabel=f"{'xyz'[first]} ({unit})", ylabel=f"{'xyz'[second]} ({unit})", title=title)


def _draw_errors(axes: Axes, found: Registration) -> None:
    names = [short_name(label) for label in found.labels]
    if found.rms_px is None:
        axes.text(
            0.5, 0.5, "how well pictures agree\nis not stated by the imported file", ha="center", va="center"
        )
        axes.set_axis_off()
        return
    numbers = np.arange(len(names))
    axes.bar(numbers, found.rms_px, color="C0")
    axes.set(ylabel="RMS distance from the points (px)", title="How well each photo agrees")
    axes.set_xticks(numbers, names, rotation=90, fontsize=8 if len(names) < 30 else 5)


def _shown(found: Registration) -> tuple[Floats, NDArray[np.uint8]]:
    points = found.points
    if not len(points):
        return points, found.colours
    off = np.linalg.norm(points - np.median(points, axis=0), axis=1)
    near = np.flatnonzero(off <= np.quantile(off, _SHOWN))
    some = near[np.linspace(0, len(near) - 1, min(len(near), _MOST_POINTS)).astype(int)]
    return points[some], found.colours[some]
