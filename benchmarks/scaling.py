"""Time and memory of the fit against samples, photographs and degree of the light: fitted exponents against theory's.

    python -m benchmarks --only scaling

Each measurement is a process of its own, whose peak memory is what the system counts, less what it took before. The
`pass` makes, weighs and multiplies the rows of all samples, once, and solves for the light: N l_max^4. Searches repeat
it a number of times that doesn't depend on either.
"""

from __future__ import annotations

import multiprocessing
import os
import time
from collections.abc import Callable, Mapping, Sequence
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass
from functools import partial
from pathlib import Path

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from numpy.typing import NDArray

from benchmarks.atlas.stage import Stage, told
from benchmarks.ink import COLOURS, GREY, MARKS, save, write_table
from benchmarks.kept import Kept
from benchmarks.memory import forget_peak, peak_megabytes
from capture.parallel import one_blas_thread
from invrender.estimate.unknown_light import factorize_blind
from invrender.estimate.unknown_light.lighting_design import LightingDesign
from invrender.estimate.unknown_light.projection import light_scale, solve_lighting
from invrender.estimate.unknown_light.state import BlindState
from recon.sampling.lightfield import LightField, pools

Floats = NDArray[np.float64]

_REPEATED = 3
_PER_PHOTO, _SAMPLES, _L_MAX, _VIEWS = 300, 4000, 8, 6
# Half of a sphere's image of this radius gives the most samples asked of one photograph.
_RADIUS_PX = 90.0
# Below the last points of a line, what doesn't grow still counts: exponents are fitted to so many.
_FITTED = 3


@dataclass(frozen=True)
class Axis:
    """What grows. expected : exponents by the names of tasks."""

    name: str
    label: str
    sizes: tuple[int, ...]
    quick: tuple[int, ...]
    expected: Mapping[str, float]


AXES = (
    Axis(
        "samples",
        "samples, of 6 photographs, light of degree 8",
        (2000, 4000, 8000, 16000, 32000),
        (300, 600),
        {"pass": 1, "unknown light": 1, "known light": 1},
    ),
    Axis(
        "photographs",
        f"photographs of {_PER_PHOTO} samples, light of degree 8",
        (6, 12, 24, 48, 96),
        (2, 3),
        {"pass": 1, "unknown light": 1, "known light": 1},
    ),
    Axis("l_max", f"degree of the light, {_SAMPLES} samples", (8, 12, 16, 24, 32, 40), (4, 6), {"pass": 4}),
)


def run_pass(fields: Sequence[LightField], stage: Stage) -> Callable[[], object]:
    """One pass over the samples under unknown light, lobes of the roughness at hand already known."""
    material = stage.material
    together = pools(fields, [0] * len(fields))
    designs = [LightingDesign.of([fields[k] for k in pool], stage.l_max) for pool in together]
    weights = [np.ones_like(design.field.radiance) for design in designs]
    share = material.ks / (material.kd + material.ks)
    directions = np.array([source.direction for source in stage.sources])
    owners = np.zeros(len(directions), int)
    state = BlindState(share, material.mu, material.sigma, directions, owners=owners)
    scale = light_scale(designs)
    return lambda: solve_lighting(designs, weights, scale, state, stage.l_max)


def run_unknown(fields: Sequence[LightField], stage: Stage) -> Callable[[], object]:
    """The whole fit under unknown light, one model."""
    return lambda: factorize_blind(fields, orders=[stage.l_max], ladder=False)


def run_known(fields: Sequence[LightField], stage: Stage) -> Callable[[], object]:
    """The whole fit under known light, its ladder of models included."""
    return lambda: told(stage, fields)


TASKS = {"pass": run_pass, "unknown light": run_unknown, "known light": run_known}


def staged(axis: str, size: int) -> Stage:
    """The photographs that a size of an axis means."""
    if axis == "photographs":
        return Stage(views=size, samples=size * _PER_PHOTO, l_max=_L_MAX)
    if axis == "samples":
        return Stage(views=_VIEWS, samples=size, radius_px=_RADIUS_PX, l_max=_L_MAX)
    return Stage(views=_VIEWS, samples=_SAMPLES, l_max=size)


def measured(axis: str, size: int, task: str, quick: bool) -> tuple[float, float]:
    """Least seconds of some runs, and megabytes at the peak beyond those before; in a process of its own.

    quick : of one run, without one before it.
    """
    stage = staged(axis, size)
    fields = stage.drawn(0)
    with one_blas_thread():
        forget_peak()
        before = peak_megabytes()
        run = TASKS[task](fields, stage)
        if not quick:
            run()
        seconds = []
        for _ in range(_REPEATED if task == "pass" and not quick else 1):
            begin = time.perf_counter()
            run()
            seconds.append(time.perf_counter() - begin)
    return min(seconds), peak_megabytes() - before


def exponent(sizes: Sequence[float], values: Sequence[float]) -> float:
    """Slope of log value against log size over the last points."""
    x, y = np.log(sizes[-_FITTED:]), np.log(np.maximum(values[-_FITTED:], 1e-9))
    return float(np.polyfit(x, y, 1)[0])


def draw_scaling(out: Path, quick: bool) -> None:
    """Write scaling.json, scaling.png and scaling.md."""
    kept = Kept(out / "scaling.json", {"samples per photograph": _PER_PHOTO, "seed": 0, "quick": quick})
    if "times" not in kept:
        found: dict[str, dict[str, list[tuple[float, float]]]] = {}
        tasks = [
            (axis.name, size, task) for axis in AXES for task in axis.expected for size in _sizes(axis, quick)
        ]
        # One after the other, so that none disturbs another's time, each in a new process, whose memory is its own: but
        # nobody looks at those of a coarse version.
        workers, spawn = os.cpu_count() if quick else 1, multiprocessing.get_context("spawn")
        with ProcessPoolExecutor(workers, spawn, max_tasks_per_child=None if quick else 1) as pool:
            for (axis, size, task), value in zip(
                tasks, pool.map(partial(measured, quick=quick), *zip(*tasks, strict=True)), strict=True
            ):
                found.setdefault(axis, {}).setdefault(task, []).append(value)
                print(f"  {axis}, {task}, {size}", flush=True)
        # Times only as ratios, here to one pass over the first size.
        kept["times"] = {
            axis: {
                task: [[seconds / lines["pass"][0][0], megabytes] for seconds, megabytes in line]
                for task, line in lines.items()
            }
            for axis, lines in found.items()
        }
    save(scaling_figure(kept["times"], quick), out / "scaling.png", kept.caption)
    write_table(out / "scaling.md", _table(kept["times"], quick), kept.caption)


def _sizes(axis: Axis, quick: bool) -> tuple[int, ...]:
    return axis.quick if quick else axis.sizes


Times = Mapping[str, Mapping[str, Sequence[Sequence[float]]]]


def scaling_figure(times: Times, quick: bool) -> Figure:
    """Time above, memory below, against each axis; exponents of the lines' ends, and theory's."""
    figure = Figure(figsize=(13, 7.5), layout="constrained")
    rows = figure.subplots(2, len(AXES))
    for column, axis in enumerate(AXES):
        sizes = _sizes(axis, quick)
        for k, (task, expected) in enumerate(axis.expected.items()):
            line = np.array(times[axis.name][task])
            for row, values in ((0, line[:, 0]), (1, np.maximum(line[:, 1], 0.1))):
                label = f"{task}: exponent {exponent(sizes, values):.2f}"
                if row == 0:
                    label += f", theory {expected:g}"
                rows[row, column].plot(sizes, values, f"-{MARKS[k]}", color=COLOURS[k], label=label)
        _guide(rows[0, column], sizes, max(axis.expected.values()))
        rows[0, column].set_ylabel("time / one pass's at the left")
        rows[1, column].set_ylabel("memory at the peak beyond the photographs' [MB]")
        for row in range(2):
            rows[row, column].set(xscale="log", yscale="log", xlabel=axis.label, xticks=sizes)
            rows[row, column].set_xticklabels([str(size) for size in sizes])
            rows[row, column].minorticks_off()
            rows[row, column].legend(fontsize=8)
            rows[row, column].grid(alpha=0.2)
    return figure


def _guide(axes: Axes, sizes: Sequence[int], power: float) -> None:
    x = np.array(sizes, float)
    axes.plot(x, (x / x[0]) ** power, ":", color=GREY, label=f"size^{power:g}")


def _table(times: Times, quick: bool) -> list[str]:
    lines = [
        "# Scaling\n",
        f"Exponents over the last {_FITTED} points of each line.\n",
        "| against | task | sizes | time | theory | memory | passes that it takes at the last size |",
        "|---|---|---|---|---|---|---|",
    ]
    for axis in AXES:
        sizes = _sizes(axis, quick)
        for task, expected in axis.expected.items():
            line, passes = (np.array(times[axis.name][name]) for name in (task, "pass"))
            lines.append(
                f"| {axis.name} | {task} | {sizes[0]} to {sizes[-1]} | {exponent(sizes, line[:, 0]):.2f} | {expected:g}"
                f" | {exponent(sizes, line[:, 1]):.2f} | {line[-1, 0] / passes[-1, 0]:.2g} |"
            )
    return lines
