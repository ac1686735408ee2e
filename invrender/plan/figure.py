"""A plan as a picture: what will be known, where a further photograph helps, and how much of the light shows."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from capture.figures import printable
from capture.lighting import latlong_directions
from invrender.plan.advice import Advice, TriedPhotos
from invrender.plan.experiment import angles_deg
from invrender.plan.light_prospect import DETERMINED
from invrender.plan.planning import Plan
from invrender.plan.prospect import Expected
from invrender.plan.summary import shown_quantities

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

Floats = NDArray[np.float64]

_MAP_HEIGHT = 90
# Between the directions that were tried gains are blended over about their distance, radians.
_BLEND = 0.15
# Gains beyond this are drawn on a logarithmic scale. Of many lightings and sources so many are drawn.
_WIDE = 5.0
# Less than this isn't worth a colour.
_LEAST_SCALE = 1.25
_MOST_LIGHTS, _MOST_SOURCES = 6, 20


def plan_figure(plan: Plan, advice: Advice) -> Figure:
    """Expected relative deviations; gain over directions of views and of lights; determined share per degree."""
    from matplotlib.figure import Figure

    figure = Figure(figsize=(14, 8.6), dpi=110, layout="constrained")
    figure.suptitle(printable(f"{plan.experiment.name}: what will be known, and what would help"))
    grid = figure.add_gridspec(2, 2, height_ratios=[1, 1.1])
    if plan.lights:
        _draw_quantities(figure.add_subplot(grid[0, 0]), plan, advice)
        _draw_light(figure.add_subplot(grid[0, 1]), plan)
    else:
        _draw_quantities(figure.add_subplot(grid[0, :]), plan, advice)
    for column, (kind, trial) in enumerate((("view", advice.view), ("lamp", advice.lamp))):
        axes = figure.add_subplot(grid[1, column], projection="mollweide")
        _draw_gains(figure, axes, plan, advice.target, kind, trial)
    return figure


def _draw_quantities(axes: Axes, plan: Plan, advice: Advice) -> None:
    now = shown_quantities(plan)
    series = [("now", now, "o", "C0"), ("every photograph twice", plan.repeated, "d", "C7")]
    series.append(("one view more", advice.view.best.expected, "<", "C2"))
    series.append(("one lamp more", advice.lamp.best.expected, "*", "C1"))
    heights = np.arange(len(now))[::-1]
    for index, (label, expected, marker, colour) in enumerate(series):
        by_name = {one.name: one for one in expected}
        # One below the other, for they often agree.
        at = heights + 0.24 - 0.16 * index
        for height, one in zip(at, (by_name[one.name] for one in now), strict=True):
            filled = colour if one.quantity.status != "undetermined" else "white"
            axes.plot(100 * one.relative, height, marker, color=colour, markerfacecolor=filled, markersize=8)
        axes.plot([], [], marker, color=colour, label=label, linestyle="none")
    axes.plot(
        [], [], "o", color="C0", markerfacecolor="white", label="hollow: undetermined", linestyle="none"
    )
    for edge in heights[:-1] - 0.5:
        axes.axhline(edge, color="0.85", linewidth=0.8, zorder=0)
    axes.set_xscale("log")
    axes.xaxis.set_major_formatter("{x:g}")
    axes.axvline(10, color="C3", linestyle=":", linewidth=1, label="from here on weak")
    axes.set_yticks(heights, [printable(one.label) for one in now])
    axes.set_ylim(-0.6, len(now) - 0.4)
    axes.set(xlabel="expected standard deviation (% of the quantity)", title="What will be known")
    axes.legend(loc="center left", bbox_to_anchor=(1.01, 0.5), fontsize=8)


def _draw_light(axes: Axes, plan: Plan) -> None:
    for index, prospect in enumerate(plan.lights[:_MOST_LIGHTS]):
        name = printable(
            f"{prospect.name}: {prospect.effective_rank:.0f} of {(prospect.l_max + 1) ** 2} coefficients"
        )
        degrees = np.arange(prospect.l_max + 1)
        axes.plot(degrees, 100 * prospect.shares, "o-", color=f"C{index}", label=name)
    axes.axhline(100 * DETERMINED, color="C3", linestyle=":", linewidth=1, label="from here on determined")
    axes.set_xticks(np.arange(plan.lights[0].l_max + 1))
    axes.set(xlabel="degree of the light", ylabel="determined share (%)", ylim=(-4, 106))
    axes.set_title("Unknown light, by degree of its harmonics")
    axes.legend(loc="best", fontsize=8)


def _draw_gains(
    figure: Figure, axes: Axes, plan: Plan, target: Expected, kind: str, trial: TriedPhotos
) -> None:
    from matplotlib.colors import LogNorm, Normalize

    blended = _blended(*trial.gains(target))
    highest = max(float(blended.max()), _LEAST_SCALE)
    norm = (LogNorm if highest > _WIDE else Normalize)(1, highest)
    # From -180 to 180 degrees of azimuth, where a lat-long map runs from 0 to 360.
    azimuth = (np.arange(2 * _MAP_HEIGHT) + 0.5) * np.pi / _MAP_HEIGHT - np.pi
    elevation = np.pi / 2 - (np.arange(_MAP_HEIGHT) + 0.5) * np.pi / _MAP_HEIGHT
    values = np.roll(np.maximum(blended, 1), _MAP_HEIGHT, axis=1)
    drawn = axes.pcolormesh(azimuth, elevation, values, norm=norm, cmap="viridis", shading="nearest")
    what = printable(f"what photographs change of the std of {target.label}: now, over that with it")
    figure.colorbar(drawn, ax=axes, orientation="horizontal", shrink=0.8, pad=0.12).set_label(
        what, fontsize=9
    )
    experiment = plan.experiment
    views = [experiment.direction(view) for view in experiment.views]
    _mark(axes, views, ".", "white", "photographs")
    sources = [one for light in experiment.lights for one in light.lighting.directions]
    _mark(axes, sources[:_MOST_SOURCES], "*", "gold", "sources")
    best = trial.best.place
    _mark(axes, [best.direction], "o", "red", f"best {kind}", hollow=True)
    if best.viewpoint is not None:
        _mark(axes, [views[best.viewpoint]], "s", "red", "photographed from here", hollow=True)
    axes.grid(alpha=0.3)
    axes.tick_params(labelsize=7, labelcolor="0.5")
    where = "from azimuth, elevation" if kind == "view" else "towards azimuth, elevation"
    axes.set_title(f"One {kind} more: {where}")
    axes.legend(loc="upper center", bbox_to_anchor=(0.5, -0.02), ncols=4, fontsize=7, facecolor="0.75")


def _blended(directions: Floats, gains: Floats) -> Floats:
    """A lat-long map of the gains that were tried. Gains are factors: their logarithms are blended."""
    pixels = latlong_directions(_MAP_HEIGHT)
    weights = np.exp((pixels.reshape(-1, 3) @ directions.T - 1) / _BLEND**2)
    blended = np.exp(weights @ np.log(gains) / weights.sum(axis=1))
    return np.asarray(blended.reshape(pixels.shape[:2]))


def _mark(
    axes: Axes, directions: Sequence[Floats], marker: str, colour: str, label: str, hollow: bool = False
) -> None:
    if not directions:
        return
    angles = np.radians([angles_deg(direction) for direction in directions])
    style: dict[str, Any] = {"facecolors": "none", "edgecolors": colour, "linewidths": 2, "s": 110}
    if not hollow:
        style = {"c": colour, "edgecolors": "black", "linewidths": 0.5, "s": 90 if marker == "*" else 40}
    axes.scatter(angles[:, 0], angles[:, 1], marker=marker, label=label, clip_on=False, **style)
