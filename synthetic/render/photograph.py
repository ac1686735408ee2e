"""Photographs of a scene without noise: mean radiance over each pixel's square.

A photograph is made in tiles, sets of pixels that are integrated on their own, with their own random numbers: so the
result depends neither on how many threads share the work nor on their order.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Callable, Iterable, Iterator
from functools import partial
from itertools import groupby
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from capture.parallel import parallel_map
from capture.tasks.stage import stage_results
from synthetic.render.gather import direct_light
from synthetic.render.lattice import dealt
from synthetic.render.paths import indirect_light
from synthetic.render.pixels import looked_at, pixel_coverage
from synthetic.render.radiosity import PartsLight, bounced_light, parts_light
from synthetic.render.spherepixels import sphere_means
from synthetic.scene import Scene, Shot
from synthetic.shapes.meshsurface import MeshSurface
from synthetic.shapes.surface import Points
from synthetic.vectors import sums_by_row

Floats = NDArray[np.float64]
Ints = NDArray[np.int64]
Progress = Callable[[Iterable[Any], str], Iterable[Any]]

# What tiles are kept as until the whole set is there.
STAGE = "tiles"
_PIXELS_PER_TILE = 2048
# Per sub-sample of a pixel.
_MIRROR_PATHS = 4


class Tile(NamedTuple):
    """Pixels (n, 2), (column, row), of the photograph numbered so; the tile's number in it fixes its random numbers."""

    photograph: int
    number: int
    pixels: Ints


def photographs(scene: Scene, progress: Progress | None = None) -> Iterator[tuple[Floats, Floats]]:
    """Radiance (h, w, 3) and coverage (h, w) of each photograph, in order; few are held at a time.

    progress : called with the steps of the work and a description; iterates over what it returns.
    """
    coverages: dict[int, Floats] = {}
    begun: deque[Tile] = deque()

    def work() -> Iterator[Tile]:
        cameras = [shot.camera for shot in scene.shots]
        seen = parallel_map(partial(pixel_coverage, scene.surface), cameras)
        for index, (shot, coverage) in enumerate(zip(scene.shots, seen, strict=True)):
            coverages[index] = coverage
            if not coverages[index].any():
                raise ValueError(f"scene {scene.name!r}: camera {index} sees nothing of the object")
            _parts(scene, shot)
            for tile in tiles(index, coverages[index]):
                begun.append(tile)
                yield tile

    computed = stage_results(STAGE, partial(tile_radiance, scene), work(), _named)
    done = ((begun.popleft(), radiance) for radiance in computed)
    finished = groupby(done, key=lambda result: result[0].photograph)
    count = range(len(scene.shots))
    for _ in progress(count, "Photographing") if progress else count:
        index, parts = next(finished)
        coverage = coverages.pop(index)
        radiance = np.zeros((*coverage.shape, 3))
        for tile, means in parts:
            radiance[tile.pixels[:, 1], tile.pixels[:, 0]] = means
        yield radiance, coverage


def _named(tile: Tile) -> str:
    return f"photograph {tile.photograph}, tile {tile.number}"


def tiles(index: int, coverage: Floats) -> list[Tile]:
    """The covered pixels of photograph `index` in tiles."""
    rows, columns = np.nonzero(coverage)
    pixels = np.column_stack([columns, rows])
    starts = range(0, len(pixels), _PIXELS_PER_TILE)
    return [Tile(index, k, pixels[start : start + _PIXELS_PER_TILE]) for k, start in enumerate(starts)]


def tile_radiance(scene: Scene, tile: Tile) -> Floats:
    """Mean radiance (n, 3) over a tile's pixels; what misses the surface is black."""
    shot = scene.shots[tile.photograph]
    smooth = sphere_means(
        scene.surface, scene.material, shot.illumination, shot.camera, tile.pixels, len(scene.shots)
    )
    return _means(scene, tile, plain=False) if smooth is None else smooth


def plain_radiance(scene: Scene, tile: Tile) -> Floats:
    """As `tile_radiance`, by plain sums whatever the scene."""
    return _means(scene, tile, plain=True)


def _means(scene: Scene, tile: Tile, plain: bool) -> Floats:
    shot, effort, pixels = scene.shots[tile.photograph], scene.effort, tile.pixels
    rng = np.random.default_rng([scene.seed, tile.photograph, tile.number])
    pixel, place, weight, points, views = looked_at(scene.surface, shot.camera, pixels, effort.per_side)
    lattices = dealt(effort.directions, effort.per_side**2)[place]
    radiance = weight[:, None] * _radiance(scene, shot, points, views, lattices, pixel, rng, plain)
    return sums_by_row(pixel, radiance, len(pixels))


def _parts(scene: Scene, shot: Shot) -> PartsLight | None:
    """What the parts of the object send each other: computed by the first who asks, on all cores, and kept.

    None where it doesn't apply: without bounces, and to mirrors, which show sharply what no vertex can hold.
    """
    surface, material, bounces = scene.surface, scene.material, scene.effort.bounces
    if not bounces or material.is_mirror or not isinstance(surface, MeshSurface):
        return None
    return parts_light(surface, material, shot.illumination, bounces)


def _radiance(
    scene: Scene,
    shot: Shot,
    points: Points,
    views: Floats,
    lattices: Floats,
    pixel: Ints,
    rng: np.random.Generator,
    plain: bool,
) -> Floats:
    """Radiance (n, 3) at points (n) towards views (n, 3)."""
    surface, material, light = scene.surface, scene.material, shot.illumination
    irradiance, lobe = direct_light(surface, material, light, points, views, lattices, rng, pixel)
    kd, ks = material.weights(points.uv)
    radiance: Floats = kd * irradiance + ks * lobe
    if (parts := _parts(scene, shot)) is not None:
        radiance += bounced_light(parts, points, views, lattices, rng, pixel, everywhere=plain)
    elif scene.effort.bounces and not surface.convex:
        # A mirror's paths have one way to go: few do.
        again = np.repeat(np.arange(len(points)), _MIRROR_PATHS)
        bounces = scene.effort.bounces
        followed = indirect_light(surface, material, light, points[again], views[again], bounces, rng)
        radiance += followed.reshape(len(points), -1, 3).mean(axis=1)
    return radiance
