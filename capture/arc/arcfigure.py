"""A picture of a calibrated arc: where the cameras stood, and how well the arc explains what they saw."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from capture.arc.arcfit import ArcFit
from capture.arc.gantrycalibration import GantryCalibration
from capture.figures import short_name

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

Floats = NDArray[np.float64]


def arc_figure(found: GantryCalibration) -> Figure:
    """Figure of an arc, seen along its axis, and of the residuals of its photographs."""
    from matplotlib.figure import Figure

    fit, nominal = found.fit, found.nominal
    names = [short_name(name) for name in found.names]

    figure = Figure(figsize=(12, 5), dpi=110, layout="constrained")
    left, upper, lower = figure.subplot_mosaic(
        [["arc", "angles"], ["arc", "pixels"]], width_ratios=[1, 1.4]
    ).values()
    _draw_arc(left, fit)
    _draw_angles(upper, fit, nominal)
    numbers = np.arange(len(names))
    lower.bar(numbers - 0.2, fit.rms_px, 0.4, label="on the arc")
    lower.bar(numbers + 0.2, fit.free_rms_px, 0.4, label="with its own pose")
    lower.set(ylabel="corners' RMS distance (px)", title="How well the arc explains each photo")
    lower.set_xticks(
        numbers, names, rotation=90 if len(names) > 6 else 0, fontsize=8 if len(names) < 30 else 5
    )
    lower.legend()
    return figure


def _draw_arc(axes: Axes, fit: ArcFit) -> None:
    arc = fit.arc
    turn = np.linspace(0, 2 * np.pi, 361)
    axes.plot(arc.radius * np.cos(turn), arc.radius * np.sin(turn), color="0.8", zorder=0)
    x, y = arc.radius * np.cos(fit.angles), arc.radius * np.sin(fit.angles)
    axes.plot(x, y, "o", color="C0", label="camera")
    forward = np.array([arc.pose(angle)[2, :3] for angle in fit.angles])
    across = np.cross(arc.axis, arc.start)
    length = 0.25 * arc.radius
    axes.quiver(
        x,
        y,
        length * forward @ arc.start,
        length * forward @ across,
        angles="xy",
        scale_units="xy",
        scale=1,
        color="C0",
        width=0.004,
    )
    axes.plot(0, 0, "+", color="C3", markersize=12, label="axis (towards the viewer)")
    axes.annotate("angle 0", (arc.radius, 0), textcoords="offset points", xytext=(6, 4), fontsize=8)
    axes.set_aspect("equal")
    axes.set(
        xlabel="along the start direction (m)",
        ylabel="a quarter turn on (m)",
        title="The arc, seen along its axis",
    )
    axes.legend(loc="lower left", fontsize=8)


def _draw_angles(axes: Axes, fit: ArcFit, nominal: Floats | None) -> None:
    numbers = np.arange(len(fit.angles))
    reference, what = np.polynomial.Polynomial.fit(numbers, fit.angles, 1)(numbers), "equal steps"
    if nominal is not None:
        reference, what = nominal, "the gantry's own reading"
    axes.axhline(0, color="0.8", zorder=0)
    deviation, std = np.degrees(fit.angles - reference), np.degrees(fit.angle_std)
    axes.errorbar(numbers, deviation, 2 * std, fmt="o", capsize=3)
    axes.set(ylabel="deviation (degrees)", title=f"Angles against {what} (bars: two standard deviations)")
    axes.set_xticks([])
