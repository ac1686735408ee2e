"""The main job on a textured mesh, under known light [RH01, section 6.4].

Twice through the photographs, one per core at a time: first a subset of points tells the model, mu and sigma; then
every point's Kd, and Ks, is solved for. Predictions go through them once more.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cache, partial

import numpy as np
from numpy.typing import NDArray

from capture.arrays import release_memory
from capture.decode import decode_photo
from capture.lighting import Lighting
from capture.parallel import parallel_map
from capture.photoset import Photo, PhotoSet
from capture.progress import Track
from invrender.clock import Clock
from invrender.findings import find_warnings
from invrender.model.columns import columns_of_forms
from invrender.model.lobes import PRINTED, LobeForm
from invrender.model.microfacet import Microfacet
from invrender.model.predict import predict, reflected
from invrender.model.transfer import LightElement, light_elements
from invrender.reading import check_usable
from invrender.render.reflected import ReflectedMap, prepared_map
from invrender.render.shading import shade
from invrender.solve.clusters import tile_of
from invrender.solve.forms import together
from invrender.solved import Solved, factorization
from invrender.specimen import Specimen
from invrender.texture.cover import cover
from invrender.texture.fit import FIT_STEPS, TexturedFit, fit_textured, solved
from invrender.texture.joint import Grid, View, in_shadow, solve_joint, stacked
from invrender.texture.layout import Layout, SurfacePoints, find_layout
from invrender.texture.observe import Observations, observe
from invrender.texture.solution import textured_solution
from invrender.texture.stack import Rows
from invrender.texture.textures import Textures
from invrender.wording import sentences
from recon.bodies import MeshBody
from recon.knownlight import read_lighting
from recon.lightfield import LightField, off_terminators
from recon.sampling import sample_body

Floats = NDArray[np.float64]

# Pixels whose transfers are computed together: harmonics of a high degree take 10 kilobytes a pixel.
_PIXELS_AT_A_TIME = 20_000
# Of all points of a surface one photograph sees about this share, several times less those at grazing angles.
_SEEN_SHARE = 0.25
# Pixels of all photographs that the texture is solved from, evenly taken of more: 200 bytes each.
_MOST_PIXELS = 6_000_000
# Share of the surface without a texture from which on a sentence says so.
_UNKNOWN = 0.02


@dataclass(frozen=True, eq=False)
class _Bench:
    """What both passes need."""

    photoset: PhotoSet
    specimen: Specimen
    body: MeshBody
    lightings: Mapping[str, Lighting]
    elements: Mapping[str, Sequence[LightElement]]
    clock: Clock

    def pixels(self, photo: Photo) -> LightField:
        """All usable pixels of a photograph."""
        with self.clock.on("capture"):
            image = decode_photo(self.photoset, photo)
        with self.clock.on("recon"), self.clock.on("visibility"):
            mask = self.specimen.found.mask_of(photo)
            directions = self.lightings[photo.lighting].directions
            drawn = sample_body(
                self.body, photo.camera, image, mask, directions, None, np.random.default_rng(0)
            )
            drawn = off_terminators(drawn, directions)
            check_usable(photo, image, drawn, mask)
        return drawn


def solve_textured(
    photoset: PhotoSet, specimen: Specimen, samples: int, clock: Clock, track: Track
) -> Solved:
    """Recover Kd and Ks over a mesh, and the mu and sigma that they share, under light that is known.

    samples : about how many observations of points enter the search for mu and sigma; also, about how many pixels of
    all photographs the residuals are reported of.
    """
    assert isinstance(specimen.body, MeshBody)
    used = {photo.lighting for photo in photoset.photos}
    with clock.on("recon"):
        lightings = {t.name: read_lighting(photoset, t) for t in photoset.lightings if t.name in used}
    _check_known(photoset, lightings)
    elements = {name: light_elements(lighting) for name, lighting in lightings.items()}
    bench = _Bench(photoset, specimen, specimen.body, lightings, elements, clock)
    with clock.on("recon"):
        layout, faults = find_layout(specimen.body, _footprint(photoset, specimen.body))
    fit, fields = _first_pass(bench, layout.points, samples, track)
    release_memory()
    textures, dark = _second_pass(bench, layout, fit, track)
    if not textures.known.any():
        raise ValueError(
            f"{photoset.manifest}: no point of the object is seen by enough photographs to tell its Kd from its Ks;"
            " take more, from sides that overlap, or leave texture out"
        )

    def radiance(photo: Photo, field: LightField) -> Floats:
        brdf = fit.brdf
        kd, ks = textures.at(field)
        own = replace(brdf, kd=kd, ks=ks)
        ones = np.ones((len(elements[photo.lighting]), 3))
        return predict(own, elements[photo.lighting], ones, field, specimen.shadows)

    def transfers(photo: Photo, field: LightField) -> tuple[Floats, Floats]:
        d, s = _transfers(bench, photo, field, fit.brdf)
        return d.astype(float), s.astype(float)

    @cache
    def prepared(lighting: str) -> ReflectedMap | None:
        return prepared_map(fit.brdf, elements[lighting][0])

    def shaded(photo: Photo, field: LightField, kd: Floats, ks: Floats) -> Floats:
        own = replace(fit.brdf, kd=kd, ks=ks)
        # All that is known of a lighting is one element. Its map integrated pixel by pixel takes twenty times as long.
        element, light = elements[photo.lighting][0], prepared(photo.lighting)
        return shade(own, element, field, specimen.shadows, reflected=light)[0]

    fields, residuals = _residuals(photoset, fields, radiance)
    solution = textured_solution(photoset, lightings, fit, textures, fields, residuals)
    warnings = [
        *find_warnings(photoset, solution, specimen, lightings),
        *_remarks([*faults, *dark], textures),
    ]
    result = factorization(photoset, specimen, solution, fields, residuals, warnings)
    return Solved(replace(result, textures=textures), fields, residuals, radiance, transfers, shaded)


def _check_known(photoset: PhotoSet, lightings: Mapping[str, Lighting]) -> None:
    for name, lighting in lightings.items():
        if lighting.recovers:
            raise ValueError(
                f'{photoset.manifest}: [[lighting]] "{name}" leaves {" and ".join(lighting.recovers)} to be recovered,'
                " but textures need light that is known: light and texture can't be told apart (RH01, section 6.4)."
                " Measure the light, or leave texture out"
            )


def _footprint(photoset: PhotoSet, body: MeshBody) -> float:
    """Metres on the object that a pixel of a photograph spans, the median over the fitted ones."""
    centre = body.mesh.vertices.mean(axis=0)
    spans = []
    for photo in photoset.photos:
        if not photo.held_out:
            camera = photo.camera
            depth = 1.0 if camera.is_orthographic else float(camera.depth(centre)[0])
            spans.append(depth / camera.focal_px)
    return float(np.median(spans))


def _first_pass(
    bench: _Bench, points: SurfacePoints, samples: int, track: Track
) -> tuple[TexturedFit, dict[str, LightField]]:
    """Model, mu and sigma from a subset of the points, and some pixels of each photograph to report residuals of."""
    photos = bench.photoset.photos
    fitted = [photo for photo in photos if not photo.held_out]
    rng = np.random.default_rng(0)
    count = min(len(points), int(samples / (_SEEN_SHARE * len(fitted))) + 1)
    chosen = np.sort(rng.choice(len(points), count, replace=False))
    subset = points.where(chosen)
    budget = max(samples // len(fitted), 100)

    def read(index: int) -> tuple[LightField, tuple[_Seen, Rows] | None]:
        photo = photos[index]
        field = bench.pixels(photo)
        with bench.clock.on("invrender"):
            rows = None
            if not photo.held_out:
                seen = _Seen.of(photo.lighting, observe(bench.body, photo.camera, field, subset), field)
                rows = seen, _rows(bench, seen, (PRINTED,))[PRINTED]
        keep = np.zeros(len(field), bool)
        keep[np.random.default_rng(index).permutation(len(field))[:budget]] = True
        return field.where(keep), rows

    work = parallel_map(read, range(len(photos)))
    fields: dict[str, LightField] = {}
    found = []
    for photo in track(photos, "Reading photographs"):
        field, rows = next(work)
        fields[photo.label] = field
        if rows is not None:
            found.append(rows)

    def in_forms(forms: Sequence[LobeForm], some: NDArray[np.bool_]) -> dict[LobeForm, list[Rows]]:
        shown = [seen.of_points(some) for seen, _ in found]
        result: dict[LobeForm, list[Rows]] = {form: [] for form in forms}
        for group in together(forms):
            for rows in parallel_map(partial(_rows, bench, forms=group), shown):
                for form, own in rows.items():
                    result[form].append(own)
        return result

    with bench.clock.on("invrender"):
        steps = iter(track(range(FIT_STEPS), "Fitting and cross-validating"))
        next(steps)
        fit = fit_textured([rows for _, rows in found], count, in_forms, lambda: next(steps, None))
        for _ in steps:
            pass
    return fit, fields


@dataclass(frozen=True, eq=False)
class _Seen:
    """What a photograph shows of points: the samples around them, and the light that it was under."""

    lighting: str
    points: Observations
    pixels: LightField

    @classmethod
    def of(cls, lighting: str, points: Observations, field: LightField) -> _Seen:
        """With those samples only that are used."""
        used = points.of_samples(len(field))
        return cls(lighting, points.renumbered(used), field.where(used))

    def of_points(self, some: NDArray[np.bool_]) -> _Seen:
        """Of the points that are marked."""
        return _Seen.of(self.lighting, self.points.where(some[self.points.points]), self.pixels)


def _rows(bench: _Bench, shown: _Seen, forms: Sequence[LobeForm]) -> dict[LobeForm, Rows]:
    """What a photograph says of points, as columns that hold neither mu nor sigma; forms as of `columns_of_forms`."""
    seen, pixels, name = shown.points, shown.pixels, shown.lighting
    entries = columns_of_forms([name], bench.elements, [pixels], forms, bench.specimen.shadows)
    result = {}
    for form, (entry,) in entries.items():
        columns = np.stack([seen.at_points(channel) for channel in entry.columns[:, :, 0]])
        result[form] = Rows(
            seen.points,
            columns.astype(np.float32),
            seen.at_points(pixels.radiance),
            _brightness(seen, pixels),
            _share(seen, pixels),
            np.unique(tile_of(pixels)[seen.samples[:, 0]], return_inverse=True)[1],
            seen.at_points(pixels.cos_exitant),
        )
    return result


def _brightness(seen: Observations, field: LightField) -> Floats:
    return np.maximum(field.radiance[seen.samples].mean(axis=1), 0)


def _share(seen: Observations, field: LightField) -> Floats:
    """Variance of interpolated numbers over a pixel's, more where its geometry is trusted less."""
    return seen.variance_share() / np.maximum(seen.at_points(field.weight), 0.01)


def _second_pass(bench: _Bench, layout: Layout, fit: TexturedFit, track: Track) -> tuple[Textures, list[str]]:
    """Kd and Ks of every point, and sentences on photographs that say nothing of them."""
    finer, parents = layout.finer()
    fitted = [photo for photo in bench.photoset.photos if not photo.held_out]
    brdf, most = fit.brdf, _MOST_PIXELS // len(fitted)

    def read(photo: Photo) -> View:
        field = bench.pixels(photo)
        with bench.clock.on("invrender"):
            if len(field) > most:
                field = field.where(np.random.default_rng(0).permutation(len(field)) < most)
            trust = np.maximum(field.weight, 0.01)[:, None].astype(np.float32)
            d, s = _transfers(bench, photo, field, brdf)
            covered = cover(bench.body, photo.camera, field, finer)
            return View(covered, d, s, field.radiance.astype(np.float32), trust, trust)

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
    return Textures.of(layout, values, fit.model.ks_varies), dark


def _transfers(
    bench: _Bench, photo: Photo, field: LightField, brdf: Microfacet
) -> tuple[NDArray[np.float32], NDArray[np.float32]]:
    """Diffuse and specular transfers (n, 3) of a photograph's samples: radiance of Kd = 1, and of Ks = 1."""
    elements = bench.elements[photo.lighting]
    strengths = np.ones((len(elements), 3))
    found = np.empty((2, len(field), 3), np.float32)
    for part in np.array_split(np.arange(len(field)), len(field) // _PIXELS_AT_A_TIME + 1):
        keep = np.zeros(len(field), bool)
        keep[part] = True
        some = field.where(keep)
        rays = reflected(brdf, elements, strengths, some, bench.specimen.shadows)
        found[:, part] = [some.mean_over_rays(one) for one in rays]
    return found[0], found[1]


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


def _remarks(faults: Sequence[str], textures: Textures) -> list[str]:
    """What a user should know of the texture before using it."""
    remarks = sentences(faults)
    unknown = 1 - textures.share_known
    if unknown > _UNKNOWN:
        remarks.append(
            f"{unknown:.0%} of the surface has no texture: too few photographs see it, or they can't tell its Kd from"
            " its Ks. It is marked in the textures (A = 0) and isn't predicted; photographs from other sides, or under"
            " light from elsewhere, would fill it."
        )
    return remarks
