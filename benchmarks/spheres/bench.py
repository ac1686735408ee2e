"""The six spheres of RH01's Fig. 11 before cameras on an arc, photographed by brute force, and what no fit sees."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

from benchmarks.atlas.stage import AREA, SOURCE, SPHERE, Stage
from capture.arc.gantry import Arc
from capture.camera import Camera
from invrender.plan.photographs import unexposed
from recon.harmonics.basis import evaluate_harmonics, sphere_directions
from recon.mesh.bodies import SphereBody
from recon.sampling.draw import NO_SOURCES, sample_body
from recon.sampling.lightfield import LightField, off_terminators
from synthetic.lights.arealight import AreaLight
from synthetic.lights.sources import DirectionalSource
from synthetic.materials.rh01 import RH01_MATERIALS, radiometric
from synthetic.render.lobes import reflected_radiance

Floats = NDArray[np.float64]

MATERIALS = {name: radiometric(row) for name, row in RH01_MATERIALS.items()}
RADIUS_PX = 90.0
# Under which a BRDF is tried out: from other sides, and by another lamp than it was found by.
OTHER_AREA = AreaLight(np.array([0.3, -0.6, 0.74]), np.array([1.2, 1.1, 0.9]), width_rad=0.5)
OTHER_SOURCE = DirectionalSource(np.array([0.2, 0.9, 0.39]), np.array([1.1, 1.3, 1.5]))
# Samples of each photograph that is predicted; degree of the light that is compared.
_JUDGED, LIGHT_DEGREE = 3000, 6


def stage_of(name: str, known: bool, views: int, samples: int) -> Stage:
    """A sphere of Fig. 11 under the area light and the source."""
    return Stage(MATERIALS[name], known=known, views=views, samples=samples, radius_px=RADIUS_PX)


@lru_cache(maxsize=4)
def black_fields(known: bool, views: int, samples: int) -> tuple[LightField, ...]:
    """Samples before any light: all materials share them."""
    return tuple(stage_of("teflon", known, views, samples).fields())


def photographs(name: str, known: bool, views: int, samples: int) -> list[LightField]:
    """Photographs without noise."""
    return [_lit(name, field, [AREA], [SOURCE]) for field in black_fields(known, views, samples)]


def noisy(photos: Sequence[LightField], seed: int) -> list[LightField]:
    """The same with 1% noise above a floor of 0.1% of the photograph's mean."""
    return Stage().noisy(photos, np.random.default_rng(seed))


@lru_cache(maxsize=1)
def _unseen() -> tuple[LightField, ...]:
    """Photographs from between the others' places and from above them, still black."""
    found = []
    side = int(2.2 * RADIUS_PX)
    focal = RADIUS_PX * 0.6 / SPHERE.radius
    for axis, angle in (([0, 0, 1], 31.5), ([0, 0, 1], 100.5), ([0, 0.6, 0.8], 40.0)):
        pose = Arc(np.zeros(3), axis, 0.6, [1, 0, 0]).pose(np.radians(angle))
        camera = Camera("PINHOLE", np.array([focal, focal, side / 2, side / 2]), side, side, pose)
        rng = np.random.default_rng(99)
        field = sample_body(SphereBody(SPHERE), camera, unexposed(camera), None, NO_SOURCES, _JUDGED, rng)
        directions = np.stack([SOURCE.direction, OTHER_SOURCE.direction])
        visible = np.ones((len(field.ray_sample), 2), bool)
        found.append(off_terminators(replace(field, sources_visible=visible), directions))
    return tuple(found)


def unseen_ratio(
    name: str, predict: Callable[[LightField], Floats], other_light: bool, scaled: bool
) -> float:
    """RMS of prediction less photograph over that of the photograph's noise, for views that no fit has seen.

    other_light : under another lamp and area light. scaled : whether a factor per channel is free.
    """
    lights = ([OTHER_AREA], [OTHER_SOURCE]) if other_light else ([AREA], [SOURCE])
    clean = [_lit(name, field, *lights) for field in _unseen()]
    seen = np.concatenate([photo.radiance for photo in noisy(clean, 12345)])
    true = np.concatenate([photo.radiance for photo in clean])
    made = np.concatenate([predict(field) for field in clean])
    if scaled:
        made = made * (made * seen).sum(axis=0) / (made**2).sum(axis=0)
    return float(np.sqrt(np.mean((seen - made) ** 2) / np.mean((seen - true) ** 2)))


@lru_cache(maxsize=1)
def true_coefficients() -> Floats:
    """Coefficients (49, 3) of all the light over that of degree 0, by equal solid angles."""
    sharp = evaluate_harmonics(SOURCE.direction[None], LIGHT_DEGREE).T * SOURCE.irradiance
    total = area_coefficients(LIGHT_DEGREE) + sharp
    return np.asarray(total / total[0])


@lru_cache(maxsize=4)
def area_coefficients(l_max: int) -> Floats:
    """Coefficients ((l_max + 1)^2, 3) of the area light."""
    grid = sphere_directions(50_000)
    return np.asarray(4 * np.pi / len(grid) * evaluate_harmonics(grid, l_max).T @ AREA.radiance_from(grid))


def _lit(
    name: str, field: LightField, areas: Sequence[AreaLight], sources: Sequence[DirectionalSource]
) -> LightField:
    radiance = reflected_radiance(MATERIALS[name], areas, sources, field.normals, field.views)
    return replace(field, radiance=field.mean_over_rays(radiance))
