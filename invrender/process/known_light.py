"""The main job where lighting is known, or all of it but strengths."""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from capture.lighting import Lighting
from capture.photo import Photo
from capture.photoset import PhotoSet
from capture.progress import Track
from invrender.brdf.microfacet import Microfacet
from invrender.diagnostics.named import NamedCause, named_causes
from invrender.estimate.calibration import calibration_scores, weighed_photos
from invrender.estimate.explanation import Explanation
from invrender.estimate.known_scale import given_scale, known_scale
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
from invrender.estimate.solution import solution_of
from invrender.observation.clock import Clock
from invrender.observation.geometry import SceneGeometry
from invrender.observation.sphere_place import found_of_sphere, place_changes
from invrender.process.explained import ExplainedSet, explain_set
from invrender.process.held_out_light import scored_lighting, used_lightings
from invrender.process.warnings import find_warnings
from invrender.result.run import Run
from invrender.result.scores import mean_rms, photo_scores
from invrender.transport.cached_shader import LOOKUPS_OFF, CachedShader
from invrender.transport.predict import predict
from invrender.transport.sphere_rays import SphereRays
from invrender.transport.transfer import LightElement
from recon.lighting import stands_clear
from recon.mesh.bodies import Body, SphereBody
from recon.reference import Reference, find_references
from recon.sampling.lightfield import LightField

Floats = NDArray[np.float64]

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
        references = find_references(photoset, geometry.body)
        # A reference that tells nothing is named before the fit.
        given_scale(references, {photo.lighting: lightings[photo.lighting] for photo in photoset.fitted})

    def explained(under: Mapping[str, Lighting], causes: bool = True) -> ExplainedSet:
        return explain_set(photoset, geometry, under, samples, clock, track, find_causes and causes)

    def concluded(known: ExplainedSet, said: Sequence[str] = (), turns: Floats | None = None) -> Run:
        return _concluded(photoset, geometry, known, references, clock, said, turns)

    def under_turned(turned: FoundDirections) -> Run:
        """Under sources in other directions, if these explain photographs better."""
        found = explained(turned.lightings)
        if found.error >= FEWER * given.error:
            return concluded(given)
        better = improve_directions(lightings, turned, found.known)
        if better is not None:
            turned, found = better, explained(better.lightings)
        return concluded(found, [direction_sentence(lightings, turned, given.error)], turned.covariance)

    given = explained(lightings)
    if given.distance is None:
        turned = find_directions(lightings, given.known) if given.misplaced else None
        return concluded(given) if turned is None else under_turned(turned)
    near = at_one_distance(lightings, geometry.body.centre, given.distance)
    places = [place[0] for lighting in near.values() for place in lighting.places if place is not None]
    if not all(stands_clear(geometry.body, place) for place in places):
        return concluded(given)
    near = with_found_distances(near, explained(near, causes=False).known, geometry.shadows)
    found = explained(near)
    if found.error >= FEWER * given.error:
        return concluded(given)
    return concluded(found, [distance_sentence(near, given.error)])


def _concluded(
    photoset: PhotoSet,
    geometry: SceneGeometry,
    explained: ExplainedSet,
    references: Sequence[Reference],
    clock: Clock,
    said: Sequence[str],
    turns: Floats | None,
) -> Run:
    """What an explanation amounts to.

    references : of known reflectance. said : sentences on the lightings. turns : as of `calibration_scores`.
    """
    lightings, elements, known = explained.lightings, explained.elements, explained.known
    brdf = known.best.estimate.brdf
    scale = known_scale(references, known.best.estimate.strengths, elements)
    known = replace(known, gauge=scale.gauge)
    fields, strengths, bounces = explained.fields, explained.strengths, explained.bounces
    causes: tuple[NamedCause, ...] = ()
    instead: list[Microfacet] = []
    if explained.diagnosis is not None:
        causes = named_causes(explained.diagnosis, photoset.radiometry.exposure, geometry.brushing_axis)
        # The error bars hold what a fault moves.
        instead = [finding.instead(brdf) for finding in explained.diagnosis.findings]
    with clock.on("invrender"):
        lights = {lighting.name: lighting for lighting in explained.used}
        doubts = _doubts(explained, lights, geometry)
        weighed = weighed_photos(
            known,
            [photo.label for photo in photoset.fitted],
            [photo.camera for photo in photoset.fitted],
            geometry.body,
            lights,
            geometry.shadows,
        )
        errors = calibration_scores(
            weighed, geometry.body, found_of_sphere(photoset), photoset.errors, lights, turns
        )
        solution = solution_of(known, explained.used, doubts, instead, errors)
    first = {photo.lighting: photo.label for photo in reversed(photoset.photos)}
    scored = [
        scored_lighting(own, elements[name], strengths[first[name]])
        for name, own in lightings.items()
        if name not in lights
    ]
    if scale.gauge is not None:
        scored = [own.dimmed(scale.factor) for own in scored]
    solution = replace(solution, lightings=(*solution.lightings, *scored))
    scores = photo_scores(photoset, solution, fields, explained.residuals)
    warnings = (
        *explained.left_out,
        *said,
        *find_warnings(photoset, solution, geometry, lightings, causes),
        *explained.remarks,
        *scale.remarks,
        *([explained.elsewhere] if explained.elsewhere else []),
    )

    # Not all of what was explained: its columns are most of a set's memory, and a run outlives them.
    sent = explained.sent

    def with_bounces(photo: Photo, field: LightField, shown: Floats) -> Floats:
        return shown if sent is None else shown + sent.radiance(photo.lighting, field)

    def radiance(photo: Photo, field: LightField) -> Floats:
        light = elements[photo.lighting], strengths[photo.label]
        return with_bounces(photo, field, predict(brdf, *light, field, geometry.shadows))

    by_samples = sorted(photoset.photos, key=lambda photo: len(fields[photo.label]))
    many = CachedShader(
        brdf,
        elements,
        # The last is kept, which is the photograph with the most samples.
        {photo.lighting: fields[photo.label] for photo in by_samples},
        {photo.lighting: SphereRays.of(geometry.body, photo.camera) for photo in by_samples},
        Counter(photo.lighting for photo in photoset.photos),
        geometry.shadows,
        LOOKUPS_OFF * (mean_rms(scores, held_out=False) or 0.0),
    )

    def pictured(photo: Photo, field: LightField, binning: int) -> Floats:
        rays = SphereRays.of(geometry.body, photo.camera)
        shown = many.radiance(photo.lighting, strengths[photo.label], field, rays)
        return with_bounces(photo, field, shown)

    return Run(
        photoset,
        geometry,
        solution,
        fields,
        explained.residuals,
        scores,
        warnings,
        radiance,
        pictured,
        interreflection=None if bounces is None else bounces.found,
        causes=causes,
        references=scale.scores,
    )


def _doubts(
    explained: ExplainedSet, lights: Mapping[str, Lighting], geometry: SceneGeometry
) -> dict[str, Sequence[Sequence[Floats]]]:
    """By cause, what radiance is in doubt: as `solution_of` has it. lights : that fitted photographs are under."""
    known = explained.known
    estimate = known.best.estimate
    found: dict[str, Sequence[Sequence[Floats]]] = {}
    if explained.bounces is not None:
        found["bounced_light"] = [explained.bounces.doubts]
    found["sphere_place"] = _of_place(geometry.body, known, explained.elements)
    found["lamp_distances"] = distance_doubts(
        known.photos, estimate.brdf, estimate.strengths, lights, geometry.shadows
    )
    return found


def _of_place(
    body: Body, known: Explanation, elements: Mapping[str, Sequence[LightElement]]
) -> list[list[Floats]]:
    """What a sphere's place and radius leave in doubt of each photograph's radiance, where that is notable."""
    if not isinstance(body, SphereBody):
        return []
    deviation = np.sqrt(np.linalg.eigvalsh(body.sphere.covariance).max())
    if deviation < _PLACED_WELL * body.sphere.radius:
        return []
    estimate, photos = known.best.estimate, known.photos

    def radiance(k: int, field: LightField) -> Floats:
        name = photos[k].lighting
        return predict(estimate.brdf, elements[name], estimate.strengths[name], field)

    return place_changes([photo.field for photo in photos], body.sphere, radiance)
