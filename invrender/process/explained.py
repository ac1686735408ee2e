"""Photographs of a set under known lightings, explained: samples, the model that suits them, and what it leaves."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial

import numpy as np
from numpy.typing import NDArray

from capture.lighting import Lighting, cosines, seen_from
from capture.photoset import PhotoSet
from capture.progress import Track, counted
from invrender.diagnostics.diagnosis import Diagnosis, diagnose, lamp_distance
from invrender.diagnostics.known_light import known_light_remainders
from invrender.estimate.evidence import fit_strengths, outlying
from invrender.estimate.explanation import EXPLANATION_STEPS, Explanation, explain
from invrender.estimate.interreflection.correction import Correction, Sent
from invrender.estimate.interreflection.known_light import (
    KnownLightEvidence,
    correct_known_light,
    unknown_scale,
)
from invrender.observation.clock import Clock
from invrender.observation.geometry import SceneGeometry
from invrender.observation.lighting_axes import other_frame
from invrender.observation.samples import read_samples
from invrender.process.held_out_light import lit_by_itself
from invrender.process.leverage import importances
from invrender.process.warnings import POOR
from invrender.transport.columns import PhotoColumns, all_columns, photo_columns
from invrender.transport.predict import predict_columns
from invrender.transport.radiosity import ConcaveMesh
from invrender.transport.transfer import LightElement, light_elements
from invrender.transport.visibility import Shadows
from recon.sampling.lightfield import LightField

Floats = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class ExplainedSet:
    """A set's photographs under known lightings, and what of them a model explains.

    lightings, elements : by name. fields, columns, strengths, residuals : of each photograph by its label; columns of
    the chosen form, without bounced light that was taken off, of which strengths (elements, 3) and residuals (n, 3)
    are. known : the explanation. bounces, sent : light that bounces, and what of it was taken off. left_out, remarks :
    sentences on samples, and on bounced light. elsewhere : that lightings are given in other axes, if they seem to be.
    diagnosis : why photographs aren't what the fit predicts, if causes were looked for.
    """

    lightings: Mapping[str, Lighting]
    elements: Mapping[str, Sequence[LightElement]]
    fields: Mapping[str, LightField]
    columns: Mapping[str, PhotoColumns]
    strengths: Mapping[str, Floats]
    residuals: Mapping[str, Floats]
    known: Explanation
    bounces: Correction[Explanation, Sent, KnownLightEvidence] | None
    sent: Sent | None
    left_out: Sequence[str]
    remarks: Sequence[str]
    elsewhere: str | None
    diagnosis: Diagnosis | None

    @property
    def error(self) -> float:
        """Relative RMS on unseen photographs."""
        return self.known.best.error

    @property
    def used(self) -> list[Lighting]:
        """The lightings that some fitted photograph is under: others are no evidence, they are scored."""
        seen = {photo.lighting for photo in self.known.photos}
        return [lighting for name, lighting in self.lightings.items() if name in seen]

    @property
    def distance(self) -> float | None:
        """Metres, at which sources that are given as distant seem to be in truth, if they do."""
        if self.diagnosis is None or not self.diagnosis.findings:
            return None
        return lamp_distance(self.diagnosis)

    @property
    def misplaced(self) -> bool:
        """Whether more than noise is left, of which sources in other directions may be the first cause.

        A sphere or cameras elsewhere displace highlights, too, and are named with fewer numbers.
        """
        return self.diagnosis is not None and all(
            finding.fit.cause.name == "direction" for finding in self.diagnosis.findings[:1]
        )


def explain_set(
    photoset: PhotoSet,
    geometry: SceneGeometry,
    lightings: Mapping[str, Lighting],
    samples: int,
    clock: Clock,
    track: Track,
    find_causes: bool,
) -> ExplainedSet:
    """Explain a set's photographs under lightings by name.

    samples : of all fitted photographs. find_causes : whether to look for the causes of what the model doesn't explain.
    Raises ValueError where a source lights nothing that is seen.
    """
    sources = {name: lighting.sources for name, lighting in lightings.items()}
    importance = importances(photoset, geometry, lightings, clock)
    fields, left_out = read_samples(photoset, geometry.found, sources, samples, clock, track, importance)
    with clock.on("invrender"):
        elements = {name: light_elements(lighting) for name, lighting in lightings.items()}
        columns = _columns(photoset, fields, elements, geometry.shadows)
    _check_lit(photoset, lightings, columns)
    fitted = photoset.fitted
    with clock.on("invrender"):
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
        known = known if bounces is None else bounces.solution
        columns = _in_form(photoset, known, columns, elements)
        sent = None if bounces is None else bounces.taken
        if sent is not None:
            sent = replace(sent, brdf=known.best.estimate.brdf)
            columns, sent = _less_bounced(photoset, known, columns, elements, sent)
        strengths = {
            photo.label: _strengths(known, columns[photo.label], photo.held_out) for photo in photoset.photos
        }
        brdf = known.best.estimate.brdf
        residuals = {
            label: entry.radiance - predict_columns(entry, brdf, strengths[label])
            for label, entry in columns.items()
        }
    elsewhere, diagnosis = None, None
    if known.best.error > POOR and not any(light.recovers for light in used):
        elsewhere = other_frame([fields[p.label] for p in fitted], [lightings[p.lighting] for p in fitted])
    if find_causes and elsewhere is None:
        left = {photo.label: columns[photo.label] for photo in fitted}
        scene = known_light_remainders(known, geometry, left, lightings, elements, residuals)
        diagnosis = diagnose(scene, bool(outlying(known.best.photo_errors).any()))
    return ExplainedSet(
        lightings,
        elements,
        fields,
        columns,
        strengths,
        residuals,
        known,
        bounces,
        sent,
        left_out,
        remarks,
        elsewhere,
        diagnosis,
    )


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


def _less_bounced(
    photoset: PhotoSet,
    known: Explanation,
    columns: Mapping[str, PhotoColumns],
    elements: Mapping[str, Sequence[LightElement]],
    sent: Sent,
) -> tuple[dict[str, PhotoColumns], Sent]:
    """Columns, those of held-out photographs without bounced light too, and what bounces under every lighting."""
    columns = dict(columns)
    for photo in photoset.held_out:
        own = columns[photo.label]
        if photo.lighting not in sent.bounced:

            def strengths(field: LightField, own: PhotoColumns = own) -> Floats:
                return _strengths(known, replace(own, field=field), held_out=True)

            light = photo.lighting, elements[photo.lighting]
            sent = lit_by_itself(sent, *light, own.field, strengths)[1]
        columns[photo.label] = own.less(sent.radiance(photo.lighting, own.field))
    return columns, sent


def _in_form(
    photoset: PhotoSet,
    known: Explanation,
    columns: Mapping[str, PhotoColumns],
    elements: Mapping[str, Sequence[LightElement]],
) -> dict[str, PhotoColumns]:
    """Columns of the form that was found; of held-out photographs they may not have been made yet."""
    form = known.best.estimate.model.form
    fitted = iter(known.photos)
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


def _strengths(known: Explanation, photo: PhotoColumns, held_out: bool) -> Floats:
    estimate = known.best.estimate
    found = estimate.strengths.get(photo.lighting)
    if found is not None:
        return found
    assert held_out
    return fit_strengths(photo, 1 / known.noise.variance(photo.radiance), estimate)
