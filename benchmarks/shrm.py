"""Reflection maps of a microfacet lobe: by harmonics, and by integration over angles [R02, table 5.5].

    python -m benchmarks.shrm [ROUNDS [LARGEST_SIGMA]]

A colour map of 128 x 256 pixels, and what is seen of it in as many mirrored directions from each of 10 x 10 directions
about these: a hundred reflection maps. The integration is plain C, compiled here, over those pixels alone that the
lobe reaches: all but 5% of it, as in benchmarks.prefilter. It is done at every tenth row and column, each map's from
another one on, and counts for the share of the pixels that these are. The harmonics go to the paper's own F and P of
each sigma. `shrm` is all of the spherical harmonic reflection map: coefficients of lobe and light, products, synthesis;
`harmonics` is that and its hundred maps. `first` is the first of its orders, whose rotation matrices are then kept.
They take turns; ratios of the medians count, of processor time on one core. `one map` is the ratio of one map by
integration to the whole SHRM. `differ` is the relative RMS between both results. Needs a C compiler, and says so where
there is none.
"""

from __future__ import annotations

import ctypes
import shutil
import sys
import tempfile
import time
from collections.abc import Callable
from functools import partial
from pathlib import Path
from statistics import median

import numpy as np
from numpy.typing import NDArray
from threadpoolctl import threadpool_limits

from benchmarks.overangles import HEIGHT, LEFT_OUT, compiled, light_map, map_pixels
from capture.lighting import latlong_directions
from invrender.brdf.form import Angles
from invrender.brdf.lobes import RH01_FORM
from invrender.prefilter.reflectionmap import ReflectionMap, lobe_coefficients, reflection_map

Floats = NDArray[np.float64]
Singles = NDArray[np.float32]
Ints = NDArray[np.int32]

# Sigma: the paper's F and P, seconds by integration and by harmonics, and the latter of the SHRM alone.
_PUBLISHED = {
    0.1: (24, 3, 923, 2.70, 1.55),
    0.2: (12, 2, 2744, 1.55, 0.72),
    0.3: (7, 2, 5731, 1.49, 0.67),
    0.4: (5, 2, 9034, 1.47, 0.65),
    0.5: (5, 2, 12580, 1.45, 0.64),
}
_SIDE, _STRIDE, _ROUNDS, _REPEATS = 10, 10, 3, 10
# Of the lobe's quadrature: 0.2% of its largest coefficient, where the orders leave 3% of the energy.
_FINENESS = 0.25
_SOURCE = """
#include <math.h>

/* What n views see of a lat-long map (h, 2h, 3): the lobe exp(-(theta_h / s)^2) / (4 pi s^2) over pixels above the
   horizon, as far as `reach` from the mirrored direction, the centre of a pixel of the same grid. */
void integrate(int n, const int *pixels, const float *views, int h, const float *direction, const float *solid,
               const float *map, float s, float reach, float *out)
{
    const float pi = 3.14159265f, step = pi / h, least = cosf(reach), scale = 1 / (4 * pi * s * s);
    for (int k = 0; k < n; k++) {
        int i = pixels[k] / (2 * h), j = pixels[k] % (2 * h);
        const float *about = direction + 3 * pixels[k], *view = views + 3 * k;
        float theta = step * (i + 0.5f), sum[3] = {0, 0, 0}, normal[3], length = 0;
        for (int a = 0; a < 3; a++) {
            normal[a] = about[a] + view[a];
            length += normal[a] * normal[a];
        }
        for (int a = 0; a < 3; a++)
            normal[a] /= sqrtf(length);
        int top = (int)floorf((theta - reach) / step), bottom = (int)ceilf((theta + reach) / step);
        for (int r = top < 0 ? 0 : top; r < (bottom > h ? h : bottom); r++) {
            float other = step * (r + 0.5f);
            float turn = (least - cosf(theta) * cosf(other)) / (sinf(theta) * sinf(other));
            int side = turn <= -1 ? h : turn >= 1 ? 0 : (int)ceilf(acosf(turn) / step);
            int first = side >= h ? -h : -side, last = side >= h ? h : side + 1;
            for (int c = first; c < last; c++) {
                int pixel = 2 * h * r + (j + c + 2 * h) % (2 * h);
                const float *w = direction + 3 * pixel;
                float x = w[0] + view[0], y = w[1] + view[1], z = w[2] + view[2];
                if (about[0] * w[0] + about[1] * w[1] + about[2] * w[2] < least
                    || normal[0] * w[0] + normal[1] * w[1] + normal[2] * w[2] <= 0)
                    continue;
                float cosine = (normal[0] * x + normal[1] * y + normal[2] * z) / sqrtf(x * x + y * y + z * z);
                float ratio = acosf(cosine < 1 ? cosine : 1) / s;
                float weight = expf(-ratio * ratio) * scale * solid[pixel];
                for (int a = 0; a < 3; a++)
                    sum[a] += weight * map[3 * pixel + a];
            }
        }
        for (int a = 0; a < 3; a++)
            out[3 * k + a] = sum[a];
    }
}
"""


def main(rounds: int, largest_sigma: float) -> None:
    """Print seconds, milliseconds and ratios."""
    compiler = shutil.which("cc")
    if compiler is None:
        print("There is no C compiler (cc), so nothing to compare with.")
        return
    values = light_map()
    views = _local_views()
    image, pixel = _sampled_pixels()
    seen_from = _world_views(views, image, pixel)
    share = len(pixel) / (len(views) * 2 * HEIGHT**2)
    titles = ("sigma", "F, P", "angles", "first", "shrm", "harmonics", "ratio", "paper", "goal")
    print(" ".join(f"{title:>9}" for title in (*titles, "one map", "paper", "differ")))
    with tempfile.TemporaryDirectory() as folder, threadpool_limits(1):
        over_angles = _compiled(compiler, Path(folder))
        maps = np.empty((len(views), 3, HEIGHT, 2 * HEIGHT), np.float32)
        for sigma, (f, p, *published) in _PUBLISHED.items():
            if sigma > largest_sigma:
                continue
            integrated = partial(over_angles, values, pixel, seen_from, sigma)
            mapped = partial(by_harmonics, values, sigma, f, p)

            def drawn(mapped: Callable[[], ReflectionMap] = mapped) -> Singles:
                return mapped().seen_from(views, maps)

            first = _seconds(mapped, 1)
            times = [
                (_seconds(integrated, 1), _seconds(mapped, _REPEATS), _seconds(drawn, _REPEATS))
                for _ in range(rounds)
            ]
            slow, shrm, fast = (median(column) for column in zip(*times, strict=True))
            slow /= share
            theirs, ours = integrated(), drawn().reshape(len(views), 3, -1)[image, :, pixel]
            differ = np.sqrt(np.mean((ours - theirs) ** 2) / np.mean(theirs**2))
            paper, paper_map = published[0] / published[1], published[0] / len(views) / published[2]
            print(
                f"{sigma:9.1f} {f'{f}, {p}':>9} {slow:8.1f}s {1e3 * first:7.1f}ms {1e3 * shrm:7.2f}ms",
                f"{1e3 * fast:7.2f}ms {slow / fast:9.0f} {paper:9.0f} {10 * paper:9.0f}",
                f"{slow / len(views) / shrm:9.0f} {paper_map:9.1f} {differ:9.2%}",
                flush=True,
            )


def by_harmonics(values: Singles, sigma: float, l_max: int, p_max: int) -> ReflectionMap:
    """The reflection map of the lobe under a map (h, 2h, 3), as lightfactor makes it."""

    def lobe(normals: Floats, wi: Floats, wo: Floats) -> Floats:
        angles = Angles.between(normals, wi, wo)
        return RH01_FORM.shape(angles, sigma) * angles.cos_o  # [R02, eq. 5.34] above the horizon

    rho, _ = lobe_coefficients(lobe, l_max, p_max, _FINENESS)
    return reflection_map(values, rho, HEIGHT)


def _local_views() -> Floats:
    """Directions (100, 3) about the mirrored one."""
    theta, phi = np.meshgrid(
        (np.arange(_SIDE) + 0.5) * np.pi / _SIDE,
        (np.arange(_SIDE) + 0.5) * 2 * np.pi / _SIDE,
        indexing="ij",
    )
    sin = np.sin(theta)
    return np.stack([sin * np.cos(phi), sin * np.sin(phi), np.cos(theta)], axis=-1).reshape(-1, 3)


def _sampled_pixels() -> tuple[Ints, Ints]:
    """Which map, and which of its pixels, (n,) each."""
    image, row, column = np.indices((_SIDE**2, -(-HEIGHT // _STRIDE), -(-2 * HEIGHT // _STRIDE)))
    row, column = _STRIDE * row + image // _SIDE, _STRIDE * column + image % _SIDE
    kept = (row < HEIGHT) & (column < 2 * HEIGHT)
    return image[kept].astype(np.int32), (2 * HEIGHT * row + column)[kept].astype(np.int32)


def _world_views(local: Floats, image: Ints, pixel: Ints) -> Singles:
    """Views (n, 3) in the world: Rz(beta) Ry(alpha) of the local ones."""
    about = latlong_directions(HEIGHT).reshape(-1, 3)[pixel]
    level = np.linalg.norm(about[:, :2], axis=1)
    y = np.stack([-about[:, 1] / level, about[:, 0] / level, np.zeros_like(level)], axis=-1)
    frames = np.stack([np.cross(y, about), y, about], axis=-1)
    return np.ascontiguousarray(np.einsum("nkj,nj->nk", frames, local[image]), np.float32)


def _compiled(compiler: str, folder: Path) -> Callable[[Singles, Ints, Singles, float], Singles]:
    integrate = compiled(compiler, folder, _SOURCE).integrate
    single, whole = (np.ctypeslib.ndpointer(kind, flags="C") for kind in (np.float32, np.int32))
    integrate.argtypes = [ctypes.c_int, whole, single, ctypes.c_int, single, single, single]
    integrate.argtypes += [ctypes.c_float, ctypes.c_float, single]
    integrate.restype = None
    directions, solid = map_pixels()

    def over_angles(values: Singles, pixels: Ints, views: Singles, sigma: float) -> Singles:
        # Beyond this half-vector's angle is so much of the integral of the lobe; the light is twice as far.
        reach = 2 * sigma * float(np.sqrt(-np.log(LEFT_OUT)))
        out = np.empty((len(pixels), 3), np.float32)
        integrate(len(pixels), pixels, views, HEIGHT, directions, solid, values, sigma, reach, out)
        return out

    return over_angles


def _seconds(work: Callable[[], object], repeats: int) -> float:
    start = time.process_time()
    for _ in range(repeats):
        work()
    return (time.process_time() - start) / repeats


if __name__ == "__main__":
    main(int(sys.argv[1]) if sys.argv[1:] else _ROUNDS, float(sys.argv[2]) if sys.argv[2:] else 0.5)
