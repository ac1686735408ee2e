"""What crossed filters pass of the lobe, found before the main job from a share of its samples."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace

from capture.photoset import PhotoSet
from capture.polarisation import Extinction
from capture.progress import Track, counted
from capture.source_region import source_regions
from invrender.estimate.explanation import explain
from invrender.estimate.extinction import improve_extinction
from invrender.estimate.unknown_light import BlindSolution, factorize_blind
from invrender.estimate.unknown_light.extinction import improve_blind_extinction
from invrender.observation.clock import Clock
from invrender.observation.geometry import SceneGeometry
from invrender.observation.samples import read_samples
from invrender.process.held_out_light import used_lightings
from invrender.process.leverage import importances
from invrender.process.unknown_light import orders_of
from invrender.transport.columns import all_columns
from invrender.transport.transfer import light_elements
from recon.sampling.lightfield import LightField

# Of all photographs together. Noise then leaves less in doubt than what no model explains.
_SAMPLES = 20_000
# Steps, each a fit and what it leaves, and the last one's length in deviations that is short enough.
_STEPS, _SETTLED = 4, 0.2

# The extinction a step further, from samples seen through filters of the one so far.
Step = Callable[[Sequence[LightField], Extinction], Extinction]
_Fields = Mapping[str, LightField]


def with_found_extinction(
    photoset: PhotoSet, geometry: SceneGeometry, samples: int, clock: Clock, track: Track
) -> PhotoSet:
    """The set with the extinction of its filters, where the photographs are to tell it; as it is where it is given.

    Without highlights nothing tells it: its origin stays "free" then.
    """
    extinction = photoset.extinction
    if extinction is None or not extinction.is_free:
        return photoset
    if photoset.object.texture:
        raise ValueError(
            f"{photoset.manifest}: what crossed filters pass of highlights isn't found with texture = true: write"
            " [polarisation] extinction; `process` without texture = true finds it, of a glossy ball say"
        )
    fitted = replace(photoset, photos=photoset.fitted)
    unknown = {table.name for table in photoset.lightings if table.unknown}
    is_unknown = bool(unknown & {photo.lighting for photo in fitted.photos})
    prepared = _unknown_light if is_unknown else _known_light
    fields, step = prepared(fitted, geometry, min(samples, _SAMPLES), clock, track)
    with (
        counted(track, _STEPS, "Finding what crossed filters pass of highlights") as on_step,
        clock.on("invrender"),
    ):
        for _ in range(_STEPS):
            photoset = photoset.with_extinction(extinction)
            seen = [fields[photo.label].through(photo.polariser) for photo in photoset.fitted]
            before, extinction = extinction, step(seen, extinction)
            on_step()
            if abs(extinction.value - before.value) <= _SETTLED * extinction.std:
                break
    return photoset.with_extinction(extinction)


def _known_light(
    fitted: PhotoSet, geometry: SceneGeometry, samples: int, clock: Clock, track: Track
) -> tuple[_Fields, Step]:
    """Samples by photographs' labels, and a step under known light."""
    lightings = used_lightings(fitted, geometry.body)
    sources = {name: lighting.sources for name, lighting in lightings.items()}
    importance = importances(fitted, geometry, lightings, clock)
    fields, _ = read_samples(fitted, geometry.found, sources, samples, clock, track, importance)
    elements = {name: light_elements(lighting) for name, lighting in lightings.items()}
    names = [photo.lighting for photo in fitted.photos]

    def step(seen: Sequence[LightField], extinction: Extinction) -> Extinction:
        photos = all_columns(names, elements, seen, shadows=geometry.shadows)
        known = explain(photos, list(lightings.values()), axis=geometry.brushing_axis)
        return improve_extinction(known, extinction)

    return fields, step


def _unknown_light(
    fitted: PhotoSet, geometry: SceneGeometry, samples: int, clock: Clock, track: Track
) -> tuple[_Fields, Step]:
    """Samples by photographs' labels, and a step in unknown light; each begins where the last one ended."""
    names = [photo.lighting for photo in fitted.photos]
    fields, _ = read_samples(fitted, geometry.found, {}, samples, clock, track, highlights=True)
    orders, regions, shadows = orders_of(fitted, ()), source_regions(fitted.lightings), geometry.shadows
    near: list[BlindSolution] = []

    def step(seen: Sequence[LightField], extinction: Extinction) -> Extinction:
        last = near[-1] if near else None
        found = factorize_blind(
            seen, names, orders=orders, source_regions=regions, shadows=shadows, near=last
        )
        near.append(found)
        return improve_blind_extinction(found, seen, names, shadows, extinction)

    return fields, step
