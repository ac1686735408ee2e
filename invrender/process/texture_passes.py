"""Both passes through the photographs of a textured mesh: a subset of its points, then all that they show."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from capture.arrays import release_memory
from capture.lighting import Lighting
from capture.photoset import Photo, PhotoSet
from capture.progress import Track
from capture.tasks.stage import stage_results
from invrender.brdf.lobes import RH01_FORM
from invrender.brdf.microfacet import Microfacet
from invrender.estimate.textured.cover import cover
from invrender.estimate.textured.fit import TexturedFit
from invrender.estimate.textured.joint import Grid, PixelsOfPoints, in_shadow, solve_joint, stacked
from invrender.estimate.textured.layout import Layout, SurfacePoints
from invrender.estimate.textured.observe import observe, points_for, squares_seen
from invrender.estimate.textured.search import solved
from invrender.estimate.textured.seen import Seen, rows_of, transfers_of
from invrender.estimate.textured.texel_observations import TexelRows
from invrender.estimate.textured.textures import FittedTextures
from invrender.observation.clock import Clock
from invrender.observation.samples import PhotoReader
from invrender.transport.radiosity import Bounced
from invrender.transport.transfer import LightElement
from invrender.transport.visibility import Shadows
from recon.sampling.lightfield import LightField

Floats = NDArray[np.float64]
Singles = NDArray[np.float32]

# Pixels of all photographs that the texture is solved from, evenly taken of more: 200 bytes each.
_MOST_PIXELS = 6_000_000
# What the second pass keeps of photographs until the result is there: all those pixels.
PIXELS_STAGE = "texture-pixels"


@dataclass(frozen=True, eq=False)
class TextureBench:
    """What both passes need. bounced : per lighting, what parts of the mesh send each other, once that is known."""

    reader: PhotoReader
    lightings: Mapping[str, Lighting]
    elements: Mapping[str, Sequence[LightElement]]
    shadows: Shadows | None
    bounced: Mapping[str, Bounced]

    def direct(self, photo: Photo, pixels: LightField, brdf: Microfacet) -> tuple[Singles, Singles]:
        """Diffuse and specular transfers (n, 3) of a photograph's samples: radiance of Kd = 1, and of Ks = 1."""
        return transfers_of(self.elements[photo.lighting], pixels, brdf, self.shadows)

    def by_mesh(self, photo: Photo, pixels: LightField, brdf: Microfacet) -> tuple[Singles, Singles]:
        """The same by light that other parts of the mesh send."""
        if photo.lighting not in self.bounced:
            nothing = np.zeros((len(pixels), 3), np.float32)
            return nothing, nothing
        diffuse, specular = self.bounced[photo.lighting].reflected(pixels, brdf)
        means = [pixels.mean_over_rays(rays).astype(np.float32) for rays in (diffuse, specular)]
        return means[0], means[1]


@dataclass(frozen=True, eq=False)
class PointSubset:
    """What photographs show of some of the points, and of each some pixels to report residuals of, by its label."""

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
    return PointSubset(subset, shown, rows, fields)


@dataclass(frozen=True, eq=False)
class _PixelsGathered:
    """The usable pixels of a photograph, `most` of them, by the points that they cover, of one BRDF."""

    bench: TextureBench
    brdf: Microfacet
    layout: Layout
    most: int

    def __call__(self, photo: Photo) -> tuple[PixelsOfPoints, Mapping[str, float]]:
        """Of a photograph; and seconds by package."""
        clock, bench = Clock(), self.bench
        parts = []
        for field in bench.reader.pixels(photo, self.most, bench.lightings[photo.lighting].sources, clock):
            with clock.on("invrender"):
                parts.append(self._of(photo, field))
        return PixelsOfPoints.joined(parts), clock.seconds

    def _of(self, photo: Photo, field: LightField) -> PixelsOfPoints:
        bench = self.bench
        (d, s), (more_d, more_s) = (of(photo, field, self.brdf) for of in (bench.direct, bench.by_mesh))
        lit = d.max(axis=1)
        # What other parts send makes the albedo brighter, but not more certain.
        direct = lit / np.maximum((d + more_d).max(axis=1), np.float32(1e-30))
        trust = (np.maximum(field.weight, 0.01) * direct**2)[:, None].astype(np.float32)
        covered = cover(bench.reader.body, photo.camera, field, self.layout)
        radiance = field.radiance.astype(np.float32)
        return PixelsOfPoints(covered, d + more_d, s + more_s, lit, radiance, trust, trust)


def second_pass(
    bench: TextureBench,
    fitted: Sequence[Photo],
    layout: Layout,
    fit: TexturedFit,
    clock: Clock,
    track: Track,
) -> tuple[FittedTextures, list[str]]:
    """Kd and Ks of every point, and sentences on photographs that say nothing of them."""
    finer, parents = layout.finer()
    gathered = _PixelsGathered(bench, fit.brdf, finer, _MOST_PIXELS // len(fitted))
    work = stage_results(PIXELS_STAGE, gathered, fitted, lambda photo: str(photo.file))
    found = []
    for _ in track(fitted, "Gathering the texture"):
        pixels, seconds = next(work)
        found.append(pixels)
        clock.add(seconds)
    release_memory()
    views, covered = stacked(found)
    with clock.on("invrender"):
        grid = Grid(parents, len(layout), finer.pairs())
        # Room for the solve: let go of 0.2 GB of the finer texels' places, and of the covers that were copied.
        finer, found = layout, []
        release_memory()
        with clock.on("texels"):
            values = solve_joint(
                views,
                covered,
                grid,
                lambda sums: solved(fit.model, sums, fit.common_ks),
                fit.noise,
                np.random.default_rng(0),
            )
    dark = [
        f"{photo.file}: all that it shows of the object lies in the object's own shadow under the given light, which"
        " says nothing of the texture; leave it out, or check the light's direction and the photograph's pose"
        for photo, shaded in zip(fitted, in_shadow(views), strict=True)
        if shaded
    ]
    return FittedTextures.of(layout, values, fit.model.ks_varies), dark
