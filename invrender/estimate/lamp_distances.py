"""How far lamps of known direction are, found with the BRDF from what inverse squares and angles do across an object.

Everything is sought at once on some of the samples: the BRDF's numbers, strengths that are free, and one over the
distance of each lamp, in which radiance is nearly linear up to infinity.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property, partial

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import least_squares

from capture.lighting import Lighting
from invrender.brdf.fresnel import MU_RANGE
from invrender.brdf.microfacet import SIGMA_RANGE, Microfacet
from invrender.estimate.linear import symmetric_pinv
from invrender.estimate.solution import Solution
from invrender.transport.columns import PhotoColumns
from invrender.transport.predict import predict
from invrender.transport.transfer import light_elements
from invrender.transport.visibility import Shadows
from invrender.wording import with_error
from recon.sampling.lightfield import LightField

Floats = NDArray[np.float64]

# Samples that distances are sought on, of all photographs; where light of a map is integrated for each, fewer.
_SAMPLES, _SAMPLES_OF_MAPS = 6000, 1000
# Lamps that a sentence names.
_TOLD = 4


@dataclass(frozen=True, eq=False)
class _Seen:
    """Some samples of a photograph. root : (n, 3), roots of their weights."""

    lighting: str
    field: LightField
    root: Floats


def at_one_distance(
    lightings: Mapping[str, Lighting], centre: Floats, distance: float
) -> dict[str, Lighting]:
    """Lightings by name whose sources are all assumed to lie so many metres from an object's centre (3,)."""
    return {
        name: replace(
            own,
            closeness=np.full(len(own.directions), 1 / distance),
            closeness_std=np.full(len(own.directions), np.inf),
            centre=centre,
        )
        for name, own in lightings.items()
    }


def with_found_distances(
    lightings: Mapping[str, Lighting], solution: Solution, shadows: Shadows | None
) -> dict[str, Lighting]:
    """Near lightings by name, each source at the distance that suits photographs best, with its standard deviation.

    solution : of the photographs, with sources where they are assumed to be. A lighting that no photograph of it is
    under stays as it is.
    """
    seen = _some(solution, any(own.radiance_map is not None for own in lightings.values()))
    used = [name for name in lightings if any(one.lighting == name for one in seen)]
    numbers = _Numbers(solution, {name: lightings[name] for name in used})

    def residuals(point: Floats) -> Floats:
        brdf, strengths, moved = numbers.unpacked(point)
        elements = {name: light_elements(own) for name, own in moved.items()}
        return np.concatenate(
            [
                (
                    one.root
                    * (
                        predict(brdf, elements[one.lighting], strengths[one.lighting], one.field, shadows)
                        - one.field.radiance
                    )
                ).ravel()
                for one in seen
            ]
        )

    start = numbers.start
    found = least_squares(residuals, start, x_scale="jac", bounds=numbers.bounds, xtol=1e-6, max_nfev=30)
    covariance = symmetric_pinv(found.jac.T @ found.jac) * max(
        2 * found.cost / (found.fun.size - start.size), 1
    )
    _, _, moved = numbers.unpacked(found.x)
    std = np.sqrt(np.diag(covariance))
    return {
        name: replace(moved[name], closeness_std=numbers.closeness_of(std)[name]) if name in moved else own
        for name, own in lightings.items()
    }


def distance_sentence(lightings: Mapping[str, Lighting], error: float) -> str:
    """What was found of sources that were given as distant. error : on unseen photographs without it."""
    told = []
    for name, own in lightings.items():
        assert own.closeness is not None
        assert own.closeness_std is not None
        told += [
            f"{name}: {with_error(1 / near, deviation / near**2)} m"
            for near, deviation in zip(own.closeness, own.closeness_std, strict=True)
            if near > 0 and np.isfinite(deviation)
        ]
    more = f" and {len(told) - _TOLD} more" if len(told) > _TOLD else ""
    return (
        f"The lamps were given as distant, but are near; taken for distant, {error:.1%} of the radiance would be left"
        " on unseen photographs. Their distances from the object's centre were found with the BRDF:"
        f" {', '.join(told[:_TOLD])}{more}. result.json has their places: check these, and give them as near."
    )


def distance_doubts(
    solution_photos: Sequence[PhotoColumns],
    brdf: Microfacet,
    strengths: Mapping[str, Floats],
    lightings: Mapping[str, Lighting],
    shadows: Shadows | None,
) -> list[list[Floats]]:
    """By how much each photograph's radiance (n, 3) changes if one lamp's closeness is off by its deviation."""
    doubts = []
    for name, lighting in lightings.items():
        if lighting.closeness is None or lighting.closeness_std is None:
            continue
        for k in np.flatnonzero(np.isfinite(lighting.closeness_std) & (lighting.closeness_std > 0)):
            ends = []
            for way in (0.5, -0.5):
                closeness = lighting.closeness.copy()
                closeness[k] = max(closeness[k] + way * lighting.closeness_std[k], 0)
                elements = light_elements(replace(lighting, closeness=closeness))
                ends.append(partial(predict, brdf, elements, strengths[name], shadows=shadows))
            doubts.append(
                [
                    ends[0](photo.field) - ends[1](photo.field)
                    if photo.lighting == name
                    else np.zeros_like(photo.radiance)
                    for photo in solution_photos
                ]
            )
    return doubts


def _some(solution: Solution, mapped: bool) -> list[_Seen]:
    """Every so many samples of each photograph, with what they count for in the fit."""
    photos = solution.photos
    step = max(sum(len(photo.field) for photo in photos) // (_SAMPLES_OF_MAPS if mapped else _SAMPLES), 1)
    found = []
    for photo, own in zip(photos, solution.weights, strict=True):
        keep = np.arange(len(photo.field)) % step == 0
        weight = own.weight / np.maximum(own.trust, 1e-12)
        found.append(_Seen(photo.lighting, photo.field.where(keep), np.sqrt(weight[keep])))
    return found


@dataclass(frozen=True, eq=False)
class _Numbers:
    """What is sought, as one vector: Kd, Ks, mu and sigma where the lobe has them, closeness of sources, strengths."""

    solution: Solution
    lightings: Mapping[str, Lighting]

    @property
    def _brdf(self) -> Microfacet:
        return self.solution.estimate.brdf

    @property
    def _lobe(self) -> tuple[str, ...]:
        return tuple(name for name in ("mu", "sigma") if getattr(self._brdf, name) is not None)

    @property
    def _ks(self) -> int:
        """How many numbers Ks is: none, one, or one per channel."""
        if self._brdf.sigma is None:
            return 0
        return 1 if self.solution.estimate.model.neutral else 3

    @cached_property
    def _free(self) -> dict[str, Floats]:
        """Which elements' strengths are free, (elements,), by lighting."""
        return {
            name: np.array([element.name != "known" for element in light_elements(own)])
            for name, own in self.lightings.items()
        }

    @property
    def start(self) -> Floats:
        brdf = self._brdf
        lobe = [getattr(brdf, name) for name in self._lobe]
        closeness = [own.closeness for own in self.lightings.values()]
        strengths = [
            self.solution.estimate.strengths[name][free].ravel() for name, free in self._free.items()
        ]
        parts = [brdf.kd, brdf.ks[: self._ks], lobe, *closeness, *strengths]
        return np.concatenate([np.asarray(part, float) for part in parts])

    @property
    def bounds(self) -> tuple[Floats, Floats]:
        low, high = np.full((2, len(self.start)), np.inf)
        low *= -1
        lobe = {"mu": MU_RANGE, "sigma": SIGMA_RANGE}
        first = 3 + self._ks
        for place, name in enumerate(self._lobe, start=first):
            value = self.start[place]
            low[place], high[place] = min(lobe[name][0], 0.99 * value), max(lobe[name][1], 1.01 * value)
        first += len(self._lobe)
        low[first : first + self._sources] = 0
        return low, high

    @property
    def _sources(self) -> int:
        return sum(len(own.directions) for own in self.lightings.values())

    def closeness_of(self, vector: Floats) -> dict[str, Floats]:
        """The part of a vector that is of each lighting's sources."""
        place = 3 + self._ks + len(self._lobe)
        found = {}
        for name, own in self.lightings.items():
            found[name] = vector[place : place + len(own.directions)]
            place += len(own.directions)
        return found

    def unpacked(self, vector: Floats) -> tuple[Microfacet, dict[str, Floats], dict[str, Lighting]]:
        """The BRDF, strengths (elements, 3) and lightings that a vector stands for."""
        brdf, first = replace(self._brdf, kd=vector[:3]), 3 + self._ks
        if self._ks:
            brdf = replace(brdf, ks=np.broadcast_to(vector[3:first], 3))
        brdf = replace(brdf, **dict(zip(self._lobe, vector[first:].tolist(), strict=False)))
        lightings = {
            name: replace(self.lightings[name], closeness=closeness)
            for name, closeness in self.closeness_of(vector).items()
        }
        place, strengths = first + len(self._lobe) + self._sources, {}
        for name, free in self._free.items():
            strengths[name] = np.array(self.solution.estimate.strengths[name], float)
            count = 3 * int(free.sum())
            strengths[name][free] = vector[place : place + count].reshape(-1, 3)
            place += count
        return brdf, strengths, lightings
