"""The charts and the table of all boards: time against error, and the front that nothing beats."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from operator import attrgetter

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from numpy.typing import NDArray

from benchmarks.ink import COLOURS, GREY, MARKS
from benchmarks.pareto.boards import Point

Floats = NDArray[np.float64]

_PARAMETERS: Callable[[Point], float] = attrgetter("parameters")
_UNSEEN: Callable[[Point], float] = attrgetter("held_out")


def front(seconds: Floats, errors: Floats) -> NDArray[np.int64]:
    """Indices, by time, of points that no other beats in both."""
    order = np.lexsort((errors, seconds))
    best, kept = np.inf, []
    for index in order:
        if errors[index] < best:
            best = errors[index]
            kept.append(index)
    return np.array(kept)


def on_front(points: Sequence[Point], of: Callable[[Point], float]) -> list[Point]:
    """Those by time that no other beats, of all that are told nothing."""
    fair = [point for point in points if not point.contestant.told]
    best = front(np.array([point.time for point in fair]), np.array([of(point) for point in fair]))
    return [fair[index] for index in best]


def pareto_figure(boards: Mapping[str, Sequence[Point]]) -> Figure:
    """A row per board: errors of the parameters left, of unseen photographs right."""
    figure = Figure(figsize=(13, 4.2 * len(boards)), layout="constrained")
    rows = figure.subplots(len(boards), 2, squeeze=False)
    for row, (title, points) in zip(rows, boards.items(), strict=True):
        for axes, of, label in (
            (row[0], _PARAMETERS, points[0].label),
            (row[1], _UNSEEN, "relative RMS error, unseen photographs"),
        ):
            _draw(axes, points, of)
            axes.set_ylabel(label, fontsize=8)
            axes.set(xlabel="time / the default's", title=title)
        row[1].legend(fontsize=7, loc="center left", bbox_to_anchor=(1.01, 0.5))
    return figure


def _draw(axes: Axes, points: Sequence[Point], of: Callable[[Point], float]) -> None:
    best = on_front(points, of)
    families = list(dict.fromkeys(point.contestant.family for point in points))
    times, errors = [point.time for point in best], [of(point) for point in best]
    axes.step(times, errors, where="post", color=GREY, linewidth=6, alpha=0.3, label="Pareto front")
    for family, colour, mark in zip(families, COLOURS, MARKS, strict=False):
        mine = [p for p in points if p.contestant.family == family and not p.contestant.is_default]
        at, values = [p.time for p in mine], [of(p) for p in mine]
        if mine:
            told = mine[0].contestant.told
            style = {"markerfacecolor": "none", "linestyle": ":"} if told else {"linestyle": "-"}
            label = f"{family} (told order and form)" if told else family
            axes.plot(at, values, marker=mark, color=colour, markersize=5, linewidth=1, label=label, **style)
        for point in mine:
            axes.annotate(
                point.contestant.setting,
                (point.time, of(point)),
                xytext=(3, 3),
                textcoords="offset points",
                fontsize=6,
            )
    for point in points:
        if point.contestant.is_default:
            axes.plot(
                point.time,
                of(point),
                "*",
                color="black",
                markersize=14,
                label=f"{point.contestant.setting} samples",
            )
    axes.set(xscale="log", yscale="log")
    axes.grid(alpha=0.2, which="both")


def pareto_table(boards: Mapping[str, Sequence[Point]]) -> Iterator[str]:
    """All boards in Markdown."""
    yield "# Time against error\n"
    yield (
        "Times over the default's of the same board and run. Starred is what lies on the Pareto front of parameters,"
        " and of unseen photographs; a method that is told the order of the light and the form of the lobe isn't on it."
        " Parameters: the largest relative error of Ks share, mu - 1 and sigma; of lighting, the largest error of its"
        " first nine coefficients.\n"
    )
    yield "| board | method | samples or order | time | parameters | unseen | front |"
    yield "|---|---|---|---|---|---|---|"
    for title, points in boards.items():
        fronts = [on_front(points, of) for of in (_PARAMETERS, _UNSEEN)]
        for point in points:
            stars = " ".join("*" if point in one else "-" for one in fronts)
            one = point.contestant
            yield (
                f"| {title} | {one.family} | {one.setting} | {point.time:.2g} | {point.parameters:.2%} |"
                f" {point.held_out:.3%} | {stars} |"
            )
