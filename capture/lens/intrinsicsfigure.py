"""A picture of a calibration: where corners were seen, how far they are from their predictions, what the lens does."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from capture.figures import printable
from capture.lens.distortion import displacement, picture_grid
from capture.lens.intrinsics import CameraCalibration

Floats = NDArray[np.float64]

_SEEN, _ERROR, _LENS, _DROPPED = "#1f77b4", "#d62728", "#7a7a7a", "#d62728"
# Long enough for every bar's name to be read.
_MAX_NAMED_VIEWS = 40


def intrinsics_figure(calibration: CameraCalibration) -> Any:
    """A matplotlib Figure of a calibration, its numbers in the title."""
    from matplotlib.figure import Figure

    figure = Figure(figsize=(12.5, 7.8), dpi=110, layout="constrained")
    axes = figure.subplot_mosaic(
        [["picture", "scatter"], ["picture", "views"]], width_ratios=[1.75, 1], height_ratios=[1, 1.1]
    )
    _draw_picture(axes["picture"], calibration)
    _draw_scatter(axes["scatter"], calibration)
    _draw_views(axes["views"], calibration)
    focal = ", ".join(
        f"{name} {value:.2f} ± {std:.2f}"
        for name, value, std in zip(calibration.param_names, calibration.params, calibration.std, strict=True)
        if name in ("f", "fx", "fy", "cx", "cy")
    )
    figure.suptitle(
        f"{calibration.lens.name}: {focal} px\nRMS {calibration.rms:.3f} px fitted,"
        f" {calibration.held_out_rms:.3f} px held out; {len(calibration.used)} of {len(calibration.views)} photos,"
        f" {sum(len(view.points) for view in calibration.used)} corners",
        fontsize=12,
    )
    return figure


def _draw_picture(axis: Any, calibration: CameraCalibration) -> None:
    points = np.concatenate([view.points for view in calibration.used])
    residuals = np.concatenate([view.residuals for view in calibration.used])
    width, height = calibration.width, calibration.height
    longest = float(np.percentile(np.linalg.norm(residuals, axis=1), 95))
    gain = _round_number(0.035 * max(width, height) / max(longest, 1e-9))
    _draw_lens(axis, calibration)
    axis.scatter(*points.T, s=7, color=_SEEN, alpha=0.55, linewidths=0, label="corners", zorder=3)
    axis.quiver(
        *points.T,
        *(gain * residuals).T,
        angles="xy",
        scale_units="xy",
        scale=1,
        width=0.0016,
        color=_ERROR,
        zorder=4,
        label=f"seen minus predicted, {gain:g} times as long",
    )
    x, y = calibration.camera.project(np.array([[0.0, 0, 1]]))[0]
    axis.plot(x, y, "+", color="black", markersize=14, markeredgewidth=1.5, label="principal point", zorder=5)
    axis.set_xlim(0, width)
    axis.set_ylim(height, 0)
    axis.set_aspect("equal")
    axis.set_xlabel("column (pixels)")
    axis.set_ylabel("row (pixels)")
    axis.set_title(
        f"corners of all photos cover {calibration.hull_share:.0%} of the picture and reach"
        f" {calibration.reach:.0%} of the way to its corners\ngrey: how far the lens moves the image (pixels)",
        fontsize=9,
    )
    axis.legend(loc="upper center", bbox_to_anchor=(0.5, -0.09), ncols=3, fontsize=8, frameon=False)


def _draw_lens(axis: Any, calibration: CameraCalibration) -> None:
    grid = picture_grid((calibration.width, calibration.height), 60)
    moved = displacement(calibration.camera, grid)
    if not np.nanmax(moved) > 0.01:
        return
    x, y = np.unique(grid[:, 0]), np.unique(grid[:, 1])
    levels = _levels(float(np.nanmax(moved)))
    lines = axis.contour(
        x, y, moved.reshape(len(y), len(x)), levels=levels, colors=_LENS, linewidths=0.8, linestyles="--"
    )
    axis.clabel(lines, fontsize=8, fmt="%g")


def _draw_scatter(axis: Any, calibration: CameraCalibration) -> None:
    residuals = np.concatenate([view.residuals for view in calibration.used])
    numbers = np.concatenate([np.full(len(view.points), k) for k, view in enumerate(calibration.used)])
    axis.scatter(*residuals.T, c=numbers, cmap="turbo", s=8, alpha=0.7, linewidths=0)
    turn = np.linspace(0, 2 * np.pi, 181)
    axis.plot(
        calibration.rms * np.cos(turn),
        calibration.rms * np.sin(turn),
        color="black",
        linewidth=1,
        label="RMS",
    )
    reach = 1.08 * float(np.abs(residuals).max())
    axis.set_xlim(-reach, reach)
    axis.set_ylim(reach, -reach)
    axis.set_aspect("equal")
    axis.axhline(0, color=_LENS, linewidth=0.5)
    axis.axvline(0, color=_LENS, linewidth=0.5)
    axis.set_xlabel("residual in x (pixels)")
    axis.set_ylabel("residual in y (pixels)")
    axis.set_title("residuals of all corners, one colour per photo", fontsize=9)
    axis.legend(fontsize=8, loc="upper right")


def _draw_views(axis: Any, calibration: CameraCalibration) -> None:
    shown = [view for view in calibration.views if view.rms is not None]
    shown.sort(key=lambda view: view.name)
    places = np.arange(len(shown))
    fitted = np.array([view.rms for view in shown], float)
    colours = [_SEEN if view.dropped is None else _DROPPED for view in shown]
    axis.bar(places, fitted, color=colours, width=0.75)
    held_out = [(k, view.held_out_rms) for k, view in enumerate(shown) if view.held_out_rms is not None]
    axis.plot(*np.array(held_out, float).T, "_", color="black", markersize=9)
    outlying = [k for k, view in enumerate(shown) if view.dropped is not None]
    # A view that is far off would leave the others flat.
    top = 1.25 * max(height for _, height in held_out)
    if fitted.max() > top:
        axis.set_ylim(0, 1.3 * top)
        for k in outlying:
            text = f"{fitted[k]:.2g} px"
            axis.annotate(
                text, (k, 1.27 * top), ha="center", va="top", rotation=90, fontsize=7, color="white"
            )
    if len(shown) <= _MAX_NAMED_VIEWS:
        axis.set_xticks(places, [_short(view.name) for view in shown], rotation=90, fontsize=7)
    else:
        axis.set_xlabel("photo, by name")
    axis.set_ylabel("RMS (pixels)")
    absent = len(calibration.views) - len(shown)
    without = "" if absent == 0 else f"\nnot shown: {absent} in which the board wasn't found"
    axis.set_title(f"each photo: bar fitted, dash held out, red outlier (not used){without}", fontsize=9)


def _short(name: str) -> str:
    return printable(name if len(name) <= 18 else f"{name[:8]}…{name[-9:]}")


def _round_number(value: float) -> float:
    """The largest of 1, 2 and 5 times a power of ten that isn't above a value."""
    power = 10.0 ** np.floor(np.log10(value))
    return float(max(step for step in (1, 2, 5) if step * power <= value * (1 + 1e-9)) * power)


def _levels(highest: float) -> list[float]:
    """Round numbers, about one for each doubling, below a highest one."""
    steps = [step * 10.0**power for power in range(-2, 5) for step in (1, 2, 5)]
    return [step for step in steps if highest / 100 <= step < highest]
