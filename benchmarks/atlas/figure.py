"""Charts of sweeps: errors and standard deviations on both sides of a boundary, and what the fit said of them."""

from __future__ import annotations

from textwrap import fill

import numpy as np
from matplotlib.axes import Axes
from matplotlib.colors import ListedColormap
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.ticker import LogLocator, NullFormatter
from numpy.typing import NDArray

from benchmarks.atlas.light import LIGHT_DEGREE
from benchmarks.atlas.sweep import Sweep
from benchmarks.ink import BLUE, GREEN, GREY, ORANGE, SKY

Floats = NDArray[np.float64]

_STATUSES = {"determined": GREEN, "weak": SKY, "undetermined": ORANGE, "absent": "#CCCCCC"}
_UNITS = {"Ks share": "", "mu": "", "sigma": " [rad]", "sources": " [degrees]"}
# That fit below a panel.
_LABEL_LETTERS = 44


def sweep_figure(sweep: Sweep) -> Figure:
    """One chart of a boundary."""
    if sweep.boundary.name == LIGHT_DEGREE.name:
        return _degree_figure(sweep)
    count = len(sweep.boundary.quantities)
    figure = Figure(figsize=(3.7 * count + 0.6, 5.2), layout="constrained")
    rows = figure.subplots(2, count, sharex="col", height_ratios=(4, 1), squeeze=False)
    for q, name in enumerate(sweep.boundary.quantities):
        _draw_errors(rows[0, q], sweep, q)
        _draw_statuses(rows[1, q], sweep, q)
        rows[0, q].set_title(name, fontsize=10)
        rows[0, q].set_ylabel(f"|error|, standard deviation{_UNITS.get(name, '')}")
    rows[1, 0].set_ylabel("draws")
    _entitle(figure, sweep)
    _legend(figure, sweep)
    return figure


def _draw_errors(axes: Axes, sweep: Sweep, q: int) -> None:
    at = sweep.at
    for draw in range(sweep.error.shape[1]):
        error, stated = np.abs(sweep.error[:, draw, q]), sweep.stated[:, draw, q]
        missed = stated & ~(np.abs(sweep.scores[:, draw, q]) < 1.96)
        axes.plot(at[stated], error[stated], "o", color=BLUE, markersize=4, alpha=0.7)
        axes.plot(at[~stated], error[~stated], "o", color=BLUE, markersize=4, fillstyle="none", alpha=0.7)
        axes.plot(at[missed], error[missed], "x", color="black", markersize=8)
    axes.plot(at, _middle(sweep.std[:, :, q]), "-s", color=GREEN, markersize=3)
    axes.plot(at, sweep.expected_std[:, q], "--", color=ORANGE)
    axes.set_yscale("log")
    _bottom(axes, sweep, q)
    _draw_edge(axes, sweep)


def _entitle(figure: Figure, sweep: Sweep) -> None:
    figure.suptitle(f"{sweep.boundary.title}\n{fill(sweep.boundary.says, 110)}", fontsize=10)


def _bottom(axes: Axes, sweep: Sweep, q: int) -> None:
    """A decade and a half below the smallest bar, errors are zero by luck."""
    bars = np.concatenate([sweep.std[:, :, q].ravel(), sweep.expected_std[:, q]])
    bars = bars[np.isfinite(bars) & (bars > 0)]
    if len(bars):
        axes.set_ylim(bottom=bars.min() / 30)


def _draw_statuses(axes: Axes, sweep: Sweep, q: int) -> None:
    """How many draws had which status, and how many of the stated intervals hold the truth."""
    draws, places = sweep.status.shape[1], np.arange(len(sweep.at))
    at = sweep.at
    edges = np.exp(_edges(np.log(at))) if sweep.boundary.log else _edges(at)
    below = np.zeros(len(at))
    for status, colour in _STATUSES.items():
        share = (sweep.status[:, :, q] == status).sum(axis=1)
        axes.bar(edges[:-1], share, np.diff(edges), below, color=colour, align="edge", edgecolor="white")
        below = below + share
    for place in places:
        covered, stated = sweep.covered[place, q], sweep.stated[place, :, q].sum()
        if stated:
            hits = round(covered * stated)
            axes.annotate(f"{hits}/{stated}", (at[place], draws / 2), ha="center", va="center", fontsize=7)
    axes.set(xlabel=fill(sweep.boundary.axis, _LABEL_LETTERS), ylim=(0, draws), yticks=(0, draws))
    axes.xaxis.label.set_size(8)
    _draw_edge(axes, sweep)


def _draw_edge(axes: Axes, sweep: Sweep) -> None:
    if sweep.boundary.edge is not None:
        axes.axvline(sweep.boundary.edge, color=GREY, linestyle=":", linewidth=1.5)
    if sweep.boundary.log:
        axes.set_xscale("log")
        # In plain numbers, and few: less than a decade is swept at times, and nearly three.
        first, last = axes.get_xlim()
        axes.xaxis.set_major_locator(LogLocator(subs=(1, 2, 5) if last < 100 * first else (1, 3)))
        axes.xaxis.set_major_formatter("{x:g}")
        axes.xaxis.set_minor_formatter(NullFormatter())


def _edges(at: Floats) -> Floats:
    """Edges (v + 1,) of bars about places (v,), halfway between them."""
    middle = (at[1:] + at[:-1]) / 2
    return np.array([2 * at[0] - middle[0], *middle, 2 * at[-1] - middle[-1]])


def _middle(values: Floats) -> Floats:
    """Medians (v,) over draws (v, d) of what is finite; NaN where nothing is."""
    finite = [row[np.isfinite(row)] for row in values]
    return np.array([np.median(row) if len(row) else np.nan for row in finite])


def _legend(figure: Figure, sweep: Sweep) -> None:
    entries = [
        Line2D([], [], color=BLUE, marker="o", linestyle="", markersize=4, label="error of a draw"),
        Line2D(
            [],
            [],
            color=BLUE,
            marker="o",
            linestyle="",
            markersize=4,
            fillstyle="none",
            label="error, had it been stated",
        ),
        Line2D([], [], color="black", marker="x", linestyle="", label="outside its 95% interval"),
        Line2D([], [], color=GREEN, marker="s", markersize=3, label="standard deviation (median)"),
        Line2D([], [], color=ORANGE, linestyle="--", label="theory's bound"),
    ]
    if sweep.boundary.edge is not None:
        entries.append(Line2D([], [], color=GREY, linestyle=":", label=sweep.boundary.edge_label))
    entries += [
        Line2D([], [], color=colour, marker="s", linestyle="", markersize=8, label=status)
        for status, colour in _STATUSES.items()
    ]
    figure.legend(handles=entries, loc="outside right upper", fontsize=7)


def _degree_figure(sweep: Sweep) -> Figure:
    """Status of each degree over 1 / sigma, theory's answer beside it, and errors in standard deviations."""
    figure = Figure(figsize=(12, 4.6), layout="constrained")
    found, scores = figure.subplots(1, 2)
    names = list(_STATUSES)[:3]
    # The worst of the draws.
    rank = np.array(
        [[max(names.index(status) for status in draws) for draws in row] for row in _by_degree(sweep)]
    )
    edges = _edges(sweep.at)
    l = np.arange(rank.shape[1])
    found.pcolormesh(
        edges,
        _edges(l.astype(float)),
        rank.T,
        cmap=ListedColormap(list(_STATUSES.values())[:3]),
        vmin=0,
        vmax=2,
    )
    line = np.linspace(0, sweep.at[-1], 50)
    found.plot(line, line, ":", color="black", label="l = 1 / sigma [RH01, eq. 20]")
    for k, at in enumerate(sweep.at):
        known = sweep.expected_status[k] == "determined"
        marks = np.where(known, l, np.nan)
        found.plot(
            np.full(len(l), at),
            marks,
            ".",
            color="black",
            label="theory: stands out of the noise" if not k else None,
        )
    found.set(xlabel=sweep.boundary.axis, ylabel="degree l", ylim=(-0.5, l[-1] + 0.5))
    handles, _ = found.get_legend_handles_labels()
    handles += [
        Line2D([], [], color=_STATUSES[n], marker="s", linestyle="", markersize=8, label=n) for n in names
    ]
    figure.legend(handles=handles, fontsize=7, loc="outside right upper")
    for draw in range(sweep.error.shape[1]):
        z = sweep.error[:, draw] / sweep.std[:, draw]
        for k, at in enumerate(sweep.at):
            scores.plot(
                l + 0.04 * (k - 3),
                z[k],
                "o",
                markersize=3,
                color=_shade(k, len(sweep.at)),
                label=f"1 / sigma = {at:g}" if not draw else None,
            )
    scores.axhline(1.96, color=GREY, linestyle=":")
    scores.set(xlabel="degree l", ylabel="RMS error / RMS standard deviation", ylim=(0, None))
    scores.legend(fontsize=6, ncols=4, loc="upper center")
    _entitle(figure, sweep)
    return figure


def _by_degree(sweep: Sweep) -> list[list[list[str]]]:
    return [[list(sweep.status[v, :, q]) for q in range(sweep.status.shape[2])] for v in range(len(sweep.at))]


def _shade(k: int, count: int) -> tuple[float, float, float]:
    return (0.0, 0.25 + 0.6 * k / max(count - 1, 1), 0.75 - 0.5 * k / max(count - 1, 1))
