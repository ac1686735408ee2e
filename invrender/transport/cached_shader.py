"""Radiance of many pixels under known light: what a lobe gathers of a map looked up, where that is as good.

The integral over half-vectors takes some 30 microseconds for each ray and map, what is prepared once
(`reflected`) some 3; how far that is off depends on the map and on the lobe, and so is tried out. For pictures of a
sphere the integral is taken on a grid of its normals (`sphere_rays`).
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from functools import lru_cache
from threading import Lock

import numpy as np
from numpy.typing import NDArray

from invrender.brdf.microfacet import Microfacet
from invrender.transport.interpolated import InterpolatedLobe
from invrender.transport.predict import predict
from invrender.transport.reflected import prepared_map
from invrender.transport.shading import shade
from invrender.transport.sphere_rays import SphereRays
from invrender.transport.transfer import LightElement
from invrender.transport.visibility import Shadows
from recon.sampling.lightfield import LightField

Floats = NDArray[np.float64]

# Of what photographs differ from the model, the share (RMS) by which lookups may be off: they differ 3% more.
LOOKUPS_OFF = 0.25
# So many times the tolerance of a picture, grids on a sphere are tried with: lobes alone may be off by more.
_LOOSER = (64.0, 8.0, 1.0)
# Rays from which on preparing a map takes less time than it saves; samples that it is tried out on.
MANY_RAYS, _TRIED = 100_000, 400


@dataclass(frozen=True, eq=False)
class CachedShader:
    """Pictures of an object of one BRDF under lightings, by name, whose elements have known strengths.

    fields : some samples of each lighting. spheres : the rays of the photograph that they are of, if it is of a sphere.
    photos : how many pictures there will be under each. tolerance : relative RMS by which they may be off what
    `predict` yields.
    """

    brdf: Microfacet
    elements: Mapping[str, Sequence[LightElement]]
    fields: Mapping[str, LightField]
    spheres: Mapping[str, SphereRays | None]
    photos: Mapping[str, int]
    shadows: Shadows | None
    tolerance: float
    _serve: dict[str, bool] = field(default_factory=dict, repr=False)
    _allowed: dict[str, float | None] = field(default_factory=dict, repr=False)
    _trying: Lock = field(default_factory=Lock, repr=False)

    def __reduce__(self) -> tuple[object, ...]:
        # Its lock is of this process.
        given = self.brdf, self.elements, self.fields, self.spheres, self.photos, self.shadows, self.tolerance
        return CachedShader, given

    def radiance(
        self, lighting: str, strengths: Floats, samples: LightField, sphere: SphereRays | None = None
    ) -> Floats:
        """Radiance (n, 3) of samples; strengths : (elements, 3). sphere : the rays of their picture, if of a sphere."""
        tolerance = None if sphere is None else self._grids_serve(lighting, strengths)
        if sphere is not None and tolerance is not None:
            lobes = self._lobes(lighting, sphere, tolerance)
            # Integrals ray by ray may be fewer.
            if sum(lobe.over_sphere.count for lobe in lobes if lobe and lobe.over_sphere) <= len(
                samples.ray_sample
            ):
                return self._over_grids(lighting, strengths, samples, lobes)
        shown = self.brdf, self.elements[lighting], strengths, samples, self.shadows
        many = len(samples.ray_sample) * self.photos[lighting] >= MANY_RAYS
        return (_looked_up if many and self._maps_serve(lighting, strengths) else predict)(*shown)

    def _grids_serve(self, lighting: str, strengths: Floats) -> float | None:
        """The widest tolerance of what lobes reflect alone that keeps a picture within its own; None if none does."""
        with self._trying:
            if lighting not in self._allowed:
                self._allowed[lighting] = self._tried_on_grids(lighting, strengths)
            return self._allowed[lighting]

    def _tried_on_grids(self, lighting: str, strengths: Floats) -> float | None:
        sphere, brdf, elements = self.spheres[lighting], self.brdf, self.elements[lighting]
        mapped = any(element.slow_map is not None for element in elements)
        if sphere is None or brdf.sigma is None or brdf.form.axis is not None or not mapped:
            return None
        some = _some(self.fields[lighting])
        exact = predict(brdf, elements, strengths, some)
        for tolerance in (looser * self.tolerance for looser in _LOOSER if self.tolerance):
            lobes = self._lobes(lighting, sphere, tolerance)
            if _off(self._over_grids(lighting, strengths, some, lobes), exact) <= self.tolerance:
                return tolerance
        return None

    def _lobes(self, lighting: str, sphere: SphereRays, tolerance: float) -> list[InterpolatedLobe | None]:
        return [_lobe(self.brdf, element, tolerance, sphere) for element in self.elements[lighting]]

    def _over_grids(
        self, lighting: str, strengths: Floats, samples: LightField, lobes: Sequence[InterpolatedLobe | None]
    ) -> Floats:
        pairs = zip(self.elements[lighting], lobes, strict=True)
        return _added(strengths, (shade(self.brdf, element, samples, None, lobe) for element, lobe in pairs))

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
    exact, other = (of(brdf, elements, strengths, _some(field), shadows) for of in (predict, _looked_up))
    return _off(other, exact) <= tolerance


def _some(field: LightField) -> LightField:
    """Some hundred of the samples, all over."""
    return field.where(np.arange(len(field)) % (len(field) // _TRIED + 1) == 0)


def _off(radiance: Floats, exact: Floats) -> float:
    """RMS error over the RMS."""
    return float(np.linalg.norm(radiance - exact) / max(np.linalg.norm(exact), np.finfo(float).tiny))


def _looked_up(
    brdf: Microfacet,
    elements: Sequence[LightElement],
    strengths: Floats,
    samples: LightField,
    shadows: Shadows | None,
) -> Floats:
    parts = (shade(brdf, element, samples, shadows, prepared_map(brdf, element)) for element in elements)
    return _added(strengths, parts)


def _added(strengths: Floats, parts: Iterable[Floats]) -> Floats:
    return np.asarray(sum(strength * part for strength, part in zip(strengths, parts, strict=True)))


# Threads work on a photograph each, one part of it after another.
@lru_cache(maxsize=32)
def _lobe(
    brdf: Microfacet, element: LightElement, tolerance: float, sphere: SphereRays
) -> InterpolatedLobe | None:
    if element.slow_map is None:
        return None
    return InterpolatedLobe(brdf, element, tolerance, sphere, finer=False)
