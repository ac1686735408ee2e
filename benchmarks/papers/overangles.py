"""Prefiltering by integration over angles in C, compiled where it is needed: what reflection maps are timed against.

A pixel of a map costs as many pixels of the light as the lobe reaches, as in [R02, section 5.6.4].
"""

from __future__ import annotations

import ctypes
import shutil
import subprocess
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from benchmarks.papers.entry import MissingMeansError
from capture.lighting import latlong_directions, latlong_solid_angles
from synthetic.lights.arealight import AreaLight
from synthetic.lights.illumination import latlong_map

Singles = NDArray[np.float32]
Ints = NDArray[np.int32]

_LIGHTS = (
    AreaLight(np.array([-0.26, 0.72, 0.64]), np.array([1.5, 1.6, 1.8]), width_rad=0.7),
    AreaLight(np.array([0.7, -0.1, -0.7]), np.array([0.9, 0.5, 0.3]), width_rad=1.0),
)
_SOURCE = """
#include <math.h>

/* The columns of a row at polar angle `other` that are within `least` (a cosine) of a pixel at polar angle `theta`. */
static void reached(int h, float theta, float other, float least, int *first, int *last)
{
    float turn = (least - cosf(theta) * cosf(other)) / (sinf(theta) * sinf(other));
    int side = turn <= -1 ? h : turn >= 1 ? 0 : (int)ceilf(acosf(turn) * h / 3.14159265f);
    *first = side >= h ? -h : -side;
    *last = side >= h ? h : side + 1;
}

/* Means of a lat-long map (h, 2h, 3) over Phong's lobe of exponent s about the centre of each pixel. */
void phong(int h, const float *direction, const float *solid, const float *map, float s, float reach, float *out)
{
    const float step = 3.14159265f / h, least = cosf(reach);
    for (int i = 0; i < h; i++)
        for (int j = 0; j < 2 * h; j++) {
            const float *about = direction + 3 * (2 * h * i + j), theta = step * (i + 0.5f);
            float sum[3] = {0, 0, 0}, total = 0;
            int top = (int)floorf((theta - reach) / step), bottom = (int)ceilf((theta + reach) / step);
            for (int r = top < 0 ? 0 : top; r < (bottom > h ? h : bottom); r++) {
                int first, last;
                reached(h, theta, step * (r + 0.5f), least, &first, &last);
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

/* What n views see of a lat-long map (h, 2h, 3): the lobe exp(-(theta_h / s)^2) / (4 pi s^2) over pixels above the
   horizon, as far as `reach` from the mirrored direction, the centre of a pixel of the same grid. */
void microfacets(int n, const int *pixels, const float *views, int h, const float *direction, const float *solid,
                 const float *map, float s, float reach, float *out)
{
    const float pi = 3.14159265f, step = pi / h, scale = 1 / (4 * pi * s * s);
    const float least = reach < pi ? cosf(reach) : -1.01f;
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
            int first, last;
            reached(h, theta, step * (r + 0.5f), least, &first, &last);
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


class OverAngles:
    """Integration over angles. left_out : the share of a lobe's integral that it may leave out, 5% in the paper."""

    def __init__(self, library: ctypes.CDLL) -> None:
        single, whole = (np.ctypeslib.ndpointer(kind, flags="C") for kind in (np.float32, np.int32))
        grid, lobe = [ctypes.c_int, single, single, single], [ctypes.c_float, ctypes.c_float, single]
        self._phong, self._microfacets = library.phong, library.microfacets
        self._phong.argtypes = grid + lobe
        self._microfacets.argtypes = [ctypes.c_int, whole, single, *grid, *lobe]
        self._phong.restype = self._microfacets.restype = None

    def phong(self, values: Singles, exponent: float, left_out: float = 0.05) -> Singles:
        """A map (h, 2h, 3) filtered by Phong's lobe, as large."""
        reach = float(np.arccos(left_out ** (1 / (exponent + 1))))
        out = np.empty_like(values)
        self._phong(
            len(values), *_map_pixels(len(values)), np.ascontiguousarray(values), exponent, reach, out
        )
        return out

    def microfacets(
        self, values: Singles, pixels: Ints, views: Singles, sigma: float, left_out: float = 0.05
    ) -> Singles:
        """Radiance (n, 3) at pixels (n,) of the map's own grid, mirrored directions, seen from (n, 3) in the world."""
        # Beyond this half-vector's angle is so much of the integral of the lobe; the light is twice as far.
        reach = 2 * sigma * float(np.sqrt(-np.log(left_out)))
        out = np.empty((len(pixels), 3), np.float32)
        grid = (len(values), *_map_pixels(len(values)), np.ascontiguousarray(values))
        self._microfacets(len(pixels), pixels, np.ascontiguousarray(views), *grid, sigma, reach, out)
        return out


@contextmanager
def over_angles() -> Iterator[OverAngles]:
    """The integration, compiled; MissingMeansError where there is no C compiler."""
    compiler = shutil.which("cc")
    if compiler is None:
        raise MissingMeansError("there is no C compiler (cc), so nothing to compare with")
    with tempfile.TemporaryDirectory() as folder:
        source, library = Path(folder, "angles.c"), Path(folder, "angles.so")
        source.write_text(_SOURCE, encoding="utf-8")
        subprocess.run(
            [compiler, "-O3", "-shared", "-fPIC", str(source), "-o", str(library), "-lm"], check=True
        )
        yield OverAngles(ctypes.CDLL(str(library)))


def room(height: int) -> Singles:
    """Two area lights in a grey room, (height, 2 height, 3)."""
    return np.asarray(latlong_map(_LIGHTS, height).astype(np.float32) + np.float32(0.1))


def world_views(local: NDArray[np.float64], image: Ints, pixel: Ints, height: int) -> Singles:
    """Views (n, 3) in the world, Rz(beta) Ry(alpha) of local ones (k, 3): which, (n,), at which pixels, (n,)."""
    about = latlong_directions(height).reshape(-1, 3)[pixel]
    level = np.linalg.norm(about[:, :2], axis=1)
    y = np.stack([-about[:, 1] / level, about[:, 0] / level, np.zeros_like(level)], axis=-1)
    frames = np.stack([np.cross(y, about), y, about], axis=-1)
    return np.ascontiguousarray(np.einsum("nkj,nj->nk", frames, local[image]), np.float32)


def local_views(side: int) -> NDArray[np.float64]:
    """Directions (side^2, 3) about the mirrored one, at centres of equal steps in polar angle and azimuth."""
    steps = (np.arange(side) + 0.5) * np.pi / side
    theta, phi = np.meshgrid(steps, 2 * steps, indexing="ij")
    sin = np.sin(theta)
    return np.stack([sin * np.cos(phi), sin * np.sin(phi), np.cos(theta)], axis=-1).reshape(-1, 3)


def _map_pixels(height: int) -> tuple[Singles, Singles]:
    """Directions (h, 2h, 3) and solid angles (h, 2h) of a map's pixels, as C reads them."""
    directions = np.ascontiguousarray(latlong_directions(height), np.float32)
    solid = np.broadcast_to(latlong_solid_angles(height), directions.shape[:2])
    return directions, np.ascontiguousarray(solid, np.float32)
