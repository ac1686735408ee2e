"""R02's table 5.4: prefiltering a map for Phong's lobe by harmonics, and by integration over angles."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from functools import partial
from statistics import median

import numpy as np
from threadpoolctl import threadpool_limits

from benchmarks.papers.entry import Outcome, Workplace
from benchmarks.papers.overangles import Singles, over_angles, room
from benchmarks.papers.processortime import median_seconds, seconds
from invrender.prefilter.complexity import crossover, measured_crossover, phong_width
from invrender.prefilter.symmetric import symmetric_map
from invrender.theory.convolution import filtered
from invrender.theory.specialcases import phong_transfer
from recon.harmonics.latlong import project_latlong, synthesise_latlong

_HEIGHT = 128
# Exponents: the paper's seconds by integration and by harmonics.
_PUBLISHED = {
    8: (67.28, 0.081),
    16: (38.03, 0.114),
    32: (21.80, 0.159),
    64: (11.94, 0.227),
    128: (7.17, 0.328),
    256: (3.55, 0.461),
    512: (2.28, 0.686),
}


def phong_times(place: Workplace) -> Outcome:
    """Milliseconds and ratios beside the paper's."""
    values, rounds = room(_HEIGHT), 1 if place.quick else 3
    table = [
        [
            "exponent",
            "degree",
            "angles [ms]",
            "plain harmonics [ms]",
            "products [ms]",
            "ratio",
            "paper",
            "ten times that",
        ]
    ]
    table[0].append("differ")
    ratios: dict[int, float] = {}
    slow_times, fast_times, operations = [], [], []
    with over_angles() as angles, threadpool_limits(1):
        for exponent in (256, 512) if place.quick else _PUBLISHED:
            degree = _degree(exponent)
            slow = median(seconds(partial(angles.phong, values, exponent)) for _ in range(rounds))
            fast = median_seconds(partial(by_products, values, exponent, degree), rounds)
            plain = median_seconds(partial(by_harmonics, values, exponent, degree), rounds)
            theirs, ours = angles.phong(values, exponent), by_products(values, exponent, degree)
            differ = np.sqrt(np.mean((ours - theirs) ** 2) / np.mean(theirs**2))
            ratios[exponent] = slow / fast
            slow_times.append(slow)
            fast_times.append(fast)
            # Along rows, to waves and back, which is most of it.
            operations.append(2 * 2 * 3 * _HEIGHT * 2 * _HEIGHT * 2 * (degree + 1))
            paper = _PUBLISHED[exponent][0] / _PUBLISHED[exponent][1]
            cells = [
                str(exponent),
                str(degree),
                f"{1e3 * slow:.0f}",
                *(f"{1e3 * time:.3g}" for time in (plain, fast)),
            ]
            table.append([*cells, f"{slow / fast:.0f}", f"{paper:.1f}", f"{10 * paper:.0f}", f"{differ:.2%}"])
        square = np.ones((800, 800), np.float32)
        bare = 2 * 800**3 / median_seconds(lambda: square @ square)
    reached = [count / fast / bare for count, fast in zip(operations, fast_times, strict=True)]
    rate = (
        f"What bounds them is BLAS: they reach {min(reached):.0%} (lowest degree) to {max(reached):.0%} of its rate for"
        " large squares."
    )
    ten = [s for s, ratio in ratios.items() if ratio >= 10 * _PUBLISHED[s][0] / _PUBLISHED[s][1]]
    gains = [ratio * _PUBLISHED[s][1] / _PUBLISHED[s][0] for s, ratio in ratios.items()]
    return Outcome(
        "830 times as fast at s = 8, 3.3 at s = 512",
        f"{max(ratios.values()):.0f} to {min(ratios.values()):.0f} times; ten times the paper's ratio in"
        f" {len(ten)} of {len(ratios)} rows",
        f"Ratios are {min(gains):.1f} to {max(gains):.1f} times the paper's. One core of one machine, processor time, a"
        f" colour map of {_HEIGHT} x {2 * _HEIGHT} pixels filtered for each of as many directions. Integration is C,"
        " compiled here (-O3), over all but 5% of the lobe, as in the paper; harmonics go to degree 1 + sqrt(6 s), all"
        " but 1%. Plain harmonics are FFTs in double precision. Products are matrix products in single precision, from"
        f" map to map (`invrender.prefilter.symmetric`). {rate} `differ` is the relative RMS between integration and"
        f" products. {_scaling(list(ratios), slow_times, fast_times)} {_crossover(ratios)}",
        table=table,
    )


def by_products(values: Singles, exponent: int, degree: int) -> Singles:
    """A map (h, 2h, 3) filtered by Phong's lobe, in single precision."""
    return symmetric_map(values, phong_transfer(float(exponent), degree), _HEIGHT).transpose(1, 2, 0)


def by_harmonics(values: Singles, exponent: int, degree: int) -> np.ndarray:
    """The same in double precision, by FFT."""
    transfer = phong_transfer(float(exponent), degree)
    return synthesise_latlong(filtered(project_latlong(values, degree), transfer).real, _HEIGHT)


def _degree(exponent: int) -> int:
    return 1 + int(np.ceil(np.sqrt(6 * exponent)))


def _scaling(exponents: Sequence[int], slow: Sequence[float], fast: Sequence[float]) -> str:
    """How both grow with the exponent, ours and the paper's."""

    def slope(times: Sequence[float]) -> float:
        return float(np.polyfit(np.log(exponents), np.log(times), 1)[0])

    printed = [[_PUBLISHED[s][column] for s in exponents] for column in (0, 1)]
    width = slope([float(phong_width(s, 0.05)) for s in exponents])
    return (
        f"Over the exponent integration grows as s^{slope(slow):.2f} (paper's times s^{slope(printed[0]):.2f}, its"
        f" eq. 5.32 s^-1, the width of eq. 5.30 s^{width:.2f}), harmonics as s^{slope(fast):.2f} (paper's"
        f" s^{slope(printed[1]):.2f}, its eq. 5.29 s^0.5)."
    )


def _crossover(ratios: Mapping[int, float]) -> str:
    """From which exponent on integration is faster: as predicted, and by the ratios of times at exponents."""
    published = measured_crossover(list(_PUBLISHED), [slow / fast for slow, fast in _PUBLISHED.values()])
    try:
        measured = measured_crossover(list(ratios), list(ratios.values()))
    except ValueError:
        # Of few rounds on a busy machine ratios needn't fall.
        found = "these ratios don't fall, so that they name none"
    else:
        found = f"from {float(f'{measured:.2g}'):,.0f} on by the last two ratios"
    return (
        f"Integration is faster from exponent {crossover(_HEIGHT):.0f} on as predicted [R02, eq. 5.33]; {found}; by the"
        f" paper's from {float(f'{published:.2g}'):,.0f} on."
    )
