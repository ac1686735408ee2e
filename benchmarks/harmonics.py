"""Harmonic transforms and rotations against ducc0 and bare sphericart, in one run.

    python -m benchmarks.harmonics [ROUNDS]

On a map of 128 x 256, degree 30: analysis, filter and synthesis, as prefiltering an environment does, for one and three
channels, beside ducc0 on the same number of cores. Scattered evaluation beside `sphericart` itself. The reflection
operator's rows beside the bare evaluation of as many harmonics. They take turns; ratios of the medians count.
"""

from __future__ import annotations

import sys
import time
from collections.abc import Callable
from statistics import median

import ducc0
import numpy as np
import sphericart
from numpy.typing import NDArray
from threadpoolctl import threadpool_limits

from invrender.theory.convolution import filtered
from invrender.theory.operator import reflection_operator
from invrender.theory.specialcases import phong_transfer
from recon.harmonics.basis import evaluate_harmonics, sphere_directions
from recon.harmonics.latlong import analyse_latlong, synthesise_latlong
from synthetic.materials.microfacet import MicrofacetMaterial

Floats = NDArray[np.float64]

_HEIGHT, _L_MAX, _ROUNDS = 128, 30, 11
_GRID = {"spin": 0, "geometry": "F1", "phi0": np.pi / (2 * _HEIGHT), "lmax": _L_MAX}


def main(rounds: int) -> None:
    """Print milliseconds and ratios."""
    print(f"{'work':44} {'ours':>9} {'bare':>9}  ratio  goal")
    for threads in (1, 2):
        with threadpool_limits(threads):
            for channels in (1, 3):
                _prefiltering(channels, threads, rounds)
    for l_max in (2, 4, 8, 12, 20):
        _evaluation(l_max, rounds)
    _operator(rounds)


def _prefiltering(channels: int, threads: int, rounds: int) -> None:
    values = np.random.default_rng(1).random((_HEIGHT, 2 * _HEIGHT, channels))
    transfer = phong_transfer(64.0, _L_MAX)
    maps = [np.ascontiguousarray(values[None, ..., c]) for c in range(channels)]
    degree = np.triu_indices(_L_MAX + 1)[1]
    factors = transfer[degree]

    def bare() -> object:
        done = []
        for one in maps:
            found = ducc0.sht.analysis_2d(map=one, nthreads=threads, **_GRID) * factors
            done.append(
                ducc0.sht.synthesis_2d(alm=found, ntheta=_HEIGHT, nphi=2 * _HEIGHT, nthreads=threads, **_GRID)
            )
        return done

    def ours() -> object:
        return synthesise_latlong(filtered(analyse_latlong(values, _L_MAX), transfer), _HEIGHT)

    _compare(
        f"prefilter 128x256, l_max 30, {channels} channel(s), {threads} core(s)", ours, bare, 3.0, rounds
    )


def _evaluation(l_max: int, rounds: int) -> None:
    directions = sphere_directions(100_000)
    calculator = sphericart.SphericalHarmonics(l_max)
    _compare(
        f"harmonics of 100,000 directions, l_max {l_max}",
        lambda: evaluate_harmonics(directions, l_max),
        lambda: calculator.compute(directions),
        1.2,
        rounds,
    )


def _operator(rounds: int) -> None:
    view = np.array([1.0, 0.0, 0.0])
    normals = sphere_directions(60_000)
    normals = normals[normals @ view > 0.15]
    views = np.broadcast_to(view, normals.shape)
    lobe = MicrofacetMaterial(np.zeros(3), np.ones(3), 1.5, 0.12).lobe
    _compare(
        f"operator rows of {len(normals)} samples, l_max 12",
        lambda: reflection_operator(lambda wi, wo: lobe(wi, wo)[..., 0], normals, views, 12),
        lambda: evaluate_harmonics(normals, 12),
        None,
        rounds,
    )


def _compare(
    what: str, ours: Callable[[], object], bare: Callable[[], object], goal: float | None, rounds: int
) -> None:
    times: dict[str, list[float]] = {"ours": [], "bare": []}
    for _ in range(rounds):
        for name, work in (("ours", ours), ("bare", bare)):
            start = time.perf_counter()
            work()
            times[name].append(time.perf_counter() - start)
    mine, theirs = (1e3 * median(times[name]) for name in ("ours", "bare"))
    limit = "" if goal is None else f"  {goal:.1f}"
    print(f"{what:44} {mine:7.3f}ms {theirs:7.3f}ms  {mine / theirs:5.2f}{limit}")


if __name__ == "__main__":
    main(int(sys.argv[1]) if len(sys.argv) > 1 else _ROUNDS)
