"""What nobody could know of a photo set: truth.json, and how well the photographs are integrated."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from functools import partial
from typing import Any

import numpy as np
from numpy.typing import NDArray

from capture.files.documents import software
from capture.parallel import parallel_map
from synthetic.lights.arealight import AreaLight
from synthetic.lights.disc import DiscLight
from synthetic.lights.illumination import Illumination
from synthetic.lights.sources import DirectionalSource, PointSource
from synthetic.manifest import WrittenSet
from synthetic.materials.facets import GGXSlopes
from synthetic.materials.material import Material
from synthetic.materials.microfacet import MicrofacetMaterial
from synthetic.materials.mirror import Mirror
from synthetic.materials.phong import PhongMaterial
from synthetic.materials.plastic import Plastic
from synthetic.materials.smith import SmithMaterial
from synthetic.materials.tabulated import Tabulated
from synthetic.materials.texture import Textured
from synthetic.render.photograph import Tile, plain_radiance, tile_radiance
from synthetic.scene import Scene
from synthetic.sensing.development import Development
from synthetic.shapes.ball import Ball
from synthetic.staging import Staging

Floats = NDArray[np.float64]

# How many times more directions the judge of the integration looks into.
_FINER = 8


def truth_document(
    staging: Staging, written: WrittenSet, calibration: dict[str, Any] | None, error: float
) -> dict[str, Any]:
    """What truth.json holds. error : of `integration_error`."""
    scene = staging.scene
    return {
        "format": 1,
        "name": scene.name,
        "seed": scene.seed,
        "brdf": described(scene.material),
        "object": _object(staging),
        "lighting": [_lighting(light, written) for light in scene.illuminations],
        "photos": [
            {
                "file": photograph.file,
                "radiance": f"truth/{photograph.shot:03d}.exr",
                "lighting": scene.shots[photograph.shot].illumination.name,
                "world_to_camera": scene.shots[photograph.shot].camera.world_to_camera.tolist(),
            }
            for photograph in written.photographs
        ],
        "sensor": _sensor(staging),
        "faults": staging.faults.model_dump(),
        "uncertainty": staging.uncertainty.model_dump(),
        "calibration": calibration,
        "integration": {
            "relative_rms_error": error,
            "directions": scene.effort.directions,
            "per_side": scene.effort.per_side,
            "bounces": scene.effort.bounces,
        },
        "software": software(),
    }


def described(material: Material) -> dict[str, Any]:
    """A material's model and parameters; of a textured one the means, and the maps' files."""
    if isinstance(material, Textured):
        maps = {"kd_map": "truth/texture_kd.exr", "ks_map": "truth/texture_ks.exr"}
        return described(material.material) | _weights(material) | maps
    numbers: dict[str, Any] = {}
    if isinstance(material, Plastic):
        return described(material.gloss) | {"model": "plastic"}
    match material:
        case MicrofacetMaterial():
            model, numbers = "microfacet", {"mu": material.mu, "sigma": material.sigma}
        case SmithMaterial(facets=GGXSlopes()) if material.is_isotropic:
            model, numbers = "ggx", {"mu": material.mu, "alpha": material.facets.along}
        case SmithMaterial(facets=GGXSlopes()):
            sizes = {"alpha_x": material.facets.along, "alpha_y": material.facets.across}
            model, numbers = "anisotropic", {"mu": material.mu} | sizes
        case SmithMaterial():
            model, numbers = "smith", {"mu": material.mu, "sigma": material.facets.along}
        case PhongMaterial():
            model, numbers = "phong", {"exponent": material.exponent}
        case Mirror():
            model, numbers = "mirror", {"mu": material.mu}
        case Tabulated():
            model = "table"
        case _:
            model = "lambertian"
    return {"model": model} | _weights(material) | numbers


def integration_error(scene: Scene, judged: Sequence[Tile]) -> float:
    """Relative RMS by which pixels differ from plain sums over many times more directions.

    judged : pixels, the object's outline left out. Root mean square difference over root mean square radiance.
    """
    effort = scene.effort
    finer = replace(effort, directions=effort.directions * _FINER)
    judge = replace(scene, effort=finer, seed=scene.seed + 1)
    used = np.concatenate(list(parallel_map(partial(tile_radiance, scene), judged)))
    fine = np.concatenate(list(parallel_map(partial(plain_radiance, judge), judged)))
    level = (fine**2).mean()
    # Photographs that are black are so exactly.
    return float(np.sqrt(((used - fine) ** 2).mean() / level)) if level else 0.0


def _weights(material: Material) -> dict[str, Any]:
    return {"kd": material.kd.tolist(), "ks": material.ks.tolist()}


def _object(staging: Staging) -> dict[str, Any]:
    surface = staging.scene.surface
    if isinstance(surface, Ball):
        return {"shape": "sphere", "centre": surface.centre.tolist(), "radius": surface.radius}
    exact = not (staging.faults.mesh_m or staging.uncertainty.height)
    mesh = "object.obj" if exact else "truth/object.obj"
    centre = np.asarray(surface.centre).tolist()
    return {"shape": "mesh", "mesh": mesh, "centre": centre, "mesh_to_world": staging.mesh_to_world.tolist()}


def _lighting(illumination: Illumination, written: WrittenSet) -> dict[str, Any]:
    areas = [light for light in illumination.extended if isinstance(light, AreaLight)]
    discs = [light for light in illumination.extended if isinstance(light, DiscLight)]
    distant = [source for source in illumination.sources if isinstance(source, DirectionalSource)]
    lamps = [source for source in illumination.sources if isinstance(source, PointSource)]
    return {
        "name": illumination.name,
        "map": written.maps.get(illumination.name),
        "mirror_ball": written.balls.get(illumination.name),
        "area": [
            {
                "axis": light.axis.tolist(),
                "radiance": light.radiance.tolist(),
                "width_rad": light.width_rad,
            }
            for light in areas
        ],
        "discs": [
            {
                "direction": light.direction.tolist(),
                "irradiance": light.irradiance.tolist(),
                "radius_rad": light.radius_rad,
            }
            for light in discs
        ],
        "directional": [
            {"direction": source.direction.tolist(), "irradiance": source.irradiance.tolist()}
            for source in distant
        ],
        "lamps": [
            {"position": lamp.position.tolist(), "intensity": lamp.intensity.tolist()} for lamp in lamps
        ],
    }


def _sensor(staging: Staging) -> dict[str, Any]:
    sensor = staging.sensor
    if not isinstance(sensor, Development):
        return {"noise": {"relative": sensor.relative, "floor": sensor.floor}}
    inner = sensor.sensor
    return {
        "file": sensor.file,
        "response": inner.response,
        "bits": inner.bits,
        "full_well": inner.full_well.tolist(),
        "read_noise": inner.read_noise.tolist(),
        "focal_px": None if np.isinf(inner.focal_px) else inner.focal_px,
        "demosaic": sensor.demosaic,
        "radiance_factor": sensor.radiance_factor,
    }
