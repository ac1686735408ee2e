"""Prefiltered light as a picture: the light, its maps, a ball, and how far they can be off."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from capture.figures import printable
from capture.srgb import linear_to_srgb
from invrender.inverse_lighting.figure import draw_map, white_level
from invrender.prefilter.energy import energy_fraction, isotropic_power
from invrender.prefilter.prefiltered import PrefilteredLight, PrefilteredLobe

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

Floats = NDArray[np.float64]

_SIDE = 256
_COLOURS = ("#0072B2", "#D55E00", "#009E73", "#CC79A7")


def prefilter_figure(
    name: str, radiance_map: NDArray[np.floating], found: PrefilteredLight, viewer: Floats
) -> Figure:
    """The light, each lobe's map for a distant viewer (3,), unit, the ball that this one sees, energies, errors."""
    from matplotlib.figure import Figure

    columns = len(found.lobes) + 2
    figure = Figure(figsize=(4.6 * columns, 6.6), dpi=90, layout="constrained")
    figure.suptitle(printable(f"{name}, prefiltered for {found.brdf.description}"))
    above, below = figure.subfigures(2, 1, squeeze=False)[:, 0]
    panels = above.subplots(1, columns)
    light = np.asarray(radiance_map, float)
    draw_map(panels[0], light, white_level(light), "light")
    for axes, each in zip(panels[1:], found.lobes, strict=False):
        values = each.seen_from(viewer).transpose(1, 2, 0).astype(float)
        f, p = each.orders
        draw_map(axes, values, white_level(values), f"{each.lobe.name}: F = {f}, P = {p}, {len(values)} rows")
    _draw_object(panels[-1], found, viewer)
    energies, errors = below.subplots(1, 2)
    _draw_energies(energies, found.lobes)
    _draw_errors(errors, found)
    return figure


def object_picture(found: PrefilteredLight, viewer: Floats, side: int) -> Floats:
    """Radiance (side, side, 3) of a ball from afar, NaN around it; of tangents that are combed from its top down."""
    axes, inside = ball_axes(viewer, side, found.brdf.axis == "tangent")
    picture = np.full((side, side, 3), np.nan)
    picture[inside] = found.radiance(axes, np.broadcast_to(viewer, axes.shape))
    return picture


def ball_axes(viewer: Floats, side: int, is_combed: bool) -> tuple[Floats, NDArray[np.bool_]]:
    """Normals (n, 3) of a ball's pixels, or its tangents away from +Z, and which pixels (side, side) it covers."""
    across, up = np.meshgrid(*2 * [(np.arange(side) + 0.5) / side * 2 - 1])
    inside = across**2 + up**2 < 1
    right = np.cross([0.0, 0, 1], viewer)
    # Straight from above, +X is to the right.
    right = np.array([1.0, 0, 0]) if np.linalg.norm(right) < 1e-6 else right / np.linalg.norm(right)
    frame = np.stack([right, np.cross(viewer, right), viewer])
    x, y = across[inside], -up[inside]
    normals = np.stack([x, y, np.sqrt(1 - x**2 - y**2)], axis=-1) @ frame
    if not is_combed:
        return normals, inside
    down = normals * normals[:, 2:] - np.array([0.0, 0, 1])
    return down / np.maximum(np.linalg.norm(down, axis=1, keepdims=True), 1e-12), inside


def draw_picture(axes: Axes, picture: Floats, white: float, title: str) -> None:
    """A picture (h, w, 3) through the sRGB curve; transparent where it is NaN."""
    inside = np.isfinite(picture[..., :1])
    shown = linear_to_srgb(np.clip(np.nan_to_num(picture) / white, 0, 1))
    axes.imshow(np.concatenate([shown, inside], axis=-1), interpolation="nearest")
    axes.set_axis_off()
    axes.set_title(title)


def _draw_object(axes: Axes, found: PrefilteredLight, viewer: Floats) -> None:
    picture = object_picture(found, viewer, _SIDE)
    white = max(float(np.nanpercentile(picture, 99.5)), 1e-12)
    elevation = np.degrees(np.arcsin(np.clip(viewer[2], -1, 1)))
    azimuth = np.degrees(np.arctan2(viewer[1], viewer[0]))
    draw_picture(axes, picture, white, f"seen from azimuth {azimuth:.0f}°, elevation {elevation:.0f}°")


def _draw_energies(axes: Axes, lobes: Sequence[PrefilteredLobe]) -> None:
    for each, colour in zip(lobes, _COLOURS, strict=False):
        power = np.mean([isotropic_power(rho) for rho in each.rho], axis=0)
        # Of what the map holds, which is all but `left_out`.
        share = (1 - each.left_out) * energy_fraction(power.sum(axis=1), power.sum())
        axes.plot(100 * share, marker=".", color=colour, label=each.lobe.name)
    axes.axhline(100, color="#666666", linewidth=0.8)
    axes.set(xlabel="degree l", ylabel="share of the energy up to l [%]", title="what the maps hold")
    axes.legend(loc="lower right")


def _draw_errors(axes: Axes, found: PrefilteredLight) -> None:
    bound, angles = found.bound, np.degrees(np.arccos(found.bound.cos_angles))
    for values, label, colour in (
        (bound.reflected, "reflected (RMS)", "#000000"),
        (bound.largest, "nowhere more than", "#D55E00"),
        (bound.rms, "left out (RMS)", "#0072B2"),
    ):
        axes.semilogy(angles, np.maximum(values.mean(axis=1), 1e-12), color=colour, label=label)
    what = "normal" if found.brdf.axis == "normal" else "tangent"
    axes.set(
        xlabel=f"angle between view and {what} (degrees)", ylabel="radiance", title="how far they can be off"
    )
    axes.legend(loc="best")
