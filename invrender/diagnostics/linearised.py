"""Photographs about a BRDF and the numbers of a cause: residuals, and columns of all that may change.

Whatever a fit found together with the BRDF may take up part of a cause's pattern. So a cause is fitted with all of it.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from invrender.brdf.microfacet import Microfacet
from invrender.diagnostics.altered import Alteration, shown, source_parts
from invrender.diagnostics.cause import Cause
from invrender.diagnostics.remainder import Remainder, Remainders
from invrender.transport.diffuse_base import base_transfer
from invrender.transport.transfer import LightElement
from recon.harmonics.basis import evaluate_harmonics

Floats = NDArray[np.float64]
Ints = NDArray[np.int64]

# Steps of differences: of the logarithms of sigma and mu - 1; radians, of a source's direction.
_STEP, _TURN = 0.02, 0.003
# Degree of light from all around that fits in unknown light are free in, as matte objects show it.
_SKY_DEGREE = 2
# Places of the BRDF's numbers among all: Kd, Ks, log sigma, log(mu - 1).
KD, KS, SIGMA, MU = slice(0, 3), slice(3, 6), 6, 7
_OF_BRDF = 8
_CHANNELS = np.eye(3)
# Radiance that stands for none where a slope is taken by its size.
_DARKEST = 1e-100


@dataclass(frozen=True, eq=False)
class CauseState:
    """Where a search is: a BRDF, and a cause's numbers."""

    brdf: Microfacet
    numbers: Floats


@dataclass(frozen=True, eq=False)
class Linearised:
    """A photograph about a state: residual (n, 3), columns (n, 3, m), and their places (m,) among all numbers."""

    residual: Floats
    columns: Floats
    places: Ints


@dataclass(frozen=True, eq=False)
class LightColumns:
    """What of the light was found with the BRDF: columns (n, 3, m) of each photograph and their places (m,)."""

    columns: tuple[Floats, ...]
    places: tuple[Ints, ...]

    @property
    def first_free(self) -> int:
        """The first place after those of BRDF and light; a cause's numbers begin there."""
        return max((int(own.max()) + 1 for own in self.places if len(own)), default=_OF_BRDF)


def light_columns(scene: Remainders) -> LightColumns:
    """Columns of all that was found of the light, those of one lighting's photographs in the same places."""
    found = [_of_light(scene, photo) for photo in scene.photos]
    names = {name: k for k, name in enumerate(dict.fromkeys(name for own in found for name, _ in own))}
    columns, places = [], []
    for photo, own in zip(scene.photos, found, strict=True):
        empty = np.zeros((len(photo.field), 3, 0))
        columns.append(np.concatenate([empty, *(values[..., None] for _, values in own)], axis=-1))
        places.append(np.array([_OF_BRDF + names[name] for name, _ in own], int))
    return LightColumns(tuple(columns), tuple(places))


def predicted(scene: Remainders, cause: Cause, state: CauseState, k: int) -> Floats:
    """What photograph k would show (n, 3)."""
    return _reported(scene, cause, state, k)[0]


def linear_part(
    scene: Remainders, cause: Cause, state: CauseState, k: int, light: LightColumns
) -> Linearised:
    """Photograph k about a state, with columns only of what its radiance is linear in: Kd, Ks, light."""
    reported, slope, diffuse, specular = _reported(scene, cause, state, k)
    channels = np.broadcast_to(_CHANNELS, (len(diffuse), 3, 3))
    columns = [diffuse[..., None] * channels, specular[..., None] * channels, light.columns[k]]
    places = np.concatenate([np.arange(6), light.places[k]])
    return Linearised(
        scene.photos[k].field.radiance - reported, slope[..., None] * np.concatenate(columns, axis=-1), places
    )


def linearised(
    scene: Remainders, cause: Cause, state: CauseState, k: int, light: LightColumns, part: Linearised
) -> Linearised:
    """Photograph k about a state, with columns of everything; part : `linear_part` there."""
    here = scene.photos[k].field.radiance - part.residual
    columns, places = [part.columns], [*part.places]

    def add(moved: CauseState, step: float, place: int) -> None:
        columns.append(((predicted(scene, cause, moved, k) - here) / step)[..., None])
        places.append(place)

    brdf = state.brdf
    if brdf.sigma is not None:
        add(CauseState(replace(brdf, sigma=brdf.sigma * np.exp(_STEP)), state.numbers), _STEP, SIGMA)
    if brdf.mu is not None:
        add(CauseState(replace(brdf, mu=1 + (brdf.mu - 1) * np.exp(_STEP)), state.numbers), _STEP, MU)
    first = light.first_free
    if cause.columns is not None:
        return Linearised(
            part.residual,
            np.concatenate([*columns, cause.columns[k]], axis=-1),
            np.concatenate([places, first + cause.touches[k]]).astype(int),
        )
    for number in cause.touches[k].tolist():
        numbers = state.numbers.copy()
        numbers[number] += cause.step
        add(CauseState(brdf, numbers), cause.step, first + number)
    return Linearised(part.residual, np.concatenate(columns, axis=-1), np.array(places, int))


def _reported(
    scene: Remainders, cause: Cause, state: CauseState, k: int
) -> tuple[Floats, Floats, Floats, Floats]:
    """What a photograph shows, how much more per radiance that reaches it, and radiance per unit of Kd and of Ks."""
    diffuse, specular = shown(scene, scene.photos[k], state.brdf, cause.alter(k, state.numbers))
    total = state.brdf.kd * diffuse + state.brdf.ks * specular
    if cause.finish is None:
        return total, np.ones_like(total), diffuse, specular
    # A photograph that no light reaches has no level of its own.
    more = 1e-4 * np.maximum(np.abs(total), 1e-6 * np.abs(total).max() + _DARKEST)
    reported = cause.finish(total, state.numbers)
    return reported, (cause.finish(total + more, state.numbers) - reported) / more, diffuse, specular


def _of_light(scene: Remainders, photo: Remainder) -> list[tuple[tuple[str, str], Floats]]:
    """Columns (n, 3) of what of a photograph's light was found, by lighting and what it is."""
    found: list[tuple[tuple[str, str], Floats]] = []
    field, brdf = photo.field, scene.brdf

    def add_channels(what: str, values: Floats) -> None:
        found.extend(((photo.lighting, f"{what} {c}"), values * _CHANNELS[c]) for c in range(3))

    def of_source(k: int, otherwise: Alteration) -> Floats:
        diffuse, specular = source_parts(scene, photo, brdf, k, field, otherwise)
        return np.asarray(field.mean_over_rays(brdf.kd * diffuse + brdf.ks * specular))

    for k in range(len(photo.directions)):
        here = of_source(k, Alteration())
        if "irradiance" in photo.recovered:
            add_channels(f"source {k}", here)
        for way in (0, 1) if "direction" in photo.recovered else ():
            turns = np.zeros((len(photo.directions), 2))
            turns[k, way] = _TURN
            there = of_source(k, Alteration(turns=turns))
            found.append(((photo.lighting, f"direction {k} {way}"), (there - here) / _TURN))
    if "ambient" in photo.recovered:
        uniform = LightElement("ambient", np.zeros((0, 3)), np.zeros((0, 1)), uniform=1.0)
        base = base_transfer(brdf.form, brdf.mu, uniform, field.normals, field.views, None)
        add_channels("ambient", np.asarray(field.mean_over_rays(base)))
    if "sky" in photo.recovered:
        basis = field.mean_over_rays(evaluate_harmonics(field.normals, _SKY_DEGREE))
        for k, values in enumerate(basis.T):
            add_channels(f"sky {k}", values[:, None])
    return found
