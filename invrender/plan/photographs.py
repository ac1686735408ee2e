"""Photographs before they are taken: which samples `process` would draw, what they would show, and how it changes."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from capture.camera import Camera
from capture.radiance import RadianceImage
from invrender.brdf.fresnel import normalised_fresnel
from invrender.brdf.microfacet import Microfacet
from invrender.plan.reflected import LightParts, Reflected, ReflectingObject
from invrender.plan.unknowns import Unknowns
from invrender.theory.operator import irradiance_operator, reflection_operator
from recon.mesh.bodies import Body, body_coverage, body_window
from recon.sampling.draw import NO_SOURCES, sample_body, samples_at
from recon.sampling.lightfield import LightField, off_terminators

Floats = NDArray[np.float64]

# Pixels by which an object's brightness in a photograph is measured.
_PICTURE = 300
# How many times the samples that are looked at are drawn from, at least.
_SPARE = 4
# Of the reflection operator's rows, relative to the largest: a plan needs no more.
_TOLERANCE = 1e-4
# Numbers of rows that are held at once, to bound memory.
_ROW_NUMBERS = 1 << 24


@dataclass(frozen=True, eq=False)
class Draw:
    """Samples of a photograph, a part of those that a fit would take.

    field : them, with the visibility of `LightParts.compact`. stands_for : how many samples of a fit each stands for.
    """

    field: LightField
    stands_for: float


@dataclass(frozen=True, eq=False)
class ShownSamples:
    """What samples show, and how that changes with the unknowns.

    brdf : of which BRDF. reflected : of all light together. own : (3, n, q'), derivatives in each channel's numbers
    of the lighting, in `Unknowns.places` after those of the BRDF.
    """

    brdf: Microfacet
    reflected: Reflected
    own: Floats

    @property
    def radiance(self) -> Floats:
        """(n, 3)."""
        return self.reflected.radiance(self.brdf)

    @property
    def columns(self) -> Floats:
        """Derivatives (3, n, q) of the radiance in what each channel depends on."""
        shared = np.stack(self.reflected.columns(self.brdf), axis=-1).transpose(1, 0, 2)
        return np.concatenate([shared, self.own], axis=2)

    def where(self, keep: NDArray[np.bool_]) -> ShownSamples:
        """The samples marked by a mask (n,)."""
        parts = (self.reflected.diffuse, self.reflected.lobe, self.reflected.by_mu, self.reflected.by_sigma)
        return ShownSamples(self.brdf, Reflected(*(part[keep] for part in parts)), self.own[:, keep])


def draw(
    body: Body, camera: Camera, parts: LightParts, budget: int, looked_at: int, rng: np.random.Generator
) -> Draw:
    """Draw a photograph's samples: of the `budget` that a fit would take, about `looked_at`."""
    top, left, bottom, right = body_window(body, camera)
    # Enough pixels for the samples, and for a fit's choice among them, which is as even over normals.
    share = max(_SPARE * looked_at / max((bottom - top) * (right - left), 1), looked_at / budget)
    step = max(int(1 / np.sqrt(share)), 1)
    image = unexposed(camera, step)
    taken = sample_body(body, camera, image, None, NO_SOURCES, max(round(budget / step**2), 1), rng)
    count = len(taken)
    some = np.sort(rng.choice(count, min(looked_at, count), replace=False))
    field = samples_at(body, camera, image, taken.rows[some], taken.columns[some], parts.compact)
    visible = field.sources_visible[:, : len(parts.sources)]
    field = field.where(steady(field, parts.sources, visible))
    return Draw(field, count * step**2 / max(len(some), 1))


def picture(body: Body, camera: Camera, parts: LightParts) -> LightField:
    """Pixels that lie wholly on the object, every so many rows and columns: they show how bright it is."""
    top, left, bottom, right = body_window(body, camera)
    stride = max(int(np.sqrt((bottom - top) * (right - left) / _PICTURE)), 1)
    rows, columns = (stride * place for place in np.nonzero(body_coverage(body, camera, stride)))
    whole = body.pixel_geometry(camera, rows, columns).whole
    return samples_at(body, camera, unexposed(camera), rows[whole], columns[whole], parts.compact)


def unexposed(camera: Camera, step: int = 1) -> RadianceImage:
    """A photograph that nobody has taken: black, of which every step-th row and column is to be looked at.

    The others count as saturated: sampling passes over those.
    """
    size = (camera.height, camera.width)
    black = np.broadcast_to(np.zeros(3, np.float32), (*size, 3))
    passed_over = np.full(size, step > 1)
    passed_over[step // 2 :: step, step // 2 :: step] = False
    return RadianceImage(black, black, passed_over)


def steady(field: LightField, sources: Floats, visible: NDArray[np.bool_]) -> NDArray[np.bool_]:
    """Which samples (n,) `off_terminators` keeps under sources (k, 3) that rays see as `visible` (m, k) says."""
    numbered = replace(field, rows=np.arange(len(field)), sources_visible=visible)
    keep = np.zeros(len(field), bool)
    keep[off_terminators(numbered, sources).rows] = True
    return keep


def reflected(optics: ReflectingObject, parts: LightParts, field: LightField) -> Reflected:
    """What samples show of all the light of a lighting."""
    total = optics.of_extended(parts, field)
    for k, (direction, irradiance) in enumerate(zip(parts.sources, parts.irradiances, strict=True)):
        total += optics.of_source(direction, field, field.sources_visible[:, k]).times(irradiance)
    return total


def shown(
    optics: ReflectingObject, parts: LightParts, unknowns: Unknowns, fields: Sequence[LightField]
) -> Iterator[ShownSamples]:
    """What photographs under one lighting show, one after the other."""
    l_max = round(np.sqrt(len(unknowns.harmonics))) - 1
    rows = _harmonic_rows(optics, fields, l_max)
    for field in fields:
        extended = next(rows)
        yield ShownSamples(
            optics.brdf,
            reflected(optics, parts, field),
            _own_columns(optics, parts, unknowns, field, extended),
        )


def _own_columns(
    optics: ReflectingObject,
    parts: LightParts,
    unknowns: Unknowns,
    field: LightField,
    extended: tuple[Floats, Floats],
) -> Floats:
    """Derivatives (3, n, q') in the numbers of an unknown lighting; q' is 0 where it is known."""
    brdf = optics.brdf
    columns = [np.zeros((3, len(field), 0))]
    if len(unknowns.harmonics):
        diffuse, specular = extended
        columns.append(brdf.kd[:, None, None] * diffuse + brdf.ks[:, None, None] * specular)
    if len(unknowns.irradiance):
        seen = field.sources_visible.T[: len(parts.sources)]
        sources = list(zip(parts.sources, parts.irradiances, seen, strict=True))
        columns += [
            optics.of_source(direction, field, visible).radiance(brdf).T[:, :, None]
            for direction, _, visible in sources
        ]
        columns += [
            moved.times(irradiance).radiance(brdf).T[:, :, None]
            for direction, irradiance, visible in sources
            for moved in optics.by_direction(direction, field, visible)
        ]
    return np.concatenate(columns, axis=2)


def _harmonic_rows(
    optics: ReflectingObject, fields: Sequence[LightField], l_max: int
) -> Iterator[tuple[Floats, Floats]]:
    """Per photograph the diffuse and the specular rows (n, (l_max + 1)^2), of unit Kd and Ks, over coefficients.

    At each pixel's mean normal and view. The operator tabulates a lobe anew whenever it is called: as many
    photographs as memory holds share a call.
    """
    count = (l_max + 1) ** 2
    batch: list[LightField] = []
    for index, field in enumerate(fields):
        batch.append(field)
        held = sum(len(one) for one in batch) * count
        if held < _ROW_NUMBERS and index + 1 < len(fields):
            continue
        yield from _batch_rows(optics, batch, l_max)
        batch = []


def _batch_rows(
    optics: ReflectingObject, fields: Sequence[LightField], l_max: int
) -> Iterator[tuple[Floats, Floats]]:
    count = (l_max + 1) ** 2
    if not count or not any(len(field) for field in fields):
        yield from ((np.zeros((len(field), count)), np.zeros((len(field), count))) for field in fields)
        return
    normals, views = (
        np.concatenate([_unit(field.mean_over_rays(getattr(field, name))) for field in fields])
        for name in ("normals", "views")
    )
    specular = np.zeros((len(normals), count))
    if optics.brdf.sigma is not None:
        cos = (normals * views).sum(axis=1)
        free = np.concatenate(
            [field.mean_over_rays(field.reflected_visible.astype(float)) for field in fields]
        )
        specular = reflection_operator(optics.lobe_without_fresnel, normals, views, l_max, _TOLERANCE)
        specular *= (free * normalised_fresnel(optics.brdf.mu, cos))[:, None]
    diffuse = irradiance_operator(normals, l_max)
    if optics.shadows is not None:
        diffuse -= np.concatenate([optics.shadows.hidden_rows(field, l_max) for field in fields])
    ends = np.cumsum([len(field) for field in fields])[:-1]
    yield from zip(np.split(diffuse, ends), np.split(specular, ends), strict=True)


def _unit(vectors: NDArray[np.floating]) -> Floats:
    return np.asarray(vectors / np.linalg.norm(vectors, axis=1, keepdims=True), float)
