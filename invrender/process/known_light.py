"""The main job where lighting is known, or all of it but strengths."""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial

import numpy as np
from numpy.typing import NDArray

from capture.lighting import Lighting, cosines, seen_from
from capture.photoset import Photo, PhotoSet
from capture.progress import Track, counted
from invrender.diagnostics.diagnosis import diagnose, lamp_distance
from invrender.diagnostics.known_light import known_light_remainders
from invrender.diagnostics.named import NamedCause, named_causes
from invrender.estimate.calibration import calibration_scores, weighed_photos
from invrender.estimate.evidence import fit_strengths, outlying
from invrender.estimate.explanation import EXPLANATION_STEPS, Explanation, explain
from invrender.estimate.interreflection.correction import Sent
from invrender.estimate.interreflection.known_light import correct_known_light, unknown_scale
from invrender.estimate.lamp_directions import (
    FEWER,
    FoundDirections,
    direction_sentence,
    find_directions,
    improve_directions,
)
from invrender.estimate.lamp_distances import (
    at_one_distance,
    distance_doubts,
    distance_sentence,
    with_found_distances,
)
from invrender.estimate.solution import Solution, solution_of
from invrender.observation.clock import Clock
from invrender.observation.geometry import SceneGeometry
from invrender.observation.lighting_axes import other_frame
from invrender.observation.samples import read_samples
from invrender.observation.sphere_place import found_of_sphere, place_changes
from invrender.process.held_out_light import lit_by_itself, scored_lighting, used_lightings
from invrender.process.leverage import importances
from invrender.process.run import Run, factorization
from invrender.process.warnings import POOR, find_warnings
from invrender.transport.cached_shader import CachedShader
from invrender.transport.columns import PhotoColumns, all_columns, photo_columns
from invrender.transport.predict import predict, predict_columns
from invrender.transport.radiosity import ConcaveMesh
from invrender.transport.transfer import LightElement, light_elements
from invrender.transport.visibility import Shadows
from recon.lighting import stands_clear
from recon.mesh.bodies import Body, SphereBody
from recon.sampling.lightfield import LightField

Floats = NDArray[np.float64]

# Of what photographs differ from the model, the share (RMS) by which pictures of it may be off: they differ 3% more.
PICTURES_OFF = 0.25
# Of the error on unseen photographs, what sources at a found distance may leave at most to be believed.
_FEWER = 0.98
# Deviation of a sphere's place, of its radius, below which normals are known well enough: a twentieth of a degree.
_PLACED_WELL = 8e-4


def solve_known_light(
    photoset: PhotoSet,
    geometry: SceneGeometry,
    samples: int,
    clock: Clock,
    track: Track,
    find_causes: bool = True,
) -> Run:
    """Recover the BRDF of an object, and what of its lighting is free.

    find_causes : whether to look for the causes of what the model doesn't explain. Where that is sources nearer than
    given, their distances are found, and the photographs explained once more; so are directions where highlights lie
    elsewhere than given ones put them.
    """
    with clock.on("recon"):
        lightings = used_lightings(photoset, geometry.body)

    def solve(
        under: Mapping[str, Lighting],
        said: Sequence[str] = (),
        causes: bool = True,
        turns: Floats | None = None,
    ) -> _Solved:
        return _solve(photoset, geometry, under, samples, clock, track, find_causes and causes, said, turns)

    def resolve(found: FoundDirections) -> _Solved:
        said = direction_sentence(lightings, found, given.error)
        return solve(found.lightings, [said], turns=found.covariance)

    given = solve(lightings)
    centre, shadows = geometry.body.centre, geometry.shadows
    if given.distance is None:
        turned = find_directions(lightings, given.solution) if given.misplaced else None
        if turned is None:
            return given.run
        found = resolve(turned)
        if found.error >= FEWER * given.error:
            return given.run
        better = improve_directions(lightings, turned, found.solution)
        return (found if better is None else resolve(better)).run
    near = at_one_distance(lightings, centre, given.distance)
    places = [place[0] for lighting in near.values() for place in lighting.places if place is not None]
    if not all(stands_clear(geometry.body, place) for place in places):
        return given.run
    near = with_found_distances(near, solve(near, causes=False).solution, shadows)
    found = solve(near, [distance_sentence(near, given.error)])
    return found.run if found.error < _FEWER * given.error else given.run


@dataclass(frozen=True, eq=False)
class _Solved:
    """A solution under known lightings.

    distance : metres, at which the sources seem to be in truth, if they do. misplaced : whether more than noise is
    left, of which sources in other directions may be the first cause.
    """

    run: Run
    solution: Solution
    distance: float | None
    misplaced: bool

    @property
    def error(self) -> float:
        """Relative RMS on unseen photographs."""
        return self.solution.candidates[self.solution.chosen].error


def _solve(
    photoset: PhotoSet,
    geometry: SceneGeometry,
    lightings: Mapping[str, Lighting],
    samples: int,
    clock: Clock,
    track: Track,
    find_causes: bool,
    said: Sequence[str],
    turns: Floats | None,
) -> _Solved:
    """said : sentences on the lightings. turns : as of `calibration_scores`."""
    sources = {name: lighting.sources for name, lighting in lightings.items()}
    importance = importances(photoset, geometry, lightings, clock)
    fields, left_out = read_samples(photoset, geometry.found, sources, samples, clock, track, importance)
    with clock.on("invrender"):
        elements = {name: light_elements(lighting) for name, lighting in lightings.items()}
        columns = _columns(photoset, fields, elements, geometry.shadows)
    _check_lit(photoset, lightings, columns)
    fitted = photoset.fitted
    with clock.on("invrender"):
        # A light that only held-out photographs are under is no evidence: it is scored, not fitted.
        seen = {photo.lighting for photo in fitted}
        used = [lighting for name, lighting in lightings.items() if name in seen]
        given = [columns[photo.label] for photo in fitted]

        def explained(photos: Sequence[PhotoColumns], doing: str) -> Explanation:
            with counted(track, EXPLANATION_STEPS, doing) as on_step:
                return explain(photos, used, on_step, geometry.brushing_axis)

        known = explained(given, "Fitting and cross-validating")
        parts = None if geometry.shadows is None else ConcaveMesh.of(geometry.shadows)
        bounces, remarks = None, []
        if parts is not None and any(element.name == "known" for name in seen for element in elements[name]):
            without = partial(explained, doing="Judging light that bounces")
            bounces = correct_known_light(parts, given, known, elements, without)
        elif parts is not None:
            remarks = unknown_scale(parts, known, elements)
        concluded = known if bounces is None else bounces.solution
        doubts = {} if bounces is None else {"bounced_light": [bounces.doubts]}
        doubts["sphere_place"] = _of_place(geometry.body, concluded, elements)
        settled = concluded.candidates[concluded.chosen].estimate
        lights = {lighting.name: lighting for lighting in used}
        doubts["lamp_distances"] = distance_doubts(
            concluded.photos, settled.brdf, settled.strengths, lights, geometry.shadows
        )
        weighed = weighed_photos(
            concluded,
            [photo.label for photo in fitted],
            [photo.camera for photo in fitted],
            geometry.body,
            lights,
            geometry.shadows,
        )
        scores = calibration_scores(
            weighed, geometry.body, found_of_sphere(photoset), photoset.errors, lights, turns
        )
        solution = solution_of(concluded, used, doubts, scores=scores)
        columns = _in_form(photoset, solution, columns, elements)
        sent = None if bounces is None else bounces.taken
        if sent is not None:
            held_out = photoset.held_out
            sent = replace(sent, brdf=solution.estimate.brdf)
            columns, sent = _less_bounced(solution, columns, held_out, elements, sent)
        strengths = {
            photo.label: _strengths(solution, columns[photo.label], photo.held_out)
            for photo in photoset.photos
        }
        scored = []
        for name in [name for name in lightings if name not in seen]:
            label = next(photo.label for photo in photoset.photos if photo.lighting == name)
            scored.append(scored_lighting(lightings[name], elements[name], strengths[label]))
        residuals = {
            label: entry.radiance - predict_columns(entry, solution.estimate.brdf, strengths[label])
            for label, entry in columns.items()
        }
    elsewhere, chosen = None, solution.candidates[solution.chosen]
    if chosen.error > POOR and not any(light.recovers for light in used):
        elsewhere = other_frame([fields[p.label] for p in fitted], [lightings[p.lighting] for p in fitted])
    causes: tuple[NamedCause, ...] = ()
    distance, misplaced = None, False
    if find_causes and elsewhere is None:
        left = {photo.label: columns[photo.label] for photo in fitted}
        scene = known_light_remainders(solution, geometry, left, lightings, elements, residuals)
        diagnosis = diagnose(scene, bool(outlying(chosen.photo_errors).any()))
        causes = named_causes(diagnosis, photoset.radiometry.exposure, geometry.brushing_axis)
        # A sphere or cameras elsewhere displace highlights, too, and are named with fewer numbers.
        misplaced = diagnosis is not None and all(
            finding.fit.cause.name == "direction" for finding in diagnosis.findings[:1]
        )
        if diagnosis is not None and diagnosis.findings:
            distance = lamp_distance(diagnosis)
            # The error bars hold what a fault moves.
            brdf = solution.estimate.brdf
            instead = [finding.instead(brdf) for finding in diagnosis.findings]
            solution = solution_of(concluded, used, doubts, instead, scores)
    warnings = [*left_out, *said, *find_warnings(photoset, solution, geometry, lightings, causes), *remarks]
    warnings += [elsewhere] if elsewhere else []
    found = None if bounces is None else bounces.found
    result = factorization(
        photoset, geometry, solution, fields, residuals, warnings, found, causes=causes, scored=scored
    )

    def with_bounces(photo: Photo, field: LightField, shown: NDArray[np.float64]) -> NDArray[np.float64]:
        return shown if sent is None else shown + sent.radiance(photo.lighting, field)

    def radiance(photo: Photo, field: LightField) -> NDArray[np.float64]:
        light = elements[photo.lighting], strengths[photo.label]
        return with_bounces(photo, field, predict(result.brdf, *light, field, geometry.shadows))

    by_samples = sorted(photoset.photos, key=lambda photo: len(fields[photo.label]))
    many = CachedShader(
        result.brdf,
        elements,
        # The last is kept, which is the photograph with the most samples.
        {photo.lighting: fields[photo.label] for photo in by_samples},
        Counter(photo.lighting for photo in photoset.photos),
        geometry.shadows,
        PICTURES_OFF * (result.rms(held_out=False) or 0.0),
    )

    def pictured(photo: Photo, field: LightField, binning: int) -> NDArray[np.float64]:
        shown = many.radiance(photo.lighting, strengths[photo.label], field)
        return with_bounces(photo, field, shown)

    run = Run(photoset, geometry, result, fields, residuals, radiance, pictured)
    return _Solved(run, solution, distance, misplaced)


def _columns(
    photoset: PhotoSet,
    fields: Mapping[str, LightField],
    elements: Mapping[str, Sequence[LightElement]],
    shadows: Shadows | None,
) -> dict[str, PhotoColumns]:
    photos = photoset.photos
    found = all_columns(
        [photo.lighting for photo in photos],
        elements,
        [fields[photo.label] for photo in photos],
        shadows=shadows,
    )
    return {photo.label: columns for photo, columns in zip(photos, found, strict=True)}


def _of_place(
    body: Body, known: Explanation, elements: Mapping[str, Sequence[LightElement]]
) -> list[list[NDArray[np.float64]]]:
    """What a sphere's place and radius leave in doubt of each photograph's radiance, where that is notable."""
    if not isinstance(body, SphereBody):
        return []
    deviation = np.sqrt(np.linalg.eigvalsh(body.sphere.covariance).max())
    if deviation < _PLACED_WELL * body.sphere.radius:
        return []
    estimate, photos = known.candidates[known.chosen].estimate, known.photos

    def radiance(k: int, field: LightField) -> NDArray[np.float64]:
        name = photos[k].lighting
        return predict(estimate.brdf, elements[name], estimate.strengths[name], field)

    return place_changes([photo.field for photo in photos], body.sphere, radiance)


def _less_bounced(
    solution: Solution,
    columns: Mapping[str, PhotoColumns],
    held_out: Sequence[Photo],
    elements: Mapping[str, Sequence[LightElement]],
    sent: Sent,
) -> tuple[dict[str, PhotoColumns], Sent]:
    """Columns, those of held-out photographs without bounced light too, and what bounces under every lighting."""
    columns = dict(columns)
    for photo in held_out:
        own = columns[photo.label]
        if photo.lighting not in sent.bounced:

            def strengths(field: LightField, own: PhotoColumns = own) -> NDArray[np.float64]:
                return _strengths(solution, replace(own, field=field), held_out=True)

            light = photo.lighting, elements[photo.lighting]
            sent = lit_by_itself(sent, *light, own.field, strengths)[1]
        columns[photo.label] = own.less(sent.radiance(photo.lighting, own.field))
    return columns, sent


def _in_form(
    photoset: PhotoSet,
    solution: Solution,
    columns: Mapping[str, PhotoColumns],
    elements: Mapping[str, Sequence[LightElement]],
) -> dict[str, PhotoColumns]:
    """Columns of the form that was found; of held-out photographs they may not have been made yet."""
    form = solution.estimate.model.form
    fitted = iter(solution.photos)
    found = {}
    for photo in photoset.photos:
        own = columns[photo.label] if photo.held_out else next(fitted)
        if own.form is not form:
            own = photo_columns(photo.lighting, elements[photo.lighting], own.field, form, own.shadows)
        found[photo.label] = own
    return found


def _check_lit(
    photoset: PhotoSet, lightings: Mapping[str, Lighting], columns: Mapping[str, PhotoColumns]
) -> None:
    for name, lighting in lightings.items():
        if lighting.closeness_std is not None:
            # Where its sources were put isn't for the set to mend.
            continue
        users = [columns[photo.label] for photo in photoset.photos if photo.lighting == name]
        for k, direction in enumerate(lighting.directions):
            source = lighting.sources[k][None]
            highest = max(
                float(cosines(photo.field.normals, seen_from(source, photo.field.positions)[0]).max())
                for photo in users
            )
            if highest <= 0:
                raise ValueError(
                    f'{photoset.manifest}: [[lighting]] "{name}": source {k + 1} at {np.round(direction, 3).tolist()}'
                    " is below the horizon of everything that is seen; directions point from the object to the"
                    " light, in the world's frame: check its sign and frame"
                )
            if lighting.recover_irradiance and not any(
                photo.field.sources_visible[:, k].any() for photo in users
            ):
                raise ValueError(
                    f'{photoset.manifest}: [[lighting]] "{name}": source {k + 1} is hidden by the object itself from'
                    " everything that is seen, so its irradiance can't be recovered: photograph the side that it"
                    " lights, or give its irradiance"
                )


def _strengths(solution: Solution, photo: PhotoColumns, held_out: bool) -> NDArray[np.float64]:
    known = solution.estimate.strengths.get(photo.lighting)
    if known is not None:
        return known
    assert held_out
    return fit_strengths(photo, 1 / solution.noise.variance(photo.radiance), solution.estimate)
