"""Both passes through the photographs of a textured mesh: a subset of its points, then all that they show."""

from __future__ import annotations

import sys
from collections import Counter
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, fields, replace
from functools import partial

import numpy as np
from numpy.typing import NDArray

from capture.arrays import release_memory
from capture.lighting import Lighting
from capture.photo import Photo
from capture.photoset import PhotoSet
from capture.progress import Track
from capture.tasks.parted import Parts
from capture.tasks.stage import stage_results
from invrender.brdf.lobes import RH01_FORM
from invrender.brdf.microfacet import Microfacet
from invrender.estimate.noise import NoiseModel
from invrender.estimate.textured.cover import cover
from invrender.estimate.textured.fit import TexturedFit
from invrender.estimate.textured.joint import in_shadow, solve_apart, solve_joint
from invrender.estimate.textured.layout import Layout, SurfacePoints
from invrender.estimate.textured.observe import observe, points_for, squares_seen
from invrender.estimate.textured.search import TexturedModel, solved
from invrender.estimate.textured.seen import Seen, rows_of, transfers_of
from invrender.estimate.textured.texel_equations import PointValues, TexelEquations, Usual
from invrender.estimate.textured.texel_grid import Grid, SurfaceTiles
from invrender.estimate.textured.texel_observations import TexelRows
from invrender.estimate.textured.texel_pixels import PixelsOfPoints, stacked
from invrender.estimate.textured.textures import FittedTextures
from invrender.observation.clock import Clock
from invrender.observation.geometry import SceneGeometry
from invrender.observation.samples import PhotoReader
from invrender.transport.cached_shader import LOOKUPS_OFF, MANY_RAYS, maps_serve
from invrender.transport.radiosity import Bounced
from invrender.transport.reflected import prepared_map
from invrender.transport.transfer import LightElement, light_elements
from invrender.transport.visibility import Shadows
from recon.mesh.bodies import Body, body_coverage
from recon.sampling.lightfield import LightField

Floats = NDArray[np.float64]
Singles = NDArray[np.float32]
Ints = NDArray[np.int64]

# Pixels of all photographs that the texture is solved from, evenly taken of more: 200 bytes each.
_MOST_PIXELS = 6_000_000
# About so many of them are worked on at once, those of a tile of the surface.
_OF_A_TILE = 1_500_000
# What the second pass keeps until the result is there: those pixels, and what was solved of tiles.
PIXELS_STAGE, TILES_STAGE = "texture-pixels", "texture-tiles"
# A tile is solved with what lies around it, as far as its pixels' blur reaches: so many texels or pixels, whichever
# are wider, of pixels, and of texels.
_PIXELS_AROUND, _TEXELS_AROUND = 8.0, 11.0
# Every so manieth pixel tells how bright the brightest are; rows and columns by which a body's pixels are counted.
_EVERY, _STRIDE = 8, 8


@dataclass(frozen=True, eq=False)
class TextureBench:
    """What both passes need.

    bounced : per lighting, what parts of the mesh send each other, once that is known. looked_up : the lightings, by
    name, of which a prepared map tells what the fitted lobe reflects, as well as an integral for each ray.
    """

    reader: PhotoReader
    lightings: Mapping[str, Lighting]
    elements: Mapping[str, Sequence[LightElement]]
    shadows: Shadows | None
    bounced: Mapping[str, Bounced]
    looked_up: frozenset[str] = frozenset()

    @classmethod
    def of(
        cls, photoset: PhotoSet, geometry: SceneGeometry, lightings: Mapping[str, Lighting]
    ) -> TextureBench:
        """Of a set under lightings by name, as long as nothing is known of what bounces."""
        elements = {name: light_elements(lighting) for name, lighting in lightings.items()}
        return cls(PhotoReader.of(photoset, geometry.found), lightings, elements, geometry.shadows, {})

    def direct(self, lighting: str, pixels: LightField, brdf: Microfacet) -> tuple[Singles, Singles]:
        """Diffuse and specular transfers (n, 3) of a photograph's samples: radiance of Kd = 1, and of Ks = 1."""
        elements = self.elements[lighting]
        light = prepared_map(brdf, elements[0]) if lighting in self.looked_up else None
        return transfers_of(elements, pixels, brdf, self.shadows, light)

    def with_lookups(self, fit: TexturedFit, shown: Sequence[Seen]) -> TextureBench:
        """With prepared maps of the lightings where they are off by little against what the fit leaves.

        shown : what photographs show of some points, of each lighting that was fitted. Few rays aren't worth a map.
        """
        tolerance = LOOKUPS_OFF * fit.candidates[fit.chosen].error
        # The last is kept, which is the photograph that shows most.
        fields = {seen.lighting: seen.pixels for seen in sorted(shown, key=lambda seen: len(seen.pixels))}
        rays: Counter[str] = Counter()
        for seen in shown:
            rays[seen.lighting] += len(seen.pixels.ray_sample)
        lookups = frozenset(
            name
            for name, field in fields.items()
            if rays[name] >= MANY_RAYS
            and len(elements := self.elements[name]) == 1
            and maps_serve(fit.brdf, elements, np.ones((1, 3)), field, self.shadows, tolerance)
        )
        return replace(self, looked_up=lookups)

    def by_mesh(self, lighting: str, pixels: LightField, brdf: Microfacet) -> tuple[Singles, Singles]:
        """The same by light that other parts of the mesh send."""
        if lighting not in self.bounced:
            nothing = np.zeros((len(pixels), 3), np.float32)
            return nothing, nothing
        diffuse, specular = self.bounced[lighting].reflected(pixels, brdf)
        means = [pixels.mean_over_rays(rays).astype(np.float32) for rays in (diffuse, specular)]
        return means[0], means[1]


@dataclass(frozen=True, eq=False)
class PointSubset:
    """What photographs show of some of the points, and of each some pixels to report residuals of, by its label.

    numbers : (n,), of the points among all.
    """

    numbers: Ints
    points: SurfacePoints
    shown: Sequence[Seen]
    rows: Sequence[TexelRows]
    fields: Mapping[str, LightField]


@dataclass(frozen=True, eq=False)
class _ShownPoints:
    """What a photograph shows of some points, and some of its pixels, for residuals: `budget` of them."""

    bench: TextureBench
    points: SurfacePoints
    budget: int

    def __call__(
        self, numbered: tuple[int, Photo]
    ) -> tuple[LightField, tuple[Seen, TexelRows] | None, Mapping[str, float]]:
        """Of a photograph and its number; nothing of the points if it is held out. And seconds by package."""
        index, photo = numbered
        clock, bench, rng = Clock(), self.bench, np.random.default_rng(index)
        squares, sources = squares_seen(photo.camera, self.points), bench.lightings[photo.lighting].sources
        field, drawn = bench.reader.pixels_around(photo, squares, self.budget, sources, rng, clock)
        with clock.on("invrender"):
            found = None
            if not photo.held_out:
                observed = observe(bench.reader.body, photo.camera, field, self.points)
                seen = Seen.of(photo.lighting, observed, field)
                found = seen, rows_of(seen, bench.elements, (RH01_FORM,), bench.shadows)[RH01_FORM]
        keep = np.zeros(len(field), bool)
        keep[rng.permutation(np.flatnonzero(drawn))[: self.budget]] = True
        return field.where(keep), found, clock.seconds


def first_pass(
    bench: TextureBench, photoset: PhotoSet, points: SurfacePoints, samples: int, clock: Clock, track: Track
) -> PointSubset:
    """A subset of the points, about as many as are seen in so many samples."""
    photos, fitted = photoset.photos, photoset.fitted
    rng = np.random.default_rng(0)
    count = min(len(points), points_for(samples, len(fitted)))
    chosen = np.sort(rng.choice(len(points), count, replace=False))
    subset = points.where(chosen)
    shown_points = _ShownPoints(bench, subset, max(samples // len(fitted), 100))
    work = stage_results("texture-points", shown_points, enumerate(photos), lambda item: str(item[1].file))
    fields: dict[str, LightField] = {}
    shown, rows = [], []
    for photo in track(photos, "Reading photographs"):
        fields[photo.label], found, seconds = next(work)
        clock.add(seconds)
        if found is not None:
            shown.append(found[0])
            rows.append(found[1])
    return PointSubset(chosen, subset, shown, rows, fields)


@dataclass(frozen=True, eq=False)
class _Told:
    """What a photograph's pixels tell of it as a whole.

    brightest : as of `in_shadow`. lit : diffuse transfers of some. seconds : by package.
    """

    brightest: float
    lit: Singles
    seconds: Mapping[str, float]


@dataclass(frozen=True, eq=False)
class _PixelsGathered:
    """The usable pixels of a photograph, `most` of them, by the points that they cover, of one BRDF.

    around : metres that a tile's pixels reach beyond it.
    """

    bench: TextureBench
    brdf: Microfacet
    layout: Layout
    most: int
    tiles: SurfaceTiles
    around: float

    def __call__(self, photo: Photo) -> tuple[PixelsOfPoints | _Told, ...]:
        """Of a photograph: those of each tile, and last what they tell of it as a whole."""
        clock, bench = Clock(), self.bench
        parts: list[list[PixelsOfPoints]] = [[] for _ in range(len(self.tiles))]
        lit, brightest = [], 0.0
        for field in bench.reader.pixels(photo, self.most, bench.lightings[photo.lighting].sources, clock):
            with clock.on("invrender"):
                pixels = self._of(photo, field)
                lit.append(pixels.lit[::_EVERY])
                brightest = max(brightest, pixels.brightest)
                places = np.asarray(field.mean_over_rays(field.positions))
                for tile, own in enumerate(parts):
                    near = self.tiles.holds(tile, places, self.around)
                    own.append(pixels if near.all() else pixels.where(near))
        told = _Told(brightest, np.concatenate(lit), clock.seconds)
        return *(PixelsOfPoints.joined(own) for own in parts), told

    def _of(self, photo: Photo, field: LightField) -> PixelsOfPoints:
        bench = self.bench
        (d, s), (more_d, more_s) = (
            of(photo.lighting, field, self.brdf) for of in (bench.direct, bench.by_mesh)
        )
        lit = d.max(axis=1)
        # What other parts send makes the albedo brighter, but not more certain.
        direct = lit / np.maximum((d + more_d).max(axis=1), np.float32(1e-30))
        trust = (np.maximum(field.weight, 0.01) * direct**2)[:, None].astype(np.float32)
        covered = cover(bench.reader.body, photo.camera, field, self.layout)
        radiance = field.radiance.astype(np.float32)
        return PixelsOfPoints(covered, d + more_d, s + more_s, lit, radiance, trust, trust)


# The numbers of a tile's points, their values, none where no photograph shows the tile, and seconds by package.
_TileValues = tuple[Ints, tuple[PointValues, ...], Mapping[str, float]]


@dataclass(frozen=True, eq=False)
class _TileSolver:
    """Solves tiles of a surface from their pixels.

    solved : by tile, the points that are solved for together; given : those of them that the tile's values are of.
    lit : as of `solve_joint`.
    """

    pixels: Parts[Photo, PixelsOfPoints | _Told]
    grid: Grid
    solved: Sequence[Ints]
    given: Sequence[Ints]
    model: TexturedModel
    common_ks: Floats
    noise: NoiseModel
    lit: float

    @property
    def key(self) -> object:
        """What stands for it in keys: its fields, the pixels by what they are made of."""
        return self.pixels.key, [getattr(self, entry.name) for entry in fields(self)[1:]]

    def apart(self, tile: int) -> _TileValues:
        """Values of a tile's points as of `solve_apart`."""
        return self._values(
            tile,
            lambda views, grid: solve_apart(views, grid, self._tiny, self.noise, self.lit),
        )

    def joint(self, usual: Usual, tile: int) -> _TileValues:
        """Values of a tile's points as of `solve_joint`."""

        def solve(views: list[PixelsOfPoints], grid: Grid) -> tuple[PointValues, ...]:
            stack = stacked(views)
            # The covers would be there twice.
            views.clear()
            rng = np.random.default_rng(tile)
            return (solve_joint(*stack, grid, self._tiny, self.noise, usual, self.lit, rng),)

        return self._values(tile, solve)

    def _values(
        self, tile: int, solve: Callable[[list[PixelsOfPoints], Grid], tuple[PointValues, ...]]
    ) -> _TileValues:
        clock, points, given = Clock(), self.solved[tile], self.given[tile]
        with clock.on("invrender"), clock.on("texels"):
            grid, numbers = self.grid.of_points(points, given)
            views = []
            for view in self.pixels.read(tile):
                assert isinstance(view, PixelsOfPoints)
                # A photograph may show nothing of the tile.
                if len(view):
                    views.append(view if len(self.solved) == 1 else view.of_points(points))
            own = np.searchsorted(numbers, given)
            found = tuple(values.where(own) for values in solve(views, grid)) if views else ()
        return given, found, clock.seconds

    def _tiny(self, sums: TexelEquations) -> PointValues:
        return solved(self.model, sums, self.common_ks)


def second_pass(
    bench: TextureBench,
    fitted: Sequence[Photo],
    layout: Layout,
    fit: TexturedFit,
    footprint: float,
    pixels: int | None,
    clock: Clock,
    track: Track,
) -> tuple[FittedTextures, list[str]]:
    """Kd and Ks of every point, and sentences on photographs that say nothing of them.

    footprint : metres that a pixel spans on the object. pixels : of all photographs that are taken, 0 for all; by
    default `_MOST_PIXELS`.
    """
    with clock.on("invrender"):
        finer, parents = layout.finer()
        places = layout.points.positions
        most = max((_MOST_PIXELS if pixels is None else pixels or sys.maxsize) // len(fitted), 1)
        seen = sum(min(_pixels_about(bench.reader.body, photo), most) for photo in fitted)
        tiles = SurfaceTiles.cut(places, max(-(-seen // _OF_A_TILE), 1))
        grid, fine = Grid(parents, len(layout), finer.pairs()), finer.points.positions
        wide = max(footprint, 2 * grid.spacing(fine))
        reach = _TEXELS_AROUND * wide
        solved_at = [np.flatnonzero(tiles.holds(tile, fine, reach)) for tile in range(len(tiles))]
        given_at = [np.flatnonzero(tiles.holds(tile, places)) for tile in range(len(tiles))]
        del fine
    gathered = _PixelsGathered(bench, fit.brdf, finer, most, tiles, _PIXELS_AROUND * wide)
    parts = Parts.of(PIXELS_STAGE, gathered, fitted, len(tiles) + 1)
    making = parts.make(lambda photo: str(photo.file))
    for _ in track(fitted, "Gathering the texture"):
        next(making)
    told = [entry for entry in parts.read(len(tiles)) if isinstance(entry, _Told)]
    for entry in told:
        clock.add(entry.seconds)
    release_memory()
    lit = float(np.quantile(np.concatenate([entry.lit for entry in told]), 0.99))
    solver = _TileSolver(parts, grid, solved_at, given_at, fit.model, fit.common_ks, fit.noise, lit)

    def of_all(
        solve: Callable[[int], _TileValues], count: int, made_of: object, doing: str
    ) -> list[PointValues]:
        work = stage_results(TILES_STAGE, solve, range(len(tiles)), _tile_named, made_of)
        found: list[list[tuple[Ints, PointValues]]] = [[] for _ in range(count)]
        for _ in track(range(len(tiles)), doing):
            given, values, seconds = next(work)
            clock.add(seconds)
            for parts, own in zip(found, values, strict=False):
                parts.append((given, own))
        return [PointValues.together(len(layout), parts) for parts in found]

    usual = Usual.of(*of_all(solver.apart, 2, (solver.key, None), "Solving each texel"))
    (values,) = of_all(partial(solver.joint, usual), 1, (solver.key, usual), "Solving the texture")
    release_memory()
    dark = [
        f"{photo.file}: all that it shows of the object lies in the object's own shadow under the given light, which"
        " says nothing of the texture; leave it out, or check the light's direction and the photograph's pose"
        for photo, shaded in zip(fitted, in_shadow([entry.brightest for entry in told]), strict=True)
        if shaded
    ]
    return FittedTextures.of(layout, values, fit.model.ks_varies), dark


def _tile_named(tile: int) -> str:
    return f"part {tile + 1} of the texture"


def _pixels_about(body: Body, photo: Photo) -> int:
    """About how many pixels of a photograph show the object."""
    return int(body_coverage(body, photo.camera, _STRIDE).sum()) * _STRIDE**2
