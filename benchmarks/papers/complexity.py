"""R02's table 5.3: how prefiltering's cost grows with resolutions, orders and the width of the lobe."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from functools import partial

import numpy as np
from threadpoolctl import threadpool_limits

from benchmarks.papers.entry import Outcome, Workplace
from benchmarks.papers.overangles import OverAngles, local_views, over_angles, room, world_views
from benchmarks.papers.processortime import median_seconds
from invrender.prefilter.complexity import phong_width
from invrender.prefilter.reflectionmap import ReflectionMap, isotropic_terms, reflected_terms
from invrender.prefilter.symmetric import symmetric_map
from invrender.theory.specialcases import phong_transfer

# What one size takes: processor seconds.
Work = Callable[[int], Callable[[], object]]


def measured_exponents(place: Workplace) -> Outcome:
    """Slopes of processor time in doubly logarithmic scales, beside the printed exponents."""
    quick = place.quick
    table = [
        [
            "type",
            "domain",
            "printed cost",
            "varied",
            "sizes",
            "printed exponent",
            "ours",
            "seconds at the largest",
        ]
    ]
    off = []
    with over_angles() as angles, threadpool_limits(1):
        for kind, domain, cost, varied, printed, sizes, work in _measurements(angles):
            sizes = sizes[:2] if quick else sizes
            times = [median_seconds(work(size), 1 if quick else 3, 0.01 if quick else 0.1) for size in sizes]
            of = np.array([_width(size) for size in sizes]) if varied == "W" else np.array(sizes)
            slope = float(np.polyfit(np.log(of), np.log(times), 1)[0])
            off.append(slope - printed)
            shown = ", ".join(f"{each:.2g}" for each in of) if varied == "W" else ", ".join(map(str, sizes))
            row = [kind, domain, cost, varied, shown, f"{printed}", f"{slope:.2f}", f"{times[-1]:.2g}"]
            table.append(row)
    by_angles = [float(row[6]) - float(row[5]) for row in table[1:] if row[1] == "angles"]
    by_harmonics = [float(row[6]) - float(row[5]) for row in table[1:] if row[1] == "harmonics"]
    return Outcome(
        "exponents of S, F, P and W as in the table",
        f"integration within {max(map(abs, by_angles)):.2f} of the printed exponents; harmonics"
        f" {min(by_harmonics):+.2f} to {max(by_harmonics):+.2f}",
        "Processor time of one core, medians. The SHRM's sum over degrees, F² P² S, still counts at these sizes beside"
        " its sum over orders, F P² S²; so S comes to less than 2. Products with few columns are slower per operation"
        " than those with many; so P comes to less than 2, too. Above 2 in S, maps leave the cache. Integration spends"
        " part of its time at the ends of the rows that a lobe reaches, so that narrow lobes gain less than W. Explicit"
        " maps are printed as P per pixel, which needs views on a grid, summed over one angle after the other. Ours"
        " sums all (P + 1)² terms by one product, for views anywhere, and writing the maps is most of its time. Times"
        " of P go with P + 1, as R02's text says they should.",
        table=table,
    )


def _measurements(angles: OverAngles) -> list[tuple[str, str, str, str, int, Sequence[int], Work]]:
    """Type, domain, printed cost, what is varied, its printed exponent, sizes, and the work of a size."""

    def symmetric(rows: int, f: int) -> Callable[[], object]:
        return partial(symmetric_map, room(rows), phong_transfer(64.0, f), rows)

    def phong(rows: int, exponent: int) -> Callable[[], object]:
        return partial(angles.phong, room(rows), exponent)

    def shrm(rows: int, f: int, p: int) -> Callable[[], object]:
        rho = np.random.default_rng(1).normal(size=(f + 1, p + 1, min(f, p) + 1))
        l, degree, q = np.indices(rho.shape)
        terms, orders = isotropic_terms(np.where(q <= np.minimum(l, degree), rho, 0))
        lighting = np.random.default_rng(2).normal(size=((f + 1) ** 2, 3))
        return partial(reflected_terms, lighting, terms, orders, rows)

    def explicit(rows: int, p: int, side: int) -> Callable[[], object]:
        maps = ReflectionMap(np.ones(((p + 1) ** 2, 3, rows, 2 * rows), np.float32))
        out = np.empty((side**2, 3, rows, 2 * rows), np.float32)
        return partial(maps.seen_from, local_views(side), out)

    def microfacets(rows: int, side: int) -> Callable[[], object]:
        views, count = local_views(side), 4 * side**2
        image = np.arange(count, dtype=np.int32) % side**2
        pixel = (np.arange(count, dtype=np.int32) * 97) % (2 * rows**2)
        return partial(angles.microfacets, room(rows), pixel, world_views(views, image, pixel, rows), 0.2)

    # P + 1 of 2 to 8: below, what doesn't depend on it is most.
    one, shrm_cost, three = "F S²", "F P² S²", "P T² S²"
    return [
        ("1D", "angles", "W S⁴", "S", 4, (32, 64, 128), lambda s: phong(s, 64)),
        ("1D", "angles", "W S⁴", "W", 1, (128, 32, 8), lambda e: phong(48, e)),
        ("1D", "harmonics", one, "S", 2, (128, 256, 512), lambda s: symmetric(s, 20)),
        ("1D", "harmonics", one, "F", 1, (15, 31, 63), lambda f: symmetric(256, f)),
        ("SHRM", "harmonics", shrm_cost, "S", 2, (64, 128, 256), lambda s: shrm(s, 20, 2)),
        ("SHRM", "harmonics", shrm_cost, "F", 1, (15, 31, 63), lambda f: shrm(128, f, 2)),
        ("SHRM", "harmonics", shrm_cost, "P + 1", 2, (2, 4, 8), lambda p: shrm(64, 20, p - 1)),
        ("3D, explicit", "angles", "W S² T² S²", "T", 2, (4, 8, 16), lambda t: microfacets(64, t)),
        (
            "3D, explicit",
            "angles",
            "W S² T² S²",
            "S of the light",
            2,
            (32, 64, 128),
            lambda s: microfacets(s, 6),
        ),
        ("3D, explicit", "harmonics", three, "S", 2, (32, 64, 128), lambda s: explicit(s, 3, 8)),
        ("3D, explicit", "harmonics", three, "T", 2, (4, 8, 16), lambda t: explicit(64, 3, t)),
        ("3D, explicit", "harmonics", three, "P + 1", 1, (2, 4, 8), lambda p: explicit(64, p - 1, 8)),
    ]


def _width(exponent: int) -> float:
    return float(phong_width(exponent, 0.05))
