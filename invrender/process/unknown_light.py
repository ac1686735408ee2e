"""The main job where nothing is known of the lighting: light and BRDF from the same photographs."""

from __future__ import annotations

from collections.abc import Callable, Collection, Mapping, Sequence
from dataclasses import replace
from functools import partial

import numpy as np
from numpy.typing import NDArray

from capture.parallel import parallel_map
from capture.photo import Photo
from capture.photoset import PhotoSet
from capture.progress import Track, counted
from capture.source_region import source_regions
from invrender.diagnostics.diagnosis import diagnose
from invrender.diagnostics.named import named_causes
from invrender.diagnostics.unknown_light import unknown_light_remainders
from invrender.estimate.clusters import structured_share
from invrender.estimate.evidence import Candidate
from invrender.estimate.interreflection.correction import Sent
from invrender.estimate.interreflection.unknown_light import correct_unknown_light
from invrender.estimate.lamp_distances import distances_in_words
from invrender.estimate.models import Estimate, Model
from invrender.estimate.quantities import FittedLighting, Quantity, ReferenceScore
from invrender.estimate.solution import Solution, unless_misfit
from invrender.estimate.unknown_light import (
    ORDERS,
    BlindSolution,
    blind_steps,
    factorize_blind,
    predict_blind,
)
from invrender.estimate.unknown_light.absolute_scale import absolute_blind, check_under
from invrender.estimate.unknown_light.calibration import with_calibration
from invrender.estimate.unknown_light.ladder import without_rows
from invrender.observation.clock import Clock
from invrender.observation.geometry import SceneGeometry
from invrender.observation.samples import read_samples
from invrender.observation.sphere_place import found_of_sphere
from invrender.process.held_out_light import (
    HeldOutLight,
    held_out_lights,
    lit_by_itself,
    scored_lighting,
    used_tables,
)
from invrender.process.recovered import brdf_numbers, in_absolute_scale, recovered_lighting
from invrender.process.warnings import find_warnings
from invrender.result.run import Run, pixel_by_pixel
from invrender.result.scores import photo_scores
from invrender.transport.predict import predict
from invrender.transport.radiosity import ConcaveMesh
from invrender.transport.visibility import Shadows
from invrender.wording import sentences
from recon.reference import find_references
from recon.sampling.lightfield import LightField

Floats = NDArray[np.float64]

# Of the light in a dark room: the same from all sides.
_DARK = (0,)
_NO_SCALE = Quantity(
    None,
    None,
    "undetermined",
    "without highlights, photographs in unknown light show only the product of Kd and light",
    "measure the light, with a mirror ball say, or photograph a [[reference]] of known reflectance beside the object",
)


def solve_unknown_light(
    photoset: PhotoSet,
    geometry: SceneGeometry,
    samples: int,
    clock: Clock,
    track: Track,
    factorize: Callable[..., BlindSolution] | None = None,
) -> Run:
    """Recover the BRDF of an object, up to a scale per channel, and all of the lightings on it.

    factorize : `factorize_blind` with some of its options chosen; if None, as the set has it.
    """
    with clock.on("recon"):
        others = held_out_lights(photoset, geometry.body)
        references = find_references(photoset, geometry.body)
    check_under(references, dict.fromkeys(photo.lighting for photo in photoset.fitted))
    orders = orders_of(photoset, others)
    if factorize is None:
        regions = source_regions(photoset.lightings)
        factorize = partial(factorize_blind, orders=orders, source_regions=regions)
    sources = {name: other.lighting.sources for name, other in others.items()}
    # The lamps of a room leave narrow highlights, too, and these hold most of what is seen of the lobe.
    fields, left_out = read_samples(photoset, geometry.found, sources, samples, clock, track, highlights=True)
    fitted = photoset.fitted
    with clock.on("invrender"):
        names, seen = [photo.lighting for photo in fitted], [fields[photo.label] for photo in fitted]

        def solve(photos: Sequence[LightField], near: BlindSolution | None, doing: str) -> BlindSolution:
            with counted(track, blind_steps(orders), doing) as on_step:
                found = factorize(photos, names, on_step=on_step, shadows=geometry.shadows, near=near)
            # Rows take up far more than all else, and nobody asks for them again.
            return replace(found, candidates=tuple(map(without_rows, found.candidates)))

        blind = solve(seen, None, "Fitting light and BRDF")
        parts = None if geometry.shadows is None else ConcaveMesh.of(geometry.shadows)
        bounces = None
        if parts is not None:
            without = partial(solve, doing="Fitting without light that bounces")
            bounces = correct_unknown_light(parts, seen, names, blind, without)
            blind = blind if bounces is None else bounces.solution
        blind = with_calibration(
            blind,
            seen,
            [photo.label for photo in fitted],
            [photo.camera for photo in fitted],
            names,
            geometry.body,
            found_of_sphere(photoset),
            photoset.errors,
            geometry.shadows,
        )
        sent = None if bounces is None else bounces.taken
        if sent is not None:
            sent = replace(sent, brdf=blind.candidates[blind.chosen].fit.state.brdf)

        def recovered(photo: Photo, field: LightField) -> Floats:
            shown = predict_blind(blind, field, blind.lights[photo.lighting], geometry.shadows)
            return shown if sent is None else shown + sent.radiance(photo.lighting, field)

        shown = parallel_map(lambda of: recovered(*of), zip(fitted, seen, strict=True))
        left = [field.radiance - own for field, own in zip(seen, shown, strict=True)]
        solution = _solution(blind, seen, left)
        brdf = solution.brdf
        under = {
            photo.label: _under(others[photo.lighting], solution, fields[photo.label], geometry.shadows, sent)
            for photo in photoset.photos
            if photo.lighting in others
        }
        strengths = {label: own for label, (own, _) in under.items()}

        def radiance(photo: Photo, field: LightField) -> Floats:
            if photo.lighting not in others:
                return recovered(photo, field)
            own, bounced = under[photo.label]
            shown = predict(brdf, others[photo.lighting].elements, own, field, geometry.shadows)
            return shown if bounced is None else shown + bounced.radiance(photo.lighting, field)

        residuals = dict(zip([photo.label for photo in fitted], left, strict=True))
        for photo in photoset.held_out:
            field = fields[photo.label]
            residuals[photo.label] = field.radiance - radiance(photo, field)
        given = [(photo.label, photo.lighting, fields[photo.label]) for photo in fitted]
        scene = unknown_light_remainders(blind, solution.brdf, geometry, given, left)
        causes = named_causes(diagnose(scene), photoset.radiometry.exposure)
    solution = replace(
        solution, lightings=(*solution.lightings, *_scored(others, strengths, photoset.photos))
    )
    warnings = [*left_out, *sentences(blind.warnings)]
    distances = distances_in_words({own.lighting.name: own.lighting for own in solution.lightings})
    if distances:
        warnings.append(
            f"The lamps are near. Their distances from the object's centre were found with all else: {distances}."
            " Measure one: if it is elsewhere, something else falls off across the object, such as its paint."
        )
    warnings += find_warnings(photoset, solution, geometry, {}, causes)
    scores = photo_scores(photoset, solution, fields, residuals)
    seen_references: tuple[ReferenceScore, ...] = ()
    if references:
        absolute = absolute_blind(blind, references, solution.structured)
        solution = in_absolute_scale(solution, blind, absolute)
        warnings += absolute.scale.remarks
        seen_references = absolute.scale.scores(absolute.scale.factor)
    return Run(
        photoset,
        geometry,
        solution,
        fields,
        residuals,
        scores,
        tuple(warnings),
        radiance,
        pixel_by_pixel(radiance),
        interreflection=None if bounces is None else bounces.found,
        causes=causes,
        references=seen_references,
    )


def _scored(
    others: Mapping[str, HeldOutLight], strengths: Mapping[str, Floats], photos: Sequence[Photo]
) -> list[FittedLighting]:
    """Known lightings that held-out photographs are under; of several under one the first gives its strength."""
    firsts = {
        photo.lighting: strengths[photo.label] for photo in reversed(photos) if photo.label in strengths
    }
    return [scored_lighting(other.lighting, other.elements, firsts[name]) for name, other in others.items()]


def _under(
    other: HeldOutLight, solution: Solution, field: LightField, shadows: Shadows | None, sent: Sent | None
) -> tuple[Floats, Sent | None]:
    """Strengths of a known light that suit a photograph under it best, and what bounces there at a known albedo."""

    def strengths(field: LightField) -> Floats:
        return other.strengths(solution, field, shadows)

    if sent is None:
        return strengths(field), None
    return lit_by_itself(sent, other.lighting.name, other.elements, field, strengths)


def _check_held_out(photoset: PhotoSet, others: Collection[str]) -> None:
    seen = {photo.lighting for photo in photoset.fitted}
    for photo in photoset.photos:
        if photo.lighting not in seen and photo.lighting not in others:
            raise ValueError(
                f"{photoset.manifest}: {photo.label} is held out, and no fitted photograph is under its lighting"
                f" {photo.lighting!r}, which is unknown: nothing can predict it; fit one photograph under that light,"
                " or leave it out"
            )


def orders_of(photoset: PhotoSet, others: Collection[str]) -> tuple[int, ...]:
    """Degrees of unknown light to try: all, or of a dark room.

    others : names of lightings that are known, to score held-out photographs by. ValueError for photographs that
    nothing can predict, and where dark is said of some of the unknown lightings only.
    """
    _check_held_out(photoset, others)
    return _DARK if _is_dark(photoset, others) else ORDERS


def _is_dark(photoset: PhotoSet, others: Collection[str]) -> bool:
    """Whether there are only lamps in the dark; ValueError where that is said of some unknown lightings only."""
    tables = [table for table in used_tables(photoset) if table.name not in others]
    lit = [table.name for table in tables if not table.dark]
    if lit and len(lit) < len(tables):
        raise ValueError(
            f"{photoset.manifest}: dark = true is said of some unknown lightings, but not of {lit[0]!r}; one degree of"
            " light is sought for all of them: say it of all or of none"
        )
    return bool(tables) and not lit


def _solution(blind: BlindSolution, fields: Sequence[LightField], residuals: Sequence[Floats]) -> Solution:
    """The solution in the terms of those under known light; Kd + Ks is 1 in each channel."""
    candidates = tuple(
        Candidate(
            Estimate(
                Model(
                    candidate.name,
                    specular=candidate.fit.state.sigma is not None,
                    fresnel=candidate.fit.state.mu is not None,
                    form=candidate.fit.state.form,
                ),
                candidate.fit.state.brdf,
                {},
                candidate.fit.cost,
            ),
            candidate.photo_errors,
            np.zeros(1),
            candidate.parameters,
        )
        for candidate in blind.candidates
    )
    names, of_brdf = brdf_numbers(blind.covariance_names)
    trusted = [np.sqrt(own.trust) * residual for own, residual in zip(blind.weights, residuals, strict=True)]
    return Solution(
        estimate=candidates[blind.chosen].estimate,
        candidates=candidates,
        chosen=blind.chosen,
        noise=blind.noise,
        weights=blind.weights,
        structured=structured_share(fields, trusted),
        quantities=unless_misfit(_quantities(blind), candidates[blind.chosen].error),
        lightings=tuple(recovered_lighting(name, light) for name, light in blind.lights.items()),
        covariance=of_brdf @ blind.covariance @ of_brdf.T,
        covariance_names=names,
        gauge=blind.gauge,
    )


def _quantities(blind: BlindSolution) -> dict[str, Quantity]:
    if blind.sigma is None:
        return {"kd": _NO_SCALE}
    quantities = blind.quantities
    # In this gauge the shares are Kd and Ks themselves.
    return {"kd": quantities["kd_normalised"], "ks": quantities["ks_normalised"], **quantities}
