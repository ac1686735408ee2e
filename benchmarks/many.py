"""Thousands of photographs in one set, and more workers: time and memory of `process`, stage by stage.

    python -m benchmarks.many DIR/many.png          30 to 3,000 photographs, then 300 by 1 and more workers; 15 minutes
    python -m benchmarks.many DIR/many.png 20,40    other numbers of photographs; the third, or last, by workers
    python -m benchmarks.many DIR/many.png 20 2000  of so many samples

The photographs are those of the built-in demonstration, repeated by symbolic links: the files are small, and what is
measured is what each photograph costs beyond its pixels. Nothing is kept from one run to the next.
"""

from __future__ import annotations

import json
import os
import re
import subprocess
import sys
import tempfile
import time
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from matplotlib.figure import Figure

from benchmarks.ink import COLOURS, GREY, MARKS, save
from benchmarks.kept import machine, machine_words
from capture.parallel import cores
from capture.photoset import MANIFEST_NAME
from capture.tasks.store import CACHE_VARIABLE
from capture.terminal import PROGRESS_VARIABLE
from synthetic.demo import demo_staging
from synthetic.writer import write_photoset

_PHOTOGRAPHS = (30, 100, 300, 1000, 3000)
# Stages by what progress bars call them; what comes before, between and after them is the rest.
_STAGES = {
    "Finding the sphere": "outlines",
    "Reading photographs": "samples",
    "Fitting and cross-validating": "fit",
    "Predicting photographs": "pictures",
}
_REST = "start, hashes, report"
_LOOK_S = 0.05


@dataclass(frozen=True)
class Cost:
    """What a run took. seconds : by stage, of the clock on the wall. megabytes : of its own process, at the peak."""

    seconds: Mapping[str, float]
    megabytes: float

    @property
    def total(self) -> float:
        return sum(self.seconds.values())


def repeated(photographs: Path, out: Path, count: int) -> Path:
    """A set of so many photographs, links to those of another one by turns."""
    head, *tables = (photographs / MANIFEST_NAME).read_text(encoding="utf-8").split("[[photo]]")
    out.mkdir(parents=True)
    for name in re.findall(r'map = "(.*?)"', head):
        (out / name).symlink_to(photographs / name)
    parts = [head]
    for k in range(count):
        table = tables[k % len(tables)]
        for name in re.findall(r'(?:file|mask) = "(.*?)"', table):
            (out / f"{k:05d}-{name}").symlink_to(photographs / name)
            table = table.replace(f'"{name}"', f'"{k:05d}-{name}"')
        parts.append(f"[[photo]]{table}")
    (out / MANIFEST_NAME).write_text("".join(parts), encoding="utf-8")
    return out


def cost(photoset: Path, place: Path, *options: str) -> Cost:
    """What processing a set takes, in a process of its own, with nothing kept from before."""
    place.mkdir(parents=True)
    log = place / "progress"
    log.touch()
    command = [
        sys.executable,
        "-m",
        "benchmarks.memory",
        "process",
        str(photoset),
        "-o",
        str(place / "out"),
        *options,
    ]
    environment = os.environ | {PROGRESS_VARIABLE: str(log), CACHE_VARIABLE: str(place / "cache")}
    seconds = dict.fromkeys((*_STAGES.values(), _REST), 0.0)
    with (place / "said").open("w+") as said:
        process = subprocess.Popen(command, stdout=said, stderr=subprocess.STDOUT, env=environment)
        before = time.monotonic()
        while process.poll() is None:
            time.sleep(_LOOK_S)
            now = time.monotonic()
            seconds[_stage(log)] += now - before
            before = now
        said.seek(0)
        words = said.read()
    if process.returncode:
        raise RuntimeError(f"{' '.join(command)} ended with {process.returncode}:\n{words}")
    return Cost(seconds, float(words.split()[-1]))


def _stage(log: Path) -> str:
    """The stage that a run is in, by the last line of its progress."""
    with log.open("rb") as lines:
        lines.seek(max(0, log.stat().st_size - 500))
        last = lines.read().splitlines()[-1:]
    if not last:
        return _REST
    line = json.loads(last[0])
    return _REST if line["done"] == line["of"] else _STAGES.get(line["doing"], _REST)


def many_figure(
    counts: Sequence[int], costs: Sequence[Cost], middle: int, by_workers: Mapping[str, Cost]
) -> Figure:
    """Time by stage and memory against photographs, and time by stage of the middle number against workers."""
    figure = Figure(figsize=(13, 4), layout="constrained")
    time_axes, memory_axes, worker_axes = figure.subplots(1, 3)
    for k, stage in enumerate((*_STAGES.values(), _REST)):
        line = [max(each.seconds[stage], _LOOK_S) for each in costs]
        time_axes.plot(
            counts, line, f"-{MARKS[k % len(MARKS)]}", color=COLOURS[k % len(COLOURS)], label=stage
        )
    time_axes.plot(counts, [each.total for each in costs], "-k", lw=2, label="all")
    first = costs[0].total
    time_axes.plot(counts, [first * count / counts[0] for count in counts], ":", color=GREY, label="linear")
    time_axes.set(xscale="log", yscale="log", xlabel="photographs", ylabel="time [s]")
    time_axes.legend(fontsize=7, loc="upper left")
    memory_axes.plot(counts, [each.megabytes for each in costs], "-ok")
    memory_axes.set(xscale="log", xlabel="photographs", ylabel="memory at the peak [MB]")
    memory_axes.set_ylim(0, 1.2 * max(each.megabytes for each in costs))
    bottom = np.zeros(len(by_workers))
    for k, stage in enumerate((*_STAGES.values(), _REST)):
        heights = np.array([each.seconds[stage] for each in by_workers.values()])
        worker_axes.bar(
            list(by_workers), heights, bottom=bottom, color=COLOURS[k % len(COLOURS)], label=stage
        )
        bottom += heights
    worker_axes.set_ylabel(f"time of {middle} photographs [s]")
    worker_axes.set_title("colours as at the left", fontsize=9)
    for axes in (time_axes, memory_axes):
        axes.grid(alpha=0.2)
    return figure


def main(figure: str, sizes: str = "", samples: str = "") -> None:
    """Measure, print and draw. samples : those that each run takes; as many as usual if empty."""
    few = ("--samples", samples) if samples else ()
    counts = tuple(int(size) for size in sizes.split(",")) if sizes else _PHOTOGRAPHS
    with tempfile.TemporaryDirectory() as name:
        place = Path(name)
        staging = demo_staging()
        shots = staging.scene.shots[: max(counts)]
        write_photoset(replace(staging, scene=replace(staging.scene, shots=shots)), place / "photographs")
        costs = []
        print("photographs   all [s]   memory [MB]   " + "   ".join((*_STAGES.values(), _REST)))
        for count in counts:
            costs.append(
                cost(
                    repeated(place / "photographs", place / f"set{count}", count), place / f"run{count}", *few
                )
            )
            _print(str(count), costs[-1])
        middle = counts[min(2, len(counts) - 1)]
        by_workers = {f"{cores()} threads": costs[counts.index(middle)]}
        for workers in range(1, cores() + 1):
            name = f"{workers} process{'es' if workers > 1 else ''}"
            options = ("--workers", str(workers), *few)
            by_workers[name] = cost(place / f"set{middle}", place / f"workers{workers}", *options)
            _print(f"{middle}, {name}", by_workers[name])
    save(many_figure(counts, costs, middle, by_workers), Path(figure), machine_words(machine()))


def _print(what: str, found: Cost) -> None:
    stages = "   ".join(f"{seconds:.1f}" for seconds in found.seconds.values())
    print(f"{what:12}  {found.total:8.1f}  {found.megabytes:8.0f}      {stages}", flush=True)


if __name__ == "__main__":
    main(*sys.argv[1:])
