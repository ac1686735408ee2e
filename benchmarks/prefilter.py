"""Prefiltering an environment for Phong's lobe: by harmonics, and by integration over angles [R02, table 5.4].

    python -m benchmarks.prefilter [ROUNDS [LEAST_EXPONENT]]

A colour map of 128 x 256 pixels, filtered for each of as many directions, on one core. The integration is
plain C, compiled here, over those pixels alone that the lobe reaches: all but 5% of it, as in the paper; the harmonics
go to degree 1 + sqrt(6 s), all but 1%. They take turns; ratios of the medians count. `differ` is the relative RMS
between both results. Needs a C compiler, and says so where there is none.
"""

from __future__ import annotations

import ctypes
import shutil
import sys
import tempfile
import time
from collections.abc import Callable, Mapping
from functools import partial
from pathlib import Path
from statistics import median

import numpy as np
from numpy.typing import NDArray
from threadpoolctl import threadpool_limits

from benchmarks.overangles import HEIGHT, LEFT_OUT, compiled, light_map, map_pixels
from invrender.prefilter.complexity import crossover, measured_crossover
from invrender.theory.convolution import filtered
from invrender.theory.specialcases import phong_transfer
from recon.harmonics.latlong import analyse_latlong, synthesise_latlong

Floats = NDArray[np.float64]

# Exponents, and the paper's ratio of times at each.
_PUBLISHED = {8: 830.6, 16: 333.6, 32: 137.1, 64: 52.6, 128: 21.9, 256: 7.7, 512: 3.3}
_ROUNDS = 3
_SOURCE = """
#include <math.h>

/* Means of a lat-long map (h, 2h, 3) over Phong's lobe of exponent s about the centre of each pixel. */
void prefilter(int h, const float *direction, const float *solid, const float *map, float s, float reach, float *out)
{
    const float pi = 3.14159265f, step = pi / h, least = cosf(reach);
    for (int i = 0; i < h; i++)
        for (int j = 0; j < 2 * h; j++) {
            const float *about = direction + 3 * (2 * h * i + j), theta = step * (i + 0.5f);
            float sum[3] = {0, 0, 0}, total = 0;
            int top = (int)floorf((theta - reach) / step), bottom = (int)ceilf((theta + reach) / step);
            for (int r = top < 0 ? 0 : top; r < (bottom > h ? h : bottom); r++) {
                float other = step * (r + 0.5f);
                float turn = (least - cosf(theta) * cosf(other)) / (sinf(theta) * sinf(other));
                int side = turn <= -1 ? h : turn >= 1 ? 0 : (int)ceilf(acosf(turn) / step);
                int first = side >= h ? -h : -side, last = side >= h ? h : side + 1;
                for (int c = first; c < last; c++) {
                    int pixel = 2 * h * r + (j + c + 2 * h) % (2 * h);
                    const float *w = direction + 3 * pixel;
                    float cosine = about[0] * w[0] + about[1] * w[1] + about[2] * w[2];
                    if (cosine < least)
                        continue;
                    float weight = powf(cosine, s) * solid[pixel];
                    total += weight;
                    for (int k = 0; k < 3; k++)
                        sum[k] += weight * map[3 * pixel + k];
                }
            }
            for (int k = 0; k < 3; k++)
                out[3 * (2 * h * i + j) + k] = sum[k] / total;
        }
}
"""


def main(rounds: int, least_exponent: int) -> None:
    """Print milliseconds and ratios."""
    compiler = shutil.which("cc")
    if compiler is None:
        print("There is no C compiler (cc), so nothing to compare with.")
        return
    values = light_map()
    titles = ("exponent", "degree", "angles", "harmonics", "ratio", "paper", "goal", "differ")
    print(" ".join(f"{title:>9}" for title in titles))
    with tempfile.TemporaryDirectory() as folder, threadpool_limits(1):
        over_angles = _compiled(compiler, Path(folder))
        ratios: dict[int, float] = {}
        for exponent, published in _PUBLISHED.items():
            if exponent < least_exponent:
                continue
            degree = 1 + int(np.ceil(np.sqrt(6 * exponent)))
            integrated, summed = (
                partial(over_angles, values, exponent),
                partial(by_harmonics, values, exponent, degree),
            )
            slow, fast = _medians(integrated, summed, rounds)
            ratios[exponent] = slow / fast
            theirs, ours = integrated(), summed()
            differ = np.sqrt(np.mean((ours - theirs) ** 2) / np.mean(theirs**2))
            print(
                f"{exponent:9d} {degree:9d} {1e3 * slow:7.1f}ms {1e3 * fast:7.3f}ms {slow / fast:9.0f} {published:9.1f}"
                f" {10 * published:9.0f} {differ:9.2%}",
                flush=True,
            )
    print(crossover_line(ratios))


def crossover_line(ratios: Mapping[int, float]) -> str:
    """From which exponent on integration is faster: as predicted, and by the ratios of times at exponents."""
    published = measured_crossover(list(_PUBLISHED), list(_PUBLISHED.values()))
    try:
        measured = measured_crossover(list(ratios), list(ratios.values()))
    except ValueError:
        # Of few rounds on a busy machine ratios needn't fall.
        found = "these ratios don't fall, so that they name none"
    else:
        found = f"from {float(f'{measured:.2g}'):,.0f} on by the last two ratios"
    return (
        f"Integration is faster from exponent {crossover(HEIGHT):.0f} on as predicted [R02, eq. 5.33]; {found}; by the"
        f" paper's from {float(f'{published:.2g}'):,.0f} on."
    )


def by_harmonics(values: NDArray[np.float32], exponent: int, degree: int) -> Floats:
    """A map (h, 2h, 3) filtered by Phong's lobe, as lightfactor does it."""
    return synthesise_latlong(
        filtered(analyse_latlong(values, degree), phong_transfer(float(exponent), degree)).real, HEIGHT
    )


def _compiled(compiler: str, folder: Path) -> Callable[[NDArray[np.float32], int], NDArray[np.float32]]:
    integrate = compiled(compiler, folder, _SOURCE).prefilter
    pointer = np.ctypeslib.ndpointer(np.float32, flags="C")
    integrate.argtypes = [ctypes.c_int, pointer, pointer, pointer, ctypes.c_float, ctypes.c_float, pointer]
    integrate.restype = None
    directions, solid = map_pixels()

    def over_angles(values: NDArray[np.float32], exponent: int) -> NDArray[np.float32]:
        # Beyond this angle is so much of the integral of cos^s.
        reach = float(np.arccos(LEFT_OUT ** (1 / (exponent + 1))))
        out = np.empty_like(values)
        integrate(HEIGHT, directions, solid, np.ascontiguousarray(values), exponent, reach, out)
        return out

    return over_angles


def _medians(slow: Callable[[], object], fast: Callable[[], object], rounds: int) -> tuple[float, float]:
    times: tuple[list[float], list[float]] = ([], [])
    for _ in range(rounds):
        for kept, work, repeats in ((times[0], slow, 1), (times[1], fast, 20)):
            start = time.perf_counter()
            for _ in range(repeats):
                work()
            kept.append((time.perf_counter() - start) / repeats)
    return median(times[0]), median(times[1])


if __name__ == "__main__":
    rounds, least_exponent = [*map(int, sys.argv[1:]), *(_ROUNDS, 0)[len(sys.argv) - 1 :]]
    main(rounds, least_exponent)
