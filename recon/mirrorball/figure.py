"""A picture of what was read off mirror balls: each ball, with what was found on it, beside its map."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from capture.lighting import latlong_pixels
from capture.radiance import RadianceImage
from capture.srgb import linear_to_srgb
from recon.mirrorball.light import BallLighting
from recon.mirrorball.reflection import mirroring_points
from recon.mirrorball.view import BallSource, BallView
from recon.sphere.sphere import sphere_outline

Floats = NDArray[np.float64]

MAX_PANELS = 12
_MARK = "#ff9d00"
_OUTLINE = "#00c8ff"
_CAMERA = "#ff4fd8"


@dataclass(frozen=True, eq=False)
class ViewPanel:
    """One view as it is drawn.

    crop : (h, w, 3) radiance about the ball. corner : (x, y), the pixel where the crop begins.
    outline : (n, 2) and marks : (k, 2), image points in pixels of the whole photograph.
    """

    view: BallView
    crop: NDArray[np.float32]
    corner: tuple[int, int]
    outline: Floats
    marks: Floats

    def of(self, view: BallView) -> ViewPanel:
        """The same picture of the same view, turned."""
        return replace(self, view=view)


def panel(view: BallView, image: RadianceImage) -> ViewPanel:
    """What a figure needs of one view, without the photograph."""
    outline = sphere_outline(view.sphere, view.camera, 181)
    margin = 0.08 * np.ptp(outline, axis=0).max()
    low = np.maximum(np.floor(outline.min(axis=0) - margin).astype(int), 0)
    high = np.ceil(outline.max(axis=0) + margin).astype(int)
    directions = np.array([source.direction for source in view.sources]).reshape(-1, 3)
    return ViewPanel(
        view=view,
        crop=image.radiance[low[1] : high[1], low[0] : high[0]],
        corner=(int(low[0]), int(low[1])),
        outline=np.vstack([outline, outline[:1]]),
        marks=mirroring_points(view.sphere, view.camera, directions)[1],
    )


def ball_figure(
    panels: Sequence[ViewPanel],
    singles: Sequence[BallLighting],
    merged: BallLighting | None,
    frame: str,
    upright: bool,
) -> Any:
    """A matplotlib Figure of at most `MAX_PANELS` views, each with its map, and of the merged map beneath.

    frame : what the world's axes are, in words. upright : they are x right, y up, z to the (first) camera; maps are
    then drawn upright, and otherwise as they are stored.
    """
    from matplotlib.figure import Figure

    panels, singles = panels[:MAX_PANELS], singles[:MAX_PANELS]
    across = 1 if len(panels) <= 3 else 2
    down = -(-len(panels) // across)
    extra = 0.0 if merged is None else 4.4 * across
    figure = Figure(figsize=(8.4 * across, 3.1 * down + extra + 1.1), dpi=110, layout="constrained")
    rows: Any = (
        figure.subfigures(2, 1, height_ratios=[3.1 * down + 1.1, extra]) if merged is not None else [figure]
    )
    above = rows[0]
    axes = above.subplots(down, 2 * across, squeeze=False, width_ratios=[1, 2.2] * across)
    for axis in axes.flat[2 * len(panels) :]:
        axis.set_visible(False)
    for index, (drawn, ball) in enumerate(zip(panels, singles, strict=True)):
        _draw_ball(axes.flat[2 * index], drawn)
        _draw_map(axes.flat[2 * index + 1], ball, "map", upright)
    if merged is not None:
        _draw_map(rows[1].subplots(), merged, f"all {len(merged.agreement) or 1} views merged", upright)
    how = " drawn upright" if upright else ""
    figure.suptitle(
        "Light read off mirror balls. Left: the ball, its fitted outline (blue), the masked camera (pink),"
        f" sources (orange, *: clipped)\nRight: the other light{how}, sources taken out; hatched: not seen."
        f" Tone-mapped.\nWorld: {frame}",
        fontsize=10,
    )
    return figure


def _draw_ball(axis: Any, drawn: ViewPanel) -> None:
    height, width = drawn.crop.shape[:2]
    x, y = drawn.corner
    axis.imshow(tone_mapped(drawn.crop), extent=(x, x + width, y + height, y), interpolation="nearest")
    axis.plot(*drawn.outline.T, color=_OUTLINE, linewidth=1.0)
    masked = drawn.view.in_camera_mask
    if masked.any():
        left, top = drawn.view.corner
        columns, rows = np.arange(masked.shape[1]) + left + 0.5, np.arange(masked.shape[0]) + top + 0.5
        axis.contour(columns, rows, masked, levels=[0.5], colors=_CAMERA, linewidths=0.8)
    axis.set_xlim(x, x + width)
    axis.set_ylim(y + height, y)
    _mark(axis, drawn.marks[:, 0], drawn.marks[:, 1], drawn.view.sources)
    axis.set_title(drawn.view.name, fontsize=9)
    axis.tick_params(labelsize=7)
    axis.set_xlabel("column (pixels)", fontsize=7)
    axis.set_ylabel("row (pixels)", fontsize=7)


def _draw_map(axis: Any, ball: BallLighting, what: str, upright: bool) -> None:
    """A map as it is stored, or upright as a panorama: what was behind the ball in the middle."""
    height = len(ball.radiance_map)
    radiance, coverage = ball.radiance_map, ball.coverage
    directions = np.array([source.direction for source in ball.sources]).reshape(-1, 3)
    x, y = np.meshgrid((np.arange(2 * height) + 0.5) * 180 / height, (np.arange(height) + 0.5) * 180 / height)
    extent = (0.0, 360.0, 180.0, 0.0)
    if upright:
        x, y, extent = x - 180, 90 - y, (-180.0, 180.0, -90.0, 90.0)
        row, column = latlong_pixels(_panorama(np.radians(x), np.radians(y)), height)
        row, column = np.minimum(row.astype(int), height - 1), column.astype(int) % (2 * height)
        radiance, coverage = radiance[row, column], coverage[row, column]
        across = np.degrees(np.arctan2(directions[:, 0], -directions[:, 2]))
        up = np.degrees(np.arcsin(np.clip(directions[:, 1], -1, 1)))
    else:
        up, across = (pixels * 180 / height for pixels in latlong_pixels(directions, height))
    axis.imshow(tone_mapped(radiance), extent=extent, interpolation="nearest", aspect="equal")
    if not coverage.all():
        grey = np.full((*coverage.shape, 4), 0.45)
        grey[..., 3] = ~coverage * 0.6
        axis.imshow(grey, extent=extent, interpolation="nearest", aspect="equal")
        hatching = axis.contourf(x, y, ~coverage, levels=[0.5, 1.5], colors="none", hatches=["////"])
        hatching.set_edgecolor("#c0c0c0")
        hatching.set_linewidth(0)
    _mark(axis, across, up, ball.sources)
    axis.set_xticks(range(int(extent[0]), int(extent[1]) + 1, 45))
    axis.set_yticks(range(int(min(extent[2:])), int(max(extent[2:])) + 1, 45))
    axis.tick_params(labelsize=7)
    if upright:
        axis.set_xlabel("degrees to the right of what the camera looks at; the camera is at ±180", fontsize=7)
        axis.set_ylabel("degrees up", fontsize=7)
    else:
        axis.set_xlabel("phi (degrees from +X towards +Y)", fontsize=7)
        axis.set_ylabel("theta (degrees from +Z)", fontsize=7)
    unseen = f"{ball.uncovered_share:.1%} of all directions not seen"
    axis.set_title(f"{what}, {unseen}", fontsize=9)


def _panorama(right: Floats, up: Floats) -> Floats:
    """Directions (..., 3), x right, y up, z to the camera, at angles to the right of -z and up."""
    return np.stack([np.sin(right) * np.cos(up), np.sin(up), -np.cos(right) * np.cos(up)], axis=-1)


def _mark(axis: Any, x: Floats, y: Floats, sources: Sequence[BallSource]) -> None:
    from matplotlib.patheffects import withStroke

    axis.scatter(x, y, s=90, marker="o", facecolors="none", edgecolors=_MARK, linewidths=1.5)
    for number, (across, down, source) in enumerate(zip(x, y, sources, strict=True), start=1):
        axis.annotate(
            f"{number}*" if source.clipped else f"{number}",
            (across, down),
            xytext=(7, -4),
            textcoords="offset points",
            va="top",
            color=_MARK,
            fontsize=8,
            path_effects=[withStroke(linewidth=2, foreground="black")],
        )


def tone_mapped(radiance: NDArray[np.floating]) -> Floats:
    """A picture (h, w, 3) in 0 to 1 of linear radiance, in which a dark room beside a lamp can still be seen.

    E. Reinhard et al., "Photographic tone reproduction for digital images", 2002, eq. 4, on the brightest channel
    so that colours stay; the 99.5th percentile becomes white, the logarithmic mean middle grey.
    """
    bright = np.maximum(radiance.max(axis=2).astype(float), 0)
    white = float(np.percentile(bright, 99.5))
    if not white > 0:
        return np.zeros(radiance.shape)
    key = float(np.exp(np.log(np.maximum(bright, 1e-4 * white)).mean()))
    scaled, top = 0.18 * bright / key, 0.18 * white / key
    mapped = scaled * (1 + scaled / top**2) / (1 + scaled)
    return linear_to_srgb(np.clip(radiance * (mapped / np.maximum(bright, 1e-12))[..., None], 0, 1))
