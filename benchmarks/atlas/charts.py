"""The whole atlas: all sweeps, their charts, and one table."""

from __future__ import annotations

import multiprocessing
import os
from collections.abc import Iterator, Sequence
from concurrent.futures import Executor, ProcessPoolExecutor
from contextlib import contextmanager
from pathlib import Path

import numpy as np

from benchmarks.atlas import BOUNDARIES
from benchmarks.atlas.figure import sweep_figure
from benchmarks.atlas.sweep import Sweep, swept
from benchmarks.ink import save, write_table
from benchmarks.kept import Kept
from capture.tasks.cluster import connected

_DRAWS, _QUICK_DRAWS = 4, 1
# Of the boundaries, one in so many shows that sweeps are drawn; tests/test_benchmarks.py has points of most.
_QUICK_EVERY = 6
# Errors beyond so many standard deviations are listed: of 500 numbers one is, by chance.
_FAR = 3.0


def draw_atlas(out: Path, quick: bool, workers: int | None = None, cluster: str | None = None) -> None:
    """Write atlas-NAME.json and .png of every boundary, and atlas.md.

    workers : processes on this machine, one per core if None. cluster : a Dask scheduler, whose workers do it instead.
    """
    draws = _QUICK_DRAWS if quick else _DRAWS
    sweeps = []
    with _pool(workers, cluster) as pool:
        for boundary in BOUNDARIES[::_QUICK_EVERY] if quick else BOUNDARIES:
            values = [boundary.values[k] for k in boundary.quick] if quick else boundary.values
            kept = Kept(out / f"atlas-{boundary.name}.json", {"seeds": f"0 to {draws - 1}"})
            sweep = swept(boundary, values, draws, kept, pool)
            save(sweep_figure(sweep), out / f"atlas-{boundary.name}.png", kept.caption)
            sweeps.append(sweep)
            print(f"  {boundary.name}", flush=True)
    write_table(out / "atlas.md", atlas_table(sweeps), kept.caption)


@contextmanager
def _pool(workers: int | None, cluster: str | None) -> Iterator[Executor]:
    if cluster is not None:
        with connected(cluster) as client:
            yield client.get_executor(pure=False)
        return
    with ProcessPoolExecutor(workers or os.cpu_count(), multiprocessing.get_context("spawn")) as pool:
        yield pool


def atlas_table(sweeps: Sequence[Sweep]) -> Iterator[str]:
    """All sweeps in Markdown, and first of all what was stated with too small a bar."""
    yield "# Stability atlas: the numbers\n"
    yield (
        "Medians over draws of the noise; `theory` is the bound of Cramer and Rao, or what the chart says. `held` is"
        " how many of the stated 95% intervals hold the truth. README.md has the charts.\n"
    )
    far = [line for sweep in sweeps for line in _far_off(sweep)]
    yield f"Stated numbers more than {_FAR:g} of their standard deviations off: {len(far) or 'none'}.\n"
    yield from far
    for sweep in sweeps:
        yield f"\n## {sweep.boundary.title}\n"
        yield f"| {sweep.boundary.axis} | number | error | standard deviation | theory | held | status |"
        yield "|---|---|---|---|---|---|---|"
        for v, at in enumerate(sweep.at):
            for q, name in enumerate(sweep.boundary.quantities):
                yield f"| {at:.3g} | {name} | {' | '.join(_cells(sweep, v, q))} |"


def _far_off(sweep: Sweep) -> Iterator[str]:
    for v, d, q in np.argwhere(np.abs(sweep.scores) > _FAR):
        yield (
            f"- {sweep.boundary.name}, {sweep.boundary.axis} {sweep.at[v]:.3g}: {sweep.boundary.quantities[q]} is off"
            f" by {sweep.error[v, d, q]:+.2g} +- {sweep.std[v, d, q]:.1g} ({sweep.status[v, d, q]})"
        )


def _cells(sweep: Sweep, v: int, q: int) -> list[str]:
    stated = int(sweep.stated[v, :, q].sum())
    held = f"{round(sweep.covered[v, q] * stated)} of {stated}" if stated else "none stated"
    names, counts = np.unique(sweep.status[v, :, q], return_counts=True)
    theory = f"{sweep.expected_std[v, q]:.2g} ({sweep.expected_status[v, q]})"
    if not np.isfinite(sweep.expected_std[v, q]):
        theory = str(sweep.expected_status[v, q])
    return [
        _median(np.abs(sweep.error[v, :, q])),
        _median(sweep.std[v, :, q]),
        theory,
        held,
        ", ".join(f"{name} {count}" for name, count in zip(names, counts, strict=True)),
    ]


def _median(values: np.ndarray[tuple[int], np.dtype[np.float64]]) -> str:
    finite = values[np.isfinite(values)]
    return f"{np.median(finite):.2g}" if len(finite) else ""
