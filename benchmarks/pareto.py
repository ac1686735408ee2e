"""Time against error of all methods and settings on the same photographs, and the front that none of the others passes.

    python -m benchmarks --only pareto

Errors are root mean squares over draws of the noise, times medians, relative to the default's in the same run.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from numpy.typing import NDArray

from benchmarks.atlas.stage import Stage
from benchmarks.contest import (
    Found,
    gauss_newton,
    judged,
    published_known,
    published_unknown,
    relative_error,
    statistics,
    whole_ladder,
)
from benchmarks.ink import COLOURS, GREY, MARKS, save, write_table
from benchmarks.kept import Kept
from benchmarks.spherephotos import SpherePhotos, sphere_photos
from capture.parallel import one_blas_thread
from invrender.model.lobetable import TRANSFERS
from invrender.pipeline import DEFAULT_SAMPLES

Floats = NDArray[np.float64]

_BUDGETS: tuple[int | None, ...] = (500, 2000, 8000, 32000, None)
_QUICK_BUDGETS: tuple[int | None, ...] = (2000,)
_ORDERS, _QUICK_ORDERS, _ORDER_BUDGET = (4, 6, 8, 12), (8,), 8000
# What the default of `process` is in the coarse version.
_QUICK_DEFAULT = 500
_DRAWS = 3
# RH01's map of the light takes so many samples.
_FEWEST_OF_MAP = 2000


@dataclass(frozen=True)
class Contestant:
    """A method at a setting. family : methods that differ by setting only are one line."""

    family: str
    setting: str
    known: bool
    run: Callable[[SpherePhotos], Found]
    is_default: bool = False

    @property
    def key(self) -> str:
        return f"{'known' if self.known else 'unknown'} light, {self.family}, {self.setting}"


@dataclass(frozen=True, eq=False)
class Point:
    """A contestant's median seconds and RMS errors over draws: of parameters, relative, and held out."""

    contestant: Contestant
    seconds: float
    parameters: float
    held_out: float


def contestants(quick: bool) -> list[Contestant]:
    """All methods at all settings."""
    found = []
    for budget in _QUICK_BUDGETS if quick else _BUDGETS:
        count = str(budget or "all")
        found.append(Contestant("statistics (lightfactor)", count, True, partial(statistics, samples=budget)))
        for transfer in TRANSFERS:
            simplex = partial(published_known, samples=budget, transfer=transfer)
            newton = partial(gauss_newton, samples=budget, transfer=transfer)
            found.append(Contestant(f"simplex, {transfer} [RH01]", count, True, simplex))
            found.append(Contestant(f"Gauss-Newton, {transfer}", count, False, newton))
        if budget is None or budget >= _FEWEST_OF_MAP:
            by_map = partial(published_unknown, samples=budget)
            found.append(Contestant("simplex and map [RH01]", count, False, by_map))
    budget = _QUICK_BUDGETS[-1] if quick else _ORDER_BUDGET
    for order in _QUICK_ORDERS if quick else _ORDERS:
        newton = partial(gauss_newton, samples=budget, orders=(order,))
        found.append(Contestant("Gauss-Newton, exact, other orders", f"l* = {order}", False, newton))
    default = _QUICK_DEFAULT if quick else DEFAULT_SAMPLES
    label = f"default of process, {default}"
    told, blind = partial(statistics, samples=default), partial(whole_ladder, samples=default)
    found.append(Contestant("statistics (lightfactor)", label, True, told, True))
    found.append(Contestant("whole ladder (lightfactor)", label, False, blind, True))
    return found


def measure(photos: SpherePhotos, entered: Sequence[Contestant], draws: int) -> list[Point]:
    """All contestants over draws of the noise."""
    points = []
    with one_blas_thread():
        for contestant in entered:
            outcomes = []
            for seed in range(draws):
                noisy = photos.with_noise(seed)
                run = partial(contestant.run, noisy)
                outcomes.append(judged(noisy, contestant.family, contestant.known, contestant.setting, run))
            seconds = float(np.median([one.seconds for one in outcomes]))
            parameters = _rms([relative_error(one, photos) for one in outcomes])
            points.append(Point(contestant, seconds, parameters, _rms([one.held_out for one in outcomes])))
            print(f"  {contestant.key}", flush=True)
    return points


def _rms(values: Sequence[float]) -> float:
    return float(np.sqrt(np.mean(np.square(values))))


def front(seconds: Floats, errors: Floats) -> NDArray[np.int64]:
    """Indices, by time, of points that no other beats in both."""
    order = np.lexsort((errors, seconds))
    best, kept = np.inf, []
    for index in order:
        if errors[index] < best:
            best = errors[index]
            kept.append(index)
    return np.array(kept)


def draw_pareto(out: Path, quick: bool) -> None:
    """Write pareto.json, pareto.png and pareto.md."""
    stage = Stage(views=6 if quick else 12, radius_px=30 if quick else 45)
    draws = 1 if quick else _DRAWS
    entered = contestants(quick)
    kept = Kept(
        out / "pareto.json",
        {"views": stage.views, "radius_px": stage.radius_px, "seeds": f"0 to {draws - 1}"},
    )
    if "points" not in kept:
        photos = sphere_photos(stage, 0)
        # What a first run builds for all, such as tables of lobes, isn't timed; nor is anything in a coarse version.
        if not quick:
            for run in (statistics, gauss_newton):
                run(photos, _QUICK_BUDGETS[0])
        points = measure(photos, entered, draws)
        # Times are ratios to the default's of the same light.
        unit = {p.contestant.known: p.seconds for p in points if p.contestant.is_default}
        kept["points"] = {
            p.contestant.key: [p.seconds / unit[p.contestant.known], p.parameters, p.held_out] for p in points
        }
    by_key = kept["points"]
    points = [Point(one, *by_key[one.key]) for one in entered]
    save(pareto_figure(points), out / "pareto.png", kept.caption)
    write_table(out / "pareto.md", _table(points), kept.caption)


def pareto_figure(points: Sequence[Point]) -> Figure:
    """Known light above, unknown light below; errors of the parameters left, of unseen photographs right."""
    figure = Figure(figsize=(13, 9), layout="constrained")
    rows = figure.subplots(2, 2)
    for row, known in zip(rows, (True, False), strict=True):
        mine = [point for point in points if point.contestant.known == known]
        light = "known light" if known else "unknown light"
        for axes, of, label in (
            (row[0], lambda p: p.parameters, "largest relative error of Ks share, mu - 1, sigma"),
            (row[1], lambda p: p.held_out, "relative RMS error, unseen photographs"),
        ):
            _draw(axes, mine, of)
            axes.set(xlabel="time / the default's", ylabel=label, title=light)
        row[1].legend(fontsize=7, loc="center left", bbox_to_anchor=(1.01, 0.5))
    return figure


def _draw(axes: Axes, points: Sequence[Point], of: Callable[[Point], float]) -> None:
    seconds, errors = np.array([p.seconds for p in points]), np.array([of(p) for p in points])
    families = list(dict.fromkeys(point.contestant.family for point in points))
    best = front(seconds, errors)
    axes.step(
        seconds[best], errors[best], where="post", color=GREY, linewidth=6, alpha=0.3, label="Pareto front"
    )
    for family, colour, mark in zip(families, COLOURS, MARKS, strict=False):
        mine = [p for p in points if p.contestant.family == family and not p.contestant.is_default]
        at, values = [p.seconds for p in mine], [of(p) for p in mine]
        if mine:
            axes.plot(at, values, f"-{mark}", color=colour, markersize=5, linewidth=1, label=family)
        for point in mine:
            axes.annotate(
                point.contestant.setting,
                (point.seconds, of(point)),
                xytext=(3, 3),
                textcoords="offset points",
                fontsize=6,
            )
    for point in points:
        if point.contestant.is_default:
            axes.plot(
                point.seconds,
                of(point),
                "*",
                color="black",
                markersize=14,
                label=f"{point.contestant.setting} samples",
            )
    axes.set(xscale="log", yscale="log")
    axes.grid(alpha=0.2, which="both")


def _table(points: Sequence[Point]) -> list[str]:
    lines = [
        "# Time against error\n",
        "Times over the default's of the same light and run. Starred is what lies on the Pareto front of parameters,"
        " and of unseen photographs.\n",
        "| light | method | samples or order | time | parameters | unseen | front |",
        "|---|---|---|---|---|---|---|",
    ]
    for known in (True, False):
        mine = [point for point in points if point.contestant.known == known]
        seconds = np.array([p.seconds for p in mine])
        fronts = [
            set(front(seconds, np.array(values)).tolist())
            for values in ([p.parameters for p in mine], [p.held_out for p in mine])
        ]
        for k, point in enumerate(mine):
            stars = " ".join("*" if k in one else "-" for one in fronts)
            one = point.contestant
            lines.append(
                f"| {'known' if known else 'unknown'} | {one.family} | {one.setting} | {point.seconds:.2g}"
                f" | {point.parameters:.2%} | {point.held_out:.3%} | {stars} |"
            )
    return lines
