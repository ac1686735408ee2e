"""Photographs of a mirror ball in the object's place, from which its light can be read."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from capture.files.imagefile import write_exr
from synthetic.lights.disc import DiscLight
from synthetic.lights.illumination import Illumination
from synthetic.lights.sources import PointSource
from synthetic.materials.mirror import Mirror
from synthetic.render.photograph import Progress, photographs
from synthetic.scene import Effort, Scene, Shot
from synthetic.scenes.views import seen_from
from synthetic.sensing.development import Development
from synthetic.sensing.masks import write_mask
from synthetic.sensing.sensor import vignetting
from synthetic.shapes.ball import Ball
from synthetic.staging import Staging

Floats = NDArray[np.float64]

FOLDER = "mirrorball"
# A source without a size is a disc in the ball: of this angular radius, or a pixel's, if that is larger, for smaller
# ones would fall between the points that a pixel is looked at in.
_SOURCE_RADIUS_DEG = 0.6
# A ball whose radius isn't given is as large as the object, but not larger than this share of the picture.
_LARGEST = 0.9


def write_mirror_balls(
    staging: Staging, folder: Path, progress: Progress | None = None
) -> dict[str, dict[str, Any]]:
    """Photograph the ball under every lighting into folder/mirrorball; returns `mirror_ball` tables by lighting's name.

    They are merged brackets already: linear EXR, with the lens's vignetting but without noise.
    """
    if staging.ball is None:
        return {}
    table, scene = staging.ball, staging.scene
    target = scene.surface.centre
    camera = scene.shots[0].camera
    poses = [
        seen_from(azimuth, table.elevation_deg, table.distance, target) for azimuth in table.azimuths_deg
    ]
    largest = _LARGEST / 2 * min(camera.width, camera.height) / camera.focal_px * table.distance
    radius = min(scene.surface.reach, largest) if table.radius is None else table.radius
    # Along a pixel the normal turns by its part of the radius, the reflection by twice that.
    pixel = 2 * table.distance / (camera.focal_px * radius)
    size = max(np.radians(_SOURCE_RADIUS_DEG), pixel)
    lights = [_with_sizes(light, size, target) for light in scene.illuminations]
    shots = [Shot(camera.posed(pose), light) for light in lights for pose in poses]
    ball = Scene(
        f"{scene.name}: mirror ball",
        Ball(target, radius),
        Mirror(np.zeros(3), np.ones(3)),
        tuple(shots),
        Effort(directions=64, per_side=8),
        scene.seed,
    )
    (folder / FOLDER).mkdir(exist_ok=True)
    tables: dict[str, dict[str, Any]] = {light.name: {"views": []} for light in scene.illuminations}
    for shot, (radiance, coverage) in zip(shots, photographs(ball, progress), strict=True):
        name = shot.illumination.name
        views = tables[name]["views"]
        stem = f"{FOLDER}/{name}-{len(views)}"
        if isinstance(staging.sensor, Development):
            radiance = radiance * vignetting(staging.sensor.sensor, camera.width, camera.height)[..., None]
        write_exr(folder / f"{stem}.exr", radiance.astype(np.float32))
        write_mask(folder / f"{stem}_mask.png", coverage)
        view: dict[str, Any] = {"photo": f"{stem}.exr", "mask": f"{stem}_mask.png"}
        view["world_to_camera"] = shot.camera.world_to_camera.tolist()
        if isinstance(staging.sensor, Development):
            view |= _exposure(staging.sensor)
        views.append(view)
    return tables


def _exposure(development: Development) -> dict[str, float]:
    """A second's exposure, as the manifest states it: with ISO and f-number only where the photographs' EXIF does."""
    if development.exposure == "manual":
        return {"exposure_s": 1.0}
    return {"exposure_s": 1.0, "iso": float(development.iso), "f_number": development.f_number}


def _with_sizes(illumination: Illumination, radius_rad: float, centre: Floats) -> Illumination:
    """The same light, sources being discs or bulbs of an angular radius: a mirror shows nothing of a point."""
    discs, bulbs = [], []
    for source in illumination.sources:
        if isinstance(source, PointSource):
            distance = np.linalg.norm(source.position - centre)
            bulbs.append(replace(source, radius=float(distance * np.sin(radius_rad))))
        else:
            discs.append(DiscLight(source.direction, source.irradiance, radius_rad))
    return replace(illumination, extended=(*illumination.extended, *discs), sources=tuple(bulbs))
