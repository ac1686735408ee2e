"""What a fit under known light leaves, as diagnoses look at it."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from capture.lighting import Lighting
from invrender.brdf.microfacet import Microfacet
from invrender.diagnostics.remainder import Remainder, Remainders, Rest, of_object, remembered
from invrender.estimate.explanation import Explanation
from invrender.observation.geometry import SceneGeometry
from invrender.transport.columns import PhotoColumns
from invrender.transport.predict import reflected
from invrender.transport.transfer import LightElement
from invrender.transport.visibility import Shadows
from recon.sampling.lightfield import LightField

Floats = NDArray[np.float64]


def known_light_remainders(
    known: Explanation,
    geometry: SceneGeometry,
    photos: Mapping[str, PhotoColumns],
    lightings: Mapping[str, Lighting],
    elements: Mapping[str, Sequence[LightElement]],
    residuals: Mapping[str, Floats],
) -> Remainders:
    """The fitted photographs of an explanation; photos, residuals : by label, in the order of its weights."""
    used = {photo.lighting for photo in photos.values()}
    lights = {
        name: _light(lightings[name], elements[name], known.best.estimate.strengths[name], geometry.shadows)
        for name in used
    }
    found = []
    for (label, photo), own in zip(photos.items(), known.weights, strict=True):
        directions, irradiances, rest, recovered = lights[photo.lighting]
        found.append(
            Remainder(
                label,
                photo.lighting,
                photo.field,
                residuals[label],
                own.weight / np.maximum(own.trust, 1e-12),
                directions,
                irradiances,
                rest,
                recovered,
                any(element.slow_map is not None for element in elements[photo.lighting]),
            )
        )
    trust = [own.trust for own in known.weights]
    return of_object(found, trust, known.best.estimate.brdf, geometry.shadows, geometry.description)


def _light(
    lighting: Lighting, elements: Sequence[LightElement], strengths: Floats, shadows: Shadows | None
) -> tuple[Floats, Floats, Rest | None, frozenset[str]]:
    """Sources and their irradiances (k, 3) each, what is reflected of all else, and what of the light was fitted.

    Where some sources are near all of the light counts as the rest: what nobody turns or moves.
    """
    near = lighting.closeness is not None
    directions = lighting.directions[: 0 if near else None]
    count = len(directions)
    irradiances, others, weights = lighting.irradiances[:count].copy(), [], []
    sources = 0
    for element, strength in zip(elements, strengths, strict=True):
        if element.name.startswith("source") and not near:
            irradiances[sources], sources = strength, sources + 1
            continue
        # Of known light the lighting's own sources come first, then those that its map holds.
        own = 0 if lighting.recover_irradiance or element.name != "known" else count
        rest = replace(element, directions=element.directions[own:], irradiances=element.irradiances[own:])
        if len(rest.directions) or rest.slow_map is not None or rest.uniform:
            others.append(rest)
            weights.append(strength)
    names = {"irradiance": lighting.recover_irradiance, "ambient": lighting.recover_ambient}
    recovered = frozenset(name for name, found in names.items() if found)
    if not others:
        return directions, irradiances, None, recovered

    def rest_of(brdf: Microfacet, field: LightField) -> tuple[Floats, Floats]:
        return reflected(brdf, others, np.array(weights), field, shadows)

    return directions, irradiances, remembered(rest_of), recovered
