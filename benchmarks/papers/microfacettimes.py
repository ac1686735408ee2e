"""R02's table 5.5: reflection maps of a microfacet lobe by harmonics, and by integration over angles.

A colour map of 128 x 256 pixels, and what is seen of it in as many mirrored directions from each of 10 x 10 directions
about these: a hundred reflection maps. Integration is done at every twentieth row and column, each map's from another
one on, and counts for the share of the pixels that these are. The harmonics go to the paper's own F and P of each
sigma.
"""

from __future__ import annotations

from collections.abc import Callable
from functools import partial
from statistics import median

import numpy as np
from numpy.typing import NDArray
from threadpoolctl import threadpool_limits

from benchmarks.papers.entry import Outcome, Workplace
from benchmarks.papers.overangles import Ints, Singles, local_views, over_angles, room, world_views
from benchmarks.papers.processortime import seconds
from invrender.brdf.rh01 import simplified_microfacet
from invrender.prefilter.reflectionmap import (
    ReflectionMap,
    lobe_coefficients,
    lobe_orders,
    reflection_map,
)

Floats = NDArray[np.float64]

# Sigma: the paper's F and P, seconds by integration and by harmonics, and the latter of the SHRM alone.
_PUBLISHED = {
    0.1: (24, 3, 923, 2.70, 1.55),
    0.2: (12, 2, 2744, 1.55, 0.72),
    0.3: (7, 2, 5731, 1.49, 0.67),
    0.4: (5, 2, 9034, 1.47, 0.65),
    0.5: (5, 2, 12580, 1.45, 0.64),
}
_HEIGHT, _SIDE, _STRIDE, _QUICK_STRIDE = 128, 10, 20, 40
# Of the lobe's quadrature: 0.2% of its largest coefficient, where the orders leave 3% of the energy.
_FINENESS = 0.25


def microfacet_times(place: Workplace) -> Outcome:
    """Seconds, milliseconds and ratios beside the paper's."""
    values, views = room(_HEIGHT), local_views(_SIDE)
    image, pixel = _sampled_pixels(_QUICK_STRIDE if place.quick else _STRIDE)
    seen_from = world_views(views, image, pixel, _HEIGHT)
    share = len(pixel) / (len(views) * 2 * _HEIGHT**2)
    table = [
        [
            "σ",
            "F, P",
            "F, P for 97%",
            "angles [s]",
            "first [ms]",
            "SHRM [ms]",
            "all maps [ms]",
            "ratio",
            "paper",
        ]
    ]
    table[0] += ["ten times that", "one map over SHRM", "paper", "differ"]
    gains, maps_gains = [], []
    maps = np.empty((len(views), 3, _HEIGHT, 2 * _HEIGHT), np.float32)
    with over_angles() as angles, threadpool_limits(1):
        for sigma, (f, p, *published) in _PUBLISHED.items():
            if place.quick and sigma > 0.1:
                continue
            integrated = partial(angles.microfacets, values, pixel, seen_from, sigma)
            mapped = partial(by_harmonics, values, sigma, f, p)

            def drawn(mapped: Callable[[], ReflectionMap] = mapped) -> Singles:
                return mapped().seen_from(views, maps)

            first = seconds(mapped)
            rounds, repeats = (1, 1) if place.quick else (3, 10)
            times = [
                (seconds(integrated), seconds(mapped, repeats), seconds(drawn, repeats))
                for _ in range(rounds)
            ]
            slow, shrm, fast = (median(column) for column in zip(*times, strict=True))
            slow /= share
            theirs, ours = integrated(), drawn().reshape(len(views), 3, -1)[image, :, pixel]
            differ = np.sqrt(np.mean((ours - theirs) ** 2) / np.mean(theirs**2))
            own = lobe_orders(simplified_microfacet(sigma), 0.03, 30, 6)
            ratio, paper = slow / fast, published[0] / published[1]
            of_map, paper_map = slow / len(views) / shrm, published[0] / len(views) / published[2]
            gains.append(ratio / paper)
            maps_gains.append(of_map / paper_map)
            table.append(
                [f"{sigma}", f"{f}, {p}", f"{own[0]}, {own[1]}", f"{slow:.0f}"]
                + [f"{1e3 * each:.3g}" for each in (first, shrm, fast)]
                + [f"{ratio:.0f}", f"{paper:.0f}", f"{10 * paper:.0f}"]
                + [f"{of_map:.0f}", f"{paper_map:.1f}", f"{differ:.1%}"]
            )
    ten = sum(gain >= 10 for gain in gains)
    return Outcome(
        "three to four orders of magnitude faster; the whole SHRM faster than one map",
        f"{table[1][7]} (σ = 0.1) to {table[-1][7]} times as fast; ten times the paper's ratio in {ten} of"
        f" {len(gains)} rows",
        f"Ratios are {min(gains):.0f} to {max(gains):.0f} times the paper's, those of one map to the whole SHRM"
        f" {min(maps_gains):.0f} to {max(maps_gains):.0f} times. Integration is C, compiled here, over all but 5% of"
        " the lobe; a hundred maps. `SHRM` is all of it: coefficients of lobe and light, products, synthesis; `all"
        " maps` is that and its hundred maps; `first` is the first of its orders, whose rotation matrices are then"
        " kept. Processor time of one core. `differ` is the relative RMS between both: 3% of the lobe's energy are"
        " left out, which is 17% of its values. The orders that hold 97% of the energy are ours by quadrature,"
        " beside the paper's.",
        table=table,
    )


def by_harmonics(values: Singles, sigma: float, l_max: int, p_max: int) -> ReflectionMap:
    """The reflection map of the lobe under a map (h, 2h, 3), as lightfactor makes it [R02, eq. 5.34]."""
    rho, _ = lobe_coefficients(simplified_microfacet(sigma), l_max, p_max, _FINENESS)
    return reflection_map(values, rho, _HEIGHT)


def _sampled_pixels(stride: int) -> tuple[Ints, Ints]:
    """Which map, and which of its pixels, (n,) each."""
    image, row, column = np.indices((_SIDE**2, -(-_HEIGHT // stride), -(-2 * _HEIGHT // stride)))
    row, column = stride * row + image // _SIDE, stride * column + image % _SIDE
    kept = (row < _HEIGHT) & (column < 2 * _HEIGHT)
    return image[kept].astype(np.int32), (2 * _HEIGHT * row + column)[kept].astype(np.int32)
