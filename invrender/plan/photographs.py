"""Photographs before they are taken: which samples `process` would draw."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from capture.camera import Camera
from capture.radiance import RadianceImage
from recon.mesh.bodies import Body, MeshBody, body_coverage, body_window, sees
from recon.sampling.draw import NO_SOURCES, sample_body, samples_at
from recon.sampling.lightfield import LightField, off_terminators

Floats = NDArray[np.float64]

# Pixels by which an object's brightness in a photograph is measured.
_PICTURE = 300
# How many times the samples that are looked at are drawn from, at least.
_SPARE = 4


@dataclass(frozen=True, eq=False)
class Draw:
    """Samples of a photograph, a part of those that a fit would take.

    stands_for : how many samples of a fit each stands for.
    """

    field: LightField
    stands_for: float


def draw(
    body: Body, camera: Camera, sources: Floats, budget: int, looked_at: int, rng: np.random.Generator
) -> Draw:
    """Draw a photograph's samples under sources (k, 3): of the `budget` that a fit would take, about `looked_at`."""
    top, left, bottom, right = body_window(body, camera)
    # Enough pixels for the samples, and for a fit's choice among them, which is as even over normals.
    share = max(_SPARE * looked_at / max((bottom - top) * (right - left), 1), looked_at / budget)
    step = max(int(1 / np.sqrt(share)), 1)
    image = unexposed(camera, step)
    taken = sample_body(body, camera, image, None, NO_SOURCES, max(round(budget / step**2), 1), rng)
    count = len(taken)
    some = np.zeros(count, bool)
    some[rng.choice(count, min(looked_at, count), replace=False)] = True
    # Borders of shadows are left out: nobody asks how much of a pixel is lit.
    field = replace(taken.where(some).with_few_rays(), footprints=None)
    lit = off_terminators(replace(field, sources_visible=visible_sources(body, field, sources)), sources)
    return Draw(lit, count * step**2 / max(int(some.sum()), 1))


def visible_sources(body: Body, field: LightField, sources: Floats) -> NDArray[np.bool_]:
    """Which rays (m, k) of a field on the body see sources (k, 3), or (k, 4) where some are near."""
    facets = body.facets[field.faces] if isinstance(body, MeshBody) else field.normals
    seen = [sees(body, field.positions, facets, one) for one in sources]
    return np.array(seen, bool).reshape(len(sources), len(facets)).T


def picture(body: Body, camera: Camera) -> LightField:
    """Pixels that lie wholly on the object, every so many rows and columns: they show how bright it is."""
    top, left, bottom, right = body_window(body, camera)
    stride = max(int(np.sqrt((bottom - top) * (right - left) / _PICTURE)), 1)
    rows, columns = (stride * place for place in np.nonzero(body_coverage(body, camera, stride)))
    whole = body.pixel_geometry(camera, rows, columns).whole
    return samples_at(body, camera, unexposed(camera), rows[whole], columns[whole], NO_SOURCES)


def unexposed(camera: Camera, step: int = 1) -> RadianceImage:
    """A photograph that nobody has taken: black, of which every step-th row and column is to be looked at.

    The others count as saturated: sampling passes over those.
    """
    size = (camera.height, camera.width)
    black = np.broadcast_to(np.zeros(3, np.float32), (*size, 3))
    passed_over = np.full(size, step > 1)
    passed_over[step // 2 :: step, step // 2 :: step] = False
    return RadianceImage(black, black, passed_over)
