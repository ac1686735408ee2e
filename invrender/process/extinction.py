"""What crossed filters pass of the lobe, found before the main job from a share of its samples."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace

import numpy as np

from capture.photo import Photo
from capture.photoset import PhotoSet
from capture.polarisation import Extinction
from capture.progress import Track, counted
from capture.source_region import source_regions
from invrender.brdf.form import LobeForm
from invrender.brdf.lobes import RH01_FORM
from invrender.estimate.explanation import explain
from invrender.estimate.extinction import improve_extinction, is_crossed
from invrender.estimate.search import OTHER_FORMS
from invrender.estimate.textured.extinction import improve_textured_extinction
from invrender.estimate.textured.layout import find_layout
from invrender.estimate.textured.seen import rows_in_forms
from invrender.estimate.unknown_light import BlindSolution, factorize_blind
from invrender.estimate.unknown_light.extinction import improve_blind_extinction
from invrender.observation.clock import Clock
from invrender.observation.geometry import SceneGeometry
from invrender.observation.samples import read_samples
from invrender.process.held_out_light import used_lightings
from invrender.process.leverage import importances
from invrender.process.texture_passes import TextureBench, first_pass
from invrender.process.textured import footprint, given_lightings
from invrender.process.unknown_light import orders_of
from invrender.transport.columns import all_columns
from invrender.transport.transfer import light_elements
from recon.mesh.bodies import MeshBody

# Of all photographs together. Noise then leaves less in doubt than what no model explains.
_SAMPLES = 20_000
# Steps, each a fit and what it leaves, and the last one's length in deviations that is short enough.
_STEPS, _SETTLED = 4, 0.2
# The extinction a step further, from photographs through filters of the one so far.
Step = Callable[[Sequence[Photo], Extinction], Extinction]


def with_found_extinction(
    photoset: PhotoSet,
    geometry: SceneGeometry,
    samples: int,
    clock: Clock,
    track: Track,
    is_unknown: bool,
) -> PhotoSet:
    """The set with the extinction of its filters, where the photographs are to tell it; as it is where it is given.

    is_unknown : whether light is. Without highlights nothing tells it: its origin stays "free" then.
    """
    extinction = photoset.extinction
    if extinction is None or not extinction.is_free:
        return photoset
    fitted = replace(photoset, photos=photoset.fitted)
    if photoset.object.texture and is_unknown:
        raise ValueError(
            f"{photoset.manifest}: what crossed filters pass of highlights isn't found with texture = true in unknown"
            " light: write [polarisation] extinction; `process` finds it of a glossy ball, or under known light"
        )
    prepared = _unknown_light if is_unknown else _textured if photoset.object.texture else _known_light
    step = prepared(fitted, geometry, min(samples, _SAMPLES), clock, track)
    with (
        counted(track, _STEPS, "Finding what crossed filters pass of highlights") as on_step,
        clock.on("invrender"),
    ):
        for _ in range(_STEPS):
            photoset = photoset.with_extinction(extinction)
            before, extinction = extinction, step(photoset.fitted, extinction)
            on_step()
            if abs(extinction.value - before.value) <= _SETTLED * extinction.std:
                break
    return photoset.with_extinction(extinction)


def _known_light(fitted: PhotoSet, geometry: SceneGeometry, samples: int, clock: Clock, track: Track) -> Step:
    """A step under known light; the photographs are read once."""
    lightings = used_lightings(fitted, geometry.body)
    sources = {name: lighting.sources for name, lighting in lightings.items()}
    importance = importances(fitted, geometry, lightings, clock)
    fields, _ = read_samples(fitted, geometry.found, sources, samples, clock, track, importance)
    elements = {name: light_elements(lighting) for name, lighting in lightings.items()}
    names = [photo.lighting for photo in fitted.photos]

    def step(photos: Sequence[Photo], extinction: Extinction) -> Extinction:
        seen = [fields[photo.label].through(photo.polariser) for photo in photos]
        columns = all_columns(names, elements, seen, shadows=geometry.shadows)
        known = explain(columns, list(lightings.values()), axis=geometry.brushing_axis)
        return improve_extinction(known, extinction)

    return step


def _unknown_light(
    fitted: PhotoSet, geometry: SceneGeometry, samples: int, clock: Clock, track: Track
) -> Step:
    """A step in unknown light; each begins where the last one ended."""
    names = [photo.lighting for photo in fitted.photos]
    fields, _ = read_samples(fitted, geometry.found, {}, samples, clock, track, highlights=True)
    orders, regions, shadows = orders_of(fitted, ()), source_regions(fitted.lightings), geometry.shadows
    near: list[BlindSolution] = []

    def step(photos: Sequence[Photo], extinction: Extinction) -> Extinction:
        seen = [fields[photo.label].through(photo.polariser) for photo in photos]
        last = near[-1] if near else None
        found = factorize_blind(
            seen, names, orders=orders, source_regions=regions, shadows=shadows, near=last
        )
        near.append(found)
        return improve_blind_extinction(found, seen, names, shadows, extinction)

    return step


def _textured(fitted: PhotoSet, geometry: SceneGeometry, samples: int, clock: Clock, track: Track) -> Step:
    """A step on a textured mesh under known light, from some of its points."""
    body = geometry.body
    assert isinstance(body, MeshBody)
    lightings = given_lightings(fitted, body, clock)
    bench = TextureBench.of(fitted, geometry, lightings)
    with clock.on("recon"):
        layout, _ = find_layout(body, footprint(fitted, body))
    subset = first_pass(bench, fitted, layout.points, samples, clock, track)
    # After the first step the one that suits best.
    forms: list[LobeForm] = [RH01_FORM, *OTHER_FORMS]

    def step(photos: Sequence[Photo], extinction: Extinction) -> Extinction:
        seen = [
            replace(shown, pixels=shown.pixels.through(photo.polariser))
            for photo, shown in zip(photos, subset.shown, strict=True)
        ]
        # What a wrong form of the lobe lacks would count as base, and as missing behind crossed filters.
        by_form = rows_in_forms(seen, bench.elements, forms, geometry.shadows)
        crossed = np.array([bool(is_crossed(own.pixels).any()) for own in seen])
        found, form = improve_textured_extinction(by_form, crossed, len(subset.points), extinction)
        forms[:] = [form]
        return found

    return step
