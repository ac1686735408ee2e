"""Race with Mitsuba 3: inverse rendering of the same photographs by a differentiable path tracer, error against time.

Mitsuba's settings are the best of those tried: one path per pixel (four in a minute) and one photograph per step, Adam
with little memory (but in long runs of unknown light); see `peer`.
"""

from __future__ import annotations

from collections.abc import MutableMapping, Sequence
from dataclasses import replace
from functools import lru_cache, partial
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from numpy.typing import NDArray

from benchmarks.atlas.stage import Stage
from benchmarks.contest import Outcome, judged, ours
from benchmarks.ink import BLUE, ORANGE, save, write_table
from benchmarks.kept import Kept
from benchmarks.peer import NO_LLVM, Peer, Setting, has_mitsuba
from benchmarks.spherephotos import SpherePhotos, sphere_photos
from capture.parallel import one_blas_thread

Floats = NDArray[np.float64]

_BUDGETS, _QUICK_BUDGETS = (500, 2000, 8000, 32000), (300, 600)
_LABELS = {
    "Ks share": "absolute error",
    "mu": "absolute error",
    "sigma": "absolute error [rad]",
    "unseen photographs": "relative RMS error",
}


# Under unknown light, long runs with little memory run away.
_RUNS = {
    True: (Setting(4.0, 1, 0.9), Setting(60.0, 4, 0.9)),
    False: (Setting(15.0, 1, 0.9), Setting(120.0, 1, 0.999)),
}
_QUICK_RUN = Setting(1.0, 1, 0.9)


def draw_race(out: Path, quick: bool) -> None:
    """Write race.json, race.png and race.md; without Mitsuba, say so and draw our side alone."""
    # A sphere as large as in pictures of 320 x 240: on smaller ones what a step costs besides its rays counts too much.
    stage = Stage(views=4 if quick else 60, radius_px=30 if quick else 105)
    peer = has_mitsuba()
    if not peer:
        print(f"  {NO_LLVM}")
    settings = {"views": stage.views, "radius_px": stage.radius_px, "seed": 0, "with Mitsuba": peer}
    kept = Kept(out / "race.json", settings)
    outcomes = run_race(stage, quick, peer, kept)
    save(race_figure(outcomes), out / "race.png", kept.caption)
    write_table(out / "race.md", _table(outcomes), kept.caption)


def run_race(stage: Stage, quick: bool, peer: bool, kept: MutableMapping[str, Any]) -> list[Outcome]:
    """All runs, with known light and with unknown; those that `kept` lacks are made one after the other, and kept.

    Times are in units of our first run's of the same light, which is made again for it.
    """
    outcomes = []
    for known in (True, False):
        budgets = _QUICK_BUDGETS if quick else _BUDGETS
        runs = () if not peer else (_QUICK_RUN,) if quick else _RUNS[known]
        keys = [_key(known, f"{budget} samples") for budget in budgets]
        keys += [_key(known, f"{run.seconds:g} s") for run in runs]
        if any(key not in kept for key in keys):
            photos = _photos(stage)
            # What a first run builds for all, such as tables of lobes, isn't timed: nor is Mitsuba's compiling, nor
            # anything in a coarse version.
            if not quick:
                ours(photos, known, budgets[0])
            unit = _ours(photos, known, budgets[0])
            racer = None
            for key, setting in zip(keys, (*budgets, *runs), strict=True):
                if key in kept:
                    continue
                if isinstance(setting, int):
                    found = unit if setting == budgets[0] else _ours(photos, known, setting)
                else:
                    racer = racer or Peer(photos, known)
                    found = racer.outcome(setting)
                kept[key] = replace(found, seconds=found.seconds / unit.seconds).document()
                print(f"  {_words(found)}", flush=True)
        outcomes += [Outcome(**kept[key]) for key in keys]
    return outcomes


@lru_cache(maxsize=1)
def _photos(stage: Stage) -> SpherePhotos:
    return sphere_photos(stage, 0)


def _key(known: bool, setting: str) -> str:
    return f"{'known' if known else 'unknown'} light, {setting}"


def _ours(photos: SpherePhotos, known: bool, budget: int) -> Outcome:
    with one_blas_thread():
        return judged(photos, "lightfactor", known, f"{budget} samples", partial(ours, photos, known, budget))


def race_figure(outcomes: Sequence[Outcome]) -> Figure:
    """Errors against time: known light above, unknown light below."""
    figure = Figure(figsize=(13, 6.5), layout="constrained")
    rows = figure.subplots(2, 4, sharex="row")
    for row, known in zip(rows, (True, False), strict=True):
        mine = [one for one in outcomes if one.known_light == known]
        for axes, (name, label) in zip(row, _LABELS.items(), strict=True):
            _draw(axes, mine, name)
            axes.set_ylabel(label, fontsize=8)
            axes.set_xlabel("time / our first run's", fontsize=8)
            axes.set_title(f"{name}, {'known' if known else 'unknown'} light", fontsize=9)
    rows[0, 0].legend(fontsize=8)
    return figure


def _draw(axes: Axes, outcomes: Sequence[Outcome], name: str) -> None:
    for method, colour, mark in (("lightfactor", BLUE, "o"), ("Mitsuba 3", ORANGE, "s")):
        mine = [one for one in outcomes if one.method == method]
        errors = [one.held_out if name == "unseen photographs" else one.errors[name] for one in mine]
        seconds = [one.seconds for one in mine]
        if mine:
            values = [np.nan if error is None else error for error in errors]
            axes.plot(seconds, values, f"-{mark}", color=colour, label=method)
    axes.set(xscale="log", yscale="log")
    axes.grid(alpha=0.2, which="both")


def _table(outcomes: Sequence[Outcome]) -> list[str]:
    return [
        "# Race with Mitsuba 3\n",
        "Times over those of our run with the fewest samples, of the same light; errors are absolute, unseen"
        " photographs relative RMS.\n",
        "| light | method | setting | time | Ks share | mu | sigma | unseen |",
        "|---|---|---|---|---|---|---|---|",
        *(
            f"| {'known' if one.known_light else 'unknown'} | {one.method} | {one.setting} | {one.seconds:.2g} |"
            + " |".join(" none" if e is None else f" {e:.2g}" for e in one.errors.values())
            + f" | {one.held_out:.3%} |"
            for one in outcomes
        ),
    ]


def _words(one: Outcome) -> str:
    light = "known" if one.known_light else "unknown"
    return f"{light} light, {one.method}, {one.setting}: unseen photographs {one.held_out:.3%}"
