"""What a fit in unknown light leaves, as diagnoses look at it."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from invrender.brdf.microfacet import Microfacet
from invrender.diagnostics.remainder import Remainder, Remainders, Rest, of_object, remembered
from invrender.estimate.unknown_light import BlindLight, BlindSolution
from invrender.estimate.unknown_light.solution import sky_parts
from invrender.observation.geometry import SceneGeometry
from invrender.transport.predict import reflected
from invrender.transport.transfer import light_elements
from invrender.transport.visibility import Shadows
from recon.sampling.lightfield import LightField

Floats = NDArray[np.float64]


def unknown_light_remainders(
    blind: BlindSolution,
    brdf: Microfacet,
    geometry: SceneGeometry,
    photos: Sequence[tuple[str, str, LightField]],
    residuals: Sequence[Floats],
) -> Remainders:
    """The fitted photographs of a solution; photos : label, lighting and samples of each."""
    lights = {name: _rest(blind, light, geometry.shadows) for name, light in blind.lights.items()}
    found = []
    for (label, lighting, field), residual, own in zip(photos, residuals, blind.weights, strict=True):
        sources = blind.lights[lighting].sources
        distant = slice(None if sources.closeness is None else 0)
        weight = own.weight / np.maximum(own.trust, 1e-12)
        dark = len(blind.lights[lighting].coefficients) == 1
        recovered = frozenset({"irradiance", "direction", "distance", "ambient" if dark else "sky"})
        found.append(
            Remainder(
                label,
                lighting,
                field,
                residual,
                weight,
                sources.directions[distant],
                sources.irradiances[distant],
                lights[lighting],
                recovered,
                not dark,
            )
        )
    trust = [own.trust for own in blind.weights]
    return of_object(found, trust, brdf, geometry.shadows, geometry.description)


def _rest(blind: BlindSolution, light: BlindLight, shadows: Shadows | None) -> Rest:
    """What is reflected of a recovered light but its sources; with these where some are near: nobody turns them."""
    near = () if light.sources.closeness is None else light_elements(light.sources.lighting)
    strengths = light.sources.irradiances[: len(near)]

    def rest(brdf: Microfacet, field: LightField) -> tuple[Floats, Floats]:
        sky = sky_parts(brdf, light.coefficients, field, shadows, blind.transfer)
        lamps = reflected(brdf, near, strengths, field, shadows)
        return sky[0] + lamps[0], sky[1] + lamps[1]

    return remembered(rest)
