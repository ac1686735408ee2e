"""How far lamps of known direction are, found with the BRDF from what inverse squares and angles do across an object.

Everything is sought at once on some of the samples: the BRDF's numbers, strengths that are free, and one over the
distance of each lamp, in which radiance is nearly linear up to infinity.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import least_squares

from capture.lighting import Lighting
from invrender.brdf.fresnel import MU_RANGE
from invrender.brdf.microfacet import SIGMA_RANGE, Microfacet
from invrender.estimate.explanation import Explanation
from invrender.estimate.linear import symmetric_pinv
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
        if len(own.directions)
        else own
        for name, own in lightings.items()
    }


def with_found_distances(
    lightings: Mapping[str, Lighting], known: Explanation, shadows: Shadows | None
) -> dict[str, Lighting]:
    """Near lightings by name, each source at the distance that suits photographs best, with its standard deviation.

    known : the photographs explained, with sources where they are assumed to be. A lighting that no photograph of it is
    under stays as it is.
    """
    seen = _some(known, any(own.radiance_map is not None for own in lightings.values()))
    used = [name for name in lightings if any(one.lighting == name for one in seen)]
    numbers = _Numbers(known, {name: lightings[name] for name in used})

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
    std = numbers.split(np.sqrt(np.diag(covariance)))
    return {
        name: replace(own, closeness_std=std["closeness", name]) if ("closeness", name) in std else own
        for name, own in {**lightings, **numbers.unpacked(found.x)[2]}.items()
    }


def distance_sentence(lightings: Mapping[str, Lighting], error: float) -> str:
    """What was found of sources that were given as distant. error : on unseen photographs without it."""
    return (
        f"The lamps were given as distant, but are near; taken for distant, {error:.1%} of the radiance would be left"
        " on unseen photographs. Their distances from the object's centre were found with the BRDF:"
        f" {distances_in_words(lightings)}. result.json has their places: check these, and give them as near."
    )


def distances_in_words(lightings: Mapping[str, Lighting]) -> str:
    """Distances from the object's centre that were found, of the first few sources; nothing if none was."""
    told = []
    for name, own in lightings.items():
        if own.closeness is None or own.closeness_std is None:
            continue
        told += [
            f"{name}: {with_error(1 / near, deviation / near**2)} m"
            for near, deviation in zip(own.closeness, own.closeness_std, strict=True)
            if near > 0 and np.isfinite(deviation)
        ]
    more = f" and {len(told) - _TOLD} more" if len(told) > _TOLD else ""
    return f"{', '.join(told[:_TOLD])}{more}"


def distance_doubts(
    photos: Sequence[PhotoColumns],
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
            off = 0.5 * lighting.closeness_std[k] * (np.arange(len(lighting.directions)) == k)
            ends = [
                light_elements(replace(lighting, closeness=np.maximum(lighting.closeness + way * off, 0)))
                for way in (1, -1)
            ]
            doubts.append(
                [
                    np.subtract(*(predict(brdf, end, strengths[name], photo.field, shadows) for end in ends))
                    if photo.lighting == name
                    else np.zeros_like(photo.radiance)
                    for photo in photos
                ]
            )
    return doubts


def _some(known: Explanation, mapped: bool) -> list[_Seen]:
    """Every so many samples of each photograph, with what they count for in the fit."""
    photos = known.photos
    step = max(sum(len(photo.field) for photo in photos) // (_SAMPLES_OF_MAPS if mapped else _SAMPLES), 1)
    found = []
    for photo, own in zip(photos, known.weights, strict=True):
        keep = np.arange(len(photo.field)) % step == 0
        weight = own.weight / np.maximum(own.trust, 1e-12)
        found.append(_Seen(photo.lighting, photo.field.where(keep), np.sqrt(weight[keep])))
    return found


@dataclass(frozen=True, eq=False)
class _Numbers:
    """What is sought, as one vector: Kd, Ks, mu and sigma where the lobe has them, closeness of sources, strengths."""

    known: Explanation
    lightings: Mapping[str, Lighting]

    @cached_property
    def _parts(self) -> dict[tuple[str, str], Floats]:
        """The vector's parts at the start, by what they are and of which lighting, if of any."""
        estimate = self.known.best.estimate
        brdf, parts = estimate.brdf, {("kd", ""): estimate.brdf.kd}
        if brdf.sigma is not None:
            parts["ks", ""] = brdf.ks[:1] if estimate.model.neutral else brdf.ks
        for name in ("mu", "sigma"):
            if getattr(brdf, name) is not None:
                parts[name, ""] = np.array([getattr(brdf, name)])
        for name, own in self.lightings.items():
            if own.closeness is not None:
                parts["closeness", name] = own.closeness
        for name, free in self._free.items():
            parts["strengths", name] = estimate.strengths[name][free].ravel()
        return parts

    @cached_property
    def _free(self) -> dict[str, NDArray[np.bool_]]:
        """Which elements' strengths are free, (elements,), by lighting."""
        return {
            name: np.array([element.name != "known" for element in light_elements(own)])
            for name, own in self.lightings.items()
        }

    @property
    def start(self) -> Floats:
        return np.concatenate(list(self._parts.values()))

    @property
    def bounds(self) -> tuple[Floats, Floats]:
        """The least and the largest vector; the fit's own mu and sigma may be at the ends of their ranges."""
        ranges = {"mu": MU_RANGE, "sigma": SIGMA_RANGE, "closeness": (0, np.inf)}
        ends = []
        for (what, _), values in self._parts.items():
            low, high = ranges.get(what, (-np.inf, np.inf))
            ends.append(np.stack([np.minimum(low, 0.99 * values), np.maximum(high, 1.01 * values)]))
        low, high = np.concatenate(ends, axis=1)
        return low, high

    def split(self, vector: Floats) -> dict[tuple[str, str], Floats]:
        """A vector's parts, as `_parts`."""
        ends = np.cumsum([len(values) for values in self._parts.values()])[:-1]
        return dict(zip(self._parts, np.split(vector, ends), strict=True))

    def unpacked(self, vector: Floats) -> tuple[Microfacet, dict[str, Floats], dict[str, Lighting]]:
        """The BRDF, strengths (elements, 3) and lightings that a vector stands for."""
        parts = self.split(vector)
        mu, sigma = (float(parts[name, ""][0]) if (name, "") in parts else None for name in ("mu", "sigma"))
        brdf = replace(self.known.best.estimate.brdf, kd=parts["kd", ""], mu=mu, sigma=sigma)
        if ("ks", "") in parts:
            brdf = replace(brdf, ks=np.broadcast_to(parts["ks", ""], 3))
        lightings = dict(self.lightings)
        strengths = {}
        for name, free in self._free.items():
            if ("closeness", name) in parts:
                lightings[name] = replace(lightings[name], closeness=parts["closeness", name])
            strengths[name] = np.array(self.known.best.estimate.strengths[name], float)
            strengths[name][free] = parts["strengths", name].reshape(-1, 3)
        return brdf, strengths, lightings
