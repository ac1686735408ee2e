"""Radiance of many pixels under known light: what a lobe gathers of a map looked up, where that is as good.

The integral over half-vectors takes some 30 microseconds for each ray and map, what is prepared once
(`reflected`) some 3; how far that is off depends on the map and on the lobe, and so is tried out.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from threading import Lock

import numpy as np
from numpy.typing import NDArray

from invrender.brdf.microfacet import Microfacet
from invrender.transport.predict import predict
from invrender.transport.reflected import prepared_map
from invrender.transport.shading import shade
from invrender.transport.transfer import LightElement
from invrender.transport.visibility import Shadows
from recon.sampling.lightfield import LightField

Floats = NDArray[np.float64]

# Of what photographs differ from the model, the share (RMS) by which lookups may be off: they differ 3% more.
LOOKUPS_OFF = 0.25
# Rays from which on preparing a map takes less time than it saves; samples that it is tried out on.
MANY_RAYS, _TRIED = 100_000, 400


@dataclass(frozen=True, eq=False)
class CachedShader:
    """Pictures of an object of one BRDF under lightings, by name, whose elements have known strengths.

    fields : some samples of each lighting. photos : how many pictures there will be under each. tolerance : relative
    RMS by which they may be off what `predict` yields.
    """

    brdf: Microfacet
    elements: Mapping[str, Sequence[LightElement]]
    fields: Mapping[str, LightField]
    photos: Mapping[str, int]
    shadows: Shadows | None
    tolerance: float
    _serve: dict[str, bool] = field(default_factory=dict, repr=False)
    _trying: Lock = field(default_factory=Lock, repr=False)

    def __reduce__(self) -> tuple[object, ...]:
        # Its lock is of this process.
        given = self.brdf, self.elements, self.fields, self.photos, self.shadows, self.tolerance
        return CachedShader, given

    def radiance(self, lighting: str, strengths: Floats, samples: LightField) -> Floats:
        """Radiance (n, 3) of samples; strengths : (elements, 3)."""
        many = len(samples.ray_sample) * self.photos[lighting] >= MANY_RAYS
        shown = _looked_up if many and self._maps_serve(lighting, strengths) else predict
        return shown(self.brdf, self.elements[lighting], strengths, samples, self.shadows)

    def _maps_serve(self, lighting: str, strengths: Floats) -> bool:
        with self._trying:
            if lighting not in self._serve:
                shown = self.brdf, self.elements[lighting], strengths, self.fields[lighting], self.shadows
                self._serve[lighting] = maps_serve(*shown, self.tolerance)
            return self._serve[lighting]


def maps_serve(
    brdf: Microfacet,
    elements: Sequence[LightElement],
    strengths: Floats,
    field: LightField,
    shadows: Shadows | None,
    tolerance: float,
) -> bool:
    """Whether prepared maps yield the radiance of a light field's samples, off by a tolerance (relative RMS) at most.

    strengths : (elements, 3). Some hundred of the samples are tried. False where there are no maps.
    """
    if all(prepared_map(brdf, element) is None for element in elements):
        return False
    some = field.where(np.arange(len(field)) % (len(field) // _TRIED + 1) == 0)
    exact, other = (of(brdf, elements, strengths, some, shadows) for of in (predict, _looked_up))
    return bool(np.sum((other - exact) ** 2) <= tolerance**2 * np.sum(exact**2))


def _looked_up(
    brdf: Microfacet,
    elements: Sequence[LightElement],
    strengths: Floats,
    samples: LightField,
    shadows: Shadows | None,
) -> Floats:
    parts = (shade(brdf, element, samples, shadows, prepared_map(brdf, element)) for element in elements)
    return np.asarray(sum(strength * part for strength, part in zip(strengths, parts, strict=True)))
