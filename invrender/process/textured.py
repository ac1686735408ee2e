"""The main job on a textured mesh, under known light [RH01, section 6.4].

Twice through the photographs, one per core at a time: first a subset of points determines the model, mu and sigma; then
every point's Kd, and Ks, is solved for. Predictions go through them once more.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial

import numpy as np
from numpy.typing import NDArray

from capture.arrays import release_memory
from capture.lighting import Lighting
from capture.photo import Photo
from capture.photoset import PhotoSet
from capture.progress import Track, counted
from capture.tasks.stage import kept_result
from invrender.brdf.form import LobeForm
from invrender.estimate.calibration import are_any
from invrender.estimate.interreflection.textured import CorrectedTextures, correct_textures
from invrender.estimate.known_scale import given_scale
from invrender.estimate.solution import Solution
from invrender.estimate.textured.calibration import moved_by_calibration
from invrender.estimate.textured.colors import color_shares
from invrender.estimate.textured.fit import FIT_STEPS, TexturedFit, fit_textured
from invrender.estimate.textured.layout import SurfacePoints, find_layout
from invrender.estimate.textured.seen import Seen, rows_in_forms
from invrender.estimate.textured.solution import textured_solution
from invrender.estimate.textured.texel_observations import TexelRows
from invrender.estimate.textured.textures import FittedTextures
from invrender.observation.clock import Clock
from invrender.observation.geometry import SceneGeometry
from invrender.process.held_out_light import used_lightings
from invrender.process.texture_passes import PointSubset, TextureBench, first_pass, second_pass
from invrender.process.textured_pictures import TexturedPictures
from invrender.process.warnings import find_warnings
from invrender.result.run import TexturedRun
from invrender.result.scores import photo_scores
from invrender.transport.radiosity import ConcaveMesh
from invrender.wording import sentences
from recon.mesh.bodies import MeshBody
from recon.reference import find_references
from recon.sampling.lightfield import LightField

Floats = NDArray[np.float64]
Singles = NDArray[np.float32]

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
    body = geometry.body
    assert isinstance(body, MeshBody)
    lightings = given_lightings(photoset, body, clock) if recovered is None else recovered.lightings
    # In recovered light references have fixed its scale already.
    scale = given_scale(find_references(photoset, body), lightings) if recovered is None else None
    bench = TextureBench.of(photoset, geometry, lightings)
    with clock.on("recon"):
        layout, faults = find_layout(body, footprint(photoset, body))
    subset = first_pass(bench, photoset, layout.points, samples, clock, track)
    fit, accounted = kept_result(
        "texture-fit",
        partial(_fit, bench, subset, clock, track, recovered is None),
        (bench, layout.points, samples, photoset.photos, recovered is None),
    )
    if accounted is not None:
        bench = replace(bench, bounced=accounted.bounced)
    with clock.on("invrender"):
        bench = bench.with_lookups(fit, subset.shown)
    fields, numbers = subset.fields, subset.numbers
    # What photographs show takes memory. In recovered light, which errors of calibration move, too, they don't count.
    shown = subset.shown if recovered is None and are_any(photoset.errors.geometric, lightings) else ()
    del subset
    release_memory()
    asked = footprint(photoset, body), photoset.object.texture_pixels
    textures, dark = second_pass(bench, photoset.fitted, layout, fit, *asked, clock, track)
    _check_any(photoset, textures)
    unsure, open_to = dict[str, Floats](), recovered or accounted
    if open_to is not None:
        shares = open_to.unsure_at(layout.points)
        textures = textures.less_sure(shares)
        if recovered is not None:
            textures = textures.only(np.asarray(shares[:, :3].max(axis=1) < _UNSURE))
            _check_any(photoset, textures)
        unsure["bounced_light" if recovered is None else "recovered_light"] = textures.mean(shares)
    if photoset.errors.color is not None:
        shares = color_shares(photoset.errors.color, textures, lightings.values())
        textures = textures.less_sure(shares)
        unsure["color"] = textures.mean(shares)
    moved: Mapping[str, Floats] = {}
    if shown:
        weights = (textures.known * layout.areas)[numbers]
        given = photoset.fitted, shown, body, photoset.errors, lightings, bench.shadows
        with clock.on("invrender"):
            moved = moved_by_calibration(fit, weights, *given)

    pictures = TexturedPictures(bench, body, fit.brdf, textures)
    fields, residuals = _residuals(photoset, fields, pictures.radiance)
    solution = textured_solution(photoset, lightings, fit, textures, fields, residuals, unsure, moved)
    if recovered is not None:
        solution = recovered.in_gauge(solution)
    warnings = (
        *find_warnings(photoset, solution, geometry, lightings),
        *_remarks([*faults, *dark], textures),
        *(() if scale is None else scale.remarks),
    )
    return TexturedRun(
        photoset,
        geometry,
        solution,
        fields,
        residuals,
        photo_scores(photoset, solution, fields, residuals),
        warnings,
        pictures.radiance,
        pictures.pictured,
        interreflection=None if accounted is None else accounted.found,
        textures=textures,
        references=() if scale is None else scale.scores,
        transfers=pictures.transfers,
        shaded=pictures.shaded,
    )


def _check_any(photoset: PhotoSet, textures: FittedTextures) -> None:
    if not textures.known.any():
        raise ValueError(
            f"{photoset.manifest}: no point of the object is seen by enough photographs to separate its Kd and Ks;"
            " take more, from sides that overlap, or leave texture out"
        )


def given_lightings(photoset: PhotoSet, body: MeshBody, clock: Clock) -> dict[str, Lighting]:
    """The lightings of a textured set, which must be known."""
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


def footprint(photoset: PhotoSet, body: MeshBody) -> float:
    """Metres on the object that a pixel of a photograph spans, the median over the fitted ones."""
    centre = body.mesh.vertices.mean(axis=0)
    spans = []
    for camera in (photo.camera for photo in photoset.fitted):
        depth = 1.0 if camera.is_orthographic else float(camera.depth(centre)[0])
        spans.append(depth / camera.focal_px)
    return float(np.median(spans))


def _fit(
    bench: TextureBench, subset: PointSubset, clock: Clock, track: Track, is_absolute: bool
) -> tuple[TexturedFit, CorrectedTextures | None]:
    """Model, mu and sigma from a subset of the points, and what bounced light changes in them.

    is_absolute : whether Kd is an albedo, which what bounces hangs on.
    """
    shadows = bench.shadows
    # What photographs show may change by what bounces; what they would show of a BRDF doesn't.
    made: dict[tuple[Sequence[LobeForm], bytes], dict[LobeForm, list[TexelRows]]] = {}

    def fitted(shown: Sequence[Seen], doing: str) -> TexturedFit:
        def in_forms(forms: Sequence[LobeForm], some: NDArray[np.bool_]) -> dict[LobeForm, list[TexelRows]]:
            fewer = [seen.of_points(some) for seen in shown]
            key = (tuple(forms), some.tobytes())
            if key not in made:
                made[key] = rows_in_forms(fewer, bench.elements, forms, shadows)
            return {
                form: [replace(own, radiance=seen.radiance) for own, seen in zip(photos, fewer, strict=True)]
                for form, photos in made[key].items()
            }

        given = [replace(own, radiance=seen.radiance) for own, seen in zip(subset.rows, shown, strict=True)]
        with counted(track, FIT_STEPS, doing) as on_step:
            return fit_textured(given, len(subset.points), in_forms, on_step)

    with clock.on("invrender"):
        fit = fitted(subset.shown, "Fitting and cross-validating")
        parts = None if shadows is None or not is_absolute else ConcaveMesh.of(shadows)
        if parts is None:
            return fit, None
        again = partial(fitted, doing="Judging light that bounces")
        direct = bench.with_lookups(fit, subset.shown).direct
        accounted = correct_textures(parts, subset.shown, subset.points, bench.elements, direct, fit, again)
    return (fit, None) if accounted is None else (accounted.fit, accounted)


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
