"""The main job on a textured mesh, under known light [RH01, section 6.4].

Twice through the photographs, one per core at a time: first a subset of points determines the model, mu and sigma; then
every point's Kd, and Ks, is solved for. Predictions go through them once more.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cache, partial

import numpy as np
from numpy.typing import NDArray

from capture.arrays import release_memory
from capture.lighting import Lighting
from capture.parallel import parallel_map
from capture.photoset import Photo, PhotoSet
from capture.progress import Track, counted
from invrender.brdf.form import LobeForm
from invrender.brdf.lobes import RH01_FORM
from invrender.brdf.microfacet import Microfacet
from invrender.estimate.forms import together
from invrender.estimate.interreflection.textured import CorrectedTextures, correct_textures
from invrender.estimate.solution import Solution
from invrender.estimate.textured.cover import cover
from invrender.estimate.textured.fit import FIT_STEPS, TexturedFit, fit_textured
from invrender.estimate.textured.joint import Grid, PixelsOfPoints, in_shadow, solve_joint, stacked
from invrender.estimate.textured.layout import Layout, SurfacePoints, find_layout
from invrender.estimate.textured.observe import observe, points_for
from invrender.estimate.textured.search import solved
from invrender.estimate.textured.seen import Seen, rows_of, transfers_of
from invrender.estimate.textured.solution import textured_solution
from invrender.estimate.textured.texel_observations import TexelRows
from invrender.estimate.textured.textures import FittedTextures
from invrender.observation.clock import Clock
from invrender.observation.geometry import SceneGeometry
from invrender.observation.samples import usable_pixels
from invrender.process.held_out_light import used_lightings
from invrender.process.warnings import find_warnings
from invrender.result.run import TexturedRun
from invrender.result.scores import photo_scores
from invrender.transport.predict import predict
from invrender.transport.radiosity import Bounced, ConcaveMesh
from invrender.transport.reflected import ReflectedMap, prepared_map
from invrender.transport.shading import shade
from invrender.transport.transfer import LightElement, light_elements
from invrender.wording import sentences
from recon.mesh.bodies import MeshBody
from recon.sampling.lightfield import LightField

Floats = NDArray[np.float64]
Singles = NDArray[np.float32]

# Pixels of all photographs that the texture is solved from, evenly taken of more: 200 bytes each.
_MOST_PIXELS = 6_000_000
# Kd that recovered light leaves uncertain by this share of itself isn't known.
_UNSURE = 0.5
# Share of the surface without a texture from which on a sentence says so.
_UNKNOWN = 0.02


@dataclass(frozen=True, eq=False)
class Recovered:
    """Light that was found from the same photographs, up to a scale: no albedo then fixes what bounces.

    lightings : by name. unsure_at : shares (n, 6) of themselves by which it leaves Kd and Ks of points uncertain.
    in_gauge : a solution in that scale, with what the light leaves uncertain of what all points share.
    """

    lightings: Mapping[str, Lighting]
    unsure_at: Callable[[SurfacePoints], Floats]
    in_gauge: Callable[[Solution], Solution]


@dataclass(frozen=True, eq=False)
class _Bench:
    """What both passes need. bounced : per lighting, what parts of the mesh send each other, once that is known."""

    photoset: PhotoSet
    geometry: SceneGeometry
    body: MeshBody
    lightings: Mapping[str, Lighting]
    elements: Mapping[str, Sequence[LightElement]]
    clock: Clock
    bounced: Mapping[str, Bounced]

    def pixels(self, photo: Photo) -> LightField:
        """All usable pixels of a photograph."""
        sources = self.lightings[photo.lighting].sources
        return usable_pixels(self.photoset, self.geometry.found, photo, sources, self.clock)

    def direct(self, photo: Photo, pixels: LightField, brdf: Microfacet) -> tuple[Singles, Singles]:
        """Diffuse and specular transfers (n, 3) of a photograph's samples: radiance of Kd = 1, and of Ks = 1."""
        return transfers_of(self.elements[photo.lighting], pixels, brdf, self.geometry.shadows)

    def by_mesh(self, photo: Photo, pixels: LightField, brdf: Microfacet) -> tuple[Singles, Singles]:
        """The same by light that other parts of the mesh send."""
        if photo.lighting not in self.bounced:
            nothing = np.zeros((len(pixels), 3), np.float32)
            return nothing, nothing
        diffuse, specular = self.bounced[photo.lighting].reflected(pixels, brdf)
        means = [pixels.mean_over_rays(rays).astype(np.float32) for rays in (diffuse, specular)]
        return means[0], means[1]


def solve_textured(
    photoset: PhotoSet,
    geometry: SceneGeometry,
    samples: int,
    clock: Clock,
    track: Track,
    recovered: Recovered | None = None,
) -> TexturedRun:
    """Recover Kd and Ks over a mesh, and the mu and sigma that they share, under light that is known.

    samples : about how many observations of points enter the search for mu and sigma; also, about how many pixels of
    all photographs the residuals are reported of. recovered : the light, where the set doesn't give it.
    """
    assert isinstance(geometry.body, MeshBody)
    lightings = _given(photoset, geometry.body, clock) if recovered is None else recovered.lightings
    elements = {name: light_elements(lighting) for name, lighting in lightings.items()}
    bench = _Bench(photoset, geometry, geometry.body, lightings, elements, clock, {})
    with clock.on("recon"):
        layout, faults = find_layout(geometry.body, _footprint(photoset, geometry.body))
    subset = _first_pass(bench, layout.points, samples, track)
    fit, accounted = _fit(bench, subset, track, is_absolute=recovered is None)
    if accounted is not None:
        bench = replace(bench, bounced=accounted.bounced)
    fields = subset.fields
    del subset
    release_memory()
    textures, dark = _second_pass(bench, layout, fit, track)
    _check_any(photoset, textures)
    unsure, open_to = np.zeros(6), recovered or accounted
    if open_to is not None:
        shares = open_to.unsure_at(layout.points)
        textures = textures.less_sure(shares)
        if recovered is not None:
            textures = textures.only(np.asarray(shares[:, :3].max(axis=1) < _UNSURE))
            _check_any(photoset, textures)
        unsure = np.concatenate([textures.mean(of) for of in np.split(shares, 2, axis=1)])

    def radiance(photo: Photo, field: LightField) -> Floats:
        brdf = fit.brdf
        kd, ks = textures.at(field)
        own = replace(brdf, kd=kd, ks=ks)
        ones = np.ones((len(elements[photo.lighting]), 3))
        shown = predict(own, elements[photo.lighting], ones, field, geometry.shadows)
        bounced = bench.bounced.get(photo.lighting)
        return shown if bounced is None else shown + bounced.radiance(field, own)

    def transfers(photo: Photo, field: LightField) -> tuple[Floats, Floats]:
        (d, s), (more_d, more_s) = (of(photo, field, fit.brdf) for of in (bench.direct, bench.by_mesh))
        return (d + more_d).astype(float), (s + more_s).astype(float)

    @cache
    def prepared(lighting: str) -> ReflectedMap | None:
        return prepared_map(fit.brdf, elements[lighting][0])

    def shaded(photo: Photo, field: LightField, kd: Floats, ks: Floats) -> Floats:
        own = replace(fit.brdf, kd=kd, ks=ks)
        # All that is known of a lighting is one element. Its map integrated pixel by pixel takes twenty times as long.
        element, light = elements[photo.lighting][0], prepared(photo.lighting)
        bounced = bench.bounced.get(photo.lighting)
        return shade(own, element, field, geometry.shadows, light, bounced)

    def pictured(photo: Photo, field: LightField, binning: int) -> Floats:
        # Albedo is the mean around each ray, across which light varies little. It may be as fine as the photograph's
        # own pixels: a ray to each across, and one more.
        return shaded(photo, field, *textures.around(bench.body, photo.camera, field, binning + 1))

    fields, residuals = _residuals(photoset, fields, radiance)
    solution = textured_solution(photoset, lightings, fit, textures, fields, residuals, unsure)
    if recovered is not None:
        solution = recovered.in_gauge(solution)
    warnings = (
        *find_warnings(photoset, solution, geometry, lightings),
        *_remarks([*faults, *dark], textures),
    )
    return TexturedRun(
        photoset,
        geometry,
        solution,
        fields,
        residuals,
        photo_scores(photoset, solution, fields, residuals),
        warnings,
        radiance,
        pictured,
        interreflection=None if accounted is None else accounted.found,
        textures=textures,
        transfers=transfers,
        shaded=shaded,
    )


def _check_any(photoset: PhotoSet, textures: FittedTextures) -> None:
    if not textures.known.any():
        raise ValueError(
            f"{photoset.manifest}: no point of the object is seen by enough photographs to separate its Kd and Ks;"
            " take more, from sides that overlap, or leave texture out"
        )


def _given(photoset: PhotoSet, body: MeshBody, clock: Clock) -> dict[str, Lighting]:
    with clock.on("recon"):
        lightings = used_lightings(photoset, body)
    _check_known(photoset, lightings)
    return lightings


def _check_known(photoset: PhotoSet, lightings: Mapping[str, Lighting]) -> None:
    for name, lighting in lightings.items():
        if lighting.recovers:
            raise ValueError(
                f'{photoset.manifest}: [[lighting]] "{name}" leaves {" and ".join(lighting.recovers)} to be recovered,'
                " but textures need light that is known: light and texture can't be separated (RH01, section 6.4)."
                " Measure the light, or leave texture out"
            )


def _footprint(photoset: PhotoSet, body: MeshBody) -> float:
    """Metres on the object that a pixel of a photograph spans, the median over the fitted ones."""
    centre = body.mesh.vertices.mean(axis=0)
    spans = []
    for camera in (photo.camera for photo in photoset.fitted):
        depth = 1.0 if camera.is_orthographic else float(camera.depth(centre)[0])
        spans.append(depth / camera.focal_px)
    return float(np.median(spans))


@dataclass(frozen=True, eq=False)
class _Subset:
    """What photographs show of some of the points, and of each some pixels to report residuals of, by its label."""

    points: SurfacePoints
    shown: Sequence[Seen]
    rows: Sequence[TexelRows]
    fields: Mapping[str, LightField]


def _first_pass(bench: _Bench, points: SurfacePoints, samples: int, track: Track) -> _Subset:
    """A subset of the points, about as many as are seen in so many samples."""
    photos, fitted = bench.photoset.photos, bench.photoset.fitted
    rng = np.random.default_rng(0)
    count = min(len(points), points_for(samples, len(fitted)))
    chosen = np.sort(rng.choice(len(points), count, replace=False))
    subset = points.where(chosen)
    budget = max(samples // len(fitted), 100)

    def read(index: int) -> tuple[LightField, tuple[Seen, TexelRows] | None]:
        photo = photos[index]
        field = bench.pixels(photo)
        with bench.clock.on("invrender"):
            found = None
            if not photo.held_out:
                seen = Seen.of(photo.lighting, observe(bench.body, photo.camera, field, subset), field)
                found = seen, rows_of(seen, bench.elements, (RH01_FORM,), bench.geometry.shadows)[RH01_FORM]
        keep = np.zeros(len(field), bool)
        keep[np.random.default_rng(index).permutation(len(field))[:budget]] = True
        return field.where(keep), found

    work = parallel_map(read, range(len(photos)))
    fields: dict[str, LightField] = {}
    shown, rows = [], []
    for photo in track(photos, "Reading photographs"):
        fields[photo.label], found = next(work)
        if found is not None:
            shown.append(found[0])
            rows.append(found[1])
    return _Subset(subset, shown, rows, fields)


def _fit(
    bench: _Bench, subset: _Subset, track: Track, is_absolute: bool
) -> tuple[TexturedFit, CorrectedTextures | None]:
    """Model, mu and sigma from a subset of the points, and what bounced light changes in them.

    is_absolute : whether Kd is an albedo, which what bounces hangs on.
    """
    shadows = bench.geometry.shadows
    # What photographs show may change by what bounces; what they would show of a BRDF doesn't.
    made: dict[tuple[Sequence[LobeForm], bytes], list[dict[LobeForm, TexelRows]]] = {}

    def fitted(shown: Sequence[Seen], doing: str) -> TexturedFit:
        def in_forms(forms: Sequence[LobeForm], some: NDArray[np.bool_]) -> dict[LobeForm, list[TexelRows]]:
            fewer = [seen.of_points(some) for seen in shown]
            result: dict[LobeForm, list[TexelRows]] = {form: [] for form in forms}
            for group in together(forms):
                key = (group, some.tobytes())
                if key not in made:
                    make = partial(rows_of, elements=bench.elements, forms=group, shadows=shadows)
                    made[key] = list(parallel_map(make, fewer))
                for seen, rows in zip(fewer, made[key], strict=True):
                    for form, own in rows.items():
                        result[form].append(replace(own, radiance=seen.radiance))
            return result

        given = [replace(own, radiance=seen.radiance) for own, seen in zip(subset.rows, shown, strict=True)]
        with counted(track, FIT_STEPS, doing) as on_step:
            return fit_textured(given, len(subset.points), in_forms, on_step)

    with bench.clock.on("invrender"):
        fit = fitted(subset.shown, "Fitting and cross-validating")
        parts = None if shadows is None or not is_absolute else ConcaveMesh.of(shadows)
        if parts is None:
            return fit, None
        again = partial(fitted, doing="Judging light that bounces")
        accounted = correct_textures(parts, subset.shown, subset.points, bench.elements, fit, again)
    return (fit, None) if accounted is None else (accounted.fit, accounted)


def _second_pass(
    bench: _Bench, layout: Layout, fit: TexturedFit, track: Track
) -> tuple[FittedTextures, list[str]]:
    """Kd and Ks of every point, and sentences on photographs that say nothing of them."""
    finer, parents = layout.finer()
    fitted = bench.photoset.fitted
    brdf, most = fit.brdf, _MOST_PIXELS // len(fitted)

    def read(photo: Photo) -> PixelsOfPoints:
        field = bench.pixels(photo)
        with bench.clock.on("invrender"):
            if len(field) > most:
                field = field.where(np.random.default_rng(0).permutation(len(field)) < most)
            (d, s), (more_d, more_s) = (of(photo, field, brdf) for of in (bench.direct, bench.by_mesh))
            lit = d.max(axis=1)
            # What other parts send makes the albedo brighter, but not more certain.
            direct = lit / np.maximum((d + more_d).max(axis=1), np.float32(1e-30))
            trust = (np.maximum(field.weight, 0.01) * direct**2)[:, None].astype(np.float32)
            covered = cover(bench.body, photo.camera, field, finer)
            radiance = field.radiance.astype(np.float32)
            return PixelsOfPoints(covered, d + more_d, s + more_s, lit, radiance, trust, trust)

    work = parallel_map(read, fitted)
    found = [next(work) for _ in track(fitted, "Gathering the texture")]
    release_memory()
    views, covered = stacked(found)
    with bench.clock.on("invrender"):
        grid = Grid(parents, len(layout), finer.pairs())
        # Room for the solve: let go of 0.2 GB of the finer texels' places, and of the covers that were copied.
        finer, found = layout, []
        release_memory()
        with bench.clock.on("texels"):
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


def _residuals(
    photoset: PhotoSet, fields: Mapping[str, LightField], radiance: Callable[[Photo, LightField], Floats]
) -> tuple[dict[str, LightField], dict[str, Floats]]:
    """The samples of each photograph that lie where the texture is known, and what of them is left unexplained."""
    kept, residuals = {}, {}
    for photo in photoset.photos:
        field = fields[photo.label]
        predicted = radiance(photo, field)
        known = np.asarray(np.isfinite(predicted).all(axis=1))
        if not known.any():
            raise ValueError(
                f"{photo.file}: shows no part of the object whose texture the other photographs determine; leave it"
                " out, or add photographs that overlap with it"
            )
        kept[photo.label] = field.where(known)
        residuals[photo.label] = field.radiance[known] - predicted[known]
    return kept, residuals


def _remarks(faults: Sequence[str], textures: FittedTextures) -> list[str]:
    """What a user should know of the texture before using it."""
    remarks = sentences(faults)
    unknown = 1 - textures.share_known
    if unknown > _UNKNOWN:
        remarks.append(
            f"{unknown:.0%} of the surface has no texture: too few photographs see it, or they can't separate its"
            " Kd and Ks. It is marked in the textures (A = 0) and isn't predicted; photographs from other sides, or"
            " under light from elsewhere, would fill it."
        )
    return remarks
