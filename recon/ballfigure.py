"""A picture of what was read off mirror balls: each ball, with what was found on it, beside its map."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from capture.camera import Camera
from capture.decode import RadianceImage, linear_to_srgb
from capture.lighting import latlong_pixels
from recon.mirrorball import BallLighting
from recon.reflection import mirroring_points
from recon.sphere import Sphere

Floats = NDArray[np.float64]

MAX_PANELS = 12
_MARK = "#ff9d00"
_OUTLINE = "#00c8ff"


@dataclass(frozen=True, eq=False)
class Panel:
    """One ball as it is drawn.

    crop : (h, w, 3) radiance about the ball. corner : (x, y), the pixel where the crop begins.
    outline : (n, 2) and marks : (k, 2), image points in pixels of the whole photograph.
    """

    ball: BallLighting
    crop: NDArray[np.float32]
    corner: tuple[int, int]
    outline: Floats
    marks: Floats


def panel(ball: BallLighting, image: RadianceImage, camera: Camera) -> Panel:
    """What a figure needs of one photograph, without the photograph."""
    outline = outline_points(ball.sphere, camera)
    margin = 0.08 * np.ptp(outline, axis=0).max()
    low = np.maximum(np.floor(outline.min(axis=0) - margin).astype(int), 0)
    high = np.ceil(outline.max(axis=0) + margin).astype(int)
    directions = np.array([source.direction for source in ball.sources]).reshape(-1, 3)
    return Panel(
        ball=ball,
        crop=image.radiance[low[1] : high[1], low[0] : high[0]],
        corner=(int(low[0]), int(low[1])),
        outline=outline,
        marks=mirroring_points(ball.sphere, camera, directions)[1],
    )


def outline_points(sphere: Sphere, camera: Camera, count: int = 181) -> Floats:
    """Image points (count, 2) around a sphere's outline: the circle in which the camera's rays touch it."""
    axis, nearness = -camera.camera_to_world[:3, 2], 0.0
    if not camera.is_orthographic:
        offset = camera.centre - sphere.centre
        axis, nearness = offset / np.linalg.norm(offset), sphere.radius / float(np.linalg.norm(offset))
    first = np.cross(axis, np.eye(3)[np.argmin(np.abs(axis))])
    first /= np.linalg.norm(first)
    second = np.cross(axis, first)
    turn = np.linspace(0, 2 * np.pi, count)[:, None]
    normals = nearness * axis + np.sqrt(1 - nearness**2) * (np.cos(turn) * first + np.sin(turn) * second)
    return camera.project(sphere.centre + sphere.radius * normals)


def ball_figure(panels: Sequence[Panel], frame: str) -> Any:
    """A matplotlib Figure of at most `MAX_PANELS` balls. frame : what the world's axes are, in words."""
    from matplotlib.figure import Figure

    across = 1 if len(panels) <= 3 else 2
    down = -(-len(panels) // across)
    figure = Figure(figsize=(8.4 * across, 3.1 * down + 1.1), dpi=110, layout="constrained")
    axes = figure.subplots(down, 2 * across, squeeze=False, width_ratios=[1, 2.2] * across)
    for axis in axes.flat[2 * len(panels) :]:
        axis.set_visible(False)
    for index, drawn in enumerate(panels):
        _draw_ball(axes.flat[2 * index], drawn)
        _draw_map(axes.flat[2 * index + 1], drawn.ball)
    figure.suptitle(
        "Light read off mirror balls. Left: the ball, its fitted outline (blue), sources (orange, *: clipped)"
        f"\nRight: the other light, sources taken out; hatched: not seen. World: {frame}",
        fontsize=10,
    )
    return figure


def _draw_ball(axis: Any, drawn: Panel) -> None:
    height, width = drawn.crop.shape[:2]
    x, y = drawn.corner
    picture, gain = tone_mapped(drawn.crop)
    axis.imshow(picture, extent=(x, x + width, y + height, y), interpolation="nearest")
    axis.plot(*drawn.outline.T, color=_OUTLINE, linewidth=1.0)
    axis.set_xlim(x, x + width)
    axis.set_ylim(y + height, y)
    _mark(axis, drawn.marks[:, 0], drawn.marks[:, 1], drawn.ball)
    axis.set_title(f"{drawn.ball.name}{_gain_text(gain)}", fontsize=9)
    axis.tick_params(labelsize=7)
    axis.set_xlabel("column (pixels)", fontsize=7)
    axis.set_ylabel("row (pixels)", fontsize=7)


def _draw_map(axis: Any, ball: BallLighting) -> None:
    height = len(ball.radiance_map)
    picture, gain = tone_mapped(ball.radiance_map)
    axis.imshow(picture, extent=(0, 360, 180, 0), interpolation="nearest", aspect="equal")
    step = 180 / height
    phi, theta = (np.arange(2 * height) + 0.5) * step, (np.arange(height) + 0.5) * step
    if not ball.coverage.all():
        grey = np.full((height, 2 * height, 4), 0.45)
        grey[..., 3] = ~ball.coverage * 0.6
        axis.imshow(grey, extent=(0, 360, 180, 0), interpolation="nearest", aspect="equal")
        hatching = axis.contourf(
            phi, theta, ~ball.coverage, levels=[0.5, 1.5], colors="none", hatches=["////"]
        )
        hatching.set_edgecolor("#c0c0c0")
        hatching.set_linewidth(0)
    directions = np.array([source.direction for source in ball.sources]).reshape(-1, 3)
    rows, columns = latlong_pixels(directions, height)
    _mark(axis, columns * step, rows * step, ball)
    axis.set_xticks(range(0, 361, 45))
    axis.set_yticks(range(0, 181, 45))
    axis.tick_params(labelsize=7)
    axis.set_xlabel("phi (degrees from +X towards +Y)", fontsize=7)
    axis.set_ylabel("theta (degrees from +Z)", fontsize=7)
    unseen = f"{ball.uncovered_share:.0%} of all directions not seen"
    axis.set_title(f"map, {unseen}{_gain_text(gain)}", fontsize=9)


def _mark(axis: Any, x: Floats, y: Floats, ball: BallLighting) -> None:
    from matplotlib.patheffects import withStroke

    axis.scatter(x, y, s=90, marker="o", facecolors="none", edgecolors=_MARK, linewidths=1.5)
    for number, (across, down, source) in enumerate(zip(x, y, ball.sources, strict=True), start=1):
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


def _gain_text(gain: float) -> str:
    return "" if 0.8 < gain < 1.25 else f"  (shown x {gain:.2g})"


def tone_mapped(radiance: NDArray[np.floating]) -> tuple[Floats, float]:
    """A picture (h, w, 3) in 0 to 1 of linear radiance, and the gain that it is shown with.

    The gain takes the 99th percentile to white, so that a dark room beside a lamp can still be seen.
    """
    white = float(np.percentile(radiance.max(axis=2), 99))
    gain = 1 / white if white > 0 else 1.0
    return linear_to_srgb(np.clip(np.asarray(radiance, float) * gain, 0, 1)), gain
